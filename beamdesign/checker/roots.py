"""Polynomials over a mass: real roots isolated, and what they decide, stability and inequalities of magnitudes.

Real roots are isolated by Descartes' rule of signs and bisection (Vincent, Collins and Akritas); stability over a mass
rests on Hurwitz determinants, Routh's test and crossings.

Roots of plain(s) + late(s) exp(-s T) in the right half plane are counted by the direct method of Walton and Marshall
(1987). As the delay grows from none, roots cross the axis only at jw with |plain(jw)| = |late(jw)|, where W(w^2) =
|plain(jw)|^2 - |late(jw)|^2 vanishes, at the delays that give exp(-jwT) the angle of -plain / late; whichever of these
it is, a pair moves to the right where W grows with w^2 and to the left where it falls.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from itertools import pairwise, product
from typing import Any

from flint import acb, arb, arb_poly, fmpq, fmpq_mat, fmpq_poly, fmpz, fmpz_poly

from beamdesign.checker.work import of_common_divisor, of_determinant, of_quotients, of_roots, of_signs, spend

S = fmpq_poly([0, 1])
ONE, ZERO = fmpq_poly([1]), fmpq_poly([0])
Pair = tuple[fmpq, fmpq]
"""Ends of a closed interval."""
Polynomials = tuple[fmpq_poly, fmpq_poly]
"""Constant and slope in the mass, or even and odd part."""
NONE = fmpq(0)


def plus(one: Polynomials, other: Polynomials, times: fmpq | int = 1) -> Polynomials:
    """Sum of two that are affine in the mass, the second one times a factor."""
    return one[0] + times * other[0], one[1] + times * other[1]


def scaled(one: Polynomials, factor: fmpq | fmpq_poly) -> Polynomials:
    """One that is affine in the mass, times a factor."""
    return one[0] * factor, one[1] * factor


def _sign_changes(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> int:
    """An upper bound on the number of roots in the open interval, which is exact where it is 0 or 1."""
    spend(of_signs(polynomial, low, high))
    moved = polynomial(fmpq_poly([low, high - low])).numer().coeffs()  # onto (0, 1), then onto the positive numbers
    moved += [fmpz(0)] * (polynomial.degree() + 1 - len(moved))
    signs = [value > 0 for value in fmpz_poly(moved[::-1])(fmpz_poly([1, 1])).coeffs() if value != 0]
    return sum(before != after for before, after in pairwise(signs))


def isolate(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> list[Pair]:
    """Disjoint open intervals, each with one root in (low, high) of a polynomial without multiple roots, ascending.

    A root met exactly is an interval without length.
    """
    changes = _sign_changes(polynomial, low, high)
    if changes < 2:
        return [(low, high)] * changes
    middle = (low + high) / 2
    exact = [(middle, middle)] if polynomial(middle) == 0 else []
    return [*isolate(polynomial, low, middle), *exact, *isolate(polynomial, middle, high)]


def halve(polynomial: fmpq_poly, interval: Pair) -> Pair:
    """A shorter interval around the same root."""
    low, high = interval
    middle = (low + high) / 2
    spend(of_signs(polynomial, low, high))
    value = polynomial(middle)
    if low == high or value == 0:
        return middle, middle
    start = polynomial(low)
    below = start * value < 0 if start != 0 else _sign_changes(polynomial, low, middle) > 0
    return (low, middle) if below else (middle, high)


def bound(polynomial: fmpq_poly) -> fmpq:
    """A power of two above every root (Fujiwara's bound, rounded up)."""
    coefficients = [int(value) for value in polynomial.numer().coeffs()]
    lead = abs(coefficients[-1]).bit_length() - 1
    exponents = [
        -((lead - abs(value).bit_length()) // k) for k, value in enumerate(coefficients[-2::-1], start=1) if value
    ]
    return fmpq(2) ** (max(exponents, default=0) + 2)


def square_free(polynomial: fmpq_poly) -> fmpq_poly:
    """A polynomial with the same roots, each once."""
    spend(of_common_divisor(polynomial))
    return polynomial / polynomial.gcd(polynomial.derivative())


def interpolated(value: Callable[[fmpq], fmpq], points: Iterable[fmpq]) -> fmpq_poly:
    """The polynomial of least degree through what a function is at some points."""
    found, basis = ZERO, ONE
    for point in points:
        found += basis * ((value(point) - found(point)) / basis(point))
        basis *= S - point
    return found


def pieces(polynomials: Sequence[fmpq_poly], low: fmpq, high: fmpq) -> tuple[list[fmpq], int]:
    """A rational in every open interval into which the polynomials' roots cut (low, high), and how many roots that is.

    Zero polynomials cut nothing.
    """
    basis: list[fmpq_poly] = []
    for polynomial in polynomials:
        if polynomial.degree() < 1:
            continue
        rest = square_free(polynomial)
        for other in basis:
            spend(of_common_divisor(max(rest, other, key=lambda one: one.degree())))
            rest = rest / rest.gcd(other)
        for end in (low, high):  # a root at an end cuts nothing
            if rest(end) == 0:
                rest = rest / (S - end)
        if rest.degree() > 0:
            basis.append(rest)
    roots = sorted((interval, i) for i, factor in enumerate(basis) for interval in isolate(factor, low, high))
    while True:
        clash = {k for i, (one, two) in enumerate(pairwise(roots)) if not one[0][1] < two[0][0] for k in (i, i + 1)}
        if roots and not roots[0][0][0] > low:
            clash.add(0)
        if roots and not roots[-1][0][1] < high:
            clash.add(len(roots) - 1)
        if not clash:
            break
        roots = sorted((halve(basis[i], found) if k in clash else found, i) for k, (found, i) in enumerate(roots))
    edges = [low, *(end for interval, _ in roots for end in interval), high]
    return [(edges[i] + edges[i + 1]) / 2 for i in range(0, len(edges), 2)], len(roots)


def parts(polynomial: fmpq_poly) -> Polynomials:
    """Even and odd part on the axis, p(jw) = even(w^2) + j w odd(w^2)."""
    turned = [value * (1, 1, -1, -1)[i % 4] for i, value in enumerate(polynomial.coeffs())]
    return fmpq_poly(turned[0::2]), fmpq_poly(turned[1::2])


def ends(ball: arb) -> Pair:
    """The least and the largest number of a finite ball."""
    middle, radius = ball.mid().fmpq(), ball.rad().fmpq()
    return middle - radius, middle + radius


def around(interval: Pair) -> arb:
    """A ball that holds an interval."""
    middle, radius = (interval[0] + interval[1]) / 2, (interval[1] - interval[0]) / 2
    return arb(middle) + arb(0, arb(radius).upper())


def on_axis(polynomial: fmpq_poly, interval: Pair) -> bool:
    """Whether the polynomial has a root at jw for a w^2 in the interval, open or of no length."""
    even, odd = parts(polynomial)
    common = even.gcd(odd)
    if interval[0] == interval[1]:
        return common(interval[0]) == 0
    return common.degree() > 0 and bool(isolate(square_free(common), *interval))


def inner(left: fmpq_poly, right: fmpq_poly) -> fmpq_poly:
    """Real part of left(jw) conj(right(jw)) as a polynomial in w^2."""
    (even_left, odd_left), (even_right, odd_right) = parts(left), parts(right)
    return even_left * even_right + S * odd_left * odd_right


# Stability.


def _hurwitz_matrix(polynomial: fmpq_poly, degree: int) -> fmpq_mat:
    size = max(degree - 1, 0)
    entries = [polynomial[degree - 1 - 2 * column + row] for row in range(size) for column in range(size)]
    return fmpq_mat(size, size, entries)  # of a place beyond its ends a polynomial gives zero


def is_hurwitz(polynomial: fmpq_poly) -> bool:
    """Whether all roots lie in the open left half plane: the quotients of Euclid's algorithm on the two parts."""
    coefficients = polynomial.coeffs()
    degree = polynomial.degree()
    if degree < 0:
        return False
    spend(of_quotients(polynomial))

    def part(parity: int) -> fmpq_poly:
        return fmpq_poly([c if (degree - i) % 2 == parity else 0 for i, c in enumerate(coefficients)])

    upper, lower = part(0), part(1)
    for left in range(degree, 0, -1):
        if lower.degree() != left - 1 or lower[left - 1] * upper[left] <= 0:
            return False
        rest = (upper - fmpq_poly([0, upper[left] / lower[left - 1]]) * lower).numer()
        upper, lower = lower, fmpq_poly(rest // (int(rest.content()) or 1))  # a positive factor changes no sign
    return True


def determinant_of(matrix: fmpq_mat) -> fmpq:
    """Of a matrix whose size is counted as work."""
    spend(of_determinant(matrix))
    return matrix.det()


class Family:
    """p0 + m p1, and where in m it is stable."""

    def __init__(self, p0: fmpq_poly, p1: fmpq_poly):
        self.p0, self.p1 = p0, p1
        self.degree = max(p0.degree(), p1.degree())

    @cached_property
    def critical(self) -> list[fmpq_poly]:
        """The polynomials in m that vanish wherever stability can change.

        Orlando: the last but one determinant vanishes where two roots add up to zero. It is a polynomial in m of at
        most the degree of the family, and found by interpolation.
        """
        masses = map(fmpq, range(max(self.degree, 1)))
        determinant = interpolated(lambda m: determinant_of(_hurwitz_matrix(self.at(m), self.degree)), masses)
        return [determinant, *(fmpq_poly([self.p0[k], self.p1[k]]) for k in (0, self.degree))]

    def at(self, mass: fmpq) -> fmpq_poly:
        """The member at one mass."""
        return self.p0 + self.p1 * mass

    def is_stable(self, mass: fmpq) -> bool:
        """Whether one member has all its roots, and in the open left half plane."""
        return self.at(mass).degree() == self.degree and is_hurwitz(self.at(mass))

    def verdict(self, low: fmpq, high: fmpq) -> bool | None:
        """Whether all masses strictly between are stable (True), none is (False), or some are (None)."""
        if low == high:
            return self.is_stable(low)
        samples, cuts = pieces(self.critical, low, high)
        stable = [self.is_stable(mass) for mass in samples]
        if not any(stable):
            return False  # at the cuts themselves roots lie on the axis, at infinity, or on both sides of it
        return True if all(stable) and cuts == 0 and not any(q.is_zero() for q in self.critical) else None

    def is_stable_over(self, low: fmpq, high: fmpq) -> bool:
        """Whether all masses of a closed range are stable."""
        return self.is_stable(low) and self.is_stable(high) and self.verdict(low, high) is True


_MOST_HALVINGS = 16


def stable_on_rectangle(
    denominator: Polynomials, numerator: Polynomials, masses: Pair, gains: Pair, halvings: int = _MOST_HALVINGS
) -> bool:
    """Whether denominator + g numerator is stable for every mass and factor g, both affine in the mass.

    On a polytope of polynomials of constant degree the edges decide (Bartlett, Hollot and Huang, 1988). Where mass and
    factor multiply each other the rectangle is none, but all of it lies in the polytope of its corners, whose edges are
    its sides and diagonals. While a diagonal is not stable the rectangle is cut in four; a side that is not stable
    refutes, as it consists of loops.

    Raises:
        ArithmeticError: where that is not decided after so many halvings.
    """

    def between(one: tuple[fmpq, fmpq], other: tuple[fmpq, fmpq]) -> bool:
        """Whether the polynomials on the way from one mass and factor to another are stable."""
        start, end = (Family(*plus(denominator, numerator, g)).at(m) for m, g in (one, other))
        return Family(start, end - start).is_stable_over(NONE, fmpq(1))

    over_mass = [Family(*plus(denominator, numerator, g)) for g in {*gains}]
    over_gain = [Family(denominator[0] + m * denominator[1], numerator[0] + m * numerator[1]) for m in {*masses}]
    sides = all(side.is_stable_over(*masses) for side in over_mass)
    sides = sides and (gains[0] == gains[1] or all(side.is_stable_over(*gains) for side in over_gain))
    flat = masses[0] == masses[1] or gains[0] == gains[1] or numerator[1] == 0
    diagonals = zip(masses, gains, strict=True), zip(masses, gains[::-1], strict=True)
    if not sides or flat or all(between(*diagonal) for diagonal in diagonals):
        return sides
    if not halvings:
        raise ArithmeticError("whether roots cross the axis inside a range of masses and gains is not decided")
    light_heavy, low_high = (((a, (a + b) / 2), ((a + b) / 2, b)) for a, b in (masses, gains))
    parts = product(light_heavy, low_high)
    return all(stable_on_rectangle(denominator, numerator, *part, halvings - 1) for part in parts)


# Roots with a delay.


_DELAY_HALVINGS = 300


def unstable_roots(plain: fmpq_poly, late: fmpq_poly, delay: fmpq) -> int | None:
    """How many roots have a positive real part, the degree of `late` being the lower one.

    None where a root is on the axis, or too near to it to be told from one.
    """
    count = 0
    spend(of_roots(plain + late))
    roots: list[Any] = (plain + late).complex_roots()
    for root, multiplicity in roots:
        if root.real.contains(0):
            return None
        count += multiplicity if root.real > 0 else 0
    if delay == 0 or late == 0:
        return count
    difference = inner(plain, plain) - inner(late, late)
    common = square_free(difference)
    if common(0) == 0:
        common = common / S
    if common.degree() < 1:
        return count
    most = bound(common)
    samples, _ = pieces([difference], fmpq(0), most)
    for found, before, after in zip(isolate(common, fmpq(0), most), samples, samples[1:], strict=False):
        grows = int(difference(after) > 0) - int(difference(before) > 0)
        interval = found
        for _ in range(_DELAY_HALVINGS):
            crossed = _crossings(plain, late, delay, around(interval))
            if crossed is not None:
                break
            interval = halve(common, interval)
        else:
            return None
        count += 2 * grows * crossed
    return count


def _crossings(plain: fmpq_poly, late: fmpq_poly, delay: fmpq, square: arb) -> int | None:
    """How often the root at a w^2 within a ball crosses as the delay grows; None where that is too wide.

    It does where w T is the angle a of -late / plain plus a multiple of 2 pi, for 0 < T <= delay.
    """
    if not square > 0:
        return None
    w = square.sqrt()

    def on_axis(polynomial: fmpq_poly) -> acb:
        even, odd = map(arb_poly, parts(polynomial))
        return acb(even(square), w * odd(square))

    below = on_axis(plain)
    if below.contains(0):
        return None
    ratio = -on_axis(late) / below
    angle = ratio.arg() if ratio.real > 0 else (-ratio).arg() + arb.pi()
    turn = 2 * arb.pi()
    start, end = (-angle / turn).floor().unique_fmpz(), ((w * delay - angle) / turn).floor().unique_fmpz()
    return None if start is None or end is None else int(end - start)


# Inequalities over mass and frequency: magnitudes of a loop, and where their slack is not negative.


def squared(frequency_Hz: fmpq) -> Pair:
    """Bounds of w^2 for a frequency."""
    return ends((2 * arb.pi() * arb(frequency_Hz)) ** 2)


class Slack:
    """limit^2 |denominator|^2 - |numerator|^2 at jw; both polynomials are affine in the mass."""

    def __init__(self, limit: fmpq, denominator: Polynomials, numerator: Polynomials):
        (d0, d1), (n0, n1) = denominator, numerator
        square = limit * limit
        self.coefficients = tuple(
            square * inner(*below) - inner(*above)
            for below, above in (((d1, d1), (n1, n1)), ((2 * d0, d1), (2 * n0, n1)), ((d0, d0), (n0, n0)))
        )

    def at(self, mass: fmpq, square: fmpq) -> fmpq:
        """Its value at one mass and one w^2."""
        a, b, c = (polynomial(square) for polynomial in self.coefficients)
        return (a * mass + b) * mass + c

    def nonnegative(self, low: fmpq, high: fmpq, until: fmpq | None, start: fmpq = NONE) -> bool:
        """Whether it is nowhere negative for masses in [low, high] and start <= w^2 <= until (None: no end).

        Its least value over the mass lies at an end, or at the vertex: the signs of the curvature, of the slope at
        both ends, of the values there and of the discriminant decide. One point settles each interval between the
        roots of all these.
        """
        a, b, c = self.coefficients
        deciding = [a, 2 * a * low + b, 2 * a * high + b]
        deciding += [a * m**2 + b * m + c for m in (low, high)]
        deciding.append(b * b - 4 * a * c)
        if until is None:
            until = max([2 * start + 1, *(bound(q) for q in deciding if q.degree() > 0)])
        for x in pieces(deciding, start, until)[0]:
            masses, curvature = [low, high], a(x)
            if curvature > 0 and low < (vertex := -b(x) / (2 * curvature)) < high:
                masses.append(vertex)
            if any(self.at(mass, x) < 0 for mass in masses):
                return False
        return True
