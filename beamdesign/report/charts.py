"""Charts of what limits a design, what it costs and what is stable; and of time records, with their page.

Load envelope, trade curves, remedies and stable bands are drawn on the axes that are given; trade curves are moving
mass against guaranteed bandwidth against payload. A record has one panel per kind of quantity: what was done, what it
did, and the limits that it met.
"""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from itertools import groupby, pairwise
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

from beamdesign.files import LARGEST_TABLE, read_bytes, write_whole
from beamdesign.plant.actuators import FELT
from beamdesign.quantities import at_least, parted, quantity
from beamdesign.report.canvas import LIMIT, finish, inline_svg, new_figure, note, plain_numbers, save, styled
from beamdesign.report.page import Document, Part, Picture, Table, to_html
from beamdesign.spelling import in_plot

if TYPE_CHECKING:
    from beamdesign.simulation import SimulatedRecord
    from beamdesign.synthesis.operating_limits import Envelope
    from beamdesign.synthesis.remedies import Remedy


FRONT_NAME = "front.csv"
"""Of the table that `beamdesign front` writes."""


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
    for name, limit, style in styled(envelope.limits_N):
        axes.loglog(frequency, np.minimum(limit, 10 * top), label=name, linewidth=1.1, **style)
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
    changes = [k for k in range(1, len(names)) if names[k] != names[k - 1]]
    for k in changes:
        axes.axvline(float(frequency[k]), color="0.6", linewidth=0.7, linestyle=":")
    for start, end in pairwise([0, *changes, len(names) - 1]):
        if np.log(frequency[end] / frequency[start]) > 0.08 * whole:
            middle = float(np.sqrt(frequency[end] * frequency[start]))
            note(axes, names[start].replace(" ", "\n"), (middle, bottom), (0, 5), va="bottom", style="italic")


class TradePoint(NamedTuple):
    """A proved design of a front: its figures, and of rigs how many standard deviations off; None where not told."""

    outer_end_mass_high_kg: float
    bandwidth_Hz: float
    moving_mass_kg: float
    sigmas: float | None = None


def read_trade(folder: Path) -> tuple[TradePoint, ...]:
    """The proved points of a folder's front; none where there is no such file, or none that can be read."""
    try:
        text = read_bytes(folder / FRONT_NAME, LARGEST_TABLE).decode()
        rows = [row for row in csv.DictReader(StringIO(text, newline="")) if row.get("proved") == "True"]
        names = TradePoint._fields
        given = [{key: float(row[key]) for key in names if key in row or key != "sigmas"} for row in rows]
        points = tuple(TradePoint(**figures) for figures in given)
    except (OSError, KeyError, ValueError, TypeError, csv.Error):  # TypeError: a row that ends early
        return ()
    return points if all(isfinite(figure) for point in given for figure in point.values()) else ()


def plot_trade(
    axes: Axes, points: Sequence[TradePoint], own: tuple[float, float] | None = None, failed_Hz: Sequence[float] = ()
) -> Axes:
    """Moving mass over guaranteed bandwidth, one curve per payload, and this design as a square.

    Args:
        axes: drawn on: Hz and kg.
        points: proved designs.
        own: bandwidth (Hz) and moving mass (kg) of the design that is reported; None where there is none.
        failed_Hz: bandwidths at which no design was proved; a cross on the upper edge marks each.
    """
    curves = {
        f"up to {payload:g} kg at the tip": sorted(p[1:3] for p in points if p.outer_end_mass_high_kg == payload)
        for payload in sorted({point.outer_end_mass_high_kg for point in points})
    }
    for label, curve, style in styled(curves):
        axes.plot(*zip(*curve, strict=True), marker="o", label=label, **style)
    if own is not None:
        axes.plot([own[0]], [own[1]], "s", color="black", markersize=8, fillstyle="none", label="this design")
    if failed_Hz:
        axes.plot(failed_Hz, [0.97] * len(failed_Hz), "kx", transform=axes.get_xaxis_transform())
    if not points and own is None:
        axes.set_yticks([])  # there is no mass to tell
    return finish(axes, "guaranteed bandwidth, Hz", "moving mass, kg")


