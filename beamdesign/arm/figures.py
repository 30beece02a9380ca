"""Figures of the outer beam that only the arm needs: rigidities and inertia about its axis."""

from dataclasses import dataclass

from beamdesign import lumped, section
from beamdesign.materials import material
from beamdesign.prototype import Arm, Prototype
from beamdesign.records import InputError, Problem

TORSION_SHARE = 1 / 3
"""Of the tube's polar inertia that turns with its end: the kinetic energy of a twist that grows evenly (Rayleigh)."""


@dataclass(frozen=True)
class ArmFigures:
    """The outer beam beyond its bending in one plane, SI.

    Attributes:
        length: L, from clamp to tip, m.
        stiffness: K in either plane, N/m; the tube is square.
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
        InputError: where length, torsional stiffness or polar inertia can neither be read nor worked out.
    """
    beam, arm = prototype.outer_beam, arm_of(prototype)
    wrong: list[Problem] = []
    if beam.free_length_m is None:
        wrong.append(Problem("outer_beam.free_length_m", "missing; turning of the tip needs it"))
    given = arm.torsional_stiffness_N_m_per_rad
    if given is None and not beam.has_geometry:
        reason = "missing; give it, or width_m, wall_m, free_length_m and material of the outer beam"
        wrong.append(Problem("arm.torsional_stiffness_N_m_per_rad", reason))
    added = arm.end_polar_inertia_kg_m2 + arm.payload_polar_inertia_kg_m2
    if added == 0 and not beam.has_geometry:
        reason = "missing; give it, or width_m, wall_m, free_length_m and material of the outer beam"
        wrong.append(Problem("arm.end_polar_inertia_kg_m2", reason))
    if wrong:
        raise InputError(prototype.name, wrong)

    length = beam.free_length_m
    assert length is not None  # else it was wrong
    one = lumped.lumped_beam(beam, "outer_beam")
    notes: list[str] = []
    inertia, axial = added, None
    stiffness = given
    if beam.width_m is not None and beam.wall_m is not None and beam.material is not None:
        alloy, tube = material(beam.material), (beam.width_m, beam.wall_m, beam.corner_radius_m)
        # The polar second moment of a square tube is twice that about one axis.
        inertia += TORSION_SHARE * alloy.density_kg_per_m3 * 2 * float(section.second_moment(*tube)) * length
        axial = alloy.youngs_modulus_Pa * float(section.area(*tube)) / length
        computed = alloy.shear_modulus_Pa * float(section.torsion_constant(*tube)) / length
        if given is not None:
            notes.append(
                f"given torsional stiffness {given:.6g} N m/rad used, the section gives {computed:.6g} N m/rad"
            )
        else:
            stiffness = computed
            notes.append(f"torsional stiffness {computed:.6g} N m/rad worked out from the section (G J / L)")
    else:
        notes.append("no section: the tube's own polar inertia and its axial compliance are left out")
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
        notes=tuple(notes),
    )
