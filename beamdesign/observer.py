"""The record of a controller with several sensors: state feedback with an observer, or any dynamic output feedback."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.records import Problem, Record

Sensed = Literal["displacement_m", "inner_displacement_m", "load_pressure_Pa"]
SENSED: tuple[Sensed, ...] = ("displacement_m", "inner_displacement_m", "load_pressure_Pa")
"""What such a controller may sense: the outer tip, which every controller does, the inner tip, the load pressure."""

LARGEST_ORDER = 12

Row = tuple[q.MatrixEntry, ...]


class Observer(Record):
    """z' = a z + b e + b_command command_V, current = gain_A_per_V (c z + d e): a linear controller of many sensors.

    e_1 is command_V less the volts of the displacement sensor, behind its filter, as for every other controller. Each
    further e_k is minus what an ideal added sensor reads, in SI: the inner tip's displacement in m or the load
    pressure in Pa, both zero at rest. n is the order, p the number of sensors.
    """

    kind: Annotated[Literal["observer"], Field(description="which law, with its own figures")] = "observer"
    gain_A_per_V: Annotated[q.LawGain, Field(description="factor on the whole law, so that it alone scales the loop")]
    sensors: Annotated[
        tuple[Sensed, ...], Field(description="what it senses, each once, displacement_m first; they order b and d")
    ]
    a: Annotated[tuple[Row, ...], Field(description="n rows of n, 1/s; n up to 12, and [] for a static gain")]
    b: Annotated[tuple[Row, ...], Field(description="n rows of one entry per sensor")]
    c: Annotated[Row, Field(description="n entries")]
    d: Annotated[Row, Field(description="one entry per sensor")]
    b_command: Annotated[
        Row, Field(description="n entries, what command_V does to z' beside its part of e_1; [] for nothing")
    ] = ()

    @property
    def order(self) -> int:
        """How many states it has."""
        return len(self.a)

    @property
    def added(self) -> tuple[Sensed, ...]:
        """What it senses beside the displacement."""
        return self.sensors[1:]

    @classmethod
    def of(
        cls, gain_A_per_V: float, sensors: Sequence[Sensed], a: Any, b: Any, c: Any, d: Any, b_command: Any = ()
    ) -> Self:
        """The record of matrices in anything that nests like them, such as arrays of (n, n), (n, p), (n,) and (p,)."""
        return cls(
            gain_A_per_V=float(gain_A_per_V),
            sensors=tuple(sensors),
            a=tuple(tuple(float(value) for value in row) for row in a),
            b=tuple(tuple(float(value) for value in row) for row in b),
            c=tuple(float(value) for value in c),
            d=tuple(float(value) for value in d),
            b_command=tuple(float(value) for value in b_command),
        )

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The sensors are what can be sensed so, and the matrices fit each other."""
        sensors, a, b, c, d = (_entries(table.get(key)) for key in ("sensors", "a", "b", "c", "d"))
        if sensors is not None:
            if not sensors or sensors[0] != SENSED[0]:
                yield Problem("sensors", f"must begin with {SENSED[0]!r}, whose volts close the loop")
            for name in dict.fromkeys(name for name in sensors if sensors.count(name) > 1):
                yield Problem("sensors", f"{name!r} stands there more than once")
        if a is not None:
            if len(a) > LARGEST_ORDER:
                yield Problem("a", f"is of order {len(a)}; at most {LARGEST_ORDER} can be")
            yield from _widths("a", a, len(a), "to be square")
            if b is not None and len(b) != len(a):
                yield Problem("b", f"must have a row for each of the {len(a)} of a, has {len(b)}")
            commanded = _entries(table.get("b_command"))
            if commanded and len(commanded) != len(a):
                yield Problem("b_command", f"must have an entry for each of the {len(a)} of a, has {len(commanded)}")
            if c is not None and len(c) != len(a):
                yield Problem("c", f"must have an entry for each of the {len(a)} rows of a, has {len(c)}")
        if sensors:
            if len(sensors) == 1 and _entries(table.get("b_command")):
                yield Problem("b_command", "has no meaning without an added sensor; leave it out")
            if b is not None:
                yield from _widths("b", b, len(sensors), "one per sensor")
            if d is not None and len(d) != len(sensors):
                yield Problem("d", f"must have an entry for each of the {len(sensors)} sensors, has {len(d)}")


def _entries(value: Any) -> Sequence[Any] | None:
    """What stands in brackets, None for what does not."""
    return value if isinstance(value, list | tuple) else None


def _widths(key: str, matrix: Sequence[Any], width: int, why: str) -> Iterator[Problem]:
    for number, row in enumerate(matrix, start=1):
        entries = _entries(row)
        if entries is not None and len(entries) != width:
            yield Problem(key, f"entry {number}: must hold {width} entries, {why}, holds {len(entries)}")
