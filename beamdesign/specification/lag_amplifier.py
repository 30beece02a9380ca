"""The controller as an analogue circuit: an inverting lag amplifier and a stage that turns its volts into current.

Schematic, both amplifiers ideal:

- U1, inverting. R1 leads from the inverted sensor voltage -F x to its inverting input, a second R1 from the command.
  Rf leads from its output back to that input; R2 and C in series stand parallel to Rf.
- U2, a power amplifier that drives the valve's coil and holds the voltage over the sense resistor Rs, in series with
  the coil, at the inverted output of U1.

With the summed input e = command - F x the valve current is

    i / e = Rf / (R1 Rs) (1 + s R2 C) / (1 + s (R2 + Rf) C),

so that gain = Rf / (R1 Rs), zero = 1 / (2 pi R2 C) and pole = 1 / (2 pi (R2 + Rf) C). Without a lag there are no R2
and C.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import log, pi

from flint import fmpq

from beamdesign.controllers import Break, Controller, Lag, Proportional
from beamdesign.polynomial import exact
from beamdesign.specification.preferred_values import Series, neighbours, values_between

_CAPACITORS_F = (4.7e-8, 4.7e-6)
"""Film capacitors: stable ones are not made larger, and smaller ones ask for resistors that leak and hum."""
_FEEDBACK_OHM = (1e3, 2.2e6)
_SENSE_OHM = (4.7, 47.0)
_INPUT_OHM = (4.7e3, 1e6)


@dataclass(frozen=True)
class LagAmplifier:
    """Component values of the schematic above.

    Attributes:
        input_ohm: R1.
        feedback_ohm: Rf.
        sense_ohm: Rs.
        shunt_ohm: R2; None without a lag.
        capacitance_F: C; None without a lag.
        resistors: series the resistors are taken from.
        capacitors: series the capacitor is taken from.
    """

    input_ohm: float
    feedback_ohm: float
    sense_ohm: float
    shunt_ohm: float | None = None
    capacitance_F: float | None = None
    resistors: Series = "E96"
    capacitors: Series = "E6"

    @property
    def controller(self) -> Proportional | Lag:
        """The controller that these values realise, as the prototype writes it."""
        gain = self.feedback_ohm / (self.input_ohm * self.sense_ohm)
        if self.shunt_ohm is None or self.capacitance_F is None:
            return Proportional(gain_A_per_V=gain)
        slow = 2 * pi * (self.shunt_ohm + self.feedback_ohm) * self.capacitance_F
        return Lag(gain_A_per_V=gain, pole_Hz=1 / slow, zero_Hz=1 / (2 * pi * self.shunt_ohm * self.capacitance_F))

    def spans(self, resistors: float, capacitor: float) -> dict[str, tuple[fmpq, fmpq]]:
        """What gain (A/V), zero and pole (rad/s) can be with components within their tolerances, exactly.

        Names are those of `beamdesign.proof.rig_family`. Each span is attained; that the three vary independently of
        each other is more than the components can do.

        Args:
            resistors: relative tolerance, such as 0.01.
            capacitor: relative tolerance.
        """
        r, c, one = exact(resistors), exact(capacitor), fmpq(1)
        gain = exact(self.feedback_ohm) / (exact(self.input_ohm) * exact(self.sense_ohm))
        found = {"controller_gain": (gain * (one - r) / (one + r) ** 2, gain * (one + r) / (one - r) ** 2)}
        if self.shunt_ohm is not None and self.capacitance_F is not None:
            shunt, feedback, farad = (exact(v) for v in (self.shunt_ohm, self.feedback_ohm, self.capacitance_F))
            least, most = (one - r) * (one - c), (one + r) * (one + c)
            for name, ohm in (("zero", shunt), ("pole", shunt + feedback)):
                found[f"controller_{name}"] = (1 / (ohm * farad * most), 1 / (ohm * farad * least))
        return found

    def corners(self, resistors: float, capacitor: float) -> Iterator["LagAmplifier"]:
        """Every combination of components at the ends of their tolerances."""
        for r1, rf, rs, r2, c in product((-1, 1), repeat=5):
            yield LagAmplifier(
                self.input_ohm * (1 + r1 * resistors),
                self.feedback_ohm * (1 + rf * resistors),
                self.sense_ohm * (1 + rs * resistors),
                None if self.shunt_ohm is None else self.shunt_ohm * (1 + r2 * resistors),
                None if self.capacitance_F is None else self.capacitance_F * (1 + c * capacitor),
                self.resistors,
                self.capacitors,
            )


def lag_amplifier(controller: Controller, resistors: Series, capacitors: Series) -> LagAmplifier:
    """The values of two series that come nearest to a controller.

    All capacitors of a sensible size, and with each the neighbouring resistors, are looked at; the largest relative
    error of gain, pole and zero is made least.

    Raises:
        ValueError: where the pole does not lie below the zero, which this circuit cannot give.
    """
    lag = controller.lag
    if lag is not None and lag.pole_Hz >= lag.zero_Hz:
        raise ValueError("this circuit is a lag: its pole lies below its zero")
    gains = [
        (rs, ratio)
        for rs in values_between(resistors, *_SENSE_OHM)
        for ratio in (controller.gain_A_per_V * rs,)  # Rf / R1
    ]
    best: tuple[float, LagAmplifier] | None = None
    for feedback, shunt, farad, error in _lags(lag, resistors, capacitors):
        for rs, ratio in gains:
            for r1 in neighbours(resistors, feedback / ratio):
                if not _INPUT_OHM[0] <= r1 <= _INPUT_OHM[1]:
                    continue
                worst = max(error, abs(log(feedback / r1 / ratio)))
                if best is None or worst < best[0] - 1e-12:
                    best = worst, LagAmplifier(r1, feedback, rs, shunt, farad, resistors, capacitors)
    if best is None:
        raise ValueError("no components of a sensible size give this gain and these breaks")
    return best[1]


def _lags(
    lag: Break | None, resistors: Series, capacitors: Series
) -> Iterator[tuple[float, float | None, float | None, float]]:
    """Rf, R2, C and the larger relative error of pole and zero."""
    if lag is None:
        for feedback in values_between(resistors, 2e4, 3e4):
            yield feedback, None, None, 0.0
        return
    found = []
    for farad in values_between(capacitors, *_CAPACITORS_F):
        for shunt in neighbours(resistors, 1 / (2 * pi * lag.zero_Hz * farad)):
            total = 1 / (2 * pi * lag.pole_Hz * farad)
            if total <= shunt:
                continue
            for feedback in neighbours(resistors, total - shunt):
                if not (_FEEDBACK_OHM[0] <= shunt and feedback <= _FEEDBACK_OHM[1]):
                    continue
                pole, zero = abs(log(total / (shunt + feedback))), abs(log(2 * pi * lag.zero_Hz * farad * shunt))
                found.append((feedback, shunt, farad, max(pole, zero)))
    yield from sorted(found, key=lambda one: one[3])[:12]
