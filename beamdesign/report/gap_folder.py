"""The files that a diagnosis leaves: updated prototype, fields for programs, report with its pictures, new design.

The report is one self-contained HTML page: no requests, both themes, fit for print.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import escape
from matplotlib.figure import Figure

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import BandGap, Cause, Diagnosis, controller_text, in_words
from beamdesign.diagnosis.gap_metrics import Errors, in_bands
from beamdesign.diagnosis.redesign import LoopTerms, Redesign, payload_range
from beamdesign.files import write_set
from beamdesign.loop import loop
from beamdesign.proofs.scope import near_rest
from beamdesign.prototype import Prototype
from beamdesign.quantities import decimal, masses_text, stated_bandwidth, stated_peak
from beamdesign.records import InputError, to_toml
from beamdesign.report import gap_tables as tables
from beamdesign.report.canvas import finish, in_page, new_figure, plain_numbers
from beamdesign.report.figures import plot_compliance
from beamdesign.report.gap_tables import WORDS
from beamdesign.report.page import Document, Picture, page_template
from beamdesign.result import finite, json_text, picked
from beamdesign.structure.arm import off_axis

NAMES = {"prototype": "prototype.toml", "json": "diagnosis.json", "report": "report.html"}
REDESIGNED, NEXT = "redesigned/prototype.toml", "next_experiment*.csv"
_RETIRING = NEXT.replace("*", ""), NEXT.replace("*", "_[0-9]"), REDESIGNED, "redesigned/certificate*.toml"


def write_gap_folder(
    folder: Path,
    found: Diagnosis,
    data: Dataset | None = None,
    terms: tuple[LoopTerms, ...] = (),
    renewed: Redesign | None = None,
) -> tuple[dict[str, Path], dict[str, Any]]:
    """Write everything as one set; what an earlier diagnosis left in these files goes.

    Args:
        folder: made if need be.
        found: the diagnosis.
        data: of a twin beam; None for a bench.
        terms: what its loops promise.
        renewed: a new design, where one was asked for.

    Returns:
        paths by kind, and the fields of the JSON file.
    """
    names, texts = dict(NAMES), {"prototype": to_toml(found.prototype)}
    if renewed is not None and renewed.prototype is not None:
        names["redesigned"], texts["redesigned"] = REDESIGNED, to_toml(renewed.prototype)
        for k, (certificate, stage) in enumerate(renewed.proofs, start=1):
            assert stage.guarantee is not None  # what was proved
            kind = "certificate" if len(renewed.proofs) == 1 else f"certificate_stage_{k}"
            names[kind], texts[kind] = f"redesigned/{stage.guarantee.certificate}", certificate.text
    series = found.next_experiment.series if found.next_experiment is not None else {}
    for name, columns in series.items():
        rows = (",".join(f"{value:.7g}" for value in row) for row in zip(*columns.values(), strict=True))
        names[name] = NEXT.replace("*", name.removeprefix("next"))
        texts[name] = "\n".join((",".join(columns), *rows)) + "\n"
    fields = found.to_dict()
    own = "inner_end_mass_kg outer_end_mass_kg believed=nominal diagnosed"
    promised = [{"controller": loop.controller.model_dump()} | finite(picked(loop, own)) for loop in terms]
    left_out = (*found.left_out, *(renewed.left_out if renewed is not None else ()))
    fields |= {"design": promised, "redesign": _redesign(renewed), "complete": not left_out, "left_out": left_out}
    fields |= {kind: str(folder / name) for kind, name in names.items() if kind != "json"}
    texts |= {"json": json_text(fields), "report": gap_report_html(found, names, data, terms, renewed)}
    files = {kind: (name, texts[kind]) for kind, name in names.items()}
    paths = write_set(folder, files, _RETIRING)
    return paths, fields


def _redesign(renewed: Redesign | None) -> dict[str, Any] | None:
    if renewed is None:
        return None
    prototype = renewed.prototype
    if prototype is None or prototype.controller is None:
        return {"controller": None, "reason": renewed.reason}
    guaranteed = [stage.guarantee.model_dump() for _, stage in renewed.proofs if stage.guarantee is not None]
    return {
        "controller": prototype.controller.model_dump(),
        "inner_end_mass_kg": prototype.payload.inner_end_mass_kg,
        "guaranteed": guaranteed if prototype.schedule is not None else guaranteed[0],
    }


VERDICTS = {
    "no_gap": "no gap",
    "effect": "cause found",
    "ambiguous": "several causes explain it alike",
    "unknown": "cause unknown",
}
_MOST_PICTURES = 12
_BANDS = "Errors on the records that count, rms per band over the rms of the signal."


def gap_report_html(
    found: Diagnosis,
    files: dict[str, str],
    data: Dataset | None = None,
    terms: tuple[LoopTerms, ...] = (),
    renewed: Redesign | None = None,
) -> str:
    """The report of a diagnosis.

    Args:
        found: the diagnosis.
        files: names of the files beside the report, by kind.
        data: the data set, for pictures of its time records.
        terms: what the loops promise before and after.
        renewed: a controller tuned on the diagnosed prototype, where that was asked for.
    """
    held_out = {record.record for record in found.gap.records if record.held_out}
    seen = [] if data is None else sorted(found.errors, key=lambda e: e.name not in held_out)
    conditions = {} if data is None else {r.name: tables.condition_text(r) for r in data.records}
    of_tables = tables.place, tables.figure_name, tables.terms_table
    own = (decimal, stated_bandwidth, stated_peak, in_words, controller_text, *of_tables)
    template = page_template(
        "gap_report.html", *own, share=tables.share_text, figure=_figure, closed=tables.closed_text, masses=masses_text
    )
    about, answer = " of the gap between a rig and its prototype", escape(found.sentences)  # nothing in names is code
    beside = tuple(name for kind, name in files.items() if kind != "report")
    return template.render(
        found=found,
        document=Document(found.name, "Diagnosis", answer, _key(found), (), about, beside),
        files=files,
        maps=tables.error_maps(seen, conditions) if seen else (),
        indicators=[(w, tables.indicator_table(w.table)) for w in found.where.indicators],
        learnt=[_curve(cause, k) for k, cause in enumerate(found.causes) if cause.table],
        bands=in_page(band_picture(found.gap.bands), "bands", _BANDS) if found.gap.bands else None,
        records=[_shown(e, k, e.name in held_out) for k, e in enumerate(seen[:_MOST_PICTURES])],
        left_out=max(0, len(seen) - _MOST_PICTURES),
        fitted=() if found.written is None else tables.fitted_figures(found.written),
        loops=terms,
        compliance=_compliance(found, data, terms, renewed),
        payloads=None if data is None or off_axis(data.prototype) else payload_range(data),
        renewed=renewed,
    )  # fmt: skip


def _key(found: Diagnosis) -> tuple[tuple[str, str], ...]:
    where, gap = found.where, found.gap
    least, most = (tables.closed_text(value) for value in gap.closed_interval)
    rows = (
        ("verdict", VERDICTS[found.verdict] if not found.left_out else "not everything was compared in the time given"),
        ("held responsible", in_words(", ".join(found.chosen))),
        ("where", where.place),
        ("error as believed", tables.share_text(gap.before)),
        ("re-tuned within tolerances", tables.share_text(gap.tuned)),
        ("with the cause" if found.chosen else "with the best model", tables.share_text(gap.after)),
        ("noise alone", tables.share_text(gap.noise_floor)),
        ("closed, with 90 % interval", f"{tables.closed_text(gap.closed)} ({least} to {most})"),
    )
    return tuple((name, text) for name, text in rows if text or name not in ("held responsible", "where"))


def _shown(of: Errors, position: int, held_out: bool) -> Picture:
    """A picture of a record's errors."""
    state = "held out of the fits that are drawn" if held_out else "seen by them"
    lost = [words for name, words in (("before", "believed"), ("tuned", "re-tuned")) if of.diverged(name)]
    note = f"; the {' and the '.join(lost)} model diverges" if lost else ""
    caption = (
        f"{of.name}, {state}{note}. Left: where the believed model is furthest off. Right: rms in bands of the signal"
        " (thick) and of the errors, against the noise of the sensor."
    )
    return in_page(record_picture(of), f"record{position}", caption)


