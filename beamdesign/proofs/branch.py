"""Branch and bound over frequency and parameters: a tree of pieces on which the value set keeps clear of zero."""

from dataclasses import dataclass
from heapq import heappop, heappush
from math import ceil, inf, log2
from time import monotonic

import numpy as np
from flint import fmpq

from beamdesign.polynomial import exact, nearest, text
from beamdesign.proofs.frames import Cell
from beamdesign.proofs.statement import Statement
from beamdesign.proofs.value_set import Pieces, control_points, support, with_unknown
from beamdesign.proofs.zero_exclusion import coefficients, dominated
from beamdesign.time_limit import left_for_steps

TURN = 192
"""Directions of separating lines: multiples of a full turn over this."""

_LINES = np.round(1000 * np.exp(2j * np.pi * np.arange(TURN) / TURN))
_UNITS = _LINES / np.abs(_LINES)
_POINTS_AT_ONCE = 1_000_000
_CUTS_AT_ONCE = 512
_TRIED = 3
"""In how many variables it is tried to cut a piece: those along which p moves farthest."""
_NARROWEST_SHARE = 2.0**-40
_NARROWEST_BAND = 1e-10
"""A piece as narrow as this, in a variable or relatively in frequency, is left undecided."""
_LEAST_BAND = 1e-200
"""rad/s; below it there is no decimal between two floats."""

_LEADING_RATIO = 100
"""Where the leading coefficient varies by more than this, smaller boxes are better than high frequencies."""

_MOST_POINTS = 200_000
"""Most control points of a hull; beyond that a single piece takes seconds to prove."""

_CLEAR = 1e-9
"""Least distance from zero, relative to the size of p, that the ball arithmetic is sure to confirm."""


@dataclass
class _Node:
    """A piece of the tree: shares of the ranges, frequencies, and how it was settled."""

    start: np.ndarray
    end: np.ndarray
    w1: float
    w2: float
    mark: str = "?"
    halves: tuple["_Node", ...] = ()

    @property
    def volume(self) -> float:
        """Share of the whole box."""
        return float(np.prod(self.end - self.start))


