"""The same link so many times as heavy, as long and as slow: by dimensional analysis all of it moves alike.

E. Buckingham, On physically similar systems, Physical Review 4, 1914. Every key states its unit as a suffix.
"""

import re
from typing import Any, TypeVar

from beamdesign.quantities import parted
from beamdesign.records import Record

R = TypeVar("R", bound=Record)

Scales = tuple[float, float, float]
"""Of masses, lengths and times."""

EIGHTH: Scales = (8.0**-3, 8.0**-1, 8.0**-1)
"""Of the same materials: stresses and speeds are the same."""

_POWERS = {
    "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "Hz": (0, 0, -1), "N": (1, 1, -2), "Pa": (1, -1, -2),
}  # fmt: skip
"""Of mass, length and time; volts, amperes and angles stay."""


def factor(name: str, scales: Scales) -> float:
    """What the figure of a key is multiplied by."""
    found, (above, *below) = 1.0, parted(name)[1].split("/")
    for units, sign in ((above, 1), *((one, -1) for one in below)):
        for unit in units.split():
            base, power = re.fullmatch(r"(\D+|1)(\d?)", unit).groups()
            for scale, of in zip(scales, _POWERS.get(base, (0, 0, 0)), strict=True):
                found *= scale ** (sign * of * int(power or 1))
    return found


def similar(record: R, scales: Scales) -> R:
    """The record with all its figures, and those of the records in it, in these proportions."""

    def scaled(name: str, value: Any) -> Any:
        if isinstance(value, Record):
            return similar(value, scales)
        if isinstance(value, tuple):
            return tuple(scaled(name, one) for one in value)
        return value * factor(name, scales) if isinstance(value, float) else value

    return record.model_copy(update={name: scaled(name, getattr(record, name)) for name in type(record).model_fields})
