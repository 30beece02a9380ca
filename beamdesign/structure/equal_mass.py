"""The one tube that weighs as much as both beams of a rig: what the same aluminium or steel does by itself."""

from dataclasses import dataclass

from beamdesign.prototype import Beam
from beamdesign.structure.lumped import beam_figures, fixed_dashpot

_HALVINGS = 60


@dataclass(frozen=True)
class EqualMassBeam:
    """A passive cantilever like the outer beam: its outside, material, free length, damping ratio and end mass.

    Attributes:
        wall_m: so thick that the tube weighs as much as the free lengths of both tubes; half its narrower side
            where even the solid bar is lighter.
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
    tube = outer.tube
    if tube is None or outer.free_length_m is None or not outer.material or len(tubes) < 2:
        return None
    alloy, length = outer.material, outer.free_length_m

    def weighs(wall: float) -> float:
        return float(tube.at(tube.width_m, wall).mass_per_length(alloy.density_kg_per_m3)) * length

    low, high = 0.0, min(tube.sides.values()) / 2
    solid = weighs(high) <= sum(tubes)
    for _ in range(0 if solid else _HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if weighs(middle) < sum(tubes) else (low, middle)
    stiffness, mass = map(float, beam_figures(alloy, tube.at(tube.width_m, high), length, outer.end_mass_kg))
    return EqualMassBeam(high, solid, stiffness, mass, float(fixed_dashpot(outer.damping_ratio, stiffness, mass)))


def _tube_mass(beam: Beam) -> float:
    """Mass of a tube that has a geometry, on its free length, kg."""
    assert beam.tube is not None
    assert beam.free_length_m is not None
    assert beam.material is not None
    return float(beam.tube.mass_per_length(beam.material.density_kg_per_m3)) * beam.free_length_m
