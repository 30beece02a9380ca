"""Figures without pyplot, made and saved headless, the same bytes for the same data; and as SVG inside an HTML page.

There it is valid XML with identifiers of its own and greys that follow the theme.
"""

import json
import re
from collections.abc import Mapping, Sequence
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, Literal, TypeVar
from xml.sax.saxutils import quoteattr

import matplotlib
import numpy as np
from markupsafe import escape
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatter, StrMethodFormatter

from beamdesign.files import write_whole
from beamdesign.report.page import Picture
from beamdesign.spelling import one_line

STYLES = tuple(
    {"color": colour, "linestyle": line}
    for colour, line in zip(["black", "0.45"] * 4, ["-", "-", "--", ":", "-.", "--", ":", "-."], strict=True)
)
"""Line styles that stay apart in grey print, in order of use; after eight they begin again."""

LIMIT: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (8, 3))}
"""Line style of a limit or a boundary."""


T = TypeVar("T")


def styled(curves: Mapping[str, T]) -> list[tuple[str, T, dict[str, Any]]]:
    """Curves with their labels and the line style of each."""
    return [(label, curve, STYLES[k % len(STYLES)]) for k, (label, curve) in enumerate(curves.items())]


def new_figure(
    width_mm: float = 170.0, height_mm: float = 110.0, layout: Literal["constrained"] | None = "constrained"
) -> Figure:
    """An empty figure on an Agg canvas, laid out so that labels do not overlap unless its maker does that."""
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout=layout)
    FigureCanvasAgg(figure)
    return figure


Place = Literal["best", "upper left", "lower left", "lower right"]


def finish(axes: Axes, x: str | None = None, y: str | None = None, legend: Place | None = "best") -> Axes:
    """Name the axes, draw the grid, and the legend at that place where there is one.

    Args:
        axes: drawn on; a name that is None stays as it is.
        x: of the horizontal axis, with its unit.
        y: of the vertical one.
        legend: place of the legend; none where it is None or no curve has a label.
    """
    if x is not None:
        axes.set_xlabel(x)
    if y is not None:
        axes.set_ylabel(y)
    axes.grid(which="major", color="0.88", linewidth=0.6)
    if legend and axes.get_legend_handles_labels()[1]:
        axes.legend(fontsize=8, loc=legend)
    return axes


