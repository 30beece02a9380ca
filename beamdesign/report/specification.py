"""What a workshop and a controls engineer need to build a certified prototype and to accept it, as Markdown."""

import re
from math import pi, sqrt
from typing import NamedTuple

from beamdesign import beam, section
from beamdesign.lumped import lumped_beam
from beamdesign.materials import STRENGTH_SOURCE, material
from beamdesign.prototype import Beam, Prototype
from beamdesign.report.acceptance import acceptance
from beamdesign.report.foundations import proved_statements
from beamdesign.report.page_template import page_template
from beamdesign.report.quantity import decimal, mass_range_text, quantity, tube_text
from beamdesign.section import SquareTube
from beamdesign.spelling import in_markdown
from beamdesign.stock import stock_tubes
from beamdesign.study.design_run import DesignRun


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


def specification_markdown(run: DesignRun, files: dict[str, str]) -> str:
    """The specification of a design run that gave a certified prototype.

    Args:
        run: all of its steps done.
        files: names of the files beside the specification, by kind: "prototype" and "certificate" among them.

    Raises:
        ValueError: where the run has no result; its `reason` says why.
    """
    prototype, certificate = run.prototype, run.certificate
    if prototype is None or certificate is None or prototype.guarantee is None or prototype.controller is None:
        raise ValueError(f"nothing to specify: {run.reason or 'the run is not complete'}")
    force = run.problem.load.tip_force_N
    controller = prototype.controller
    text = (
        # Markdown, not HTML: `plain` escapes what a user has named
        page_template(
            __file__,
            "specification.md",
            html=False,
            quantity=quantity,
            decimal=decimal,
            mass_range=mass_range_text,
            plain=in_markdown,
        ).render(
            prototype=prototype,
            problem=run.problem,
            sizing=run.sizing,
            guarantee=prototype.guarantee,
            files=files,
            tubes=[tube_to_make(name, getattr(prototype, f"{name}_beam")) for name in ("outer", "inner")],
            strength_source=STRENGTH_SOURCE,
            gap_m=_gap_m(prototype),
            loads=held_loads(prototype, force),
            bore_m=sqrt(4 * prototype.actuator.piston_area_m2 / pi),
            load_pressure_Pa=force / prototype.actuator.piston_area_m2,
            controller=controller,
            controller_rows=controller.rows(),
            statements=proved_statements(certificate, prototype.goal.compliance_m_per_N),
            expected=acceptance(prototype),
        )
    )
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


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
    gap = _gap_m(prototype)

    def case(words: str, record: Beam) -> HeldLoad:
        stiffness = lumped_beam(record).stiffness
        return HeldLoad(words, tip_force_N / stiffness, float(beam.clearance_under_load(gap, tip_force_N, stiffness)))

    return (
        case("servo on: the inner beam bends, the outer one is held straight", prototype.inner_beam),
        case("servo off: the outer beam bends, the inner one is unloaded", prototype.outer_beam),
    )


def _gap_m(prototype: Prototype) -> float:
    outer, inner = prototype.outer_beam, prototype.inner_beam
    return float(section.clearance(outer.width_m, outer.wall_m, inner.width_m))
