"""Everything that is worked out of an arm at once: proof over the payload, compliance, remaining error, frequencies."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, pi, sqrt

import numpy as np
from scipy.linalg import eigh

from beamdesign.arm.both_planes import BothPlanes, both_planes, couples_both
from beamdesign.arm.certificate import PlaneCertificate, certify_plane
from beamdesign.arm.figures import ArmFigures, arm_figures, arm_of, sensor_of
from beamdesign.arm.plane import PLANES
from beamdesign.arm.remaining import Remaining, Vector, remaining
from beamdesign.arm.statics import at_point, held, tip_compliance
from beamdesign.lumped import lumped_beam
from beamdesign.proof.box import BoxVerdict
from beamdesign.prototype import Prototype

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


@dataclass(frozen=True)
class ArmResult:
    """What is known of an arm.

    Attributes:
        figures: of the outer beam.
        outer_end_mass_kg: range of payloads.
        planes: the proofs of both planes, y then z; none where the payload couples them.
        both: the proof of both planes together, where the payload couples them.
        sampled_stable: stability at single payloads where they are coupled, by mass in kg: (mass, stable).
        sampled_load_Hz: where they are coupled and stable, up to which frequency a force in y, and one in z, moves the
            payload's centre along itself by no more than the goal's compliance, at the payloads looked at.
        closed_m_per_N: static compliance x / F_d of the two closed loops at the tip, y and z; None where not stable.
        passive: (6, 6) compliance at the payload's centre without servos.
        active: the same with servos; None where not stable.
        tip_passive, tip_active: likewise at the tip.
        without, with_servo: motions under the load.
        frequencies: at both ends of the range.
    """

    figures: ArmFigures
    outer_end_mass_kg: tuple[float, float]
    planes: tuple[PlaneCertificate, ...]
    both: BoxVerdict | None
    sampled_stable: tuple[tuple[float, bool], ...]
    sampled_load_Hz: tuple[float, float] | None
    closed_m_per_N: tuple[float, float] | None
    passive: np.ndarray
    active: np.ndarray | None
    tip_passive: np.ndarray
    tip_active: np.ndarray | None
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


def work_out(prototype: Prototype, masses: tuple[float, float], force_N: Vector) -> ArmResult:
    """Prove and work out an arm.

    Args:
        prototype: with a controller and without effects.
        masses: range of payloads, kg.
        force_N: steady load on the payload's centre, in x, y, z.

    Raises:
        InputError: where figures are missing, or for effects.
    """
    figures, arm = arm_figures(prototype), arm_of(prototype)
    model = both_planes(prototype)
    planes: tuple[PlaneCertificate, ...] = ()
    both: BoxVerdict | None = None
    sampled: tuple[tuple[float, bool], ...] = ()
    if couples_both(prototype):
        both = model.prove(*masses)
        if not both.stable:
            sampled = tuple(_sampled(model, masses))
    else:
        planes = tuple(certify_plane(prototype, name, *masses) for name in PLANES)
    stable = both.stable if both is not None else all(plane.stable for plane in planes)
    closed = None
    if stable:
        y, z = (loop.at(0.0).static_compliance() for loop in model.loops)
        closed = y, z
    goal = prototype.goal.compliance_m_per_N
    tip = tip_compliance(figures)
    servo = None if closed is None else held(tip, closed, sensor_of(prototype)).compliance
    payload, tool = arm.offset_m, arm.tool_m or arm.offset_m
    return ArmResult(
        figures=figures,
        outer_end_mass_kg=masses,
        planes=planes,
        both=both,
        sampled_stable=sampled,
        sampled_load_Hz=_load_Hz(model, masses, goal) if both is not None and stable else None,
        closed_m_per_N=closed,
        passive=at_point(tip, payload),
        active=None if servo is None else at_point(servo, payload),
        tip_passive=tip,
        tip_active=servo,
        without=remaining(figures, force_N, payload, tool, None),
        with_servo=None if closed is None else remaining(figures, force_N, payload, tool, closed, sensor_of(prototype)),
        frequencies=tuple(frequencies(prototype, mass) for mass in dict.fromkeys(masses)),
    )


def _sampled(model: BothPlanes, masses: tuple[float, float]) -> Iterator[tuple[float, bool]]:
    for mass in np.linspace(*masses, SAMPLES):
        yield float(mass), bool(model.poles(float(mass)).real.max() < 0)


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
    motions = np.array([[int(entry.p) / int(entry.q) for entry in row] for row in model.motions.tolist()])
    mass = np.diag([beam.mass, beam.mass, figures.polar_inertia]) + payload * motions.T @ motions
    stiffness = np.diag([beam.stiffness, beam.stiffness, figures.torsional_stiffness])
    first, second, third = (sqrt(value) / (2 * pi) for value in eigh(stiffness, mass, eigvals_only=True))
    inertia = figures.polar_inertia + payload * (y**2 + z**2)
    # The end that is held turns by M L / 4 E I.
    lever = payload * x**2
    turning = sqrt(4 * figures.bending_rigidity / figures.length / lever) / (2 * pi) if lever > 0 else inf
    return Frequencies(payload, (first, second, third), sqrt(figures.torsional_stiffness / inertia) / (2 * pi), turning)
