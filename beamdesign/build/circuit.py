"""A controller as a chain of op-amp stages, and a last one that turns volts into current: what its parts realise.

Every amplifier is ideal and every stage inverts, so that its volts are -gain (1 + n1 s + n2 s^2) / (1 + d1 s + d2 s^2)
times those that it is given:

- `amplifier`: R1 to the inverting input, Rf from the output back to it. gain = Rf / R1.
- `lag`: the same with R2 and C in series parallel to Rf. n1 = R2 C, d1 = (R2 + Rf) C; without R2 there is no zero.
- `lead`: with R2 and C in series parallel to R1 instead. n1 = (R1 + R2) C, d1 = R2 C.
- `biquad`, of three amplifiers (P. E. Fleischer and J. Tow, Design formulas for biquad active filters using three
  operational amplifiers, Proceedings of the IEEE 61 (1973) 662-663). An integrator with C2 sums the stage's output
  through R2 and its input through R5. A second one with C1, damped by R1 parallel to it, sums the first through R3 and
  the input through R4. The last, with R8 back, sums the second through R7 and the input through R6; its output is the
  stage's. With R7 = R8 and R2 = R5 the static gain is one,

      gain = R2 / R5,   d1 = R2 R3 R7 C2 / (R1 R8),          d2 = R2 R3 R7 C1 C2 / R8,
      n1 = R3 R5 C2 (R7 / (R1 R6) - 1 / R4),                  n2 = R3 R5 R7 C1 C2 / R6.

  Where R4 or R6 has to count with the other sign, it leads from the input inverted by a fourth amplifier, Ri into it
  and Rb back, and the formulas have R4 or R6 times -Ri / Rb. A resistor that would be infinite is left out.

The first stage sums: it has R1 twice, from the command and from the inverted volts of the sensor. The last, a power
amplifier, drives the actuator's coil so that the voltage over the sense resistor Rs in series with it is the last
stage's output, or that inverted. A motor's drive takes these volts as its command instead: its scale, volts per ampere,
stands for Rs, and counts as exact.
"""

import random
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, reduce
from itertools import product
from math import floor, log10, prod
from typing import Any, Literal, NamedTuple

import numpy as np
from flint import fmpq

from beamdesign.controllers import Observer
from beamdesign.plant.equilibrium import StateSpace
from beamdesign.polynomial import exact, nearest
from beamdesign.quantities import decimal

Series = Literal["E6", "E12", "E24", "E96"]

_E24 = (
    1.0, 1.1, 1.2, 1.3, 1.5, 1.6, 1.8, 2.0, 2.2, 2.4, 2.7, 3.0,
    3.3, 3.6, 3.9, 4.3, 4.7, 5.1, 5.6, 6.2, 6.8, 7.5, 8.2, 9.1,
)  # fmt: skip
DECADE: dict[str, tuple[float, ...]] = {
    "E6": _E24[::4],
    "E12": _E24[::2],
    "E24": _E24,  # not the rounded powers of ten: 2.7 to 4.7 and 8.2 depart from them
    "E96": tuple(round(10 ** (k / 96), 2) for k in range(96)),
}
"""Values of one decade, from 1 to below 10."""


@cache
def values_between(series: Series, low: float, high: float) -> tuple[float, ...]:
    """All values of a series from `low` to `high`, both included, ascending."""
    found = []
    for exponent in range(floor(log10(low)), floor(log10(high)) + 1):
        found += [float(f"{step:g}e{exponent}") for step in DECADE[series]]
    return tuple(value for value in found if low * (1 - 1e-9) <= value <= high * (1 + 1e-9))


def neighbours(series: Series, value: float) -> tuple[float, ...]:
    """The values of a series next to a positive one: at or below it, and above."""
    exponent = floor(log10(value))
    listed = values_between(series, float(f"1e{exponent - 1}"), float(f"1e{exponent + 2}"))
    place = bisect_left(listed, value * (1 + 1e-12))
    return listed[max(place - 1, 0) : place + 1]