def _curve(of: Cause, position: int) -> Picture:
    """A static law that was learnt, with twice its standard error."""
    (at, x), (of_what, y), (_, std) = of.table.items()
    axes = (figure := new_figure(120.0, 70.0)).subplots()
    axes.fill_between(x, np.subtract(y, np.multiply(2, std)), np.add(y, np.multiply(2, std)), alpha=0.3)
    axes.plot(x, y)
    axes.set(xlabel=at, ylabel=of_what)
    caption = f"{in_words(of.name)}, like {of.like}: what it adds, within two deviations"
    return in_page(figure, f"curve{position}", caption)


def _compliance(
    found: Diagnosis, data: Dataset | None, terms: tuple[LoopTerms, ...], renewed: Redesign | None
) -> Picture | None:
    """At the least payload: the first loop as believed and as diagnosed, and the new one."""
    if data is None or not terms or off_axis(found.prototype):  # of which the loop here is none
        return None
    first = terms[0]
    mass = first.outer_end_mass_kg[0]
    prototypes: dict[str, Prototype] = {
        name: prototype.with_law(first.controller, prototype.payload.outer_end_mass_kg, first.inner_end_mass_kg)
        for name, prototype in (("as believed", data.prototype), ("as diagnosed", found.prototype))
    }
    new = renewed.proofs[0][1] if renewed is not None and renewed.proofs else None
    if new is not None:
        prototypes["new controller, as diagnosed"] = new
    try:
        loops = {name: loop(prototype, performing=True).at(mass) for name, prototype in prototypes.items()}
    except (InputError, ValueError):
        return None
    law = controller_text(first.controller, first.inner_end_mass_kg)
    words = f"Compliance with {mass:g} kg outside, of the linear loop: {law}."
    if small := sorted({one.effect for prototype in prototypes.values() for one in near_rest(prototype)}):
        words += f" Small motion need not follow it: {in_words(', '.join(small))}."
    if new is not None:
        words += f" New: {controller_text(new.own_controller, new.payload.inner_end_mass_kg)}."
    figure = new_figure(170.0, 92.0)
    plot_compliance(figure.subplots(), loops, data.prototype.goal.compliance_m_per_N)
    return in_page(figure, "compliance", words)


