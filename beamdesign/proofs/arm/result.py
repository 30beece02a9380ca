"""An arm worked out: of each plane what is proved over the payload, and of both what compliance and error remain."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi, sqrt
from typing import Any

import numpy as np
from scipy.linalg import eigh

from beamdesign.arguments import checked, takes
from beamdesign.plant.members import STANDARD_GRAVITY
from beamdesign.polynomial import exact, nearest
from beamdesign.proofs.arm import PlaneLoop, plane_loop
from beamdesign.proofs.arm.both_planes import BothPlanes, both_planes
from beamdesign.proofs.arm.remaining import Remaining, Vector, at_point, held, remaining, tip_compliance
from beamdesign.proofs.box import BoxVerdict
from beamdesign.proofs.certificate import Asked, Claim, Decided, Kind, as_claims, describe, least_limits, limits
from beamdesign.proofs.mass_family import floats
from beamdesign.proofs.performance import least_of, slack
from beamdesign.proofs.quadratic import kept_up_to_Hz
from beamdesign.proofs.stability import StabilityMap, stable_ranges
from beamdesign.proofs.writer import certificate, plain, stability_table, stated, texts
from beamdesign.prototype import Goal, Prototype
from beamdesign.quantities import SignedForce
from beamdesign.result import Result, finite, picked
from beamdesign.structure.arm import PLANES, ArmFigures, Name, PlaneFigures, arm_figures, arm_of, in_plane, sensor_of
from beamdesign.structure.lumped import lumped_beam

KIND = "beamdesign.arm_plane"
NOTES = {
    "arm": "Payload's centre and sensors from the tip: along the beam, sideways, upwards.",
    "plane": "The direction in which the tip moves; of the outer beam the length, and torsion where it takes part.",
}


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
class PlaneCertificate(Decided):
    """What is proved of one plane over a range of payloads.

    Attributes:
        name: direction in which the tip moves.
        coupled: whether torsion takes part.
        guaranteed: None where the range is not stable throughout.
    """

    name: Name
    coupled: bool
    guaranteed: PlaneGuaranteed | None


def certify_plane(prototype: Prototype, name: Name, low_kg: float, high_kg: float) -> PlaneCertificate:
    """Decide stability of one plane over a range of payloads, work out what can be guaranteed, and write the proof.

    Raises:
        InputError: as `beamdesign.proofs.arm.plane_loop`.
        ValueError: for an empty range, or where the payload couples both planes.
    """
    closed = plane_loop(prototype, name)
    stability = stable_ranges(closed.characteristic, exact(low_kg), exact(high_kg))
    guaranteed, claims = _guarantees(closed, prototype.goal, low_kg, high_kg) if stability.stable else (None, [])
    own = in_plane(prototype, name)
    body = {
        "outer_end_mass_kg": texts((stability.low, stability.high)),
        "plane": _plane_table(own, closed.figures),
        "stability": stability_table(stability),
        **({"claim": [claim.table() for claim in claims]} if claims else {}),
    }
    written = certificate(KIND, own, body, _summary(own, name, stability, claims), notes=NOTES)
    return PlaneCertificate((low_kg, high_kg), stability, written, name, closed.figures.coupled, guaranteed)


def _guarantees(closed: PlaneLoop, goal: Goal, low_kg: float, high_kg: float) -> tuple[PlaneGuaranteed, list[Claim]]:
    masses, limit = (exact(low_kg), exact(high_kg)), exact(goal.compliance_m_per_N)
    kinds: tuple[Kind, Kind] = ("tip_compliance", "load_compliance")
    bands = [Asked(kind, goal.compliance_m_per_N, kept_up_to_Hz(slack(kind, closed, limit), *masses)) for kind in kinds]
    others = least_limits(goal, lambda kind, *asked: least_of(kind, closed, masses, *asked))
    static = nearest(closed.load.constant(0) / closed.characteristic.constant(0))  # the payload stands beside s^2
    guaranteed = PlaneGuaranteed(bands[0].bandwidth_Hz, bands[1].bandwidth_Hz, static, *limits(others))
    return guaranteed, as_claims((*bands, *others), (low_kg, high_kg))


def _summary(prototype: Prototype, name: Name, stability: StabilityMap, claims: Sequence[Claim]) -> str:
    low, high = nearest(stability.low), nearest(stability.high)
    lines = [
        f"Certificate of {prototype.name!r}, plane {name}, for every payload from {low:.15g} to {high:.15g} kg.",
        "Stable over the whole range." if stability.stable else f"NOT stable: {stability.reason}.",
        *(f"Proved: {describe(claim)}." for claim in claims),
    ]
    return "\n".join(lines)


def _plane_table(prototype: Prototype, figures: PlaneFigures) -> dict[str, Any]:
    """Length of the outer beam; its torsion, and the section that this follows from, where they are in the loop."""
    beam = prototype.outer_beam
    table: dict[str, Any] = {"name": figures.name, "free_length_m": beam.free_length_m}
    if figures.coupled:
        units = ("stiffness_N_m_per_rad", "damping_N_m_s_per_rad", "polar_inertia_kg_m2")
        table["torsion"] = dict(zip(units, texts(figures.twist.coeffs()), strict=True))
    if figures.coupled and beam.geometry is not None:
        keys = ("shape", "width_m", "wall_m", "corner_radius_m", "material")
        table["section"] = {key: value for key, value in plain(beam).items() if key in keys}
    return stated(table)


SAMPLES = 9
"""Payloads at which an arm that couples both planes is looked at where no proof settles it."""


@dataclass(frozen=True)
class Frequencies:
    """Natural frequencies of the outer beam with a payload, no servo and no damping.

    Attributes:
        outer_end_mass_kg: the payload.
        modes_Hz: of bending in both planes and torsion together, ascending.
        torsion_held_Hz: of torsion with the tip held, as a perfect servo would.
        turning_held_Hz: of the payload on the end that is held but turns in bending; infinite without an offset along
            the beam. The loops have no such mode: their figures are for frequencies well below it.
    """

    outer_end_mass_kg: float
    modes_Hz: tuple[float, float, float]
    torsion_held_Hz: float
    turning_held_Hz: float


@dataclass(frozen=True, repr=False)
class ArmResult(Result):
    """What is known of an arm.

    Attributes:
        figures: of the outer beam.
        outer_end_mass_kg: range of payloads.
        planes: the proofs of both planes, y then z; none where the payload couples them.
        both: the proof of both planes together, where the payload couples them.
        sampled_stable: stability at single payloads where they are coupled, by mass in kg: (mass, stable).
        sampled_load_Hz: where they are coupled and stable, up to which frequency a force in y, and one in z, moves the
            payload's centre along itself by no more than the goal's compliance, at the payloads looked at.
        compliances: (6, 6) by place, "tip" or "payload", its centre, and whether with servos; None with them where not
            stable.
        without, with_servo: motions under the load.
        frequencies: at both ends of the range.
    """

    figures: ArmFigures
    outer_end_mass_kg: tuple[float, float]
    planes: tuple[PlaneCertificate, ...]
    both: BoxVerdict | None
    sampled_stable: tuple[tuple[float, bool], ...]
    sampled_load_Hz: tuple[float, float] | None
    compliances: dict[tuple[str, bool], np.ndarray | None]
    without: Remaining
    with_servo: Remaining | None
    frequencies: tuple[Frequencies, ...]

    @property
    def stable(self) -> bool | None:
        """Whether stability of both loops is proved for every payload of the range; None where it is undecided."""
        return self.both.stable if self.both is not None else all(plane.stable for plane in self.planes)

    @property
    def reason(self) -> str:
        """In words, why it is not; empty where it is."""
        if self.both is not None:
            return self.both.reason
        return "; ".join(f"plane {plane.name}: {plane.reason}" for plane in self.planes if not plane.stable)

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        planes = "plane=name coupled_with_torsion=coupled stable guaranteed stable_ranges_kg=stability.closed_ranges"
        return finite({
            **picked(self, "stable reason outer_end_mass_kg figures sampled_stable sampled_load_Hz frequencies"),
            "planes": [
                picked(plane, planes)
                | {"crossings": [picked(one, "outer_end_mass_kg=value frequency_Hz") for one in plane.crossings]}
                for plane in self.planes
            ],
            "both_planes": None if self.both is None else picked(self.both, "stable reason pieces"),
            "compliance": {
                f"{place}_{'with' if servo else 'without'}_servo": found
                for (place, servo), found in self.compliances.items()
            },
            "without_servo": self.without.to_dict(),
            "with_servo": None if self.with_servo is None else self.with_servo.to_dict(),
        })  # fmt: skip


def usual_load_N(prototype: Prototype, payload_kg: float) -> Vector:
    """The weight of a payload and the prototype's largest force, downwards, in x, y, z."""
    return 0.0, 0.0, -(payload_kg * STANDARD_GRAVITY + (prototype.payload.largest_force_N or 0.0))


