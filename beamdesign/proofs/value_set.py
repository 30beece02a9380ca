"""The value set p(jw, q) of a box: members of it, exact, and hulls over many pieces at once, in floats.

Members are polynomials, and how many of their roots are unstable is exact. Hulls are for the search that comes before
the proof: same construction as in `zero_exclusion`, which proves in ball arithmetic what is found with them; no hull
here is a proof. Arrays of points are (2, B, C, V): both ends of a frequency interval, B pieces, C control points of
what is bound and V points whose convex hull holds the value.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from flint import acb, arb, fmpq, fmpq_poly

from beamdesign.polynomial import even_odd, is_hurwitz
from beamdesign.proofs.rig_family import Node, Point, Statement, Term
from beamdesign.proofs.zero_exclusion import ARC_PARTS, control_value, unit
from beamdesign.rational import nearest

# Members.


class Undecided(ArithmeticError):
    """A root lies on the imaginary axis, or too near to it to be told from one."""


@dataclass(frozen=True)
class Quasipolynomial:
    """plain(s) + late(s) exp(-s delay), the delay in s."""

    plain: fmpq_poly
    late: fmpq_poly
    delay: fmpq


def member(statement: Statement, parameters: Point) -> Quasipolynomial:
    """The member at one value of every parameter, which may lie outside the box."""
    point = {n: a for n, (a, _) in statement.merged({n: (v, v) for n, v in parameters.items()}).items()}
    return member_at(statement, point)


def member_at(statement: Statement, point: Point) -> Quasipolynomial:
    """The member at one value of every variable."""

    def leaf(name: str) -> fmpq_poly:
        total = fmpq_poly([0])
        for c, degree, powers in statement.leaves[name]:
            for variable, power in powers.items():
                c = c * point[variable] ** power
            total += fmpq_poly([0] * degree + [c])
        return total

    plain, late = statement.split(leaf, fmpq_poly([0]), fmpq_poly([1]))
    return Quasipolynomial(plain, late, fmpq(0) if statement.delay is None else point[statement.delay])


def stable_at(statement: Statement, parameters: Point) -> bool | None:
    """Whether all roots of a member lie in the open left half plane, as many as the family's degree says, exactly.

    None where, with a delay, a root is on the axis or too near to it to tell.
    """
    one, (n, _) = member(statement, parameters), statement.degree
    if one.delay == 0 or not any(one.late.coeffs()):
        whole = one.plain + one.late
        return whole.degree() == n and is_hurwitz(whole)
    try:
        return one.plain.degree() == n and unstable_roots(one) == 0
    except Undecided:
        return None


def unstable_roots(one: Quasipolynomial) -> int:
    """Number of roots with positive real part of a member whose leading term is not delayed.

    With n the degree, N the number and R a frequency from which the leading term outweighs the rest, the argument of
    p(jw) grows from 0 to R by pi n / 2 - pi N + e, where e is the argument of p(jR) over its leading term (Mikhailov's
    criterion with its remainder). Between two frequencies it grows as along the chord, if that is clear of zero.

    Raises:
        Undecided: where a root is on the axis or too near to it.
    """
    plain, late, delay, n = one.plain, one.late, one.delay, one.plain.degree()
    sizes, delayed = (fmpq_poly([abs(c) for c in part.coeffs()]) for part in (plain, late))
    reach, others = fmpq(1), sizes + delayed - fmpq_poly([0] * n + [abs(plain[n])])
    while not others(reach) < abs(plain[n]) * reach**n:
        reach *= 2
    # Of the second derivative in w of a part sum c_i (jw)^i exp(-jwT), the sizes |c_i| bound the size.
    bend = sizes.derivative().derivative() + delayed.derivative().derivative()
    bend += 2 * delay * delayed.derivative() + delay * delay * delayed
    parts = even_odd(plain), even_odd(late)

    def value(w: fmpq) -> acb:
        on_axis, turning = (acb(even(w * w), w * odd(w * w)) for even, odd in parts)
        return on_axis + turning * unit(arb(w * delay))

    turned = arb(0)
    stack = [(fmpq(0), reach, value(fmpq(0)), value(reach))]
    while stack:
        w1, w2, p1, p2 = stack.pop()
        stray = arb(bend(w2) * (w2 - w1) ** 2 / 8)
        dot = p1.conjugate() * p2
        # The chord's distance from zero is at least the nearer end's times the cosine of half the angle between them.
        if dot.real > 0 and abs(p1).min(abs(p2)) ** 2 * (1 + dot.real / abs(dot)) > 2 * stray * stray:
            turned += (dot.imag / dot.real).atan()
        elif w2 - w1 < reach / 2**60:
            raise Undecided("a root lies on the imaginary axis, or too near to it to be told")
        else:
            middle = (w1 + w2) / 2
            there = value(middle)
            stack += [(middle, w2, there, p2), (w1, middle, p1, there)]
    ahead = value(reach) / (plain[n] * acb(0, reach) ** n)
    count = arb(fmpq(n, 2)) - (turned - (ahead.imag / ahead.real).atan()) / arb.pi()
    whole = count.unique_fmpz()
    if whole is None:
        raise Undecided("the number of unstable roots is not certain")
    return int(whole)


# Hulls, in floats.


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
    ends = [statement.inner[name] for name in statement.varying]
    low = np.array([nearest(a) for a, _ in ends])
    width = np.array([nearest(b - a) for a, b in ends])
    return Pieces(low + width * start, low + width * end, w)


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
            return _arc(statement, node.name, where)
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


def support(summands: Sequence[Hull], directions: np.ndarray) -> np.ndarray:
    """Least real part of conj(u) p over each hull: (2, B, M) for unit directions u (B, M)."""
    u = np.stack([directions.real, directions.imag], axis=-2)
    total: np.ndarray | float = 0.0
    for hull in summands:
        _, count, controls, points = hull.points.shape
        xy = np.ascontiguousarray(hull.points).view(float).reshape(2, count, controls * points, 2)
        total = total + (xy @ u).reshape(2, count, controls, points, -1).min(axis=3)
    return np.asarray(total).min(axis=2)


def values(statement: Statement, shares: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Plain and delayed part of p, each (B, N), of members at shares (B, k) of the ranges, at complex s (B or 1, N)."""
    where = pieces(statement, shares, shares, np.zeros((2, len(shares))))

    none = np.zeros((len(shares), s.shape[1]), dtype=complex)

    def leaf(name: str) -> np.ndarray:
        total = none
        for term in statement.leaves[name]:
            total = total + _size(statement, term, where.low)[:, None] * s**term.degree
        return total

    return statement.split(leaf, none, none + 1)


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
    return points.reshape(*points.shape[:-2], -1)


