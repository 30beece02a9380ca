"""What the records that files are read as say of a field, in words."""

import re
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from beamdesign.quantities import Plausible
from beamdesign.records import Record


def described(record: type[Record]) -> tuple[str, str]:
    """What a record is in its first sentence, and the `Source:` that its docstring states."""
    source = re.search(r"Source: (.*?)(?:\n\s*\n|$)", text := record.__doc__ or "", flags=re.DOTALL)
    return first_sentence(text), " ".join(source[1].split()).rstrip(".") if source else ""


def first_sentence(text: str) -> str:
    """The first paragraph of a text as one line without its full stop."""
    return " ".join(text.split("\n\n")[0].split()).rstrip(".")


def kind_of(annotation: Any) -> str:
    """What a field takes, by its annotation."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return kind_of(parts[0])
    if origin in (Union, UnionType):
        return " or ".join(kind_of(part) for part in parts if part is not NoneType)
    if origin is Literal:
        return ("one of " if len(parts) > 1 else "") + ", ".join(f'"{part}"' for part in parts)
    if origin is tuple and Ellipsis in parts:
        each = kind_of(parts[0])
        if each.startswith(("one of ", "a list of ")):
            return f"a list, each {each}"
        return f"a list of {each.removeprefix('a ')}s"
    if origin is tuple:
        return f"a list of {len(parts)} {kind_of(parts[0]).removeprefix('a ')}s"
    if origin is dict or annotation is dict:
        return "a table"
    if isinstance(annotation, type) and issubclass(annotation, str | Record):
        return "text"
    return {float: "a number", int: "a whole number", bool: "true or false"}.get(annotation, "a value")


def numeric(annotation: Any) -> bool:
    """Whether a field takes figures, which have a unit."""
    inside = () if get_origin(annotation) is dict else get_args(annotation)
    return annotation is float or any(map(numeric, inside))


def _limits(annotation: Any) -> Iterator[Any]:
    """What a type's annotations demand, at any depth."""
    for part in get_args(annotation):
        if isinstance(part, FieldInfo):
            yield from part.metadata
        elif hasattr(part, "__dataclass_fields__") and not isinstance(part, type):
            yield part
        else:
            yield from _limits(part)


_SIDES = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
"""Limits that a type may state, at most one to each side."""


def bounds_of(field: FieldInfo) -> str:
    """The range of a field's figures; empty where nothing limits them."""
    limits = (*field.metadata, *_limits(field.annotation))
    if plausible := [limit for limit in limits if isinstance(limit, Plausible)]:
        return f"from {plausible[0]}"
    stated = ((word, getattr(limit, side, None)) for side, word in _SIDES.items() for limit in limits)
    return ", ".join(dict.fromkeys(f"{word} {value:g}" for word, value in stated if value is not None))


def default_of(field: FieldInfo) -> str:
    """What stands for a field that is left out."""
    if field.is_required():
        return "needed"
    if field.default_factory_takes_validated_data:
        return "from the others"
    value = field.get_default(call_default_factory=True)
    return "none" if value in (PydanticUndefined, None, (), {}) else shown(value)


def shown(value: Any) -> str:
    """A value as it would stand in TOML."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return "[" + ", ".join(shown(item) for item in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
