"""The law as exact matrices: states, error and every rounding in it, by running it on linear forms.

A form is what a value depends on: a coefficient per state, the error, and one per rounding made so far. Roundings count
as bounded inputs of the linear law, which is no approximation: a rounded value is the value plus something that is at
most half a step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from flint import fmpq, fmpq_mat

from beamdesign.realisation.coefficient import Coefficient
from beamdesign.realisation.law import one_period, states_of
from beamdesign.realisation.sections import Section

Form = dict[str, fmpq]
Step = Literal["signal", "state", "current", "relative"]
"""What half of is the bound of a rounding: a step of words, of states, of the current, or of a float itself."""


@dataclass(frozen=True)
class LinearLaw:
    """x+ = A x + B e + F v, i = C x + D e + G v with the bounded roundings v; exact.

    Attributes:
        states: names of x.
        roundings: kind and form (in x, e and earlier roundings) of what is rounded, by name.
        a, b, c, d: (n, n), (n, 1), (1, n), (1, 1).
        f, g: (n, m), (1, m).
        signals: (p, n + 1 + m) forms of what words must hold: columns x, e, v.
        signal_names: of these rows.
        rounded: (m, n + 1 + m) forms of what is rounded.
    """

    states: tuple[str, ...]
    roundings: tuple[tuple[str, Step], ...]
    a: fmpq_mat
    b: fmpq_mat
    c: fmpq_mat
    d: fmpq_mat
    f: fmpq_mat
    g: fmpq_mat
    signals: fmpq_mat
    signal_names: tuple[str, ...]
    rounded: fmpq_mat


def linear_law(sections: Sequence[Section], coefficients: Mapping[str, Coefficient], in_floats: bool) -> LinearLaw:
    """Run the law of realised coefficients on linear forms.

    Args:
        sections: of the cascade.
        coefficients: realised, `gain` among them.
        in_floats: whether every operation rounds, relative to its result; else products, states read and the error do.
    """
    states = states_of(sections)
    forms = _Forms(coefficients, in_floats)
    error = forms.word({"error": fmpq(1)}, "error", "relative" if in_floats else "signal")
    forms.signals["error"] = error
    current = one_period(sections, error, forms)
    names = tuple(forms.roundings)

    def matrix(rows: Sequence[Form], columns: Sequence[str]) -> fmpq_mat:
        return fmpq_mat(len(rows), len(columns), [row.get(name, fmpq(0)) for row in rows for name in columns])

    after = [forms.after[name] for name in states]
    whole = (*states, "error", *names)
    return LinearLaw(
        states,
        tuple((name, kind) for name, (kind, _) in forms.roundings.items()),
        matrix(after, states),
        matrix(after, ("error",)),
        matrix([current], states),
        matrix([current], ("error",)),
        matrix(after, names),
        matrix([current], names),
        matrix(list(forms.signals.values()), whole),
        tuple(forms.signals),
        matrix([form for _, form in forms.roundings.values()], whole),
    )


@dataclass
class _Forms:
    """Arithmetic on forms; collects signals, roundings and the states after the period."""

    coefficients: Mapping[str, Coefficient]
    in_floats: bool
    signals: dict[str, Form] = field(default_factory=dict)
    roundings: dict[str, tuple[Step, Form]] = field(default_factory=dict)
    after: dict[str, Form] = field(default_factory=dict)

    def word(self, form: Form, name: str, kind: Step) -> Form:
        label = f"{name} #{len(self.roundings) + 1}"
        self.roundings[label] = (kind, form)
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
        self.signals[name] = value
        return value

    def current(self, value: Form) -> Form:
        product = _times(self.coefficients["gain"].value, value)
        return self.word(product, "current", "relative" if self.in_floats else "current")

    def advance(self, state: str, coefficient: str, value: Form, held: bool) -> None:
        step = _times(self.coefficients[coefficient].value, value)
        before: Form = {state: fmpq(1)}
        if self.in_floats:
            step = self.word(step, coefficient, "relative")
            self.after[state] = self.word(_sum(before, step), state, "relative")
        else:
            self.after[state] = _sum(before, self.word(step, coefficient, "state"))
        self.signals[state] = before


def _times(factor: fmpq, form: Form) -> Form:
    return {name: factor * value for name, value in form.items()}


def _sum(one: Form, other: Form) -> Form:
    return {name: one.get(name, fmpq(0)) + other.get(name, fmpq(0)) for name in (*one, *other)}
