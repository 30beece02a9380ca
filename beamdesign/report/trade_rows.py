"""Trade curves that lie beside a result: rows of the front.csv that `beamdesign front` has written there."""

import csv
from io import StringIO
from math import isfinite
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes

from beamdesign.files import LARGEST_TABLE, read_bytes
from beamdesign.report.canvas import STYLES

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
    for k, payload in enumerate(sorted({point.outer_end_mass_high_kg for point in points})):
        curve = sorted(point[1:] for point in points if point.outer_end_mass_high_kg == payload)
        style = STYLES[k % len(STYLES)]
        bandwidths, masses = zip(*curve, strict=True)
        label = f"up to {payload:g} kg at the tip"
        axes.plot(bandwidths, masses, marker="o", label=label, color=style["color"], linestyle=style["linestyle"])
    axes.plot([own[0]], [own[1]], "s", color="black", markersize=8, fillstyle="none", label="this design")
    axes.set_xlabel("guaranteed bandwidth, Hz")
    axes.set_ylabel("moving mass, kg")
    axes.grid(color="0.85", linewidth=0.6)
    axes.legend(fontsize=8, loc="best")
    return axes
