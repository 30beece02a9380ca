"""Lumped figures of a prototype: measured where they stand, from the geometry otherwise.

Those of the one tube that weighs as much as both its beams: what the same aluminium or steel does by itself. And the
prototype with some of its figures multiplied: a member of a box of tolerances.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import sqrt
from typing import Any

from beamdesign.parameters import PARAMETERS, rows_of
from beamdesign.prototype import Beam, Prototype
from beamdesign.structure import beam
from beamdesign.structure.materials import Material
from beamdesign.structure.section import Quantity, Tube


@dataclass(frozen=True)
class LumpedBeam:
    """One cantilever as mass, spring and fixed dashpot.

    Attributes:
        stiffness: K, N/m.
        mass: effective mass M of the bare beam, kg.
        damping: b = 2 zeta sqrt(K M), N s/m; it stays when end mass is added.
        notes: where a measured figure has replaced a computed one, in words.
    """

    stiffness: float
    mass: float
    damping: float
    notes: tuple[str, ...] = ()


def beam_figures(alloy: Material, tube: Tube, free_length: float, end_mass: Quantity) -> tuple[Quantity, Quantity]:
    """Tip stiffness (N/m) and effective mass (kg) that a section's geometry gives; numbers and symbols alike.

    Args:
        alloy: material of the tube.
        tube: its section, m.
        free_length: from clamp to tip, m.
        end_mass: M_end of equation (5), kg.
    """
    rigidity, per_length = alloy.youngs_modulus_Pa * tube.second_moment, tube.mass_per_length(alloy.density_kg_per_m3)
    return beam.tip_stiffness(rigidity, free_length), beam.effective_mass(per_length, free_length, end_mass)


def fixed_dashpot(damping_ratio: Quantity, stiffness: Quantity, mass: Quantity) -> Quantity:
    """The damping b = 2 zeta sqrt(K M) of the bare beam, N s/m, which stays when end mass is added."""
    return 2 * damping_ratio * (stiffness * mass) ** 0.5


def lumped_beam(record: Beam, name: str = "beam") -> LumpedBeam:
    """Lump one beam; a measured figure wins over the one its geometry gives."""
    stiffness, mass = record.stiffness_N_per_m, record.effective_mass_kg
    notes: list[str] = []
    tube = record.tube
    if tube is not None and record.free_length_m is not None and record.material:
        computed_stiffness, computed_mass = map(
            float, beam_figures(record.material, tube, record.free_length_m, record.end_mass_kg)
        )
        if stiffness is not None:
            notes.append(
                f"{name}: measured stiffness {stiffness:.6g} N/m used, geometry gives {computed_stiffness:.6g} N/m"
            )
        if mass is not None:
            notes.append(f"{name}: measured effective mass {mass:.4g} kg used, geometry gives {computed_mass:.4g} kg")
        stiffness = computed_stiffness if stiffness is None else stiffness
        mass = computed_mass if mass is None else mass
    if stiffness is None or mass is None:  # a Beam record is validated to have one or the other
        raise ValueError(f"{name} has neither lumped figures nor geometry")
    return LumpedBeam(stiffness, mass, fixed_dashpot(record.damping_ratio, stiffness, mass), tuple(notes))


def weighing_mass(record: Beam) -> float:
    """Mass, kg, whose weight at the tip bends a beam as its own weight and that of its end mass do; equation (6).

    Of a beam that is held straight at its tip, that weight is what holds it. Without a geometry it is the effective
    mass, which counts 0.236 of the tube where its weight counts 3/8.
    """
    tube = record.tube
    if tube is None or record.free_length_m is None or not record.material:
        return lumped_beam(record).mass
    per_length = tube.mass_per_length(record.material.density_kg_per_m3)
    return float(beam.effective_mass(per_length, record.free_length_m, record.end_mass_kg, "static"))


def servo_figures(rig: Any) -> dict[str, float]:
    """Figures of everything but the beams and end masses, named and ordered as in `beamdesign.parameters.rows_of`.

    Args:
        rig: a prototype, or a study with the same tables.
    """
    return {
        row.name: row.factor * (row.stated(rig) or 0.0)
        for row in rows_of(type(rig.actuator)).values()
        if row.place.partition(".")[0] in ("actuator", "servovalve", "sensor")
    }


def figures(prototype: Prototype) -> dict[str, float]:
    """Figures of the linear model, in the order of `beamdesign.parameters.rows_of` less the end masses.

    SI units, frequencies in rad/s. Without a sensor filter its frequency is 0 and unused.
    """
    outer, inner = lumped_beam(prototype.outer_beam, "outer_beam"), lumped_beam(prototype.inner_beam, "inner_beam")
    beams = {
        f"{name}_{figure}": getattr(found, figure)
        for name, found in (("outer", outer), ("inner", inner))
        for figure in ("stiffness", "mass", "damping")
    }
    return beams | servo_figures(prototype)


def notes(prototype: Prototype) -> tuple[str, ...]:
    """Which measured figures have replaced computed ones, in words for a report."""
    return lumped_beam(prototype.outer_beam, "outer_beam").notes + lumped_beam(prototype.inner_beam, "inner_beam").notes


@dataclass(frozen=True)
class EqualMassBeam(LumpedBeam):
    """A passive cantilever like the outer beam: its outside, material, free length, damping ratio and end mass.

    Its mass is with that end mass, and all is by the same lumped formulas as of any beam.

    Attributes:
        wall_m: so thick that the tube weighs as much as the free lengths of both tubes; half its narrower side
            where even the solid bar is lighter.
        solid: whether it is that bar.
    """

    wall_m: float = field(kw_only=True)
    solid: bool = field(kw_only=True)


def beam_of_equal_mass(outer: Beam, inner: Beam) -> EqualMassBeam | None:
    """The passive beam of a rig; None where one of its beams states no section."""
    from scipy.optimize import brentq

    tubes = [_tube_mass(one) for one in (outer, inner) if one.has_geometry]
    tube = outer.tube
    if tube is None or outer.free_length_m is None or not outer.material or len(tubes) < 2:
        return None
    alloy, length = outer.material, outer.free_length_m

    def weighs(wall: float) -> float:
        return float(tube.at(tube.width_m, wall).mass_per_length(alloy.density_kg_per_m3)) * length

    wall = min(tube.sides.values()) / 2
    if not (solid := weighs(wall) <= sum(tubes)):
        wall = brentq(lambda wall: weighs(wall) - sum(tubes), 0.0, wall, xtol=1e-15)
    stiffness, mass = map(float, beam_figures(alloy, tube.at(tube.width_m, wall), length, outer.end_mass_kg))
    damping = float(fixed_dashpot(outer.damping_ratio, stiffness, mass))
    return EqualMassBeam(stiffness, mass, damping, wall_m=wall, solid=solid)


def _tube_mass(beam: Beam) -> float:
    """Mass of a tube that has a geometry, on its free length, kg."""
    assert beam.tube is not None
    assert beam.free_length_m is not None
    assert beam.material is not None
    return float(beam.tube.mass_per_length(beam.material.density_kg_per_m3)) * beam.free_length_m


_PARTS = {name: row.place for name, row in PARAMETERS.items() if "_beam." not in row.place and name != "outer_end_mass"}
_PARTS |= {
    "controller_gain": "controller.gain_A_per_V",
    "controller_pole": "controller.pole_Hz",
    "controller_zero": "controller.zero_Hz",
}
CHANGEABLE = (*(name for name, row in PARAMETERS.items() if "_beam." in row.place), *_PARTS)
"""Figures that can be changed, named as in `beamdesign.proofs.rig_family.rig_values`."""


def with_figures(prototype: Prototype, factors: Mapping[str, float]) -> Prototype:
    """Multiply figures; those that are not named keep their values, a dashpot too when its beam's stiffness changes.

    Raises:
        KeyError: for a name that is not in `CHANGEABLE`.
    """
    if unknown := sorted(set(factors) - set(CHANGEABLE)):
        raise KeyError(f"cannot change {', '.join(unknown)}")
    changed: dict[str, Any] = {"guarantee": None}
    for name in ("outer", "inner"):
        changed[f"{name}_beam"] = _beam(
            getattr(prototype, f"{name}_beam"),
            *(factors.get(f"{name}_{figure}", 1.0) for figure in ("stiffness", "mass", "damping")),
        )
    for name, place in _PARTS.items():
        if name in factors:
            part, key = place.split(".")
            record = changed.get(part, getattr(prototype, part))
            changed[part] = record.but(**{key: _short(getattr(record, key) * factors[name])})
    return prototype.but(**changed)


def _beam(record: Beam, stiffness: float, mass: float, damping: float) -> Beam:
    if stiffness == mass == damping == 1.0:
        return record
    found = lumped_beam(record)
    return record.but(
        stiffness_N_per_m=_short(found.stiffness * stiffness),
        effective_mass_kg=_short(found.mass * mass),
        damping_ratio=_short(record.damping_ratio * damping / sqrt(stiffness * mass)),
    )


def _short(value: float) -> float:
    """To ten digits: exact arithmetic on figures with all digits of a float takes several times as long."""
    return float(f"{value:.10g}")
