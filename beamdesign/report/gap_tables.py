"""Tables and maps of a diagnosis for a page to lay out, and how it writes what they hold."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import isfinite, isnan, log10, nan
from typing import NamedTuple

import numpy as np
from markupsafe import escape

from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.data.dataset_index import OFF
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.gap_metrics import BANDS_HZ, Errors, in_bands
from beamdesign.diagnosis.redesign import LoopTerms, Terms
from beamdesign.parameters import PARAMETERS, TORSION
from beamdesign.quantities import decimal, masses_text, quantity, stated_bandwidth, stated_peak, stated_range
from beamdesign.report.page import Table

WORDS = {"before": "as believed", "tuned": "re-tuned", "after": "with the cause", "noise": "noise alone"}
"""What each model is called."""
_FAINTEST, _STRONGEST = 1e-3, 1.0  # errors over the rms of the signal that are drawn as none and as full
_WIDEST_Z = 5.0
_MOST_ROWS = 40
_ROWS = PARAMETERS | TORSION
_MANY = 5  # columns of positive figures in an indicator's table that make a map of it


class HeatMap(NamedTuple):
    """A table of figures whose cells are shaded.

    Attributes:
        title: above it.
        columns: heads.
        rows: label, more words about it, and figures of each.
        largest: figure that has the full shade; NaN for shares of a signal, which are shaded by their logarithm.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[float, ...]], ...]
    largest: float = nan

    def shade(self, value: float) -> float:
        """From 0 to 1; in the logarithm, small errors show beside large ones."""
        if not isnan(self.largest):
            return min(1.0, value / self.largest)
        return 0.0 if value <= _FAINTEST else min(1.0, log10(value / _FAINTEST) / log10(_STRONGEST / _FAINTEST))


def share_text(value: float) -> str:
    """A share of the signal in per cent, to three digits; nothing where it was not worked out."""
    if not isfinite(value):
        return ""
    return f"{decimal(100 * value, 3 if value >= 0.01 else 2)} %"


def closed_text(value: float) -> str:
    """The share of a gap that is gone, never rounded to the whole."""
    if not isfinite(value):
        return "undefined"
    if value >= 1:
        return share_text(value)
    texts = (f"{100 * value:.{digits}f}" for digits in (1, 2, 3))
    return next((f"{text} %" for text in texts if float(text) < 100), "nearly 100 %")


def condition_text(record: TimeRecord) -> str:
    """What the rig was asked to do, in a few words."""
    masses = f"{record.outer_end_mass:.3g} kg outside, {record.inner_end_mass:.3g} inside"
    law = "servo off" if record.controller == OFF else quantity(record.controller.gain_A_per_V, "A/V", 3)
    return f"{record.excitation}, {masses}, {law}"


def error_maps(all_errors: Sequence[Errors], conditions: Mapping[str, str]) -> tuple[HeatMap, ...]:
    """Errors of each record in each band: as believed, and with the cause.

    Args:
        all_errors: of the records, in the order of the rows.
        conditions: of each record by name, in words.
    """
    edges = all_errors[0].quicker * np.array(BANDS_HZ)
    names = tuple(f"{low:g} to {high:g}" for low, high in pairwise(edges))

    def row(errors: Errors, model: str) -> tuple[str, str, tuple[float, ...]]:
        values = in_bands(errors, getattr(errors, model), edges)
        return errors.name, conditions.get(errors.name, ""), tuple(values.tolist())

    return tuple(HeatMap(WORDS[of], names, tuple(row(one, of) for one in all_errors)) for of in ("before", "after"))


def indicator_table(table: Mapping[str, Sequence[object]]) -> HeatMap | Table | None:
    """What an indicator has to show: a map where several columns of figures are of one kind, else a table.

    They are where they are named after bands (`15-40 Hz`), or where there are many and all of them positive.
    """
    if not table or not next(iter(table.values())):
        return None
    figures = [name for name, values in table.items() if all(_is_figure(v) for v in values)]
    banded = [name for name in figures if name.endswith(" Hz")]
    alike = banded if len(banded) > 1 else figures
    words = [name for name, values in table.items() if all(isinstance(v, str) for v in values)]
    values = np.array([[float(v) for v in table[name]] for name in alike]).T  # type: ignore[arg-type]
    if words and (banded or len(alike) >= _MANY) and len(alike) > 1 and bool(np.all(values >= 0)):
        largest = float(values[np.isfinite(values)].max(initial=0.0)) or 1.0
        label, *more = (table[name] for name in words)
        rows = [
            (str(label[k]), ", ".join(str(one[k]) for one in more), tuple(row)) for k, row in enumerate(values.tolist())
        ]
        return HeatMap("", tuple(alike), tuple(rows), largest)
    lines = list(zip(*table.values(), strict=True))[:_MOST_ROWS]
    heads = tuple(escape(name.replace("_", " ")) for name in table)  # nothing in names is code
    return Table(heads, tuple(tuple(escape(_text(v)) for v in line) for line in lines))


