"""One case of a sweep: its whole inputs, and the address under which its result is kept."""

import hashlib
import json
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from math import isfinite
from typing import Any

from beamdesign import records
from beamdesign.records import InputError
from beamdesign.study.code_digest import code_digest, libraries
from beamdesign.study.tasks import TASKS

STATUSES = ("done", "no", "refused", "failed")
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
    """

    task: str
    document: dict[str, Any]
    options: dict[str, Any]
    varied: dict[str, Any]
    inputs_sha256: str
    code_sha256: str

    @property
    def address(self) -> str:
        """Name of its result: a digest of inputs and code."""
        return hashlib.sha256(f"{self.inputs_sha256} {self.code_sha256}".encode()).hexdigest()


def case(task: str, document: Mapping[str, Any], options: Mapping[str, Any], varied: Mapping[str, Any]) -> Case:
    """A case; inputs that no record accepts have an address too, since their refusal is a result."""
    try:
        read = [
            records.parse(TASKS[task].record, dict(document), "base").model_dump(mode="json"),
            records.parse(TASKS[task].options, dict(options), "options").model_dump(mode="json"),
        ]
    except InputError:
        read = [plain(document), plain(options)]
    text = json.dumps([task, *read], sort_keys=True, ensure_ascii=False)
    return Case(
        task,
        plain(document),
        plain(options),
        plain(varied),
        hashlib.sha256(text.encode()).hexdigest(),
        code_digest(TASKS[task].module),
    )


def compute(found: Case) -> dict[str, Any]:
    """Put a case through its task; whatever happens is a result.

    Returns:
        the record that is kept: inputs, status, reason, outputs, details, and how long it took.
    """
    begun = time.perf_counter()
    details: dict[str, Any] = {}
    outputs: dict[str, Any] = {}
    try:
        task = TASKS[found.task]
        record = records.parse(task.record, found.document, "base")
        options = records.parse(task.options, found.options, "options")
        answer = import_module(task.module).compute(record, options)
        outputs, details, reason = answer.outputs, answer.details, answer.reason
        status = "no" if reason else "done"
    except InputError as error:
        status, reason = "refused", "; ".join(f"{key}: {why}" for key, why in error.problems)
    except Exception as error:  # a crash is a row of its own: the others go on
        status, reason = "failed", f"{type(error).__name__}: {error}"
        details = {"traceback": traceback.format_exc()}
    return kept(found, status, reason, plain(outputs), plain(details), time.perf_counter() - begun)


def kept(
    found: Case, status: str, reason: str, outputs: dict[str, Any], details: dict[str, Any], seconds: float
) -> dict[str, Any]:
    """The record of a case as it is written to its file."""
    return {
        "address": found.address,
        "inputs_sha256": found.inputs_sha256,
        "code_sha256": found.code_sha256,
        "task": found.task,
        "varied": found.varied,
        "status": status,
        "reason": reason,
        "outputs": outputs,
        "details": details,
        "document": found.document,
        "options": found.options,
        "seconds": round(seconds, 3),
        "libraries": libraries(),
    }


def short(address: str) -> str:
    """As much of an address as people are shown."""
    return address[:_SHORT]


def plain(value: Any) -> Any:
    """As JSON has it: tuples become lists, numpy's numbers plain ones, and a figure that is not finite none at all."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if isfinite(value) else None
    return str(value)
