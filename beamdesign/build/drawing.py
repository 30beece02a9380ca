"""The dimensioned drawing as DXF, and the same drawing as SVG: lengthwise section with clamps, and cross-section."""

import random
import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from typing import TYPE_CHECKING, Any

from beamdesign.prototype import Prototype
from beamdesign.quantities import tube_text
from beamdesign.report.canvas import svg_element
from beamdesign.report.drawing import Drawn, gap_text, tubes_of
from beamdesign.spelling import in_dxf
from beamdesign.structure.lumped import unstated
from beamdesign.structure.section import at_corners

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts import Modelspace

LAYERS = {
    "OUTER_TUBE": (5, 50), "INNER_TUBE": (3, 50), "BASE": (8, 35), "HATCH": (8, 13), "JOINT": (1, 35),
    "CENTRE": (1, 18), "DIMENSIONS": (7, 18), "TEXT": (7, 25),
}  # fmt: skip
"""Layer, its colour index and its line weight in hundredths of a millimetre."""

_STYLE = "BEAMDESIGN"
_DRAWN_MM = 210.0
"""Length of the longest tube on the paper that text and arrows are sized for."""
_PAGE_MM = 400.0
"""Width of the picture, whose height follows."""


def missing_geometry(prototype: Prototype) -> str:
    """Why there is no drawing, in words; empty where the geometry of both beams is given."""
    if not (lacking := unstated(prototype, ("width_m", "wall_m", "free_length_m", "material"))):
        return ""
    one = prototype.outer_beam.geometry or prototype.inner_beam.geometry
    given = "the geometry of one beam" if one else "lumped figures"
    return f"the prototype gives {given} only; missing for a drawing: {', '.join(lacking)}"


@contextmanager
def _reproducible() -> Iterator[None]:
    """Without the clock, and without the chance that ezdxf shifts hatches by: one prototype, the same bytes."""
    import ezdxf

    chance, clock = random.getstate(), ezdxf.options.write_fixed_meta_data_for_testing
    random.seed(0)
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        yield
    finally:
        random.setstate(chance)
        ezdxf.options.write_fixed_meta_data_for_testing = clock


@_reproducible()
def drawing(prototype: Prototype) -> "Drawing":
    """The drawing in millimetres at full size; text and arrows are sized for plotting it to fit a sheet of A3.

    Model space holds the lengthwise section, the tips at x = 0, and the cross-section to its right. Every dimension is
    a DIMENSION entity that measures the geometry.

    Raises:
        ValueError: where a beam has no geometry.
    """
    import ezdxf
    from ezdxf import units

    if reason := missing_geometry(prototype):
        raise ValueError(reason)
    outer, inner = tubes_of(prototype)
    document = ezdxf.new("R2010", setup=True)
    document.units = units.MM
    for name, (colour, weight) in LAYERS.items():
        document.layers.add(name, color=colour, lineweight=weight)
    document.layers.get("CENTRE").dxf.linetype = "CENTER"
    scale = max(-outer.back, -inner.back) / _DRAWN_MM
    style = document.dimstyles.duplicate_entry("EZDXF", _STYLE)
    style.set_arrows(blk="")
    for key, value in {
        "dimscale": scale, "dimtxt": 3.0, "dimasz": 2.5, "dimtsz": 0.0, "dimexo": 1.0, "dimexe": 1.0, "dimgap": 1.2,
        "dimdec": 2, "dimzin": 8, "dimlfac": 1.0, "dimtad": 1, "dimdsep": ord("."),
    }.items():  # fmt: skip
        style.dxf.set(key, value)
    space = document.modelspace()
    _lengthwise(space, outer, inner, scale)
    _across(space, outer, inner, scale)
    _words(space, prototype, outer, inner, scale)
    return document


@_reproducible()
def dxf_text(document: "Drawing") -> str:
    """The drawing as a DXF file.

    Raises:
        ValueError: where ezdxf's auditor finds an error in it.
    """
    auditor = document.audit()
    if auditor.errors:
        raise ValueError("; ".join(error.message for error in auditor.errors))
    for name in sorted(document.entitydb.dxf_types_in_use()):  # which ezdxf itself would take in the order of a set
        document.classes.add_class(name)
    stream = StringIO()
    document.write(stream)
    return stream.getvalue()