Kind = Literal["amplifier", "lag", "lead", "biquad"]
_MOST_CORNERS = 32
"""Of all components together, beyond which so many are drawn."""


class Ratio(NamedTuple):
    """gain (1 + n1 s + n2 s^2) / (1 + d1 s + d2 s^2), of floats or of rationals; s in rad/s."""

    gain: Any
    n1: Any = 0
    n2: Any = 0
    d1: Any = 0
    d2: Any = 0

    def at(self, s: Any) -> Any:
        """Its value at s (rad/s), of any shape."""
        return self.gain * (1 + s * (self.n1 + s * self.n2)) / (1 + s * (self.d1 + s * self.d2))

    @property
    def order(self) -> int:
        """Of its denominator."""
        return 2 if self.d2 else 1 if self.d1 else 0

    def state_space(self) -> StateSpace:
        """Of it over its gain, in floats."""
        if self.order == 0:
            return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
        if self.order == 1:
            pole, through = 1 / self.d1, self.n1 / self.d1
            return StateSpace(*(np.array([[one]]) for one in (-pole, pole, 1 - through, through)))
        natural, through = self.d2**-0.5, self.n2 / self.d2
        a, b = np.array([[0.0, natural], [-natural, -self.d1 / self.d2]]), np.array([[0.0], [natural]])
        c = np.array([[1 - through, natural * (self.n1 - self.d1 * through)]])
        return StateSpace(a, b, c, np.array([[through]]))


@dataclass(frozen=True)
class Stage:
    """One stage of the schematic above.

    Attributes:
        kind: which.
        parts: by name, those with R in ohm, those with C in F.
        turned: which of R4 and R6 lead from the inverted input.
    """

    kind: Kind
    parts: Mapping[str, float]
    turned: tuple[str, ...] = ()

    @property
    def exact(self) -> Ratio:
        """What the parts as they stand realise, in rationals; the sign is left out."""
        return self.of({name: exact(value) for name, value in self.parts.items()})

    def of(self, parts: Mapping[str, Any]) -> Ratio:
        """What other parts in the same places would realise: floats, arrays or rationals."""
        if self.kind != "biquad":
            gain, shunt, farad = parts["Rf"] / parts["R1"], parts.get("R2", 0), parts.get("C", 0)
            short, long = shunt * farad, (parts["R1" if self.kind == "lead" else "Rf"] + shunt) * farad
            return Ratio(gain, long, 0, short, 0) if self.kind == "lead" else Ratio(gain, short, 0, long, 0)

        def conductance(name: str) -> Any:
            if name not in parts:
                return 0
            return -parts["Rb"] / (parts["Ri"] * parts[name]) if name in self.turned else 1 / parts[name]

        loop, given = (parts["R3"] * parts["C2"] * parts[name] for name in ("R2", "R5"))
        damping, direct = parts["R7"] / parts["R1"], parts["R7"] * conductance("R6")
        return Ratio(
            parts["R2"] / parts["R5"],
            given * (direct / parts["R1"] - conductance("R4")),
            given * direct * parts["C1"],
            loop * damping / parts["R8"],
            loop * parts["R7"] * parts["C1"] / parts["R8"],
        )

    def within(self, resistors: float, capacitor: float) -> Iterator[dict[str, fmpq]]:
        """Every combination of its parts at the ends of their relative tolerances, in rationals."""
        ends = [
            [exact(value) * (1 + side * exact(resistors if name[0] == "R" else capacitor)) for side in (-1, 1)]
            for name, value in self.parts.items()
        ]
        return (dict(zip(self.parts, corner, strict=True)) for corner in product(*ends))

    def spans(self, resistors: float, capacitor: float) -> Ratio:
        """What each coefficient can be with its parts within their tolerances: pairs of rationals, both attained.

        Each coefficient rises or falls with every one of its parts while the others stay, so that its ends are at
        corners. That the coefficients vary independently of each other is more than the parts can do.
        """
        found = [self.of(parts) for parts in self.within(resistors, capacitor)]
        return Ratio(*((min(values), max(values)) for values in zip(*found, strict=True)))


