"""No root on the imaginary axis for any member of a box: zero exclusion on the pieces of a tree, in ball arithmetic.

Stability of the whole box follows from

1. the member is stable: exact Routh test or, with a delay, a count of its unstable roots by the argument principle;
2. on every piece [w1, w2] x Q of the tree some line through the origin keeps p(jw, q) on one side. At w1 and w2 the
   value lies in the convex hull of control points (corners where p is affine in a parameter, the mapping theorem;
   Bernstein coefficients where it is not); in between it strays from the chord by at most max |p''| (w2 - w1)^2 / 8;
3. on every piece [w1, infinity) x Q the leading coefficient outweighs all others, so that no degree is lost either.

Then no root can cross the imaginary axis anywhere in the box. The tree is in prefix order, each cut followed by its
lower and its upper side, so that the pieces fill the box by construction. A variable is cut in the middle of its range,
or of its reciprocal's where it enters by that. All values are exact rationals or balls, with middles in floats where
there are many.
"""

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from itertools import product, zip_longest
from math import comb
from typing import Any, NamedTuple

import numpy as np
from flint import acb, arb, fmpq, fmpq_poly

from beamdesign.proofs.statement import Interval, Node, Statement, Term

PRECISION_BITS = 96
ARC_PARTS = 6
"""Tangents around the arc of exp(-jwT)."""


class Cell:
    """A sub-box: of each varying variable the share [start, end] of its range."""

    def __init__(self, statement: Statement, shares: Mapping[str, Interval]):
        self.statement, self.shares = statement, dict(shares)
        self.values = dict(statement.inner)
        for name, (start, end) in self.shares.items():
            low, high = statement.inner[name]
            self.values[name] = (low + (high - low) * start, low + (high - low) * end)
        self._grids: dict[tuple[str, int], list[dict[int, arb]]] = {}
        self._frames: dict[fmpq, Frame] = {}

    def half(self, name: str, upper: bool) -> "Cell":
        """The lower or the upper half in one variable."""
        start, end = self.shares[name]
        middle = (start + end) / 2
        return Cell(self.statement, self.shares | {name: (middle, end) if upper else (start, middle)})

    def grid(self, key: tuple[str, int], terms: Sequence[Term], degrees: Mapping[str, int]) -> list[dict[int, arb]]:
        """Control points of some terms: for each the coefficients by power of s."""
        if key not in self._grids:
            self._grids[key] = []
            for index in product(*(range(degree + 1) for degree in degrees.values())):
                corner = dict(zip(degrees, index, strict=True))
                total: dict[int, fmpq] = {}
                for c, degree, powers in terms:
                    for name, power in powers.items():
                        c = c * control_value(*self.values[name], abs(power), degrees.get(name, 0), corner.get(name, 0))
                    total[degree] = total.get(degree, fmpq(0)) + c
                self._grids[key].append({degree: arb(c) for degree, c in total.items()})
        return self._grids[key]

    def frame(self, w: fmpq) -> "Frame":
        """The hulls at one frequency; the last few are kept, since pieces share their ends."""
        if w not in self._frames:
            if len(self._frames) > 3:
                self._frames.pop(next(iter(self._frames)))
            self._frames[w] = Frame(self, w)
        return self._frames[w]


def control_value(low: Any, high: Any, power: int, degree: int, i: int) -> Any:
    """Bernstein coefficient i of x^power on [low, high] raised to a degree, of rationals or arrays; x^power for 0."""
    if degree == 0:
        return low**power
    terms = (comb(i, j) * comb(degree - i, power - j) * high**j * low ** (power - j) for j in range(power + 1))
    return sum(terms, 0 * low) / comb(degree, power)