def _figure(value: float, digits: int = 4) -> str:
    """A figure of any size, large ones with an exponent."""
    return decimal(value, digits) if abs(value) < 1e4 else f"{value:.{digits}g}"


MODELS = ("before", "tuned", "after")
# Told apart on white, on black and, by their dashes, in grey print.
LINES: dict[str, dict[str, Any]] = {
    "before": {"color": "#d1495b", "linestyle": (0, (5, 2))},
    "tuned": {"color": "#c08a1e", "linestyle": (0, (1.5, 1.2))},
    "after": {"color": "#2a8fb8", "linestyle": "-"},
    "noise": {"color": "0.5", "linestyle": ":"},
}
_TURNS = 7.0  # of the largest error's main frequency that a zoom shows
_SHORTEST_S, _LONGEST_S = 0.04, 0.8
_MOST_POINTS = 500
_LOWEST_HZ, _HIGHEST_HZ = 0.5, 400.0
_PER_OCTAVE = 6
_LEAST = 1e-12  # so that nothing has a logarithm as well


def zoom(errors: Errors) -> slice:
    """The samples where the believed model is furthest off, for a few turns of that error."""
    step = float(errors.times[1] - errors.times[0])
    error = errors.before - errors.before.mean()
    power = np.abs(np.fft.rfft(error)) ** 2
    power[0] = 0.0
    frequency = np.fft.rfftfreq(len(error), step)
    main = float(frequency[int(np.argmax(power))]) or 1.0
    count = round(float(np.clip(_TURNS / main, _SHORTEST_S, _LONGEST_S)) / step)
    count = min(max(count, 8), len(error))
    total = np.concatenate([[0.0], np.cumsum(errors.before**2)])
    energy = total[count:] - total[:-count]
    start = int(np.argmax(energy))
    return slice(start, start + count)