def _leaf_hull(statement: Statement, name: str, where: Pieces, points: np.ndarray) -> Hull:
    most = np.maximum(np.abs(where.low), np.abs(where.high))
    top, slope, bend = where.w[1], np.zeros(len(most)), np.zeros(len(most))
    for term in statement.leaves[name]:
        size, n = np.abs(_size(statement, term, most)), term.degree
        slope += size * n * top ** max(n - 1, 0)
        bend += size * n * (n - 1) * top ** max(n - 2, 0)
    return Hull(points, np.abs(points).max(axis=(0, 2, 3)) + where.stray(bend), slope, bend)


def _size(statement: Statement, term: Term, at: np.ndarray) -> np.ndarray:
    """Coefficient (B,) of a term at values (B, k) of the varying variables."""
    value, powers = _fixed(statement, term)
    size = np.full(len(at), value)
    for name, power in powers.items():
        size = size * at[:, statement.varying.index(name)] ** power
    return size


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
            tensor = (tensor[:, :, None] * along[:, None, :]).reshape(len(tensor), -1)
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


def _arc(statement: Statement, name: str, where: Pieces) -> Hull:
    """The arc exp(-jwT): its ends and the corners of tangents around it."""
    least, most = (np.full(where.w.shape[1], nearest(end)) for end in statement.inner[name])
    marks = [(0.0, 1.0)]
    sweep = np.zeros_like(where.w)
    if name in statement.varying:
        column = statement.varying.index(name)
        least, most = where.low[:, column], where.high[:, column]
        sweep = np.minimum(where.w * (most - least), 2 * np.pi)
        shrink = np.cos(sweep / (2 * ARC_PARTS))
        marks += [((i + 0.5) / ARC_PARTS, shrink) for i in range(ARC_PARTS)] + [(1.0, 1.0)]
    points = np.stack([np.exp(-1j * (where.w * least + share * sweep)) / shrink for share, shrink in marks], axis=-1)
    return Hull(points[:, :, None, :], np.ones_like(most), most, most**2)


_PADE = 3
"""exp(-x) is taken as ((1 - x / 6) / (1 + x / 6))^3 where roots are only looked for."""


def undamping(statement: Statement, shares: np.ndarray) -> np.ndarray:
    """Largest Re(s) / |s| over the roots of members at shares (B, k) of the ranges, in floats; 1 at a lost degree."""
    n, _ = statement.degree
    scale = _frequency(statement, shares.shape[1], n)
    delay = delays(statement, shares)
    order = _PADE if delay.any() else 0
    step = np.maximum(delay, 1e-3 / scale) / (2 * _PADE) if order else np.ones(len(shares))
    degree = n + order
    s = scale * np.exp(2j * np.pi * np.arange(degree + 1) / (degree + 1))[None, :]
    plain, late = values(statement, shares, s)
    half = s * step[:, None]
    coefficients = np.fft.fft(plain * (1 + half) ** order + late * (1 - half) ** order, axis=1).real
    lead = np.abs(coefficients[:, -1]) / (scale * step) ** order
    lost = lead < 1e-13 * np.abs(coefficients).max(axis=1)
    coefficients[lost, -1] = 1.0
    companion = np.zeros((len(shares), degree, degree))
    companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
    companion[:, :, -1] = -coefficients[:, :-1] / coefficients[:, -1:]
    roots = np.linalg.eigvals(companion)
    damping = roots.real / np.maximum(np.abs(roots), 1e-300)
    return np.where(lost, 1.0, damping.max(axis=1))


@lru_cache(maxsize=16)
def _frequency(statement: Statement, k: int, n: int) -> float:
    """Geometric mean of the root's sizes in the middle of the box, to scale the polynomial."""
    radius = 1.0
    s = radius * np.exp(2j * np.pi * np.arange(n + 1) / (n + 1))[None, :]
    plain, late = values(statement, np.full((1, k), 0.5), s)
    at_rest = abs(np.fft.fft(plain + late, axis=1).real[0, 0])
    far = 1e6 * s
    leading = abs(np.mean(sum(values(statement, np.full((1, k), 0.5), far)) / far**n))
    return float((at_rest / (n + 1) / leading) ** (1 / n)) if at_rest > 0 and leading > 0 else 1.0
