"""Controllers with open parameters: what a tuner may vary, for numbers, arrays and CasADi symbols alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import exp, log, pi
from typing import Any

from beamdesign.controllers import Break, Controller, Lag, Proportional, Section, Structured


@dataclass(frozen=True)
class ControllerForm:
    """A family of controllers K C(s), C(0) = 1, whose parameters are tuned on a logarithmic scale.

    Attributes:
        kind: the controller's kind in a prototype.
        names: fields of the controller record, the gain first.
        bounds: least and largest value of each, in its own unit.
        polynomials: values of the parameters after the gain to numerator and denominator of C, ascending in s.
        record: parameter values, the gain first, to the controller record.
    """

    kind: str
    names: tuple[str, ...]
    bounds: tuple[tuple[float, float], ...]
    polynomials: Callable[[Sequence[Any]], tuple[list[Any], list[Any]]]
    record: Callable[[Sequence[float]], Controller]

    @property
    def log_bounds(self) -> tuple[tuple[float, float], ...]:
        """Bounds of the logarithms."""
        return tuple((log(low), log(high)) for low, high in self.bounds)

    def rounded(self, logarithms: Sequence[float], digits: int = 6) -> Controller:
        """The record at given logarithms, its figures rounded to what a person would copy down."""
        return self.record([float(f"{exp(value):.{digits}g}") for value in logarithms])


def _lag_polynomials(values: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    pole, zero = values
    return [1.0, 1 / (2 * pi * zero)], [1.0, 1 / (2 * pi * pole)]


_GAIN = (1e-4, 100.0)

FORMS = {
    "proportional": ControllerForm(
        "proportional",
        ("gain_A_per_V",),
        (_GAIN,),
        lambda values: ([1.0], [1.0]),
        lambda values: Proportional(gain_A_per_V=values[0]),
    ),
    "lag": ControllerForm(
        "lag",
        ("gain_A_per_V", "pole_Hz", "zero_Hz"),
        (_GAIN, (0.005, 50.0), (0.5, 400.0)),
        _lag_polynomials,
        lambda values: Lag(gain_A_per_V=values[0], pole_Hz=values[1], zero_Hz=values[2]),
    ),
}
"""Controllers with a fixed number of figures that `tune` knows, by kind."""

STRUCTURED = "structured_"
"""What the names of forms with second-order sections begin with; their number follows."""

SECTION_NAMES = ("zero_Hz", "zero_damping_ratio", "pole_Hz", "pole_damping_ratio")
_SECTION_BOUNDS = ((2.0, 2000.0), (0.05, 5.0), (2.0, 1000.0), (0.1, 5.0))
"""A pole less damped than 0.1 would ring in the controller itself, and move with its parts."""


@cache
def form_named(kind: str) -> ControllerForm:
    """One of `FORMS`, or `structured_N`: a lag with N second-order sections."""
    return FORMS[kind] if kind in FORMS else _structured(kind, int(kind.removeprefix(STRUCTURED)))


def _structured(kind: str, sections: int) -> ControllerForm:
    lag, size = FORMS["lag"], len(SECTION_NAMES)
    names = tuple(f"section.{k}.{name}" for k in range(1, sections + 1) for name in SECTION_NAMES)

    def polynomials(values: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        numerator, denominator = _lag_polynomials(values[:2])
        for k in range(sections):
            zero, zero_damping, pole, pole_damping = values[2 + size * k : 2 + size * (k + 1)]
            numerator = _times(numerator, _pair(zero, zero_damping))
            denominator = _times(denominator, _pair(pole, pole_damping))
        return numerator, denominator

    def record(values: Sequence[float]) -> Structured:
        parts = [values[3 + size * k : 3 + size * (k + 1)] for k in range(sections)]
        found = tuple(Section(**dict(zip(SECTION_NAMES, part, strict=True))) for part in parts)
        return Structured(gain_A_per_V=values[0], pole_Hz=values[1], zero_Hz=values[2], section=found)

    return ControllerForm(kind, lag.names + names, lag.bounds + _SECTION_BOUNDS * sections, polynomials, record)


def _pair(frequency_Hz: Any, damping_ratio: Any) -> list[Any]:
    natural = 2 * pi * frequency_Hz
    return [1.0, 2 * damping_ratio / natural, 1 / natural**2]


def _times(left: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    product: list[Any] = [0.0] * (len(left) + len(right) - 1)
    for i, one in enumerate(left):
        for j, two in enumerate(right):
            product[i + j] = product[i + j] + one * two
    return product


def lag_and_sections(law: Controller) -> list[float]:
    """The figures of a law as the variables of its form: gain, pole, zero, then those of each section."""
    lag = law.lag or Break(1.0, 1.0)
    sections = [getattr(section, name) for section in law.sections for name in SECTION_NAMES]
    return [law.gain_A_per_V, lag.pole_Hz, lag.zero_Hz, *sections]