@takes("Prototype")
def arm(
    prototype: Prototype, outer_end_mass_kg: tuple[float, float] | None = None, force_N: Vector | None = None
) -> ArmResult:
    """Prove both planes of an arm with torsion, and work out what a steady load leaves.

    Args:
        prototype: with a controller and without effects; `arm` places its payload and its sensor.
        outer_end_mass_kg: range of payloads; else the prototype's.
        force_N: load on the payload's centre in x along the beam, y sideways, z upwards; else the weight of the largest
            payload and the prototype's largest force, downwards.

    Raises:
        InputError: where figures are missing or not plausible, or for effects.
        ValueError: for an empty range, or a load that is not of three figures.
    """
    masses = prototype.asked_kg(outer_end_mass_kg)
    figures, link = arm_figures(prototype), arm_of(prototype)
    model = both_planes(prototype)
    both = model.prove(*masses) if all(link.offset_m[1:]) else None  # off to both sides
    planes = () if both is not None else tuple(certify_plane(prototype, name, *masses) for name in PLANES)
    sampled: tuple[tuple[float, bool], ...] = ()
    if both is not None and not both.stable:
        payloads = map(float, np.linspace(*masses, SAMPLES))
        sampled = tuple((mass, bool(model.poles(mass).real.max() < 0)) for mass in payloads)
    stable = both.stable if both is not None else all(plane.stable for plane in planes)
    closed = None
    if stable:
        y, z = (loop.at(0.0).static_compliance() for loop in model.loops)
        closed = y, z
    load = usual_load_N(prototype, masses[1]) if force_N is None else force_N
    x, y, z = checked(prototype.name, "force_N", SignedForce, *load)
    goal, force = prototype.goal.compliance_m_per_N, (x, y, z)
    tip = tip_compliance(figures)
    servo = None if closed is None else held(tip, closed, sensor_of(prototype))[0]
    payload, tool = link.offset_m, link.tool_m or link.offset_m
    return ArmResult(
        figures=figures,
        outer_end_mass_kg=masses,
        planes=planes,
        both=both,
        sampled_stable=sampled,
        sampled_load_Hz=_load_Hz(model, masses, goal) if both is not None and stable else None,
        compliances={
            (place, with_servo): None if found is None else at_point(found, lever)
            for place, lever in (("tip", (0.0, 0.0, 0.0)), ("payload", payload))
            for with_servo, found in ((False, tip), (True, servo))
        },
        without=remaining(figures, force, payload, tool, None),
        with_servo=None if closed is None else remaining(figures, force, payload, tool, closed, sensor_of(prototype)),
        frequencies=tuple(frequencies(prototype, mass) for mass in dict.fromkeys(masses)),
    )


