"""Frozen, validated records and their TOML files: every figure in SI, its unit in the key."""

import codecs
import difflib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self, TypeVar, get_args, get_origin

import tomli_w
from pydantic import BaseModel, Field, FiniteFloat, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from beamdesign import files, spelling

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


class Longest(NamedTuple):
    """How many characters a text may hold where that is not `spelling.LONGEST`."""

    characters: int


FileName = Annotated[str, Longest(1000)]


class ByName:
    """That a record stands in a file by its name, as an annotation of a field."""


# Everyday units of this field and the SI suffix each should have been.
_UNIT_MISTAKES = {
    "mm": "m", "cm": "m", "in": "m", "N_per_mm": "N_per_m", "N_per_cm": "N_per_m", "kN": "N", "g": "kg", "lb": "kg",
    "MPa": "Pa", "GPa": "Pa", "bar": "Pa", "psi": "Pa", "kHz": "Hz", "rad_per_s": "Hz", "mA_per_V": "A_per_V",
    "V_per_cm": "V_per_m", "V_per_mm": "V_per_m", "cm2": "m2", "mm2": "m2", "cm3_per_s_per_mA": "m3_per_s_per_A",
    "cm3_per_s_per_Pa": "m3_per_s_per_Pa",
}  # fmt: skip


class Problem(NamedTuple):
    """One thing wrong with an input: the dotted key and the reason, in words."""

    key: str
    reason: str


class InputError(Exception):
    """Bad input, with every problem found at once.

    Attributes:
        source: the file (or the argument) that holds the bad input.
        problems: key and reason of each.
    """

    def __init__(self, source: str | Path, problems: Sequence[Problem | tuple[str, str]]):
        self.source = str(source)
        self.problems = [Problem(*problem) for problem in problems]
        super().__init__("\n".join(f"{self.source}: {key}: {reason}" for key, reason in self.problems))


