"""A controller as cascades of discrete sections of unit static gain, in incremental (delta operator) form.

With e the section's input, d what it has yet to follow, and T the period,

    first order:    d = e - x;          y = x + h d;          x += f d
    second order:   d = e - x - r w;    y = x + k w + h d;    x += f w;  w += f d

so that in the operator delta = z - 1 the section is (h delta + f) / (delta + f) or (h delta^2 + k f delta + f^2) /
(delta^2 + r f delta + f^2). Three things follow. At rest d = 0 and y = e whatever the coefficients: no word length
touches the static gain. As the rate grows, f tends to T times the pole's frequency in rad/s, r and k to twice damping
ratios and h to a ratio of the section's own figures: only f becomes small, and relative errors stay relative (R. H.
Middleton and G. C. Goodwin, Digital Control and Estimation (1990), chapter 3). And each state is of the size of the
section's input.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, count
from math import log, pi, prod, sqrt, tan
from typing import Literal

from beamdesign.controllers import SENSED, Controller, TransferFunction
from beamdesign.polynomial import nearest, roots

Factor = tuple[list[complex], list[complex]]
"""Poles and zeros of a factor, rad/s."""

_FARTHEST = -2.0 + 0j
"""Of delta: z = -1, where the bilinear rule puts a zero at infinity."""


@dataclass(frozen=True)
class Section:
    """One section; the equations stand in the module.

    Attributes:
        order: 1 or 2.
        follow: f, share of what is missing that is made up in a period.
        damping: r, 0 in sections of first order.
        slope: k, 0 in sections of first order.
        direct: h, from input to output within the sample.
        words: poles and zeros of the continuous section.
    """

    order: Literal[1, 2]
    follow: float
    damping: float
    slope: float
    direct: float
    words: str


@dataclass(frozen=True)
class Channel:
    """What the law makes of one reading: a gain and sections of unit static gain, in the order in which it passes them.

    Attributes:
        reading: `displacement_m` for the error in V, else what is read, of `beamdesign.controllers.SENSORS`, or
            `command_V`.
        gain: A per V, m or Pa of the reading, sign included.
        sections: none for a mere gain.
    """

    reading: str
    gain: float
    sections: tuple[Section, ...]

    @property
    def name(self) -> str:
        """Of the reading, without its unit."""
        return "error" if self.reading == SENSED[0] else self.reading.rpartition("_")[0]

    @property
    def gain_name(self) -> str:
        """Of its coefficient."""
        return "gain" if self.reading == SENSED[0] else f"gain_{self.name}"

    @property
    def unit(self) -> str:
        """Of the reading."""
        return "V" if self.reading == SENSED[0] else self.reading.rpartition("_")[2]


@dataclass(frozen=True)
class DiscreteLaw:
    """A controller at a rate: what its channels make of their readings, added up. The error comes first."""

    rate_Hz: float
    channels: tuple[Channel, ...]

    @property
    def sections(self) -> tuple[Section, ...]:
        """Of all channels; they are numbered in this order, from 1."""
        return tuple(section for channel in self.channels for section in channel.sections)


def factored(law: TransferFunction) -> tuple[float, list[Factor]]:
    """The gain at rest of a law, and its poles in ones and twos with the zeros that stand best over them, in rad/s.

    Args:
        law: with a gain at zero frequency that is finite and not zero.

    Returns:
        A per unit of what it hears, and (poles, zeros) of each factor of unit static gain, by rising frequency; no
        factor has more zeros than poles.

    Raises:
        ValueError: for a law that is not stable and proper, or has a root at zero.
    """
    if law.numerator == 0:
        raise ValueError("a controller that does not hear the displacement cannot be realised")
    if law.numerator.degree() > law.denominator.degree():
        raise ValueError("only a controller that is proper can be realised")
    common = law.numerator.gcd(law.denominator)
    numerator, denominator = law.numerator // common, law.denominator // common
    zeros, poles = (_groups([complex(r) for r in roots(p)]) for p in (numerator, denominator))
    if any(root == 0 for group in (*zeros, *poles) for root in group):
        reason = "has no sections of unit static gain; put a break far below the bandwidth in its place"
        raise ValueError(f"a controller with a pole or zero at zero frequency {reason}")
    if any(root.real >= 0 for group in poles for root in group):
        raise ValueError("the controller itself is not stable")
    return nearest(numerator(0) / denominator(0)), _paired(poles, zeros)


def discretised(controller: Controller | TransferFunction, rate_Hz: float) -> DiscreteLaw:
    """Discretise a controller by Tustin's rule, root by root, for each of its sensors and its command by itself.

    Every root is prewarped: it keeps its own natural frequency.

    Args:
        controller: any law of the project, or any transfer function from error (V) to current (A), as of `factored`.
        rate_Hz: sampling rate.

    Raises:
        ValueError: as of `factored`, and for a root at or above half the rate.
    """
    channels = []
    for sensed, law in laws_of(controller):
        gain, factors = factored(law)
        highest = highest_Hz(factors)
        if 2 * highest >= rate_Hz:
            words = f"a rate of {rate_Hz:g} Hz is not more than twice the controller's upper break, {highest:.6g} Hz"
            raise ValueError(f"{words}; sample more often")
        sections = (_section(own, partners, rate_Hz) for own, partners in factors)
        channels.append(Channel(sensed, gain, tuple(sections)))
    return DiscreteLaw(rate_Hz, tuple(channels))


def highest_Hz(factors: Sequence[Factor]) -> float:
    """The highest natural frequency of any root of these factors, 0 without any."""
    return max((abs(root) / (2 * pi) for factor in factors for group in factor for root in group), default=0.0)


def upper_break_Hz(controller: Controller) -> float:
    """The highest natural frequency of its poles and zeros, from any of its readings.

    Raises:
        ValueError: as of `factored`.
    """
    return max(highest_Hz(factored(law)[1]) for _, law in laws_of(controller))


def sensible_rate_Hz(crossover_Hz: float, upper_break_Hz: float = 0.0) -> float:
    """The least rate of 1, 2 or 5 times a power of ten that is 40 times the crossover and ten times the upper break."""
    least = max(40 * crossover_Hz, 10 * upper_break_Hz, 1000.0)
    return next(rate for k in count() for step in (1, 2, 5) if (rate := step * 10.0**k) >= least)


def laws_of(controller: Controller | TransferFunction) -> Iterator[tuple[str, TransferFunction]]:
    """From each reading that has a part in the current, with its own sign, to it."""
    if isinstance(controller, TransferFunction):
        yield SENSED[0], controller
        return
    law = controller.sensed_law()
    yield SENSED[0], TransferFunction(law.numerators[0], law.denominator)
    others = [(name, -numerator) for name, numerator in zip(law.sensors, law.numerators, strict=True)][1:]
    others.append(("command_V", controller.command_numerator() - law.numerators[0]))
    yield from ((name, TransferFunction(numerator, law.denominator)) for name, numerator in others if numerator != 0)


def _groups(found: list[complex]) -> list[list[complex]]:
    """Real roots alone, complex ones with their conjugates."""
    return [[r] if r.imag == 0 else [r, r.conjugate()] for r in found if r.imag >= 0]


def _paired(poles: list[list[complex]], zeros: list[list[complex]]) -> list[Factor]:
    """Give every group of poles the nearest zeros it can hold; sections by rising frequency of their poles."""
    free = list(zeros)
    double = sorted((g for g in poles if len(g) == 2), key=lambda g: abs(g[0].real) / abs(g[0]))
    single = sorted((g for g in poles if len(g) == 1), key=lambda g: abs(g[0]))
    waiting = sum(len(g) == 2 for g in free) - len(double)
    for _ in range(max(waiting, 0)):  # pairs of zeros that no pair of poles is left for get two real ones about them
        one, other = min(
            combinations(single, 2), key=lambda two: min(apart(two[0] + two[1], g) for g in free if len(g) == 2)
        )
        single = [group for group in single if group is not one and group is not other]
        double.append(one + other)
    made = []
    for groups, size in ((double, 2), (single, 1)):
        left = list(groups)
        while left:  # the nearest of all first, so that no section has to span more than it must
            own, partners = _nearest(left, [g for g in free if len(g) == size])
            left.remove(own)
            if partners:
                free.remove(partners)
            made.append((own, partners))
    for k, (own, partners) in enumerate(made):  # real zeros beyond the number of real poles
        while len(partners) < len(own) and (more := _nearest([own], [g for g in free if len(g) == 1])[1]):
            free.remove(more)
            partners = partners + more
        made[k] = (own, partners)
    return sorted(made, key=lambda pair: _frequency(pair[0]))


def _nearest(owners: list[list[complex]], groups: list[list[complex]]) -> tuple[list[complex], list[complex]]:
    """The owner and the group whose frequencies are nearest to each other; an empty group where there is none."""
    pairs = [(apart(own, group), k, j) for k, own in enumerate(owners) for j, group in enumerate(groups)]
    if not pairs:
        return owners[0], []
    _, k, j = min(pairs)
    return owners[k], groups[j]


def apart(one: list[complex], other: list[complex]) -> float:
    """Between the frequencies of two groups, geometric means of their roots', as a logarithm."""
    return abs(log(_frequency(one) / _frequency(other)))


