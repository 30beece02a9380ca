"""Measured data as people have them: CSV of any dialect, MATLAB and universal files, read as columns with units.

MATLAB files are read by SciPy, universal files (dataset 58) by pyUFF; both hand over arrays, names and units.
"""

import csv
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from io import StringIO
from math import pi, tau
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.files import LARGEST_TABLE, read_bytes
from beamdesign.records import InputError

_FEWEST, _LONGEST_UNIT, _ABBREVIATED, _SHOWN = 3, 6, 3, 80
_IN_NAME = re.compile(r"^(?P<name>.*?)\s*(?:[\[(]\s*(?P<unit>([^\[\]()]|\([^()]*\))*)[\])]|[,;:]\s+(?P<after>\S+))\s*$")
_IN_WORDS = re.compile(r"^(?P<name>.+?)\s+in\s+(?P<unit>\S+)\s*$")
NUMBER = re.compile(r"^\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][-+]?\d+)?\s*$|^\s*[-+]?(nan|inf)\s*$", re.IGNORECASE)
_TIME = r"\d?\d:\d\d:\d\d([.,]\d+)?"
_DAY = r"(\d{1,2}[./]\d{1,2}[./](\d{4}|\d\d)|\d{4}[./]\d{1,2}[./]\d{1,2})"
_CLOCK = re.compile(
    rf"^\s*(\d{{4}}-\d\d-\d\d([T ]{_TIME}Z?)?|({_DAY}[T ]\s*)?{_TIME}( ?[AP]M)?|{_DAY})\s*$", re.IGNORECASE
)
_NO_COLUMN = ("", "comment", "comments")  # what a row of names may have beyond the numbers
_VALUE = re.compile(f"{NUMBER.pattern}|{_CLOCK.pattern}", re.IGNORECASE)

_LBF = 4.4482216152605  # N
UNITS = {
    "s": {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "N": {"N": 1.0, "newton": 1.0, "newtons": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": _LBF, "lbs": _LBF, "kgf": 9.80665},
    "V": {"V": 1.0, "mV": 1e-3, "volt": 1.0, "volts": 1.0},
    "A": {"A": 1.0, "amp": 1.0, "amps": 1.0, "mA": 1e-3, "uA": 1e-6},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "inch": 0.0254, "inches": 0.0254, "mil": 2.54e-5}
    | dict.fromkeys(("micron", "microns"), 1e-6),
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "psi": 6894.757293168},
}
"""By SI unit what others are in it."""
SPELT = str.maketrans({"µ": "u", "μ": "u"})
"""Of letters in units, those that `UNITS` has in their place."""


def in_SI(text: str) -> tuple[str, float]:
    """The SI unit of what a unit measures, and what it is in it; words in capitals too; empty where it is not known."""
    spelt = text.translate(SPELT)
    ways = (spelt, spelt.lower()) if len(spelt) > _ABBREVIATED else (spelt,)
    return next(((unit, others[way]) for way in ways for unit, others in UNITS.items() if way in others), ("", 0.0))


def unit_of(text: str) -> str:
    """The SI unit of what a unit measures; empty where it is not known."""
    return in_SI(text)[0]


@dataclass(frozen=True)
class Column:
    """A column of numbers as it was read.

    Attributes:
        name: as the file has it.
        unit: as the file has it; empty where it states none.
        values: (N,)
    """

    name: str
    unit: str
    values: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class Response:
    """A frequency response as it was read.

    Attributes:
        name: of it.
        frequency_Hz: (N,)
        values: (N,) complex, answer over excitation.
        answer: displacement, velocity or acceleration.
        unit: of the answer over that of the excitation.
    """

    name: str
    frequency_Hz: np.ndarray = field(repr=False)
    values: np.ndarray = field(repr=False)
    answer: str
    unit: str


@dataclass(frozen=True)
class Measured:
    """What a file holds: columns of one length, or responses, or both; and columns of other lengths."""

    path: Path
    columns: tuple[Column, ...] = ()
    responses: tuple[Response, ...] = ()
    others: tuple[Column, ...] = ()


