"""What the controller does in one period, written once for every arithmetic; coefficients as a machine holds them.

Integers, floats of 32 bits, exact linear forms and C text are made from the same lines by exchanging the operations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import frexp
from typing import Protocol, TypeVar

import numpy as np
from flint import fmpq

from beamdesign.realisation.sections import Channel, DiscreteLaw, Section

V = TypeVar("V")


class Arithmetic(Protocol[V]):
    """The operations of the law; names are those of coefficients, states and signals."""

    def read(self, state: str) -> V:
        """A state, rounded to a word."""

    def multiply(self, coefficient: str, value: V) -> V:
        """A coefficient times a word."""

    def add(self, one: V, other: V) -> V:
        """A sum."""
        return one + other  # type: ignore[operator]

    def subtract(self, one: V, other: V) -> V:
        """A difference."""
        return one - other  # type: ignore[operator]

    def signal(self, name: str, value: V) -> V:
        """A named signal: limited to what a word holds."""

    def begin(self, channel: int) -> None:
        """What follows belongs to a channel, by its place."""
        return

    def current(self, terms: Sequence[tuple[str, V]]) -> V:
        """The sum of gains, by name, times words, limited to the largest current."""

    def advance(self, state: str, coefficient: str, value: V, held: bool) -> None:
        """Add a coefficient times a word to a state; `held`: not while that drives a limited current further."""


def one_period(channels: Sequence[Channel], readings: Sequence[V], arithmetic: Arithmetic[V]) -> V:
    """The current of one sample; all states are advanced after it is known.

    Anti-windup: while the current is at its limit, sections of first order that the error passes and whose output
    follows the state more than the input (direct term below one, a lag) do not move further in that direction. The
    other sections are stable filters of unit static gain and run on.
    """
    number, terms, advances = 0, [], []
    for place, (channel, value) in enumerate(zip(channels, readings, strict=True)):
        arithmetic.begin(place)
        for section in channel.sections:
            number += 1
            x = arithmetic.read(f"x{number}")
            missing = arithmetic.subtract(value, x)
            if section.order == 1:
                d = arithmetic.signal(f"d{number}", missing)
                value = arithmetic.add(x, arithmetic.multiply(f"direct{number}", d))
                held = place == 0 and channel.gain > 0 and section.direct < 1
                advances.append((place, f"x{number}", f"follow{number}", d, held))
            else:
                w = arithmetic.read(f"w{number}")
                missing = arithmetic.subtract(missing, arithmetic.multiply(f"damping{number}", w))
                d = arithmetic.signal(f"d{number}", missing)
                value = arithmetic.add(x, arithmetic.multiply(f"slope{number}", w))
                value = arithmetic.add(value, arithmetic.multiply(f"direct{number}", d))
                advances.append((place, f"x{number}", f"follow{number}", w, False))
                advances.append((place, f"w{number}", f"follow{number}", d, False))
            value = arithmetic.signal(f"y{number}", value)
        terms.append((channel.gain_name, value))
    current = arithmetic.current(terms)
    for place, state, coefficient, given, held in advances:
        arithmetic.begin(place)
        arithmetic.advance(state, coefficient, given, held)
    return current


def states_of(sections: Sequence[Section]) -> tuple[str, ...]:
    """Names of the states, in order."""
    return tuple(f"{letter}{number}" for number, section in enumerate(sections, 1) for letter in "xw"[: section.order])


def coefficients_of(law: DiscreteLaw) -> dict[str, float]:
    """Values of all its coefficients by name, the gains last."""
    named: dict[str, float] = {}
    for number, section in enumerate(law.sections, 1):
        named[f"follow{number}"] = section.follow
        if section.order == 2:
            named[f"damping{number}"] = section.damping
            named[f"slope{number}"] = section.slope
        named[f"direct{number}"] = section.direct
    return named | {channel.gain_name: channel.gain for channel in law.channels}


@dataclass(frozen=True)
class Coefficient:
    """A coefficient as realised.

    Attributes:
        asked: before rounding.
        integer: of a fixed-point coefficient integer / 2^places; None in floats.
        places: binary places of it.
    """

    asked: float
    integer: int | None
    places: int

    @property
    def value(self) -> fmpq:
        """As realised, exact."""
        if self.integer is not None:
            return fmpq(self.integer, 2**self.places)
        exactly = Fraction(float(np.float32(self.asked)))
        return fmpq(exactly.numerator, exactly.denominator)

    @property
    def error(self) -> float:
        """Relative, of what is realised; 0 where nothing was asked."""
        return int(self.value.p) / int(self.value.q) / self.asked - 1 if self.asked else 0.0


def fixed_point(value: float, word_length: int, more_places: int = 0) -> Coefficient:
    """Round to a word of its own scaling: the integer has word_length - 1 significant bits, and a sign.

    No more than 2 word_length - 2 places are used, so that a word times it, rounded, fits two words; `more_places`
    where the word that it multiplies has so many less than none, as of a pressure in Pa.

    Raises:
        ValueError: where it is too large for a word without places.
    """
    most = 2 ** (word_length - 1) - 1
    places = min(word_length - 1 - frexp(value)[1], 2 * word_length - 2 + more_places) if value else 0
    while abs(integer := round(Fraction(value) * Fraction(2) ** places)) > most:
        places -= 1
    if places < 0:
        raise ValueError(f"a coefficient of {value:.6g} is too large for words of {word_length} bits")
    return Coefficient(value, integer, places)


def float32(value: float) -> Coefficient:
    """Round to the nearest float of 32 bits."""
    return Coefficient(value, None, 0)


def float64(value: float) -> Coefficient:
    """A float of 64 bits as it is: an integer over a power of two."""
    integer, below = value.as_integer_ratio()
    return Coefficient(value, integer, below.bit_length() - 1)