def plot_remedies(axes: Axes, remedies: Sequence["Remedy"]) -> Axes:
    """Draw the guaranteed bandwidth of each remedy as a bar, with the mass it adds."""
    heights = [remedy.bandwidth_Hz for remedy in remedies]
    bars = axes.barh([remedy.name for remedy in remedies], heights, color="0.7", edgecolor="black")
    proved = (f"{at_least(one.bandwidth_Hz, 'Hz', 3)}, {one.added_mass_kg:+.2f} kg" for one in remedies)
    labels = ["nothing proved" if one.reason else words for one, words in zip(remedies, proved, strict=True)]
    written = axes.bar_label(bars, labels, padding=4)
    axes.set_xlim(0, max([*heights, 1.0]))
    axes.invert_yaxis()
    axes.set_xlabel("guaranteed bandwidth, Hz")
    low, high = remedies[0].parts_kg[0]
    axes.set_title(f"Proved of each remedy, {low:g} to {high:g} kg at the tip")
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
    within: tuple[float, float] = (-inf, inf),
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
        within: what ends lie between that are drawn as edges; the filling goes no further.

    Raises:
        ValueError: where a row has not as many upper ends as lower ones.
    """
    stable = (list(zip(ends(below), ends(above), strict=True)) for below, above in zip(low, high, strict=True))
    rows = sorted(zip(map(float, x), stable, strict=True))
    parts = []  # of one outline: between parts that were filled one by one a seam would be seen
    for count, run in groupby(rows, key=lambda row: len(row[1])):
        # Bands are joined only between neighbours that have equally many: elsewhere one begins or ends in between.
        at, bands = zip(*run, strict=True)
        for k in range(count):
            bottom, top = zip(*(found[k] for found in bands), strict=True)
            if len(at) == 1:  # no width to fill: a line from end to end shows it
                axes.plot(at * 2, bottom + top, **style)
                continue
            for edge in map(np.array, (bottom, top)):
                axes.plot(at, np.where((edge > within[0]) & (edge < within[1]), edge, np.nan), **style)
            outline = np.array([[*at, *at[::-1], at[0]], np.clip([*bottom, *top[::-1], bottom[0]], *within)]).T
            parts.append(Outline(outline, closed=True))
    axes.add_patch(PathPatch(Outline.make_compound_path(*parts), color=shade, linewidth=0))
    lined: dict[str, Any] = {"edgecolor": style.get("color"), "linestyle": style.get("linestyle", "-")}
    axes.fill_between([], [], color=shade, label=label, **lined)
    return axes


_MOST_POINTS = 3000
_TOLD = {"displacement_m": "m", "current_A": "A"}


Limits = Mapping[str, tuple[float, str]]
"""By column of a record, the magnitude to be drawn with the words for the legend."""


class _Panel(NamedTuple):
    label: str
    columns: tuple[tuple[str, str], ...]
    scales: tuple[tuple[float, str], ...]
    """(factor, unit), from the largest unit; the first in which the peak is at least one is taken."""


_LENGTH = ((1e3, "mm"), (1e6, "μm"), (1e9, "nm"))
_DISPLACEMENT = _Panel("displacement", (("displacement_m", "displacement"),), _LENGTH)
_PANELS: tuple[_Panel, ...] = (
    _Panel("force", (("disturbance_N", "force on the tip"),), ((1.0, "N"),)),
    _Panel("command", (("command_V", "command"),), ((1.0, "V"), (1e3, "mV"))),
    _DISPLACEMENT,
    _Panel("payload", (("outer_end_mass_kg", "payload"), ("estimate_kg", "estimate")), ((1.0, "kg"),)),
    _Panel("stage", (("stage", "stage"),), ((1.0, "no."),)),
    _Panel("inner tip", (("inner_displacement_m", "inner tip"),), _LENGTH),
    _Panel("current", (("current_A", "current"),), ((1.0, "A"), (1e3, "mA"), (1e6, "μA"))),
    _Panel(
        "pressure",
        (("load_pressure_Pa", "load pressure"), ("pressure_a_Pa", "chamber a"), ("pressure_b_Pa", "chamber b")),
        ((1e-6, "MPa"), (1e-3, "kPa")),
    ),
    _Panel("screw", (("screw_force_N", "force of the screw"),), ((1.0, "N"),)),
)
_PANELS += tuple(
    _Panel(words, ((name, words),), ((1.0, unit),))
    for name, (words, unit) in ((name, parted(name)) for name in FELT)
    if all(name not in dict(panel.columns) for panel in _PANELS)
)


def plot_record(record: "SimulatedRecord", limits: Limits) -> Figure:
    """Panels over one time axis; quantities that stay zero throughout are left out.

    A limit is drawn where the record comes within a fifth of it. The end of a record that diverged is marked.
    """
    moving = {name for name in record.columns if np.any(record.column(name) != 0)}
    panels = [panel for panel in _PANELS if any(name in moving for name, _ in panel.columns)] or [_DISPLACEMENT]
    figure = new_figure(170.0, 28.0 + 32.0 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    times = record.column("t_s")
    for panel, part in zip(panels, axes, strict=True):
        _draw(part, panel, record, limits)
    # A record that ended early is shown in the time it had, and a little beyond.
    end = float(times[-1]) if record.diverged_at_s is None else 1.02 * record.diverged_at_s
    axes[-1].set_xlim(float(times[0]), end)
    axes[-1].set_xlabel("time, s")
    figure.suptitle(in_plot(f"{record.name}: {record.reason or 'stable'}"), fontsize=9, x=0.02, ha="left")
    figure.align_ylabels(list(axes))
    return figure


def _draw(axes: Axes, panel: _Panel, record: "SimulatedRecord", limits: Limits) -> None:
    shown = {label: name for name, label in panel.columns if name in record.columns}
    peak = max(float(np.abs(record.column(name)).max()) for name in shown.values())
    factor, unit = next((s for s in panel.scales if s[0] * peak >= 1), panel.scales[-1])
    for label, name, style in styled(shown):
        curve = _envelope(record.column("t_s"), factor * record.column(name))
        axes.plot(*curve, linewidth=0.9, label=label, **style)
    for name in shown.values():
        if name in limits and peak > 0.2 * limits[name][0]:
            limit, words = limits[name]
            for sign in (1, -1):
                text = f"{words} {factor * limit:g} {unit}" if sign > 0 else None
                axes.axhline(sign * factor * limit, **LIMIT, label=text)
    if record.diverged_at_s is not None:
        end = "diverged" if panel.label == "displacement" else None
        axes.axvline(record.diverged_at_s, color="0.45", linewidth=1.2, linestyle=":", label=end)
    axes.margins(x=0)
    if panel.label == "stage":
        axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    finish(axes, y=f"{panel.label}, {unit}", legend=None)
    if len(axes.get_legend_handles_labels()[1]) > 1:  # above the panel, so that it covers no curve
        axes.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, borderaxespad=0.0)


def _envelope(times: np.ndarray, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A signal of too many samples as the least and largest of each stretch, in their order."""
    if len(signal) <= _MOST_POINTS:
        return times, signal
    edges = np.linspace(0, len(signal), _MOST_POINTS // 2 + 1).astype(int)
    keep: list[int] = []
    for start, stop in pairwise(edges):
        part = signal[start:stop]
        keep += sorted({start + int(part.argmin()), start + int(part.argmax())})
    keep = sorted({0, *keep, len(signal) - 1})
    return times[keep], signal[keep]


def write_record_page(
    title: str,
    scenario: str,
    effects: Mapping[str, Mapping[str, float]],
    records: Sequence["SimulatedRecord"],
    limits: Limits,
    folder: Path,
) -> tuple[Path, list[Path]]:
    """Draw every record, each to NAME.svg and NAME.png, and the page that shows them all.

    Args:
        title: name of the prototype.
        scenario: its name.
        effects: of the prototype, by name, with the parameters it gives.
        records: in order.
        limits: of all of them.
        folder: an existing one; files of the same names are replaced.

    Returns:
        The page, and the pictures.
    """
    files: list[Path] = []
    pictures = []
    rows = []  # names are escaped here: nothing in them is code
    for position, record in enumerate(records):
        figure = plot_record(record, limits)
        files += save(figure, folder / record.name)
        verdict = record.reason or ("stable" if record.stable else "not stable")
        figure.suptitle("")  # on the page its heading and its caption say that
        svg = inline_svg(figure, f"record{position}", f"{record.name}: {verdict}")
        picture = Picture(svg, f"{record.name}.svg", escape(verdict))
        pictures.append(Part(record.name, (picture,)))
        told = [(record.column(name), unit) for name, unit in _TOLD.items() if name in record.columns]
        largest = (quantity(float(np.abs(signal).max()), unit) for signal, unit in told)
        rows.append((escape(record.name), escape(verdict), *largest))
    heads = ("record", "verdict", "largest displacement", "largest current")[: max(map(len, rows), default=4)]
    parts = [Part("Records", (Table(heads, tuple(rows), numbers=(2, 3)),))]
    if effects:
        given = (
            (escape(name), escape(", ".join(f"{key} = {figure:g}" for key, figure in one.items()) or "defaults"))
            for name, one in effects.items()
        )
        parts.append(Part("Effects in the rig", (Table(("effect", "given"), tuple(given)),)))
    unstable = sum(not record.stable for record in records)
    verdict = f"{unstable} of {len(rows)} records not stable." if unstable else f"All {len(rows)} records stable."
    document = Document(f"{title}: {scenario}", "Simulated records", verdict, (), (*parts, *pictures), subject="")
    page = folder / "records.html"
    write_whole(page, to_html(document))
    return page, files
