"""`beamdesign study`: sweeps over a study file, kept, resumed, shown and compared."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

import beamdesign
from beamdesign.cli.command import CommandResult, command, group, resumed
from beamdesign.cli.output import default_folder, echo, echo_table, progress, refuse

_SHOWN_REASONS = 5
_Cases = Annotated[int | None, typer.Option(min=1)]


@command
def run(
    file: Path,
    out: Path | None = None,
    workers: Annotated[int, typer.Option(min=1, max=256)] = 1,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS")] = None,
    cases: _Cases = None,
    case_seconds: Annotated[int | None, typer.Option(min=1, max=1_000_000)] = None,
    again: bool = False,
) -> CommandResult:
    """Carry out a sweep.

    One row per case; a case that fails stays as a row with its reason. Results are kept by inputs and code, so that a
    second run computes nothing, and one that was interrupted or killed goes on where it stopped. Exit status 1 if no
    case has a result.

    Args:
        file: the sweep file, such as studies/sweeps/materials.toml.
        out: folder for the results; else NAME.study here.
        workers: processes of this machine.
        scheduler: scheduler of a Dask cluster to compute on instead.
        cases: no more cases than so many: spread over a grid, or fewer samples.
        case_seconds: a case that takes longer is given up, and stays as a failed row; else 3600 s.
        again: compute the cases again that failed.
    """
    from beamdesign.sweep.conclusion import in_words
    from beamdesign.sweep.sweep_run import finished, plan

    if scheduler is not None and workers != 1:
        refuse("study run", ("--workers", "has no meaning with --scheduler"))
    if scheduler is not None and case_seconds is not None:
        reason = "has no meaning with --scheduler: a case that a cluster computes can be ended only there"
        refuse("study run", ("--case-seconds", reason))
    folder = out or default_folder(f"{file.stem}.study")

    def kept() -> str:
        laid = plan(file, cases)
        done = f"{finished(laid, folder)} of {laid.budget} cases are kept in {folder}"
        return f"; {done}: the same command goes on from there"

    with resumed(kept), progress(file.stem) as update:
        found = beamdesign.study(
            file, folder, workers, update, cases=cases, scheduler=scheduler, case_seconds=case_seconds, again=again
        )
    fields = found.to_dict()
    counts = ", ".join(f"{count} {status}" for status, count in found.counts.items())
    before = f"{found.computed} computed, {len(found.records) - found.computed} kept from before"
    echo(f"{fields['name']}: {fields['cases']} cases: {counts}; {before}")
    amiss = [record for record in found.records if record["status"] in ("refused", "failed")]
    rows = [(_varied(record["varied"]), record["status"], record["reason"]) for record in amiss[:_SHOWN_REASONS]]
    if rows:
        more = f", the first {_SHOWN_REASONS} of {len(amiss)}" if len(amiss) > _SHOWN_REASONS else ""
        echo_table(f"without a result{more}", ("case", "status", "reason"), rows)
    echo(*fields["unsound"], *in_words(found.conclusion, found.laid.sweep))
    if not any(path.suffix == ".parquet" for path in found.files):
        echo("for table.parquet beside table.csv: pip install 'beamdesign[parquet]'")
    return CommandResult(fields, found.yes, found.files)


@command
def status(
    file: Path, out: Annotated[Path | None, typer.Option(metavar="DIR")] = None, cases: _Cases = None
) -> CommandResult:
    """Tell what of a sweep is finished.

    Results of other inputs or of another version of the code stay in the folder and are told as such; they are not
    used. Exit status 1 while cases remain, and where every case is refused.

    Args:
        file: the sweep file.
        out: folder of the results; else NAME.study here.
        cases: as given to `study run`.
    """
    from beamdesign.sweep.sweep_run import plan, sweep_status

    laid, folder = plan(file, cases), out or Path(f"{file.stem}.study")
    found = sweep_status(laid, folder)
    counts = ", ".join(f"{count} {status}" for status, count in found.counts.items()) or "none finished"
    remaining = "an unknown number" if found.remaining is None else str(found.remaining)
    echo(f"{laid.sweep.name}: {counts}; {remaining} to go")
    if found.impossible:
        echo("  every case is refused: `study run` does not begin with them")
    echo(*found.unsound, before="  ")
    if found.seconds_left is not None:
        echo(f"  about {found.seconds_left:.0f} s of computing are left, divided by the number of workers")
    if found.stale or found.foreign:
        echo(f"  also there: {found.stale} of another version of the code, {found.foreign} of other inputs; not used")
    if found.reasons:
        echo_table("without a result", ("status", "reason", "cases"), found.reasons)
    fields = {"name": laid.sweep.name, "folder": folder, **found.__dict__}
    return CommandResult(fields, found.remaining == 0 and not found.impossible)


@command
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR")],
    columns: str | None = None,
    sort: str | None = None,
    first: Annotated[int, typer.Option(min=1)] = 50,
) -> CommandResult:
    """Show the table of a sweep.

    Rows are numbered as in table.csv; `beamdesign study why DIR/NUMBER` tells what governs one.

    Args:
        folder: folder of the results.
        columns: columns to show, separated by commas; parts of names do. Else what varies.
        sort: column to sort by; -NAME for the largest first.
        first: no more rows than so many.
    """
    from beamdesign.sweep.store import in_words, read_index, rows_of
    from beamdesign.sweep.sweep_run import chosen, ordered, rows, worth_showing

    index = read_index(folder)
    name, kept = index["name"], rows_of(folder)
    table, unsound = rows(kept.records, index["rows"]), in_words(kept.unsound)
    echo(*unsound)
    if not table:
        echo(f"{name}: no case is finished")
        return CommandResult({"name": name, "columns": [], "rows": [], "unsound": unsound}, yes=False)
    names = worth_showing(table) if columns is None else chosen(list(table[0]), columns)
    table = ordered(table, sort)
    shown = [[row[column] for column in names] for row in table[:first]]
    title = f"{name}: {min(first, len(table))} of {len(table)} rows"
    out = echo_table(title, names, shown, wrap=False, every=columns is not None)
    hidden = [column for column in table[0] if column not in names or column in out]
    if columns is None and hidden:
        echo(f"also there: {', '.join(hidden)}")
    return CommandResult({"name": name, "columns": list(table[0]), "rows": table, "unsound": unsound})


_MOST = 40


@command
def diff(
    first: Annotated[Path, typer.Argument(metavar="A")], second: Annotated[Path, typer.Argument(metavar="B")]
) -> CommandResult:
    """Compare two result folders, case by case.

    Cases belong together by the values of their varied keys. Exit status 1 if anything differs.

    Args:
        first: folder of results.
        second: another, of the same or a changed sweep.
    """
    from beamdesign.sweep.store import difference, relative

    found = difference(first, second)
    echo(*found.unsound)
    code = "; another version of the code computed the second" if found.code_changed else ""
    if found.same:
        echo(f"no difference in {len(found.cases)} cases{code}")
    else:
        echo(f"{len(found.changed)} of {len(found.cases)} common cases have other results{code}")
        if found.inputs:
            common = [(key, *map(_shown, change)) for key, change in found.inputs.items()]
            echo_table("inputs that changed in every case", ("key", first.name, second.name), common, wrap=False)
        rows = []
        for case in found.cases:
            own = {key: change for key, change in case.inputs.items() if key not in found.inputs}
            for key, change in (*own.items(), *case.outputs.items()):
                what, share = f"input {key}" if key in own else key, relative(change)
                off = "" if share is None else f"{100 * share:+.3g} %"
                rows.append((_varied(case.varied), what, *map(_shown, change), off))
        if rows:
            more = f" (the first {_MOST} of {len(rows)})" if len(rows) > _MOST else ""
            heads = ("case", "what", first.name, second.name, "change")
            echo_table(f"what differs{more}", heads, rows[:_MOST], wrap=False)
        for name, only in ((first.name, found.only_first), (second.name, found.only_second)):
            if only:
                echo(f"only in {name}: {len(only)} cases, such as {_varied(only[0])}")
    return CommandResult({**found.__dict__, "same": found.same}, found.same)


def _varied(varied: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {_shown(value)}" for key, value in varied.items()) or "base"


def _shown(value: Any) -> str:
    from beamdesign.sweep.sweep_run import cell

    value = cell(value)
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


@command
def why(case: Annotated[str, typer.Argument()]) -> CommandResult:
    """Tell why a case came out as it did.

    The structural checks with their utilisation, what binds, the shadow prices, and for a no what to relax; of loops
    the claims, the starts that failed and the scope of the proof. Exit status 1 if the case itself has no result.

    Args:
        case: DIR/NUMBER as `study show` numbers the rows, or DIR/ADDRESS.
    """
    from beamdesign.build.result_folder import price_words
    from beamdesign.sweep.case import governing
    from beamdesign.sweep.store import case_of

    found = governing(record := case_of(case))
    details = record["details"]
    reason = f": {record['reason']}" if record["reason"] else ""
    echo(f"{record['task']} of {_varied(record['varied'])}: {record['status']}{reason}")
    if found["checks"]:
        echo_checks("structural checks, the most used first", found["checks"])
        echo(f"binding: {'; '.join(found['binding']) or 'none'}")
    if found["requirements"]:
        echo(f"active at the lightest free sizes: {'; '.join(found['requirements'])}")
    echo(*price_words(found["shadow_prices"] or {}), before="  ")
    for item in found["relaxations"]:
        echo(f"  enough alone: {item['key']} from {item['asked']:g} to {item['enough']:.6g}")
    for name in ("scope", "failures", "attempts"):
        echo(*map(str, details.get(name, ())), before="  ")
    for claim in details.get("claims", ()):
        echo(f"  {'proved' if claim['holds'] else 'REFUTED'}: {claim['claim']} {claim['reason']}".rstrip())
    if "traceback" in details:
        echo(details["traceback"].rstrip())
    if record["outputs"] and not details:
        echo("  the task keeps no more than its outputs:")
        for name, value in record["outputs"].items():
            echo(f"  {name}: {value}")
    return CommandResult(found | {"outputs": record["outputs"]}, record["status"] == "done")


def echo_checks(title: str, checks: Iterable[Mapping[str, Any]]) -> None:
    """Print structural checks, given as the fields that the task `size` keeps of them."""

    def row(
        name: str, value: float, limit: float, unit: str, at_least: bool, utilisation: float | None, satisfied: bool
    ) -> tuple[Any, ...]:
        used = "-" if utilisation is None else f"{100 * utilisation:.0f} %"
        return name, value, "at least" if at_least else "at most", limit, unit, used, "" if satisfied else "FAILS"

    echo_table(title, ("check", "value", "", "limit", "unit", "used", ""), [row(**check) for check in checks])


study = group("Sweep, sample or optimise over any key. Nothing is computed twice, and a killed run goes on.")
for part in (run, status, show, diff, why):
    study.command(part.__name__)(part)
