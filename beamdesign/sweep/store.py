"""A sweep's folder: one file per finished case, named by its address, and an index of the rows of the last run.

What is read is checked before it is believed: each record carries a digest of itself, and stands under the address of
its own inputs and code. Two folders can be compared case by case.
"""

import hashlib
import json
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NoReturn

from pydantic import Field, FiniteFloat, ValidationError

from beamdesign import records
from beamdesign.code_digest import code_digest
from beamdesign.files import LARGEST_TABLE, read_bytes, write_whole
from beamdesign.records import InputError, NonNegative, Record
from beamdesign.sweep.case import TASKS, Case, Status, address_of, case

INDEX = "study.json"
_CASES = "cases"
_DIGEST = "record_sha256"

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Cell = FiniteFloat | int | bool | str | None


class _Kept(Record):
    """The record of a case as its file has it."""

    holds_lines = False
    address: _Sha256
    inputs_sha256: str
    code_sha256: str
    task: str
    varied: dict[str, Any]
    status: Status
    reason: str
    outputs: dict[str, _Cell | Sequence[_Cell]]
    details: dict[str, Any]
    document: dict[str, Any]
    options: dict[str, Any]
    seconds: NonNegative
    libraries: dict[str, str]
    record_sha256: str


class _Index(Record):
    """The index of a folder."""

    name: str
    method: str
    complete: bool
    rows: Sequence[_Sha256]


@dataclass(frozen=True)
class Kept:
    """What a folder holds.

    Attributes:
        records: that hold, in the order of asking.
        unsound: why each of the others does not, with its file; they are not used.
    """

    records: tuple[dict[str, Any], ...]
    unsound: tuple[InputError, ...]