@_reproducible()
def svg_text(document: "Drawing", description: str) -> str:
    """The same drawing as an SVG element; its lines follow the page's ink."""
    from ezdxf.addons.drawing import Frontend, RenderContext, layout
    from ezdxf.addons.drawing.config import BackgroundPolicy, ColorPolicy, Configuration
    from ezdxf.addons.drawing.svg import SVGBackend

    backend = SVGBackend()
    config = Configuration(
        background_policy=BackgroundPolicy.OFF, color_policy=ColorPolicy.BLACK, lineweight_scaling=0.5
    )
    Frontend(RenderContext(document), backend, config=config).draw_layout(document.modelspace())
    drawn, margin = backend.player().bbox(), 4.0
    page = layout.Page(_PAGE_MM, 0, layout.Units.mm, layout.Margins.all(margin))
    text = backend.get_string(page, settings=layout.Settings(scale=(_PAGE_MM - 2 * margin) / drawn.size.x))
    text = re.sub(r"\bC(\d+)\b(?=[ \"{])", r"drawing-\1", text)
    return svg_element(text.replace("#000000", "var(--ink, #000)"), description)


def _box(
    space: "Modelspace", layer: str, x: tuple[float, float], y: tuple[float, float], hatched: float | None = None
) -> None:
    corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
    space.add_lwpolyline(corners, close=True, dxfattribs={"layer": layer})
    if hatched is not None:
        hatch = space.add_hatch(dxfattribs={"layer": "HATCH"})
        hatch.set_pattern_fill("ANSI31", scale=hatched)
        hatch.paths.add_polyline_path(corners, is_closed=True)


def _dimension(
    space: "Modelspace",
    start: tuple[float, float],
    end: tuple[float, float],
    at: tuple[float, float],
    angle: float = 0.0,
    text: str = "<>",
    text_at: tuple[float, float] | None = None,
) -> None:
    """A dimension that measures from `start` to `end`, its line through `at`; `text_at` places its text, horizontal."""
    beside = {} if text_at is None else {"dimtad": 0, "dimtih": 1, "dimtoh": 1}
    made = space.add_linear_dim(
        at, start, end, angle=angle, text=text, dimstyle=_STYLE, override=beside, dxfattribs={"layer": "DIMENSIONS"}
    )
    if text_at is not None:
        made.set_location(text_at)
    made.render()


def _lengthwise(space: "Modelspace", outer: Drawn, inner: Drawn, scale: float) -> None:
    """Both tubes cut along their axis, the base around the outer one, the plug around the inner one, the tip joint."""
    half, inside = outer.depth / 2, inner.depth / 2
    for layer, tube in (("OUTER_TUBE", outer), ("INNER_TUBE", inner)):
        for side in (-1, 1):
            _box(space, layer, (tube.back, 0.0), (side * tube.depth / 2, side * (tube.depth / 2 - tube.wall)))
    thick = 0.25 * outer.depth
    blocks = [((outer.back, -outer.free), half, half + thick), ((inner.back, -inner.free), inside, half - outer.wall)]
    for x, low, high in blocks:
        for side in (-1, 1):
            _box(space, "BASE", x, (side * low, side * high), hatched=0.8 * scale)
    back = min(outer.back, inner.back)
    space.add_line((back - 8 * scale, 0), (14 * scale, 0), dxfattribs={"layer": "CENTRE"})
    # The joint: a cylinder between the inner tip and the outer one, as a symbol.
    reach = min(0.35 * inner.depth, 12 * scale)
    _box(space, "JOINT", (-reach, 0.0), (inside, half - outer.wall))
    _box(space, "JOINT", (-reach, 0.0), (-half + outer.wall, -inside))
    space.add_line((0, -half - thick), (0, half + thick), dxfattribs={"layer": "CENTRE"})
    low, step = -half - thick, 9 * scale
    _dimension(space, (-inner.free, -inside), (0, -inside), (0, low - step), text="inner, free <>")
    _dimension(space, (-outer.free, -half), (0, -half), (0, low - 2 * step), text="outer, free <>")
    if outer.cut is not None:
        _clamp(space, outer, -half, low - 2 * step, scale)
        _dimension(space, (outer.back, -half), (0, -half), (0, low - 3 * step), text="outer, cut <>")
    high = half + thick
    if inner.cut is not None:
        _clamp(space, inner, inside, high + step, scale)
        _dimension(space, (inner.back, inside), (0, inside), (0, high + 2 * step), text="inner, cut <>")


def _clamp(space: "Modelspace", tube: Drawn, edge: float, line: float, scale: float) -> None:
    """The clamped length of a tube; where it is too short for the words they stand on its left."""
    aside = (tube.back - 13 * scale, line) if -tube.free - tube.back < 23 * scale else None
    _dimension(space, (tube.back, edge), (-tube.free, edge), (0, line), text="clamp <>", text_at=aside)


