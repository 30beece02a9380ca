"""Hulls of the value set p(jw, q) over many pieces at once, in floats: the search that comes before the proof.

Same construction as in `frames`, which proves with bounds of every error what is found here; nothing here is a proof.
Arrays of points are (2, B, C, V): both ends of a frequency interval, B pieces, C control points of what is bound and V
points whose convex hull holds the value.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import accumulate, repeat
from math import prod
from operator import mul

import numpy as np
from flint import fmpq

from beamdesign.polynomial import nearest
from beamdesign.proofs.frames import ARC_PARTS, control_value
from beamdesign.proofs.statement import Node, Statement, Term

_TURN = (1.0, 1j, -1.0, -1j)


@dataclass(frozen=True)
class Pieces:
    """Sub-boxes and frequency intervals.

    Attributes:
        low, high: (B, k), values of the varying variables as they enter.
        w: (2, B), ends of the frequency intervals, rad/s.
    """

    low: np.ndarray
    high: np.ndarray
    w: np.ndarray

    def stray(self, bend: np.ndarray) -> np.ndarray:
        """How far a curve with this bound of its second derivative strays from its chord at most."""
        return bend * (self.w[1] - self.w[0]) ** 2 / 8


@dataclass(frozen=True)
class Hull:
    """Points (2, B, C, V), and bounds (B,) of size, first and second derivative in w over the interval."""

    points: np.ndarray
    size: np.ndarray
    slope: np.ndarray
    bend: np.ndarray


def pieces(statement: Statement, start: np.ndarray, end: np.ndarray, w: np.ndarray) -> Pieces:
    """Pieces from shares (B, k) of the ranges and frequencies (2, B)."""
    low, width = _ranges(statement)
    return Pieces(low + width * start, low + width * end, w)


@lru_cache(maxsize=64)
def _ranges(statement: Statement) -> tuple[np.ndarray, np.ndarray]:
    """Least values (k,) of the varying variables as they enter, and how wide their ranges are."""
    ends = [statement.inner[name] for name in statement.varying]
    return np.array([nearest(a) for a, _ in ends]), np.array([nearest(b - a) for a, b in ends])


def hulls(statement: Statement, where: Pieces) -> list[Hull]:
    """Hulls of the summands of p; their Minkowski sum, control point by control point, holds p."""
    bound: dict[str, Hull] = {}
    for pack in statement.bound:
        new = _bind(statement, pack, where)
        count = next(iter(new.values())).points.shape[2]
        before = next(iter(bound.values())).points.shape[2] if bound else 1
        bound = {name: replace(hull, points=np.repeat(hull.points, count, axis=2)) for name, hull in bound.items()}
        bound |= {name: replace(hull, points=np.tile(hull.points, (1, 1, before, 1))) for name, hull in new.items()}

    def one(node: Node) -> Hull:
        if node.kind == "delay":
            return _late(statement, node.name, where)
        if node.kind == "circle":
            return _circle(statement, node.name, where)
        if node.name in bound:
            return bound[node.name]
        return _leaf_hull(statement, node.name, where, _points(statement, node.name, where))

    def add(left: Hull, right: Hull) -> Hull:
        points, bend = _flat(left.points[..., :, None] + right.points[..., None, :]), left.bend + right.bend
        size = np.abs(points).max(axis=(0, 2, 3)) + where.stray(bend)
        return Hull(points, size, left.slope + right.slope, bend)

    def multiply(left: Hull, right: Hull) -> Hull:
        points = _flat(left.points[..., :, None] * right.points[..., None, :])
        slope = left.slope * right.size + left.size * right.slope
        bend = left.bend * right.size + 2 * left.slope * right.slope + left.size * right.bend
        return Hull(points, left.size * right.size, slope, bend)

    return [node.fold(one, add, multiply) for node in statement.summands]


def control_points(statement: Statement) -> int:
    """Number of points of a hull of p that are computed and tested, for all summands together."""
    none = np.zeros((0, len(statement.varying)))  # hulls of no piece take no room, however many points they would have
    shapes = [hull.points.shape for hull in hulls(statement, pieces(statement, none, none, np.zeros((2, 0))))]
    return max(shape[2] for shape in shapes) * sum(shape[3] for shape in shapes)


def as_rows(summands: Sequence[Hull]) -> list[np.ndarray]:
    """The points of hulls as real numbers side by side, (V, 2, B, C, 2): what `support` takes."""
    rows = (np.ascontiguousarray(np.moveaxis(hull.points, 3, 0)) for hull in summands)
    return [one.view(float).reshape(*one.shape, 2) for one in rows]


def support(rows: Sequence[np.ndarray], directions: np.ndarray) -> np.ndarray:
    """Least real part of conj(u) p over each hull: (2, B, M) for unit directions u (B, M)."""
    u = np.stack([directions.real, directions.imag], axis=-2)
    total: np.ndarray | float = 0.0
    for points in rows:
        least = points[0] @ u
        along = np.empty_like(least)
        for one in points[1:]:  # point by point, as all of them at once are too many to be kept near the processor
            np.minimum(least, np.matmul(one, u, out=along), out=least)
        total = total + least
    return np.asarray(total).min(axis=2)


_NONE_AND_ONE = np.array([0.0, 1.0])[:, None, None]


def plain_and_whole(statement: Statement, shares: np.ndarray, s: np.ndarray) -> np.ndarray:
    """P with 0 and with 1 for exp(-s T) and the unknown, (2, B, N).

    Of members at shares (B, k) of the ranges, at complex s (B or 1, N).
    """
    found = statement.value(_leaves(statement, shares, s), _NONE_AND_ONE, _NONE_AND_ONE)
    return np.broadcast_to(found, (2, len(shares), s.shape[1]))


def with_unknown(statement: Statement, shares: np.ndarray, w: np.ndarray) -> np.ndarray:
    """P with 0 and with 1 for the unknown, (2, B, N).

    Of members at shares (B, k) of the ranges, at frequencies (B or 1, N).
    """
    s, delay = 1j * w, delays(statement, shares)
    late = np.exp(-s * delay[:, None]) if delay.any() else np.ones((1, 1))
    found = statement.value(_leaves(statement, shares, s), late, _NONE_AND_ONE)
    return np.broadcast_to(found, (2, len(shares), s.shape[1]))


def _leaves(statement: Statement, shares: np.ndarray, s: np.ndarray) -> Callable[[str], np.ndarray]:
    """Leaves (B, N) by name, of members at shares (B, k) of the ranges, at complex s (B or 1, N).

    One in which nothing varies is (1, N) where s is, and one without s is (B or 1, 1).
    """
    low, width = _ranges(statement)
    at = np.ascontiguousarray((low + width * shares).T)
    terms, found = _terms(statement), dict[str, np.ndarray]()
    most = max(degree for table in terms.values() for degree, _, _ in table)
    powers = np.stack(list(accumulate(repeat(s, most), mul, initial=np.ones_like(s))))

    def leaf(name: str) -> np.ndarray:
        if name not in found:
            table = terms[name]
            fixed = len(s) == 1 and not any(columns for _, _, columns in table)
            rows = np.zeros((1 if fixed else len(shares), 1 + max(degree for degree, _, _ in table)))
            for degree, value, columns in table:
                rows[:, degree] += prod((at[k] if power == 1 else at[k] ** power for k, power in columns), start=value)
            some = powers[: rows.shape[1]]
            if len(some) == 1:
                found[name] = rows
            elif len(s) == 1:  # of real numbers side by side: a product with complex ones takes thrice as long
                found[name] = (rows @ some[:, 0].view(float)).view(complex)
            else:
                found[name] = np.einsum("bd,dbn->bn", rows, some)
        return found[name]

    return leaf


@lru_cache(maxsize=64)
def _terms(statement: Statement) -> dict[str, list[tuple[int, float, list[tuple[int, int]]]]]:
    """Of every leaf the terms: degree in s, coefficient, and which columns of what varies in which powers."""
    found: dict[str, list[tuple[int, float, list[tuple[int, int]]]]] = {}
    for name, terms in statement.leaves.items():
        found[name] = []
        for term in terms:
            value, powers = _fixed(statement, term)
            columns = [(statement.varying.index(one), power) for one, power in powers.items()]
            found[name].append((term.degree, value, columns))
    return found


def delays(statement: Statement, shares: np.ndarray) -> np.ndarray:
    """The delay (B,) of members at shares (B, k) of the ranges; 0 where p has none."""
    name = statement.delay
    if name is None:
        return np.zeros(len(shares))
    low, high = (nearest(end) for end in statement.inner[name])
    if name not in statement.varying:
        return np.full(len(shares), low)
    return low + (high - low) * shares[:, statement.varying.index(name)]


def _bind(statement: Statement, pack: Sequence[str], where: Pieces) -> dict[str, Hull]:
    if len(pack) == 1:
        points = _points(statement, pack[0], where)
        return {pack[0]: _leaf_hull(statement, pack[0], where, np.swapaxes(points, 2, 3))}
    degrees = statement.pack_degrees(pack)
    count = int(np.prod([degree + 1 for degree in degrees.values()]))
    found = {}
    for name in pack:
        grid = _grid(statement, statement.leaves[name], degrees, where)
        points = np.broadcast_to(grid, (*grid.shape[:2], count))[..., None]
        found[name] = _leaf_hull(statement, name, where, points)
    return found


def _flat(points: np.ndarray) -> np.ndarray:
    return points.reshape(*points.shape[:-2], points.shape[-2] * points.shape[-1])


def _leaf_hull(statement: Statement, name: str, where: Pieces, points: np.ndarray) -> Hull:
    most = np.maximum(np.abs(where.low), np.abs(where.high))
    top, slope, bend = where.w[1], np.zeros(len(most)), np.zeros(len(most))
    for n, value, columns in _terms(statement)[name]:
        size = prod((most[:, k] ** power for k, power in columns), start=abs(value))
        slope += size * n * top ** max(n - 1, 0)
        bend += size * n * (n - 1) * top ** max(n - 2, 0)
    return Hull(points, np.abs(points).max(axis=(0, 2, 3)) + where.stray(bend), slope, bend)


def _fixed(statement: Statement, term: Term) -> tuple[float, dict[str, int]]:
    """Fold in what does not vary; the powers of what does, as it enters."""
    value: fmpq = term.coefficient
    powers = {}
    for name, power in term.powers.items():
        if name in statement.varying:
            powers[name] = abs(power)
        else:
            value = value * statement.inner[name][0] ** abs(power)
    return nearest(value), powers


def _grid(statement: Statement, terms: Sequence[Term], degrees: Mapping[str, int], where: Pieces) -> np.ndarray:
    """Control points (2, B, N) of some terms."""
    total: np.ndarray | float = 0.0
    for term in terms:
        value, powers = _fixed(statement, term)
        tensor = np.full((len(where.low), 1), value)
        for name, degree in degrees.items():
            column = statement.varying.index(name)
            ends = where.low[:, column], where.high[:, column]
            along = np.stack([control_value(*ends, powers.get(name, 0), degree, i) for i in range(degree + 1)], axis=-1)
            tensor = _flat(tensor[:, :, None] * along[:, None, :])
        total = total + (_TURN[term.degree % 4] * where.w**term.degree)[:, :, None] * tensor
    return np.asarray(total)


def _points(statement: Statement, name: str, where: Pieces) -> np.ndarray:
    """Points (2, B, 1, V) of a leaf: an interval along either axis, and control points of what lies along neither."""
    points = np.zeros((*where.w.shape, 1), dtype=complex)
    edges: dict[int, np.ndarray] = {}
    for axis, degrees, terms in statement.components[name]:
        grid = _grid(statement, terms, degrees, where)
        if axis == 2 or not degrees:
            points = _flat(points[..., :, None] + grid[..., None, :])
        else:
            along = grid.imag if axis else grid.real
            ends = np.stack([along.min(axis=-1), along.max(axis=-1)], axis=-1)
            edges[axis] = edges.get(axis, 0.0) + ends
    for axis, ends in edges.items():
        points = _flat(points[..., :, None] + (1j if axis else 1.0) * ends[..., None, :])
    return points[:, :, None, :]


def _late(statement: Statement, name: str, where: Pieces) -> Hull:
    """The arc exp(-jwT)."""
    if name in statement.varying:
        column = statement.varying.index(name)
        least, most = where.low[:, column], where.high[:, column]
        points = _arc(where.w * least, np.minimum(where.w * (most - least), 2 * np.pi))
    else:
        most = np.full(where.w.shape[1], nearest(statement.inner[name][1]))
        points = np.exp(-1j * where.w * most)[..., None]
    return Hull(points[:, :, None, :], np.ones_like(most), most, most**2)


def _circle(statement: Statement, name: str, where: Pieces) -> Hull:
    """The arc of a circle that the unknown may be on."""
    column = statement.varying.index(name)
    centre, radius = map(nearest, statement.circles[name])
    low, high = (2 * np.pi * np.broadcast_to(end[:, column], where.w.shape) for end in (where.low, where.high))
    points, none = centre + radius * _arc(low, high - low), np.zeros(where.w.shape[1])
    return Hull(points[:, :, None, :], none + centre + radius, none, none)


def _arc(start: np.ndarray, sweep: np.ndarray) -> np.ndarray:
    """The ends (..., V) of arcs exp(-j angle) and the corners of tangents around them."""
    shrink = np.cos(sweep / (2 * ARC_PARTS))
    marks = [(0.0, 1.0), *(((i + 0.5) / ARC_PARTS, shrink) for i in range(ARC_PARTS)), (1.0, 1.0)]
    return np.stack([np.exp(-1j * (start + share * sweep)) / shrunk for share, shrunk in marks], axis=-1)