def keep(folder: Path, record: dict[str, Any]) -> None:
    """Write a case's record, whole or not at all, with a digest of itself."""
    sealed = record | {_DIGEST: _digest(record)}
    text = json.dumps(sealed, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_whole(_file(folder, record["address"]), text)


def _digest(record: dict[str, Any]) -> str:
    """SHA-256 of a record without its own digest, as JSON with sorted keys."""
    own = {key: value for key, value in record.items() if key != _DIGEST}
    return hashlib.sha256(json.dumps(own, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _file(folder: Path, address: str) -> Path:
    return folder / _CASES / f"{address}.json"


def addresses(folder: Path) -> list[str]:
    """Names of all results in a folder, sorted; none where there is no folder.

    Raises:
        InputError: where it cannot be read.
    """
    try:
        names = os.listdir(folder / _CASES)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(folder / _CASES, [("(folder)", f"cannot be read: {error.strerror}")]) from None
    return sorted(name.removesuffix(".json") for name in names if name.endswith(".json") and name[0] != ".")


def kept(folder: Path, address: str, asked: Case | None = None) -> dict[str, Any] | None:
    """The record kept under an address, None where there is none.

    Args:
        folder: of the sweep.
        address: name of its file.
        asked: the case whose address it is, where that is known: its inputs need not be read once more.

    Raises:
        InputError: where there is a file, and it does not hold.
    """
    path = _file(folder, address)
    found = _read(_Kept, path)
    try:
        wrong = None if found is None else _wrong(found, address, asked)
    except RecursionError:
        wrong = "(file)", "is nested too deeply"
    if wrong is not None:
        raise InputError(path, [wrong])
    return found


def _read(shape: type[Record], path: Path) -> dict[str, Any] | None:
    """A JSON file of a certain shape, None where there is no such file.

    Raises:
        InputError: where it cannot be read or is of another shape.
    """
    try:
        found = _JSON.decode(read_bytes(path, LARGEST_TABLE).decode())
        try:
            shape.model_validate(found)
        except ValidationError:
            records.parse(shape, found, path)  # which says what is wrong
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(path, [("(file)", f"cannot be read: {error.strerror}")]) from None
    except (ValueError, RecursionError):
        raise InputError(path, [("(file)", "is no JSON that can be read")]) from None
    return dict(found)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no JSON")


_JSON = json.JSONDecoder(
    parse_constant=_refuse, parse_float=lambda number: float(number) if isfinite(float(number)) else _refuse(number)
)


def _wrong(found: dict[str, Any], address: str, asked: Case | None) -> tuple[str, str] | None:
    """Key and reason of what does not hold between the parts of a record; None where everything does.

    Inputs of other code are not read anew: its records may have had other keys and defaults.
    """
    if found[_DIGEST] != _digest(found):
        return _DIGEST, "is not the digest of the record, which has been changed"
    if found["address"] != address_of(found["inputs_sha256"], found["code_sha256"]):
        return "address", "is not that of its inputs and code"
    if found["address"] != address:
        return "address", "is not the name of the file, which is a copy of another"
    inputs = (found["task"], found["document"], found["options"])
    if asked is not None and inputs == (asked.task, asked.document, asked.options):
        return None
    task = TASKS.get(found["task"])
    of_this_code = task is not None and code_digest(task.place) == found["code_sha256"]
    if asked is None and not of_this_code:
        return None
    if task is None or case(*inputs, {}).inputs_sha256 != found["inputs_sha256"]:
        return "inputs_sha256", "is not the digest of its inputs"
    return None


def gathered(folder: Path, names: Iterable[str], asked: Mapping[str, Case] = MappingProxyType({})) -> Kept:
    """What a folder holds of some addresses, cases of which may be known."""
    found, unsound = [], []
    for address in names:
        try:
            found.append(kept(folder, address, asked.get(address)))
        except InputError as error:
            unsound.append(error)
    return Kept(tuple(record for record in found if record is not None), tuple(unsound))


def in_words(unsound: Sequence[InputError], done: str = "not used") -> list[str]:
    """What does not hold, by its reasons, and what is done about it."""
    each = Counter(error.problems[0] for error in unsound)
    one = {error.problems[0]: error.source for error in unsound}
    return [
        f"{count} kept results do not hold and are {done}: {problem.key} {problem.reason}, such as {one[problem]}"
        for problem, count in each.items()
    ]


def write_index(folder: Path, name: str, method: str, rows: Sequence[str], complete: bool) -> None:
    """Write down which cases make up the rows, in their order."""
    fields = {"name": name, "method": method, "complete": complete, "rows": list(rows)}
    write_whole(folder / INDEX, json.dumps(fields, indent=1) + "\n")


def read_index(folder: Path) -> dict[str, Any]:
    """The index of a folder; of one whose first run is not finished, all that it holds, by address.

    Raises:
        InputError: where the folder holds no study, or its index is none.
    """
    there = addresses(folder)
    found = _read(_Index, folder / INDEX)
    if found is None and not there:
        raise InputError(folder, [("(folder)", f"holds no study: no {INDEX} in it")])
    return found or {"name": folder.name, "method": "", "complete": False, "rows": there}


def rows_of(folder: Path) -> Kept:
    """Records of the rows of a folder that are finished, in the order of the study.

    Raises:
        InputError: where the folder holds no study.
    """
    return gathered(folder, read_index(folder)["rows"])


def case_of(address: str) -> dict[str, Any]:
    """The record of a case named DIR/NUMBER, DIR/START-OF-ADDRESS, or by its file.

    Raises:
        InputError: where there is no such case, or its result does not hold.
    """
    path = Path(address)
    folder, name = path.parent, path.name
    if path.suffix == ".json" and path.is_file():
        record, why = kept(folder.parent, path.stem), ("(file)", "is no result of a case")
    else:
        try:
            rows = read_index(folder)["rows"]
        except InputError as error:
            raise InputError(address, [(f"{error.source}: {key}", reason) for key, reason in error.problems]) from None
        if name.isdecimal() and int(name) < len(rows):
            record, why = kept(folder, rows[int(name)]), (name, "this case is not finished; run the study on")
        else:
            found = [one for one in addresses(folder) if one.startswith(name)]
            record = kept(folder, found[0]) if len(found) == 1 else None
            none = f"no such case; rows are 0 to {len(rows) - 1}"
            why = name, "several cases begin so; give more digits" if found else none
    if record is None:
        raise InputError(address, [why])
    return record


Change = tuple[Any, Any]


@dataclass(frozen=True)
class CaseDifference:
    """One case that both folders have, by its varied keys.

    Attributes:
        varied: values of the varied keys.
        inputs: other inputs that differ, before and after; absent ones are None.
        outputs: outputs that differ, status and reason among them.
    """

    varied: dict[str, Any]
    inputs: dict[str, Change]
    outputs: dict[str, Change]


@dataclass(frozen=True)
class Difference:
    """What lies between two folders.

    Attributes:
        cases: those that both have, in the order of the first.
        inputs: changes of inputs that all of these share.
        code_changed: whether another version of the code computed the second.
        only_first: varied keys of cases that only the first has.
        only_second: likewise.
        unsound: words on results of both that do not hold and are left out.
    """

    cases: tuple[CaseDifference, ...]
    inputs: dict[str, Change]
    code_changed: bool
    only_first: tuple[dict[str, Any], ...]
    only_second: tuple[dict[str, Any], ...]
    unsound: tuple[str, ...] = ()

    @property
    def changed(self) -> tuple[CaseDifference, ...]:
        """Cases whose outputs differ."""
        return tuple(case for case in self.cases if case.outputs)

    @property
    def same(self) -> bool:
        """Whether nothing differs, and nothing was left out."""
        left_out = self.only_first or self.only_second or self.unsound
        return not (self.changed or left_out or any(case.inputs for case in self.cases))


def difference(first: Path, second: Path) -> Difference:
    """Compare two result folders.

    Raises:
        InputError: where one of them holds no study.
    """
    kept = rows_of(first), rows_of(second)
    before, after = ({json.dumps(row["varied"], sort_keys=True): row for row in one.records} for one in kept)
    both = [key for key in before if key in after]
    cases = tuple(_case(before[key], after[key]) for key in both)
    own = cases[0].inputs if cases else {}
    shared = {key: change for key, change in own.items() if all(case.inputs.get(key) == change for case in cases)}
    return Difference(
        cases,
        shared,
        any(before[key]["code_sha256"] != after[key]["code_sha256"] for key in both),
        tuple(row["varied"] for key, row in before.items() if key not in after),
        tuple(row["varied"] for key, row in after.items() if key not in before),
        tuple(in_words([*kept[0].unsound, *kept[1].unsound])),
    )


def _case(before: Mapping[str, Any], after: Mapping[str, Any]) -> CaseDifference:
    given = [flat({**row["document"], "options": row["options"]}) | {"task": row["task"]} for row in (before, after)]
    results = [{"status": row["status"], **row["outputs"], "reason": row["reason"]} for row in (before, after)]
    return CaseDifference(before["varied"], changes(*given), changes(*results))


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Change]:
    """Entries that differ, before and after."""
    keys = dict.fromkeys([*before, *after])
    return {key: (before.get(key), after.get(key)) for key in keys if before.get(key) != after.get(key)}


def flat(tables: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as one, by dotted keys."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        found |= flat(value, f"{before}{key}.") if isinstance(value, Mapping) else {before + key: value}
    return found


def relative(change: Change) -> float | None:
    """Relative change of a number; None for anything else, or from zero."""
    before, after = change
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in change)
    return (after - before) / abs(before) if numbers and before else None


def idle_keys(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Varied keys whose values, all else alike, have changed no answer: a mistake more often than one.

    None where no two cases that are done differ in one alone.

    Args:
        records: of all cases, with what was varied, how each came out and its outputs.
    """
    answered = [record for record in records if record["status"] in ("done", "no") and record.get("varied")]
    varied = dict.fromkeys(key for record in answered for key in record["varied"])
    return [key for key in varied if _idle(key, answered)]


def _idle(key: str, records: Sequence[Mapping[str, Any]]) -> bool:
    alike = defaultdict(list)
    for record in records:
        others = {name: value for name, value in record["varied"].items() if name != key}
        alike[repr(sorted(others.items()))].append(record)
    both = ((first, other) for first, *rest in alike.values() for other in rest)
    pairs = [pair for pair in both if pair[0]["varied"].get(key) != pair[1]["varied"].get(key)]
    results = [[(one["status"], one["outputs"]) for one in pair] for pair in pairs]
    return any(first[0] == "done" for first, _ in results) and all(first == other for first, other in results)
