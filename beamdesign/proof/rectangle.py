"""A loop over a rectangle of outer end masses and factors on its gain, decided on the rectangle's four sides.

The characteristic polynomial o(m) + g r is affine in the mass m and in the factor g, and they do not multiply each
other: it is stable on the whole rectangle if it is on the sides (edge theorem of Bartlett, Hollot and Huang, 1988).
With added sensors r depends on the mass; `beamdesign.proof.bilinear` then looks inside.

The sides decide performance as well. At one frequency the map from (m, g) to o(m) + g r, the reciprocal of the
compliance but for a factor, is affine to the complex plane: where it is one to one, the interior of the rectangle goes
to the interior of its image, and where it is not, the sides have the whole image. Either way the least magnitude, if it
is not zero, stands on a side. The map to 1/S = 1 + g r / o(m) is in polar coordinates about 1 a product of a function
of m alone with g, and the argument is a function of m alone, monotonic or constant: the same two cases. 1/(C S) is 1/S
over a number, and |L| grows with g, so that it is largest on a side.
"""

from dataclasses import dataclass, replace

from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.polynomial import Affine
from beamdesign.proof.bilinear import Inside, axis_inside
from beamdesign.proof.rational import nearest
from beamdesign.proof.stability import is_stable_over

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
            Side(scaled(self.loop, factor), self.low, self.high, factor=factor)
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
        opened, returned = self.loop.opened, self.loop.returned
        if rate is not None:
            opened, returned = shifted(opened, rate), shifted(returned, rate)
        return axis_inside(opened, returned, (self.low, self.high), (self.least, self.most))

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


def scaled(loop: Loop, factor: fmpq) -> Loop:
    """A loop with its gain times a factor."""
    return loop if factor == 1 else replace(loop, returned=loop.returned * factor)


def over_gain(loop: Loop, mass: fmpq) -> Loop:
    """A loop at one outer end mass over a factor on its gain, which takes the mass's place.

    The factor is one on the valve or its flow and not on the controller, so that C S has it in its denominator alone.
    """
    return Loop(
        Affine(loop.opened.at(mass), _ZERO),
        Affine(_ZERO, loop.returned.at(mass)),
        loop.disturbance,
        None if loop.demanded is None else Affine(loop.demanded.at(mass), _ZERO),
    )


def shifted(family: Affine, rate: fmpq) -> Affine:
    """The family in s - rate: stable exactly where every root of the given one lies to the left of -rate."""
    shift = fmpq_poly([-rate, 1])
    return Affine(family.constant(shift), family.slope(shift))
