"""The law as exact matrices: states, readings and every rounding in it, by running it on linear forms.

A form is what a value depends on: a coefficient per state, per reading, and per rounding made so far. Roundings count
as bounded inputs of the linear law, which is no approximation: a rounded value is the value plus something that is at
most half a step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from flint import fmpq, fmpq_mat

from beamdesign.realisation.law import Arithmetic, Coefficient, one_period, states_of
from beamdesign.realisation.sections import DiscreteLaw

Form = dict[str, fmpq]
Step = Literal["signal", "state", "current", "relative"]
"""What half of is the bound of a rounding: a step of words, of states, of the current, or of a float itself."""


@dataclass(frozen=True)
class LinearLaw:
    """x+ = A x + B e + F v, i = C x + D e + G v with the readings e and the bounded roundings v; exact.

    Attributes:
        states: names of x.
        heard: what e holds, as of `Channel`: k of them, the error first.
        roundings: name, kind and place of the channel of each.
        a, b, c, d: (n, n), (n, k), (1, n), (1, k).
        f, g: (n, m), (1, m).
        signals: (p, n + k + m) forms of what words must hold: columns x, e, v.
        signal_channels: place of the channel of each of these rows.
        rounded: (m, n + k + m) forms of what is rounded.
    """

    states: tuple[str, ...]
    heard: tuple[str, ...]
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
        readings.append(forms.signal(name, forms.word({name: fmpq(1)}, name, "relative" if in_floats else "signal")))
    current = one_period(law.channels, readings, forms)
    names = tuple(forms.roundings)

    def matrix(rows: Sequence[Form], columns: Sequence[str]) -> fmpq_mat:
        return fmpq_mat(len(rows), len(columns), [row.get(name, fmpq(0)) for row in rows for name in columns])

    after = [forms.after[name] for name in states]
    whole = (*states, *given, *names)
    return LinearLaw(
        states,
        tuple(channel.heard for channel in law.channels),
        tuple((name, kind, place) for name, (kind, place, _) in forms.roundings.items()),
        matrix(after, states),
        matrix(after, given),
        matrix([current], states),
        matrix([current], given),
        matrix(after, names),
        matrix([current], names),
        matrix([form for _, form in forms.signals.values()], whole),
        tuple(place for place, _ in forms.signals.values()),
        matrix([form for _, _, form in forms.roundings.values()], whole),
    )


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
        label = f"{name} #{len(self.roundings) + 1}"
        self.roundings[label] = (kind, self.place, form)
        return form | {label: fmpq(1)}

    def _each(self, form: Form, name: str) -> Form:
        return self.word(form, name, "relative") if self.in_floats else form

    def read(self, state: str) -> Form:
        form: Form = {state: fmpq(1)}
        return form if self.in_floats else self.word(form, state, "signal")

    def multiply(self, coefficient: str, value: Form) -> Form:
        product = _times(self.coefficients[coefficient].value, value)
        return self.word(product, coefficient, "relative" if self.in_floats else "signal")

    def add(self, one: Form, other: Form) -> Form:
        return self._each(_sum(one, other), "sum")

    def subtract(self, one: Form, other: Form) -> Form:
        return self._each(_sum(one, _times(fmpq(-1), other)), "difference")

    def signal(self, name: str, value: Form) -> Form:
        self.signals[name] = (self.place, value)
        return value

    def current(self, terms: Sequence[tuple[str, Form]]) -> Form:
        kind: Step = "relative" if self.in_floats else "current"
        total: Form = {}
        for k, (gain, value) in enumerate(terms):
            product = self.word(_times(self.coefficients[gain].value, value), "current", kind)
            total = product if k == 0 else self._each(_sum(total, product), "sum")
        return total

    def advance(self, state: str, coefficient: str, value: Form, held: bool) -> None:
        step = _times(self.coefficients[coefficient].value, value)
        before: Form = {state: fmpq(1)}
        if self.in_floats:
            step = self.word(step, coefficient, "relative")
            self.after[state] = self.word(_sum(before, step), state, "relative")
        else:
            self.after[state] = _sum(before, self.word(step, coefficient, "state"))
        self.signals[state] = (self.place, before)


def _times(factor: fmpq, form: Form) -> Form:
    return {name: factor * value for name, value in form.items()}


def _sum(one: Form, other: Form) -> Form:
    return {name: one.get(name, fmpq(0)) + other.get(name, fmpq(0)) for name in (*one, *other)}