def _load_Hz(model: BothPlanes, masses: tuple[float, float], goal: float) -> tuple[float, float]:
    grid = np.geomspace(1e-3, 1e3, 6000)
    responses = [np.abs(model.response(float(mass), grid)) for mass in np.linspace(*masses, SAMPLES)]
    kept = []
    for i in (1, 2):
        beyond = np.nonzero(np.max([response[:, i, i] for response in responses], axis=0) > goal)[0]
        kept.append(inf if not len(beyond) else float(grid[beyond[0] - 1]) if beyond[0] else 0.0)
    return kept[0], kept[1]


def frequencies(prototype: Prototype, payload: float) -> Frequencies:
    """Natural frequencies of the outer beam with a payload (kg) where the prototype has it."""
    figures, model = arm_figures(prototype), both_planes(prototype)
    x, y, z = arm_of(prototype).offset_m
    beam = lumped_beam(prototype.outer_beam, "outer_beam")
    motions = floats(model.motions)
    mass = np.diag([beam.mass, beam.mass, figures.polar_inertia]) + payload * motions.T @ motions
    stiffness = np.diag([beam.stiffness, beam.stiffness, figures.torsional_stiffness])
    first, second, third = (sqrt(value) / (2 * pi) for value in eigh(stiffness, mass, eigvals_only=True))
    inertia = figures.polar_inertia + payload * (y**2 + z**2)
    # The end that is held turns by M L / 4 E I.
    lever = payload * x**2
    turning = sqrt(4 * figures.bending_rigidity / figures.length / lever) / (2 * pi) if lever > 0 else inf
    return Frequencies(payload, (first, second, third), sqrt(figures.torsional_stiffness / inertia) / (2 * pi), turning)
