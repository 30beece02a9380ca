"""Where a root of p0(s) + k p1(s) lies on the imaginary axis: all such real k, from one polynomial in the frequency."""

from dataclasses import dataclass
from math import pi, sqrt

from flint import arb, ctx, fmpq_poly

from beamdesign.polynomial import Affine, even_odd, real_roots, value_at


@dataclass(frozen=True)
class Crossing:
    """A parameter value at which the family has a root pair on the imaginary axis.

    Attributes:
        parameter: enclosure of k.
        squared_frequency: enclosure of x = w^2, (rad/s)^2; exactly zero for a root at the origin.
    """

    parameter: arb
    squared_frequency: arb

    @property
    def value(self) -> float:
        """The parameter as a float."""
        return float(self.parameter.mid())

    @property
    def frequency_Hz(self) -> float:
        """Frequency of the root pair."""
        return sqrt(max(float(self.squared_frequency.mid()), 0.0)) / (2 * pi)


def elimination(family: Affine) -> fmpq_poly:
    """The polynomial in x = w^2 that vanishes where some real k puts a root at jw, w > 0.

    With p(jw) = even + j w odd, both parts of p0 + k p1 vanish for one k exactly where even0 odd1 = odd0 even1.
    """
    even0, odd0 = even_odd(family.constant)
    even1, odd1 = even_odd(family.slope)
    return even0 * odd1 - odd0 * even1


def crossings(family: Affine, precision_bits: int = 128) -> list[Crossing]:
    """All real k with a root on the axis at w > 0 (or at the origin), ascending in k.

    A frequency at which p1 itself vanishes on the axis has no finite k, unless p0 vanishes there too.

    Raises:
        ArithmeticError: where p0 and p1 share a root on the axis, so that every k has it.
    """
    shared = family.constant.gcd(family.slope)
    even, odd = even_odd(shared)
    if any(root >= 0 for root, _ in real_roots(even.gcd(odd))) or shared(0) == 0:
        raise ArithmeticError("p0 and p1 share a root on the imaginary axis: it is there for every parameter")
    even0, odd0 = even_odd(family.constant)
    even1, odd1 = even_odd(family.slope)
    before, ctx.prec = ctx.prec, precision_bits
    try:
        found = []
        if family.slope(0) != 0:
            found.append(Crossing(arb(-family.constant(0) / family.slope(0)), arb(0)))
        stuck = even1.gcd(odd1)  # p1 on the axis: k runs off to infinity there
        equation = elimination(family)
        while (common := equation.gcd(stuck)).degree() > 0:
            equation = equation / common
        for square, _ in real_roots(equation, precision_bits):
            if not square > 0:
                continue
            denominator = value_at(even1, square)
            numerator = value_at(even0, square)
            if denominator.contains(0):
                numerator, denominator = value_at(odd0, square), value_at(odd1, square)
            found.append(Crossing(-numerator / denominator, square))
    finally:
        ctx.prec = before
    return sorted(found, key=lambda crossing: crossing.value)