def read_measured(path: Path) -> Measured:
    """Read one file by its ending: .mat, .uff, .unv, .uf; anything else as text in columns.

    Raises:
        InputError: where nothing of use can be read from it, with what to do.
    """
    readers = {".mat": _matlab} | dict.fromkeys((".uff", ".unv", ".uf"), _universal)
    try:
        return readers.get(path.suffix.lower(), _text)(path)
    except OSError as error:
        raise InputError(path, [("(file)", error.strerror or str(error))]) from error


def _refuse(path: Path, reason: str) -> InputError:
    return InputError(path, [("(file)", reason)])


# Text.


def _text(path: Path) -> Measured:
    raw = read_bytes(path, LARGEST_TABLE)
    try:
        text = raw.decode("utf-16" if raw.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if "\0" in text:
        raise _refuse(path, "is not text: it holds zero bytes; MATLAB files end in .mat, universal ones in .uff")
    lines = [line for line in text.splitlines() if line.strip(" ")]
    while lines and not lines[-1].strip(" \t;,"):
        del lines[-1]
    remarks = [line.lstrip().startswith(("#", "%")) for line in lines]
    lines = [line.lstrip("#% ") for line in lines]
    often = {mark: sum(mark in line for line in lines[-50:]) for mark in ";\t,"}
    for mark in (*sorted((m for m in often if often[m]), key=lambda m: -often[m]), ""):
        rows = _parted(path, lines, mark)
        aside = remarks if len(rows) == len(lines) else [False] * len(rows)  # a cell in quotes may go on in a new line
        first = next((k for k, row in enumerate(rows) if len(row) > 1 and not aside[k] and _numbers(row)), None)
        if first is not None and len(rows) - first >= _FEWEST:
            break
    else:
        last = f"; its last line is {lines[-1][:_SHOWN]!r}" if lines else ""
        raise _refuse(path, f"holds no rows of numbers that commas, semicolons, tabs or blanks part{last}")
    width, clocks = len(rows[first]), [not NUMBER.match(cell) for cell in rows[first]]
    while first and len(rows[first - 1]) == width and not aside[first - 1] and _numbers(rows[first - 1], 1):
        first -= 1  # what is sampled less often may begin later
    names, units = _header(path, [row for row in rows[:first] if any(map(str.strip, row))], width)
    body = [
        [""] * width if beside else row  # of a row that is commented out the place counts, and nothing else
        for row, beside in zip(rows[first:], aside[first:], strict=True)
        if len(row) == width or not (beside or not any(map(str.strip, row)))
    ]
    kinds = [_CLOCK if clock else NUMBER for clock in clocks]
    for k, row in enumerate(body, start=1):
        if wrong := [cell for kind, cell in zip(kinds, row, strict=False) if cell.strip() and not kind.match(cell)]:
            what = f"no number, such as 1234.5 or 1.2345e3: {wrong[0]!r}"
            raise _refuse(path, f"row {k} of its numbers has a cell that is {what}")
        if len(row) != width:
            raise _refuse(path, f"row {k} of its numbers has {len(row)} cells of {width}")
    numbers = [cells for cells, clock in zip(zip(*body, strict=True), clocks, strict=True) if not clock]
    if all(any(decimal in cell for cells in numbers for cell in cells) for decimal in ".,"):
        raise _refuse(path, "has numbers with a decimal point and numbers with a comma: write thousands without one")
    try:
        columns = _columns(names, units, [row for row in body if any(map(str.strip, row))], clocks)
    except ValueError as error:
        raise _refuse(path, f"has a time of day or a date that there is not: {error}") from error
    if (response := _response_of(path, columns)) is not None:
        return Measured(path, responses=(response,))
    return Measured(path, columns if any(clocks) else _columns(names, units, body, clocks))


def _numbers(row: Sequence[str], least: int | None = None) -> bool:
    """Whether cells are numbers or times of day; where some may be blank, at least so many."""
    filled = [cell for cell in row if cell.strip()] if least else row
    return len(filled) >= (least or 1) and all(map(_VALUE.match, filled))


def _header(path: Path, above: Sequence[list[str]], width: int) -> tuple[list[str], list[str]]:
    """Names and units of columns by the rows above their numbers, one of units perhaps below one of names.

    Raises:
        InputError: where the last of these rows has more cells than the numbers have: a comment alone has no column.
    """
    none = (len(row) == width + 1 and row[-1].strip().lower() in _NO_COLUMN for row in above)
    heads = [row[:width] for row, comment in zip(above, none, strict=True) if comment or len(row) == width]
    if above and len(above[-1]) > width and (not heads or heads[-1] != above[-1][:width]):
        reason = f"has {len(above[-1])} cells right above its numbers, whose rows have {width}"
        raise _refuse(path, f"{reason}: put names in quotes that hold the mark between columns")
    if not heads:
        return [f"column {k + 1}" for k in range(width)], [""] * width
    below = [cell.strip().strip("[]()") for cell in heads[-1]]
    named = len(heads) > 1 and all(name.strip() for name, unit in zip(heads[-2], below, strict=True) if unit)
    if named and all(len(cell) <= _LONGEST_UNIT or unit_of(cell) for cell in below):
        return heads[-2], below
    return heads[-1], [""] * width


def _columns(
    names: Sequence[str], units: Sequence[str], rows: Sequence[Sequence[str]], clocks: Sequence[bool]
) -> tuple[Column, ...]:
    """Columns of rows of cells, times of day in seconds."""
    each = zip(names, units, clocks, zip(*rows, strict=True), strict=True)
    found = ((clock, _column(name, unit, (_seconds if clock else numbers_of)(own))) for name, unit, clock, own in each)
    return tuple(replace(column, unit="s") if clock else column for clock, column in found)


_OF_RESPONSE = {
    "frequency": r"^freq|^fréq|^omega$",
    "magnitude": r"^mag|gain|abs|modul|betrag|compliance|receptance|mobility|accelerance|inertance|frf|^h$",
    "phase": r"phase|angle|winkel",
    "real": r"^re$|^re[ _]|real",
    "imaginary": r"^im$|^im[ _]|imag",
}
_TURNS = {"": pi / 180, "deg": pi / 180, "°": pi / 180, "degrees": pi / 180, "rad": 1.0}
_DERIVED = {r"^g/|/s(\^?2|²|/s)/|accelerance|inertance": "acceleration", "/s/|mobility": "velocity"}
_ANOTHERS = re.compile("coher|inner", re.IGNORECASE)
"""In the name of a column of another quantity, or of another point than the outer tip."""


def _response_of(path: Path, columns: Sequence[Column]) -> Response | None:
    """A frequency response in columns: magnitude (in dB too) and phase, or real and imaginary part; None for a record.

    Raises:
        InputError: where there are frequencies, and what stands beside them cannot be told.
    """
    split = [replace(c, name=c.name[: -len(end[0])], unit=end[1]) if (end := _end(c)) else c for c in columns]
    part = {
        which: [c for c in split if re.search(pattern, c.name, re.IGNORECASE) and not _ANOTHERS.search(c.name)]
        for which, pattern in _OF_RESPONSE.items()
    }
    if not part["frequency"] or any(re.search("^t$|time|^zeit", c.name, re.IGNORECASE) for c in columns):
        return None
    there = ", ".join(f"{c.name} [{c.unit}]" for c in split)
    for which, found in part.items():
        if len(found) > 1:
            names = " or ".join(repr(c.name) for c in found)
            reason = f"has frequencies, and its {which} may be {names}: leave the response of the outer tip alone in it"
            raise _refuse(path, reason)
    frequency, magnitude, phase, real, imaginary = (next(iter(found), None) for found in part.values())
    assert frequency is not None
    per_Hz, turn = _HERTZ.get(frequency.unit.lower(), 1.0), 1.0
    if frequency.unit.lower() not in ("", "hz", *_HERTZ):
        raise _refuse(path, f"has frequencies in {frequency.unit!r}; known are Hz, kHz, rad/s, rpm and cpm")
    if phase is not None and (turn := _TURNS.get(phase.unit.lower(), 0.0)) == 0:
        raise _refuse(path, f"has phases in {phase.unit!r}; known are deg and rad")
    values: np.ndarray
    if real is not None and imaginary is not None and real.unit == imaginary.unit:
        name, unit, values = real.name, real.unit, real.values + 1j * imaginary.values
    elif magnitude is not None:
        name, unit, values = magnitude.name, magnitude.unit, magnitude.values
        if unit.lower().startswith("db"):
            name, unit = f"{name} in dB", re.sub(r"^db\s*(re\.?)?\s*1?\s*", "", unit, flags=re.IGNORECASE)
            values = 10 ** (values / 20)
        elif np.any(values < 0):
            raise _refuse(path, f"has negative values of {name!r}: state its unit where these are decibels")
        values = values if phase is None else values * np.exp(1j * turn * phase.values)
    else:
        raise _refuse(path, f"has frequencies, but neither a magnitude nor a real and an imaginary part: {there}")
    if not (np.isfinite(values).all() and np.isfinite(frequency.values).all() and np.all(np.abs(values) > 0)):
        raise _refuse(path, "has a response that is zero or not finite at some of its frequencies")
    unit = re.sub("[()]", "", unit)
    says = f"{unit}/" if unit else name  # what a response is called counts where it states no unit
    kinds = (kind for pattern, kind in _DERIVED.items() if re.search(pattern, says, re.IGNORECASE))
    answer = next(kinds, "displacement")
    order = np.argsort(frequency.values)
    return Response(name, per_Hz * frequency.values[order], values[order], answer, unit)


def _end(column: Column) -> tuple[str, str] | None:
    """What the name of a column of a response ends in that is a unit, and how that is written otherwise."""
    found = None if column.unit else re.search(r"_(k?Hz|rad_per_s|rad|deg|dB|[mu]?m_per_[NV])$", column.name)
    return (found[0], found[1].replace("_per_", "/")) if found else None


def _parted(path: Path, lines: list[str], mark: str) -> list[list[str]]:
    """Cells of lines that a mark parts; blanks where it is empty, of which names that hold one have more between."""
    if not mark:
        width = len(lines[-1].split()) if lines else 0
        wide = (re.split(r"\s{2,}", line.strip()) for line in lines)
        return [cells if len(cells) == width else line.split() for cells, line in zip(wide, lines, strict=True)]
    try:
        rows = list(csv.reader(StringIO("\n".join(lines)), delimiter=mark))
    except csv.Error as error:
        raise _refuse(path, f"is no table: {error}") from error
    if any(row[-1].strip() for row in rows[-_FEWEST:]):
        return rows
    return [row if row[-1].strip() else row[:-1] for row in rows]  # they end with a mark, that of the names perhaps not


def numbers_of(cells: Sequence[str]) -> np.ndarray:
    """Of cells of text, with decimal commas or Fortran's exponents too; NaN where one is blank."""
    return np.array([float(cell.replace(",", ".").upper().replace("D", "E").strip() or "nan") for cell in cells])


def _seconds(cells: Sequence[str]) -> np.ndarray:
    """Since the first, of dates or dates and times by ISO 8601, and of times of day, over midnight too.

    Of days written otherwise nothing tells which number is the month; nor is it needed beside times of day.
    """
    plain = [cell.strip().upper().removesuffix("Z").replace(",", ".") for cell in cells]
    dated, halved = "-" in plain[0], plain[0].endswith("M")
    if not dated:
        times_of_day = (re.sub(rf"^{_DAY}([T ]\s*|$)| ?[AP]M$", "", cell) or "00:00:00" for cell in plain)
        plain = [f"2000-01-01 {'0' * (time[1] == ':')}{time}" for time in times_of_day]
    times = [datetime.fromisoformat(cell) for cell in plain]
    since = np.array([(time - times[0]).total_seconds() for time in times])
    return since if dated else np.unwrap(since, period=43200.0 if halved else 86400.0)


def _column(name: str, unit: str, values: np.ndarray) -> Column:
    """A column whose name may hold its unit, as in `Force [N]`, `Force (N)`, `Force, N` or `Force in N`."""
    name = name.strip().strip("\"'")
    if not unit and (found := _IN_NAME.match(name)) and not (found["unit"] or "").isdigit():  # as a matrix counts them
        name, unit = found["name"], (found["unit"] or found["after"] or "").strip()
    elif not unit and (found := _IN_WORDS.match(name)) and unit_of(found["unit"]):  # and not `Force in z`
        name, unit = found["name"], found["unit"]
    return Column(name, unit, values)


# MATLAB.


def _matlab(path: Path) -> Measured:
    from scipy.io import loadmat

    try:
        found = loadmat(path, squeeze_me=True, simplify_cells=True)
    except NotImplementedError as error:
        raise _refuse(path, "is a MATLAB file of version 7.3: save it with `save(name, ..., '-v7')`") from error
    except Exception as error:  # whatever the reader raises of a file that is cut or damaged
        raise _refuse(path, f"is no MATLAB file that can be read: {error}") from error
    arrays = dict(_arrays(found))
    if not (lengths := [len(one) for one in arrays.values()]):
        raise _refuse(path, "holds no vectors of numbers")
    most = max(set(lengths), key=lengths.count)
    columns = [_column(name, "", values) for name, values in arrays.items()]
    alike, others = (tuple(c for c in columns if (len(c.values) == most) is same) for same in (True, False))
    return Measured(path, alike, others=others)


def _arrays(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Vectors of a file and of the structures in it, by name."""
    for name, value in table.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind == "c" and not np.any(value.imag):
            yield from _arrays({name: value.real}, prefix)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 1 and len(value) >= _FEWEST:
            yield prefix + name, value.astype(float)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 2:
            for k in range(value.shape[1] if value.shape[0] >= _FEWEST else 0):
                yield f"{prefix}{name}({k + 1})", value[:, k].astype(float)


# Universal files.


_ANSWERS = {8: "displacement", 11: "velocity", 12: "acceleration"}
_TIME_RECORD, _FREQUENCY_RESPONSE = 1, 4
_HERTZ = {"rad/s": 1 / tau, "rpm": 1 / 60, "cpm": 1 / 60, "khz": 1e3}


def _universal(path: Path) -> Measured:
    try:
        from pyuff import UFF
    except ModuleNotFoundError as error:
        raise _refuse(path, "a universal file is read by pyUFF: pip install 'beamdesign[uff]'") from error
    read_bytes(path, LARGEST_TABLE)  # that it is there, and not too large
    try:
        found = UFF(str(path)).read_sets()
    except Exception as error:  # whatever a reader of a loose format raises
        raise _refuse(path, f"is no universal file that pyUFF can read: {error}") from error
    sets = [one for one in ([found] if isinstance(found, dict) else found) if one.get("type") == 58]
    columns, responses = list[Column](), list[Response]()
    for k, one in enumerate(sets):
        name = str(one.get("id1") or "").strip() or f"function {k + 1}"
        name += "" if name not in {c.name for c in columns} | {r.name for r in responses} else f" ({k + 1})"
        labels = (str(one.get(f"{part}_axis_units_lab") or "").strip() for part in ("ordinate", "orddenom"))
        unit, x = "/".join(label for label in labels if label.upper() not in ("", "NONE")), np.asarray(one["x"], float)
        axis = str(one.get("abscissa_axis_units_lab") or "").strip()
        answer, over = _ANSWERS.get(one.get("ordinate_spec_data_type", 0)), one.get("orddenom_spec_data_type")
        if one["func_type"] == _FREQUENCY_RESPONSE and answer and over not in _ANSWERS:
            responses.append(Response(name, _HERTZ.get(axis.lower(), 1.0) * x, np.asarray(one["data"]), answer, unit))
        elif one["func_type"] == _TIME_RECORD:
            if not columns:
                columns.append(Column("time", axis if unit_of(axis) == "s" else "s", x))
            if not np.array_equal(x, columns[0].values):
                raise _refuse(path, f"has {name} at other times than the first record: give each a file of its own")
            columns.append(Column(name, unit, np.asarray(one["data"]).real.astype(float)))
    if not columns and not responses:
        raise _refuse(path, "holds no time record and no frequency response of a motion to a force (dataset 58)")
    return Measured(path, tuple(columns), tuple(responses))
