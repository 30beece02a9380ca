"""Stable bands: what is shaded is what lies between the ends that a table lists."""

import numpy as np
import pytest
from matplotlib.axes import Axes

from beamdesign.report.canvas import STYLES, new_figure
from beamdesign.report.charts import ends, plot_stable_bands


def shaded(axes: Axes, x: float, y: float) -> bool:
    return any(area.get_path().contains_point((x, y)) for area in axes.patches)


def test_cells_of_tables_and_of_records_mean_the_same() -> None:
    assert ends("0; 2.5") == ends([0, 2.5]) == (0.0, 2.5)
    assert ends("") == ends(None) == ends([]) == ends(float("nan")) == ()
    with pytest.raises(ValueError, match="stable"):
        ends("stable")


def test_the_inside_of_a_circle_with_a_hole_is_shaded_and_nothing_else() -> None:
    # Between circles of radius 1 and 0.5 about the origin: two bands over the hole, one beside it, none beyond.
    x = np.linspace(-1.25, 1.25, 101)
    outer, hole = (np.sqrt(np.clip(radius**2 - x**2, 0, None)) for radius in (1.0, 0.5))
    low = ["" if o == 0 else f"{-o}; {h}" if h > 0 else f"{-o}" for o, h in zip(outer, hole, strict=True)]
    high = ["" if o == 0 else f"{-h}; {o}" if h > 0 else f"{o}" for o, h in zip(outer, hole, strict=True)]
    order = np.random.default_rng(1).permutation(len(x))  # a table need not be sorted
    axes = new_figure().subplots()
    plot_stable_bands(axes, x[order], [low[k] for k in order], [high[k] for k in order], "ring", dict(STYLES[0]))
    points = np.random.default_rng(2).uniform(-1.2, 1.2, (400, 2))
    radii = np.hypot(*points.T)
    # Close to an edge, and where bands begin or end between two values of x, lines stand for arcs.
    clear = (abs(radii - 1) > 0.05) & (abs(radii - 0.5) > 0.05) & (abs(abs(points[:, 0]) - 0.5) > 0.03)
    assert clear.sum() > 200
    wanted = [0.5 < radius < 1 for radius in radii[clear]]
    assert [shaded(axes, *point) for point in points[clear]] == wanted
    assert axes.get_legend_handles_labels()[1] == ["ring"]


def test_a_band_at_a_single_value_is_drawn_as_a_line() -> None:
    axes = new_figure().subplots()
    plot_stable_bands(axes, [0, 1, 2], ["", "3", ""], ["", "5", ""], "", dict(STYLES[0]))
    (line,) = axes.lines
    assert line.get_xydata().tolist() == [[1, 3], [1, 5]]


def test_ends_that_do_not_pair_are_refused() -> None:
    with pytest.raises(ValueError, match="shorter"):
        plot_stable_bands(new_figure().subplots(), [0], ["1; 2"], ["3"], "", dict(STYLES[0]))