def _across(space: "Modelspace", outer: Drawn, inner: Drawn, scale: float) -> None:
    """Both tubes in cross-section, with outside sizes, walls and the gap."""
    half, high, inside, step = outer.width / 2, outer.depth / 2, inner.width / 2, 9 * scale
    x = half + 60 * scale
    for layer, tube in (("OUTER_TUBE", outer), ("INNER_TUBE", inner)):
        for outline in tube.outlines:
            _rounded(space, layer, x, *outline)
    for along in ((x - half - 6 * scale, 0, x + half + 6 * scale, 0), (x, -high - 4 * scale, x, high + 6 * scale)):
        space.add_line(along[:2], along[2:], dxfattribs={"layer": "CENTRE"})
    for tube, drop in ((outer, 2 * step), (inner, step)):
        side, ring = tube.width / 2, tube.section.shape == "round"
        low = 0.0 if ring else -tube.depth / 2
        _dimension(space, (x - side, low), (x + side, low), (0, -high - drop), text="%%c<>" if ring else "<>")
        if tube.section.shape == "rectangle":
            _dimension(space, (x - side, low), (x - side, -low), (x - half - drop, 0), 90)
    right, left, top = x + half, x - inside, high + step
    at_outer, at_inner = (0.0 if tube.section.shape == "round" else 0.3 * tube.depth for tube in (outer, inner))
    aside = (right + 18 * scale, top) if outer.section.shape == "rectangle" else None  # clear of the inner wall's lines
    _dimension(space, (right - outer.wall, at_outer), (right, at_outer), (0, top), text="outer wall <>", text_at=aside)
    _dimension(space, (left, at_inner), (left + inner.wall, at_inner), (0, top + step), text="inner wall <>")
    beside = right + 1.5 * step
    # Beside corners in a round tube it is another than the gap that counts, which a note states.
    name, room = "gap", 13 * scale
    if at_corners(outer.section, inner.section):
        name, room = "gap at mid-side", 24 * scale
    words = (beside + room, (inner.depth / 2 + high - outer.wall) / 2)
    _dimension(space, (x, inner.depth / 2), (x, high - outer.wall), (beside, 0), 90, f"{name} <>", words)


def _rounded(space: "Modelspace", layer: str, x: float, half: float, high: float, radius: float) -> None:
    """A rectangle about (x, 0), its corners rounded by arcs of a polyline (bulge = tan 22.5 deg), or a circle."""
    a, b, bulge = half - radius, high - radius, 0.41421356237309503
    points = [
        (x + half, -b, 0.0), (x + half, b, bulge), (x + a, high, 0.0), (x - a, high, bulge),
        (x - half, b, 0.0), (x - half, -b, bulge), (x - a, -high, 0.0), (x + a, -high, bulge),
    ]  # fmt: skip
    if radius <= 0:
        _box(space, layer, (x - half, x + half), (-high, high))
    elif max(a, b) < 1e-9 * radius:
        space.add_circle((x, 0), radius, dxfattribs={"layer": layer})
    else:
        space.add_lwpolyline(points, format="xyb", close=True, dxfattribs={"layer": layer})


def _words(space: "Modelspace", prototype: Prototype, outer: Drawn, inner: Drawn, scale: float) -> None:
    lines, load_kg = [prototype.name], prototype.payload.inner_end_mass_kg
    added = f", {load_kg:g} kg to be added" if load_kg else ""
    for name, beam, more in (("Outer", prototype.outer_beam, ""), ("Inner", prototype.inner_beam, added)):
        assert beam.tube is not None  # else there is no drawing
        tube = f"{name} tube: {tube_text(beam.tube)}, {beam.material}"
        lines.append(f"{tube}; {beam.end_mass_kg:g} kg fixed to the tip{more}")
    symbols = "Tips in one plane. Tip joint and clamps are symbols. Dimensions in mm."
    lines.append(f"Gap per side at assembly {gap_text(outer, inner)}. {symbols}")
    top = outer.depth / 2 * 1.5 + 44 * scale
    for k, line in enumerate(lines):
        place = {"layer": "TEXT", "insert": (min(outer.back, inner.back), top - 5.5 * k * scale)}
        space.add_text(in_dxf(line), height=(4.0 if k == 0 else 3.0) * scale, dxfattribs=place)
    for text, at in (("Lengthwise section", outer.back / 2), ("Cross-section", outer.width / 2 + 60 * scale)):
        entity: Any = space.add_text(text, height=3.0 * scale, dxfattribs={"layer": "TEXT"})
        from ezdxf.enums import TextEntityAlignment

        entity.set_placement((at, -outer.depth * 0.75 - 36 * scale), align=TextEntityAlignment.CENTER)
