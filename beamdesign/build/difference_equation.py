"""The controller as difference equations at a sampling rate, ready to be coded: what is specified and simulated."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from beamdesign.build.realisation.law import Arithmetic, LinearLaw, coefficients_of, float64, linear_law, one_period
from beamdesign.build.realisation.sections import DiscreteLaw, discretised, factored, highest_Hz, laws_of
from beamdesign.controllers import Controller

DIGITS = 12
_PER_CROSSOVER = 40.0


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
        one_period(self.asked.channels, [_LETTERS.get(c.name, c.name) for c in self.asked.channels], written)
        return written.statements


_LETTERS = {"error": "e"}


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

    def advance(self, state: str, coefficient: str, value: str, held: bool) -> None:
        self.statements.append(f"{state} = {state} + {coefficient}*{value}")


def difference_equation(controller: Controller, rate_Hz: float) -> DifferenceEquation:
    """Tustin's rule with each break prewarped: poles and zeros lie at their own frequencies, the static gain is kept.

    Args:
        controller: continuous law.
        rate_Hz: more than twice the upper break.

    Raises:
        ValueError: as of `beamdesign.build.realisation.sections.discretised`.
    """
    asked = discretised(controller, rate_Hz)
    named = coefficients_of(asked)
    return DifferenceEquation(asked, {name: float(f"{value:.{DIGITS - 1}e}") for name, value in named.items()})


def upper_break_Hz(controller: Controller) -> float:
    """The highest natural frequency of its poles and zeros, from any of its readings.

    Raises:
        ValueError: as of `beamdesign.build.realisation.sections.factored`.
    """
    return max(highest_Hz(factored(law)[1]) for _, law in laws_of(controller))


def sensible_rate_Hz(crossover_Hz: float, upper_break_Hz: float = 0.0) -> float:
    """The least rate of 1, 2 or 5 times a power of ten that is 40 times the crossover and ten times the upper break."""
    least = max(_PER_CROSSOVER * crossover_Hz, 10 * upper_break_Hz, 1000.0)
    step = 1.0
    while True:
        for factor in (1, 2, 5):
            if factor * step >= least:
                return factor * step
        step *= 10
