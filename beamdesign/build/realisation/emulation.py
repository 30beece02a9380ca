"""The controller step by step, in the same integers (or floats of 32 bits) as the C code: equal to the last bit."""

from collections.abc import Sequence
from functools import reduce
from math import ceil, floor
from operator import add

import numpy as np

from beamdesign.build.realisation.law import Arithmetic, one_period
from beamdesign.build.realisation.realise import Realisation


def shifted(value: int, places: int) -> int:
    """Drop binary places, rounding to the nearest and halves away from zero, so that no sign is favoured."""
    half = (1 << places) >> 1
    return (value + half) >> places if value >= 0 else -((half - value) >> places)


class FixedPoint(Arithmetic[int]):
    """The fixed-point controller.

    Attributes:
        states: by name, with `state_places` binary places.
        limited: whether the last current was at its limit: -1, 0 or 1.
    """

    def __init__(self, realisation: Realisation):
        if realisation.word_length is None:
            raise ValueError("a realisation in floats")
        self.realisation = realisation
        self._given = {name: (one.integer or 0, one.places) for name, one in realisation.coefficients.items()}
        self._most = 2 ** (realisation.word_length - 1) - 1
        self._extra = realisation.state_extra
        self._shifts = realisation.current_shifts
        self.limited = 0
        self.reset(*(0 for _ in realisation.channels))

    def reset(self, *readings: int) -> None:
        """At rest under constant readings, so that the first current is that of the static gains."""
        given = [self.signal("", reading) << self._extra for reading in readings]
        self.states = {n: given[k] if n[0] == "x" else 0 for n, k in self.realisation.state_channels.items()}

    def step(self, *readings: int) -> int:
        """The current of one sample, all as words; the error first."""
        given = [self.signal("", reading) for reading in readings]
        return one_period(self.realisation.channels, given, self)

    def read(self, state: str) -> int:  # noqa: D102
        return shifted(self.states[state], self._extra)

    def multiply(self, coefficient: str, value: int) -> int:  # noqa: D102
        integer, places = self._given[coefficient]
        return shifted(integer * value, places)

    def signal(self, name: str, value: int) -> int:  # noqa: D102
        return max(-self._most, min(self._most, value))

    def current(self, terms: Sequence[tuple[str, int]]) -> int:  # noqa: D102
        product = sum(shifted(self._given[gain][0] * value, self._shifts[gain]) for gain, value in terms)
        most = self.realisation.current_limit
        self.limited = (product > most) - (product < -most)
        return max(-most, min(most, product))

    def advance(self, state: str, coefficient: str, value: int, held: bool) -> None:  # noqa: D102
        if held and self.limited * value > 0:
            return
        integer, places = self._given[coefficient]
        most = self._most << self._extra
        after = self.states[state] + shifted(integer * value, places - self._extra)
        self.states[state] = max(-most, min(most, after))


class Float32(Arithmetic[np.float32]):
    """The controller in floats of 32 bits; every operation rounds once, to the nearest."""

    def __init__(self, realisation: Realisation):
        if realisation.word_length is not None:
            raise ValueError("a realisation in fixed point")
        self.realisation = realisation
        self._given = {name: np.float32(one.asked) for name, one in realisation.coefficients.items()}
        self._largest = np.float32(realisation.largest_current_A)
        self.limited = 0
        self.reset(*(0.0 for _ in realisation.channels))

    def reset(self, *readings: float) -> None:
        """At rest under constant readings (V, m, Pa)."""
        places = self.realisation.state_channels
        self.states = {n: np.float32(readings[k] if n[0] == "x" else 0) for n, k in places.items()}

    def step(self, *readings: float) -> np.float32:
        """The current (A) of one sample (V, m, Pa); the error first."""
        return one_period(self.realisation.channels, [np.float32(reading) for reading in readings], self)

    def read(self, state: str) -> np.float32:  # noqa: D102
        return self.states[state]

    def multiply(self, coefficient: str, value: np.float32) -> np.float32:  # noqa: D102
        return self._given[coefficient] * value

    def signal(self, name: str, value: np.float32) -> np.float32:  # noqa: D102
        return value

    def current(self, terms: Sequence[tuple[str, np.float32]]) -> np.float32:  # noqa: D102
        product = reduce(add, (self._given[gain] * value for gain, value in terms))
        self.limited = int(product > self._largest) - int(product < -self._largest)
        return product if self.limited == 0 else np.float32(self.limited) * self._largest

    def advance(self, state: str, coefficient: str, value: np.float32, held: bool) -> None:  # noqa: D102
        if held and self.limited * value > 0:
            return
        self.states[state] = self.states[state] + self._given[coefficient] * value


def to_word(realisation: Realisation, reading: float, channel: int = 0) -> int:
    """A reading (V, m, Pa) as a word: the nearest, halves away from zero."""
    scaled = reading * 2.0 ** realisation.places[channel]
    return floor(scaled + 0.5) if scaled >= 0 else ceil(scaled - 0.5)
