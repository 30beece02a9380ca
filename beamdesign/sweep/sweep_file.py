"""The file of a sweep: what is computed, from which base, over which values of which keys."""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations
from math import prod
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field, FiniteFloat

from beamdesign import records
from beamdesign.prototype import Prototype
from beamdesign.quantities import RelativeStd
from beamdesign.records import ByName, FileName, InputError, Positive, Problem, Record, nested_records, of_own_names
from beamdesign.sweep.case import TASKS, Kind, Task

SAMPLED = ("latin_hypercube", "sobol")
Method = Literal["grid", "latin_hypercube", "sobol", "optimise", "tolerance", "worst_case", "sensitivity"]

MOST_CASES = 1_000_000


class Work(Record):
    """What every case is put through."""

    task: str = Field(description="what is computed per case, one of beamdesign.sweep.case")
    base: FileName = Field(min_length=1, description="study or prototype file, from this file's folder")
    method: Method = Field("grid", description="how the cases are chosen")
    cases: int = Field(64, ge=1, le=MOST_CASES, description="how many samples; of grids every point is taken")
    seed: int = Field(0, ge=0, description="of the samples and of the optimiser")


class Along(Record):
    """Values of a key that goes along with the varied one."""

    values: tuple[Any, ...] | None = Field(None, description="as many as the varied key has")
    times: FiniteFloat | None = Field(None, description="factor on the varied key's value")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """One of the two."""
        if (table.get("values") is None) == (table.get("times") is None):
            yield Problem("", "give either values or times")


class Vary(Record):
    """One axis: values of a key, and of those that go along with it."""

    key: str = Field(min_length=1, description="dotted key, such as payload.outer_end_mass_kg[1]")
    values: tuple[Any, ...] | None = Field(None, min_length=1, description="every value")
    low: FiniteFloat | None = Field(None, description="least value")
    high: FiniteFloat | None = Field(None, description="largest value")
    count: int = Field(5, ge=2, le=100_000, description="how many from low to high, in a grid")
    spacing: Literal["linear", "logarithmic"] = Field("linear", description="of the values from low to high")
    along: dict[str, Along] = Field(default_factory=dict, description="keys that change together with this one")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Values or a range; as many values along as there are here."""
        ends = table.get("low"), table.get("high")
        if table.get("values") is None:
            if None in ends:
                yield Problem("", "give values, or low and high")
            elif (pair := records.numbers(table, "low", "high")) and pair[0] >= pair[1]:
                yield Problem("low", f"{pair[0]:g} is not below high, {pair[1]:g}")
            elif pair and table.get("spacing") == "logarithmic" and pair[0] <= 0:
                yield Problem("low", f"must be greater than 0 where the spacing is logarithmic, is {pair[0]:g}")
        elif ends != (None, None):
            yield Problem("", "give either values, or low and high")
        own, along = table.get("values"), table.get("along")
        given = own if isinstance(own, tuple) else ()
        odd = [one for one in given if isinstance(one, bool) or not isinstance(one, int | float)]
        for name, other in along.items() if isinstance(along, Mapping) else ():
            listed, times = (other.get(key) if isinstance(other, Mapping) else None for key in ("values", "times"))
            if odd and times is not None:
                yield Problem(f"along.{name}", f"times is for numbers, and {odd[0]!r} is none; give values")
            if isinstance(listed, tuple) and (not isinstance(own, tuple) or len(own) != len(listed)):
                wanted = f"{len(own)} values" if isinstance(own, tuple) else "times: there are no values to go along"
                yield Problem(f"along.{name}", f"holds {len(listed)} values, expected {wanted}")


class Optimise(Record):
    """What the method `optimise` is after; cases are found by differential evolution over the varied ranges."""

    output: str = Field(min_length=1, description="column of the table")
    goal: Literal["minimise", "maximise"] = Field("minimise", description="which way")
    generations: int = Field(20, ge=1, le=10_000, description="how often the population is renewed")
    population: int = Field(16, ge=5, le=10_000, description="cases per generation")


class Demand(Record):
    """A limit of an output column: together they are the specification whose yield is told."""

    at_least: FiniteFloat | None = Field(None, description="least value of the column that meets it")
    at_most: FiniteFloat | None = Field(None, description="largest value of the column that meets it")
    equals: bool | str | None = Field(None, description="value of the column that meets it")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Limits that a value can keep, or the value itself."""
        if (pair := records.numbers(table, "at_least", "at_most")) and pair[0] > pair[1]:
            yield Problem("at_least", f"{pair[0]:g} is above at_most, {pair[1]:g}: no value meets both")
        if table.get("equals") is not None and (table.get("at_least"), table.get("at_most")) != (None, None):
            yield Problem("equals", "give either equals, or at_least and at_most")


