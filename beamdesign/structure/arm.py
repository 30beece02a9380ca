"""The link as an arm: rigidities and inertia of its outer beam, and how a payload off the axis moves with its end.

Axes: x along the beam away from the clamp, y sideways, z upwards, from the tip. What a plane of an arm is, and what is
left out of it, stands in `beamdesign.proofs.arm`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from flint import fmpq, fmpq_poly

from beamdesign.bench_prototype import AnyPrototype
from beamdesign.polynomial import exact
from beamdesign.prototype import Arm, Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure import lumped

TORSION_SHARE = 1 / 3
"""Of the tube's polar inertia that turns with its end: the kinetic energy of a twist that grows evenly (Rayleigh)."""


@dataclass(frozen=True)
class ArmFigures:
    """The outer beam beyond its bending in one plane, SI.

    Attributes:
        length: L, from clamp to tip, m.
        stiffness: K in either plane, N/m; the tube is square or round.
        bending_rigidity: E I, N m2, of K = 3 E I / L^3.
        torsional_stiffness: G J / L, N m/rad.
        torsional_damping: N m s/rad, a fixed dashpot like those of bending.
        polar_inertia: about the axis, kg m2: a third of the tube's, the end module's, and the payload's own.
        axial_stiffness: E A / L, N/m; None without the section.
        notes: which figures stand for which, in words.
    """

    length: float
    stiffness: float
    bending_rigidity: float
    torsional_stiffness: float
    torsional_damping: float
    polar_inertia: float
    axial_stiffness: float | None
    notes: tuple[str, ...] = ()


def arm_of(prototype: Prototype) -> Arm:
    """The prototype's [arm], or one without offsets."""
    return prototype.arm or Arm()


def sensor_of(prototype: Prototype) -> tuple[float, float, float]:
    """Where the servos measure, from the tip, m."""
    return arm_of(prototype).sensor_m or (0.0, 0.0, 0.0)


def arm_figures(prototype: Prototype) -> ArmFigures:
    """Work the figures out; a torsional stiffness that is given wins over the section's.

    Raises:
        InputError: where length, torsional stiffness or polar inertia can neither be read nor worked out, or a tube is
            rectangular.
    """
    beam, arm = prototype.outer_beam, arm_of(prototype)
    reason = (
        "a rectangular tube is stiffer in one plane than in the other, and an arm is worked out with one stiffness for"
        " both: take a square or a round one"
    )
    shapes = {"outer_beam": beam.shape, "inner_beam": prototype.inner_beam.shape}
    wrong = [Problem(f"{name}.shape", reason) for name, shape in shapes.items() if shape == "rectangle"]
    if beam.free_length_m is None:
        wrong.append(Problem("outer_beam.free_length_m", "missing; turning of the tip needs it"))
    given, added = arm.torsional_stiffness_N_m_per_rad, arm.end_polar_inertia_kg_m2 + arm.payload_polar_inertia_kg_m2
    if beam.geometry is None:
        reason = "missing; give it, or width_m, wall_m, free_length_m and material of the outer beam"
        needed = {"torsional_stiffness_N_m_per_rad": given is None, "end_polar_inertia_kg_m2": added == 0}
        wrong += [Problem(f"arm.{key}", reason) for key, missing in needed.items() if missing]
    if wrong:
        raise InputError(prototype.name, wrong)

    length = beam.free_length_m
    assert length is not None  # else it was wrong
    one = lumped.lumped_beam(beam, "outer_beam")
    inertia, axial, stiffness = added, None, given
    note = "no section: the tube's own polar inertia and its axial compliance are left out"
    if beam.geometry is not None:
        alloy, tube, _ = beam.geometry
        inertia += TORSION_SHARE * alloy.density_kg_per_m3 * float(tube.polar_moment) * length
        axial = alloy.youngs_modulus_Pa * float(tube.area) / length
        computed = alloy.shear_modulus_Pa * float(tube.torsion_constant) / length
        note = f"torsional stiffness {computed:.6g} N m/rad worked out from the section (G J / L)"
        if given is not None:
            note = f"given torsional stiffness {given:.6g} N m/rad used, the section gives {computed:.6g} N m/rad"
        stiffness = computed if given is None else given
    assert stiffness is not None  # else it was wrong
    ratio = beam.damping_ratio if arm.torsional_damping_ratio is None else arm.torsional_damping_ratio
    return ArmFigures(
        length=length,
        stiffness=one.stiffness,
        bending_rigidity=one.stiffness * length**3 / 3,
        torsional_stiffness=stiffness,
        torsional_damping=2 * ratio * (stiffness * inertia) ** 0.5,
        polar_inertia=inertia,
        axial_stiffness=axial,
        notes=(note,),
    )


Name = Literal["y", "z"]
PLANES: tuple[Name, Name] = ("y", "z")