def _is_figure(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return ""
    if isinstance(value, float | np.floating):
        return decimal(float(value))
    return str(value)


class FittedFigure(NamedTuple):
    """A tolerated figure before and after, with its move in standard deviations of its tolerance.

    Attributes:
        name: in words.
        nominal: value.
        fitted: value with its standard error.
        z: move over the tolerance.
        spread: standard error over the tolerance.
    """

    name: str
    nominal: str
    fitted: str
    z: float
    spread: float


def fitted_figures(fit: Fit) -> tuple[FittedFigure, ...]:
    """Tolerated figures of a fit, those that moved most first."""
    if fit.reason or not len(fit.z):
        return ()
    spreads = np.sqrt(np.diag(fit.covariance))
    rows = []
    for unknown, z, spread in zip(fit.unknowns, fit.z, spreads, strict=True):
        if unknown.kind != "figure":
            continue
        value, error = unknown.value(z), abs(unknown.slope(z)) * float(spread)
        before, after = _shown(unknown.name, unknown.nominal), _shown(unknown.name, value, error)
        name = unknown.name.rpartition(".")[2].removesuffix("_Pa").replace("_", " ")
        rows.append(FittedFigure(name, before, after, float(z), float(spread)))
    return tuple(sorted(rows, key=lambda row: -abs(row.z)))


def _shown(name: str, value: float, error: float | None = None) -> str:
    """A figure of the rig in the unit it is read in, with its error."""
    row = _ROWS.get(name)
    unit, factor = (row.shown_unit, row.factor) if row is not None else ("Pa", 1.0)  # of a bench's supply
    text = quantity(value / factor, unit)
    if error is None:
        return text
    number, _, shown = text.partition(" ")
    return f"{number} ± {quantity(error / factor, unit, 2).partition(' ')[0]} {shown}".rstrip()


def figure_name(key: str) -> str:
    """A figure of a cause with its unit, as those of effects have theirs: that of the model."""
    return _ROWS[key].key if key in _ROWS else key


def place(z: float) -> float:
    """Of a move on a scale from 0 to 1, its middle where nothing moved."""
    return 0.5 + 0.5 * min(1.0, max(-1.0, z / _WIDEST_Z))


def terms_table(loop: LoopTerms) -> Table:
    """What is promised: figure, as believed, as diagnosed."""
    masses = masses_text(loop.outer_end_mass_kg)
    ends = tuple(dict.fromkeys(loop.outer_end_mass_kg))
    names = ["proved stable outside", *(f"guaranteed {name}, {masses}" for name in ("bandwidth", "peak sensitivity"))]
    names += [f"critical gain at {mass:g} kg" for mass in ends]
    promised = (_promised(of, masses, ends) for of in (loop.nominal, loop.diagnosed))
    return Table(("", "as believed", "as diagnosed"), tuple(zip(names, *promised, strict=True)))


def _promised(of: Terms, masses: str, ends: tuple[float, ...]) -> Iterator[str]:
    """Where a loop is stable, its bandwidth and peak sensitivity, and its critical gain at each end."""
    ranges = ", ".join(f"{stated_range(ends, 4)} kg" for ends in of.stable_ranges_kg) or "nowhere"
    inside = f"; {of.open_between}" if of.open_between else ""
    yield of.reason or (f"all of {masses}{inside}" if of.stable else ranges)
    absent = "" if of.reason else "none"  # of figures that nobody worked out none is no answer
    yield absent if of.bandwidth_Hz is None else stated_bandwidth(of.bandwidth_Hz)
    yield absent if of.peak_sensitivity is None else stated_peak(of.peak_sensitivity)
    found = {at.outer_end_mass_kg: at for at in of.critical}
    for at in map(found.get, ends):
        yield absent if at is None else f"{quantity(at.gain_A_per_V, 'A/V')} at {quantity(at.frequency_Hz, 'Hz')}"
