"""`beamdesign gap diagnose`: where a built rig differs from its prototype, why, and how far the gap closes."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json

if TYPE_CHECKING:
    from beamdesign.gap.diagnosis import Diagnosis

INTERRUPTED = 130
"""Exit status of a run that was interrupted, as shells have it."""


def diagnose(
    dataset: Annotated[Path, typer.Argument(help="Folder with dataset.toml, the prototype believed and CSV files.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=folder_to_write,
            help="Folder for prototype.toml, diagnosis.json and report.html; else NAME.diagnosis in this folder.",
        ),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Processes that fit at the same time.")] = 2,
    json: JsonOption = None,
) -> None:
    """Diagnose the gap between a prototype and its rig.

    Every cause that is known, alone and in pairs, is fitted to the records with the tolerances of the prototype; the
    verdict is judged on records that no fit has seen. Exit status 0 whatever the verdict is. An interrupted run is
    taken up where it stopped by the same command: finished fits are kept in the folder `fits` of the results.
    """
    from beamdesign.gap.dataset_index import index_of

    folder = out or Path(f"{index_of(dataset).resolve().parent.name}.diagnosis")
    _diagnose(dataset, folder, workers, json)


def _diagnose(dataset: Path, folder: Path, workers: int, json: Path | None) -> None:
    from beamdesign.gap.dataset import read_dataset
    from beamdesign.gap.diagnose import diagnose as engine
    from beamdesign.gap.diagnosis_fields import diagnosis_fields
    from beamdesign.gap.kept_fits import kept_fits
    from beamdesign.prototype import write_prototype

    data = read_dataset(dataset)
    kept = kept_fits(folder / "fits", data)
    try:
        with progress("diagnosing") as update:
            found = engine(data, workers, update, kept)
    except KeyboardInterrupt:
        print(
            f"interrupted: {kept.count} fits are kept in {kept.folder}; the same command goes on from there",
            file=sys.stderr,
        )
        raise typer.Exit(INTERRUPTED) from None
    paths = {name: folder / file for name, file in (("prototype", "prototype.toml"), ("json", "diagnosis.json"))}
    write_prototype(found.prototype, paths["prototype"])
    fields = diagnosis_fields(found) | {"prototype": paths["prototype"]}
    say_diagnosis(found)
    for target in (paths["json"], json):
        write_json(target, fields)
    for path in paths.values():
        say(str(path))


def say_diagnosis(found: "Diagnosis") -> None:
    """The answer for people."""
    say(f"{found.name}: {found.verdict.replace('_', ' ')}")
    say(found.sentences)
    for words in found.warnings:
        say(f"warning: {words}")
    say("")
    if found.causes:
        rows = [
            (
                cause.name,
                cause.subsystem,
                f"{cause.probability:.1%}",
                f"{cause.share:.0%}",
                ", ".join(f"{key} = {q.value:.4g} ± {q.std:.2g}" for key, q in cause.parameters.items()),
            )
            for cause in found.causes
        ]
        rows.append(("none that is known here", "", f"{found.probability_unknown:.1%}", "", ""))
        say_table("causes", ("cause", "subsystem", "probability", "share of the gap", "figures"), rows)
        for cause in found.causes:
            if cause.name in found.chosen:
                for flag in cause.flags:
                    say(f"flag: {cause.name}: {flag}")
    where = found.where
    if where.subsystem:
        low, high = where.band_Hz
        condition = f", {where.condition}" if where.condition else ""
        kind = f", {where.kind}" if where.kind else ""
        say(f"where: {where.subsystem}, {low:g} to {high:g} Hz{kind}{condition}")
    if where.sentence:
        say(where.sentence)
    _say_gap(found)
    for rivals in found.classes:
        say(f"these data cannot tell apart: {'; '.join(rivals)}")
    if found.next_experiment is not None:
        say(f"measure next: {found.next_experiment.text}")


def _say_gap(found: "Diagnosis") -> None:
    gap = found.gap
    if not gap.records:
        return
    rows: list[tuple[Any, ...]] = [
        (record.record, "held out" if record.held_out else "fitted", *map(_share, _errors(record)))
        for record in gap.records
    ]
    of_all = "held out" if any(record.held_out for record in gap.records) else "all"
    rows.append((f"{of_all} together", "", *map(_share, _errors(gap))))
    columns = ("record", "", "as believed", "re-tuned", "with the cause", "noise alone")
    say_table("prediction error over the signal's rms", columns, rows)
    low, high = gap.closed_interval
    say(f"closed: {gap.closed:.1%} of the explainable gap, 90 % interval {low:.1%} to {high:.1%}")


def _errors(of: Any) -> tuple[float, float, float, float]:
    return of.before, of.tuned, of.after, of.noise_floor


def _share(value: float) -> str:
    return f"{100 * value:.3g} %"
