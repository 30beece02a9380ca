"""Upper bounds of integrals of absolute impulse responses, in ball arithmetic, over all masses of a range.

What enters a stable linear loop as an error e with |e| <= E moves its output by no more than E times the integral of
the absolute impulse response from there to the output, at any time and however e varies (M. A. Dahleh and I. J.
Diaz-Bobillo, Control of Uncertain Systems, 1995, section 2.2).

At one mass the response is a sum of exponentials, its poles and residues balls. Time is cut into cells. On one of width
h about t the response is g(t) + g'(t) u, u from -h/2 to h/2, to within u^2 / 2 times a bound of |g''|, and the integral
of a straight line's absolute value is known. Behind the last cell each exponential counts by itself.

From a mass M to others: with p(m) = p(M) + (m - M) p1 the response at m is that at M in a loop with (m - M) p1 / p(M),
whose own absolute integral k, times |m - M| below one, raises the bound by the factor 1 / (1 - |m - M| k).
"""

from collections.abc import Sequence
from math import ceil, frexp, sqrt

from flint import acb, acb_mat, acb_poly, arb, ctx, fmpq, fmpq_poly

from beamdesign.polynomial import Affine
from beamdesign.rational import bounds, nearest

_BITS = 128
_CELLS = 16
"""In a row, of one width."""
_CLOSE = 2e-3
"""Error of a cell over its width, per sum of the absolute exponentials; made less while it adds up to too much."""
_OFF = 5e-3
_TAIL = 2e-3
_MOST_ROWS = 20_000
_RAISED = 0.06
"""Most that going from one mass to its neighbours may raise a bound by."""
MOST_PIECES = 2000


def absolute_integrals(numerators: Sequence[fmpq_poly], denominator: fmpq_poly) -> list[fmpq]:
    """For each numerator an upper bound of the absolute integral of the impulse response of numerator / denominator.

    Args:
        numerators: of no higher degree than the denominator; what passes straight through counts with its size.
        denominator: with simple roots, all in the open left half plane.

    Raises:
        ArithmeticError: where it has others, or the cells run out.
    """
    degree = denominator.degree()
    with ctx.workprec(_BITS):
        straight = [numerator[degree] / denominator[degree] for numerator in numerators]
        rest = [one - share * denominator for one, share in zip(numerators, straight, strict=True)]
        poles, weights = _exponentials(rest, denominator)
        close = _CLOSE
        while True:
            totals, off = _summed(poles, weights, close)
            if all(bool(more <= total * _OFF) for more, total in zip(off, totals, strict=True)):
                break
            close /= 4
        parts = zip(totals, off, straight, strict=True)
        return [bounds(total + more + abs(arb(share)))[1] for total, more, share in parts]


def _exponentials(numerators: Sequence[fmpq_poly], denominator: fmpq_poly) -> tuple[list[acb], list[list[acb]]]:
    """Poles, those below the axis left out, and the residues of each response there, doubled for what is left out."""
    slope, poles = denominator.derivative(), []
    found: list[tuple[acb, int]] = denominator.numer().complex_roots()  # type: ignore[assignment]
    for root, count in found:
        if count > 1 or not root.real < 0:
            raise ArithmeticError("the loop is not stable, or has poles in the same place")
        if root.imag == 0 or root.imag > 0:
            poles.append(root)
    twice = [1 if pole.imag == 0 else 2 for pole in poles]
    below = [acb_poly(slope)(pole) for pole in poles]
    weights = [
        [acb_poly(one)(pole) * factor / under for pole, factor, under in zip(poles, twice, below, strict=True)]
        for one in numerators
    ]
    return poles, weights