class Spread(Record):
    """How figures spread about those of the base: its [tolerance], as standard deviations."""

    sigmas: Positive = Field(3.0, le=10, description="half-width of the box of a worst case")
    confidence: Positive = Field(0.95, lt=1, description="of the bounds on the yield")
    output: str | None = Field(None, description="column whose worst case is sought")
    worst: Literal["least", "largest"] = Field("least", description="which end of it is the bad one")
    rounds: int = Field(8, ge=1, le=100, description="of the search for the worst case")
    outputs: tuple[str, ...] = Field((), description="columns whose sensitivity is told")
    tolerance: dict[str, RelativeStd] = Field(
        default_factory=dict, description="relative standard deviations in place of the base's"
    )


_FIGURES: tuple[Kind, ...] = ("numbers", "yes or no")
_ANY: tuple[Kind, ...] = (*_FIGURES, "text")

PICTURES: dict[str, tuple[dict[str, tuple[Kind, ...]], tuple[str, ...]]] = {
    "lines": ({"x": _ANY, "y": _FIGURES}, ()),
    "bars": ({"x": _ANY, "y": _FIGURES}, ()),
    "map": ({"x": _ANY, "y": _ANY, "series": _FIGURES}, ()),
    "lag_breaks": ({"x": ("numbers",)}, ("stable_zero_from_Hz", "stable_zero_to_Hz")),
    "end_masses": ({"x": ("numbers",)}, ("stable_from_kg", "stable_to_kg", "crossings_kg", "crossing_frequencies_Hz")),
    "histogram": ({"x": _FIGURES}, ()),
}
"""Of each kind of picture: the columns that it is told, with what they may hold, and the lists that it draws."""


class Picture(Record):
    """What is drawn of the finished table."""

    kind: Literal["lines", "bars", "map", "lag_breaks", "end_masses", "histogram"] = Field(description="what it shows")
    x: str | None = Field(None, description="column along the horizontal axis")
    y: str | None = Field(None, description="column along the vertical axis")
    series: str | None = Field(None, description="column whose values get a curve each")
    title: str = Field("", description="above the picture")
    x_label: str = Field("", description="of the horizontal axis; none: the column's name")
    y_label: str = Field("", description="of the vertical axis; none: the column's name")
    series_label: str = Field("", description="before the value in the legend")
    limit: FiniteFloat | None = Field(None, description="value of y at which a line is drawn")


class Sweep(Record):
    """A whole sweep file."""

    name: str = Field(min_length=1, pattern=r"^[^/\\]+$", description="what the sweep is called; also of its files")
    study: Work
    vary: tuple[Vary, ...] = ()
    options: dict[str, Any] = Field(default_factory=dict, description="options of the task")
    optimise: Optimise | None = None
    spread: Spread = Spread()
    specification: dict[str, Demand] = Field(default_factory=dict)
    picture: tuple[Picture, ...] = ()

    def is_whole(self, key: str) -> bool:
        """Whether a key that can be varied takes whole numbers alone."""
        task, option = TASKS[self.study.task], key.removeprefix("options.")
        return dict(_walk(task.record if option == key else task.options, "")).get(option) is int


def read_sweep(path: str | Path) -> Sweep:
    """Read a sweep file and check task, method and every key that it varies.

    Raises:
        InputError: naming file, key and reason of everything wrong with it.
    """
    sweep = records.parse(Sweep, records.read_table(path), path)
    if problems := list(_problems(sweep)):
        raise InputError(path, problems)
    return sweep


