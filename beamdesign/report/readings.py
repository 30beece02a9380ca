"""The points of a figure's curves with their places in its SVG, so that a page can tell values under the pointer."""

import json
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

_FEWEST, _MOST = 12, 160
_SVG_DPI = 72


def readings(figure: Figure) -> list[dict[str, Any]]:
    """Curves of a figure that was last drawn by saving it as SVG: each way of drawing lays out a little differently.

    Returns:
        per curve its name in the legend (empty without one), the labels of its axes, and up to 160 points
        `[x in the SVG, y in the SVG, value along x, value along y]` within the frame.
    """
    found = []
    for axes in figure.axes:
        for line in axes.lines:
            if points := _points(axes, line, _SVG_DPI / figure.dpi, figure.bbox.height):
                label = str(line.get_label())
                name = "" if label.startswith("_") else label
                found.append({"name": name, "x": _horizontal(axes), "y": axes.get_ylabel(), "points": points})
    return found


def readings_json(figure: Figure) -> str:
    """The same as JSON that may stand inside a script element; empty where there is no curve."""
    found = readings(figure)
    return json.dumps(found, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c") if found else ""


def _horizontal(axes: Axes) -> str:
    """Label of the horizontal axis, which axes that share it leave to the lowest."""
    own = axes.get_xlabel()
    shared = [other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes)]
    return own or next((label for label in shared if label), "")


def _points(axes: Axes, line: Line2D, scale: float, height: float) -> list[list[float]]:
    if line.get_linestyle() in ("None", "none", " ", "") or len(np.atleast_1d(line.get_xdata())) < _FEWEST:
        return []
    values = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
    with np.errstate(divide="ignore", invalid="ignore"):
        places = line.get_transform().transform(values)
    frame = axes.bbox
    inside = np.isfinite(places).all(axis=1) & np.isfinite(values).all(axis=1)
    inside[inside] = [bool(frame.contains(x, y)) for x, y in places[inside]]
    chosen = np.nonzero(inside)[0]
    if len(chosen) > _MOST:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, _MOST).astype(int))]
    return [
        [round(float(scale * x), 1), round(float(scale * (height - y)), 1), float(f"{a:.5g}"), float(f"{b:.5g}")]
        for (x, y), (a, b) in zip(places[chosen], values[chosen], strict=True)
    ]