@dataclass(frozen=True)
class PlaneFigures:
    """How a payload takes part in one plane, exact.

    Attributes:
        name: direction in which the tip moves.
        travel: kappa, the payload's motion in the plane per motion of the tip.
        along: lambda, its motion along the beam per motion of the tip.
        lever: e, its motion in the plane per roll, m.
        twist: torsion of the outer beam's end, k + b s + I s^2, of N m/rad, N m s/rad and kg m2.
        residual: compliance at the payload beside the mode's, m/N: 3 a_x^2 / (4 K L^2), its lever's on an end that is
            held but turns.
        sensed_travel: kappa_s, what the servo sees per motion of the tip.
        sensed_lever: e_s, what it sees per roll, m.
        sensed_residual: what it sees beside the mode per force on the payload, m/N: 3 a_x s_x / (4 K L^2).
    """

    name: Name
    travel: fmpq
    along: fmpq
    lever: fmpq
    twist: fmpq_poly
    residual: fmpq
    sensed_travel: fmpq
    sensed_lever: fmpq
    sensed_residual: fmpq

    @property
    def torsion(self) -> fmpq_poly:
        """Torsion; one where the payload has no lever, so that torsion has no part in the loop."""
        return self.twist if self.coupled else fmpq_poly([1])

    @property
    def coupled(self) -> bool:
        """Whether the payload couples this plane with torsion."""
        return self.lever != 0


def plane_figures(prototype: Prototype, name: Name) -> PlaneFigures:
    """The payload's part in one plane."""
    found = arm_figures(prototype)
    x, y, z = (exact(value) for value in arm_of(prototype).offset_m)
    sensed_x, sensed_y, sensed_z = (exact(value) for value in sensor_of(prototype))
    length = exact(found.length)
    rest = fmpq(3, 4) / (exact(found.stiffness) * length**2)
    return PlaneFigures(
        name=name,
        travel=1 + 3 * x / (2 * length),
        along=3 * (y if name == "y" else z) / (2 * length),
        lever=y if name == "z" else -z,
        twist=fmpq_poly([*map(exact, (found.torsional_stiffness, found.torsional_damping, found.polar_inertia))]),
        residual=rest * x**2,
        sensed_travel=1 + 3 * sensed_x / (2 * length),
        sensed_lever=sensed_y if name == "z" else -sensed_z,
        sensed_residual=rest * x * sensed_x,
    )


LEVER_FIGURES = (
    "payload_travel", "payload_along", "payload_lever", "sensed_travel", "sensed_lever",
    "torsional_stiffness", "torsional_damping", "polar_inertia",
)  # fmt: skip
"""Of a payload off the axis in one plane: kappa, lambda, e (m), kappa_s, e_s (m), N m/rad, N m s/rad, kg m2."""


def off_axis(prototype: AnyPrototype) -> bool:
    """Whether the prototype is that of one plane of an arm, its payload or its sensor off the axis."""
    arm: Arm | None = getattr(prototype, "arm", None)  # a bench has none
    return arm is not None and arm.plane is not None and (any(arm.offset_m) or any(arm.sensor_m or ()))


def left_aside(prototype: Prototype) -> str:
    """What work on one loop leaves aside of an arm, in words; empty where that is the arm's loop in either plane."""
    arm, words = arm_of(prototype), []
    if any(arm.offset_m) or any(arm.sensor_m or ()):
        words.append("payload and sensor on the beam's axis at the tip")
    if arm.second_controller is not None:
        words.append("the law of [controller], and not that of [arm.second_controller]")
    return f"{' and '.join(words)}; with all of [arm] and torsion: beamdesign arm" if words else ""


def lever_figures(prototype: Prototype) -> dict[str, float]:
    """`LEVER_FIGURES` of its plane; none where everything stands on the axis.

    Raises:
        InputError: as `arm_figures`, and where offsets to both sides couple this plane with the other.
    """
    plane = arm_of(prototype).plane
    if plane is None or not off_axis(prototype):
        return {}
    figures = plane_figures(prototype, plane)
    if figures.coupled and figures.along != 0:
        words = "offsets to both sides couple both planes, of which one alone is simulated and diagnosed here"
        raise InputError(prototype.name, [Problem("arm.offset_m", words)])
    parts = figures.travel, figures.along, figures.lever, figures.sensed_travel, figures.sensed_lever
    return dict(zip(LEVER_FIGURES, map(float, (*parts, *figures.twist)), strict=True))


def with_torsion(prototype: Prototype, values: Mapping[str, float]) -> Arm:
    """The prototype's [arm] with other figures of torsion in its plane, of those of `LEVER_FIGURES` that are given.

    Its dashpot, which goes with the root of the stiffness, is stated: it is no longer that of the beam's bending.
    """
    arm, nominal = arm_of(prototype), lever_figures(prototype)
    if not nominal:
        return arm
    dashpot = values.get("torsional_damping", nominal["torsional_damping"])
    ratio = dashpot / (2 * (nominal["torsional_stiffness"] * nominal["polar_inertia"]) ** 0.5)
    stiffness = values.get("torsional_stiffness", arm.torsional_stiffness_N_m_per_rad)
    return arm.but(torsional_stiffness_N_m_per_rad=stiffness, torsional_damping_ratio=ratio)


def in_plane(prototype: Prototype, name: Name | None = None) -> Prototype:
    """The prototype in one plane, its own unless one is named: in y with the second controller, where there is one."""
    arm = arm_of(prototype)
    there = (name or arm.plane) == "y" and arm.second_controller is not None
    return prototype.but(controller=arm.second_controller) if there else prototype
