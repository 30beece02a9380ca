"""The cantilever, and a prototype's beams as lumped figures: measured where they stand, from the geometry otherwise.

Tip stiffness, effective mass, natural frequencies, what deflection leaves of a clearance. Equation numbers are those of
Zalucky and Hardt, "Active Control of Robot Structure Deflections", J. Dyn. Sys., Meas., Control 106 (1984). Lengths are
free lengths, from the clamp to the tip: what is clamped in the base neither bends nor moves, so it adds nothing to
compliance or to effective mass. The closed forms work on floats, numpy arrays and CasADi symbols.

Then the one tube that weighs as much as both beams: what the same aluminium or steel does by itself. And the prototype
with some of its figures multiplied: a member of a box of tolerances.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, exp, pi, sin, sqrt, tanh
from typing import Any, Literal

from pydantic import ValidationError

from beamdesign.parameters import PARAMETERS, rows_of
from beamdesign.prototype import Beam, Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure.materials import BEAMS, Material
from beamdesign.structure.section import Quantity, Tube

MODE_MASS_FRACTION = 0.236
"""Share of a uniform beam's mass that moves with its tip, equations (2) and (5).

It is 33/140 rounded: the kinetic energy of the static tip-load shape (Rayleigh), in which Y enters squared. It makes
(2) too high by 1.4 % with no end mass, and better the heavier the end mass is.
"""

STATIC_MASS_FRACTION = 0.375
"""Equation (6): 3/8, equation (1) with the static tip-load shape, in which Y enters once (force, not energy)."""


def static_shape(position: Quantity) -> Quantity:
    """Deflection of a cantilever under a tip force relative to its tip's, Y(x) / Y_end, at x / L in 0..1."""
    return position**2 * (3 - position) / 2


def tip_stiffness(flexural_rigidity: Quantity, free_length: Quantity) -> Quantity:
    """Force per deflection at the tip, K = 3 E I / L^3, equation (3).

    Args:
        flexural_rigidity: E I, N m2.
        free_length: L from the clamp to the tip, m.

    Returns:
        Stiffness, N/m.
    """
    return 3 * flexural_rigidity / free_length**3


def effective_mass(
    mass_per_length: Quantity,
    free_length: Quantity,
    end_mass: Quantity = 0.0,
    shape: Literal["mode", "static"] = "mode",
) -> Quantity:
    """Mass that, lumped at the tip, stands for a uniform beam and what is fixed to its end.

    Args:
        mass_per_length: m, kg/m.
        free_length: L from the clamp to the tip, m.
        end_mass: M_end, kg.
        shape: "mode" for equation (5), right at the first natural frequency and the one the paper uses; "static" for
            equation (6), right well below it.

    Returns:
        M_eff, kg.
    """
    fraction = MODE_MASS_FRACTION if shape == "mode" else STATIC_MASS_FRACTION
    return end_mass + fraction * mass_per_length * free_length


def first_frequency(
    flexural_rigidity: Quantity, mass_per_length: Quantity, free_length: Quantity, end_mass: Quantity = 0.0
) -> Quantity:
    """First natural frequency by equation (2), without the minus sign that is printed before it.

    Args:
        flexural_rigidity: E I, N m2.
        mass_per_length: m, kg/m.
        free_length: L, m.
        end_mass: M_end, kg.

    Returns:
        f_n, Hz.
    """
    stiffness = tip_stiffness(flexural_rigidity, free_length)
    return (stiffness / effective_mass(mass_per_length, free_length, end_mass)) ** 0.5 / (2 * pi)


