"""Proof that a quadratic in the mass, its coefficients polynomials in x = w^2, is nowhere negative on a rectangle."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.polynomial import bounds, real_roots, shortened, simple_between


@dataclass(frozen=True)
class Verdict:
    """Outcome of `quadratic_nonnegative`.

    Attributes:
        holds: whether the inequality is proved for the whole rectangle.
        holds_to: where it does not hold, an x up to which it is proved all the same.
        witness: where it does not hold, a mass and an x at which the quadratic is negative.
    """

    holds: bool
    holds_to: fmpq | None = None
    witness: tuple[fmpq, fmpq] | None = None


def quadratic_nonnegative(
    a: fmpq_poly, b: fmpq_poly, c: fmpq_poly, low: fmpq, high: fmpq, x_low: fmpq, x_high: fmpq | None
) -> Verdict:
    """Decide whether a m^2 + b m + c >= 0 for all masses m in [low, high] and all x in [x_low, x_high].

    The real roots in x of the quadratic's values at both masses and of its discriminant cut the interval into open
    cells. Inside one, both values keep their signs. Where both are positive, the real roots in m are none, or two
    that stay both inside or both outside [low, high], since none can pass an end of the range; a root that comes
    from infinity would have to pass one. So one rational point settles each cell, and the ends follow by continuity.

    Args:
        a: coefficient of m^2, a polynomial in x.
        b: coefficient of m.
        c: constant coefficient.
        low: least mass.
        high: largest mass.
        x_low: least squared frequency, (rad/s)^2.
        x_high: largest one, None for infinity.
    """
    dividers = _dividers(a, b, c, low, high)
    for settled, sample in _cells(dividers, x_low, x_high):
        mass = _negative_at(a(sample), b(sample), c(sample), low, high)
        if mass is not None:
            return Verdict(False, settled, (mass, sample))
    return Verdict(True)


def _dividers(a: fmpq_poly, b: fmpq_poly, c: fmpq_poly, low: fmpq, high: fmpq) -> list[fmpq_poly]:
    at_low, at_high = a * low**2 + b * low + c, a * high**2 + b * high + c
    if low == high:
        dividers = [at_low]
    else:
        dividers = [at_low, at_high, b * b - 4 * a * c]
        if at_low.is_zero() or at_high.is_zero():
            # A root in m sits on an end of the range: the sign of the curvature and of both slopes decide then.
            dividers += [a, 2 * a * low + b, 2 * a * high + b]
    return [divider for divider in dividers if divider.degree() > 0]


def _negative_at(a: fmpq, b: fmpq, c: fmpq, low: fmpq, high: fmpq) -> fmpq | None:
    """A mass in the range at which the quadratic is negative: an end or the vertex; None where there is none."""

    def value(mass: fmpq) -> fmpq:
        return (a * mass + b) * mass + c

    candidates = [low, high]
    if a > 0 and low < (vertex := -b / (2 * a)) < high:
        candidates.append(vertex)
    mass = min(candidates, key=value)
    if not value(mass) < 0:
        return None
    for digits in (3, 6, 12):  # a mass that can be read is as good a witness, if it refutes as well
        if mass > 0 and low < (short := shortened(mass, digits)) < high and value(short) < 0:
            return short
    return mass


def _cells(dividers: Sequence[fmpq_poly], x_low: fmpq, x_high: fmpq | None) -> Iterator[tuple[fmpq, fmpq]]:
    """For each open cell between the dividers' roots, ascending: a rational just below its start, and one inside it."""
    if x_low == x_high:
        yield x_low, x_low
        return
    precision = 32  # mostly enough, and arb takes a third of the time it needs for 64
    while (roots := _inner_roots(dividers, x_low, x_high, precision)) is None:
        precision *= 2
        if precision == 256:  # common roots of two dividers would never be told apart
            dividers = _coprime(dividers)
    edges = [(x_low, x_low), *roots]
    for i, (below, start) in enumerate(edges):
        end = edges[i + 1][0] if i + 1 < len(edges) else x_high
        yield below, simple_between(start, 2 * start + 2 if end is None else end)


def _inner_roots(
    dividers: Sequence[fmpq_poly], x_low: fmpq, x_high: fmpq | None, precision: int
) -> list[tuple[fmpq, fmpq]] | None:
    """Bounds of all roots strictly inside the interval, ascending and apart; None where the precision is too low."""
    found = []
    with ctx.workprec(precision):
        for divider in dividers:
            for root, _ in real_roots(divider, precision):
                place = _inside(divider, root, x_low, x_high)
                if place is None:
                    return None
                if place:
                    found.append(bounds(root))
    found.sort()
    apart = all(before[1] < after[0] for before, after in pairwise(found))
    return found if apart else None


def _inside(divider: fmpq_poly, root: arb, x_low: fmpq, x_high: fmpq | None) -> bool | None:
    """Whether a root lies strictly inside the interval; None where its enclosure does not tell."""
    least, most = bounds(root)
    if most < x_low or (x_high is not None and least > x_high):
        return False
    for end in (x_low, x_high):
        if end is not None and least <= end <= most:
            # One root per enclosure: if the end is a root at all, it is this one.
            return False if divider(end) == 0 else None
    return True


def _coprime(polynomials: Sequence[fmpq_poly]) -> list[fmpq_poly]:
    """Square-free polynomials without common roots that together have the same roots."""
    basis: list[fmpq_poly] = []
    for polynomial in polynomials:
        rest = polynomial / polynomial.gcd(polynomial.derivative())
        for other in basis:
            rest = rest / rest.gcd(other)
        if rest.degree() > 0:
            basis.append(rest)
    return basis
