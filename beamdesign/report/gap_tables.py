"""Tables and maps of a diagnosis, as rows of text and shares for a page to lay out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, log10

import numpy as np
from markupsafe import escape

from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.diagnosis import Diagnosis, Errors
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.gap_metrics import BANDS_HZ, in_bands
from beamdesign.diagnosis.redesign import LoopTerms, Terms
from beamdesign.parameters import PARAMETERS
from beamdesign.quantity_text import decimal, mass_range_text, quantity, stated_bandwidth, stated_peak
from beamdesign.report.page import Table

_FAINTEST, _STRONGEST = 1e-3, 1.0  # errors over the rms of the signal that are drawn as none and as full
_WIDEST_Z = 5.0
_TOLERATED_Z = 2.0
_MOST_ROWS = 40
_MANY = 5  # columns of positive figures in an indicator's table that make a map of it


@dataclass(frozen=True)
class HeatMap:
    """A table of shares whose cells are shaded.

    Attributes:
        title: above it.
        columns: heads.
        rows: label, more words about it, and cells of each: (text, shade from 0 to 1, words on hovering).
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[tuple[str, float, str], ...]], ...]


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
    return f"{record.excitation}, {masses}, {quantity(record.controller.gain_A_per_V, 'A/V', 3)}"


def error_maps(all_errors: Sequence[Errors], conditions: Mapping[str, str]) -> tuple[HeatMap, ...]:
    """Errors of each record in each band: as believed, and with the cause.

    Args:
        all_errors: of the records, in the order of the rows.
        conditions: of each record by name, in words.
    """
    edges = np.array(BANDS_HZ)
    names = tuple(f"{low:g} to {high:g}" for low, high in pairwise(edges))
    found = []
    for attribute, title in (("before", "as believed"), ("after", "with the cause")):
        rows = []
        for errors in all_errors:
            values = in_bands(errors, getattr(errors, attribute), edges)
            cells = tuple(
                (
                    decimal(100 * value, 2) if value >= 5e-5 else "0",
                    shade(value),
                    f"{errors.name}, {name} Hz, {title}: {share_text(value)}",
                )
                for name, value in zip(names, map(float, values), strict=True)
            )
            rows.append((errors.name, conditions.get(errors.name, ""), cells))
        found.append(HeatMap(title, names, tuple(rows)))
    return tuple(found)


def shade(value: float) -> float:
    """From 0 to 1 in the logarithm, so that small errors show beside large ones."""
    if value <= _FAINTEST:
        return 0.0
    return min(1.0, log10(value / _FAINTEST) / log10(_STRONGEST / _FAINTEST))


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
        return _map(table, words, alike, values)
    lines = list(zip(*table.values(), strict=True))[:_MOST_ROWS]
    heads = tuple(escape(name.replace("_", " ")) for name in table)  # nothing in names is code
    return Table(heads, tuple(tuple(escape(_text(v)) for v in line) for line in lines))


def _map(table: Mapping[str, Sequence[object]], words: list[str], alike: list[str], values: np.ndarray) -> HeatMap:
    finite = values[np.isfinite(values)]
    largest = float(finite.max(initial=0.0)) or 1.0
    rows = []
    for k, line in enumerate(values):
        label, more = str(table[words[0]][k]), ", ".join(str(table[name][k]) for name in words[1:])
        cells = tuple(
            (decimal(float(v), 2), min(1.0, float(v) / largest), f"{label}, {name}: {decimal(float(v), 3)}")
            for name, v in zip(alike, line, strict=True)
        )
        rows.append((label, more, cells))
    heads = tuple(name.removesuffix(" Hz").replace("-", " to ") for name in alike)
    return HeatMap("", heads, tuple(rows))


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


@dataclass(frozen=True)
class FittedFigure:
    """A tolerated figure before and after, with its move in standard deviations of its tolerance.

    Attributes:
        name: in words.
        nominal: value.
        fitted: value with its standard error.
        z: move over the tolerance.
        spread: standard error over the tolerance.
        beyond: whether the move is more than two tolerances.
        place: of z on a scale from 0 to 1, its middle 0.5 where nothing moved.
        extent: of the standard error on that scale: from, to.
    """

    name: str
    nominal: str
    fitted: str
    z: float
    spread: float
    beyond: bool
    place: float
    extent: tuple[float, float]


def chosen_fit(found: Diagnosis) -> Fit | None:
    """The fit behind the written prototype."""
    if found.search is None:
        return None
    names = tuple(sorted(found.chosen))
    fits = [found.search.null, *found.search.fits]  # the latter best first
    return next((fit for fit in fits if fit.hypothesis.causes == names and not fit.reason), found.search.null)


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
        rows.append(
            FittedFigure(
                unknown.name.replace("_", " "),
                _shown(unknown.name, unknown.nominal),
                _shown(unknown.name, value, error),
                float(z),
                float(spread),
                abs(z) > _TOLERATED_Z,
                _place(float(z)),
                (_place(float(z - spread)), _place(float(z + spread))),
            )
        )
    return tuple(sorted(rows, key=lambda row: -abs(row.z)))


def _shown(name: str, value: float, error: float | None = None) -> str:
    """A figure of the rig in the unit it is read in, with its error."""
    row = PARAMETERS[name]
    unit, value, error = row.shown_unit, value / row.factor, None if error is None else error / row.factor
    if error is None:
        return quantity(value, unit)
    text, words = quantity(value, unit), quantity(error, unit, 2)
    number, _, shown = text.partition(" ")
    return f"{number} ± {words.partition(' ')[0]} {shown}".rstrip()


def _place(z: float) -> float:
    return 0.5 + 0.5 * min(1.0, max(-1.0, z / _WIDEST_Z))


def controller_text(controller: Controller, inner_end_mass_kg: float) -> str:
    """A controller in one line."""
    gain = quantity(controller.gain_A_per_V, "A/V")
    return f"{controller.words(4)} at {gain}, {inner_end_mass_kg:.3g} kg inside"


def terms_rows(loop: LoopTerms) -> list[tuple[str, str, str]]:
    """What is promised: figure, as believed, as diagnosed."""
    masses = mass_range_text(loop.outer_end_mass_kg)
    ends = tuple(dict.fromkeys(loop.outer_end_mass_kg))
    names = ["proved stable outside", *(f"guaranteed {name}, {masses}" for name in ("bandwidth", "peak sensitivity"))]
    names += [f"critical gain at {mass:g} kg" for mass in ends]
    nominal, diagnosed = (_promised(of, masses, ends) for of in (loop.nominal, loop.diagnosed))
    return list(zip(names, nominal, diagnosed, strict=True))


def _promised(of: Terms, masses: str, ends: tuple[float, ...]) -> Iterator[str]:
    """Where a loop is stable, its bandwidth and peak sensitivity, and its critical gain at each end."""
    ranges = ", ".join(f"{low:.4g} to {high:.4g} kg" for low, high in of.stable_ranges_kg) or "nowhere"
    yield of.reason or (f"all of {masses}" if of.stable else ranges)
    yield "none" if of.bandwidth_Hz is None else stated_bandwidth(of.bandwidth_Hz)
    yield "none" if of.peak_sensitivity is None else stated_peak(of.peak_sensitivity)
    found = {at.outer_end_mass_kg: at for at in of.critical}
    for at in map(found.get, ends):
        yield "none" if at is None else f"{quantity(at.gain_A_per_V, 'A/V')} at {quantity(at.frequency_Hz, 'Hz')}"