def natural_frequencies(
    flexural_rigidity: float, mass_per_length: float, free_length: float, end_mass: float = 0.0, count: int = 3
) -> list[float]:
    """Natural frequencies of the uniform cantilever with a point mass at its tip, without lumping.

    The wave numbers k solve 1 + cos kL cosh kL + mu kL (cos kL sinh kL - sin kL cosh kL) = 0 with mu = M_end / (m L)
    (Euler and Bernoulli's beam; e.g. R. D. Blevins, Formulas for Natural Frequency and Mode Shape, 1979, chapter 8).

    Args:
        flexural_rigidity: E I, N m2.
        mass_per_length: m, kg/m.
        free_length: L, m.
        end_mass: M_end, kg, without rotary inertia.
        count: how many, from the lowest.

    Returns:
        Frequencies, Hz, ascending.
    """
    from scipy.optimize import brentq

    ratio = end_mass / (mass_per_length * free_length)

    def characteristic(wave: float) -> float:
        # Divided by cosh, so that high modes do not overflow.
        secant = 2 * exp(-wave) / (1 + exp(-2 * wave))
        return secant + cos(wave) + ratio * wave * (cos(wave) * tanh(wave) - sin(wave))

    # A tip mass moves the n-th root from its free-tip value down towards the pinned-tip one, and the two families
    # interlace: root n lies between (n - 1) pi and n pi. The first tends to zero with a large mass.
    roots = [brentq(characteristic, max(n * pi, 1e-9), (n + 1) * pi, xtol=1e-12) for n in range(count)]
    scale = (flexural_rigidity / mass_per_length) ** 0.5 / (2 * pi * free_length**2)
    return [float(root**2 * scale) for root in roots]


def clearance_under_load(clearance: Quantity, tip_force: Quantity, inner_stiffness: Quantity) -> Quantity:
    """Gap left when the servo holds the outer beam straight and the inner one bends under the whole load.

    Args:
        clearance: gap per side at assembly, m.
        tip_force: F, N.
        inner_stiffness: K_f, N/m.

    Returns:
        clearance - F / K_f, m; negative where the beams touch. The tip is where the deflection is largest.
    """
    return clearance - tip_force / inner_stiffness


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
    return tip_stiffness(rigidity, free_length), effective_mass(per_length, free_length, end_mass)


def fixed_dashpot(damping_ratio: Quantity, stiffness: Quantity, mass: Quantity) -> Quantity:
    """The damping b = 2 zeta sqrt(K M) of the bare beam, N s/m, which stays when end mass is added."""
    return 2 * damping_ratio * (stiffness * mass) ** 0.5


def lumped_beam(record: Beam, name: str = "beam") -> LumpedBeam:
    """Lump one beam; a measured figure wins over the one its geometry gives."""
    stiffness, mass = record.stiffness_N_per_m, record.effective_mass_kg
    notes: list[str] = []
    if record.geometry is not None:
        stiff, heavy = map(float, beam_figures(*record.geometry, record.end_mass_kg))
        if stiffness is not None:
            notes.append(f"{name}: measured stiffness {stiffness:.6g} N/m used, geometry gives {stiff:.6g} N/m")
        if mass is not None:
            notes.append(f"{name}: measured effective mass {mass:.4g} kg used, geometry gives {heavy:.4g} kg")
        stiffness, mass = stiff if stiffness is None else stiffness, heavy if mass is None else mass
    if stiffness is None or mass is None:  # a Beam record is validated to have one or the other
        raise ValueError(f"{name} has neither lumped figures nor geometry")
    return LumpedBeam(stiffness, mass, fixed_dashpot(record.damping_ratio, stiffness, mass), tuple(notes))


def unstated(prototype: Prototype, keys: Sequence[str]) -> list[str]:
    """Of some keys of both beams those that a prototype does not state."""
    return [f"{name}.{key}" for name in BEAMS for key in keys if getattr(getattr(prototype, name), key) is None]


def weighing_mass(record: Beam) -> float:
    """Mass, kg, whose weight at the tip bends a beam as its own weight and that of its end mass do; equation (6).

    Of a beam that is held straight at its tip, that weight is what holds it. Without a geometry it is the effective
    mass, which counts 0.236 of the tube where its weight counts 3/8.
    """
    if record.geometry is None:
        return lumped_beam(record).mass
    alloy, tube, length = record.geometry
    return float(effective_mass(tube.mass_per_length(alloy.density_kg_per_m3), length, record.end_mass_kg, "static"))


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
    """Which measured figures have replaced computed ones, and where shear softens a beam, in words for a report."""
    beams = {name: getattr(prototype, name) for name in BEAMS}
    measured = (note for name, beam in beams.items() for note in lumped_beam(beam, name).notes)
    least = 2 * (prototype.tolerance.stiffness or PARAMETERS["outer_stiffness"].typical)
    return (*measured, *(note for name, beam in beams.items() if (note := _sheared(beam, name, least))))