class _PlainNumbers(LogFormatter):
    """Chooses the ticks that have a label as its base does, and writes them without an exponent."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:g}" if super().__call__(x, pos) else ""


def plain_numbers(*scales: Axis) -> None:
    """Label logarithmic scales with plain numbers: at their major ticks, and within two decades at others too.

    Of less than two decades there may be one major tick alone, from which nothing can be read.
    """
    for scale in scales:
        scale.set_major_formatter(StrMethodFormatter("{x:g}"))
        scale.set_minor_formatter(_PlainNumbers(minor_thresholds=(2, 0.5)))


def note(
    axes: Axes, words: str, at: tuple[float, float], shift: tuple[float, float], ha: str = "center", **more: Any
) -> None:
    """Write at a point of the data, shifted by so many points of print."""
    axes.annotate(words, at, xytext=shift, textcoords="offset points", fontsize=8, ha=ha, **more)


def save(
    figure: Figure, path_without_suffix: Path, kinds: Sequence[Literal["png", "svg", "pdf"]] = ("png", "svg")
) -> list[Path]:
    """Save a figure, one file per kind, each whole or not at all.

    SVG text stays text, and nothing in a file depends on the day.

    Returns:
        The files written, in the order of `kinds`.
    """
    written = []
    engine = figure.get_layout_engine()
    dates = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with matplotlib.rc_context({"svg.hashsalt": path_without_suffix.name, "svg.fonttype": "none"}):
        for kind in kinds:
            path = path_without_suffix.with_name(f"{path_without_suffix.name}.{kind}")
            picture = BytesIO()
            figure.savefig(picture, format=kind, dpi=150, metadata=dates[kind])
            write_whole(path, picture.getvalue())
            written.append(path)
            figure.set_layout_engine("none")  # laid out by the first file; doing it again costs as much as drawing
    figure.set_layout_engine(engine)
    return written


_GREY = re.compile(r"#([0-9a-fA-F]{2})\1\1\b")


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """Give the `<svg>` element of a figure.

    Greys become shares of the CSS variables `--ink` and `--paper` (black is ink, white is paper), so that the page
    decides what is dark; colours stay. Text stays text.

    Args:
        figure: to be shown; nothing about it changes.
        name: put before each identifier, so that figures on one page do not refer to each other's parts.
        description: read out instead of the picture.
    """
    buffer = StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = re.sub(r"<metadata>.*?</metadata>", "", buffer.getvalue(), flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    return svg_element(_GREY.sub(_themed, text), description)


def svg_element(text: str, description: str) -> str:
    """The `<svg>` element of an SVG file, with a description that is read out instead of it.

    Sizes come from the page, up to a width that the file states in points; the view box keeps the proportions.
    """
    head, rest = text[text.index("<svg") :].split(">", 1)
    width = re.search(r'width="([0-9.]+)pt"', head)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    style = f' style="max-width:{float(width[1]) * 4 / 3:.0f}px"' if width else ""
    return f'{head} role="img" aria-label={quoteattr(one_line(description))}{style}>{rest.strip()}'


def _themed(match: re.Match[str]) -> str:
    ink = 1 - int(match[1], 16) / 255
    if ink == 1:
        return "var(--ink)"
    if ink == 0:
        return "var(--paper)"
    return f"color-mix(in srgb, var(--ink) {100 * ink:.0f}%, var(--paper))"


def in_page(figure: Figure, name: str, caption: str, hover: bool = False) -> Picture:
    """A figure as it stands in a page, over its caption, in which nothing is code.

    Args:
        figure: to be shown.
        name: of the picture in links, and before each identifier in it.
        caption: what it shows.
        hover: whether the page tells its values under the pointer.
    """
    svg = inline_svg(figure, name, caption)
    if hover and (data := readings_json(figure)):
        svg += f'<script type="application/json" class="readings">{data}</script>'
    return Picture(svg, "", escape(caption), name)


_FEWEST_POINTS, _MOST_POINTS = 12, 160
_SVG_DPI = 72


def readings_json(figure: Figure) -> str:
    """Curves of a figure that was last drawn by saving it as SVG: each way of drawing lays out a little differently.

    Returns:
        JSON that may stand inside a script element, empty where there is no curve: per curve its name in the legend
        (empty without one), the labels of its axes, and up to 160 points `[x in the SVG, y in the SVG, value along x,
        value along y]` within the frame.
    """
    found = []
    for axes in figure.axes:
        shared = [other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes)]
        x = axes.get_xlabel() or next((label for label in shared if label), "")  # left to the lowest that shares it
        for line in axes.lines:
            if points := _points(axes, line, _SVG_DPI / figure.dpi, figure.bbox.height):
                label = str(line.get_label())
                name = "" if label.startswith("_") else label
                found.append({"name": name, "x": x, "y": axes.get_ylabel(), "points": points})
    return json.dumps(found, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c") if found else ""


def _points(axes: Axes, line: Line2D, scale: float, height: float) -> list[list[float]]:
    if line.get_linestyle() in ("None", "none", " ", "") or len(np.atleast_1d(line.get_xdata())) < _FEWEST_POINTS:
        return []
    values = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
    with np.errstate(divide="ignore", invalid="ignore"):
        places = line.get_transform().transform(values)
    frame = axes.bbox
    inside = np.isfinite(places).all(axis=1) & np.isfinite(values).all(axis=1)
    inside[inside] = [bool(frame.contains(x, y)) for x, y in places[inside]]
    chosen = np.nonzero(inside)[0]
    if len(chosen) > _MOST_POINTS:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, _MOST_POINTS).astype(int))]
    return [
        [round(float(scale * x), 1), round(float(scale * (height - y)), 1), float(f"{a:.5g}"), float(f"{b:.5g}")]
        for (x, y), (a, b) in zip(places[chosen], values[chosen], strict=True)
    ]