@dataclass(frozen=True)
class Circuit:
    """Stages in series and the last one.

    Attributes:
        stages: the first sums command and sensor.
        sense_ohm: Rs, or volts per ampere of a drive.
        falling: whether the current falls where the error rises, as for a law of negative gain.
        resistors: series that the resistors are taken from.
        capacitors: series that the capacitors are taken from.
        driven: whether it ends at a drive.
    """

    stages: tuple[Stage, ...]
    sense_ohm: float
    falling: bool = False
    resistors: Series = "E96"
    capacitors: Series = "E6"
    driven: bool = False

    @property
    def inverted(self) -> bool:
        """Whether the power amplifier inverts the last stage's volts."""
        return (len(self.stages) % 2 == 1) != self.falling

    @property
    def has_capacitors(self) -> bool:
        """Whether there are any."""
        return any(stage.kind != "amplifier" for stage in self.stages)

    @property
    def parts(self) -> dict[str, float]:
        """Every part by the number of its stage and its name, such as "1.R1"; a sense resistor is "Rs"."""
        named = {f"{k}.{name}": v for k, stage in enumerate(self.stages, 1) for name, v in stage.parts.items()}
        return named if self.driven else named | {"Rs": self.sense_ohm}

    @property
    def gain_A_per_V(self) -> fmpq:
        """Of current over error at rest, exact, with its sign."""
        gain = prod((stage.exact.gain for stage in self.stages), start=1 / exact(self.sense_ohm))
        return -gain if self.falling else gain

    @property
    def law(self) -> Observer:
        """What the parts realise, as a prototype writes it; the size of its gain is that at rest."""
        each = (Ratio(*(nearest(fmpq(one)) for one in stage.exact)).state_space() for stage in self.stages)
        whole, sign = reduce(lambda before, stage: stage.behind(before), each), -1.0 if self.falling else 1.0
        gain = abs(nearest(self.gain_A_per_V))
        return Observer.of(gain, ("displacement_m",), whole.a, whole.b, sign * whole.c[0], sign * whole.d[0])

    def made_of(self, parts: Mapping[str, float]) -> "Circuit":
        """The same circuit of other parts, named as in `parts`."""
        stages = tuple(
            replace(stage, parts={name: parts[f"{k}.{name}"] for name in stage.parts})
            for k, stage in enumerate(self.stages, 1)
        )
        return replace(self, stages=stages, sense_ohm=parts.get("Rs", self.sense_ohm))

    def corners(self, resistors: float, capacitor: float) -> Iterator["Circuit"]:
        """Combinations of all parts at the ends of their tolerances: each, or some drawn where they are many."""
        parts, n = self.parts, len(self.parts)
        within = [capacitor if ".C" in name else resistors for name in parts]
        if 2**n <= _MOST_CORNERS * 2:
            sides: Any = product((-1, 1), repeat=n)
        else:
            drawn = random.Random(0)
            sides = [[drawn.choice((-1, 1)) for _ in range(n)] for _ in range(_MOST_CORNERS)]
        for ends in sides:
            at = (value * (1 + side * by) for value, side, by in zip(parts.values(), ends, within, strict=True))
            yield self.made_of(dict(zip(parts, at, strict=True)))

    def gain_span(self, resistors: float, capacitor: float) -> tuple[fmpq, fmpq]:
        """What the size of the gain can be with all parts within their tolerances."""
        r, sense = exact(0 if self.driven else resistors), exact(self.sense_ohm)
        spans = [stage.spans(resistors, capacitor).gain for stage in self.stages]
        low, high = (prod((span[end] for span in spans), start=fmpq(1)) for end in (0, 1))
        return low / (sense * (1 + r)), high / (sense * (1 - r))


def part_value(name: str, value: float | None) -> str:
    """A part's value as it is printed on it."""
    if value is None:
        return "left out"
    if ".C" in name:
        return f"{decimal(value * 1e9)} nF"
    return f"{decimal(value)} Ω" if value < 1e3 else f"{decimal(value / 1e3)} kΩ"
