"""Controllers with open parameters: what a tuner may vary, for numbers, arrays and CasADi symbols alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, log, pi
from typing import Any

from beamdesign.prototype import Lag, Proportional


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
    record: Callable[[Sequence[float]], Proportional | Lag]

    @property
    def log_bounds(self) -> tuple[tuple[float, float], ...]:
        """Bounds of the logarithms."""
        return tuple((log(low), log(high)) for low, high in self.bounds)

    def rounded(self, logarithms: Sequence[float], digits: int = 6) -> Proportional | Lag:
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
"""Controllers that `tune` knows, by kind."""
