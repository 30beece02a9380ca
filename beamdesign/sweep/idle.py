"""Keys that a sweep varies without any effect, which is a mistake more often than an answer."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any


def idle_keys(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Keys whose values, all else alike, have changed no result; none where no two finished cases differ in one alone.

    Args:
        records: of all cases, with what was varied, how each came out and its outputs.
    """
    finished = [record for record in records if record["status"] == "done" and record.get("varied")]
    varied = dict.fromkeys(key for record in finished for key in record["varied"])
    return [key for key in varied if _idle(key, finished)]


def _idle(key: str, records: Sequence[Mapping[str, Any]]) -> bool:
    alike = defaultdict(list)
    for record in records:
        others = {name: value for name, value in record["varied"].items() if name != key}
        alike[repr(sorted(others.items()))].append(record)
    pairs = [
        (first, other)
        for first, *rest in alike.values()
        for other in rest
        if first["varied"].get(key) != other["varied"].get(key)
    ]
    return bool(pairs) and all(first["outputs"] == other["outputs"] for first, other in pairs)
