"""Upper bounds of integrals of absolute impulse responses, in ball arithmetic, over all masses of a range.

At one mass the response is a sum of exponentials, its poles and residues balls. Time is cut into cells. On one of width
h about t the response is g(t) + g'(t) u, u from -h/2 to h/2, to within u^2 / 2 times a bound of |g''|, and the integral
of a straight line's absolute value is known. Behind the last cell each exponential counts by itself.

From a mass M to others: with p(m) = p(M) + (m - M) p1 the response at m is that at M in a loop with (m - M) p1 / p(M),
whose own absolute integral k, times |m - M| below one, raises the bound by the factor 1 / (1 - |m - M| k).

Cells are as short as the fastest exponential asks for that has not died down, and the payloads fall into as many pieces
as the slowest decay asks for. A loop that rings fast and long asks for more than anybody would prove again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, frexp, sqrt

from flint import acb, acb_mat, acb_poly, arb, ctx, fmpq, fmpq_poly

from beamdesign.polynomial import Affine, bounds, nearest

_BITS = 128
_CELLS = 16
"""In a row, of one width."""
_CLOSE = 2e-3
"""Error of a cell over its width, per sum of the absolute exponentials; made less while it adds up to too much."""
_OFF = 5e-3
_TAIL = 2e-3
MOST_CELLS = 700_000
"""Of all responses of one proof together: so many that its checker can be sure to do with the work that it may do."""
_RAISED = 0.06
"""Most that going from one mass to its neighbours may raise a bound by."""
MOST_PIECES = 2000


@dataclass
class Cells:
    """Cells that are left for the responses of one proof.

    Attributes:
        left: how many.
    """

    left: int = MOST_CELLS

    def take(self, count: int) -> None:
        """Take some; errors as of `suffice_for`."""
        self.suffice_for(count)
        self.left -= count

    def suffice_for(self, count: int) -> None:
        """See to it that so many are left.

        Raises:
            ArithmeticError: where they are not.
        """
        if count > self.left:
            raise ArithmeticError(
                "the loop rings too fast and for too long to be summed up over these payloads; ask for a narrower range"
            )


def absolute_integrals(
    numerators: Sequence[fmpq_poly], denominator: fmpq_poly, cells: Cells | None = None
) -> list[fmpq]:
    """For each numerator an upper bound of the absolute integral of the impulse response of numerator / denominator.

    Args:
        numerators: of no higher degree than the denominator; what passes straight through counts with its size.
        denominator: with simple roots, all in the open left half plane.
        cells: that it may take; as many as of a whole proof where they are not given.

    Raises:
        ArithmeticError: where it has others, or the cells run out.
    """
    degree, cells = denominator.degree(), cells or Cells()
    with ctx.workprec(_BITS):
        straight = [numerator[degree] / denominator[degree] for numerator in numerators]
        rest = [one - share * denominator for one, share in zip(numerators, straight, strict=True)]
        poles, weights = _exponentials(rest, denominator)
        close = _CLOSE
        while True:
            totals, off = _summed(poles, weights, close, cells)
            if all(bool(more <= total * _OFF) for more, total in zip(off, totals, strict=True)):
                break
            close /= 4
        parts = zip(totals, off, straight, strict=True)
        return [bounds(total + more + abs(arb(share)))[1] for total, more, share in parts]


def _exponentials(numerators: Sequence[fmpq_poly], denominator: fmpq_poly) -> tuple[list[acb], list[list[acb]]]:
    """Poles, those below the axis left out, and the residues of each response there, doubled for what is left out."""
    slope = denominator.derivative()
    found: list[tuple[acb, int]] = denominator.numer().complex_roots()  # type: ignore[assignment]
    if any(count > 1 or not root.real < 0 for root, count in found):
        raise ArithmeticError("the loop is not stable, or has poles in the same place")
    poles = [root for root, _ in found if root.imag == 0 or root.imag > 0]
    below = [acb_poly(slope)(pole) / (1 if pole.imag == 0 else 2) for pole in poles]
    return poles, [[acb_poly(one)(p) / under for p, under in zip(poles, below, strict=True)] for one in numerators]


def _summed(
    poles: Sequence[acb], weights: Sequence[Sequence[acb]], close: float, cells: Cells
) -> tuple[list[arb], list[arb]]:
    """The absolute integrals of sums of exponentials, weights by response and pole, and how far they may be off."""
    count = len(poles)
    rows = acb_mat([[w * p**k for w, p in zip(row, poles, strict=True)] for row in weights for k in (0, 1)])
    sizes = [[abs(w) for w in row] for row in weights]
    bends = [[abs(w * p * p) for w, p in zip(row, poles, strict=True)] for row in weights]
    totals, off, time = [arb(0) for _ in weights], [arb(0) for _ in weights], fmpq(0)
    while True:
        left = [(pole.real * arb(time)).exp() for pole in poles]
        size = [_dot(row, left) for row in sizes]
        bend = [_dot(row, left) for row in bends]
        tail = [sum((s * d / -p.real for s, d, p in zip(row, left, poles, strict=True)), arb(0)) for row in sizes]
        if time > 0 and all(bool(one < total * _TAIL) or one == 0 for one, total in zip(tail, totals, strict=True)):
            return [total + one for total, one in zip(totals, tail, strict=True)], off
        cells.take(_CELLS * len(totals))
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


def over_masses(
    numerators: Sequence[fmpq_poly], closed: Affine, low: fmpq, high: fmpq, cells: Cells | None = None
) -> tuple[list[fmpq], int]:
    """For each numerator a bound of the absolute integral at every mass (kg) from `low` to `high`; equal pieces used.

    Args:
        numerators: free of the mass.
        closed: the characteristic polynomial over the mass, stable at every one of the range.
        low: kg.
        high: kg.
        cells: as of `absolute_integrals`.

    Raises:
        ArithmeticError: as `absolute_integrals`, or where too many pieces would be needed.
    """
    cells = cells or Cells()
    before = cells.left
    ends = [absolute_integrals([closed.slope], closed.at(mass), cells)[0] for mass in (low, (low + high) / 2, high)]
    pieces = max(1, ceil(nearest(max(ends) * (high - low) / 2) / _RAISED))
    cells.suffice_for(pieces * (len(numerators) + 1) * (before - cells.left) // len(ends))
    while pieces <= MOST_PIECES:
        reach = (high - low) / (2 * pieces)
        worst = [fmpq(0) for _ in numerators]
        for k in range(pieces):
            *own, share = absolute_integrals([*numerators, closed.slope], closed.at(low + (2 * k + 1) * reach), cells)
            left = 1 - reach * share
            if left < 1 - 2 * fmpq(*_RAISED.as_integer_ratio()):
                break  # the piece is too long
            worst = [max(before, one / left) for before, one in zip(worst, own, strict=True)]
        else:
            return worst, pieces
        pieces *= 2
    raise ArithmeticError("the response varies too much with the mass to be bounded")
