"""Quadratics in the mass, their coefficients polynomials in x = w^2, and proof that one is nowhere negative."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from math import inf, prod
from typing import NamedTuple

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.polynomial import Affine, bounds, inner, nearest, real_roots, shortened, simple_between

Coefficients = tuple[fmpq_poly, fmpq_poly, fmpq_poly]
"""Of m^2, m and 1, polynomials in x = w^2."""
_ZERO = fmpq(0)


def magnitude_slack(limit: fmpq, denominator: Affine, numerator: Affine) -> Coefficients:
    """limit^2 |denominator|^2 - |numerator|^2 at jw as a quadratic a m^2 + b m + c in the mass."""
    return less(limit * limit, over_mass(inner, denominator, denominator), over_mass(inner, numerator, numerator))


def over_mass(form: Callable[[fmpq_poly, fmpq_poly], fmpq_poly], left: Affine, right: Affine) -> Coefficients:
    """What is linear in each of two polynomials, as a quadratic a m^2 + b m + c in the mass over which these are."""
    mixed = form(left.constant, right.slope) + form(left.slope, right.constant)
    return form(left.slope, right.slope), mixed, form(left.constant, right.constant)


def less(factor: fmpq_poly | fmpq, one: Coefficients, other: Coefficients) -> Coefficients:
    """A factor times one quadratic in the mass, less another."""
    a, b, c = (factor * first - second for first, second in zip(one, other, strict=True))
    return a, b, c


# Proof that one is nowhere negative.


class Negative(NamedTuple):
    """A mass and an x at which a quadratic is negative, and an x up to which it is proved not to be."""

    mass: fmpq
    x: fmpq
    proved_to: fmpq


def first_negative(
    quadratic: Coefficients, low: fmpq, high: fmpq, x_low: fmpq = _ZERO, x_high: fmpq | None = None
) -> Negative | None:
    """Decide whether a m^2 + b m + c >= 0 for all masses m in [low, high] and all x in [x_low, x_high]: None if it is.

    The real roots in x of the quadratic's values at both masses and of its discriminant cut the interval into open
    cells. Inside one, both values keep their signs. Where both are positive, the real roots in m are none, or two
    that stay both inside or both outside [low, high], since none can pass an end of the range; a root that comes
    from infinity would have to pass one. So one rational point settles each cell, and the ends follow by continuity.

    Args:
        quadratic: a, b and c, polynomials in x.
        low: least mass.
        high: largest mass.
        x_low: least squared frequency, (rad/s)^2.
        x_high: largest one, None for infinity.
    """
    a, b, c = quadratic
    for settled, sample in _cells(_dividers(a, b, c, low, high), x_low, x_high):
        if (mass := _negative_at(a(sample), b(sample), c(sample), low, high)) is not None:
            return Negative(mass, sample, settled)
    return None


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
    dividers = [_without(divider, x_low, x_high) for divider in dividers]
    precision = 32  # mostly enough, and arb takes a third of the time it needs for 64
    while (roots := _inner_roots(dividers, x_low, x_high, precision)) is None:
        precision *= 2
        if precision == 256:  # common roots of two dividers would never be told apart
            whole = prod(dividers, start=fmpq_poly([1]))
            dividers = [whole / whole.gcd(whole.derivative())]
    edges = [(x_low, x_low), *roots]
    for i, (below, start) in enumerate(edges):
        end = edges[i + 1][0] if i + 1 < len(edges) else x_high
        yield below, simple_between(start, 2 * start + 2 if end is None else end)


def _without(divider: fmpq_poly, *ends: fmpq | None) -> fmpq_poly:
    """Without the roots at the ends of an interval, so that all others are told to be inside or outside."""
    for end in ends:
        while end is not None and divider(end) == 0:
            divider = divider / fmpq_poly([-end, 1])
    return divider


def _inner_roots(
    dividers: Sequence[fmpq_poly], x_low: fmpq, x_high: fmpq | None, precision: int
) -> list[tuple[fmpq, fmpq]] | None:
    """Bounds of all roots inside the interval, ascending and apart; None where the precision is too low."""
    with ctx.workprec(precision):
        found = sorted(bounds(root) for divider in dividers for root, _ in real_roots(divider, precision))
    found = [one for one in found if one[1] >= x_low and (x_high is None or one[0] <= x_high)]
    edges = [(x_low, x_low), *found, *([] if x_high is None else [(x_high, x_high)])]
    return found if all(before[1] < after[0] for before, after in pairwise(edges)) else None


def kept_up_to_Hz(slack: Coefficients, low: fmpq, high: fmpq) -> float:
    """Up to which frequency a quadratic in the mass is proved not to be negative, rounded down; infinite for all.

    It comes from the cell in which it first is; everything up to there is proved by the same cells.
    """
    if (negative := first_negative(slack, low, high)) is None:
        return inf
    # A little less, so that its square is not beyond that either where rounding eats nothing.
    return nearest(shortened(frequency_of(negative.proved_to)[0] * (1 - fmpq(1, 10**30)), 7))


def squared_frequency(frequency_Hz: fmpq) -> tuple[fmpq, fmpq]:
    """Rationals at or just below, and at or just above, (2 pi f)^2, (rad/s)^2."""
    with ctx.workprec(128):
        return bounds((2 * arb.pi() * arb(frequency_Hz)) ** 2)


def frequency_of(squared_frequency: fmpq) -> tuple[fmpq, fmpq]:
    """Rationals at or just below, and at or just above, sqrt(x) / (2 pi), Hz; zero for what is not positive."""
    with ctx.workprec(128):
        return bounds(arb(max(squared_frequency, _ZERO)).sqrt() / (2 * arb.pi()))
