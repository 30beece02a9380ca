"""What is proved of one plane of the arm over a range of payloads: stable masses, guaranteed figures, and the text."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, isinf
from typing import Literal

import numpy as np
from flint import fmpq

from beamdesign.arm.figures import arm_of, sensor_of
from beamdesign.arm.plane import Name, PlaneFigures, PlaneLoop, in_plane, plane_loop
from beamdesign.crossing import Crossing
from beamdesign.polynomial import Affine, exact
from beamdesign.proof.document import controller_lines, quoted, remarks, rig_lines, sealed, stability_lines
from beamdesign.proof.estimates import sampled_masses
from beamdesign.proof.performance import kept_up_to_Hz, least_proved
from beamdesign.proof.quadratic import quadratic_nonnegative
from beamdesign.proof.rational import nearest, text
from beamdesign.proof.stability import StabilityMap, stable_ranges
from beamdesign.proof.statements import magnitude_slack, squared_frequency_below
from beamdesign.prototype import Goal, Prototype

KIND = "beamdesign.arm_plane"
VERSION = 1
METHOD = (
    "exact rational arithmetic: bending and torsion in one polynomial affine in the payload, every payload with a root"
    " on the imaginary axis isolated, one Routh test per range between them"
)

ClaimKind = Literal["tip_compliance", "load_compliance", "peak_sensitivity", "loop_gain", "controller_effort"]


@dataclass(frozen=True)
class ArmClaim:
    """One statement that holds for every payload of the range.

    Attributes:
        kind: what is bounded.
        limit: its bound: m/N, a plain number or A/V.
        up_to_Hz: for a compliance, the frequency up to which it holds; infinite for all.
        from_Hz: for a loop gain, the frequency from which on it holds.
    """

    kind: ClaimKind
    limit: float
    up_to_Hz: float | None = None
    from_Hz: float | None = None


@dataclass(frozen=True)
class PlaneGuaranteed:
    """The best figures that are proved of a plane that is stable over the whole range, rounded to the safe side.

    Attributes:
        tip_bandwidth_Hz: up to which a force on the tip moves the tip by no more than the goal's compliance.
        load_bandwidth_Hz: the same of the payload's centre; zero where even a steady force moves it further.
        load_static_m_per_N: static compliance at the payload's centre, which is the same for every payload.
        peak_sensitivity: max |1 / (1 + L)|.
        loop_gain: max |L| from the goal's frequency up; None where the goal sets it no limit.
        controller_effort_A_per_V: max |C / (1 + L)|; None likewise.
    """

    tip_bandwidth_Hz: float
    load_bandwidth_Hz: float
    load_static_m_per_N: float
    peak_sensitivity: float
    loop_gain: float | None = None
    controller_effort_A_per_V: float | None = None


@dataclass(frozen=True)
class PlaneCertificate:
    """What is proved of one plane.

    Attributes:
        name: direction in which the tip moves.
        coupled: whether torsion takes part.
        outer_end_mass_kg: the range of payloads.
        stability: stable ranges and crossings, exact.
        guaranteed: None where the range is not stable throughout.
        text: the certificate as `beamdesign.proof.replay_arm` reads it.
    """

    name: Name
    coupled: bool
    outer_end_mass_kg: tuple[float, float]
    stability: StabilityMap
    guaranteed: PlaneGuaranteed | None
    text: str

    @property
    def stable(self) -> bool:
        """Whether every payload of the closed range is stable."""
        return self.stability.stable

    @property
    def reason(self) -> str:
        """In words, why it is not; empty where it is."""
        return self.stability.reason

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """Payloads of the range at which a root lies on the axis."""
        return self.stability.crossings


def certify_plane(prototype: Prototype, name: Name, low_kg: float, high_kg: float) -> PlaneCertificate:
    """Decide stability of one plane over a range of payloads, work out what can be guaranteed, and write the proof.

    Raises:
        InputError: as `beamdesign.arm.plane.plane_loop`.
        ValueError: for an empty range, or where the payload couples both planes.
    """
    closed = plane_loop(prototype, name)
    stability = stable_ranges(closed.characteristic, exact(low_kg), exact(high_kg))
    guaranteed, claims = _guarantees(closed, prototype.goal, low_kg, high_kg) if stability.stable else (None, [])
    written = _document(in_plane(prototype, name), closed.figures, stability, claims)
    return PlaneCertificate(name, closed.figures.coupled, (low_kg, high_kg), stability, guaranteed, written)


def _guarantees(closed: PlaneLoop, goal: Goal, low_kg: float, high_kg: float) -> tuple[PlaneGuaranteed, list[ArmClaim]]:
    masses = exact(low_kg), exact(high_kg)
    samples = [closed.at(mass) for mass in sampled_masses(*masses)]
    p = closed.characteristic

    def least(above: Affine, below: Affine, start: float, from_Hz: float = 0.0) -> float:
        square = squared_frequency_below(exact(from_Hz))

        def proves(limit: fmpq) -> bool:
            return quadratic_nonnegative(*magnitude_slack(limit, below, above), *masses, square, None).holds

        return least_proved(start, proves, 1e12)

    limit = exact(goal.compliance_m_per_N)
    bands = [kept_up_to_Hz(magnitude_slack(limit, p, numerator), *masses) for numerator in (closed.tip, closed.load)]
    peak = least(closed.opened, p, max(1.0, *(one.peak_sensitivity() for one in samples)))
    gain = effort = None
    if goal.loop_gain is not None:
        start = _largest([abs(one.loop_response(_above(goal.loop_gain_from_Hz))) for one in samples])
        gain = least(closed.returned, closed.opened, start, goal.loop_gain_from_Hz)
    if goal.controller_effort_A_per_V is not None:
        effort = least(closed.demanded, p, _largest([abs(one.effort_response(_above(0.01))) for one in samples]))
    static = nearest(closed.load.constant(0) / p.constant(0))  # the payload stands beside s^2 everywhere
    claims = [
        ArmClaim("tip_compliance", goal.compliance_m_per_N, bands[0]),
        ArmClaim("load_compliance", goal.compliance_m_per_N, bands[1]),
        ArmClaim("peak_sensitivity", peak),
    ]
    if gain is not None:
        claims.append(ArmClaim("loop_gain", gain, from_Hz=goal.loop_gain_from_Hz))
    if effort is not None:
        claims.append(ArmClaim("controller_effort", effort))
    proved = [claim for claim in claims if not isinf(claim.limit) and claim.up_to_Hz != 0]
    return PlaneGuaranteed(bands[0], bands[1], static, peak, gain, effort), proved


def _above(frequency_Hz: float) -> np.ndarray:
    return np.geomspace(max(frequency_Hz, 0.01), 1e5, 3000)


def _largest(values: Sequence[np.ndarray]) -> float:
    return max(float(value.max()) for value in values)


# The text.


def describe(claim: ArmClaim) -> str:
    """A claim in words."""
    up_to = "at every frequency" if claim.up_to_Hz in (None, inf) else f"up to {claim.up_to_Hz:.7g} Hz"
    match claim.kind:
        case "tip_compliance":
            return f"a force on the tip moves it by at most {claim.limit:.6g} m/N {up_to}"
        case "load_compliance":
            return f"a force on the payload's centre moves it by at most {claim.limit:.6g} m/N {up_to}"
        case "peak_sensitivity":
            return f"peak sensitivity max |1/(1+L)| at most {claim.limit:.6g}"
        case "loop_gain":
            return f"loop gain |L| at most {claim.limit:.6g} from {claim.from_Hz or 0:.7g} Hz up"
        case "controller_effort":
            return f"controller effort |C/(1+L)| at most {claim.limit:.6g} A/V"


def _document(prototype: Prototype, figures: PlaneFigures, stability: StabilityMap, claims: Sequence[ArmClaim]) -> str:
    low, high = nearest(stability.low), nearest(stability.high)
    summary = [
        f"Certificate of {prototype.name!r}, plane {figures.name}, for every payload from {low:g} to {high:g} kg.",
        "Stable over the whole range." if stability.stable else f"NOT stable: {stability.reason}.",
        *(f"Proved: {describe(claim)}." for claim in claims),
    ]
    above = [
        *remarks("\n".join(summary)),
        "#",
        "# To prove it again: python -m beamdesign.proof.replay_arm THIS-FILE",
        "# Lines that begin with # explain; the others are proved. All numbers are exact: decimals or quotients, as",
        "# text. The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    below = [
        f"name = {quoted(prototype.name)}",
        'parameter = "outer_end_mass_kg"',
        f'low = "{text(stability.low)}"',
        f'high = "{text(stability.high)}"',
        "",
        *rig_lines(prototype),
        *controller_lines(prototype),
        *_arm_lines(prototype, figures),
        *stability_lines(stability),
        *(line for claim in claims for line in _claim_lines(claim)),
    ]
    return sealed(above, below)


def _arm_lines(prototype: Prototype, figures: PlaneFigures) -> Iterator[str]:
    length = prototype.outer_beam.free_length_m
    assert length is not None  # else there are no figures of the arm
    yield "# Payload's centre and sensors from the tip (along the beam, sideways, upwards); torsion of the outer beam."
    yield "[arm]"
    yield f'plane = "{figures.name}"'
    yield f'free_length_m = "{text(exact(length))}"'
    yield f"offset_m = [{', '.join(quoted(text(exact(value))) for value in arm_of(prototype).offset_m)}]"
    yield f"sensor_m = [{', '.join(quoted(text(exact(value))) for value in sensor_of(prototype))}]"
    yield f'torsional_stiffness_N_m_per_rad = "{text(figures.torsional_stiffness)}"'
    yield f'torsional_damping_N_m_s_per_rad = "{text(figures.torsional_damping)}"'
    yield f'polar_inertia_kg_m2 = "{text(figures.polar_inertia)}"'
    yield ""


def _claim_lines(claim: ArmClaim) -> Iterator[str]:
    yield "[[claim]]"
    yield f'kind = "{claim.kind}"'
    yield f'limit = "{text(exact(claim.limit))}"'
    if claim.up_to_Hz is not None:
        yield f'up_to_Hz = "{"infinite" if isinf(claim.up_to_Hz) else text(exact(claim.up_to_Hz))}"'
    if claim.from_Hz is not None:
        yield f'from_Hz = "{text(exact(claim.from_Hz))}"'
    yield ""