def _sheared(record: Beam, name: str, least: float) -> str:
    """That shear softens a beam by no less than a share of the stiffness that its geometry gives; empty where not.

    A tip force F moves the tip by F L^3 / 3 E I, and by F L / G A_s beside (S. P. Timoshenko, Strength of Materials).
    """
    if record.geometry is None or record.stiffness_N_per_m is not None:
        return ""
    material, tube, length = record.geometry
    sheared = material.shear_modulus_Pa * tube.shear_area * length**2
    lost = 1 / (1 + sheared / (3 * material.youngs_modulus_Pa * tube.second_moment))
    return (
        f"{name}: shear, which its stiffness of 3 E I / L^3 does not count, makes it {100 * lost:.2g} % softer, which"
        " is beyond its tolerance; state a measured stiffness"
        if lost > least
        else ""
    )


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

    if outer.geometry is None or inner.geometry is None:
        return None
    alloy, tube, length = outer.geometry
    both = _tube_mass(*outer.geometry) + _tube_mass(*inner.geometry)

    def excess(wall: float) -> float:
        return _tube_mass(alloy, tube.at(tube.width_m, wall), length) - both

    wall = min(tube.sides.values()) / 2
    if not (solid := excess(wall) <= 0):
        wall = brentq(excess, 0.0, wall, xtol=1e-15)
    stiffness, mass = map(float, beam_figures(alloy, tube.at(tube.width_m, wall), length, outer.end_mass_kg))
    damping = float(fixed_dashpot(outer.damping_ratio, stiffness, mass))
    return EqualMassBeam(stiffness, mass, damping, wall_m=wall, solid=solid)


def _tube_mass(alloy: Material, tube: Tube, length: float) -> float:
    """Mass of a tube on its free length, kg."""
    return float(tube.mass_per_length(alloy.density_kg_per_m3)) * length


_PARTS = {name: row.place for name, row in PARAMETERS.items() if "_beam." not in row.place and name != "outer_end_mass"}
_LAW = {"gain": "gain_A_per_V", "pole": "pole_Hz", "zero": "zero_Hz"}
_PARTS |= {f"controller_{name}": f"controller.{key}" for name, key in _LAW.items()}
CHANGEABLE = (*(name for name, row in PARAMETERS.items() if "_beam." in row.place), *_PARTS)
"""Figures that can be changed, named as in `beamdesign.proofs.rig_family.rig_values`."""


def with_figures(prototype: Prototype, factors: Mapping[str, float]) -> Prototype:
    """Multiply figures; those that are not named keep their values, a dashpot too when its beam's stiffness changes.

    Raises:
        KeyError: for a name that is not in `CHANGEABLE`.
        InputError: where a figure is plausible no more.
    """
    if unknown := sorted(set(factors) - set(CHANGEABLE)):
        raise KeyError(f"cannot change {', '.join(unknown)}")
    changed: dict[str, Any] = {"guarantee": None}
    for name in ("outer", "inner"):
        place = f"{name}_beam"
        own = (factors.get(f"{name}_{figure}", 1.0) for figure in ("stiffness", "mass", "damping"))
        changed[place] = _beam(getattr(prototype, place), place, *own)
    for name, place in _PARTS.items():
        if name in factors:
            part, key = place.split(".")
            record = changed.get(part, getattr(prototype, part))
            changed[part] = _off(record, part, **{key: _short(getattr(record, key) * factors[name])})
    return prototype.but(**changed)


def _off(record: Any, place: str, **figures: float) -> Any:
    """A record with figures that are off."""
    try:
        return record.but(**figures)
    except ValidationError as error:
        keys = sorted({str(line["loc"][0]) for line in error.errors()} & figures.keys())
        reason = "{:g} of a rig that is off by its tolerances is outside the plausible range: let it vary less"
        wrong = [Problem(f"{place}.{key}", reason.format(figures[key])) for key in keys]
        raise InputError("tolerance", wrong) from None


def _beam(record: Beam, place: str, stiffness: float, mass: float, damping: float) -> Beam:
    if stiffness == mass == damping == 1.0:
        return record
    found = lumped_beam(record)
    damped = _short(record.damping_ratio * damping / sqrt(stiffness * mass))
    stiff, heavy = _short(found.stiffness * stiffness), _short(found.mass * mass)
    return _off(record, place, stiffness_N_per_m=stiff, effective_mass_kg=heavy, damping_ratio=damped)


def _short(value: float) -> float:
    """To ten digits: exact arithmetic on figures with all digits of a float takes several times as long."""
    return float(f"{value:.10g}")