def _problems(sweep: Sweep) -> Iterator[Problem]:
    task, method = TASKS.get(sweep.study.task), sweep.study.method
    if task is None:
        yield Problem("study.task", f"unknown task {sweep.study.task!r}; there are {', '.join(TASKS)}")
        return
    known = known_keys(task.record) | {f"options.{key}": size for key, size in known_keys(task.options).items()}
    seen: set[str] = set()
    for number, vary in enumerate(sweep.vary, 1):
        for key in (vary.key, *vary.along):
            where = f"vary {number}: {key}"
            if reason := wrong_key(key, known):
                yield Problem(where, reason)
            elif key in seen:
                yield Problem(where, "is varied twice")
            seen.add(key)
        if method == "optimise" and vary.values is not None:
            yield Problem(f"vary {number}: {vary.key}", "an optimiser needs low and high, not values")
    if method == "grid" and (cases := prod(len(one.values or range(one.count)) for one in sweep.vary)) > MOST_CASES:
        words = f"is a grid of {cases:g} cases, more than {MOST_CASES:g}; give fewer values, or sample another way"
        yield Problem("vary", f"{words}: study.method = 'latin_hypercube'")
    for key, whole in permutations(seen, 2):
        if key.startswith((f"{whole}.", f"{whole}[")):
            yield Problem("vary", f"{key} is part of {whole}, which is varied too; leave one of them out")
    for name in sweep.options:
        if reason := wrong_key(f"options.{name}", known):
            yield Problem(f"options.{name}", reason.replace("options.", ""))
    yield from _column_problems(sweep, task, known)
    if method == "optimise" and (sweep.optimise is None or not sweep.vary):
        yield Problem("optimise", "missing: which output to minimise or maximise, and at least one [[vary]]")
    if method in ("tolerance", "worst_case", "sensitivity"):
        if task.record is not Prototype:
            yield Problem("study.method", f"{method} needs a task on prototypes, {sweep.study.task} works on studies")
        if sweep.vary:
            yield Problem("vary", f"{method} varies the figures of [tolerance]; leave [[vary]] out")
    elif not sweep.vary and method in SAMPLED:
        yield Problem("vary", f"missing: {method} needs at least one key to vary")
    if method == "worst_case" and sweep.spread.output is None:
        yield Problem("spread.output", "missing: the column whose worst case is sought")
    if method == "sensitivity" and not sweep.spread.outputs:
        yield Problem("spread.outputs", "missing: the columns whose sensitivity is told")


def _column_problems(sweep: Sweep, task: Task, known: Mapping[str, int]) -> Iterator[Problem]:
    """What is wrong with the columns that a sweep names, by what its task gives."""
    of_numbers = [("spread.outputs", name) for name in sweep.spread.outputs]
    of_numbers += [("spread.output", sweep.spread.output)] if sweep.spread.output is not None else []
    of_numbers += [("optimise.output", sweep.optimise.output)] if sweep.optimise is not None else []
    for key, name in of_numbers:
        yield from _no_column(key, name, task, ("numbers",))
    for name, demand in sweep.specification.items():
        limits = demand.at_least is not None or demand.at_most is not None
        kinds = _ANY if demand.equals is None else ("text",) if isinstance(demand.equals, str) else ("yes or no",)
        yield from _no_column("specification", name, task, ("numbers",) if limits else kinds)
    for number, picture in enumerate(sweep.picture, 1):
        roles, lists = PICTURES[picture.kind]
        for role in ("x", "y", "series"):
            name, key = getattr(picture, role), f"picture {number}: {role}"
            if name is None and role in roles:
                yield Problem(key, f"missing: a picture of kind {picture.kind!r} needs it")
            elif name is not None and (name in task.columns or wrong_key(name, known)):
                yield from _no_column(key, name, task, roles.get(role, _ANY))
        for name in lists:
            yield from _no_column(f"picture {number}: kind {picture.kind!r}", name, task, ("lists",))


def _no_column(key: str, name: str, task: Task, kinds: tuple[Kind, ...]) -> Iterator[Problem]:
    """Why a name is no column that holds what is asked for."""
    there = [column for column, kind in task.columns.items() if kind in kinds]
    if name not in there:
        holds = f"holds {task.columns[name]}" if name in task.columns else "is no output"
        choice = f"outputs that hold {' or '.join(kinds)} are {', '.join(there)}" if there else "there is none such"
        yield Problem(key, f"{name} {holds}; {choice}")


_NAME = r'"[^"]+"|[^\[\]."]+'  # in quotes as in TOML, where it has a dot of its own
_STEP = rf"(?:{_NAME})(?:\[\d+\])?"
_KEY = re.compile(rf"{_STEP}(?:\.{_STEP})*\Z")


