"""Trade curves: moving mass against guaranteed bandwidth against payload, and the four remedies side by side.

Those that lie beside a result are rows of the front.csv that `beamdesign front` has written there.
"""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from math import isfinite
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from beamdesign.files import LARGEST_TABLE, read_bytes
from beamdesign.report.canvas import STYLES, finish
from beamdesign.synthesis.codesign import Front
from beamdesign.synthesis.remedies import Remedy

NAME = "front.csv"


class TradePoint(NamedTuple):
    """A proved design of a front."""

    outer_end_mass_high_kg: float
    bandwidth_Hz: float
    moving_mass_kg: float


def read_trade(folder: Path) -> tuple[TradePoint, ...]:
    """The proved points of a folder's front; none where there is no such file, or none that can be read."""
    try:
        text = read_bytes(folder / NAME, LARGEST_TABLE).decode()
        rows = [row for row in csv.DictReader(StringIO(text, newline="")) if row.get("proved") == "True"]
        points = tuple(TradePoint(*(float(row[key]) for key in TradePoint._fields)) for row in rows)
    except (OSError, KeyError, ValueError, TypeError, csv.Error):  # TypeError: a row that ends early
        return ()
    return points if all(isfinite(figure) for point in points for figure in point) else ()


def plot_trade(axes: Axes, points: tuple[TradePoint, ...], own: tuple[float, float]) -> Axes:
    """Moving mass over guaranteed bandwidth, one curve per payload, and this design as a square.

    Args:
        axes: drawn on: Hz and kg.
        points: proved designs.
        own: bandwidth (Hz) and moving mass (kg) of the design that is reported.
    """
    curves = {
        f"up to {payload:g} kg at the tip": [p[1:] for p in points if p.outer_end_mass_high_kg == payload]
        for payload in sorted({point.outer_end_mass_high_kg for point in points})
    }
    _draw_curves(axes, curves)
    axes.plot([own[0]], [own[1]], "s", color="black", markersize=8, fillstyle="none", label="this design")
    return finish(axes, "guaranteed bandwidth, Hz", "moving mass, kg")


def plot_front(axes: Axes, front: Front) -> Axes:
    """Draw proved designs, one curve per payload range; a cross on the upper edge marks each that failed."""
    curves = {
        f"{masses[0]:g} to {masses[1]:g} kg at the tip": [
            (design.point.proved.bandwidth_Hz, design.point.moving_mass_kg)
            for design in front.designs
            if design.point is not None and design.outer_end_mass_kg == masses
        ]
        for masses in dict.fromkeys(design.outer_end_mass_kg for design in front.designs)
    }
    _draw_curves(axes, curves)
    for design in front.failed:
        axes.plot(
            design.bandwidth_Hz, 0.97, marker="x", color="black", linestyle="none", transform=axes.get_xaxis_transform()
        )
    axes.set_title("Lightest proved designs; x: no proved design found")
    return finish(axes, "guaranteed bandwidth, Hz", "moving mass, kg")


def _draw_curves(axes: Axes, curves: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    """Bandwidth and moving mass of proved designs, joined by lines; a curve per label."""
    for k, (label, points) in enumerate(curves.items()):
        bandwidths, masses = zip(*sorted(points), strict=True) if points else ((), ())
        style = STYLES[k % len(STYLES)]
        axes.plot(bandwidths, masses, marker="o", label=label, color=style["color"], linestyle=style["linestyle"])


def plot_remedies(axes: Axes, remedies: Sequence[Remedy]) -> Axes:
    """Draw the guaranteed bandwidth of each remedy as a bar, with the mass it adds."""
    names = [remedy.name for remedy in remedies]
    heights = [remedy.bandwidth_Hz for remedy in remedies]
    bars = axes.barh(names, heights, color="0.7", edgecolor="black")
    labels = [
        f"{remedy.bandwidth_Hz:.2f} Hz, {remedy.added_mass_kg:+.2f} kg" if not remedy.reason else "nothing proved"
        for remedy in remedies
    ]
    written = axes.bar_label(bars, labels, padding=4)
    axes.set_xlim(0, max([*heights, 1.0]))
    axes.invert_yaxis()
    axes.set_xlabel("guaranteed bandwidth, Hz")
    low, high = remedies[0].parts_kg[0]
    axes.set_title(f"Remedies for {low:g} to {high:g} kg at the tip, each proved")
    axes.set_xlim(0, _end_beyond(axes, heights, written))
    return axes


def _end_beyond(axes: Axes, heights: Sequence[float], written: Sequence[Text]) -> float:
    """End of the scale at which every bar with the text behind it lies within the frame."""
    figure = axes.figure
    assert isinstance(figure, Figure)  # not a part of one
    figure.draw_without_rendering()
    frame = axes.get_window_extent().width
    shares = [(text.get_window_extent().width + 0.03 * frame) / frame for text in written]
    return max(1.0, *(height / max(1.0 - share, 0.1) for height, share in zip(heights, shares, strict=True)))
