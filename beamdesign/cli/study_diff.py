"""`beamdesign study diff`: what changed between two result folders, and what it did."""

from pathlib import Path
from typing import Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, say, say_wide, write_json

_MOST = 40


def diff(
    first: Annotated[Path, typer.Argument(metavar="A", help="Folder of results.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another, of the same or a changed sweep.")],
    json: JsonOption = None,
) -> None:
    """Compare two result folders, case by case.

    Cases belong together by the values of their varied keys. Exit status 1 if anything differs.
    """
    from beamdesign.study.difference import difference

    found = difference(first, second)
    for line in found.unsound:
        say(line)
    if found.same:
        say(f"no difference in {len(found.cases)} cases{_code(found.code_changed)}")
    else:
        say(f"{len(found.changed)} of {len(found.cases)} common cases have other results{_code(found.code_changed)}")
        if found.inputs:
            rows = [(key, _shown(before), _shown(after)) for key, (before, after) in found.inputs.items()]
            say_wide("inputs that changed in every case", ("key", first.name, second.name), rows)
        _say_cases(found, first, second)
        for name, only in ((first.name, found.only_first), (second.name, found.only_second)):
            if only:
                say(f"only in {name}: {len(only)} cases, such as {_varied(only[0])}")
    write_json(json, {**found.__dict__, "same": found.same})
    if not found.same:
        raise typer.Exit(1)


def _code(changed: bool) -> str:
    return "; another version of the code computed the second" if changed else ""


def _say_cases(found: Any, first: Path, second: Path) -> None:
    from beamdesign.study.difference import relative

    rows = []
    for case in found.cases:
        own = {key: change for key, change in case.inputs.items() if key not in found.inputs}
        for key, change in (*own.items(), *case.outputs.items()):
            share = relative(change)
            rows.append(
                (
                    _varied(case.varied),
                    f"input {key}" if key in own else key,
                    _shown(change[0]),
                    _shown(change[1]),
                    "" if share is None else f"{100 * share:+.3g} %",
                )
            )
    if rows:
        more = f" (the first {_MOST} of {len(rows)})" if len(rows) > _MOST else ""
        say_wide(f"what differs{more}", ("case", "what", first.name, second.name, "change"), rows[:_MOST], True)


def _varied(varied: dict[str, Any]) -> str:
    return ", ".join(f"{key.rpartition('.')[2]} = {_shown(value)}" for key, value in varied.items()) or "base"


def _shown(value: Any) -> str:
    from beamdesign.study.table import cell

    value = cell(value)
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