def _frequency(group: list[complex]) -> float:
    return prod(abs(root) for root in group) ** (1 / len(group))


def _delta(root: complex, rate_Hz: float) -> complex:
    """Where the bilinear rule puts a root (rad/s), prewarped, as z - 1."""
    half = root / (2 * rate_Hz)
    half *= tan(abs(half)) / abs(half)
    return 2 * half / (1 - half)


def _section(poles: list[complex], zeros: list[complex], rate_Hz: float) -> Section:
    own = [_delta(root, rate_Hz) for root in poles]
    other = [_delta(root, rate_Hz) for root in zeros] + [_FARTHEST] * (len(poles) - len(zeros))
    words = f"poles {_frequencies(poles)}; zeros {_frequencies(zeros)}"
    if len(own) == 1:
        follow = -own[0].real
        return Section(1, follow, 0.0, 0.0, follow / -other[0].real, words)
    product = (own[0] * own[1]).real
    follow, direct = sqrt(product), product / (other[0] * other[1]).real
    damping = -(own[0] + own[1]).real / follow
    return Section(2, follow, damping, -(other[0] + other[1]).real * direct / follow, direct, words)


def _frequencies(group: list[complex]) -> str:
    """Of one group of roots, for people."""
    if not group:
        return "none"
    if len(group) == 2 and group[0].imag != 0:
        return f"{abs(group[0]) / (2 * pi):.6g} Hz with damping ratio {-group[0].real / abs(group[0]):.6g}"
    return " and ".join(f"{-root.real / (2 * pi):.6g} Hz" for root in group)
