"""CSV files: those of numbers read, and where something is wrong said where; tables written."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO, StringIO, TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.files import LARGEST_TABLE, read_bytes, write_whole
from beamdesign.records import InputError, Problem
from beamdesign.spelling import fault, in_csv

LARGEST = {
    "s": (1e10, 1e6), "N": (1e7, 1.0), "V": (1e3, 1e3), "A": (100.0, 1e6), "m": (10.0, 1e6), "Pa": (1e9, 1.0),
    "Hz": (1e6, 1.0), "m_per_N": (1.0, 1e6), "m_per_V": (10.0, 1e6), "deg": (1e6, 1.0),
}  # fmt: skip
"""By unit of a column: what no rig goes beyond (times may count from 1970), and how much larger it may be written.

Figures in millimetres are for an examination to tell, which knows the rig.
"""
INTERVALS_S = (1e-6, 0.025)
"""Least and largest interval between samples: modes of 10 Hz need 50 samples a second, recorders make a million."""
_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6, "minutes": 60.0, "days, as spreadsheets count": 86_400.0}
_OFF_PLACE = 0.26  # of a sample interval; times are written with few digits
_FEWEST = 3
_SHOWN = 24


Spared = Callable[[str, Mapping[str, np.ndarray]], np.ndarray]
"""Of a column's name and all columns (N,): where its cells are not to count."""


