"""A picture of a blind check: what was named against what was there, and how true stated probabilities are."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.gap.blind.bounds import clopper_pearson
from beamdesign.gap.blind.outcome import Outcome
from beamdesign.gap.blind.scoring import Bin, calibration, confusion, split
from beamdesign.report.canvas import new_figure


def blindcheck_picture(outcomes: Sequence[Outcome]) -> Figure:
    """Both, over nulls and large gaps."""
    large, _ = split(outcomes)
    matrix, (bins, _) = confusion(large), calibration(large)
    figure = new_figure(240.0, max(80.0, 4.6 * len(matrix) + 40.0))
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1))
    draw_confusion(left, matrix)
    draw_reliability(right, bins)
    return figure


def draw_confusion(axes: Axes, matrix: Mapping[str, Mapping[str, int]]) -> Axes:
    """Counts, on a grey that goes with their share of the row; a frame where the name is right."""
    rows = list(matrix)
    named = {name for row in matrix.values() for name in row}
    columns = [label for label in rows if label in named] + sorted(named - set(rows))
    counts = np.array([[matrix[row].get(column, 0) for column in columns] for row in rows], dtype=float)
    share = counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(share, cmap="Greys", vmin=0.0, vmax=2.2, aspect="auto")
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            if counts[i, j]:
                axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7)
            right = column == row or column == row.removesuffix(" +")
            if right or (row.startswith("outside: ") and column == "unknown"):
                axes.plot(
                    (j - 0.5, j + 0.5, j + 0.5, j - 0.5, j - 0.5), (i - 0.5, i - 0.5, i + 0.5, i + 0.5, i - 0.5), "k"
                )
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xlabel("named first")
    axes.set_title("Truth (rows) and what was named; framed: right", fontsize=9)
    return axes


def draw_reliability(axes: Axes, bins: Sequence[Bin]) -> Axes:
    """Share of statements that are true over the probability stated, with 95 % bounds."""
    axes.plot((0, 1), (0, 1), color="0.6", linestyle="--", label="calibrated")
    for b in bins:
        axes.plot((b.stated, b.stated), clopper_pearson(round(b.true * b.count), b.count), color="0.5")
    axes.plot([b.stated for b in bins], [b.true for b in bins], "ko", label="found, 95 % bounds")
    axes.set_xlabel("probability stated")
    axes.set_ylabel("share that is true")
    axes.set_title("Calibration", fontsize=9)
    axes.legend(fontsize=7)
    return axes
