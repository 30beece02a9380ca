"""Dotted keys of a study or prototype file: which there are, and how a value is put under one."""

import difflib
import re
from collections.abc import Iterator, Mapping
from typing import Any, get_args

from beamdesign.records import Record, nested_records

_STEP = re.compile(r"(?P<key>[^\[\]]+)(?:\[(?P<entry>\d+)\])?\Z")


def known_keys(record: type[Record]) -> dict[str, int]:
    """Every dotted key of a record type, tables included, with how many entries its list has (0 for no list).

    The keys of effects are those of the effect library.
    """
    found = dict(_walk(record, ""))
    if "effects" in record.model_fields:
        from beamdesign.rig.effects import library

        for name, effect in library().items():
            found[f"effects.{name}"] = 0
            found |= {f"effects.{name}.{parameter.name}": 0 for parameter in effect.parameters}
    return found


def _walk(record: type[Record], before: str) -> Iterator[tuple[str, int]]:
    for name, field in record.model_fields.items():
        yield before + name, _entries(field.annotation)
        for nested in nested_records(field.annotation):
            yield from _walk(nested, f"{before}{name}.")


def _entries(annotation: Any) -> int:
    """Entries of a tuple of fixed length somewhere in an annotation; 0 where there is none."""
    if getattr(annotation, "__origin__", None) is tuple:
        return len(get_args(annotation))
    return max((_entries(part) for part in get_args(annotation)), default=0)


def wrong_key(key: str, known: Mapping[str, int]) -> str:
    """Why a key cannot be varied, with the nearest that can; empty where it can."""
    parts = _STEP.match(key)
    if parts is None:
        return "not a key; write table.key, or table.key[0] for one entry of a list"
    name, entry = parts["key"], parts["entry"]
    if name not in known:
        ends: dict[str, list[str]] = {}
        for there in known:
            ends.setdefault(there.rpartition(".")[2], []).append(there)
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
        last = difflib.get_close_matches(name.rpartition(".")[2], ends, n=2, cutoff=0.75)
        near = list(dict.fromkeys([*near, *(there for end in last for there in ends[end])]))[:4]
        return "unknown key; " + (f"nearest are {', '.join(near)}" if near else "none is near it")
    if entry is not None and int(entry) >= known[name]:
        return f"{name} has {known[name]} entries, counted from 0" if known[name] else f"{name} is not a list"
    return ""


def with_value(document: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A document with one value put under a dotted key; tables on the way are made where they are missing.

    The document itself stays as it is; what is not on the way is shared with it.

    Raises:
        ValueError: where an entry of a list is meant and there is no such list yet, or no table on the way.
    """
    changed = dict(document)
    parts = _STEP.match(key)
    assert parts is not None  # checked by `wrong_key`
    *way, last = parts["key"].split(".")
    table = changed
    for step in way:
        below = table.get(step, {})
        if not isinstance(below, Mapping):
            raise ValueError(f"{key}: {step} is not a table")
        table[step] = dict(below)
        table = table[step]
    if parts["entry"] is None:
        table[last] = value
        return changed
    listed = table.get(last)
    if not isinstance(listed, list | tuple) or len(listed) <= int(parts["entry"]):
        raise ValueError(f"{key}: there is no list to change one entry of; give the whole list")
    entries = list(listed)
    entries[int(parts["entry"])] = value
    table[last] = entries
    return changed


def value_at(document: Mapping[str, Any], key: str) -> Any:
    """The value under a dotted key, None where there is none."""
    parts = _STEP.match(key)
    assert parts is not None
    value: Any = document
    for step in parts["key"].split("."):
        value = value.get(step) if isinstance(value, Mapping) else None
    if parts["entry"] is not None:
        entry = int(parts["entry"])
        value = value[entry] if isinstance(value, list | tuple) and entry < len(value) else None
    return value