def read_columns(path: Path, only: Sequence[str] = (), spared: Spared | None = None) -> dict[str, np.ndarray]:
    """Read a CSV file of numbers with one line of column names.

    Names may stand in quotes; a byte order mark and any line ends are understood.

    Args:
        path: of the file.
        only: the columns that count, as far as they are there, whatever stands in the others; all where empty.
        spared: tells where cells may be empty or no plausible number; what is no number there is NaN.

    Raises:
        InputError: naming file, column and row where something is not a finite number or beyond `LARGEST`, or where
            the file is no regular one, is too large, or has no rows.
    """
    try:
        text = TextIOWrapper(BytesIO(read_bytes(path, LARGEST_TABLE)), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise InputError(path, [("(file)", f"is not text in UTF-8: {error.reason}")]) from error
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise InputError(path, [("(file)", getattr(error, "strerror", None) or str(error))]) from error
    if not text.strip():
        raise InputError(path, [("(file)", "is empty")])
    header, _, body = text.partition("\n")
    names = _names(path, header)
    if not body.strip():
        raise InputError(
            path, [("(file)", "holds no rows below the column names; fill it in, or leave out what names it")]
        )
    if "\0" in body:
        raise InputError(path, [("(file)", "is not text: it holds zero bytes")])
    used = [name for name in names if not only or name in only]
    columns = _numbers(path, _EMPTY.sub("nan", body) if spared else body, names, used)
    wrong = []
    for name in used:
        counts = ~spared(name, columns) if spared else np.ones(len(columns[name]), dtype=bool)
        wrong += _impossible(name, columns[name], counts, body)
    if wrong:
        raise InputError(path, wrong)
    return columns


_EMPTY = re.compile(r"(?<=,)(?=[ \t]*(?:,|\r?$))|^(?=[ \t]*,)", re.MULTILINE)


def _numbers(path: Path, body: str, names: list[str], used: list[str]) -> dict[str, np.ndarray]:
    """The columns that count, with row and column of what cannot be read."""
    if not used:
        return {}
    picked = None if used == names else [names.index(name) for name in used]
    try:
        values = np.loadtxt(StringIO(body), delimiter=",", ndmin=2, comments=None, usecols=picked)
    except ValueError:
        raise InputError(path, _bad_cells(names, body, used)) from None
    if values.shape[1] != len(used):
        raise InputError(path, _bad_cells(names, body, used))
    return {name: values[:, k].copy() for k, name in enumerate(used)}


def _impossible(name: str, values: np.ndarray, counts: np.ndarray, body: str) -> list[Problem]:
    """What is wrong with the figures of a column where they count, whatever the rig."""
    bad = np.nonzero(counts & ~np.isfinite(values))[0]
    if len(bad):
        count = "1 value is" if len(bad) == 1 else f"{len(bad)} values are"
        return [Problem(name, f"{count} not finite, the first in row {_row_of(body, int(bad[0]))}")]
    unit = max((unit for unit in LARGEST if name.endswith(f"_{unit}")), key=len, default=None)
    if unit is None:
        return []
    largest, finer = LARGEST[unit]
    beyond = np.nonzero(counts & (np.abs(values) > largest * finer))[0]
    if not len(beyond):
        return []
    others = "" if len(beyond) == 1 else f", as are {len(beyond) - 1} more beyond what is possible"
    where = f"row {_row_of(body, int(beyond[0]))} is {values[beyond[0]]:g}{others}"
    scale = unit.replace("_per_", "/")
    return [Problem(name, f"{where}: from {-largest:g} to {largest:g} {scale} is plausible")]


def _names(path: Path, header: str) -> list[str]:
    names = [name.strip().strip("\"'").strip() for name in header.split(",")]
    if len(names) == 1:
        for mark, word in ((";", "semicolons"), ("\t", "tabs")):
            if mark in header:
                reason = f"columns are separated by {word}: use commas, and points in numbers"
                raise InputError(path, [("(file)", reason)])
    if all(_number(name) is not None for name in names):
        raise InputError(path, [("(file)", "row 1 holds numbers: the column names are missing")])
    if "" in names:
        more = ": it ends with a comma" if names[-1] == "" else ""
        raise InputError(path, [("(file)", f"column {names.index('') + 1} has no name in row 1{more}")])
    if unfit := [Problem(name, reason) for name in names if (reason := fault(name))]:
        raise InputError(path, unfit)
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise InputError(path, [(name, "stands twice in row 1") for name in dict.fromkeys(twice)])
    return names


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _row_of(body: str, position: int) -> int:
    """Row in the file, from 1 with the header, of the position-th line of numbers."""
    filled = [row for row, line in enumerate(body.splitlines(), start=2) if line.strip()]
    return filled[position]


def _bad_cells(names: list[str], body: str, used: Sequence[str]) -> list[Problem]:
    """The first row that cannot be read, in words."""
    for row, line in enumerate(body.splitlines(), start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(names):
            found = "1 cell" if len(cells) == 1 else f"{len(cells)} cells"
            return [Problem("(file)", f"row {row} has {found}, the header {len(names)}{_why(cells, names)}")]
        for name, cell in zip(names, cells, strict=True):
            # What Python takes for a number and a table does not: 1_000.
            if name in used and (_number(cell) is None or "_" in cell):
                shown = repr(cell.strip().strip('"')[:_SHOWN]) if cell.strip() else "empty"
                return [Problem(name, f"row {row} is not a number: {shown}")]
    return [Problem("(file)", "cannot be read as numbers")]


def _why(cells: list[str], names: list[str]) -> str:
    if len(cells) == len(names) + 1 and not cells[-1].strip():
        return ": it ends with a comma"
    if any(mark in cells[0] for mark in (";", "\t")):
        return ": cells are separated by commas"
    if len(cells) == 2 * len(names):
        return ": are decimals written with commas? They need points"
    return ""


def csv_text(rows: Sequence[Mapping[str, Any]], end: str = "\r\n") -> str:
    """Rows as CSV with a line of column names, in order of first appearance; absent cells are empty."""
    text = StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator=end)
    writer.writeheader()
    writer.writerows({key: in_csv(value) for key, value in row.items()} for row in rows)
    return text.getvalue()


def uniform_times(path: Path, times: np.ndarray, longest_s: float = INTERVALS_S[1]) -> np.ndarray:
    """(N,) times in exactly equal steps; refuses such as do not rise in equal ones, or in none of a recorder's.

    Args:
        path: of the file they are from.
        times: (N,) s.
        longest_s: largest interval of a recorder.

    Raises:
        InputError: naming the first row at which they do not, or the unit they seem to be in.
    """
    if reason := _uneven(times, longest_s):
        raise InputError(path, [("t_s", reason)])
    return np.linspace(times[0], times[-1], len(times))


def unrising(times: np.ndarray) -> str:
    """Where times do not rise, in words; empty where they do."""
    steps = np.diff(times)
    back = np.nonzero(steps <= 0)[0]
    if not len(back):
        return ""
    row = int(back[0]) + 3
    held = "repeats" if steps[back[0]] == 0 else "goes back from"
    return f"does not rise: row {row} {held} the time of row {row - 1}"


def _uneven(times: np.ndarray, high: float) -> str:
    """What keeps times from being those of a recorder; empty where nothing does."""
    if len(times) < _FEWEST:
        return f"too short: {len(times)} samples"
    if reason := unrising(times):
        return reason
    steps = np.diff(times)
    typical = float(np.median(steps))
    low = INTERVALS_S[0]
    if not low <= typical <= high:
        meant = [unit for unit, seconds in _TIMES.items() if 10 * low <= typical * seconds <= high]
        question = f": are these {meant[0]}?" if meant else ":"
        return f"steps of {typical:.3g} s{question} From {low:g} to {high:g} s is plausible"
    gap = np.nonzero(steps > 1.5 * typical)[0]
    if len(gap) and len(gap) < 0.1 * len(steps):
        row, lost = int(gap[0]) + 3, round(float(steps[gap[0]]) / typical) - 1
        more = f", and {len(gap) - 1} more gaps" if len(gap) > 1 else ""
        word = "sample is" if lost == 1 else "samples are"
        return f"not uniform: {lost} {word} missing before row {row} ({times[row - 2]:g} s){more}"
    should = np.linspace(times[0], times[-1], len(times))  # what counts is how far a sample is from where it should be
    off = np.abs(times - should) / float(should[1] - should[0])
    bad = np.nonzero(off > _OFF_PLACE)[0]
    if len(bad):
        return f"not uniform: row {int(bad[0]) + 2} is {off[bad[0]]:.2g} samples off its place"
    return ""


def write_tables(tables: Mapping[str, tuple[tuple[str, ...], np.ndarray]], folder: Path) -> list[Path]:
    """Write one CSV file per table of columns (C) and samples (N, C), named after it, each whole or not at all.

    Raises:
        OSError: naming what cannot be written.
    """
    paths = [folder / f"{name}.csv" for name in tables]
    for (columns, table), path in zip(tables.values(), paths, strict=True):
        text = StringIO()
        formats = ["%.15g" if name == "t_s" else "%.9g" for name in columns]  # times may count from 1970
        np.savetxt(text, table, fmt=formats, delimiter=",", header=",".join(columns), comments="")
        write_whole(path, text.getvalue())
    return paths


_UNRECORDED = {"current_A": "; if it was not recorded, state current_recorded = false of the record"}


def refuse_missing(path: Path, needed: tuple[str, ...], columns: Mapping[str, np.ndarray]) -> None:
    """Refuse a file without a column it needs; one of the same quantity in another unit is pointed at."""
    problems = []
    for name in (name for name in needed if name not in columns):
        stem, _, unit = name.partition("_")
        alike = [other for other in columns if other.partition("_")[0].lower() == stem and other not in needed]
        there = f"{alike[0]}: give it in {unit}, as {name}" if alike else ", ".join(columns)
        problems.append(Problem(name, f"column missing; the file has {there}{_UNRECORDED.get(name, '')}"))
    if problems:
        raise InputError(path, problems)