@dataclass(frozen=True)
class Balls:
    """Complex numbers in floats, each no farther from its middle than its radius, which is rounded up.

    Arrays (C1, ..., CN, V): an axis for every pack that is enumerated, of length one where nothing depends on it, and V
    points. Sums and products of floats as bounded by S. M. Rump, BIT 39 (1999) 534; that of complex ones errs by less
    than 4 u |a b| (R. Brent, C. Percival, P. Zimmermann, Math. Comp. 76 (2007) 1469).
    """

    middle: np.ndarray
    radius: np.ndarray

    def __add__(self, other: "Balls") -> "Balls":
        """Of every point of either."""
        return self._joined(other, np.add, lambda a, b, r, t: r + t + _UNIT * (a + b))

    def __mul__(self, other: "Balls") -> "Balls":
        """Of every point of either."""
        return self._joined(other, np.multiply, lambda a, b, r, t: a * t + (b + t) * r + 4 * _UNIT * a * b)

    def _joined(self, other: "Balls", combined: np.ufunc, strayed: Callable[..., np.ndarray]) -> "Balls":
        sides = [part[..., :, None] for part in (self.middle, self.size, self.radius)]
        others = [part[..., None, :] for part in (other.middle, other.size, other.radius)]
        middle = combined(sides[0], others[0])
        radius = _UP * strayed(sides[1], others[1], sides[2], others[2]) + _LEAST
        return Balls(*(part.reshape(*part.shape[:-2], -1) for part in (middle, radius)))

    @cached_property
    def size(self) -> np.ndarray:
        """Upper bounds of the sizes of the middles."""
        return np.asarray(_UP * np.abs(self.middle))

    @cached_property
    def largest(self) -> arb:
        """Upper bound of the size of any."""
        return arb(float((_UP * (self.size + self.radius)).max()))

    def along(self, direction: tuple[int, int]) -> np.ndarray:
        """Lower bounds (C1, ..., CN) of the real part of the points times the conjugate of a direction."""
        x, y = direction
        strayed = (abs(x) + abs(y)) * (self.radius + 4 * _UNIT * self.size)
        return np.asarray((x * self.middle.real + y * self.middle.imag - _UP * strayed - _LEAST).min(axis=-1))


_UNIT, _UP, _LEAST = 2.0**-53, 1 + 2.0**-48, 1e-290
"""Relative error of one rounding, what outweighs a dozen of them, and what outweighs underflow."""


def balls(points: Sequence[acb], shape: Sequence[int] = (-1,)) -> Balls:
    """Points as they are."""
    middle = [complex(point) for point in points]
    radius = [float(abs(point - acb(at)).upper()) for point, at in zip(points, middle, strict=True)]
    return Balls(np.array(middle).reshape(shape), (_UP * np.array(radius) + _LEAST).reshape(shape))


class Frame:
    """Points whose convex hull holds each part of p at one exact frequency, over one cell."""

    def __init__(self, cell: Cell, w: fmpq):
        self.cell, self.w = cell, w
        self._powers = [arb(w**i) for i in range(max(*cell.statement.degree, 2) + 1)]
        self._known: dict[int, Balls] = {}
        self._enumerated = {
            name: self._along(one, k) for k, pack in enumerate(cell.statement.bound) for name, one in self._pack(pack)
        }

    def _value(self, coefficients: Mapping[int, arb]) -> acb:
        parts = [arb(0), arb(0)]
        for degree, c in coefficients.items():
            term = c * self._powers[degree]
            parts[degree % 2] += -term if degree % 4 >= 2 else term
        return acb(*parts)

    def _leaf(self, name: str) -> list[acb]:
        """An interval along either axis, and control points of what lies along neither."""
        points, ends = [acb(0)], ([arb(0), arb(0)], [arb(0), arb(0)])
        for i, (axis, degrees, terms) in enumerate(self.cell.statement.components[name]):
            values = [self._value(c) for c in self.cell.grid((name, i), terms, degrees)]
            if axis == 2 or len(values) == 1:
                points = [a + b for a in points for b in values]
                continue
            numbers = [v.imag if axis else v.real for v in values]
            ends[axis][0] += reduce(arb.min, numbers)
            ends[axis][1] += reduce(arb.max, numbers)
        for (low, high), turn in zip(ends, (acb(1), acb(0, 1)), strict=True):
            steps = [turn * low] if low == 0 and high == 0 else [turn * low, turn * high]
            points = [point + step for point in points for step in steps]
        return points

    def _pack(self, pack: Sequence[str]) -> Iterator[tuple[str, list[acb]]]:
        if len(pack) == 1:
            yield pack[0], self._leaf(pack[0])
            return
        statement = self.cell.statement
        degrees = statement.pack_degrees(pack)
        for name in pack:
            yield name, [self._value(c) for c in self.cell.grid((name, -1), statement.leaves[name], degrees)]

    def _along(self, points: Sequence[acb], axis: int | None = None) -> Balls:
        """Points along the axis of a pack, or of none."""
        shape = [1] * (len(self.cell.statement.bound) + 1)
        shape[-1 if axis is None else axis] = len(points)
        return balls(points, shape)

    def points(self, node: Node) -> Balls:
        """Points whose hull holds a part of p, for each choice of control points of the packs on which it depends."""
        if id(node) not in self._known:
            self._known[id(node)] = self._found(node)
        return self._known[id(node)]

    def _found(self, node: Node) -> Balls:
        if node.kind == "leaf":
            return self._enumerated[node.name] if node.packs else self._along(self._leaf(node.name))
        if node.kind == "delay":
            least, most = self.cell.values[node.name]
            return self._along(arc(arb(self.w * least), arb(self.w * (most - least))))
        if node.kind == "circle":
            low, high = self.cell.values[node.name]
            centre, radius = map(arb, self.cell.statement.circles[node.name])
            around = arc(_turn() * arb(low), _turn() * arb(high - low))
            return self._along([centre + radius * point for point in around])
        return reduce(operator.add if node.kind == "sum" else operator.mul, map(self.points, node.parts))

    def least(self, direction: tuple[int, int]) -> arb:
        """Lower bound of the real part of p times the conjugate of a direction, over the cell."""
        along = [self.points(node).along(direction) for node in self.cell.statement.summands]
        strayed = 2 * len(along) * _UNIT * reduce(operator.add, map(np.abs, along))
        return arb(float((reduce(operator.add, along) - _UP * strayed).min()))


