"""What a rig built to a prototype should measure: nominal by the linear model, and bands within its tolerances."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, pi, sqrt

import numpy as np

from beamdesign.changed_figures import CHANGEABLE, with_figures
from beamdesign.loop import CriticalGain, critical_gain, loop
from beamdesign.lumped import lumped_beam
from beamdesign.polynomial import exact
from beamdesign.proof.box import box_of, certify_box
from beamdesign.proof.rig_family import rig_values
from beamdesign.prototype import Prototype
from beamdesign.specification.tolerances import why_no_box

MEASURED_WITHIN = 0.05
"""Relative error allowed to the measurement of a compliance or a critical gain, beyond the bands."""
FREQUENCIES_HZ = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 150.0)
_MEMBERS = 64
_BACK_OFF = (0.99, 0.97, 0.94, 0.9, 0.85)
_BUDGET = 1500
_EDGE = 0.7
"""A member is drawn with each figure at an end of its tolerance, with this probability, or else between them."""


@dataclass(frozen=True)
class Band:
    """A measured quantity: nominal, and its least and largest value over the members looked at.

    Without tolerances all three are the same.
    """

    nominal: float
    low: float
    high: float

    @property
    def limits(self) -> tuple[float, float]:
        """Pass if measured between these: the band and the error of the measurement."""
        return self.low * (1 - MEASURED_WITHIN), self.high * (1 + MEASURED_WITHIN)


@dataclass(frozen=True)
class AcceptanceAtMass:
    """Expected measurements with one mass on the outer tip.

    Attributes:
        outer_end_mass_kg: the mass.
        bandwidth_Hz: up to where the nominal compliance keeps the goal.
        peak_sensitivity: largest nominal |1 / (1 + L)|.
        static_compliance_m_per_N: nominal |x / F_d| at zero frequency.
        compliance_m_per_N: |x / F_d| by frequency in Hz.
        critical_gain_A_per_V: band; None where raising the gain never sets in oscillation.
        oscillation_Hz: band of its frequency.
        critical_gain_proved_A_per_V: up to this gain every rig within the tolerances is proved stable; None where no
            gain above the specified one was proved, or there are no tolerances.
    """

    outer_end_mass_kg: float
    bandwidth_Hz: float
    peak_sensitivity: float
    static_compliance_m_per_N: float
    compliance_m_per_N: Mapping[float, Band]
    critical_gain_A_per_V: Band | None
    oscillation_Hz: Band | None
    critical_gain_proved_A_per_V: float | None


def bare_frequencies_Hz(prototype: Prototype) -> tuple[float, float]:
    """Undamped frequencies of the beams by themselves: outer with its module alone, inner with its added mass too."""
    outer, inner = lumped_beam(prototype.outer_beam), lumped_beam(prototype.inner_beam)
    loaded = inner.mass + prototype.payload.inner_end_mass_kg
    return sqrt(outer.stiffness / outer.mass) / (2 * pi), sqrt(inner.stiffness / loaded) / (2 * pi)


def acceptance(
    prototype: Prototype,
    masses_kg: tuple[float, ...],
    tolerances: Mapping[str, float] | None = None,
    told: Callable[[float, str], None] = lambda share, text: None,
) -> tuple[AcceptanceAtMass, ...]:
    """Expected measurements at some outer end masses.

    Bands are the extremes of members drawn from the box of tolerances, most figures at an end: sampled, not proved.
    That all rigs of the box are stable up to a gain is proved by zero exclusion.

    Args:
        prototype: with a controller.
        masses_kg: outer end masses.
        tolerances: relative, by figure as in `beamdesign.proof.rig_family.rig_values`; none where it is None.
        told: the share done, and with what.
    """
    spread = {name: part for name, part in (tolerances or {}).items() if name in CHANGEABLE and part > 0}
    members = [prototype, *_drawn(prototype, spread)]
    responses: list[list[np.ndarray]] = [[] for _ in masses_kg]
    gains: list[list[CriticalGain]] = [[] for _ in masses_kg]
    grid = np.array(FREQUENCIES_HZ)
    nominal = loop(prototype)
    for k, member in enumerate(members):
        told(0.7 * k / len(members), "members within the tolerances")
        closed = loop(member)
        for at, mass in enumerate(masses_kg):
            responses[at].append(np.abs(closed.at(mass).compliance_response(grid)))
            try:
                gains[at].append(critical_gain(member, mass, from_own=True))
            except ValueError:  # no gain makes it oscillate
                gains[at].append(CriticalGain(inf, 0.0))
    found = []
    for at, mass in enumerate(masses_kg):
        told(0.7 + 0.3 * at / len(masses_kg), "gain that all rigs bear")
        table = np.array(responses[at])
        onset = [one for one in gains[at] if one.gain_A_per_V < inf]
        gain = _band([one.gain_A_per_V for one in onset]) if len(onset) == len(members) else None
        here = nominal.at(mass)
        found.append(
            AcceptanceAtMass(
                mass,
                here.bandwidth_Hz(prototype.goal.compliance_m_per_N),
                here.peak_sensitivity(),
                abs(here.static_compliance()),
                {float(f): _band(table[:, k]) for k, f in enumerate(grid)},
                gain,
                None if gain is None else _band([one.frequency_Hz for one in onset]),
                _proved_gain(prototype, mass, spread, gain.low) if gain and spread else None,
            )
        )
    return tuple(found)


def _band(values: "list[float] | np.ndarray") -> Band:
    return Band(float(values[0]), float(min(values)), float(max(values)))


def _drawn(prototype: Prototype, spread: Mapping[str, float]) -> list[Prototype]:
    """Each figure alone at either end, and members with all figures off."""
    random = np.random.default_rng(1)
    factors = [{name: 1 + side * part} for name, part in spread.items() for side in (-1, 1)]
    for _ in range(_MEMBERS if spread else 0):
        at = np.where(random.random(len(spread)) < _EDGE, random.choice((-1.0, 1.0), len(spread)), 0.0)
        at = np.where(at == 0, random.uniform(-1, 1, len(spread)), at)
        factors.append({name: 1 + float(a) * part for a, (name, part) in zip(at, spread.items(), strict=True)})
    return [with_figures(prototype, one) for one in factors]


def _proved_gain(prototype: Prototype, mass: float, spread: Mapping[str, float], sampled: float) -> float | None:
    """A gain, as near as was proved to the least critical one sampled, up to which all rigs are stable."""
    if why_no_box(prototype):
        return None
    values = rig_values(prototype)
    own = prototype.controller
    assert own is not None
    ranges = {
        name: (values[name] * (1 - exact(part)), values[name] * (1 + exact(part)))
        for name, part in spread.items()
        if name != "controller_gain"
    }
    for back_off in _BACK_OFF:
        gain = float(f"{back_off * sampled:.4g}")
        if gain <= own.gain_A_per_V:
            return None
        box = box_of(
            {**ranges, "outer_end_mass": (mass, mass), "controller_gain": (own.gain_A_per_V, gain)},
            {"controller_gain": own.gain_A_per_V},
        )
        if certify_box(prototype, box, _BUDGET, volumes=False).stable:
            return gain
    return None
