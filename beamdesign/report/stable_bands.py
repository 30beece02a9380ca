"""Stable bands over a varied figure, from the columns of a sweep's table that list their lower and upper ends."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any

from matplotlib.axes import Axes

Cell = str | Sequence[float] | None
"""What a column says of one row: "0; 2.5" in a table, a list in a record; nothing or empty where no band is stable."""


def ends(cell: Cell) -> tuple[float, ...]:
    """The figures that a cell lists.

    Raises:
        ValueError: for text that is no list of numbers.
    """
    if isinstance(cell, str):
        return tuple(float(part) for part in cell.split(";") if part.strip())
    # A missing cell is None in a record, and a float that is not a number in some tables.
    return () if cell is None or isinstance(cell, float) else tuple(float(value) for value in cell)


def plot_stable_bands(
    axes: Axes,
    x: Sequence[float],
    low: Sequence[Cell],
    high: Sequence[Cell],
    label: str,
    style: dict[str, Any],
    shade: str = "0.85",
) -> Axes:
    """Fill what is stable over x; ends are exact at each x and joined by straight lines between neighbours.

    Args:
        axes: drawn on.
        x: the varied figure, one per row in any order.
        low: lower ends of the bands at each x.
        high: upper ends, as many.
        label: in the legend.
        style: colour and line style of the edges, such as one of `canvas.STYLES`.
        shade: of the filling.

    Raises:
        ValueError: where a row has not as many upper ends as lower ones.
    """
    rows = sorted(
        (float(at), list(zip(ends(below), ends(above), strict=True)))
        for at, below, above in zip(x, low, high, strict=True)
    )
    for count, run in groupby(rows, key=lambda row: len(row[1])):
        # Bands are joined only between neighbours that have equally many: elsewhere one begins or ends in between.
        at, bands = zip(*run, strict=True)
        for k in range(count):
            bottom, top = zip(*(found[k] for found in bands), strict=True)
            axes.fill_between(at, bottom, top, color=shade, linewidth=0)
            if len(at) == 1:  # no width to fill: a line from end to end shows it
                axes.plot(at * 2, bottom + top, **style)
                continue
            axes.plot(at, bottom, **style)
            axes.plot(at, top, **style)
    axes.fill_between([], [], color=shade, edgecolor=style.get("color"), label=label, linestyle=style.get("linestyle"))
    return axes
