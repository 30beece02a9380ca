"""`beamdesign study show`: the table of a sweep in the terminal."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.output import JsonOption, say, say_wide, write_json


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the results.")],
    columns: Annotated[
        str | None, typer.Option(help="Columns to show, separated by commas; parts of names do. Else what varies.")
    ] = None,
    sort: Annotated[str | None, typer.Option(help="Column to sort by; -NAME for the largest first.")] = None,
    first: Annotated[int, typer.Option(min=1, help="No more rows than so many.")] = 50,
    json: JsonOption = None,
) -> None:
    """Show the table of a sweep.

    Rows are numbered as in table.csv; `beamdesign study why DIR/NUMBER` tells what governs one.
    """
    from beamdesign.study.store import in_words, read_index, rows_of
    from beamdesign.study.table import chosen, ordered, rows, worth_showing

    name = read_index(folder)["name"]
    kept = rows_of(folder)
    table, unsound = rows(kept.records), in_words(kept.unsound)
    for line in unsound:
        say(line)
    if not table:
        say(f"{name}: no case is finished")
        write_json(json, {"name": name, "columns": [], "rows": [], "unsound": unsound})
        raise typer.Exit(1)
    names = worth_showing(table) if columns is None else chosen(list(table[0]), columns)
    table = ordered(table, sort)
    shown = [[row[column] for column in names] for row in table[:first]]
    out = say_wide(f"{name}: {min(first, len(table))} of {len(table)} rows", names, shown, columns is not None)
    hidden = [column for column in table[0] if column not in names or column in out]
    if columns is None and hidden:
        say(f"also there: {', '.join(hidden)}")
    write_json(json, {"name": name, "columns": list(table[0]), "rows": table, "unsound": unsound})