def steps_of(key: str) -> list[str | int]:
    """Names of a dotted key and numbers of entries of lists, in their order."""
    found = re.findall(rf"\[(\d+)\]|({_NAME})", key)
    return [int(entry) if entry else name.strip('"') for entry, name in found]


OWN_NAME = "NAME"
"""In the place of one, as in material.NAME.density_kg_per_m3."""


def known_keys(record: type[Record]) -> dict[str, int]:
    """Every dotted key of a record type, tables included, with how many entries its list has (0 for no list).

    A name of one's own stands as `OWN_NAME`.

    The keys of effects are those of the effect library.
    """
    found = {key: _entries(annotation) for key, annotation in _walk(record, "")}
    if "effects" in record.model_fields:
        from beamdesign.plant.effects import library

        for name, effect in library().items():
            found[f"effects.{name}"] = 0
            found |= {f"effects.{name}.{parameter.name}": 0 for parameter in effect.parameters}
    return found


def _walk(record: type[Record], before: str) -> Iterator[tuple[str, Any]]:
    for name, field in record.model_fields.items():
        yield before + name, field.annotation
        nested = [] if any(isinstance(mark, ByName) for mark in field.metadata) else nested_records(field.annotation)
        inside = f"{before}{name}.{OWN_NAME}" if nested and of_own_names(field.annotation) else before + name
        for one in nested:
            yield from _walk(one, f"{inside}.")


def _entries(annotation: Any) -> int:
    """Entries of a tuple of fixed length somewhere in an annotation; 0 where there is none."""
    if getattr(annotation, "__origin__", None) is tuple:
        return len(get_args(annotation))
    return max((_entries(part) for part in get_args(annotation)), default=0)


def wrong_key(key: str, known: Mapping[str, int]) -> str:
    """Why a key cannot be varied, with the nearest that can; empty where it can."""
    if _KEY.match(key) is None:
        return "not a key; write table.key, or table.key[0] for one entry of a list"
    entry, steps = steps_of(key)[-1], [step for step in steps_of(key) if isinstance(step, str)]
    name = ".".join(steps)
    own = (".".join([*steps[:k], OWN_NAME, *steps[k + 1 :]]) for k in range(1, len(steps)))
    name = next((one for one in own if one in known), name)
    if name not in known:
        ends: dict[str, list[str]] = {}
        for there in known:
            ends.setdefault(there.rpartition(".")[2], []).append(there)
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
        last = difflib.get_close_matches(name.rpartition(".")[2], ends, n=2, cutoff=0.75)
        near = list(dict.fromkeys([*near, *(there for end in last for there in ends[end])]))[:4]
        return "unknown key; " + (f"nearest are {', '.join(near)}" if near else "none is near it")
    if isinstance(entry, int) and entry >= known[name]:
        return f"{name} has {known[name]} entries, counted from 0" if known[name] else f"{name} is not a list"
    return ""


def with_value(document: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A document with one value put under a dotted key; tables on the way are made where they are missing.

    The document itself stays as it is; what is not on the way is shared with it.

    Raises:
        ValueError: where an entry of a list is meant and there is no such list yet, or no table on the way.
    """
    changed = _with(document, steps_of(key), value, key)
    assert isinstance(changed, dict)  # a key begins with a name
    return changed


def _with(held: Any, steps: Sequence[str | int], value: Any, key: str) -> Any:
    """A table or a list with a value put where steps lead from there."""
    if not steps:
        return value
    step, rest = steps[0], steps[1:]
    if isinstance(step, int):
        if not isinstance(held, list | tuple) or len(held) <= step:
            raise ValueError(f"{key}: there is no list to change one entry of; give the whole list")
        return [*held[:step], _with(held[step], rest, value, key), *held[step + 1 :]]
    below = held.get(step, {})
    if rest and isinstance(rest[0], str) and not isinstance(below, Mapping):
        listed = f", but a list; write {step}[0] for the first of them" if isinstance(below, list | tuple) else ""
        raise ValueError(f"{key}: {step} is not a table{listed}")
    return {**held, step: _with(below, rest, value, key)}


def value_at(document: Mapping[str, Any], key: str) -> Any:
    """The value under a dotted key, None where there is none."""
    value: Any = document
    for step in steps_of(key):
        if isinstance(step, int):
            value = value[step] if isinstance(value, list | tuple) and step < len(value) else None
        else:
            value = value.get(step) if isinstance(value, Mapping) else None
    return value