class Record(BaseModel, frozen=True, extra="forbid", strict=True):
    """Base of all records: frozen, no unknown keys, no silent coercion of text to numbers.

    Every text in it, keys of free tables included, is one line without control characters (see `spelling.fault`).

    A subclass states what must hold between its fields in `relations`, which sees the raw table, so that a relation
    that fails is reported together with fields that are wrong on their own.
    """

    holds_lines: ClassVar[bool] = True
    """Whether its texts are names, titles and the like; those that a program has written may be of many lines."""

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Yield what is wrong between the fields of `table`, whose values may themselves be wrong."""
        yield from ()

    @classmethod
    def prepared(cls, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """The table with what parts of it say of others put there; what is wrong in it stays."""
        return table

    @classmethod
    def whole(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table with the defaults of what it leaves out."""
        return {name: field.default for name, field in cls.model_fields.items()} | dict(table)

    @model_validator(mode="wrap")
    @classmethod
    def _all_problems_at_once(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        problems: list[InitErrorDetails] = []
        if isinstance(data, Mapping):
            data = cls.prepared(data)
            found = [(tuple(key.split(".")) if key else (), reason) for key, reason in cls.relations(data)]
            for place, reason in [*(_unfit_texts(cls, data) if cls.holds_lines else ()), *found]:
                kind = PydanticCustomError("relation", "{reason}", {"reason": reason})
                problems.append(InitErrorDetails(type=kind, loc=place, input=data))
        if not problems:
            return handler(data)
        try:
            handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(cls.__name__, [*_line_errors(error), *problems]) from None
        raise ValidationError.from_exception_data(cls.__name__, problems)

    @classmethod
    def variants(cls) -> "list[type[Record]]":
        """The records that a field of this type may hold: this one alone, or all kinds of an abstract one."""
        return [cls]

    def but(self, **changes: Any) -> Self:
        """Give a validated copy with some fields replaced."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self).model_validate(fields | changes)


Place = tuple[str | int, ...]


def _unfit_texts(record: type[Record], table: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Texts that no record may hold, with what is wrong; a record inside of this one looks after its own."""
    for key, value in table.items():
        if field := record.model_fields.get(key):
            longest = [mark.characters for mark in field.metadata if isinstance(mark, Longest)]
            for place, text in _texts(value, (key,), field.annotation):
                if reason := spelling.fault(text, *longest):
                    yield place, reason


def _texts(value: Any, place: Place, annotation: Any) -> Iterator[tuple[Place, str]]:
    if isinstance(value, str):
        yield place, value
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            yield from _texts(item, (*place, k), annotation)
    elif isinstance(value, Mapping):
        plain = not nested_records(annotation)
        for key, item in value.items():
            inside = (*place, spelling.one_line(str(key)))
            yield inside, str(key)
            if plain:
                yield from _texts(item, inside, annotation)


def _errors(error: ValidationError) -> list[Any]:
    """All errors but what others lead to: a list too short that holds enough entries, a default that is unknown."""
    errors = [e for e in error.errors(include_url=False) if e["type"] != "default_factory_not_called"]
    return [e for e in errors if e["type"] != "too_short" or len(e["input"]) < e["ctx"]["min_length"]]


def _line_errors(error: ValidationError) -> list[InitErrorDetails]:
    lines = []
    for item in _errors(error):
        kind: Any = item["type"]
        if kind != "extra_forbidden":
            kind = PydanticCustomError("said", "{reason}", {"reason": _reason(item)})
        lines.append(InitErrorDetails(type=kind, loc=item["loc"], input=item["input"]))
    return lines


def stated(part: Any, key: str, usual: Any = None) -> Any:
    """What a table or a record has under a key, or what is usual where it has nothing; dots lead into tables."""
    for step in key.split("."):
        part = part.get(step, usual) if isinstance(part, Mapping) else getattr(part, step, usual)
    return part


def numbers(table: Mapping[str, Any], *keys: str, each: int = 1) -> tuple[float, ...] | None:
    """The figures under `keys`, or None where one of them is absent or not a finite number; see `stated`.

    So many stand under each key, more than one as a list.
    """
    values: list[Any] = []
    for key in keys:
        value = stated(table, key)
        values += [value] if each == 1 else value if isinstance(value, tuple) and len(value) == each else [None]
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
        return None
    try:
        figures = tuple(map(float, values))
    except OverflowError:  # an integer beyond every float
        return None
    return figures if all(map(isfinite, figures)) else None


R = TypeVar("R", bound=Record)


def _as_tuples(value: Any) -> Any:
    """TOML arrays become tuples, so that frozen records stay hashable."""
    if isinstance(value, list):
        return tuple(_as_tuples(item) for item in value)
    if isinstance(value, dict):
        return {key: _as_tuples(item) for key, item in value.items()}
    return value


def under_tag(error: ValidationError, tag: str) -> ValidationError:
    """The same problems, placed inside of the kind of record that was meant; `_walk` knows such places."""
    lines = [line | {"loc": (tag, *line.get("loc", ()))} for line in _line_errors(error)]
    return ValidationError.from_exception_data(error.title, lines)


def nested_records(annotation: Any) -> list[type[Record]]:
    """The record types an annotation mentions, unions, Annotated and the kinds of abstract records included.

    But for those that stand by their names.
    """
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return annotation.variants()
    if any(isinstance(part, ByName) for part in get_args(annotation)):
        return []
    return [record for part in get_args(annotation) for record in nested_records(part)]


def of_own_names(annotation: Any) -> bool:
    """Whether there are tables under names of their own."""
    return any(get_origin(one) is dict for one in (annotation, *get_args(annotation)))


def _walk(record: type[Record], path: Sequence[str | int]) -> tuple[list[str], list[str]]:
    """The path as a user would write it, without tags of unions and places in lists; and the keys allowed there."""
    written: list[str] = []
    choices, of_own_name = record.variants(), False
    for step in path:
        if isinstance(step, int):
            continue
        if of_own_name:
            written, of_own_name = [*written, step], False
            continue
        tagged = [c for c in choices if len(choices) > 1 and c.model_fields["kind"].default == step]
        if tagged:
            choices = tagged
            continue
        written.append(step)
        fields = [c.model_fields[step].annotation for c in choices if step in c.model_fields]
        choices = [nested for annotation in fields for nested in nested_records(annotation)]
        of_own_name = bool(choices) and any(map(of_own_names, fields))
    return written, list(dict.fromkeys(key for choice in choices for key in choice.model_fields))


def _unknown_key_reason(key: str, known: Sequence[str]) -> str:
    for wrong in sorted(_UNIT_MISTAKES, key=len, reverse=True):
        stem = key.removesuffix("_" + wrong)
        right = _UNIT_MISTAKES[wrong]
        if stem != key and f"{stem}_{right}" in known:
            return f"wrong unit {wrong}: give {stem}_{right}, in {right.replace('_per_', '/')}"
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if close:
        return f"unknown key; did you mean {close[0]}?"
    return f"unknown key; known here are {', '.join(known)}" if known else "unknown key"


def _shown(value: Any) -> str:
    """A value as it might stand in the file, cut where it is long."""
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else text[:57] + "..."


_WORDS = {
    "missing": "missing",
    "union_tag_not_found": "missing kind",
    "string_too_short": "must not be empty",
    "relation": "{reason}",
    "said": "{reason}",
    "greater_than": "must be greater than {gt:g}, is {given}",
    "greater_than_equal": "must be at least {ge:g}, is {given}",
    "less_than": "must be less than {lt:g}, is {given}",
    "less_than_equal": "must be at most {le:g}, is {given}",
    "finite_number": "must be a finite number, is {given}",
    "float_type": "must be a number, is {given}",
    "int_type": "must be a whole number, is {given}",
    "int_from_float": "must be a whole number, is {given}",
    "bool_type": "must be true or false, is {given}",
    "string_type": "must be text in quotes, is {given}",
    "tuple_type": "must be a list in square brackets, is {given}",
    "model_type": "must be a table, is {given}",
    "model_attributes_type": "must be a table, is {given}",
    "dict_type": "must be a table, is {given}",
    "string_pattern_mismatch": "must be of letters that a file may be named with, is {given}",
    "too_short": "must hold at least {min_length} entries, holds {actual_length}",
    "too_long": "must hold {max_length} entries, holds {actual_length}",
    "literal_error": "must be {expected}, is {given}{meant}",
    "union_tag_invalid": "kind must be one of {expected_tags}, is {tag!r}{meant}",
}
"""Of a kind of validation error: what was given, and which of the expected words it may mean, stand in it."""


def _meant(given: Any, expected: str) -> str:
    """Which of the expected words, in quotes, a misspelt one may be."""
    close = difflib.get_close_matches(str(given), re.findall(r"'([^']+)'", expected), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def _reason(item: Any) -> str:
    """One validation error in words."""
    kind, context, given = item["type"], item.get("ctx", {}), _shown(item["input"])
    if kind == "implausible":
        key = [step for step in item["loc"] if isinstance(step, str)][-1]
        return str(context["range"].refusal(given, key))
    if kind not in _WORDS:
        return f"{item['msg'][:1].lower()}{item['msg'][1:]}, is {given}"
    expected = context.get("expected", context.get("expected_tags", ""))
    return _WORDS[kind].format(**context, given=given, meant=_meant(context.get("tag", item["input"]), expected))


def _problems(error: ValidationError, record: type[Record]) -> list[Problem]:
    problems = []
    for item in _errors(error):
        written, _ = _walk(record, item["loc"])
        if item["type"] == "extra_forbidden":
            _, known = _walk(record, item["loc"][:-1])
            reason = _unknown_key_reason(written[-1], known)
        else:
            reason = _reason(item)
        places = "".join(f"entry {step + 1}: " for step in item["loc"] if isinstance(step, int))
        problems.append(Problem(".".join(written) or "(whole file)", places + reason))
    return problems


def parse(record: type[R], table: dict[str, Any], source: str | Path) -> R:
    """Validate a table read from `source` against a record type.

    Raises:
        InputError: with all problems at once, each naming its key.
    """
    try:
        return record.model_validate(_as_tuples(table))
    except ValidationError as error:
        if fault := files.wrong_kind(table, record.__name__, str(source)):
            raise InputError(source, [Problem("(whole file)", fault)]) from error
        raise InputError(source, _problems(error, record)) from error


def read_table(path: str | Path) -> dict[str, Any]:
    """Read a TOML file as plain tables; a byte order mark before them is understood.

    Raises:
        InputError: where the file cannot be read, is too large, is not TOML, or where its tables, lists and numbers
            are of a size that none of our files has.
    """
    try:
        raw = files.read_bytes(path)
    except OSError as error:
        raise InputError(path, [Problem("(file)", files.unreadable(Path(path), error))]) from error
    try:
        text = raw.removeprefix(codecs.BOM_UTF8).decode()
        if key := files.longer_key(text, _DEEPEST):
            raise InputError(path, [Problem(f"{key[:60]}...", f"nested more than {_DEEPEST} levels deep")])
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, [Problem("(file)", files.not_toml(raw, error))]) from error
    except RecursionError as error:
        raise InputError(path, [Problem("(file)", f"nested more than {_DEEPEST} levels deep")]) from error
    except ValueError as error:  # an integer of thousands of digits, which Python does not convert
        raise InputError(path, [Problem("(file)", "holds a whole number of thousands of digits")]) from error
    if problems := list(_beyond_size(table)):
        raise InputError(path, problems)
    return table


_DEEPEST, _LONGEST_LIST, _LARGEST_INTEGER = 20, 100_000, 10**18


def _beyond_size(table: dict[str, Any]) -> Iterator[Problem]:
    """What no figure and no list of ours is, found without recursion, so that no depth is too deep for the search."""
    waiting: list[tuple[str, Any, int]] = [("", table, 0)]
    while waiting:
        key, value, depth = waiting.pop()
        if isinstance(value, dict | list) and depth >= _DEEPEST:
            yield Problem(f"{key[:60]}...", f"nested more than {_DEEPEST} levels deep")
        elif isinstance(value, list) and len(value) > _LONGEST_LIST:
            yield Problem(key, f"holds {len(value)} entries, more than the {_LONGEST_LIST} of the longest list")
        elif isinstance(value, list):
            waiting += [(key, item, depth + 1) for item in value]
        elif isinstance(value, dict):
            waiting += [(f"{key}.{name}" if key else name, item, depth + 1) for name, item in value.items()]
        elif isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
            digits = "thousands of" if value.bit_length() > 10_000 else len(str(abs(value)))  # Python prints no more
            size = f"is a whole number of {digits} digits"
            yield Problem(key, f"must be at most {_LARGEST_INTEGER:.0e} in size, {size}")


def read(record: type[R], path: str | Path) -> R:
    """Read and validate one record from a TOML file."""
    return parse(record, read_table(path), path)


def to_toml(record: Record) -> str:
    """Write a record as TOML text; absent figures are left out, floats keep every digit."""
    return tomli_w.dumps(record.model_dump(exclude_none=True, mode="python"))