def arc(start: arb, sweep: arb) -> list[acb]:
    """The ends of the arc exp(-j angle) over some angles, and the corners of tangents around it."""
    if sweep == 0:
        return [unit(start)]
    sweep = sweep if sweep < _turn() else _turn()
    shrink = (sweep / (2 * ARC_PARTS)).cos()
    corners = [unit(start + sweep * (2 * i + 1) / (2 * ARC_PARTS)) / shrink for i in range(ARC_PARTS)]
    return [unit(start), *corners, unit(start + sweep)]


def _turn() -> arb:
    return 2 * arb.pi()


def growth(frames: tuple[Frame, Frame], node: Node) -> tuple[arb, arb, arb]:
    """Bounds of |f|, |df/dw| and |d2f/dw2| of a part of p between two frequencies, over their cell."""
    cell = frames[0].cell
    statement = cell.statement
    if node.kind == "delay":
        most = arb(cell.values[node.name][1])
        return arb(1), most, most * most
    if node.kind == "circle":
        return arb(sum(statement.circles[node.name])), arb(0), arb(0)
    if node.kind == "product":
        size, slope, bend = arb(1), arb(0), arb(0)
        for part in node.parts:
            f, df, ddf = growth(frames, part)
            bend, slope, size = bend * f + 2 * slope * df + size * ddf, slope * f + size * df, size * f
        return size, slope, bend
    if node.kind == "leaf":
        slope, bend = _steepness(cell, statement.leaves[node.name], frames[1].w)
    else:
        parts = [growth(frames, part) for part in node.parts]
        slope, bend = sum((df for _, df, _ in parts), arb(0)), sum((ddf for _, _, ddf in parts), arb(0))
    return reduce(arb.max, (frame.points(node).largest for frame in frames)) + _stray(frames, bend), slope, bend


def _stray(frames: tuple[Frame, Frame], bend: arb) -> arb:
    """How far a curve strays from its chord at most."""
    return bend * ((frames[1].w - frames[0].w) ** 2 / 8)


def _steepness(cell: Cell, leaf: Sequence[Term], w: fmpq) -> tuple[arb, arb]:
    slope = bend = fmpq(0)
    for c, degree, powers in leaf:
        most = abs(c)
        for name, power in powers.items():
            most *= _most(cell.values[name]) ** abs(power)
        slope += most * degree * w ** max(degree - 1, 0)
        bend += most * degree * (degree - 1) * w ** max(degree - 2, 0)
    return arb(slope), arb(bend)


def separated(cell: Cell, w1: fmpq, w2: fmpq, direction: tuple[int, int]) -> bool:
    """Whether p(jw, q) stays on one side of the line across a direction, w1 <= w <= w2 and q in the cell."""
    frames = cell.frame(w1), cell.frame(w2)
    bend = sum((growth(frames, node)[2] for node in cell.statement.summands), arb(0))
    stray = arb(direction[0] ** 2 + direction[1] ** 2).sqrt() * _stray(frames, bend)
    return all(bool(frame.least(direction) > stray) for frame in frames)


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


def _most(interval: Interval) -> fmpq:
    return max(abs(interval[0]), abs(interval[1]))


def _times(a: Interval, b: Interval) -> Interval:
    ends = [x * y for x in a for y in b]
    return min(ends), max(ends)


def _sizes(ranges: Sequence[Interval]) -> fmpq_poly:
    """The largest sizes of coefficients."""
    return fmpq_poly([_most(interval) for interval in ranges])


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


def holds(piece: Piece) -> bool:
    """Whether p vanishes nowhere on a piece, by what the piece claims."""
    if piece.direction is None:
        return piece.w2 is None and dominated(piece.cell, piece.w1)
    if isinstance(piece.direction, str) or piece.w2 is None:
        return False
    return separated(piece.cell, piece.w1, piece.w2, piece.direction)


def unit(angle: arb) -> acb:
    """exp(-j angle)."""
    return acb(angle.cos(), -angle.sin())
