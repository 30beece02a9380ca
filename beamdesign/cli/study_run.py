"""`beamdesign study run`: every case of a sweep, each computed once."""

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json

if TYPE_CHECKING:
    from beamdesign.study.sampling import Plan
    from beamdesign.study.sweep_run import SweepRun
    from beamdesign.study.workers import Workers

INTERRUPTED = 130
"""Exit status of a run that was interrupted, as shells have it."""

CASE_SECONDS = 3600
"""After which a case is given up, if nothing else is said."""

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
    case_seconds: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="A case that takes longer is given up, and stays as a failed row.")
    ] = CASE_SECONDS,
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
    from beamdesign.study.conclusion import in_words
    from beamdesign.study.store import in_words as unsound_words
    from beamdesign.study.sweep_run import default_folder, plan, run_sweep

    if scheduler is not None and workers != 1:
        raise InputError("study run", [("--workers", "has no meaning with --scheduler")])
    if scheduler is not None and case_seconds != CASE_SECONDS:
        reason = "has no meaning with --scheduler: a case that a cluster computes can be ended only there"
        raise InputError("study run", [("--case-seconds", reason)])
    laid = plan(file, cases)
    folder = out or default_folder(file)
    try:
        with progress(laid.sweep.name) as update, _where(workers, scheduler, case_seconds) as compute:
            found = run_sweep(laid, folder, compute, update, again, draw)
    except KeyboardInterrupt:
        _interrupted(folder, laid)
        raise typer.Exit(INTERRUPTED) from None
    unsound = unsound_words(found.unsound, "computed again")
    _say(found, laid)
    for line in (*unsound, *in_words(found.conclusion, laid.sweep), *map(str, found.files)):
        say(line)
    write_json(json, _fields(found, laid) | {"files": found.files, "conclusion": found.conclusion, "unsound": unsound})
    if not found.counts.get("done"):
        raise typer.Exit(1)


def _where(workers: int, scheduler: str | None, case_seconds: int) -> "AbstractContextManager[Workers]":
    from beamdesign.study import workers as room

    return room.processes(workers, case_seconds) if scheduler is None else room.cluster(scheduler)


def _interrupted(folder: Path, laid: "Plan") -> None:
    from beamdesign.study.sweep_status import finished

    print(
        f"interrupted; {finished(laid, folder)} of {laid.budget} cases are kept in {folder}: the same command goes on"
        " from there",
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
