"""Where a root of p0(s) + k p1(s) lies on the imaginary axis: all such real k, from one polynomial in the frequency."""

from dataclasses import dataclass, replace
from math import isfinite, pi, sqrt

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.polynomial import Affine, even_odd, real_roots, value_at


@dataclass(frozen=True)
class Crossing:
    """A parameter value at which the family has a root pair on the imaginary axis.

    Attributes:
        parameter: enclosure of k.
        squared_frequency: enclosure of x = w^2, (rad/s)^2; exactly zero for a root at the origin, infinite where the
            leading coefficient vanishes and a root passes through infinity.
        rational: k itself where it is known to be this rational, otherwise None.
    """

    parameter: arb
    squared_frequency: arb
    rational: fmpq | None = None

    @property
    def value(self) -> float:
        """The parameter as a float."""
        return float(self.parameter.mid())

    @property
    def frequency_Hz(self) -> float:
        """Frequency of the root pair."""
        return sqrt(max(float(self.squared_frequency.mid()), 0.0)) / (2 * pi)

    @property
    def finite(self) -> bool:
        """Whether the root lies on the axis itself rather than at infinity."""
        return isfinite(float(self.squared_frequency.mid()))

    def known(self, rational: fmpq) -> "Crossing":
        """The same crossing, its parameter now known to be a rational."""
        return replace(self, parameter=arb(rational), rational=rational)


def elimination(family: Affine) -> fmpq_poly:
    """The polynomial in x = w^2 that vanishes where some real k puts a root at jw, w > 0.

    With p(jw) = even + j w odd, both parts of p0 + k p1 vanish for one k exactly where even0 odd1 = odd0 even1.
    """
    even0, odd0 = even_odd(family.constant)
    even1, odd1 = even_odd(family.slope)
    return even0 * odd1 - odd0 * even1


def shares_axis_root(family: Affine) -> bool:
    """Whether p0 and p1 have a common root on the imaginary axis, which is then there for every k."""
    shared = family.constant.gcd(family.slope)
    if shared.degree() < 1:
        return False
    even, odd = even_odd(shared)
    return shared(0) == 0 or any(root >= 0 for root, _ in real_roots(even.gcd(odd)))


def degree_drop(family: Affine) -> fmpq | None:
    """The k at which the leading coefficient vanishes, or None where it never does."""
    degree = max(family.constant.degree(), family.slope.degree())
    if degree < 0 or family.slope[degree] == 0:
        return None
    return -family.constant[degree] / family.slope[degree]


def crossings(family: Affine, precision_bits: int = 128) -> list[Crossing]:
    """All isolated real k with a root on the axis at w > 0 (or at the origin), ascending in k.

    A frequency at which p1 itself vanishes on the axis has no finite k. Where both polynomials are even (or both odd)
    up to a common factor, every k has roots symmetric about the axis and none is isolated.

    Raises:
        ArithmeticError: where p0 and p1 share a root on the axis, so that every k has it.
    """
    if shares_axis_root(family):
        raise ArithmeticError("p0 and p1 share a root on the imaginary axis: it is there for every parameter")
    even0, odd0 = even_odd(family.constant)
    even1, odd1 = even_odd(family.slope)
    equation = elimination(family)
    stuck = even1.gcd(odd1)  # p1 on the axis: k runs off to infinity there
    while not equation.is_zero() and (common := equation.gcd(stuck)).degree() > 0:
        equation = equation / common
    at_origin = []
    if family.slope[0] != 0:
        parameter = -family.constant[0] / family.slope[0]
        at_origin = [Crossing(arb(parameter), arb(0), parameter)]
    while True:
        with ctx.workprec(precision_bits):
            squares = [] if equation.is_zero() else [x for x, _ in real_roots(equation, precision_bits) if x > 0]
            found = [Crossing(_parameter(even0, odd0, even1, odd1, square), square) for square in squares]
        if all(crossing.parameter.is_finite() for crossing in found):
            return sorted([*at_origin, *found], key=lambda crossing: crossing.value)
        precision_bits *= 2


def _parameter(even0: fmpq_poly, odd0: fmpq_poly, even1: fmpq_poly, odd1: fmpq_poly, square: arb) -> arb:
    """The k that belongs to a root of the elimination polynomial, from the part of p1 that is known better there."""
    even, odd = value_at(even1, square), value_at(odd1, square)
    # An exact zero counts as perfectly accurate, so it is ruled out first.
    if odd.contains(0) or (not even.contains(0) and even.rel_accuracy_bits() >= odd.rel_accuracy_bits()):
        return -value_at(even0, square) / even
    return -value_at(odd0, square) / odd
