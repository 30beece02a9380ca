"""What every command prints and writes: tables for people unless hushed, JSON for programs, ranges as LO:HI.

Tables with long column names lose no name: in a terminal they have as many columns as its width holds.
"""

import csv
import io
import os
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any

import typer

from beamdesign.files import write_whole
from beamdesign.json_text import json_text
from beamdesign.spelling import in_csv, one_line


def file_to_write(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option: refuse a path that no file can be written to, before any work is done for it.

    Raises:
        InputError: naming the option, the path and what is in its way.
    """
    if path is not None and path.is_dir():
        _refuse(option.opts[0], path, "is a folder; name a file")
    return path if path is None else _need_folder(option.opts[0], path, path.absolute().parent)


def json_target(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of --json: as `file_to_write`; `-` is standard output, which then holds nothing else."""
    if path == STANDARD_OUTPUT:
        hush()
        return path
    return file_to_write(option, path)


STANDARD_OUTPUT = Path("-")


def path_to_write(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option: refuse a path whose folder cannot be made, be it that of a file or of a folder.

    Raises:
        InputError: naming the option, the path and what is in its way.
    """
    return path if path is None else _need_folder(option.opts[0], path, path.absolute().parent)


def folder_to_write(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option: refuse a path at which no folder is or can be made, before any work is done for it.

    Raises:
        InputError: naming the option, the path and what is in its way.
    """
    return path if path is None else _need_folder(option.opts[0], path, path.absolute())


def default_file(name: str) -> Path:
    """A file of this name in the current folder, refused as `file_to_write` does."""
    return _need_folder("--out", Path(name), Path.cwd())


def default_folder(name: str) -> Path:
    """A folder of this name in the current one, refused as `folder_to_write` does."""
    return _need_folder("--out", Path(name), Path(name).absolute())


def _need_folder(option: str, path: Path, folder: Path) -> Path:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        _refuse(option, path, f"cannot be written: {folder} is a file, not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        _refuse(option, path, f"cannot be written: no permission to write in {folder}")
    return path


def _refuse(option: str, path: Path, reason: str) -> None:
    from beamdesign.records import InputError

    raise InputError(option, [(str(path), reason)])


JsonOption = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        callback=json_target,
        help="Write the result to this JSON file as well; `-` prints it, and nothing else, to standard output.",
    ),
]
RangeOption = Annotated[
    str | None, typer.Option("--outer-end-mass", metavar="LO:HI", help="Range of mass on the outer tip, kg.")
]


_hushed = ContextVar("hushed", default=False)


def hush() -> None:
    """Print nothing for people from here on: `--quiet`. Errors are raised, not said."""
    _hushed.set(True)


def speak() -> None:
    """Undo `hush`."""
    _hushed.set(False)


def shown(text: str) -> str:
    """Lines as a terminal may have them: control characters of names do nothing there."""
    return "\n".join(map(one_line, text.split("\n")))


def echo(text: str) -> None:
    """Print a line for people. Where nobody reads on (`| head`), the work goes on without a word."""
    _echo(shown(text))


def _echo(text: str) -> None:
    if _hushed.get():
        return
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def echo_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table; floats get four significant digits. Styles go only to terminals."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    if _hushed.get():
        return
    table = Table(title=Text(shown(title)), title_justify="left", box=box.SIMPLE_HEAD)
    for column in columns:
        table.add_column(Text(shown(column)))
    for row in rows:
        table.add_row(*(Text(shown(f"{cell:.4g}" if isinstance(cell, float) else str(cell))) for cell in row))
    plain = "NO_COLOR" in os.environ or not sys.stdout.isatty()
    console = Console(highlight=False, file=sys.stdout, color_system=None if plain else "auto")
    with console.capture() as captured:
        console.print(table)
    _echo("\n".join(line.rstrip() for line in captured.get().rstrip().splitlines()) + "\n")


def write_json(path: Path | None, fields: Mapping[str, Any]) -> None:
    """Write fields as JSON, whole or not at all, or to standard output; nothing without a path."""
    if path == STANDARD_OUTPUT:
        sys.stdout.write(json_text(fields))
        sys.stdout.flush()
    elif path is not None:
        write_whole(path, json_text(fields))


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write rows as CSV, whole or not at all; columns in order of first appearance, absent cells empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    writer.writerows({key: in_csv(value) for key, value in row.items()} for row in rows)
    write_whole(path, text.getvalue())


def reporting(name: str) -> AbstractContextManager[None]:
    """Where stderr is no terminal: a line now and then for as long as a command runs that takes long."""
    if sys.stderr.isatty():
        return nullcontext()
    from beamdesign.cli.progress import lines

    return lines(name, silent=_hushed.get)


def progress(description: str) -> AbstractContextManager[Any]:
    """How far work has got, on stderr, for as long as a `with` block runs, which is given `update(share, words)`.

    A bar on a terminal; elsewhere in the lines of `reporting`.
    """
    from beamdesign.cli import progress as room

    if _hushed.get() or not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        return room.reported(description)
    return room.display(description)


_GAP = "  "


def echo_wide(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]], every: bool = False) -> list[str]:
    """Print a table, floats with six significant digits.

    Args:
        title: above it.
        columns: headings.
        rows: cells.
        every: print every column, however wide the terminal; so it is where the output is no terminal.

    Returns:
        the columns that were left out.
    """
    cells = [[_text(value) for value in row] for row in rows]
    widths = [max(len(name), *(len(row[k]) for row in cells), 0) for k, name in enumerate(columns)]
    shown = list(range(len(columns)))
    if not every and sys.stdout.isatty():
        room = shutil.get_terminal_size().columns
        while len(shown) > 2 and sum(widths[k] + len(_GAP) for k in shown) > room:
            shown.pop()
    lines = [[columns[k] for k in shown], ["-" * widths[k] for k in shown], *([row[k] for k in shown] for row in cells)]
    echo(title + "\n")
    for line in lines:
        echo(_GAP.join(cell.ljust(widths[k]) for cell, k in zip(line, shown, strict=True)).rstrip())
    echo("")
    return [columns[k] for k in range(len(columns)) if k not in shown]


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
