"""Hulls of the value set p(jw, q) over many pieces at once, in floats: the search that comes before the proof.

Same construction as in `frames`, which proves with bounds of every error what is found here; nothing here is a proof.
Arrays have both ends of a frequency interval and B pieces on their first axes, (2, B, ...).
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate, repeat
from math import prod
from operator import mul
from typing import Any

import numpy as np
from flint import fmpq

from beamdesign.polynomial import nearest
from beamdesign.proofs.balls import ARC_PARTS, Balls, flat
from beamdesign.proofs.frames import Between, Hulls, control_value
from beamdesign.proofs.statement import Node, Statement, Term

_TURN = (1.0, 1j, -1.0, -1j)


class Pieces(Hulls):
    """Hulls over sub-boxes, at both ends of frequency intervals: the frames (2 B,) are all first ends, then all others.

    Attributes:
        low, high: (B, k), values of the varying variables as they enter.
        w: (2, B), ends of the frequency intervals, rad/s.
        between: the pieces.
    """

    def __init__(self, statement: Statement, start: np.ndarray, end: np.ndarray, w: np.ndarray):
        """From shares (B, k) of the ranges and frequencies (2, B)."""
        low, width = _ranges(statement)
        self.low, self.high, self.w, self._at = low + width * start, low + width * end, w, statement.varying.index
        self._most = np.maximum(np.abs(self.low), np.abs(self.high))
        self.between = Between(slice(len(start)), slice(len(start), None), (w[1] - w[0]) ** 2 / 8)
        super().__init__(statement, 2 * len(start))

    def rows(self) -> list[np.ndarray]:
        """The points of all summands as real numbers side by side, (V, 2, B, C, 2): what `support` takes."""
        hulls = [(node.packs, self.points(node).middle) for node in self.statement.summands]
        choices, found = np.broadcast_shapes(*(points.shape[1:-1] for _, points in hulls)), []
        for packs, points in hulls:
            each = np.broadcast_to(points, (self.count, *choices, points.shape[-1])) if packs else points
            each = np.moveaxis(each.reshape(2, self.count // 2, -1, each.shape[-1]), 3, 0)
            found.append(np.ascontiguousarray(each, dtype=complex))  # without s they are real
        return [one.view(float).reshape(*one.shape, 2) for one in found]

    def _frames(self, points: np.ndarray) -> Balls:
        """Points (2, B, V) by frames."""
        return Balls(points.reshape(self.count, points.shape[2]))

    def _values(self, key: tuple[str, int], terms: Sequence[Term], degrees: Mapping[str, int]) -> Balls:
        total: np.ndarray | float = 0.0
        for term in terms:
            value, powers = _fixed(self.statement, term)
            tensor = np.full((len(self.low), 1), value)
            for name, degree in degrees.items():
                ends = self.low[:, self._at(name)], self.high[:, self._at(name)]
                along = [control_value(*ends, powers.get(name, 0), degree, i) for i in range(degree + 1)]
                tensor = flat(tensor[:, :, None] * np.stack(along, axis=-1)[:, None, :])
            total = total + (_TURN[term.degree % 4] * self.w**term.degree)[:, :, None] * tensor
        return self._frames(np.asarray(total))

    def _late(self, name: str) -> Balls:
        most = self._latest(name, self.between.last)
        if name not in self.statement.varying:
            return self._frames(np.exp(-1j * self.w * most)[..., None])
        least = self.low[:, self._at(name)]
        return self._frames(_arc(self.w * least, np.minimum(self.w * (most - least), 2 * np.pi)))

    def _circle(self, name: str) -> Balls:
        centre, radius = map(nearest, self.statement.circles[name])
        low, high = (2 * np.pi * np.broadcast_to(end[:, self._at(name)], self.w.shape) for end in (self.low, self.high))
        return self._frames(centre + radius * _arc(low, high - low))

    def _latest(self, name: str, which: Any) -> np.ndarray:
        if name in self.statement.varying:
            return self.high[:, self._at(name)]
        return np.full(len(self.high), nearest(self.statement.inner[name][1]))

    def _steepness(self, name: str, which: Any) -> tuple[np.ndarray, np.ndarray]:
        top, slope, bend = self.w[1], np.zeros(len(self.high)), np.zeros(len(self.high))
        for n, value, columns in _terms(self.statement)[name]:
            size = prod((self._most[:, k] ** power for k, power in columns), start=abs(value))
            slope += size * n * top ** max(n - 1, 0)
            bend += size * n * (n - 1) * top ** max(n - 2, 0)
        return slope, bend


@lru_cache(maxsize=64)
def _ranges(statement: Statement) -> tuple[np.ndarray, np.ndarray]:
    """Least values (k,) of the varying variables as they enter, and how wide their ranges are."""
    ends = [statement.inner[name] for name in statement.varying]
    return np.array([nearest(a) for a, _ in ends]), np.array([nearest(b - a) for a, b in ends])


def _arc(start: np.ndarray, sweep: np.ndarray) -> np.ndarray:
    """The ends (..., V) of arcs exp(-j angle) and the corners of tangents around them."""
    shrink = np.cos(sweep / (2 * ARC_PARTS))
    marks = [(0.0, 1.0), *(((i + 0.5) / ARC_PARTS, shrink) for i in range(ARC_PARTS)), (1.0, 1.0)]
    return np.stack([np.exp(-1j * (start + share * sweep)) / shrunk for share, shrunk in marks], axis=-1)


def control_points(statement: Statement) -> int:
    """Number of points of a hull of p that are computed and tested, for all summands together."""
    none = np.zeros((0, len(statement.varying)))  # hulls of no piece take no room, however many points they would have
    hulls, choices = Pieces(statement, none, none, np.zeros((2, 0))), list[tuple[int, ...]]()

    def one(node: Node) -> int:
        _, *enumerated, count = hulls.points(node).middle.shape
        choices.append((*enumerated,))
        return count

    total = sum(node.fold(one, mul, mul) for node in statement.summands)
    return total * prod(np.broadcast_shapes(*choices))


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
    """P over its divisors with 0 and with 1 for the unknown, (2, B, N).

    Of members at shares (B, k) of the ranges, at frequencies (B or 1, N).
    """
    s, delay = 1j * w, delays(statement, shares)
    late = np.exp(-s * delay[:, None]) if delay.any() else np.ones((1, 1))
    leaf = _leaves(statement, shares, s)
    found = statement.value(leaf, late, _NONE_AND_ONE) / prod(map(leaf, statement.divisors), start=1.0)
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

    def row(term: Term) -> tuple[int, float, list[tuple[int, int]]]:
        value, powers = _fixed(statement, term)
        return term.degree, value, [(statement.varying.index(one), power) for one, power in powers.items()]

    return {name: [*map(row, terms)] for name, terms in statement.leaves.items()}


def delays(statement: Statement, shares: np.ndarray) -> np.ndarray:
    """The delay (B,) of members at shares (B, k) of the ranges; 0 where p has none."""
    name = statement.delay
    if name is None:
        return np.zeros(len(shares))
    low, high = (nearest(end) for end in statement.inner[name])
    if name not in statement.varying:
        return np.full(len(shares), low)
    return low + (high - low) * shares[:, statement.varying.index(name)]


def _fixed(statement: Statement, term: Term) -> tuple[float, dict[str, int]]:
    """Fold in what does not vary; the powers of what does, as it enters."""
    powers = {name: abs(power) for name, power in term.powers.items() if name in statement.varying}
    value = term.times(lambda name, power: fmpq(1) if name in powers else statement.inner[name][0] ** abs(power))
    return nearest(value), powers
