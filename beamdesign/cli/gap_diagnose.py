"""`beamdesign gap diagnose`: where a built rig differs from its prototype, why, and how far the gap closes."""

import sys
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.completion import data_sets
from beamdesign.cli.output import JsonOption, default_folder, folder_to_write, progress, say, say_table, write_json

if TYPE_CHECKING:
    from beamdesign.gap.designer_terms import LoopTerms
    from beamdesign.gap.diagnosis import Diagnosis

INTERRUPTED = 130
"""Exit status of a run that was interrupted, as shells have it."""


_WORTH_FIGURES = 0.1  # probability of a cause from which its figures are printed


def diagnose(
    dataset: Annotated[
        Path,
        typer.Argument(
            autocompletion=data_sets, help="Folder with dataset.toml, the prototype believed and CSV files."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=folder_to_write,
            help="Folder for prototype.toml, diagnosis.json and report.html; else NAME.diagnosis here.",
        ),
    ] = None,
    redesign: Annotated[
        bool, typer.Option("--redesign", help="Tune and prove a controller for the diagnosed prototype as well.")
    ] = False,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes that fit at the same time.")] = 2,
    json: JsonOption = None,
) -> None:
    """Diagnose the gap between a prototype and its rig.

    Every cause that is known, alone and in pairs, is fitted to all records with the tolerances of the prototype. The
    gap is then measured by fits without some of the records, on those. Exit status 0 whatever the verdict is. An
    interrupted run is taken up where it stopped by the same command: finished fits are kept in the folder `fits` of
    the results.
    """
    from beamdesign.gap.data.dataset_index import index_of, kind_of

    folder = out or default_folder(f"{index_of(dataset).resolve().parent.name}.diagnosis")
    if kind_of(dataset) == "actuator_bench":
        return _diagnose_bench(dataset, folder, redesign, json)
    _diagnose(dataset, folder, redesign, workers, json)


def _diagnose(dataset: Path, folder: Path, renew: bool, workers: int, json: Path | None) -> None:
    from beamdesign.gap.data.dataset import read_dataset
    from beamdesign.gap.designer_terms import designer_terms, payload_range
    from beamdesign.gap.diagnose import diagnose as engine
    from beamdesign.gap.fitting.fit import kept_fits
    from beamdesign.report.gap_folder import write_gap_folder
    from beamdesign.study.redesign import redesign

    data = read_dataset(dataset)
    kept = kept_fits(folder / "fits", data)
    renewed = None
    try:
        with progress("diagnosing") as update:
            found = engine(data, workers, update, kept)
        say_diagnosis(found)
        if renew:
            with progress("redesigning") as update:
                renewed = redesign(found.prototype, payload_range(data), update)
        new = [] if renewed is None else [stage for _, stage in renewed.proofs]
        terms = designer_terms(data, found.prototype, new)
        with progress("drawing"):
            paths, fields = write_gap_folder(folder, found, data, terms, renewed)
    except KeyboardInterrupt:
        print(
            f"interrupted: {kept.count} fits are kept in {kept.folder}; the same command goes on from there",
            file=sys.stderr,
        )
        raise typer.Exit(INTERRUPTED) from None
    _say_terms(terms)
    if renewed is not None and renewed.reason:
        say(f"no new controller: {renewed.reason}")
    write_json(json, fields)
    for path in paths.values():
        say(str(path))
    if renewed is None:
        low, high = payload_range(data)
        say(f"to tune on what was found: beamdesign tune {paths['prototype']} --outer-end-mass {low:g}:{high:g}")


def _diagnose_bench(dataset: Path, folder: Path, renew: bool, json: Path | None) -> None:
    from beamdesign.gap.bench.data import read_bench_set
    from beamdesign.gap.bench.diagnose import diagnose_bench_set
    from beamdesign.gap.bench.presented import presented
    from beamdesign.records import InputError
    from beamdesign.report.gap_folder import write_gap_folder

    if renew:
        raise InputError("--redesign", [(str(dataset), "a bench has no controller to design")])
    data = read_bench_set(dataset)
    with progress("diagnosing"):
        found = presented(data.name, diagnose_bench_set(data))
    say_diagnosis(found)
    paths, fields = write_gap_folder(folder, found)
    write_json(json, fields)
    for path in paths.values():
        say(str(path))


def _say_terms(terms: Sequence["LoopTerms"]) -> None:
    from beamdesign.report.gap_tables import controller_text, terms_rows

    for loop in terms:
        title = ("new: " if loop.new else "") + controller_text(loop.controller, loop.inner_end_mass_kg)
        say_table(title, ("", "as believed", "as diagnosed"), terms_rows(loop))


def say_diagnosis(found: "Diagnosis") -> None:
    """The answer for people."""
    say(f"{found.name}: {found.verdict.replace('_', ' ')}")
    say(found.sentences)
    for words in found.warnings:
        say(f"warning: {words}")
    say("")
    if found.causes:
        _say_causes(found)
    where = found.where
    if where.subsystem:
        low, high = where.band_Hz
        condition = f", {where.condition}" if where.condition else ""
        kind = f", {where.kind}" if where.kind else ""
        say(f"where: {where.subsystem}, {low:g} to {high:g} Hz{kind}{condition}")
    if where.sentence:
        say(where.sentence)
    _say_gap(found)
    for words in getattr(found, "notes", ()):
        say(words)
    told = found.separability
    for alike in told.classes if told is not None else ():
        say(f"known before any fit: these data cannot tell apart {', '.join(alike)}")
    if told is not None and told.invisible:
        say(f"known before any fit: these data cannot show {', '.join(told.invisible)}")
    for rivals in found.classes:
        say(f"these data cannot tell apart: {'; '.join(rivals)}")
    if found.next_experiment is not None:
        say(f"measure next: {found.next_experiment.text}")


def _say_causes(found: "Diagnosis") -> None:
    rows = [(c.name, c.subsystem, f"{c.probability:.1%}", f"{c.share:.0%}") for c in found.causes]
    if isfinite(found.probability_unknown):
        rows.append(("none that is known here", "", f"{found.probability_unknown:.1%}", ""))
    say_table("causes", ("cause", "subsystem", "probability", "share of the gap"), rows)
    for cause in found.causes:
        if cause.name in found.chosen or cause.probability > _WORTH_FIGURES:
            for key, q in cause.parameters.items():
                say(f"{cause.name}: {key} = {q.value:.4g} ± {q.std:.2g}")
            for flag in cause.flags:
                say(f"{cause.name}: {flag}")


def _say_gap(found: "Diagnosis") -> None:
    from beamdesign.report.gap_tables import closed_text

    gap = found.gap
    if not gap.records:
        return
    rows: list[tuple[Any, ...]] = [
        (record.record, "held out" if record.held_out else "fitted", *map(_share, _errors(record)))
        for record in gap.records
    ]
    of_all = "held out" if any(record.held_out for record in gap.records) else "all"
    rows.append((f"{of_all} together", "", *map(_share, _errors(gap))))
    columns = ("record", "", "believed", "re-tuned", "with cause", "noise")
    say_table("prediction error, per cent", columns, rows)
    low, high = (closed_text(value) for value in gap.closed_interval)
    say(f"closed: {closed_text(gap.closed)} of the explainable gap, 90 % interval {low} to {high}")


def _errors(of: Any) -> tuple[float, float, float, float]:
    return of.before, of.tuned, of.after, of.noise_floor


def _share(value: float) -> str:
    return f"{100 * value:.3g}" if isfinite(value) else ""
