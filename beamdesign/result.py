"""What every public function gives: a record that states its answer, and shows itself in a terminal and a notebook.

And results as JSON: plain values, and no figure that is not finite.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from html import escape
from math import isfinite
from operator import attrgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Result:
    """Base of the frozen records that public functions give.

    A record of this kind may have a field or a property `reason`: why the answer is no. Two are equal where they are of
    one kind and all their figures are, arrays and enclosures among them.
    """

    def __init_subclass__(cls) -> None:
        # Those that a dataclass makes ask arrays and enclosures of numbers for a truth that they do not have.
        cls.__eq__, cls.__hash__ = Result.__eq__, Result.__hash__  # type: ignore[method-assign]

    def __eq__(self, other: object) -> bool:
        return self is other or (type(self) is type(other) and _plain(self) == _plain(other))

    def __hash__(self) -> int:
        # Of numbers and words alone: those that are equal, as 1 and 1.0, have one hash in Python, but not one text.
        return hash((type(self), *(value for value in _plain(self).values() if not isinstance(value, dict | list))))

    @property
    def yes(self) -> bool:
        """Whether the answer is yes; of a command the exit status is 1 where it is no."""
        return not getattr(self, "reason", "")

    @property
    def status(self) -> str:
        """The answer in a word."""
        return "yes" if self.yes else "no"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as they stand in a JSON file; what is not finite is None."""
        return finite(self)

    def rows(self) -> Sequence[tuple[Any, ...]]:
        """Its figures for people, the same in a terminal and on a page: name with the unit in it, and value.

        What was found comes before the rig that it was found for.
        """
        return list(_figures(dict(sorted(self.to_dict().items(), key=lambda field: field[0] == "prototype"))))

    def pictures(self) -> "dict[str, Figure]":
        """The pictures of the rig that it gives, by name: see `beamdesign.pictures`.

        Raises:
            ValueError: where it gives no rig.
        """
        import beamdesign  # results do not rest on how they are drawn: no import of the module that draws

        if (rig := getattr(self, "prototype", None)) is None:
            raise ValueError(f"{type(self).__name__} gives no rig to draw: {self.status}")
        return beamdesign.pictures(rig)

    def __repr__(self) -> str:
        figures = ", ".join(
            f"{shown(name)}={shown(value)}" for name, value, *_ in self.rows() if not isinstance(value, str)
        )
        words = "; ".join(part for part in (self.status, str(getattr(self, "reason", "")), figures) if part)
        return f"<{type(self).__name__}: {words}>"

    def _repr_html_(self) -> str:
        texts = (("" if cell is None else shown(cell) for cell in row) for row in self.rows())
        cells = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in texts)
        reason = str(getattr(self, "reason", ""))
        heading = f"{type(self).__name__}: {self.status}" + (f": {reason}" if reason else "")
        return f"<p>{escape(heading)}</p><table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def _plain(found: Any) -> dict[str, Any]:
    """The fields of a record that it compares, as plain values; what is not finite as text, so that it differs."""
    return {field.name: finite(getattr(found, field.name), beyond=str) for field in fields(found) if field.compare}


def _figures(fields: Mapping[str, Any], inside: str = "") -> Iterator[tuple[str, Any]]:
    """What of some fields is a figure or a word, those of tables inside by their names and a dot."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            yield from _figures(value, f"{inside}{name}.")
        elif isinstance(value, str | int | float) and value != "" and name != "reason":
            yield f"{inside}{name}", value


def shown(cell: Any) -> str:
    """A cell of a table as text: floats with the seven significant digits that guaranteed figures have."""
    return f"{cell:.7g}" if isinstance(cell, float) and isfinite(cell) else str(cell)


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


def finite(value: Any, digits: int | None = None, beyond: Callable[[float], Any] = lambda figure: None) -> Any:
    """Records, arrays, rationals and their figures as dictionaries, lists and numbers of Python; else as text.

    JSON has no infinity, so that figures that are not finite become None. What a record neither shows nor compares is
    of its making, and left out.

    Args:
        value: any of these.
        digits: significant ones that a float keeps; all where None.
        beyond: gives what stands for a figure that is not finite.
    """
    inside = partial(finite, digits=digits, beyond=beyond)
    if is_dataclass(value) and not isinstance(value, type):
        stated = (field.name for field in fields(value) if field.repr or field.compare)
        return {name: inside(getattr(value, name)) for name in stated}
    if hasattr(value, "model_dump"):
        return inside(value.model_dump(mode="json", exclude_none=True))
    if isinstance(value, Mapping):
        return {str(name): inside(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [inside(item) for item in value]
    if isinstance(value, float):
        shown = value if digits is None else f"{value:.{digits}g}"
        return float(shown) if isfinite(value) else beyond(value)
    if isinstance(value, str | int) or value is None:
        return value
    if hasattr(value, "q"):  # a rational of python-flint: the float nearest to it
        return int(value.p) / int(value.q)
    return inside(value.tolist()) if hasattr(value, "tolist") else str(value)
