"""Points whose convex hull holds p(jw, q) over a cell of the box, and how far p strays between two frequencies.

Coefficients are exact rationals over their cell. From there on all is in floats that carry a bound of their error, for
many frames and pieces of a tree at once: arrays have the frames (F, ...) or the pieces (P, ...) on their first axis.
The search before the proof puts hulls together alike, in floats alone (`beamdesign.proofs.value_set`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial, reduce
from itertools import product
from math import comb
from operator import add, mul
from typing import Any, NamedTuple

import numpy as np
from flint import arb, fmpq

from beamdesign.polynomial import nearest
from beamdesign.proofs.balls import LEAST, UNIT, UP, Balls, arc, balls, turn, unit
from beamdesign.proofs.statement import Interval, Node, Statement, Term

_TINY = 1e-300
"""What outweighs underflow in a power of w."""


class Cell:
    """A sub-box: of each varying variable the share [start, end] of its range."""

    def __init__(self, statement: Statement, shares: Mapping[str, Interval], half_of: "tuple[Cell, str] | None" = None):
        self.statement, self.shares, self._half_of = statement, dict(shares), half_of
        self.values = dict(statement.inner)
        for name, (start, end) in self.shares.items():
            low, high = statement.inner[name]
            self.values[name] = (low + (high - low) * start, low + (high - low) * end)
        self._known: dict[tuple[str, Any], np.ndarray] = {}

    def half(self, name: str, upper: bool) -> "Cell":
        """The lower or the upper half in one variable."""
        start, end = self.shares[name]
        middle = (start + end) / 2
        shares = self.shares | {name: (middle, end) if upper else (start, middle)}
        return Cell(self.statement, shares, (self, name))

    def known(self, key: tuple[str, Any], names: Collection[str], make: Callable[[], np.ndarray]) -> np.ndarray:
        """What depends on the ranges of some variables alone, made once for all cells that have these in common."""
        cell = self
        while cell._half_of is not None and cell._half_of[1] not in names:
            cell = cell._half_of[0]
        if key not in cell._known:
            cell._known[key] = make()
        return cell._known[key]

    def grid(self, key: tuple[str, int], terms: Sequence[Term], degrees: Mapping[str, int]) -> np.ndarray:
        """Control points of some terms (N, n + 1): of each the coefficients by power of s, rounded to the nearest."""

        def at(corner: Mapping[str, int], name: str, power: int) -> fmpq:
            return control_value(*self.values[name], abs(power), degrees.get(name, 0), corner.get(name, 0))

        def made() -> np.ndarray:
            indices = product(*(range(degree + 1) for degree in degrees.values()))
            corners = (partial(at, dict(zip(degrees, index, strict=True))) for index in indices)
            return np.array([_by_degree((term.degree, term.times(corner)) for term in terms) for corner in corners])

        return self.known(key, degrees, made)

    def sizes(self, name: str) -> np.ndarray:
        """Bounds of the sizes of a leaf's coefficients by power of s (n + 1,)."""
        leaf = self.statement.leaves[name]

        def most(variable: str, power: int) -> fmpq:
            return max(map(abs, self.values[variable])) ** abs(power)

        def made() -> np.ndarray:
            return UP * _by_degree((term.degree, abs(term.times(most))) for term in leaf)

        return self.known((name, "sizes"), {one for term in leaf for one in term.powers}, made)


def _by_degree(terms: Iterable[tuple[int, fmpq]]) -> np.ndarray:
    """Sums by degree (n + 1,), rounded to the nearest."""
    total: dict[int, fmpq] = {}
    for degree, c in terms:
        total[degree] = total.get(degree, fmpq(0)) + c
    return np.array([nearest(total.get(degree, fmpq(0))) for degree in range(max(total, default=0) + 1)])


def control_value(low: Any, high: Any, power: int, degree: int, i: int) -> Any:
    """Bernstein coefficient i of x^power on [low, high] raised to a degree, of rationals or arrays; x^power for 0."""
    if degree == 0:
        return low**power
    terms = (comb(i, j) * comb(degree - i, power - j) * high**j * low ** (power - j) for j in range(power + 1))
    return sum(terms, 0 * low) / comb(degree, power)


class Between(NamedTuple):
    """Pieces, each of one cell between two frequencies: the numbers (P,) of their frames.

    `sag` (P,) is an eighth of the squared step, rounded up: times a second derivative it is how far a curve strays from
    its chord.
    """

    first: np.ndarray | slice
    last: np.ndarray | slice
    sag: np.ndarray


