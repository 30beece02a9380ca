"""Time records as figures: what was done, what it did, and the limits it met, one panel per kind of quantity.

The records of a simulation also make one self-contained HTML page.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.files import write_whole
from beamdesign.quantity_text import quantity
from beamdesign.report.canvas import LIMIT, STYLES, finish, inline_svg, new_figure, save
from beamdesign.report.page import Document, Part, Picture, Table, to_html
from beamdesign.spelling import in_plot

if TYPE_CHECKING:
    from beamdesign.simulation import SimulatedRecord

_MOST_POINTS = 3000
_TOLD = ("displacement_m", "current_A")


Limits = Mapping[str, tuple[float, str]]
"""By column of a record, the magnitude to be drawn with the words for the legend."""


@dataclass(frozen=True)
class _Panel:
    label: str
    columns: tuple[tuple[str, str], ...]
    scales: tuple[tuple[float, str], ...]
    """(factor, unit), from the largest unit; the first in which the peak is at least one is taken."""


_LENGTH = ((1e3, "mm"), (1e6, "μm"), (1e9, "nm"))
_DISPLACEMENT = _Panel("displacement", (("displacement_m", "displacement"),), _LENGTH)
_PANELS = (
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
    axes[-1].set_xlim(float(times[0]), float(times[-1]) * (1.0 if record.diverged_at_s is None else 1.02))
    axes[-1].set_xlabel("time, s")
    figure.suptitle(in_plot(f"{record.name}: {record.reason or 'stable'}"), fontsize=9, x=0.02, ha="left")
    figure.align_ylabels(list(axes))
    return figure


def _draw(axes: Axes, panel: _Panel, record: "SimulatedRecord", limits: Limits) -> None:
    shown = [(name, label) for name, label in panel.columns if name in record.columns]
    peak = max(float(np.abs(record.column(name)).max()) for name, _ in shown)
    factor, unit = next((s for s in panel.scales if s[0] * peak >= 1), panel.scales[-1])
    for (name, label), style in zip(shown, STYLES, strict=False):
        line = axes.plot(*_envelope(record.column("t_s"), factor * record.column(name)), linewidth=0.9, label=label)[0]
        line.set(**style)
    drawn = len(shown) > 1
    for name, _ in shown:
        if name in limits and peak > 0.2 * limits[name][0]:
            limit, words = limits[name]
            for sign in (1, -1):
                named = f"{words} {factor * limit:g} {unit}" if sign > 0 else None
                axes.axhline(sign * factor * limit, **LIMIT, label=named)
            drawn = True
    if record.diverged_at_s is not None:
        end = "diverged" if panel.label == "displacement" else None
        axes.axvline(record.diverged_at_s, color="0.45", linewidth=1.2, linestyle=":", label=end)
        drawn = drawn or end is not None
    axes.margins(x=0)
    finish(axes, y=f"{panel.label}, {unit}", legend="upper left" if drawn else None)


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
        largest = {name: float(np.abs(record.column(name)).max()) for name in _TOLD if name in record.columns}
        rows.append(
            (
                escape(record.name),
                escape(verdict),
                quantity(largest["displacement_m"], "m"),
                f"{1e3 * largest['current_A']:.4g} mA" if "current_A" in largest else "",
            )
        )
    heads = ("record", "verdict", "largest displacement", "largest current")
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
