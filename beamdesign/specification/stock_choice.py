"""The nearest stock size of each tube, and what changes when it is used."""

from dataclasses import dataclass

from beamdesign import section
from beamdesign.lumped import lumped_beam
from beamdesign.proof.certifying import guaranteed_by_all
from beamdesign.prototype import Prototype
from beamdesign.report.specification import TubeToMake, nearest_stock_tube, tube_to_make
from beamdesign.section import SquareTube


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
    before, after = _gap(beams), _gap(beams | {name: other})
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


def _gap(beams: dict) -> float:
    outer, inner = beams["outer"], beams["inner"]
    return float(section.clearance(outer.width_m, outer.wall_m, inner.width_m))