def _summed(poles: Sequence[acb], weights: Sequence[Sequence[acb]], close: float) -> tuple[list[arb], list[arb]]:
    """The absolute integrals of sums of exponentials, weights by response and pole, and how far they may be off."""
    count = len(poles)
    rows = acb_mat([[w * p**k for w, p in zip(row, poles, strict=True)] for row in weights for k in (0, 1)])
    sizes = [[abs(w) for w in row] for row in weights]
    bends = [[abs(w * p * p) for w, p in zip(row, poles, strict=True)] for row in weights]
    totals, off, time = [arb(0) for _ in weights], [arb(0) for _ in weights], fmpq(0)
    for _ in range(_MOST_ROWS):
        left = [(pole.real * arb(time)).exp() for pole in poles]
        size = [_dot(row, left) for row in sizes]
        bend = [_dot(row, left) for row in bends]
        tail = [sum((s * d / -p.real for s, d, p in zip(row, left, poles, strict=True)), arb(0)) for row in sizes]
        if time > 0 and all(bool(one < total * _TAIL) or one == 0 for one, total in zip(tail, totals, strict=True)):
            return [total + one for total, one in zip(totals, tail, strict=True)], off
        ratio = max((float(b.mid() / s.mid()) for b, s in zip(bend, size, strict=True) if s > 0), default=1.0)
        width = _short(sqrt(24 * close / ratio))
        step = [(pole * arb(width)).exp() for pole in poles]
        now = [(pole * arb(time + width / 2)).exp() for pole in poles]
        for _ in range(_CELLS):
            values = rows * acb_mat(count, 1, now)
            for k in range(len(totals)):
                totals[k] += _line(values[2 * k, 0].real, values[2 * k + 1, 0].real, width)
            now = [one * by for one, by in zip(now, step, strict=True)]
        off = [total + one * arb(_CELLS * width**3 / 24) for total, one in zip(off, bend, strict=True)]
        time += width * _CELLS
    raise ArithmeticError("the response lasts too long to be summed up")


def _dot(one: Sequence[arb], other: Sequence[arb]) -> arb:
    return sum((a * b for a, b in zip(one, other, strict=True)), arb(0))


def _short(value: float) -> fmpq:
    """A power of two at or below a positive number."""
    return fmpq(2) ** (frexp(value)[1] - 1)


def _line(value: arb, slope: arb, width: fmpq) -> arb:
    """Upper bound of the integral of |value + slope u| over u from -width/2 to width/2."""
    size, half = abs(value).upper(), abs(slope).upper() * arb(width / 2)
    if size >= half:
        return size * arb(width)
    # two triangles, of heights half + size and half - size; it grows with the size and with the half
    return (size * size / half + half) * arb(width / 2)


def over_masses(numerators: Sequence[fmpq_poly], closed: Affine, low: fmpq, high: fmpq) -> tuple[list[fmpq], int]:
    """For each numerator a bound of the absolute integral at every mass (kg) from `low` to `high`; equal pieces used.

    Args:
        numerators: free of the mass.
        closed: the characteristic polynomial over the mass, stable at every one of the range.
        low: kg.
        high: kg.

    Raises:
        ArithmeticError: as `absolute_integrals`, or where too many pieces would be needed.
    """
    ends = [absolute_integrals([closed.slope], closed.at(mass))[0] for mass in (low, (low + high) / 2, high)]
    half = (high - low) / 2
    pieces = max(1, ceil(nearest(max(ends) * half) / _RAISED))
    while pieces <= MOST_PIECES:
        found = _with_pieces(numerators, closed, low, high, pieces)
        if found is not None:
            return found, pieces
        pieces *= 2
    raise ArithmeticError("the response varies too much with the mass to be bounded")


def _with_pieces(
    numerators: Sequence[fmpq_poly], closed: Affine, low: fmpq, high: fmpq, pieces: int
) -> list[fmpq] | None:
    """The bounds over equal pieces of the range; None where a piece is too long."""
    reach = (high - low) / (2 * pieces)
    worst = [fmpq(0) for _ in numerators]
    for k in range(pieces):
        *own, share = absolute_integrals([*numerators, closed.slope], closed.at(low + (2 * k + 1) * reach))
        left = 1 - reach * share
        if left < 1 - 2 * fmpq(*_RAISED.as_integer_ratio()):
            return None
        worst = [max(before, one / left) for before, one in zip(worst, own, strict=True)]
    return worst
