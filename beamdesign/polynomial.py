"""Exact rationals and polynomials in s: conversion of figures, values on the imaginary axis, real roots, Routh test.

Rationals at the border of a proof: bounds of balls, simple numbers in a gap, text without loss, safe rounding.

And where a root of p0(s) + k p1(s) lies on the imaginary axis: all such real k, from one polynomial in the frequency.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from functools import lru_cache, reduce
from math import inf, isfinite, nextafter, pi, sqrt

import numpy as np
from flint import acb, arb, arb_poly, ctx, fmpq, fmpq_mat, fmpq_mpoly, fmpq_poly, fmpz_poly

from beamdesign.exact_copies import let_be_copied

let_be_copied()


@lru_cache(1 << 14)
def exact(value: float) -> fmpq:
    """The rational of a float's shortest decimal form: 0.1 gives 1/10, not the nearest binary fraction.

    Raises:
        ValueError: for infinity and for what is not a number.
    """
    return fmpq(*Fraction(repr(float(value))).as_integer_ratio())


def bounds(ball: arb) -> tuple[fmpq, fmpq]:
    """The least and the largest number of a finite ball, exactly, whatever the working precision."""
    middle, radius = ball.mid().fmpq(), ball.rad().fmpq()
    return middle - radius, middle + radius


def simple_between(low: fmpq, high: fmpq) -> fmpq:
    """A decimal of few digits strictly between two rationals, near their middle.

    Raises:
        ValueError: where nothing lies between.
    """
    if not low < high:
        raise ValueError(f"nothing lies between {low} and {high}")
    middle = (low + high) / 2
    step = fmpq(1)
    while step * 10 < high - low:
        step *= 10
    while True:
        candidate = ((middle / step) + fmpq(1, 2)).floor() * step
        if low < candidate < high:
            return fmpq(candidate)
        step /= 10


def text(value: fmpq) -> str:
    """A decimal where the rational has a short one, otherwise the quotient p/q; both read back exactly."""
    denominator = int(value.q)
    if 10**40 % denominator:
        return f"{value.p}/{value.q}"
    digits = f"{abs(int(value.p)) * 10**40 // denominator:041d}"
    return ("-" if value < 0 else "") + f"{digits[:-40]}.{digits[-40:]}".rstrip("0").rstrip(".")


def shortened(value: fmpq, digits: int, up: bool = False) -> fmpq:
    """A rational rounded down, or up, to a decimal of so many significant digits; what is not positive as it is."""
    if value <= 0:
        return value
    towards = Context(prec=digits, rounding=ROUND_CEILING if up else ROUND_FLOOR)
    return fmpq(*towards.divide(Decimal(int(value.p)), Decimal(int(value.q))).as_integer_ratio())


def rounded_down(value: fmpq) -> float:
    """The largest float that is not above a rational."""
    near = nearest(value)
    return near if fmpq(*near.as_integer_ratio()) <= value else nextafter(near, -inf)


def rounded_up(value: fmpq) -> float:
    """The least float that is not below a rational."""
    return 0.0 - rounded_down(-value)  # no minus before a zero


def nearest(value: fmpq) -> float:
    """The float nearest to a rational: the way back from `exact`."""
    return int(value.p) / int(value.q)  # a quotient of whole numbers is rounded once, to the nearest float


@dataclass(frozen=True)
class Affine:
    """A polynomial in s that is affine in one parameter k: constant + k slope; free of it where no slope is given."""

    constant: fmpq_poly
    slope: fmpq_poly = field(default_factory=fmpq_poly)

    def __call__(self, inner: fmpq_poly) -> "Affine":
        """With a polynomial in the place of s."""
        return Affine(self.constant(inner), self.slope(inner))

    def at(self, value: fmpq) -> fmpq_poly:
        """The polynomial at one value of the parameter."""
        return self.constant + self.slope * value

    def __mul__(self, factor: fmpq_poly | fmpq) -> "Affine":
        return Affine(self.constant * factor, self.slope * factor)

    def __add__(self, other: "Affine") -> "Affine":
        return Affine(self.constant + other.constant, self.slope + other.slope)

    def __sub__(self, other: "Affine") -> "Affine":
        return Affine(self.constant - other.constant, self.slope - other.slope)


@dataclass(frozen=True)
class Quotient:
    """A quotient of polynomials in several variables, which reckons with rationals too.

    It is in lowest terms, of a denominator with leading coefficient 1, as numbers else grow without end.
    """

    numerator: fmpq_mpoly
    denominator: fmpq_mpoly

    def _over(self, numerator: fmpq_mpoly, denominator: fmpq_mpoly) -> "Quotient":
        common = numerator.gcd(denominator)
        above, below = divmod(numerator, common)[0], divmod(denominator, common)[0]
        return Quotient(above / below.leading_coefficient(), below / below.leading_coefficient())

    def _lifted(self, other: "Quotient | fmpq") -> "Quotient":
        nothing = 0 * self.numerator
        return other if isinstance(other, Quotient) else Quotient(nothing + other, nothing + 1)

    def __add__(self, other: "Quotient | fmpq") -> "Quotient":
        (a, b), (c, d) = ((one.numerator, one.denominator) for one in (self, self._lifted(other)))
        return self._over(a + c, b) if b == d else self._over(a * d + c * b, b * d)

    def __mul__(self, other: "Quotient | fmpq") -> "Quotient":
        other = self._lifted(other)
        return self._over(self.numerator * other.numerator, self.denominator * other.denominator)

    def __neg__(self) -> "Quotient":
        return Quotient(-self.numerator, self.denominator)

    def __sub__(self, other: "Quotient | fmpq") -> "Quotient":
        return self + -other

    def __rsub__(self, other: "Quotient | fmpq") -> "Quotient":
        return -self + other

    def __truediv__(self, other: "Quotient | fmpq") -> "Quotient":
        other = self._lifted(other)
        return self._over(self.numerator * other.denominator, self.denominator * other.numerator)

    def __rtruediv__(self, other: fmpq) -> "Quotient":
        return self._lifted(other) / self

    __radd__, __rmul__ = __add__, __mul__


def transfer(a: fmpq_mat, b: fmpq_mat, c: fmpq_mat, d: fmpq_mat) -> tuple[list[fmpq_poly], fmpq_poly]:
    """Numerators of c (s - a)^-1 b + d from each input to the one output, and their denominator, in s or in z.

    With det(s - a + b c) = det(s - a) + c adj(s - a) b.
    """
    n, below = a.nrows(), a.charpoly()
    columns = [fmpq_mat(n, 1, [b[i, k] for i in range(n)]) for k in range(b.ncols())]
    return [(a - one * c).charpoly() + (d[0, k] - 1) * below for k, one in enumerate(columns)], below


def in_variable(polynomial: fmpq_poly, variable: fmpq_mpoly) -> fmpq_mpoly:
    """A polynomial in one variable as one in several."""
    return sum((c * variable**i for i, c in enumerate(polynomial.coeffs())), 0 * variable)


def even_odd(polynomial: fmpq_poly) -> tuple[fmpq_poly, fmpq_poly]:
    """Parts on the imaginary axis: p(jw) = even(x) + j w odd(x), both polynomials in x = w^2."""
    coefficients = polynomial.coeffs()
    even = [-c if i % 2 else c for i, c in enumerate(coefficients[0::2])]
    odd = [-c if i % 2 else c for i, c in enumerate(coefficients[1::2])]
    return fmpq_poly(even), fmpq_poly(odd)


def squared_magnitude(polynomial: fmpq_poly) -> fmpq_poly:
    """|p(jw)|^2 as a polynomial in x = w^2."""
    return inner(polynomial, polynomial)


def inner(left: fmpq_poly, right: fmpq_poly) -> fmpq_poly:
    """Real part of left(jw) times the conjugate of right(jw), a polynomial in x = w^2."""
    (even_left, odd_left), (even_right, odd_right) = even_odd(left), even_odd(right)
    return even_left * even_right + fmpq_poly([0, 1]) * odd_left * odd_right


def turned(left: fmpq_poly, right: fmpq_poly) -> fmpq_poly:
    """Imaginary part of left(jw) times the conjugate of right(jw), over w, a polynomial in x = w^2."""
    (even_left, odd_left), (even_right, odd_right) = even_odd(left), even_odd(right)
    return odd_left * even_right - even_left * odd_right


def real_roots(polynomial: fmpq_poly, precision_bits: int = 128) -> list[tuple[arb, int]]:
    """Disjoint enclosures of all real roots, ascending, with multiplicities.

    Arb isolates all complex roots of the square-free factors; a root's enclosure has an imaginary part of exactly
    zero only where the root is proved to be real.

    Args:
        polynomial: not the zero polynomial.
        precision_bits: relative accuracy of the enclosures.

    Raises:
        ValueError: for the zero polynomial, of which every number is a root.
    """
    if polynomial.is_zero():
        raise ValueError("the zero polynomial has no isolated roots")
    with ctx.workprec(precision_bits):
        found = [(root.real, count) for root, count in _complex_roots(polynomial) if root.imag == 0]
    return sorted(found, key=lambda pair: float(pair[0].mid()))


def roots(polynomial: fmpq_poly) -> np.ndarray:
    """All complex roots as floats, each as often as its multiplicity, by real then imaginary part."""
    each = (root for root, count in _complex_roots(polynomial) for _ in range(count))
    found = [complex(float(root.real.mid()), float(root.imag.mid())) for root in each]
    return np.array(sorted(found, key=lambda z: (z.real, z.imag)))


def _complex_roots(polynomial: fmpq_poly) -> list[tuple[acb, int]]:
    return polynomial.numer().complex_roots()  # type: ignore[return-value]  # python-flint's stub has a plain list


def at_points(polynomial: fmpq_poly, points: np.ndarray | complex) -> np.ndarray:
    """Values at complex points, in floats."""
    return np.asarray(np.polyval([nearest(c) for c in reversed(polynomial.coeffs())] or [0.0], points))


def ratio(above: Affine, below: Affine, masses: np.ndarray, w: np.ndarray) -> np.ndarray:
    """A quotient of polynomials over the mass at jw in floats, (masses, frequencies)."""
    s = 1j * w
    top, bottom = (at_points(p.constant, s) + masses[:, None] * at_points(p.slope, s) for p in (above, below))
    return np.asarray(top / bottom)


def value_at(polynomial: fmpq_poly, point: arb) -> arb:
    """Enclosure of the value at a real ball, at the working precision."""
    return arb_poly(polynomial)(point)


_ACCURATE_BITS = 56


def tight(figures: Callable[[int], list[arb] | None]) -> list[arb]:
    """Figures at a precision that makes each as accurate as a float; None stands for a precision that does not tell."""
    bits = 128
    while True:
        with ctx.workprec(bits):
            found = figures(bits)
            if found is not None and all(one.is_exact() or one.rel_accuracy_bits() >= _ACCURATE_BITS for one in found):
                return found
        bits *= 2


def peak(above: fmpq_poly, below: fmpq_poly) -> arb:
    """Max |above / below| over all frequencies, of a stable quotient: at an end, or where its slope vanishes."""
    top, bottom, degree = squared_magnitude(above), squared_magnitude(below), below.degree()
    slope = top.derivative() * bottom - top * bottom.derivative()
    ends = top[0] / bottom[0], top[degree] / bottom[degree]

    def largest(bits: int) -> list[arb]:
        inside = [] if slope.is_zero() else [x for x, _ in real_roots(slope, bits) if x > 0]
        return [reduce(arb.max, [*map(arb, ends), *(value_at(top, x) / value_at(bottom, x) for x in inside)]).sqrt()]

    return tight(largest)[0]


def is_hurwitz(polynomial: fmpq_poly) -> bool:
    """Whether all roots lie in the open left half plane, by an exact Routh test.

    Fraction-free rows on even and odd parts; a zero or a sign change in the first column answers no, which is right
    for stability: a Hurwitz polynomial has a first column of one sign without zeros.
    """
    whole, degree = polynomial.numer(), polynomial.degree()
    if degree < 0:
        return False
    coefficients = (whole if whole[degree] > 0 else -whole).coeffs()
    upper, lower = fmpz_poly(coefficients[degree % 2 :: 2]), fmpz_poly(coefficients[1 - degree % 2 :: 2])
    for left in range(degree, 0, -1):
        lead, following = upper[left // 2], lower[(left - 1) // 2]
        if following <= 0:
            return False
        upper, lower = lower, following * upper - lead * lower.left_shift(1 - left % 2)
        if (divisor := lower.content()) > 1:
            lower //= divisor
    return True


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
    def ends(self) -> tuple[fmpq, fmpq]:
        """Rationals that enclose the parameter."""
        return bounds(self.parameter) if self.rational is None else (self.rational, self.rational)

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
    return turned(family.slope, family.constant)


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
