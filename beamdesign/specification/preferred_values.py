"""Preferred values of components, IEC 60063: series E6, E12, E24 and E96."""

from bisect import bisect_left
from functools import cache
from math import floor, log10
from typing import Literal

Series = Literal["E6", "E12", "E24", "E96"]

_E24 = (
    1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0,
    3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1,
)  # fmt: skip
DECADE: dict[str, tuple[float, ...]] = {
    "E6": _E24[::4],
    "E12": _E24[::2],
    "E24": _E24,  # not the rounded powers of ten: 2.7 to 4.7 and 8.2 depart from them
    "E96": tuple(round(10 ** (k / 96), 2) for k in range(96)),
}
"""Values of one decade, from 1 to below 10."""


@cache
def values_between(series: Series, low: float, high: float) -> tuple[float, ...]:
    """All values of a series from `low` to `high`, both included, ascending."""
    found = []
    for exponent in range(floor(log10(low)), floor(log10(high)) + 1):
        found += [float(f"{step:g}e{exponent}") for step in DECADE[series]]
    return tuple(value for value in found if low * (1 - 1e-9) <= value <= high * (1 + 1e-9))


def neighbours(series: Series, value: float, count: int = 1) -> tuple[float, ...]:
    """The values of a series next to a positive one: so many at or below it, and as many above."""
    exponent = floor(log10(value))
    listed = values_between(series, float(f"1e{exponent - 1}"), float(f"1e{exponent + 2}"))
    place = bisect_left(listed, value * (1 + 1e-12))
    return listed[max(place - count, 0) : place + count]
