"""The controller as a difference equation at a sampling rate, ready to be coded."""

from dataclasses import dataclass
from math import pi, tan

from beamdesign.controllers import Break, Controller
from beamdesign.sampled import tustin

DIGITS = 12
_PER_CROSSOVER = 40.0


@dataclass(frozen=True)
class DifferenceEquation:
    """i[k] = b0 e[k] + b1 e[k-1] - a1 i[k-1], with e the error in volts and i the current in A.

    Attributes:
        rate_Hz: sampling rate.
        b0, b1: A/V, to `DIGITS` significant digits: what is printed is what is proved.
        a1: pure number.
    """

    rate_Hz: float
    b0: float
    b1: float
    a1: float

    @property
    def period_s(self) -> float:
        """Between two samples."""
        return 1 / self.rate_Hz


def difference_equation(controller: Controller, rate_Hz: float) -> DifferenceEquation:
    """Tustin's rule with each break prewarped: pole and zero lie at their own frequencies, the static gain is kept.

    Args:
        controller: continuous law.
        rate_Hz: more than twice the upper break.

    Raises:
        ValueError: where a break lies at or above half the rate.
    """
    lag = controller.lag
    if lag is not None:
        if rate_Hz <= 2 * max(lag.pole_Hz, lag.zero_Hz):
            raise ValueError(f"a rate of {rate_Hz:g} Hz is not more than twice the upper break of the controller")
        lag = Break(*(rate_Hz / pi * tan(pi * frequency / rate_Hz) for frequency in (lag.pole_Hz, lag.zero_Hz)))
    b0, b1, a1 = tustin(lag, 1 / rate_Hz)
    gain = controller.gain_A_per_V
    return DifferenceEquation(rate_Hz, *(float(f"{c:.{DIGITS - 1}e}") for c in (gain * b0, gain * b1, a1)))


def sensible_rate_Hz(crossover_Hz: float, upper_break_Hz: float = 0.0) -> float:
    """The least rate of 1, 2 or 5 times a power of ten that is 40 times the crossover and ten times the upper break."""
    least = max(_PER_CROSSOVER * crossover_Hz, 10 * upper_break_Hz, 1000.0)
    step = 1.0
    while True:
        for factor in (1, 2, 5):
            if factor * step >= least:
                return factor * step
        step *= 10
