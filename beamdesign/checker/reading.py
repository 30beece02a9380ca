"""Strict reading of a certificate: numbers by one grammar, every key asked for, limits before any work is done."""

import hashlib
import re
import tomllib
from collections.abc import Iterator, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any

from flint import fmpq, fmpq_poly

from beamdesign.checker.roots import Pair
from beamdesign.checker.work import Unreadable

LARGEST_BYTES = 8_000_000
DEEPEST = 32
LONGEST_FIGURE, LONGEST_NUMBER = 700, 3_000
"""Characters of a figure that stands alone, the decimals of the least float among them, and of a coefficient."""
LONGEST_LIST = 64
"""Entries of a list: coefficients of a polynomial, entries of a row of a matrix, ranges, claims."""
HIGHEST_DEGREE = 60
"""Of the polynomials of a loop, and of its controller."""
LONGEST_WORDS = 20_000
"""Characters of a text that is no number, and entries of a list of such."""

LARGEST_WHOLE = 2**63
"""Of TOML's whole numbers: a longer one, as hexadecimals may be, is not even printed."""

_NUMBER = re.compile(r"-?[0-9]+(\.[0-9]+)?|-?[0-9]+/[0-9]*[1-9][0-9]*", re.ASCII)
_PART = r"""(?:[\w-]++|"(?:\\.|[^"\\\n])*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w\\-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}", re.ASCII)
"""A dotted key that nests deeper than anything may: `tomllib` takes hours for a long one."""
_SEAL = re.compile(r'^sha256 = "([0-9a-f]{64})"\n', re.MULTILINE)


def rational(text: Any, place: str = "an entry", longest: int = LONGEST_FIGURE) -> fmpq:
    """A decimal or a quotient p/q of ASCII digits, exactly: nothing before, between or behind them but one sign.

    Raises:
        Unreadable: for anything else.
    """
    if not isinstance(text, str) or len(text) > longest or not _NUMBER.fullmatch(text):
        raise Unreadable(f"{place} is not a decimal or a quotient in quotes: {str(text)[:60]!r}")
    above, _, below = text.partition("/")
    whole, _, decimals = above.partition(".")
    return fmpq(int(whole + decimals), int(below) if below else 10 ** len(decimals))


class Table:
    """A table of a certificate, from which every entry has to be taken.

    Each of its methods raises Unreadable where an entry is missing or not what it has to be.
    """

    def __init__(self, entries: Any, place: str = "") -> None:
        if not isinstance(entries, dict):
            raise Unreadable(f"{place} must be a table")
        self._entries: dict[str, Any] = entries
        self.place = place
        self._left = set(entries)
        self._inner: list[Table] = []

    def __contains__(self, key: str) -> bool:
        return key in self._entries

    @property
    def keys(self) -> tuple[str, ...]:
        """Its keys, as they are written."""
        return tuple(self._entries)

    def place_of(self, key: str) -> str:
        """Where an entry stands, in words."""
        return f"{self.place}.{key}".lstrip(".")

    def take(self, key: str) -> Any:
        """An entry as it is."""
        if key not in self._entries:
            raise Unreadable(f"{self.place_of(key)} is missing")
        self._left.discard(key)
        return self._entries[key]

    def number(self, key: str) -> fmpq:
        """A number."""
        return rational(self.take(key), self.place_of(key))

    def at_least(self, key: str, least: int, above: bool = False) -> fmpq:
        """A number that is not below a bound, or above it."""
        value = self.number(key)
        if value < least or (above and value == least):
            raise Unreadable(f"{self.place_of(key)} must be {'above' if above else 'at least'} {least}")
        return value

    def entries(self, key: str) -> list[Any]:
        """A list."""
        value = self.take(key)
        if not isinstance(value, list) or len(value) > LONGEST_LIST:
            raise Unreadable(f"{self.place_of(key)} must be a list of at most {LONGEST_LIST} entries")
        return value

    def numbers(self, key: str, count: int | None = None) -> list[fmpq]:
        """A list of numbers, of so many where that is given."""
        values = [rational(value, self.place_of(key), LONGEST_NUMBER) for value in self.entries(key)]
        if count is not None and len(values) != count:
            raise Unreadable(f"{self.place_of(key)} must be {count} numbers")
        return values

    def rows(self, key: str) -> list[list[fmpq]]:
        """A list of lists of numbers."""
        return [Table({"row": row}, self.place_of(key)).numbers("row") for row in self.entries(key)]

    def polynomial(self, key: str) -> fmpq_poly:
        """Coefficients of s^0, s^1, ..."""
        return fmpq_poly(self.numbers(key))

    def range(self, key: str, least: int | None = None) -> Pair:
        """Two numbers, the first not above the second, and neither below a bound."""
        values = self.numbers(key)
        if len(values) != 2 or values[0] > values[1] or (least is not None and values[0] < least):
            bound = "" if least is None else f", none below {least}"
            raise Unreadable(f"{self.place_of(key)} must be a range [least, most]{bound}")
        return values[0], values[1]

    def word(self, key: str, *among: str, longest: int = LONGEST_WORDS) -> str:
        """A text, one of some where they are given."""
        value = self.take(key)
        if not isinstance(value, str) or len(value) > longest:
            raise Unreadable(f"{self.place_of(key)} must be a text of at most {longest} characters")
        if among and value not in among:
            raise Unreadable(f"{self.place_of(key)} {value[:60]!r} is not known here; known are {', '.join(among)}")
        return value

    def words(self, key: str) -> list[str]:
        """A list of texts."""
        values = self.take(key)
        good = isinstance(values, list) and len(values) <= LONGEST_WORDS
        if not good or not all(isinstance(value, str) for value in values):
            raise Unreadable(f"{self.place_of(key)} must be a list of at most {LONGEST_WORDS} texts")
        return list(values)

    def flag(self, key: str) -> bool:
        """Yes or no."""
        value = self.take(key)
        if not isinstance(value, bool):
            raise Unreadable(f"{self.place_of(key)} must be true or false")
        return value

    def whole(self, key: str, least: int, most: int) -> int:
        """A whole number within bounds, which stands without quotes."""
        value = self.take(key)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise Unreadable(f"{self.place_of(key)} must be a whole number from {least} to {most}")
        return value

    def table(self, key: str) -> "Table":
        """A table within this one."""
        inner = Table(self.take(key), self.place_of(key))
        self._inner.append(inner)
        return inner

    def optional(self, key: str) -> "Table":
        """A table within this one, empty where there is none."""
        return self.table(key) if key in self else Table({}, self.place_of(key))

    def tables(self, key: str) -> "list[Table]":
        """Tables in a list, none where there is no such list."""
        if key not in self:
            return []
        found = [Table(value, f"{self.place_of(key)}[{k}]") for k, value in enumerate(self.entries(key), start=1)]
        self._inner += found
        return found

    def done(self) -> None:
        """Refuse what nothing has asked for, here and in the tables within."""
        if self._left:
            left = ", ".join(map(self.place_of, sorted(self._left)))
            raise Unreadable(f"not known in a certificate of this kind: {left[:300]}")
        for inner in self._inner:
            inner.done()

    def again(self) -> "Table":
        """The same entries, of which none has been taken."""
        return Table(self._entries, self.place)

    def whole_of_it(self) -> Any:
        """All entries as they stand, for comparison."""
        self._left.clear()
        return self._entries


def read(data: bytes) -> tuple[Table, str]:
    """The table of a certificate and its text.

    Raises:
        Unreadable: where it is not one, or beyond the limits.
    """
    try:
        entries, text = toml(data)
    except Unreadable as error:
        raise Unreadable(f"not a certificate: {error}") from error
    return Table(entries), text


def toml(data: bytes) -> tuple[dict[str, Any], str]:
    """The tables of a file and its text.

    Raises:
        Unreadable: where it is not TOML, or beyond the limits.
    """
    if len(data) > LARGEST_BYTES:
        raise Unreadable(f"it holds more than {LARGEST_BYTES} bytes")
    try:
        text = data.decode("utf-8")
        if _LONG_KEY.search(text):
            raise Unreadable(f"it is nested more than {DEEPEST} deep")
        entries = tomllib.loads(text)
        _refuse_beyond(entries, 1)
    except (RecursionError, MemoryError) as error:
        raise Unreadable("it is nested too deeply") from error
    except ValueError as error:  # an integer of thousands of digits is a plain one
        raise Unreadable(str(error)[:200]) from error
    return entries, text


def _refuse_beyond(value: Any, depth: int) -> None:
    if depth > DEEPEST:
        raise Unreadable(f"it is nested more than {DEEPEST} deep")
    if isinstance(value, int) and abs(value) > LARGEST_WHOLE:
        raise Unreadable("it holds a whole number of more than 64 bits")
    inner: Sequence[Any] = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else ()
    for item in inner:
        _refuse_beyond(item, depth + 1)


def sealed(table: Table, text: str) -> tuple[bool, str]:
    """Whether the text is as it was written: its digest is of itself without the line that states it."""
    stated = table.word("sha256")
    lines = _SEAL.findall(text)
    digest = hashlib.sha256(_SEAL.sub("", text).encode()).hexdigest()
    intact = lines == [stated] and digest == stated
    return intact, "the text is as it was written" if intact else "the text was altered after it was written (sha256)"


Statements = Iterator[tuple[bool, str]]
"""Of a certificate: whether each was proved, and it or its failure in words."""


def judged(found: bool, words: str, stated: bool = True) -> tuple[bool, str]:
    """Whether a statement was proved, and it in words or its failure.

    Args:
        found: whether what it is about holds.
        words: what it is about.
        stated: whether the certificate says that it does.
    """
    if found is not stated:
        return False, f"{'not proved' if stated else 'holds after all'}: {words}"
    return True, words if stated else f"refuted: {words}"


def short(value: fmpq, up: bool | None = None, digits: int = 7) -> str:
    """A number with few digits, for words: no less than it, or no more, where only that was proved."""
    if up is None:
        return f"{int(value.p) / int(value.q):.{digits}g}"
    towards = Context(prec=digits, rounding=ROUND_CEILING if up else ROUND_FLOOR)
    return f"{float(towards.divide(Decimal(int(value.p)), Decimal(int(value.q)))):.{digits}g}"


def span(pair: Pair, between: str = " to ") -> str:
    """A range, likewise, no wider than it is."""
    low, high = short(pair[0], up=True), short(pair[1], up=False)
    return between.join((low, high) if float(low) <= float(high) else (f"{int(x.p) / int(x.q):.17g}" for x in pair))
