"""`beamdesign study run`: every case of a sweep, each computed once."""

import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json

if TYPE_CHECKING:
    from beamdesign.study.sweep_plan import Plan
    from beamdesign.study.sweep_run import SweepRun
    from beamdesign.study.workers import Workers

INTERRUPTED = 130
"""Exit status of a run that was interrupted, as shells have it."""

_SHOWN_REASONS = 5


def run(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="The sweep file, such as studies/sweeps/materials.toml.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", callback=folder_to_write, help="Folder for the results; else NAME.study here."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes of this machine.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster to compute on instead.")
    ] = None,
    cases: Annotated[
        int | None, typer.Option(min=1, help="No more cases than so many: spread over a grid, or fewer samples.")
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Compute the cases again that failed.")] = False,
    json: JsonOption = None,
) -> None:
    """Carry out a sweep.

    One row per case; a case that fails stays as a row with its reason. Results are kept by inputs and code, so that a
    second run computes nothing, and one that was interrupted or killed goes on where it stopped. Exit status 1 if no
    case has a result.
    """
    from beamdesign.records import InputError
    from beamdesign.report.study_plot import draw
    from beamdesign.study.conclusion import conclude, in_words, write_sensitivity
    from beamdesign.study.sweep_run import default_folder, plan, refused_alike, run_sweep

    if scheduler is not None and workers != 1:
        raise InputError("study run", [("--workers", "has no meaning with --scheduler")])
    laid = plan(file, cases)
    folder = out or default_folder(file)
    try:
        with progress(laid.sweep.name) as update, _where(workers, scheduler) as compute:
            found = run_sweep(laid, folder, compute, update, again)
    except KeyboardInterrupt:
        _interrupted(folder, laid)
        raise typer.Exit(INTERRUPTED) from None
    if reason := refused_alike(found.records):
        raise InputError(laid.path.parent / laid.sweep.study.base, [tuple(reason.split(": ", 1))])  # type: ignore[list-item]
    conclusion = conclude(laid, found.records)
    _say(found, laid)
    for line in in_words(conclusion, laid.sweep):
        say(line)
    pictures = draw(laid.sweep, found.records, conclusion, folder)
    files = [*found.tables, *write_sensitivity(folder, conclusion), *pictures]
    if conclusion:
        files.append(folder / "conclusion.json")
        write_json(files[-1], conclusion)
    for path in files:
        say(str(path))
    write_json(json, _fields(found, laid) | {"files": files, "conclusion": conclusion})
    if not found.counts.get("done"):
        raise typer.Exit(1)


def _where(workers: int, scheduler: str | None) -> "AbstractContextManager[Workers]":
    from beamdesign.study import workers as room

    if scheduler is not None:
        return room.cluster(scheduler)
    return room.processes(workers) if workers > 1 else nullcontext(room.here)


def _interrupted(folder: Path, laid: "Plan") -> None:
    from beamdesign.study.store import rows_of

    finished = len(rows_of(folder)) if (folder / "study.json").exists() else 0
    print(
        f"interrupted; {finished} of {laid.budget} cases are kept in {folder}: the same command goes on from there",
        file=sys.stderr,
    )


def _say(found: "SweepRun", laid: "Plan") -> None:
    counts = ", ".join(f"{count} {status}" for status, count in found.counts.items())
    kept = len(found.records) - found.computed
    say(f"{laid.sweep.name}: {len(found.records)} cases: {counts}; {found.computed} computed, {kept} kept from before")
    amiss = [record for record in found.records if record["status"] in ("refused", "failed")]
    rows = [(_varied(record), record["status"], record["reason"]) for record in amiss[:_SHOWN_REASONS]]
    if rows:
        more = f", the first {_SHOWN_REASONS} of {len(amiss)}" if len(amiss) > _SHOWN_REASONS else ""
        say_table(f"without a result{more}", ("case", "status", "reason"), rows)


def _varied(record: dict[str, Any]) -> str:
    from beamdesign.study.table import cell

    return ", ".join(f"{key} = {cell(value)}" for key, value in record["varied"].items()) or "base"


def _fields(found: "SweepRun", laid: "Plan") -> dict[str, Any]:
    return {
        "name": laid.sweep.name,
        "cases": len(found.records),
        "counts": found.counts,
        "computed": found.computed,
        "folder": found.folder,
        "tables": list(found.tables),
    }
