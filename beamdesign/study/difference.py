"""Two result folders compared: which inputs changed, and what that did, case by case."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beamdesign.study.store import in_words, rows_of

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
    before, after = (_by_varied(one.records) for one in kept)
    both = [key for key in before if key in after]
    cases = tuple(_case(before[key], after[key]) for key in both)
    shared = {
        key: change
        for key, change in (cases[0].inputs if cases else {}).items()
        if all(case.inputs.get(key) == change for case in cases)
    }
    return Difference(
        cases,
        shared,
        any(before[key]["code_sha256"] != after[key]["code_sha256"] for key in both),
        tuple(row["varied"] for key, row in before.items() if key not in after),
        tuple(row["varied"] for key, row in after.items() if key not in before),
        tuple(in_words([*kept[0].unsound, *kept[1].unsound])),
    )


def _by_varied(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {json.dumps(row["varied"], sort_keys=True): row for row in rows}


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
