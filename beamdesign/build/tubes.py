"""The tubes to make: what to cut and clamp, the nearest stock size with what it changes, and how a load bends them."""

from dataclasses import dataclass
from typing import NamedTuple

from beamdesign.proofs.certifying import guaranteed_by_all
from beamdesign.prototype import Beam, Prototype
from beamdesign.quantity_text import tube_text
from beamdesign.structure import beam, section
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.materials import material
from beamdesign.structure.section import SquareTube
from beamdesign.structure.stock import stock_tubes


class TubeToMake(NamedTuple):
    """One tube as the workshop sees it; lengths in m, masses in kg."""

    name: str
    size: str
    nearest_stock: str
    length_m: float
    free_length_m: float
    clamped_m: float
    material: str
    tube_mass_kg: float
    end_mass_kg: float


class HeldLoad(NamedTuple):
    """One load case: which beam bends, how far its tip moves, what is left of the gap; m."""

    case: str
    deflection_m: float
    gap_left_m: float


@dataclass(frozen=True)
class StockChoice:
    """One tube.

    Attributes:
        made: what to cut and clamp.
        stock: nearest stock tube that is no less stiff.
        same: whether the tube is that stock size.
        fits: whether the gap between the tubes stays positive with it.
        stiffness_N_per_m: of the tip as specified, and with the stock tube by its geometry.
        effective_mass_kg: likewise.
        tube_mass_kg: likewise.
        gap_m: play per side, likewise.
        stable: whether the loop with this tube exchanged is proved stable over the range; None where it is the same
            or does not fit.
        bandwidth_Hz, peak_sensitivity: proved with it; None where not stable.
    """

    made: TubeToMake
    stock: SquareTube
    same: bool
    fits: bool
    stiffness_N_per_m: tuple[float, float]
    effective_mass_kg: tuple[float, float]
    tube_mass_kg: tuple[float, float]
    gap_m: tuple[float, float]
    stable: bool | None
    bandwidth_Hz: float | None
    peak_sensitivity: float | None


def nearest_stock_tube(width_m: float, wall_m: float) -> SquareTube:
    """The stock tube of at least this wall and bending stiffness with the least area, or the stiffest of the list."""
    needed = section.second_moment(width_m, wall_m)
    enough = [
        tube
        for tube in stock_tubes()
        if tube.wall_m >= wall_m * (1 - 1e-9) and section.second_moment(*tube) >= needed * (1 - 1e-9)
    ]
    if enough:
        return min(enough, key=lambda tube: float(section.area(*tube)))
    return max(stock_tubes(), key=lambda tube: float(section.second_moment(*tube)))


def tube_to_make(name: str, record: Beam) -> TubeToMake:
    """What to cut and clamp.

    Raises:
        ValueError: where the beam has no geometry.
    """
    if record.width_m is None or record.wall_m is None or record.free_length_m is None or record.material is None:
        raise ValueError(f"the {name} beam has no geometry")
    length = record.length_m if record.length_m is not None else record.free_length_m
    nearest = nearest_stock_tube(record.width_m, record.wall_m)
    same = abs(nearest.width_m - record.width_m) < 1e-9 and abs(nearest.wall_m - record.wall_m) < 1e-9
    density = material(record.material).density_kg_per_m3
    return TubeToMake(
        name=name,
        size=tube_text(record.width_m, record.wall_m),
        nearest_stock="is a stock size" if same else tube_text(*nearest),
        length_m=length,
        free_length_m=record.free_length_m,
        clamped_m=length - record.free_length_m,
        material=record.material,
        tube_mass_kg=float(
            length * section.mass_per_length(record.width_m, record.wall_m, density, record.corner_radius_m)
        ),
        end_mass_kg=record.end_mass_kg,
    )


def held_loads(prototype: Prototype, tip_force_N: float) -> tuple[HeldLoad, HeldLoad]:
    """Static deflection and remaining gap with the servo on (inner beam bends) and off (outer beam bends)."""
    gap = _gap(prototype.outer_beam, prototype.inner_beam)

    def case(words: str, record: Beam) -> HeldLoad:
        stiffness = lumped_beam(record).stiffness
        return HeldLoad(words, tip_force_N / stiffness, float(beam.clearance_under_load(gap, tip_force_N, stiffness)))

    return (
        case("servo on: the inner beam bends, the outer one is held straight", prototype.inner_beam),
        case("servo off: the outer beam bends, the inner one is unloaded", prototype.outer_beam),
    )


def stock_choices(prototype: Prototype, masses_kg: tuple[float, float]) -> tuple[StockChoice, ...] | None:
    """Both tubes, or None where a beam has no geometry.

    With a stock tube its lumped figures are those of its geometry, whatever was measured on the tube it replaces.
    """
    if not (prototype.outer_beam.has_geometry and prototype.inner_beam.has_geometry):
        return None
    return tuple(_choice(prototype, name, masses_kg) for name in ("outer", "inner"))


def _choice(prototype: Prototype, name: str, masses_kg: tuple[float, float]) -> StockChoice:
    record = getattr(prototype, f"{name}_beam")
    stock = nearest_stock_tube(record.width_m, record.wall_m)
    same = abs(stock.width_m - record.width_m) < 1e-9 and abs(stock.wall_m - record.wall_m) < 1e-9
    other = record.but(
        width_m=stock.width_m, wall_m=stock.wall_m, corner_radius_m=0.0, stiffness_N_per_m=None, effective_mass_kg=None
    )
    beams = {"outer": prototype.outer_beam, "inner": prototype.inner_beam}
    before, after = _gap(**beams), _gap(**(beams | {name: other}))
    made, changed = tube_to_make(name, record), tube_to_make(name, other)
    stable = reached = None
    if not same and after > 0:
        reached = guaranteed_by_all(prototype.but(**{f"{name}_beam": other}, guarantee=None).stages(masses_kg))
        stable = reached is not None
    found, exchanged = lumped_beam(record), lumped_beam(other)
    return StockChoice(
        made,
        stock,
        same,
        after > 0,
        (found.stiffness, exchanged.stiffness),
        (found.mass, exchanged.mass),
        (made.tube_mass_kg, changed.tube_mass_kg),
        (before, after),
        stable,
        None if reached is None else reached.bandwidth_Hz,
        None if reached is None else reached.peak_sensitivity,
    )


def _gap(outer: Beam, inner: Beam) -> float:
    """Play per side at assembly, m."""
    return float(section.clearance(outer.width_m, outer.wall_m, inner.width_m))
