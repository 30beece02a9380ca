"""A loop over a rectangle of outer end masses and factors on its gain, decided on the rectangle's four sides.

The characteristic polynomial o(m) + g r is affine in the mass m and in the factor g, and they do not multiply each
other: it is stable on the whole rectangle if it is on the sides (edge theorem of Bartlett, Hollot and Huang, 1988).
With added sensors r depends on the mass; `axis_inside` then looks inside.

The sides decide performance as well. At one frequency the map from (m, g) to o(m) + g r, the reciprocal of the
compliance but for a factor, is affine to the complex plane: where it is one to one, the interior of the rectangle goes
to the interior of its image, and where it is not, the sides have the whole image. Either way the least magnitude, if it
is not zero, stands on a side. The map to 1/S = 1 + g r / o(m) is in polar coordinates about 1 a product of a function
of m alone with g, and the argument is a function of m alone, monotonic or constant: the same two cases. 1/(C S) is 1/S
over a number, and |L| grows with g, so that it is largest on a side.

With added sensors the characteristic polynomial is p = o_0 + m o_1 + g (r_0 + m r_1). It is not affine, so that the
sides of a rectangle do not decide. Where they are stable, though, neither the leading coefficient nor p(0) vanishes
inside: both are bilinear, and of one sign at the corners. So the points with a root at jw, if there are any, are a
compact set inside the rectangle and above w = 0. At the largest x = w^2 of it the even part E and the odd part O of p
have dependent gradients in (m, g), else x could grow (implicit function theorem). With subscripts for derivatives,

    R(g) = E O_m - O E_m

is free of m and quadratic in g; there, R = 0 and R' = E_g O_m - O_g E_m = 0. So x is a root of R's discriminant, a
polynomial. Each such root gives one g and one m, which are inside the rectangle or not.
"""

from dataclasses import dataclass, replace
from math import pi, sqrt

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.polynomial import Affine, even_odd, real_roots, value_at
from beamdesign.proofs.stability import is_stable_over
from beamdesign.rational import nearest

# Roots on the axis inside a rectangle of masses m and factors g that multiply each other.


_PRECISIONS = (128, 512, 2048)
"""Bits, tried in turn."""


@dataclass(frozen=True)
class Inside:
    """A point inside a rectangle with a root on the axis.

    Attributes:
        mass: kg.
        factor: on the gain.
        frequency_Hz: of the root.
        decided: whether it was found; False where it could not be told from one that is none.
    """

    mass: float
    factor: float
    frequency_Hz: float
    decided: bool = True


def axis_inside(
    denominator: Affine, numerator: Affine, masses: tuple[fmpq, fmpq], factors: tuple[fmpq, fmpq]
) -> Inside | None:
    """A point inside a rectangle at which denominator + g numerator has a root on the imaginary axis; None if none has.

    Args:
        denominator: over the mass.
        numerator: likewise.
        masses: least and largest.
        factors: least and largest; all four sides are stable.
    """
    if masses[0] == masses[1] or factors[0] == factors[1] or numerator.slope.is_zero():
        return None  # the sides decide
    parts = _Parts(denominator, numerator)
    if parts.discriminant.is_zero():
        return Inside(float("nan"), float("nan"), float("nan"), decided=False)
    left = None
    for bits in _PRECISIONS:
        with ctx.workprec(bits):
            found = [
                parts.judged(root, masses, factors) for root, _ in real_roots(parts.discriminant, bits) if root > 0
            ]
        if any(isinstance(one, Inside) and one.decided for one in found):
            return next(one for one in found if isinstance(one, Inside) and one.decided)
        left = next((one for one in found if one is not None), None)
        if left is None:
            return None
    return left


class _Parts:
    """E and O as bilinear functions of m and g, and R(g) = q_0 + q_1 g + q_2 g^2, all over x = w^2."""

    def __init__(self, denominator: Affine, numerator: Affine):
        parts = (denominator.constant, denominator.slope, numerator.constant, numerator.slope)
        self.even, self.odd = zip(*map(even_odd, parts), strict=True)
        (e, e_m, e_g, e_mg), (o, o_m, o_g, o_mg) = self.even, self.odd
        self.q0 = e * o_m - o * e_m
        self.q1 = e * o_mg + e_g * o_m - o * e_mg - o_g * e_m
        self.q2 = e_g * o_mg - o_g * e_mg
        self.discriminant: fmpq_poly = self.q1 * self.q1 - 4 * self.q0 * self.q2

    def judged(self, x: arb, masses: tuple[fmpq, fmpq], factors: tuple[fmpq, fmpq]) -> Inside | None:
        """Where a root of the discriminant has its point: None outside, else inside or not to be told."""
        q0, q1, q2 = (value_at(q, x) for q in (self.q0, self.q1, self.q2))
        if not q2.contains(0):
            factor = -q1 / (2 * q2)
        elif not q1.contains(0):
            factor = -2 * q0 / q1
        else:
            return Inside(_float(masses), _float(factors), _hertz(x), decided=False)
        if outside(factor, factors):
            return None
        for part in (self.even, self.odd):
            p, p_m, p_g, p_mg = (value_at(q, x) for q in part)
            below = p_m + p_mg * factor
            if below.contains(0):
                continue
            mass = -(p + p_g * factor) / below
            if outside(mass, masses):
                return None
            sure = within(mass, masses) and within(factor, factors)
            return Inside(float(mass.mid()), float(factor.mid()), _hertz(x), sure)
        return Inside(_float(masses), float(factor.mid()), _hertz(x), decided=False)


def outside(ball: arb, ends: tuple[fmpq, fmpq]) -> bool:
    """Whether all of a ball is outside an interval."""
    return bool(ball < arb(ends[0])) or bool(ball > arb(ends[1]))


def within(ball: arb, ends: tuple[fmpq, fmpq]) -> bool:
    """Whether all of a ball is inside an open interval."""
    return bool(ball > arb(ends[0])) and bool(ball < arb(ends[1]))


def _float(pair: tuple[fmpq, fmpq]) -> float:
    middle = (pair[0] + pair[1]) / 2
    return int(middle.p) / int(middle.q)


def _hertz(x: arb) -> float:
    return sqrt(float(x.mid())) / (2 * pi)


# The rectangle and its sides.


_ZERO = fmpq_poly([0])
_ONE = fmpq(1)


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

    def inside(self, rate: fmpq | None = None) -> Inside | None:
        """A point inside with a root on the axis, or to the right of -rate, where the sides have none; None if none."""
        denominator, numerator = self.loop.loop_denominator, self.loop.loop_numerator
        if rate is not None:
            denominator, numerator = shifted(denominator, rate), shifted(numerator, rate)
        return axis_inside(denominator, numerator, (self.low, self.high), (self.least, self.most))

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
        Affine(loop.loop_denominator.at(mass), _ZERO),
        Affine(_ZERO, loop.loop_numerator.at(mass)),
        loop.disturbance,
        None if loop.effort_numerator is None else Affine(loop.effort_numerator.at(mass), _ZERO),
    )


def shifted(family: Affine, rate: fmpq) -> Affine:
    """The family in s - rate: stable exactly where every root of the given one lies to the left of -rate."""
    shift = fmpq_poly([-rate, 1])
    return Affine(family.constant(shift), family.slope(shift))
