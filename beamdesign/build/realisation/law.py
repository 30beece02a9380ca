"""What the controller does in one period, written once for every arithmetic; as difference equations; coefficients.

Integers, floats of 32 bits, exact linear forms and C text are made from the same lines by exchanging the operations. As
difference equations in floats of 64 bits it is what is specified and simulated.

A linear form is what a value depends on: a coefficient per state, per reading, and per rounding made so far. Roundings
count as bounded inputs of the linear law, which is no approximation: a rounded value is the value plus something that
is at most half a step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from math import frexp
from typing import Literal, Protocol, TypeVar

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.build.realisation.sections import Channel, DiscreteLaw, Section, discretised
from beamdesign.controllers import Controller, TransferFunction
from beamdesign.polynomial import nearest

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

    def advance(self, state: str, coefficient: str, value: V, held: int) -> None:
        """Add a coefficient times a word to a state; not while that drives a limited current further.

        It does so by the sign `held`, 1 or -1; where that is 0 the state is always advanced.
        """


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
                held = (1 if channel.gain > 0 else -1) if place == 0 and section.direct < 1 else 0
                advances.append((place, f"x{number}", f"follow{number}", d, held))
            else:
                w = arithmetic.read(f"w{number}")
                missing = arithmetic.subtract(missing, arithmetic.multiply(f"damping{number}", w))
                d = arithmetic.signal(f"d{number}", missing)
                value = arithmetic.add(x, arithmetic.multiply(f"slope{number}", w))
                value = arithmetic.add(value, arithmetic.multiply(f"direct{number}", d))
                advances.append((place, f"x{number}", f"follow{number}", w, 0))
                advances.append((place, f"w{number}", f"follow{number}", d, 0))
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
        return nearest(self.value) / self.asked - 1 if self.asked else 0.0


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


def float64(value: float) -> Coefficient:
    """A float of 64 bits as it is: an integer over a power of two."""
    integer, below = value.as_integer_ratio()
    return Coefficient(value, integer, below.bit_length() - 1)


Form = dict[str, fmpq]
Step = Literal["signal", "state", "current", "relative"]
"""What half of is the bound of a rounding: a step of words, of states, of the current, or of a float itself."""


@dataclass(frozen=True)
class LinearLaw:
    """x+ = A x + B e + F v, i = C x + D e + G v with the readings e and the bounded roundings v; exact.

    Attributes:
        states: names of x.
        sensed: what e holds, as of `Channel`: k of them, the error first.
        roundings: name, kind and place of the channel of each.
        a, b, c, d: (n, n), (n, k), (1, n), (1, k).
        f, g: (n, m), (1, m).
        signals: (p, n + k + m) forms of what words must hold: columns x, e, v.
        signal_channels: place of the channel of each of these rows.
        rounded: (m, n + k + m) forms of what is rounded.
    """

    states: tuple[str, ...]
    sensed: tuple[str, ...]
    roundings: tuple[tuple[str, Step, int], ...]
    a: fmpq_mat
    b: fmpq_mat
    c: fmpq_mat
    d: fmpq_mat
    f: fmpq_mat
    g: fmpq_mat
    signals: fmpq_mat
    signal_channels: tuple[int, ...]
    rounded: fmpq_mat


def linear_law(law: DiscreteLaw, coefficients: Mapping[str, Coefficient], in_floats: bool) -> LinearLaw:
    """Run the law of realised coefficients on linear forms.

    Args:
        law: what was discretised.
        coefficients: realised, the gains among them.
        in_floats: whether every operation rounds, relative to its result; else products, states read and readings do.
    """
    states, given = states_of(law.sections), tuple(channel.name for channel in law.channels)
    forms, readings = _Forms(coefficients, in_floats), []
    for place, name in enumerate(given):
        forms.begin(place)
        readings.append(forms.signal(name, forms.word({name: fmpq(1)}, name, "signal")))
    current = one_period(law.channels, readings, forms)
    names = tuple(forms.roundings)

    def matrix(rows: Sequence[Form], columns: Sequence[str]) -> fmpq_mat:
        return fmpq_mat(len(rows), len(columns), [row.get(name, fmpq(0)) for row in rows for name in columns])

    both, whole = ([forms.after[name] for name in states], [current]), (*states, *given, *names)
    a, b, c, d = (matrix(rows, columns) for rows in both for columns in (states, given))
    f, g = (matrix(rows, names) for rows in both)
    sensed = tuple(channel.reading for channel in law.channels)
    roundings = tuple((name, kind, place) for name, (kind, place, _) in forms.roundings.items())
    signals = matrix([form for _, form in forms.signals.values()], whole)
    places = tuple(place for place, _ in forms.signals.values())
    rounded = matrix([form for _, _, form in forms.roundings.values()], whole)
    return LinearLaw(states, sensed, roundings, a, b, c, d, f, g, signals, places, rounded)


@dataclass
class _Forms(Arithmetic[Form]):
    """Arithmetic on forms; collects signals, roundings and the states after the period."""

    coefficients: Mapping[str, Coefficient]
    in_floats: bool
    signals: dict[str, tuple[int, Form]] = field(default_factory=dict)
    roundings: dict[str, tuple[Step, int, Form]] = field(default_factory=dict)
    after: dict[str, Form] = field(default_factory=dict)
    place: int = 0

    def begin(self, channel: int) -> None:
        self.place = channel

    def word(self, form: Form, name: str, kind: Step) -> Form:
        """Rounded to a step, in floats relative to itself."""
        label = f"{name} #{len(self.roundings) + 1}"
        self.roundings[label] = ("relative" if self.in_floats else kind, self.place, form)
        return form | {label: fmpq(1)}

    def _each(self, form: Form, name: str) -> Form:
        return self.word(form, name, "relative") if self.in_floats else form

    def read(self, state: str) -> Form:
        form: Form = {state: fmpq(1)}
        return form if self.in_floats else self.word(form, state, "signal")

    def multiply(self, coefficient: str, value: Form) -> Form:
        return self.word(_times(self.coefficients[coefficient].value, value), coefficient, "signal")

    def add(self, one: Form, other: Form) -> Form:
        return self._each(_sum(one, other), "sum")

    def subtract(self, one: Form, other: Form) -> Form:
        return self._each(_sum(one, _times(fmpq(-1), other)), "difference")

    def signal(self, name: str, value: Form) -> Form:
        self.signals[name] = (self.place, value)
        return value

    def current(self, terms: Sequence[tuple[str, Form]]) -> Form:
        total: Form = {}
        for k, (gain, value) in enumerate(terms):
            product = self.word(_times(self.coefficients[gain].value, value), "current", "current")
            total = product if k == 0 else self._each(_sum(total, product), "sum")
        return total

    def advance(self, state: str, coefficient: str, value: Form, held: int) -> None:
        step = self.word(_times(self.coefficients[coefficient].value, value), coefficient, "state")
        before: Form = {state: fmpq(1)}
        self.after[state] = self._each(_sum(before, step), state)
        self.signals[state] = (self.place, before)


def _times(factor: fmpq, form: Form) -> Form:
    return {name: factor * value for name, value in form.items()}


def _sum(one: Form, other: Form) -> Form:
    return {name: one.get(name, fmpq(0)) + other.get(name, fmpq(0)) for name in (*one, *other)}


DIGITS = 12


@dataclass(frozen=True)
class DifferenceEquation:
    """The sections of `beamdesign.build.realisation.sections`, their coefficients as they are printed.

    Attributes:
        asked: what was discretised, before it was rounded.
        coefficients: by name, to `DIGITS` significant digits: what is printed is what is proved. Gains are in A per
            unit of their reading.
    """

    asked: DiscreteLaw
    coefficients: dict[str, float]

    @property
    def rate_Hz(self) -> float:
        """Sampling rate."""
        return self.asked.rate_Hz

    @property
    def period_s(self) -> float:
        """Between two samples."""
        return 1 / self.rate_Hz

    @cached_property
    def linear(self) -> LinearLaw:
        """As matrices, exact."""
        return linear_law(self.asked, {name: float64(value) for name, value in self.coefficients.items()}, False)

    def lines(self) -> list[str]:
        """The statements of one period, in the order in which they are carried out."""
        written = _Lines()
        names = (channel.name for channel in self.asked.channels)
        one_period(self.asked.channels, ["e" if name == "error" else name for name in names], written)
        return written.statements


class _Lines(Arithmetic[str]):
    """Arithmetic on names and expressions."""

    def __init__(self) -> None:
        self.statements: list[str] = []

    def read(self, state: str) -> str:
        return state

    def multiply(self, coefficient: str, value: str) -> str:
        return f"{coefficient}*{value}"

    def add(self, one: str, other: str) -> str:
        return f"{one} + {other}"

    def subtract(self, one: str, other: str) -> str:
        return f"{one} - {other}"

    def signal(self, name: str, value: str) -> str:
        self.statements.append(f"{name} = {value}")
        return name

    def current(self, terms: Sequence[tuple[str, str]]) -> str:
        self.statements.append(f"i = {' + '.join(f'{gain}*{value}' for gain, value in terms)}")
        return "i"

    def advance(self, state: str, coefficient: str, value: str, held: int) -> None:
        self.statements.append(f"{state} = {state} + {coefficient}*{value}")


def difference_equation(controller: Controller | TransferFunction, rate_Hz: float) -> DifferenceEquation:
    """Tustin's rule with each break prewarped: poles and zeros lie at their own frequencies, the static gain is kept.

    Args:
        controller: continuous law, or a transfer function from error (V) to current (A).
        rate_Hz: more than twice the upper break.

    Raises:
        ValueError: as of `beamdesign.build.realisation.sections.discretised`.
    """
    asked = discretised(controller, rate_Hz)
    named = coefficients_of(asked)
    return DifferenceEquation(asked, {name: float(f"{value:.{DIGITS - 1}e}") for name, value in named.items()})