class Hulls(ABC):
    """Points whose convex hull holds each part of p, each frame over a cell at one frequency.

    Attributes:
        statement: what p is.
        count: of frames.
        up: what outweighs the roundings of a bound.
    """

    up = 1.0

    def __init__(self, statement: Statement, count: int):
        self.statement, self.count = statement, count
        self._known: dict[int, Balls] = {}
        self._divisors: dict[str, Balls] = {}
        packs = [(k, self._pack(pack)) for k, pack in enumerate(statement.bound)]
        self._enumerated: dict[str, Balls] = {name: self._along(one, k) for k, pack in packs for name, one in pack}

    def points(self, node: Node) -> Balls:
        """Points whose hull holds a part of p, for each choice of control points of the packs on which it depends."""
        if id(node) not in self._known:
            self._known[id(node)] = self._found(node)
        return self._known[id(node)]

    def largest(self, node: Node) -> np.ndarray:
        """Upper bounds (F,) of the size of a part of p."""
        return np.asarray(self.points(node).largest.reshape(self.count, -1).max(axis=1))

    def bend(self, between: Between) -> np.ndarray:
        """Bounds (P,) of the second derivative of p in w on pieces, over their cells."""
        with np.errstate(over="ignore", invalid="ignore"):  # of what comes near zero where p is divided by it
            return np.asarray(reduce(add, (self.growth(between, node)[2] for node in self.statement.summands)))

    def growth(self, between: Between, node: Node) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bounds (P,) of |f|, |df/dw| and |d2f/dw2| of a part of p on pieces, over their cells."""
        (first, last, sag), up = between, self.up
        if node.kind == "delay":
            most = self._latest(node.name, last)
            return 0 * sag + 1, most, up * most * most
        if node.kind == "circle":
            return 0 * sag + up * nearest(sum(self.statement.circles[node.name], fmpq(0))), 0 * sag, 0 * sag
        if node.kind == "inverse":
            slope, bend = self._steepness(node.name, last)
            square = self._own(node.name).with_those(first, last).turned.least.min(axis=(1, 2))
            # The mean of points is at least the root of the least Re(a conj(b)) from zero.
            apart = np.sqrt(np.maximum(square, 0.0)) / up - up * bend * sag
            most = np.where(apart > 0, up / np.maximum(apart, _TINY), np.inf)
            return most, up * slope * most**2, up * (bend * most**2 + 2 * slope**2 * most**3)
        if node.kind == "product":
            size, slope, bend = self.growth(between, node.parts[0])
            for part in node.parts[1:]:
                f, df, ddf = self.growth(between, part)
                bend = up * (bend * f + 2 * slope * df + size * ddf)
                slope, size = up * (slope * f + size * df), up * (size * f)
            return size, slope, bend
        if node.kind == "leaf":
            slope, bend = self._steepness(node.name, last)
        else:
            _, slopes, bends = zip(*(self.growth(between, part) for part in node.parts), strict=True)
            slope, bend = (reduce(lambda a, b: up * (a + b), parts) for parts in (slopes, bends))
        largest = self.largest(node)
        return up * (np.maximum(largest[first], largest[last]) + up * bend * sag), slope, bend

    def _along(self, found: Balls, axis: int | None = None) -> Balls:
        """Points (F, V) along the axis of a pack, or of none."""
        shape = [self.count, *[1] * (len(self.statement.bound) + 1)]
        shape[-1 if axis is None else axis + 1] = found.middle.shape[1]
        return found.shaped(shape)

    def _found(self, node: Node) -> Balls:
        if node.kind == "leaf":
            return self._enumerated[node.name] if node.packs else self._along(self._leaf(node.name))
        if node.kind == "inverse":
            return self._along(self._own(node.name).inverted())
        if node.kind == "delay":
            return self._along(self._late(node.name))
        if node.kind == "circle":
            return self._along(self._circle(node.name))
        return reduce(add if node.kind == "sum" else mul, map(self.points, node.parts))

    def _own(self, name: str) -> Balls:
        """The same points (F, V) of a leaf that p is divided by, made once."""
        if name not in self._divisors:
            self._divisors[name] = self._leaf(name)
        return self._divisors[name]

    def _leaf(self, name: str) -> Balls:
        """An interval along either axis, and control points of what lies along neither."""
        points: list[Balls] = []
        along: dict[int, list[Balls]] = {0: [], 1: []}
        for i, (axis, degrees, terms) in enumerate(self.statement.components[name]):
            found = self._values((name, i), terms, degrees)
            if axis == 2 or found.middle.shape[1] == 1:
                points.append(found)
            else:
                along[axis].append(found.ends(axis))
        edges = [reduce(Balls.beside, ends) for ends in along.values() if ends]
        return reduce(add, [*points, *edges])

    def _pack(self, pack: Sequence[str]) -> Iterator[tuple[str, Balls]]:
        if len(pack) == 1:
            yield pack[0], self._leaf(pack[0])
            return
        degrees = self.statement.pack_degrees(pack)
        for name in pack:
            yield name, self._values((name, -1), self.statement.leaves[name], degrees)

    @abstractmethod
    def _values(self, key: tuple[str, int], terms: Sequence[Term], degrees: Mapping[str, int]) -> Balls:
        """Control points (F, N) of some terms."""

    @abstractmethod
    def _late(self, name: str) -> Balls:
        """The delay (F, V): an arc, or one point of each frame where it does not vary."""

    @abstractmethod
    def _circle(self, name: str) -> Balls:
        """The arc (F, V) of a circle that the unknown may be on."""

    @abstractmethod
    def _latest(self, name: str, which: Any) -> np.ndarray:
        """Largest delays (P,) in the cells of some frames."""

    @abstractmethod
    def _steepness(self, name: str, which: Any) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (P,) of the first and second derivative of a leaf in w, up to the frequencies of some frames."""


