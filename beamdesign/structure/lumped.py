"""Lumped figures of a prototype: measured where they stand, from the geometry otherwise."""

from dataclasses import dataclass
from typing import Any

from beamdesign.parameters import rows_of
from beamdesign.prototype import Beam, Prototype
from beamdesign.structure import beam, section
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
    rigidity = section.flexural_rigidity(alloy.youngs_modulus_Pa, tube.second_moment)
    per_length = tube.mass_per_length(alloy.density_kg_per_m3)
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
    outer = lumped_beam(prototype.outer_beam, "outer_beam")
    inner = lumped_beam(prototype.inner_beam, "inner_beam")
    beams = {
        "outer_stiffness": outer.stiffness,
        "outer_mass": outer.mass,
        "outer_damping": outer.damping,
        "inner_stiffness": inner.stiffness,
        "inner_mass": inner.mass,
        "inner_damping": inner.damping,
    }
    return beams | servo_figures(prototype)


def notes(prototype: Prototype) -> tuple[str, ...]:
    """Which measured figures have replaced computed ones, in words for a report."""
    outer = lumped_beam(prototype.outer_beam, "outer_beam")
    inner = lumped_beam(prototype.inner_beam, "inner_beam")
    return outer.notes + inner.notes
