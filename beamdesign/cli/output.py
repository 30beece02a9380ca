"""What every command prints and writes: tables for people, JSON for programs, ranges as LO:HI."""

import csv
import json
import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer

JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result to this JSON file as well.")]
RangeOption = Annotated[
    str | None, typer.Option("--outer-end-mass", metavar="LO:HI", help="Range of mass on the outer tip, kg.")
]


def say(text: str) -> None:
    """Print a line for people; rich markup is understood, colours go only to terminals."""
    from rich.console import Console

    Console(highlight=False, soft_wrap=True).print(text)


def say_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Print a table; floats get four significant digits."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row))
    Console(highlight=False).print(table)


def _plain(value: Any) -> Any:
    """JSON has no infinity: non-finite figures become null."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float):
        return value if isfinite(value) else None
    return value


def write_json(path: Path | None, fields: dict[str, Any]) -> None:
    """Write fields as JSON, whole or not at all; nothing without a path."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(_plain(fields), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    os.replace(partial, path)


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write rows as CSV; columns in order of first appearance, absent cells empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def mass_range(text: str | None, default: tuple[float, float] | None, source: str | Path) -> tuple[float, float]:
    """The range of outer end masses in kg, from LO:HI or else from the prototype's payload.

    Raises:
        InputError: where neither gives a range of finite masses from zero up.
    """
    from beamdesign.records import InputError

    if text is None:
        if default is None:
            raise InputError(
                source, [("payload.outer_end_mass_kg", "missing; give it there or as --outer-end-mass LO:HI")]
            )
        return default
    parts = text.split(":")
    try:
        low, high = (float(part) for part in parts)
    except ValueError:
        raise InputError("--outer-end-mass", [(text, "expected two masses in kg as LO:HI, such as 0:6.8")]) from None
    if not (isfinite(low) and isfinite(high)):
        raise InputError("--outer-end-mass", [(text, "both masses must be finite")])
    if low < 0:
        raise InputError("--outer-end-mass", [(text, "a mass cannot be negative")])
    if low > high:
        raise InputError("--outer-end-mass", [(text, f"empty mass range: {low:g} is above {high:g}")])
    return low, high


def progress(description: str) -> AbstractContextManager[Any]:
    """A bar on stderr for as long as a `with` block runs, which is given `update(share_done, words)`."""
    from beamdesign.cli.progress import display

    return display(description)
