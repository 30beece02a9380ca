"""Results as JSON: plain values, and no figure that is not finite."""

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from operator import attrgetter
from typing import Any


def picked(found: Any, names: str) -> dict[str, Any]:
    """Attributes of a record by name.

    Args:
        found: the record.
        names: separated by blanks; `name=path.to.it` is for one that stands deeper, or under another name.
    """
    words = (word.partition("=") for word in names.split())
    return {name: attrgetter(path or name)(found) for name, _, path in words}


def json_text(fields: Mapping[str, Any]) -> str:
    """Fields as the text of a JSON file."""
    return json.dumps(finite(fields), indent=2, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """Records, arrays, rationals and their figures as dictionaries, lists and numbers of Python; else as text.

    JSON has no infinity, so that figures that are not finite become None.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: finite(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "model_dump"):
        return finite(value.model_dump(mode="json", exclude_none=True))
    if isinstance(value, Mapping):
        return {str(name): finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    if isinstance(value, str | int) or value is None:
        return value
    if hasattr(value, "q"):  # a rational of python-flint: the float nearest to it
        return int(value.p) / int(value.q)
    return finite(value.tolist()) if hasattr(value, "tolist") else str(value)
