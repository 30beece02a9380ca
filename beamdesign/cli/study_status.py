"""`beamdesign study status`: how far a sweep has got."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.output import JsonOption, say, say_table, write_json


def status(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The sweep file.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results; else NAME.study here.")
    ] = None,
    cases: Annotated[int | None, typer.Option(min=1, help="As given to `study run`.")] = None,
    json: JsonOption = None,
) -> None:
    """Tell what of a sweep is finished.

    Results of other inputs or of another version of the code stay in the folder and are told as such; they are not
    used. Exit status 1 while cases remain, and where every case is refused.
    """
    from beamdesign.study.sweep_run import default_folder, plan
    from beamdesign.study.sweep_status import sweep_status

    laid = plan(file, cases)
    found = sweep_status(laid, out or default_folder(file))
    counts = ", ".join(f"{count} {status}" for status, count in found.counts.items()) or "none finished"
    remaining = "an unknown number" if found.remaining is None else str(found.remaining)
    say(f"{laid.sweep.name}: {counts}; {remaining} to go")
    if found.impossible:
        say("  every case is refused: `study run` does not begin with them")
    for line in found.unsound:
        say(f"  {line}")
    if found.seconds_left is not None:
        say(f"  about {found.seconds_left:.0f} s of computing are left, divided by the number of workers")
    if found.stale or found.foreign:
        say(f"  also there: {found.stale} of another version of the code, {found.foreign} of other inputs; not used")
    if found.reasons:
        say_table("without a result", ("status", "reason", "cases"), found.reasons)
    write_json(json, {"name": laid.sweep.name, "folder": out or default_folder(file), **found.__dict__})
    if found.remaining != 0 or found.impossible:
        raise typer.Exit(1)