class Search:
    """A tree in the making.

    Attributes:
        statement: what is searched.
        looked_at: how many pieces were looked at so far.
        open_volume: sum of the boxes of all open pieces, as shares of the whole; they may overlap.
    """

    def __init__(self, statement: Statement) -> None:
        self.statement, self.looked_at, self.open_volume = statement, 0, 0.0
        self._queue: list[tuple[float, int, _Node]] = []
        self._pushed, self._width, k = 0, control_points(statement), len(statement.varying)
        if self._width > _MOST_POINTS:
            raise ValueError(
                f"a hull of this expression has {self._width} control points, more than {_MOST_POINTS}: let fewer"
                " parameters vary, or give it leaves that share none"
            )
        since, until = statement.since, statement.until
        self._root = _Node(np.zeros(k), np.ones(k), nearest(since), inf if until is None else nearest(until))
        self._push(self._root)

    @property
    def tree(self) -> list[str]:
        """The marks of `zero_exclusion.pieces`, open pieces as "?"."""
        marks, stack = [], [self._root]
        while stack:
            node = stack.pop()
            marks.append(node.mark)
            stack += reversed(node.halves)
        return marks

    def run(self, budget: int, seconds: float = inf, enough: float = 0.0) -> None:
        """Look at pieces, the largest boxes first, until all are settled or the budget is used up.

        Args:
            budget: most pieces to look at, over all runs.
            seconds: most time, beside what is left for a step.
            enough: open volume at which to stop.
        """
        limit = monotonic() + min(seconds, left_for_steps())
        at_once = max(1, min(256, _POINTS_AT_ONCE // (2 * self._width)))
        while self._queue and self.looked_at < budget and monotonic() < limit and self.open_volume >= enough:
            batch: list[_Node] = []
            while self._queue and len(batch) < at_once and self.looked_at < budget:
                _, _, node = heappop(self._queue)
                self.open_volume -= node.volume
                self.looked_at += 1
                if node.w2 == inf:
                    self._tail(node)
                else:
                    batch.append(node)
            if batch:
                self._look(batch)

    def open_middles(self, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the smallest open pieces, shares (B, k) of the ranges and frequencies (B,), rad/s."""
        ends = (node for _, _, node in self._queue if node.w2 < inf)
        found = sorted(ends, key=lambda node: node.volume)[:most]
        shares = np.array([(node.start + node.end) / 2 for node in found]).reshape(len(found), len(self._root.start))
        return shares, np.array([(node.w1 + node.w2) / 2 for node in found])

    def _push(self, node: _Node) -> None:
        self._pushed += 1
        self.open_volume += node.volume
        heappush(self._queue, (-node.volume, self._pushed, node))

    def _split(self, node: _Node, mark: str, halves: tuple[_Node, _Node]) -> None:
        node.mark, node.halves = mark, halves
        for half in halves:
            self._push(half)

    def _halve(self, node: _Node, variable: int) -> None:
        if node.end[variable] - node.start[variable] < _NARROWEST_SHARE:
            return
        middle = (node.start[variable] + node.end[variable]) / 2
        lower, upper = node.end.copy(), node.start.copy()
        lower[variable] = upper[variable] = middle
        halves = _Node(node.start, lower, node.w1, node.w2), _Node(upper, node.end, node.w1, node.w2)
        self._split(node, self.statement.varying[variable], halves)

    def _cut(self, node: _Node, near: float) -> None:
        """Cut in frequency, at a short decimal near the one given."""
        if node.w2 - node.w1 < max(_NARROWEST_BAND * node.w2, _LEAST_BAND):
            return
        digits = 3
        while not node.w1 < (w := float(f"{near:.{digits}g}")) < node.w2:
            digits += 1
        halves = _Node(node.start, node.end, node.w1, w), _Node(node.start, node.end, w, node.w2)
        self._split(node, f"w={text(exact(w))}", halves)

    def _tail(self, node: _Node) -> None:
        """All frequencies from w1 up: settled where the leading term dominates."""
        shares = {
            name: (fmpq(*a.as_integer_ratio()), fmpq(*b.as_integer_ratio()))
            for name, a, b in zip(self.statement.varying, node.start, node.end, strict=True)
        }
        cell = Cell(self.statement, shares)
        if node.w1 > 0 and dominated(cell, exact(node.w1)):
            node.mark = "inf"
        elif (reach := _reach(cell)) is not None:
            self._cut(node, max(reach, 2 * node.w1))
        elif shares:
            n = self.statement.degree[0]
            spreads = []
            for name in self.statement.varying:
                ends = [coefficients(cell.half(name, upper))[0][n] for upper in (False, True)]
                spreads.append(nearest(sum((b - a for a, b in ends), fmpq(0))))
            self._halve(node, int(np.argmin(spreads)))

    def _look(self, batch: list[_Node]) -> None:
        start, end = np.array([node.start for node in batch]), np.array([node.end for node in batch])
        w = np.array([[node.w1 for node in batch], [node.w2 for node in batch]])
        line, clear, alone = _best_lines(Pieces(self.statement, start, end, w))
        # Where zero is in the hull at one end, only smaller boxes help; otherwise a shorter interval does.
        wide = w[1] > 1.5 * w[0]
        stuck = (alone[0] <= 0) & (~wide | (w[0] == 0)) | (alone[1] <= 0) & ~wide
        todo = np.flatnonzero(~clear & stuck) if start.shape[1] else np.array([], dtype=int)
        variables = np.zeros(len(batch), dtype=int)
        if len(todo):
            at = np.where(alone[0, todo] <= alone[1, todo], w[0, todo], w[1, todo])
            variables[todo] = _best_cuts(self.statement, start[todo], end[todo], at)
        for i, node in enumerate(batch):
            if clear[i]:
                node.mark = f"{int(_LINES[line[i]].real)},{int(_LINES[line[i]].imag)}"
            elif i in todo:
                self._halve(node, variables[i])
            else:
                low, high = node.w1, node.w2
                self._cut(node, high / 8 if low == 0 else (low * high) ** 0.5 if high > 4 * low else (low + high) / 2)


def _reach(cell: Cell) -> float | None:
    """A frequency from which the leading term dominates; None where the leading coefficient may come near to zero.

    Fujiwara's bound: twice the largest |a_(n-i) / a_n|^(1/i).
    """
    n, _ = cell.statement.degree
    plain, late = coefficients(cell)
    low, high = plain[n]
    lead, most = sorted((abs(low), abs(high)))
    lead -= late[n]
    if low * high <= 0 or lead <= 0 or (cell.shares and most > _LEADING_RATIO * lead):
        return None
    sizes = [max(abs(a), abs(b)) + late[i] for i, (a, b) in enumerate(plain[:n])]
    ratios = [(nearest(size / lead)) ** (1 / (n - i)) for i, size in enumerate(sizes)]
    return 2.0 ** ceil(log2(max(2 * max(ratios, default=1.0), 1e-3)))


def _best_lines(where: Pieces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each piece the best line found, whether it separates p from zero, and the distances (2, B) of either end.

    Directions are tried on a coarse grid, then nearer to the best; distances of the ends are each by its own line.
    """
    with np.errstate(invalid="ignore"):
        stray = where.bend(where.between) * where.between.sag
    blur = _CLEAR * np.sum([where.largest(node) for node in where.statement.summands], axis=0).reshape(2, -1)
    points, count = where.rows(), len(stray)
    rows = np.arange(count)
    # Per piece three searches: the line that is best for both ends, and one for each end alone.
    indices = np.broadcast_to(np.arange(0, TURN, TURN // 12), (3, count, 12))
    best = np.zeros((3, count), dtype=int)
    value = np.full((3, count), -inf)
    step = TURN // 24
    while True:
        tried = np.concatenate(list(indices), axis=1) if step < TURN // 24 else indices[0]
        found = support(points, _UNITS[tried]) - blur[..., None]
        scores = np.stack([found.min(axis=0), found[0], found[1]])
        choice = scores.argmax(axis=2)
        score = np.take_along_axis(scores, choice[..., None], axis=2)[..., 0]
        best = np.where(score > value, tried[rows, choice], best)
        value = np.maximum(value, score)
        if step == 0:
            break
        indices = np.stack([best - step, best + step], axis=-1) % TURN
        step //= 2
    return best[0], value[0] > stray, value[1:]


def _best_cuts(statement: Statement, start: np.ndarray, end: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The variable (B,) of which the worse half comes farthest from zero at a frequency (B,), of a few tried."""
    tried, (count, k) = _farthest(statement, start, end, w), start.shape
    few, rows = tried.shape[1], np.arange(count)
    low, high = (np.repeat(side, 2 * few, axis=0).reshape(count, few, 2, k) for side in (start, end))
    for j, i in enumerate(tried.T):
        high[rows, j, 0, i] = low[rows, j, 1, i] = (start[rows, i] + end[rows, i]) / 2
    ends, at = np.stack([low, high]).reshape(2, -1, k), np.repeat([w, w], 2 * few, axis=1)
    apart = []
    for first in range(0, at.shape[1], _CUTS_AT_ONCE):
        some = slice(first, first + _CUTS_AT_ONCE)
        halves = Pieces(statement, ends[0, some], ends[1, some], at[:, some])
        apart.append(_best_lines(halves)[2][0])
    worse, better = np.sort(np.concatenate(apart).reshape(count, few, 2), axis=2).T
    return np.asarray(tried[rows, (worse + better / 4).T.argmax(axis=1)])


def _farthest(statement: Statement, start: np.ndarray, end: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The variables (B, few) along which p moves farthest at a frequency (B,), the others being in their middles."""
    (count, k), each = start.shape, np.arange(start.shape[1])
    points = np.tile(((start + end) / 2)[:, None, None], (k, 2, 1))
    points[:, each, 0, each], points[:, each, 1, each] = start, end
    p, whole = with_unknown(statement, points.reshape(-1, k), np.repeat(w, 2 * k)[:, None]).reshape(2, count, k, 2)
    turned, arcs = whole - p, [(statement.varying.index(name), circle) for name, circle in statement.circles.items()]
    for i, (centre, radius) in arcs:
        p = p + (nearest(centre) + nearest(radius) * np.exp(-2j * np.pi * points[..., i])) * turned
    moves = np.abs(p[..., 1] - p[..., 0])
    for i, (_, radius) in arcs:  # not between its ends, which meet where it is a whole turn
        half = np.pi * np.minimum(end[:, i] - start[:, i], 0.5)
        moves[:, i] = 2 * nearest(radius) * np.abs(turned[:, i, 0]) * np.sin(half)
    return np.argsort(-moves, axis=1, kind="stable")[:, :_TRIED]
