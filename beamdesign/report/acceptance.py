"""What a rig built to a prototype should measure, by its linear model: critical gains, compliances, frequencies."""

from dataclasses import dataclass
from math import inf, pi, sqrt

import numpy as np

from beamdesign.loop import Loop, loop
from beamdesign.lumped import lumped_beam
from beamdesign.prototype import Prototype


@dataclass(frozen=True)
class ExpectedAtMass:
    """Expected measurements with one mass on the outer tip.

    Attributes:
        outer_end_mass_kg: the mass.
        critical_gain_A_per_V: gain at which raising it sets in sustained oscillation; infinite where none does.
        oscillation_Hz: frequency of that oscillation, 0 where there is none.
        bandwidth_Hz: up to where the compliance keeps the goal.
        peak_sensitivity: largest |1 / (1 + L)|.
        compliance_m_per_N: |x / F_d| at `Acceptance.frequencies_Hz`, (n,).
        static_compliance_m_per_N: |x / F_d| at zero frequency.
    """

    outer_end_mass_kg: float
    critical_gain_A_per_V: float
    oscillation_Hz: float
    bandwidth_Hz: float
    peak_sensitivity: float
    compliance_m_per_N: tuple[float, ...]
    static_compliance_m_per_N: float


@dataclass(frozen=True)
class Acceptance:
    """Expected measurements.

    Attributes:
        frequencies_Hz: of the compliances.
        at_mass: one per mass.
        bare_outer_Hz: undamped frequency of the outer beam alone with nothing on its tip but its module.
        bare_inner_Hz: the same of the inner beam, its added mass included.
    """

    frequencies_Hz: tuple[float, ...]
    at_mass: tuple[ExpectedAtMass, ...]
    bare_outer_Hz: float
    bare_inner_Hz: float


def representative_masses(bounds: tuple[float, float]) -> tuple[float, ...]:
    """Both ends of a range and its middle, each once."""
    low, high = bounds
    return tuple(sorted({low, (low + high) / 2, high}))


def acceptance(
    prototype: Prototype, frequencies_Hz: tuple[float, ...] = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
) -> Acceptance:
    """Expected measurements of a prototype at both ends and in the middle of its range of outer end masses.

    Args:
        prototype: with controller and payload range.
        frequencies_Hz: where to give compliances.

    Raises:
        ValueError: without a controller or a range.
    """
    bounds, controller = prototype.payload.outer_end_mass_kg, prototype.controller
    if bounds is None or controller is None:
        raise ValueError("expected measurements need [controller] and payload.outer_end_mass_kg")
    closed = loop(prototype)
    outer = lumped_beam(prototype.outer_beam)
    inner = lumped_beam(prototype.inner_beam)
    return Acceptance(
        frequencies_Hz=frequencies_Hz,
        at_mass=tuple(
            _expected(closed, mass, controller.gain_A_per_V, prototype.goal.compliance_m_per_N, frequencies_Hz)
            for mass in representative_masses(bounds)
        ),
        bare_outer_Hz=sqrt(outer.stiffness / outer.mass) / (2 * pi),
        bare_inner_Hz=sqrt(inner.stiffness / (inner.mass + prototype.payload.inner_end_mass_kg)) / (2 * pi),
    )


def _expected(closed: Loop, mass: float, gain: float, limit: float, frequencies: tuple[float, ...]) -> ExpectedAtMass:
    here = closed.at(mass)
    margins = here.margins()
    return ExpectedAtMass(
        outer_end_mass_kg=mass,
        critical_gain_A_per_V=gain * margins.gain_up if margins.gain_up < inf else inf,
        oscillation_Hz=margins.critical_frequency_Hz,
        bandwidth_Hz=here.bandwidth_Hz(limit),
        peak_sensitivity=here.peak_sensitivity(),
        compliance_m_per_N=tuple(float(c) for c in np.abs(here.compliance_response(np.array(frequencies)))),
        static_compliance_m_per_N=abs(here.static_compliance()),
    )
