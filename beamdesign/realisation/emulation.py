"""The controller step by step, in the same integers (or floats of 32 bits) as the C code: equal to the last bit."""

from collections.abc import Sequence
from math import ceil, floor

import numpy as np

from beamdesign.realisation.law import one_period
from beamdesign.realisation.realise import Realisation


def shifted(value: int, places: int) -> int:
    """Drop binary places, rounding to the nearest and halves away from zero, so that no sign is favoured."""
    half = (1 << places) >> 1
    return (value + half) >> places if value >= 0 else -((half - value) >> places)


class FixedPoint:
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
        self._extra = realisation.word_length - 2
        self.limited = 0
        self.reset(0)

    def reset(self, error: int) -> None:
        """At rest under a constant error, so that the first current is that of the static gain."""
        error = max(-self._most, min(self._most, error))
        self.states = {name: error << self._extra if name[0] == "x" else 0 for name in self.realisation.states}

    def step(self, error: int) -> int:
        """The current of one sample, both as words."""
        return one_period(self.realisation.sections, self.signal("error", error), self)

    def read(self, state: str) -> int:  # noqa: D102
        return shifted(self.states[state], self._extra)

    def multiply(self, coefficient: str, value: int) -> int:  # noqa: D102
        integer, places = self._given[coefficient]
        return shifted(integer * value, places)

    def add(self, one: int, other: int) -> int:  # noqa: D102
        return one + other

    def subtract(self, one: int, other: int) -> int:  # noqa: D102
        return one - other

    def signal(self, name: str, value: int) -> int:  # noqa: D102
        return max(-self._most, min(self._most, value))

    def current(self, value: int) -> int:  # noqa: D102
        product = shifted(self._given["gain"][0] * value, self.realisation.current_shift)
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


class Float32:
    """The controller in floats of 32 bits; every operation rounds once, to the nearest."""

    def __init__(self, realisation: Realisation):
        if realisation.word_length is not None:
            raise ValueError("a realisation in fixed point")
        self.realisation = realisation
        self._given = {name: np.float32(one.asked) for name, one in realisation.coefficients.items()}
        self._largest = np.float32(realisation.largest_current_A)
        self.limited = 0
        self.reset(0.0)

    def reset(self, error: float) -> None:
        """At rest under a constant error (V)."""
        self.states = {name: np.float32(error if name[0] == "x" else 0) for name in self.realisation.states}

    def step(self, error: float) -> np.float32:
        """The current (A) of one sample (V)."""
        return one_period(self.realisation.sections, np.float32(error), self)

    def read(self, state: str) -> np.float32:  # noqa: D102
        return self.states[state]

    def multiply(self, coefficient: str, value: np.float32) -> np.float32:  # noqa: D102
        return self._given[coefficient] * value

    def add(self, one: np.float32, other: np.float32) -> np.float32:  # noqa: D102
        return one + other

    def subtract(self, one: np.float32, other: np.float32) -> np.float32:  # noqa: D102
        return one - other

    def signal(self, name: str, value: np.float32) -> np.float32:  # noqa: D102
        return value

    def current(self, value: np.float32) -> np.float32:  # noqa: D102
        product = self._given["gain"] * value
        self.limited = int(product > self._largest) - int(product < -self._largest)
        return product if self.limited == 0 else np.float32(self.limited) * self._largest

    def advance(self, state: str, coefficient: str, value: np.float32, held: bool) -> None:  # noqa: D102
        if held and self.limited * value > 0:
            return
        self.states[state] = self.states[state] + self._given[coefficient] * value


def to_word(realisation: Realisation, error_V: float) -> int:
    """A voltage as a word: the nearest, halves away from zero."""
    scaled = error_V * 2.0**realisation.signal_places
    return floor(scaled + 0.5) if scaled >= 0 else ceil(scaled - 0.5)


def in_volts_and_amperes(realisation: Realisation, errors_V: Sequence[float]) -> list[float]:
    """Currents (A) of a series of errors (V), from rest."""
    if realisation.word_length is None:
        float_machine = Float32(realisation)
        return [float(float_machine.step(e)) for e in errors_V]
    machine = FixedPoint(realisation)
    unit = 2.0**-realisation.current_places
    return [machine.step(to_word(realisation, e)) * unit for e in errors_V]