class Frames(Hulls):
    """Hulls that are proved, each frame over a cell at one exact frequency, rad/s."""

    up = UP

    def __init__(self, statement: Statement, places: Sequence[tuple[Cell, fmpq]]):
        self.places = places
        numbers: dict[Cell, int] = {}
        self._cell = [numbers.setdefault(cell, len(numbers)) for cell, _ in places]
        self._cells = [*numbers]
        most = max(2, *(term.degree for leaf in statement.leaves.values() for term in leaf))
        w = np.array([nearest(one) for _, one in places])
        self._powers = np.cumprod(np.stack([np.ones(len(w)), *([w] * most)], axis=1), axis=1)
        super().__init__(statement, len(places))

    def least(self, which: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Lower bounds (P,) over some frames of the real part of p times the conjugates of directions (2, P)."""
        x, y = directions.reshape(2, -1, *[1] * (len(self.statement.bound) + 1))
        along = [self.points(node).along(x, y, which) for node in self.statement.summands]
        strayed = 2 * len(along) * UNIT * reduce(add, map(np.abs, along))
        return np.asarray((reduce(add, along) - UP * strayed).reshape(len(which), -1).min(axis=1))

    @property
    def width(self) -> int:
        """Points of all summands of one frame."""
        return sum(self.points(node).middle[0].size for node in self.statement.summands)

    def _steepness(self, name: str, which: Any) -> tuple[np.ndarray, np.ndarray]:
        sizes = np.stack([cell.sizes(name) for cell in self._cells])[np.array(self._cell)[which]]
        n = np.arange(sizes.shape[1])
        up = 1 + 4 * (len(n) + 2) * UNIT
        first = up * (sizes * n * self._powers[which][:, np.maximum(n - 1, 0)]).sum(axis=1)
        second = up * (sizes * n * (n - 1) * self._powers[which][:, np.maximum(n - 2, 0)]).sum(axis=1)
        return first + LEAST, second + LEAST

    def _latest(self, name: str, which: Any) -> np.ndarray:
        return np.array([UP * nearest(self.places[k][0].values[name][1]) for k in which])

    def _values(self, key: tuple[str, int], terms: Sequence[Term], degrees: Mapping[str, int]) -> Balls:
        """Control points (F, N) of some terms.

        A term c w^k has at most 2 k + 1 roundings, those of c and w among them, and a sum of n + 1 terms at most n.
        """
        grids = np.stack([cell.grid(key, terms, degrees) for cell in self._cells])[self._cell]
        n = grids.shape[2] - 1
        each = grids * self._powers[:, None, : n + 1]
        turned = each * np.array([1.0, 1.0, -1.0, -1.0])[np.arange(n + 1) % 4]
        strayed = (3 * n + 4) * UNIT * np.abs(each).sum(axis=2) + _TINY * np.abs(grids).sum(axis=2)
        return Balls(turned[..., ::2].sum(axis=2) + 1j * turned[..., 1::2].sum(axis=2), UP * strayed + LEAST)

    def _late(self, name: str) -> Balls:
        if name not in self.statement.varying and self.statement.inner[name][0] == 0:
            return Balls(np.ones((len(self.places), 1), dtype=complex), np.zeros((len(self.places), 1)))
        points = []
        for cell, w in self.places:
            least, most = cell.values[name]
            if name in self.statement.varying:
                points += arc(arb(w * least), arb(w * (most - least)))
            else:
                points.append(unit(arb(w * least)))
        return balls(points).shaped((len(self.places), -1))

    def _circle(self, name: str) -> Balls:
        centre, radius = map(arb, self.statement.circles[name])
        points = []
        for cell in self._cells:
            low, high = cell.values[name]
            points += [centre + radius * point for point in arc(turn() * arb(low), turn() * arb(high - low))]
        return balls(points).shaped((len(self._cells), -1)).arranged(lambda part: part[self._cell])