def record_picture(errors: Errors) -> Figure:
    """A stretch of the displacement beside its predictions, and the spectra of their errors."""
    figure = new_figure(170.0, 68.0, layout=None)  # there are many, all alike: to lay them out takes half the time
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    figure.subplots_adjust(left=0.11, right=0.985, bottom=0.17, top=0.9, wspace=0.34)
    part = zoom(errors)
    every = max(1, (part.stop - part.start) // _MOST_POINTS)
    shown = slice(part.start, part.stop, every)
    moved = errors.counted * errors.measured
    factor, unit = (1e3, "mm") if np.abs(moved).max() >= 1e-3 else (1e6, "μm")
    times = errors.times[shown]
    left.plot(times, factor * errors.measured[shown], color="black", linewidth=1.8, label="measured")
    for name in MODELS:
        if errors.diverged(name):
            left.plot([], [], linewidth=1.2, label=f"{WORDS[name]}: diverges", **LINES[name])
            continue
        left.plot(times, factor * errors.predicted(name)[shown], linewidth=1.2, label=WORDS[name], **LINES[name])
    finish(left, "time, s", f"displacement, {unit}", legend=None).margins(x=0)
    edges = bands(errors)
    centres = np.sqrt(edges[:-1] * edges[1:])
    right.loglog(centres, _LEAST + in_bands(errors, moved / errors.rms, edges), color="black", linewidth=1.8)
    for name in MODELS:
        right.loglog(centres, _LEAST + in_bands(errors, getattr(errors, name), edges), linewidth=1.2, **LINES[name])
    half = 0.5 / float(errors.times[1] - errors.times[0])
    noise = errors.noise * np.sqrt(np.diff(edges) / half)
    right.loglog(centres, noise, linewidth=1.2, label=WORDS["noise"], **LINES["noise"])
    finish(right, "frequency, Hz", f"rms per 1/{_PER_OCTAVE} octave", legend=None).margins(x=0)
    plain_numbers(right.xaxis, right.yaxis)
    right.set_ylim(bottom=max(0.2 * float(noise.min()), 1e-7))
    figure.legend(fontsize=7.5, loc="upper center", ncols=5, frameon=False)
    return figure


def bands(errors: Errors) -> np.ndarray:
    """Edges of sixths of octaves that each hold at least one line of a record's spectrum, Hz."""
    duration = float(errors.times[-1] - errors.times[0])
    highest = min(errors.quicker * _HIGHEST_HZ, 0.45 * len(errors.times) / duration)
    edges = [max(_LOWEST_HZ, 0.5 / duration)]
    while edges[-1] < highest:
        edges.append(max(edges[-1] * 2 ** (1 / _PER_OCTAVE), edges[-1] + 1.001 / duration))
    return np.array(edges)


def band_picture(rows: Sequence[BandGap]) -> Figure:
    """Errors on held-out records band by band."""
    figure = new_figure(170.0, 62.0)
    axes = figure.subplots()
    edges = [row.low_Hz for row in rows] + [rows[-1].high_Hz]
    for name, attribute in (*((m, m) for m in MODELS), ("noise", "noise_floor")):
        values = [getattr(row, attribute) for row in rows]
        axes.stairs(np.maximum(values, 1e-9), edges, baseline=None, linewidth=1.6, label=WORDS[name], **LINES[name])
    axes.set(xscale="log", yscale="log", xlim=(edges[0], edges[-1]))
    axes.set_xticks(edges, [f"{edge:g}" for edge in edges])
    axes.xaxis.minorticks_off()
    plain_numbers(axes.yaxis)
    finish(axes, "frequency, Hz", "error over the signal's rms", legend=None)
    figure.legend(fontsize=7.5, loc="outside upper center", ncols=4, frameon=False)
    return figure
