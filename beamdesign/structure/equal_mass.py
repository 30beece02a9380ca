"""The one square tube that weighs as much as both beams of a rig: what the same aluminium or steel does by itself."""

from dataclasses import dataclass

from beamdesign.prototype import Beam
from beamdesign.structure import section
from beamdesign.structure.lumped import beam_figures, fixed_dashpot

_HALVINGS = 60


@dataclass(frozen=True)
class EqualMassBeam:
    """A passive cantilever of the outer beam's width, corners, material, free length, damping ratio and end mass.

    Attributes:
        wall_m: so thick that the tube weighs as much as the free lengths of both tubes; half the width where even the
            solid bar is lighter.
        solid: whether it is that bar.
        stiffness: K, N/m.
        mass: M with the end mass, kg.
        damping: b = 2 zeta sqrt(K M), N s/m, by the same lumped formulas as of any beam.
    """

    wall_m: float
    solid: bool
    stiffness: float
    mass: float
    damping: float


def beam_of_equal_mass(outer: Beam, inner: Beam) -> EqualMassBeam | None:
    """The passive beam of a rig; None where one of its beams states no section."""
    tubes = [_tube_mass(one) for one in (outer, inner) if one.has_geometry]
    if outer.width_m is None or outer.free_length_m is None or not outer.material or len(tubes) < 2:
        return None
    alloy, width, radius, length = outer.material, outer.width_m, outer.corner_radius_m, outer.free_length_m

    def weighs(wall: float) -> float:
        return float(section.mass_per_length(width, wall, alloy.density_kg_per_m3, radius)) * length

    low, high = 0.0, width / 2
    solid = weighs(high) <= sum(tubes)
    for _ in range(0 if solid else _HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if weighs(middle) < sum(tubes) else (low, middle)
    stiffness, mass = map(float, beam_figures(alloy, width, high, radius, length, outer.end_mass_kg))
    return EqualMassBeam(high, solid, stiffness, mass, float(fixed_dashpot(outer.damping_ratio, stiffness, mass)))


def _tube_mass(beam: Beam) -> float:
    """Mass of a tube that has a geometry, on its free length, kg."""
    assert beam.width_m is not None
    assert beam.wall_m is not None
    assert beam.free_length_m is not None
    assert beam.material is not None
    density = beam.material.density_kg_per_m3
    return float(section.mass_per_length(beam.width_m, beam.wall_m, density, beam.corner_radius_m)) * beam.free_length_m
