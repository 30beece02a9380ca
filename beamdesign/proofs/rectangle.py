"""A loop over outer end masses and one more parameter, a factor on its gain or the inverse zero of its lag.

Over a rectangle of masses and factors it is decided on the rectangle's four sides.

The characteristic polynomial o(m) + g r is affine in the mass m and in the factor g, and they do not multiply each
other: it is stable on the whole rectangle if it is on the sides (edge theorem of Bartlett, Hollot and Huang, 1988).
With added sensors r depends on the mass; `Rectangle.inside` then looks inside.

The sides decide performance as well. At one frequency the map from (m, g) to o(m) + g r, the reciprocal of the
compliance but for a factor, is affine to the complex plane: where it is one to one, the interior of the rectangle goes
to the interior of its image, and where it is not, the sides have the whole image. Either way the least magnitude, if it
is not zero, stands on a side. The map to 1/S = 1 + g r / o(m) is in polar coordinates about 1 a product of a function
of m alone with g, and the argument is a function of m alone, monotonic or constant: the same two cases. 1/(C S) is 1/S
over a number, and |L| grows with g, so that it is largest on a side.

With added sensors the characteristic polynomial is o_0 + m o_1 + g (r_0 + m r_1). It is not affine, so that the sides
of a rectangle do not decide; but all of it lies in the polytope of its corners, which is stable if the sides and the
diagonals between corners are. While a diagonal is not, the rectangle is cut in four, along loops that are looked at.

With the inverse zero u of a lag in the place of g, those u at which every mass of a range is stable are found, exactly
and not from a grid. The characteristic polynomial is p0(s) + m p1(s) + u p2(s), affine in both, at a given gain and
pole. A root pair lies at jw where two linear equations in (m, u) hold, so that all such pairs are one rational curve
(m(x), u(x)) over x = w^2. Whether every mass of the range is stable can change over u only where that curve, cut to the
range, begins, ends or turns back: at crossings of the range's two ends, and where du/dx vanishes. Between these values
of u one proof over the whole range settles all.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import accumulate, product
from math import nan, pi

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.controllers import Lag
from beamdesign.loop import Loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import (
    Affine,
    bounds,
    crossings,
    exact,
    nearest,
    real_roots,
    rounded_down,
    rounded_up,
    simple_between,
    turned,
    value_at,
)
from beamdesign.proofs.stability import is_stable_over, unstable_at
from beamdesign.prototype import Prototype

# The rectangle of masses m and factors g, and its sides.


_HALVINGS = 16
_ONE = fmpq(1)


@dataclass(frozen=True)
class Inside:
    """A point inside a rectangle at which it is not stable.

    Attributes:
        mass: kg.
        factor: on the gain.
        frequency_Hz: of the growing oscillation.
        decided: whether it was found; False where it could not be told from one that is none.
    """

    mass: float
    factor: float
    frequency_Hz: float
    decided: bool = True


@dataclass(frozen=True)
class Side:
    """One side of the rectangle.

    Attributes:
        loop: over what varies along the side, the mass or the factor.
        low: its least value.
        high: its largest value.
        mass: where the factor varies, the outer end mass.
        factor: where the mass varies, the factor.
    """

    loop: Loop
    low: fmpq
    high: fmpq
    mass: fmpq | None = None
    factor: fmpq | None = None

    @property
    def stable(self) -> bool:
        """Whether every loop of the side is stable."""
        return is_stable_over(self.loop.characteristic, self.low, self.high)

    @property
    def where(self) -> str:
        """What does not vary along the side, in words; empty for a factor of one."""
        if self.mass is not None:
            return f" and an outer end mass of {nearest(self.mass):.6g} kg"
        return "" if self.factor == 1 or self.factor is None else f" and {nearest(self.factor):.6g} times the gain"


@dataclass(frozen=True)
class Rectangle:
    """A loop over outer end masses and factors on its gain.

    Attributes:
        loop: at a factor of one.
        low: least outer end mass, kg.
        high: largest.
        least: least factor.
        most: largest.

    Raises:
        ValueError: for an empty range of masses.
    """

    loop: Loop
    low: fmpq
    high: fmpq
    least: fmpq = _ONE
    most: fmpq = _ONE

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError(f"empty range: {self.low} is above {self.high}")

    def sides(self) -> list[Side]:
        """The sides, those of varying mass first; one alone where the factor does not vary."""
        over_mass = [
            Side(self.loop.scaled(factor), self.low, self.high, factor=factor)
            for factor in sorted({self.least, self.most})
        ]
        if self.least == self.most:
            return over_mass
        return over_mass + [
            Side(over_gain(self.loop, mass), self.least, self.most, mass=mass) for mass in sorted({self.low, self.high})
        ]

    def widened(self, factor: fmpq) -> "Rectangle":
        """The rectangle with its gain also times every number between one and the given one."""
        return replace(self, least=self.least * min(factor, fmpq(1)), most=self.most * max(factor, fmpq(1)))

    def unstable_side(self) -> Side | None:
        """A side that is not stable throughout, None where all are."""
        return next((side for side in self.sides() if not side.stable), None)

    def inside(self, rate: fmpq | None = None, halvings: int = _HALVINGS) -> Inside | None:
        """A point inside that is not stable, or decays no faster than a rate, where the sides do; None if none is.

        After so many halvings it is left undecided.
        """
        denominator, numerator = self.loop.loop_denominator, self.loop.loop_numerator
        if rate is not None:
            denominator, numerator = shifted(denominator, rate), shifted(numerator, rate)
        masses, factors = (self.low, self.high), (self.least, self.most)
        if masses[0] == masses[1] or factors[0] == factors[1] or numerator.slope.is_zero():
            return None  # the sides decide
        (a, b), (c, d) = ([(denominator + numerator * g).at(mass) for g in factors] for mass in masses)
        if all(is_stable_over(Affine(one, other - one), fmpq(0), _ONE) for one, other in ((a, d), (b, c))):
            return None
        mass, factor = (sum(ends, fmpq(0)) / 2 for ends in (masses, factors))
        if not halvings:
            return Inside(nearest(mass), nearest(factor), nan, decided=False)
        if (there := unstable_at(denominator + numerator * factor, *masses)) is not None:
            return Inside(nearest(there.value), nearest(factor), there.frequency_Hz)
        if (there := unstable_at(Affine(denominator.at(mass), numerator.at(mass)), *factors)) is not None:
            return Inside(nearest(mass), nearest(there.value), there.frequency_Hz)
        parts = product(((self.low, mass), (mass, self.high)), ((self.least, factor), (factor, self.most)))
        found = (Rectangle(self.loop, *ends, *gains).inside(rate, halvings - 1) for ends, gains in parts)
        return next((one for one in found if one is not None), None)

    @property
    def stable(self) -> bool:
        """Whether it is stable throughout, inside as on its sides."""
        return self.unstable_side() is None and self.inside() is None

    def deciding_sides(self) -> list[Side]:
        """The sides, which decide what is claimed of magnitudes.

        Raises:
            ValueError: for a range of factors on a loop in which they and the mass multiply each other.
        """
        if self.least != self.most and not self.loop.gain_and_mass_apart:
            raise ValueError("mass and gain multiply each other in this loop, so that the sides do not decide")
        return self.sides()


def over_gain(loop: Loop, mass: fmpq) -> Loop:
    """A loop at one outer end mass over a factor on its gain, which takes the mass's place.

    The factor is one on the valve or its flow and not on the controller, so that C S has it in its denominator alone.
    """
    return Loop(
        Affine(loop.loop_denominator.at(mass)),
        Affine(fmpq_poly(), loop.loop_numerator.at(mass)),
        loop.disturbance,
        None if loop.effort_numerator is None else Affine(loop.effort_numerator.at(mass)),
    )


def shifted(family: Affine, rate: fmpq) -> Affine:
    """The family in s - rate: stable exactly where every root of the given one lies to the left of -rate."""
    return family(fmpq_poly([-rate, 1]))


# Zero frequencies of a lag for which every mass of a range is stable.


LEAST_HZ = 1e-3
LARGEST_HZ = 1e5
"""Zero frequencies outside these are not looked at."""

_BITS = 128


def stable_zeros(
    prototype: Prototype, pole_Hz: float, gain_A_per_V: float, outer_end_mass_kg: tuple[float, float]
) -> list[tuple[float, float]]:
    """All intervals of the lag's zero frequency, Hz, in which every mass is stable at a pole and a gain, ascending.

    They lie between neighbouring critical frequencies, their ends rounded inwards.

    Args:
        prototype: the rig and its inner end mass; its own controller does not matter.
        pole_Hz: lower break of the lag.
        gain_A_per_V: its gain at zero frequency.
        outer_end_mass_kg: range of masses, each of which is to be stable.

    Raises:
        InputError: for a prototype with effects.
    """
    plant = paper_model(prototype).plant(prototype.payload.inner_end_mass_kg)
    lag = Lag(gain_A_per_V=gain_A_per_V, pole_Hz=pole_Hz, zero_Hz=1.0)
    pole = fmpq_poly([1, 1 / exact(2 * pi * lag.pole_Hz)])
    denominator = plant.denominator * pole
    numerator = plant.control[0].constant * exact(lag.gain_A_per_V)
    p0, p1, p2 = denominator.constant + numerator, denominator.slope, numerator * fmpq_poly([0, 1])
    low, high = (exact(mass) for mass in outer_end_mass_kg)
    ends = tuple(1 / exact(2 * pi * frequency) for frequency in (LARGEST_HZ, LEAST_HZ))
    inside = (value for value in critical_values(p0, p1, p2, low, high) if value > ends[0] and value < ends[1])
    edges = [(ends[0], ends[0]), *sorted(map(bounds, inside)), (ends[1], ends[1])]
    found = []
    for start, (end, _) in zip(accumulate((most for _, most in edges), max), edges[1:], strict=False):
        if start < end and is_stable_over(Affine(p0 + simple_between(start, end) * p2, p1), low, high):
            # A last digit inwards, for the division and pi.
            least = rounded_up(1 / end) / (2 * pi) * (1 + 1e-12)
            most = rounded_down(1 / start) / (2 * pi) * (1 - 1e-12)
            found.append((least, most))
    return found[::-1]


def critical_values(p0: fmpq_poly, p1: fmpq_poly, p2: fmpq_poly, low: fmpq, high: fmpq) -> Iterator[arb]:
    """Enclosures of all u at which stability over the whole range of m can change for p0 + m p1 + u p2.

    The leading coefficient is taken not to vanish in the range, and the last to be free of m and u: so it is for a rig,
    whose end mass acts on accelerations.

    Raises:
        ArithmeticError: where the leading coefficient may vanish.
    """
    degree = max(polynomial.degree() for polynomial in (p0, p1, p2))
    if p2[degree] != 0 or p2[0] != 0 or p1[0] != 0 or (p0 + low * p1)[degree] * (p0 + high * p1)[degree] <= 0:
        raise ArithmeticError("a root of this family passes through the origin or through infinity")
    with ctx.workprec(_BITS):
        for mass in {low, high}:
            for crossing in crossings(Affine(p0 + mass * p1, p2), _BITS):
                yield crossing.parameter
        determinant, of_mass, of_zero = turned(p2, p1), turned(p0, p2), turned(p1, p0)
        # At a shared root a whole line of (m, u) has a root pair: it begins and ends at the range's ends, found above.
        shared = determinant.gcd(of_mass).gcd(of_zero)
        if not shared.is_zero():
            determinant, of_mass, of_zero = determinant / shared, of_mass / shared, of_zero / shared
        turning = of_zero.derivative() * determinant - of_zero * determinant.derivative()
        for square, _ in [] if turning.is_zero() else real_roots(turning, _BITS):
            below = value_at(determinant, square)
            if not square > 0 or below.contains(0):
                continue
            there = value_at(of_mass, square) / below
            if there < arb(low) or there > arb(high):
                continue
            yield value_at(of_zero, square) / below
