"""Charts of what limits a design and of what it costs: load envelope, trade curves, remedies side by side.

Each function draws on the axes it is given. Trade curves are moving mass against guaranteed bandwidth against payload.
"""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from itertools import cycle
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from beamdesign.files import LARGEST_TABLE, read_bytes
from beamdesign.quantity_text import at_least
from beamdesign.report.canvas import LIMIT, STYLES, finish, note, plain_numbers, styled

if TYPE_CHECKING:
    from beamdesign.synthesis.codesign import Front
    from beamdesign.synthesis.operating_limits import Envelope
    from beamdesign.synthesis.remedies import Remedy

FRONT_NAME = "front.csv"
"""Of the table that `beamdesign front` writes."""
_STYLES = (*STYLES, {"color": "0.45", "linestyle": "--"})


def plot_envelope(axes: Axes, envelope: "Envelope", asked_N: float | None = None) -> Axes:
    """Largest amplitude of a force on the tip over its frequency: every limit, and the least of them shaded below.

    Args:
        axes: drawn on.
        envelope: one that has limits.
        asked_N: a load to be marked, such as that of the design.
    """
    frequency, least = envelope.frequency_Hz, envelope.load_N
    top = 6 * float(max(least.max(), asked_N or 0.0))
    bottom = 0.5 * float(max(least.min(), 1e-3 * top))
    axes.fill_between(frequency, bottom, least, color="0.9", linewidth=0)
    for (name, limit), style in zip(envelope.limits_N.items(), cycle(_STYLES), strict=False):
        line = axes.loglog(frequency, np.minimum(limit, 10 * top), label=name, linewidth=1.1)[0]
        line.set(**style)
    axes.loglog(frequency, least, color="black", linewidth=2.4, label="envelope")
    if asked_N is not None:
        axes.axhline(asked_N, **LIMIT, label=f"asked for, {asked_N:g} N")
    _name_stretches(axes, envelope, bottom)
    axes.set(xlim=(float(frequency[0]), float(frequency[-1])), ylim=(bottom, top))
    plain_numbers(axes.xaxis, axes.yaxis)
    finish(axes, "frequency, Hz", "amplitude of the force on the tip, N", legend=None)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return axes


def _name_stretches(axes: Axes, envelope: "Envelope", bottom: float) -> None:
    """Write at the foot which limit governs, between lines where that changes; short stretches go without a name."""
    names, frequency = envelope.governing, envelope.frequency_Hz
    whole = np.log(frequency[-1] / frequency[0])
    start = 0
    for k in range(1, len(names) + 1):
        if k < len(names) and names[k] == names[start]:
            continue
        end = frequency[min(k, len(names) - 1)]
        if k < len(names):
            axes.axvline(float(end), color="0.6", linewidth=0.7, linestyle=":")
        if np.log(end / frequency[start]) > 0.08 * whole:
            words = names[start].replace(" ", "\n")
            middle = float(np.sqrt(frequency[start] * end))
            note(axes, words, (middle, bottom), (0, 5), va="bottom", style="italic")
        start = k


class TradePoint(NamedTuple):
    """A proved design of a front."""

    outer_end_mass_high_kg: float
    bandwidth_Hz: float
    moving_mass_kg: float


def read_trade(folder: Path) -> tuple[TradePoint, ...]:
    """The proved points of a folder's front; none where there is no such file, or none that can be read."""
    try:
        text = read_bytes(folder / FRONT_NAME, LARGEST_TABLE).decode()
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


def plot_front(axes: Axes, front: "Front") -> Axes:
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
    for label, points, style in styled(curves):
        axes.plot(*zip(*sorted(points), strict=True) if points else ((), ()), marker="o", label=label, **style)


def plot_remedies(axes: Axes, remedies: Sequence["Remedy"]) -> Axes:
    """Draw the guaranteed bandwidth of each remedy as a bar, with the mass it adds."""
    heights = [remedy.bandwidth_Hz for remedy in remedies]
    bars = axes.barh([remedy.name for remedy in remedies], heights, color="0.7", edgecolor="black")
    labels = [
        f"{at_least(remedy.bandwidth_Hz, 'Hz', 3)}, {remedy.added_mass_kg:+.2f} kg"
        if not remedy.reason
        else "nothing proved"
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
