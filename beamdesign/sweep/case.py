"""One case of a sweep: its whole inputs, the code that it rests on, and the address under which its result is kept."""

import hashlib
import json
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Literal, cast

from beamdesign import records
from beamdesign.code_digest import code_digest
from beamdesign.json_text import finite, picked
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem, Record
from beamdesign.sweep.tasks import TASKS, Answer, of_all

Status = Literal["done", "no", "refused", "failed"]
"""The answer is yes; it is no, with its reason; the inputs are bad; the program failed."""

_SHORT = 12


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        task: its name.
        document: study or prototype as tables, the varied values put in.
        options: of the task, likewise.
        varied: the varied values by key, for tables and comparisons.
        inputs_sha256: digest of task, document and options as the task reads them, defaults filled in.
        code_sha256: digest of the code that the task reaches.
        problems: with its inputs, as far as they are known without computing; such a case is refused.
    """

    task: str
    document: dict[str, Any]
    options: dict[str, Any]
    varied: dict[str, Any]
    inputs_sha256: str
    code_sha256: str
    problems: tuple[Problem, ...] = ()

    @property
    def address(self) -> str:
        """Name of its result: a digest of inputs and code."""
        return address_of(self.inputs_sha256, self.code_sha256)


def address_of(inputs_sha256: str, code_sha256: str) -> str:
    """Name of the result of inputs and code, by the digests of both."""
    return hashlib.sha256(f"{inputs_sha256} {code_sha256}".encode()).hexdigest()


def case(task: str, document: Mapping[str, Any], options: Mapping[str, Any], varied: Mapping[str, Any]) -> Case:
    """A case; inputs that no record accepts have an address too, since their refusal is a result."""
    document, options = dict(document), dict(options)
    problems: tuple[Problem, ...] = ()
    try:
        read = [part.model_dump(mode="json") for part in parsed(task, document, options)]
    except InputError as error:
        read, problems = [finite(document), finite(options)], tuple(error.problems)
    return Case(
        task,
        finite(document),
        finite(options),
        finite(varied),
        _digest(task, *map(_text, read)),
        code_digest(TASKS[task].place),
        problems,
    )


def parsed(task: str, document: Mapping[str, Any], options: Mapping[str, Any]) -> tuple[Record, Record]:
    """The records that a task is given.

    Raises:
        InputError: with everything that is wrong with both, keys of the options under `options`.
    """
    asked, found, problems = TASKS[task], [], []
    for table, record, before in ((document, asked.record, ""), (options, asked.options, "options.")):
        try:
            found.append(records.parse(record, dict(table), task))
        except InputError as error:
            problems += [Problem(before + key, reason) for key, reason in error.problems]
    if not problems:
        problems += asked.lacks(found[0])
    if problems:
        raise InputError(task, problems)
    return found[0], found[1]


def inputs_hold(task: str, document: Mapping[str, Any], options: Mapping[str, Any], inputs_sha256: str) -> bool:
    """Whether a digest is that of a case's inputs, as its task reads them or, where it does not, as they stand."""
    given = _text(document), _text(options)
    read = _as_read(TASKS[task].record, given[0]), _as_read(TASKS[task].options, given[1])
    return any(_digest(task, *texts) == inputs_sha256 for texts in (read, given))


@lru_cache(maxsize=64)  # cases of a sweep over options share their document
def _as_read(record: type[Record], text: str) -> str:
    """Tables as a record has them, defaults filled in; nothing where it does not accept them."""
    try:
        return _text(records.parse(record, json.loads(text), "").model_dump(mode="json"))
    except InputError:
        return ""


def _text(tables: Mapping[str, Any]) -> str:
    return json.dumps(tables, sort_keys=True, ensure_ascii=False)


def _digest(task: str, document: str, options: str) -> str:
    return hashlib.sha256(f'["{task}", {document}, {options}]'.encode()).hexdigest()


def compute(found: Case) -> dict[str, Any]:
    """Put a case through its task, law by law where a controller has several; whatever happens is a result.

    Returns:
        the record that is kept: inputs, status, reason, outputs, details, and how long it took.
    """
    begun = time.perf_counter()
    details: dict[str, Any] = {}
    outputs: dict[str, Any] = {}
    try:
        if found.problems:
            raise InputError(found.task, found.problems)
        record, options = parsed(found.task, found.document, found.options)
        task = TASKS[found.task]
        module, _, name = task.place.partition(":")
        work = cast("Callable[[Any, Any], Answer]", getattr(import_module(module), name))
        if isinstance(record, Prototype) and record.schedule is not None and "controller" in task.needs:
            mass = getattr(options, "outer_end_mass_kg", None)  # of tasks at one mass
            range_kg = record.outer_end_mass_kg if mass is None else (mass, mass)
            assert range_kg is not None  # laws have their payloads
            answer = of_all({one.prototype.name: work(one.prototype, options) for one in record.stages(range_kg)})
        else:
            answer = work(record, options)
        outputs, details, reason = answer.outputs, answer.details, answer.reason
        status = "no" if reason else "done"
    except InputError as error:
        status, reason = "refused", in_words(error.problems)
    except Exception as error:  # a crash is a row of its own: the others go on
        status, reason = "failed", f"{type(error).__name__}: {error}"
        details = {"traceback": traceback.format_exc()}
    return kept(found, status, reason, finite(outputs), finite(details), time.perf_counter() - begun)


def in_words(problems: Iterable[Problem]) -> str:
    """Why a case is refused."""
    return "; ".join(f"{key}: {reason}" for key, reason in problems)


def kept(
    found: Case, status: str, reason: str, outputs: dict[str, Any], details: dict[str, Any], seconds: float
) -> dict[str, Any]:
    """The record of a case as it is written to its file."""
    given = picked(found, "address inputs_sha256 code_sha256 task varied document options")
    answer = {"status": status, "reason": reason, "outputs": outputs, "details": details}
    return given | answer | {"seconds": round(seconds, 3), "libraries": libraries()}


def short(address: str) -> str:
    """As much of an address as people are shown."""
    return address[:_SHORT]


_LIBRARIES = ("casadi", "cvxpy", "numpy", "python-flint", "scipy")


@cache
def libraries() -> dict[str, str]:
    """Versions of the libraries that do the arithmetic; told with each result, not part of its address."""
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
