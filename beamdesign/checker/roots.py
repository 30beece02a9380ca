"""Real roots of polynomials, isolated by Descartes' rule of signs and bisection (Vincent, Collins and Akritas)."""

from collections.abc import Sequence
from itertools import pairwise

from flint import arb, fmpq, fmpq_poly, fmpz, fmpz_poly

S = fmpq_poly([0, 1])
ONE, ZERO = fmpq_poly([1]), fmpq_poly([0])
Pair = tuple[fmpq, fmpq]
"""Ends of a closed interval."""
Polynomials = tuple[fmpq_poly, fmpq_poly]
"""Constant and slope in the mass, or even and odd part."""


def _sign_changes(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> int:
    """An upper bound on the number of roots in the open interval, which is exact where it is 0 or 1."""
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
    return polynomial / polynomial.gcd(polynomial.derivative())


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

    def dyadic(point: arb) -> fmpq:
        mantissa, exponent = point.man_exp()
        return fmpq(mantissa) * fmpq(2) ** int(exponent)

    return dyadic(ball.mid()) - dyadic(ball.rad()), dyadic(ball.mid()) + dyadic(ball.rad())


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
