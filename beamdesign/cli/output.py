"""What every command prints and writes: tables for people unless hushed, JSON for programs, how far long work has got.

Tables with long column names lose no name: in a terminal they have as many columns as its width holds. Progress goes
to stderr: a bar on a terminal, a line every half minute elsewhere; a word on it passes on a Ctrl-C that a library has
swallowed.
"""

import hashlib
import os
import shutil
import sys
import threading
import time
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import typer

from beamdesign.files import read_bytes, write_whole
from beamdesign.progress import Progress, pass_on
from beamdesign.result import json_text
from beamdesign.spelling import one_line

STANDARD_OUTPUT = Path("-")


def file_to_write(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option: refuse a path that no file can be written to, before any work is done for it.

    Raises:
        InputError: naming the option, the path and what is in its way.
    """
    if path is not None and path.is_dir():
        refuse(option.opts[0], (str(path), "is a folder; name a file"))
    return path_to_write(option, path)


def json_target(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of --json: as `file_to_write`; `-` is standard output, which then holds nothing else."""
    if path == STANDARD_OUTPUT:
        hush()
        return path
    return file_to_write(option, path)


def path_to_write(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option: as `file_to_write`, of a path that may be that of a file or of a folder."""
    return path and _need_folder(option.opts[0], path, path.absolute().parent)


def folder_to_write(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Callback of an option: as `file_to_write`, of a path at which a folder is or can be made."""
    return path and _need_folder(option.opts[0], path, path.absolute())


def default_folder(name: str) -> Path:
    """A folder of this name in the current one, refused as `folder_to_write` does."""
    return _need_folder("--out", Path(name), Path(name).absolute())


def _need_folder(option: str, path: Path, folder: Path) -> Path:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        refuse(option, (str(path), f"cannot be written: {folder} is a file, not a folder"))
    if not os.access(folder, os.W_OK | os.X_OK):
        refuse(option, (str(path), f"cannot be written: no permission to write in {folder}"))
    return path


def spare(read: Iterable[Path], folder: Path | None, names: Iterable[str]) -> None:
    """Refuse a folder, if there is one, in which what is to be written would take the place of what is read.

    Raises:
        InputError: naming what would be lost.
    """
    kept = set(map(os.path.realpath, read))
    if folder is not None and (hit := [name for name in names if os.path.realpath(folder / name) in kept]):
        refuse("--out", (str(folder), f"would be written over {', '.join(hit)}, which is read; name another folder"))


def another_file(json: Path | None, values: Iterable[Any]) -> list[tuple[str, str]]:
    """That the file of --json is one among some values, or one that these name: the problem, or none."""
    if json is None or os.path.realpath(json) not in {
        os.path.realpath(file) for path in _inside(list(values), Path) for file in (path, *named_files(path))
    }:
        return []
    return [("--json", f"{json} is another file of this command, which it would take the place of")]


T = TypeVar("T")


def _inside(value: Any, kind: type[T]) -> Iterator[T]:
    """All that is of a kind in tables and lists."""
    if isinstance(value, kind):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _inside(one, kind)


def named_files(path: Path) -> list[Path]:
    """A file, or the dataset.toml of a folder, with all files that it names and that are there, and what these name."""
    from beamdesign.records import InputError, read_table

    found, ahead = dict[str, Path](), [path / "dataset.toml" if path.is_dir() else path]
    while ahead:
        one = ahead.pop()
        # `isfile` takes names that no file can have; files that name each other would go on with ever longer paths.
        if not os.path.isfile(one) or (place := os.path.realpath(one)) in found:
            continue
        found[place] = one
        if one.suffix == ".toml":
            with suppress(InputError):  # what is wrong with it is told where it is read
                table = read_table(one)
                certificate = str(table.get("kind", "")).startswith("beamdesign.")  # which names none
                ahead += [one.parent / text for text in (() if certificate else _inside(table, str))]
    return list(found.values())


def refuse(source: str | Path, *problems: tuple[str, str]) -> NoReturn:
    """Raise an `InputError` with what is wrong, key and reason each; its room is loaded only for that."""
    from beamdesign.records import InputError

    raise InputError(source, problems)


_hushed = threading.Event()  # which threads share: one of them tells how far long work has got


def hush() -> None:
    """Print nothing for people from here on: `--quiet`. Errors are raised, not said."""
    _hushed.set()


def speak() -> None:
    """Undo `hush`."""
    _hushed.clear()


def shown(text: str) -> str:
    """Lines as a terminal may have them: control characters of names do nothing there."""
    return "\n".join(map(one_line, text.split("\n")))


def echo(*lines: str, before: str = "") -> None:
    """Print lines for people, `before` each the same. Where nobody reads on (`| head`), work goes on without a word."""
    for line in lines:
        _echo(shown(before + line))


def _echo(text: str) -> None:
    if not _hushed.is_set():
        _print(text)


def _print(text: str) -> None:
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def note(text: str) -> None:
    """Print a line for people on stderr, beside the answer."""
    if not _hushed.is_set():
        print(shown(text), file=sys.stderr, flush=True)


def echo_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], wrap: bool = True, every: bool = True
) -> list[str]:
    """Print a table; floats get four significant digits, seven in lines that are not wrapped. Styles go to terminals.

    Args:
        title: above it.
        columns: headings.
        rows: cells; those that are None stay empty.
        wrap: break cells so that the table has the width of the terminal.
        every: print every column that is not wrapped, however wide the terminal; so it is where there is none.

    Returns:
        the columns that were left out.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    if _hushed.is_set():
        return []
    digits, kept = 4 if wrap else 7, len(columns)
    texts = [[f"{v:.{digits}g}" if isinstance(v, float) else "" if v is None else str(v) for v in row] for row in rows]
    plain = "NO_COLOR" in os.environ or not sys.stdout.isatty()
    width, room = None if wrap else _WIDEST, shutil.get_terminal_size().columns
    console = Console(highlight=False, file=sys.stdout, color_system=None if plain else "auto", width=width)

    def table() -> Table:
        found = Table(title=Text(shown(title)), title_justify="left", box=box.SIMPLE_HEAD)
        for column in columns[:kept]:
            found.add_column(Text(shown(column)))
        for row in texts:
            found.add_row(*(Text(shown(cell)) for cell in row[:kept]))
        return found

    while not every and sys.stdout.isatty() and kept > 2 and console.measure(table()).maximum > room:
        kept -= 1
    with console.capture() as captured:
        console.print(table())
    _echo("\n".join(line.rstrip() for line in captured.get().rstrip().splitlines()) + "\n")
    return list(columns[kept:])


_WIDEST = 10_000  # characters of a line that is not wrapped


def write_json(path: Path | None, fields: Mapping[str, Any]) -> None:
    """Write fields as JSON, whole or not at all, or to standard output; nothing without a path."""
    if path == STANDARD_OUTPUT:
        _print(json_text(fields).rstrip())
    elif path is not None:
        write_whole(path, json_text(fields))


_TELLING = ("name", "rig", "controller", "effects", "arm")
"""Keys of a certificate that tell whose it is."""


def certificate_file(out: Path | None, prototype: Path, kind: str, suffix: str = "") -> Path:
    """Where a certificate of a kind is to go, asked before the work for it; that of a stage has its suffix in its name.

    Raises:
        InputError: where something stands there that is no certificate, or where no file can be written.
    """
    name = f"{prototype.stem}{suffix}.{kind}.toml"
    path = _need_folder("--out", Path(name), Path.cwd()) if out is None else out.with_suffix(suffix + out.suffix)
    if path.exists():
        _stated(path, _standing(path))
    return path


def write_certificate(path: Path, text: str) -> None:
    """Write a certificate and say so; one of another prototype there gets a name with its digest, which is said too.

    Raises:
        InputError: where something stands there that is no certificate.
    """
    if path.exists() and (standing := _standing(path)) != text.encode():
        older, new = _stated(path, standing), tomllib.loads(text)
        if any(older.get(key) != new.get(key) for key in _TELLING):
            aside = path.with_suffix(f".{hashlib.sha256(standing).hexdigest()[:8]}{path.suffix}")
            write_whole(aside, standing)
            echo(f"the certificate of {older.get('name', 'another prototype')} that stood there is now {aside}")
    write_whole(path, text)
    echo(f"certificate: {path}")


def _standing(path: Path) -> bytes:
    try:
        return read_bytes(path, _LARGEST)
    except OSError as error:
        refuse(path, ("(file)", f"{error.strerror}; name another file with --out"))


_LARGEST = 10**9  # bytes: whatever stands there is looked at


def _stated(path: Path, standing: bytes) -> dict[str, Any]:
    try:
        table = tomllib.loads(standing.decode())
    except (ValueError, RecursionError):
        table = {}
    if not str(table.get("kind", "")).startswith("beamdesign."):
        refuse(path, ("(file)", "exists and is no certificate; name another file with --out"))
    return table


EVERY_S = 30.0
"""From line to line."""


class Work:
    """What is being done, as the lines tell it."""

    def __init__(self, name: str):
        self.begun, self.name, self.share, self.words = time.monotonic(), name, 0.0, ""

    def line(self) -> str:
        """Share done, time taken, an estimate of what is left, and what is being done."""
        taken = time.monotonic() - self.begun
        parts = [f"{100 * self.share:.0f} % done"] if self.share > 0 else []
        parts.append(f"{in_words(taken)} so far")
        if 0.02 < self.share < 1:
            parts.append(f"about {in_words(taken * (1 / self.share - 1))} to go")
        return f"{self.name}: {', '.join(parts)}{f' ({self.words})' if self.words else ''}"


_works: list[Work] = []


def in_words(seconds: float) -> str:
    """A time in the unit in which one would say it."""
    for limit, unit, size in ((100, "s", 1), (6000, "min", 60)):
        if seconds < limit:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds / 3600:.1f} h"


@contextmanager
def lines(name: str, every_s: float = EVERY_S) -> Iterator[None]:
    """Print a line on the work in progress now and then for as long as the block runs, whatever its engine is at.

    Args:
        name: of the command, where nothing within it says what is being done.
        every_s: from line to line.
    """
    done = threading.Event()

    def tell() -> None:
        while not done.wait(every_s):
            note(_works[-1].line())

    before = list(_works)
    _works.append(Work(name))
    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
        _works[:] = before


@contextmanager
def reported(description: str) -> Iterator[Progress]:
    """Let the lines tell of this work while the block runs.

    Yields:
        update(share, words): the share done, 0 to 1, and a word on what is being done.
    """
    work = Work(description)

    def update(share: float, words: str = "") -> None:
        pass_on()
        work.share, work.words = share, words

    _works.append(work)
    try:
        yield update
    finally:
        _works.remove(work)


@contextmanager
def display(description: str) -> Iterator[Progress]:
    """Show a bar while the block runs; yields as `reported` does."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True, no_color="NO_COLOR" in os.environ)
    described, noted = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}"))
    columns = (described, BarColumn(), noted)
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(shown(description), total=1.0, note="")

        def update(share: float, words: str = "") -> None:
            pass_on()
            bar.update(task, completed=share, note=shown(words))

        yield update


def progress(description: str, expected: str = "") -> AbstractContextManager[Progress]:
    """How far work has got, on stderr, for as long as a `with` block runs, which is given `update(share, words)`.

    A bar on a terminal; elsewhere `lines` tells it, and before that a line how long it is expected to take, where that
    is given.
    """
    if expected and not sys.stderr.isatty():
        note(f"{description}: {expected} on an ordinary core; every half minute a line follows")
    bar = sys.stderr.isatty() and not _hushed.is_set() and os.environ.get("TERM") != "dumb"
    return display(description) if bar else reported(description)
