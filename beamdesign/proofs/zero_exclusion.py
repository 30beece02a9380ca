"""No root on the imaginary axis for any member of a box: zero exclusion on the pieces of a tree, in ball arithmetic.

Stability of the whole box follows from

1. the member is stable: exact Routh test or, with a delay, a count of its unstable roots by the argument principle;
2. on every piece [w1, w2] x Q of the tree some line through the origin keeps p(jw, q) on one side. At w1 and w2 the
   value lies in the convex hull of control points (corners where p is affine in a parameter, the mapping theorem;
   Bernstein coefficients where it is not); in between it strays from the chord by at most max |p''| (w2 - w1)^2 / 8;
3. on every piece [w1, infinity) x Q the leading coefficient outweighs all others, so that no degree is lost either.

Then no root can cross the imaginary axis anywhere in the box. In 2 p may be divided by lags that are factors of one of
its summands, where each keeps clear of zero: whose phase is uncertain, such a lag turns all of that summand, and near a
resonance, where its parts are large and cancel, by more than is left of them. Over the quotient the lags turn the
others alone, which are small there. Their inverses lie in the hull of points too (`Balls.inverted`).

The tree is in prefix order, each cut followed by its lower and its upper side, so that the pieces fill the box by
construction. A variable is cut in the middle of its range, or of its reciprocal's where it enters by that. All values
are exact rationals, or floats with a bound of their error (`beamdesign.proofs.frames`).
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product, zip_longest
from typing import NamedTuple

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.polynomial import nearest
from beamdesign.proofs.balls import UP
from beamdesign.proofs.frames import Between, Cell, Frames
from beamdesign.proofs.statement import Interval, Node, Statement

PRECISION_BITS = 96
_AT_ONCE, _AT_FIRST = 50_000, 8
"""How many control points to go through at once, and how many pieces before it is known how many a frame has."""

Claimed = tuple[Cell, fmpq, fmpq, tuple[int, int]]
"""A cell, two frequencies and the direction across a line."""


def separated(given: Sequence[Claimed]) -> list[bool]:
    """Whether p(jw, q) stays on one side of a line, w1 <= w <= w2 and q in the cell, for claims of one statement."""
    found: list[bool] = []
    many = _AT_FIRST
    while len(found) < len(given):
        apart, width = _separated(given[len(found) : len(found) + many])
        found += apart
        many = max(1, _AT_ONCE // width)
    return found


def _separated(given: Sequence[Claimed]) -> tuple[list[bool], int]:
    """The same of a few, and how many control points a frame has."""
    numbers: dict[tuple[Cell, fmpq], int] = {}
    first = np.array([numbers.setdefault((cell, w1), len(numbers)) for cell, w1, _, _ in given])
    last = np.array([numbers.setdefault((cell, w2), len(numbers)) for cell, _, w2, _ in given])
    sag = np.array([UP * nearest((w2 - w1) ** 2 / 8) for _, w1, w2, _ in given])
    directions = np.array([claim[3] for claim in given], dtype=float).T
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is not found to be apart
        frames = Frames(given[0][0].statement, [*numbers])
        stray = UP * np.hypot(*directions) * frames.bend(Between(first, last, sag)) * sag
        apart = [frames.least(which, directions) > stray for which in (first, last)]
    return (apart[0] & apart[1]).tolist(), frames.width


def dominated(cell: Cell, w: fmpq) -> bool:
    """Whether the leading term outweighs all others from a frequency up, so that p vanishes nowhere there."""
    n, _ = cell.statement.degree
    if not w > 0:
        return False
    plain, late = coefficients(cell)
    low, high = plain[n]
    others = _sizes(plain[:n]) + late
    return bool(others(w) < max(low, -high) * w**n)


_Ranges = tuple[list[Interval], fmpq_poly]


def coefficients(cell: Cell) -> _Ranges:
    """Ranges of the coefficients of p without delay and unknowns, and largest sizes of those that these multiply."""

    def one(node: Node) -> _Ranges:
        if node.kind != "leaf":
            return [], fmpq_poly([sum(cell.statement.circles.get(node.name, (1,)), fmpq(0))])
        leaf = cell.statement.leaves[node.name]
        found = [(fmpq(0), fmpq(0))] * (max((term.degree for term in leaf), default=0) + 1)
        for c, degree, powers in leaf:
            value = (c, c)
            for name, power in powers.items():
                for _ in range(abs(power)):
                    value = _times(value, cell.values[name])
            found[degree] = (found[degree][0] + value[0], found[degree][1] + value[1])
        return found, fmpq_poly([])

    def add(a: _Ranges, b: _Ranges) -> _Ranges:
        ends = zip_longest(a[0], b[0], fillvalue=(fmpq(0), fmpq(0)))
        return [(x[0] + y[0], x[1] + y[1]) for x, y in ends], a[1] + b[1]

    def multiply(a: _Ranges, b: _Ranges) -> _Ranges:
        total = [(fmpq(0), fmpq(0))] * (len(a[0]) + len(b[0]) - 1 if a[0] and b[0] else 0)
        for (i, x), (j, y) in product(enumerate(a[0]), enumerate(b[0])):
            low, high = _times(x, y)
            total[i + j] = (total[i + j][0] + low, total[i + j][1] + high)
        return total, _sizes(a[0]) * b[1] + a[1] * _sizes(b[0]) + a[1] * b[1]

    return cell.statement.body.fold(one, add, multiply)


def _times(a: Interval, b: Interval) -> Interval:
    ends = [x * y for x in a for y in b]
    return min(ends), max(ends)


def _sizes(ranges: Sequence[Interval]) -> fmpq_poly:
    """The largest sizes of coefficients."""
    return fmpq_poly([max(map(abs, interval)) for interval in ranges])


class Piece(NamedTuple):
    """One leaf of the tree: a cell and the frequencies from w1 to w2 (None: all above w1).

    `direction` is that of the separating line, None where the leading term is to outweigh the others, or "?" where
    nothing is claimed.
    """

    cell: Cell
    w1: fmpq
    w2: fmpq | None
    direction: tuple[int, int] | str | None


def pieces(statement: Statement, tree: Sequence[str]) -> Iterator[Piece]:
    """Walk a tree of the marks NAME (cut in a variable), w=VALUE, X,Y (a line), "inf" and "?" of a search."""
    whole = {name: (fmpq(0), fmpq(1)) for name in statement.varying}
    open_pieces: list[tuple[Cell, fmpq, fmpq | None]] = [(Cell(statement, whole), statement.since, statement.until)]
    for mark in tree:
        cell, w1, w2 = open_pieces.pop()
        if mark in cell.shares:
            open_pieces += [(cell.half(mark, True), w1, w2), (cell.half(mark, False), w1, w2)]
        elif mark.startswith("w="):
            w = fmpq(*Fraction(mark[2:]).as_integer_ratio())
            open_pieces += [(cell, w, w2), (cell, w1, w)]
        elif mark == "?":
            yield Piece(cell, w1, w2, "?")
        elif mark == "inf":
            yield Piece(cell, w1, w2, None)
        else:
            x, y = map(int, mark.split(","))
            yield Piece(cell, w1, w2, (x, y))


def held(every: Sequence[Piece]) -> list[bool]:
    """Whether p vanishes nowhere on each of some pieces of one statement, by what the piece claims."""
    lines = {
        k: (piece.cell, piece.w1, piece.w2, piece.direction)
        for k, piece in enumerate(every)
        if piece.w2 is not None and isinstance(piece.direction, tuple)
    }
    apart = dict(zip(lines, separated([*lines.values()]), strict=True))
    return [
        apart.get(k, False) if piece.direction is not None else piece.w2 is None and dominated(piece.cell, piece.w1)
        for k, piece in enumerate(every)
    ]
