"""Members of a box: exact, with how many of their roots are unstable; and searches for unstable and for worst ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from math import pi, prod
from typing import NamedTuple

import numpy as np
from flint import acb, arb, fmpq, fmpq_poly

from beamdesign.polynomial import even_odd, is_hurwitz, nearest, squared_magnitude
from beamdesign.proofs.balls import unit
from beamdesign.proofs.statement import UNKNOWN, Point, Statement
from beamdesign.proofs.value_set import delays, plain_and_whole, with_unknown


@dataclass(frozen=True)
class Quasipolynomial:
    """plain(s) + late(s) exp(-s delay), the delay in s."""

    plain: fmpq_poly
    late: fmpq_poly
    delay: fmpq


def member(statement: Statement, parameters: Point) -> Quasipolynomial:
    """The member at one value of every parameter, which may lie outside the box."""
    plain, whole = (with_number(statement, parameters, fmpq(late), late) for late in (0, 1))
    name = statement.delay
    return Quasipolynomial(plain, whole - plain, fmpq(0) if name is None else _values(statement, parameters)[name])


def _values(statement: Statement, parameters: Point) -> dict[str, fmpq]:
    """Of the variables."""
    return {n: a for n, (a, _) in statement.merged({n: (v, v) for n, v in parameters.items()}).items()}


def with_number(statement: Statement, parameters: Point, unknown: fmpq, late: int = 1) -> fmpq_poly:
    """P of a member with numbers for the unknown and for exp(-s T); one for this leaves the delay out."""
    leaf = partial(statement.leaf_at, point=_values(statement, parameters))
    return statement.value(leaf, fmpq_poly([late]), fmpq_poly([unknown]))


def below(statement: Statement, point: Point, square: fmpq) -> bool:
    """Whether a member without delay keeps its limit at a squared frequency, (rad/s)^2, exactly.

    With p = a + u b it does where u = -a / b lies outside of the unknown's circle.
    """
    centre, radius = statement.circles[UNKNOWN]
    at_none, at_one, at_centre = (with_number(statement, point, unknown) for unknown in (fmpq(0), fmpq(1), centre))
    return bool(squared_magnitude(at_centre)(square) > radius**2 * squared_magnitude(at_one - at_none)(square))


def stable_at(statement: Statement, parameters: Point) -> bool | None:
    """Whether all roots of a member lie in the open left half plane, as many as the family's degree says, exactly.

    None where, with a delay, a root is on the axis or too near to it to tell.
    """
    one, (n, _) = member(statement, parameters), statement.degree
    if one.delay == 0 or not any(one.late.coeffs()):
        whole = one.plain + one.late
        return whole.degree() == n and is_hurwitz(whole)
    if one.plain.degree() != n:
        return False
    return None if (count := unstable_roots(one)) is None else count == 0


def unstable_roots(one: Quasipolynomial) -> int | None:
    """Number of roots with positive real part of a member whose leading term is not delayed.

    None where a root lies on the imaginary axis, or too near to it to be told from one.

    With n the degree, N the number and R a frequency from which the leading term outweighs the rest, the argument of
    p(jw) grows from 0 to R by pi n / 2 - pi N + e, where e is the argument of p(jR) over its leading term (Mikhailov's
    criterion with its remainder). Between two frequencies it grows as along the chord, if that is clear of zero.
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
            return None
        else:
            middle = (w1 + w2) / 2
            there = value(middle)
            stack += [(middle, w2, there, p2), (w1, middle, p1, there)]
    ahead = value(reach) / (plain[n] * acb(0, reach) ** n)
    count = arb(fmpq(n, 2)) - (turned - (ahead.imag / ahead.real).atan()) / arb.pi()
    return None if (whole := count.unique_fmpz()) is None else int(whole)


# Members that are not stable: looked for in floats, confirmed in exact arithmetic.


_PADE = 3
"""exp(-x) is taken as ((1 - x / 6) / (1 + x / 6))^3 where roots are only looked for."""

_UNSTABLE = 1e-3
"""A root with a real part of this share of its size will be confirmed."""

_POPULATION, _ROUNDS, _STEPS = 32, 6, 1000
"""How many members in how many rounds; to how many steps the shares of a member's parameters are rounded."""


def unstable_member(statement: Statement, near: Sequence[Sequence[float]] = ()) -> dict[str, fmpq] | None:
    """Parameters of a member that is proved not to be stable, or None where none was found.

    A population of corners and midpoints climbs, one variable at a time, towards less damping of the least damped
    root, until one is not stable. Finding nothing means nothing.

    Args:
        statement: the family over its box.
        near: members to start from, as shares of the varying variables' ranges, beside those drawn.
    """

    def confirmed(some: np.ndarray) -> dict[str, fmpq] | None:
        point = member_at(statement, some[None])
        return point if stable_at(statement, point) is False else None

    above = _UNSTABLE
    for shares, score in ascend(partial(undamping, statement), len(statement.varying), near, _POPULATION, _ROUNDS):
        order = np.argsort(-score)
        if score[order[0]] > above and (point := confirmed(shares[order[0]])):
            return point
        above = max(above, score[order[0]])
    return next((point for some in shares[order[:3]] if (point := confirmed(some))), None)


def ascend(
    score_of: Callable[[np.ndarray], np.ndarray], k: int, near: Sequence[Sequence[float]], population: int, rounds: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Members (P, k) of a population of corners and midpoints and their scores (P,), better in one variable each time.

    Args:
        score_of: scores (B,) of members at shares (B, k) of the ranges.
        k: number of variables.
        near: as for `unstable_member`.
        population: of how many; at most half of them start from those given.
        rounds: most rounds over all variables.
    """
    generator = np.random.default_rng(0)
    shares = generator.choice([0.0, 0.5, 1.0], size=(population, k))
    shares[:3] = np.array([0.0, 0.5, 1.0])[:, None]
    if near:
        given = np.array(near)[generator.permutation(len(near))[: population // 2]]
        shares[-len(given) :] = given
    score_of = _once_each(score_of)
    score = score_of(shares)
    yield shares, score
    for turn in range(rounds if k else 0):
        before = score.copy()
        for i in generator.permutation(k):
            here = shares[:, i]
            nudge = 0.3 * generator.random(population) / (turn + 1)
            tried = np.stack([0 * here, 0 * here + 0.5, 0 * here + 1, here - nudge, here + nudge]).clip(0, 1)
            options = np.repeat(shares[None], len(tried), axis=0)
            options[:, :, i] = tried
            found = score_of(options.reshape(-1, k)).reshape(len(tried), population)
            best = found.argmax(axis=0)
            better = found.max(axis=0) > score
            shares[better, i] = tried[best, np.arange(population)][better]
            score = np.maximum(score, found.max(axis=0))
            yield shares, score
        if np.all(score - before < 1e-4):
            return


def _once_each(score_of: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """The same scores, each member's worked out once: many of a population are tried at the same corners again."""
    known: dict[bytes, float] = {}

    def score(shares: np.ndarray) -> np.ndarray:
        keys = [row.tobytes() for row in shares]
        new = {key: place for place, key in enumerate(keys) if key not in known}
        if new:
            known.update(zip(new, score_of(shares[[*new.values()]]).tolist(), strict=True))
        return np.array([known[key] for key in keys])

    return score


def undamping(statement: Statement, shares: np.ndarray) -> np.ndarray:
    """Largest Re(s) / |s| over the roots of members at shares (B, k) of the ranges, in floats; 1 at a lost degree."""
    n, _ = statement.degree
    scale = _frequency(statement)
    delay = delays(statement, shares)
    order = _PADE if delay.any() else 0
    step = np.maximum(delay, 1e-3 / scale) / (2 * _PADE) if order else np.ones(len(shares))
    degree = n + order
    s = scale * np.exp(2j * np.pi * np.arange(degree + 1) / (degree + 1))[None, :]
    plain, whole = plain_and_whole(statement, shares, s)
    half = s * step[:, None]
    coefficients = np.fft.fft(plain * (1 + half) ** order + (whole - plain) * (1 - half) ** order, axis=1).real
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
def _frequency(statement: Statement) -> float:
    """Geometric mean of the root's sizes in the middle of the box, to scale the polynomial."""
    middle = parameters_at(statement, [fmpq(1, 2)] * len(statement.varying))
    p, (n, _) = with_number(statement, middle, fmpq(1)), statement.degree
    return float(arb(abs(p[0] / p[n])).root(n)) if p[0] != 0 and p[n] != 0 else 1.0


def parameters_at(statement: Statement, shares: list[fmpq]) -> dict[str, fmpq]:
    """Parameters that give the varying variables these shares of their ranges; exact."""
    share = dict(zip(statement.varying, shares, strict=True))
    groups = {name: (kind, members) for name, kind, members in statement.groups}
    point = {name: low for name, (low, _) in statement.parameters.items()}
    for name, part in share.items():
        low, high = statement.inner[name]
        value = low + (high - low) * part
        value = 1 / value if name in statement.reciprocal else value
        kind, members = groups.get(name, ("", []))
        if kind == "sum":
            for one in members:
                a, b = statement.parameters[one]
                point[one] = a + (b - a) * part
        elif kind == "product":
            # One factor after the other goes from its low to its high end until the product is reached.
            for one in members:
                others = prod((point[other] for other in members if other != one), start=fmpq(1))
                point[one] = min(statement.parameters[one][1], value / others) if others != 0 else point[one]
        else:
            point[name] = value
    return point


# Members that come nearest to the limit of a claim: what a search finds of them, which proves nothing.


_LEAST_rad_per_s, _MOST_rad_per_s = 1e-2, 1e5
_BANDS_rad_per_s, _IN_BAND, _FINE = np.geomspace(6.0, 2500.0, 25), 30, 3
"""Bands of frequency in which worst members are sought, of a rig as quick as the published one, and at how many
frequencies in each at first."""
_CLIMBING, _TURNS = 12, 4
_CORNERS, _NEAR_ENOUGH = 64, 0.2
"""Members drawn from corners and midpoints, and what one of them must have of the limit for a band to be searched."""
_ABOUT = 1.1
"""Within which factor of its frequency a member that is bad is made worse."""
Ratios = Callable[[Statement, np.ndarray, np.ndarray], np.ndarray]
"""Of members at shares (B, k) of the ranges and frequencies (B or 1, N), what is above one beyond a limit: (B, N)."""
Found = tuple[float, np.ndarray, np.ndarray]
"""The ratio of a member, its shares (1, k) and its frequency (1, 1), rad/s."""


class Worst(NamedTuple):
    """A member that leaves least of a limit, of those that a search found.

    Attributes:
        ratio: what it has over the limit, or what is above one where that is; infinite of one that is not stable.
        parameters: of the member.
        frequency_Hz: where it has it.
    """

    ratio: float
    parameters: dict[str, fmpq]
    frequency_Hz: float


def worst_of(statement: Statement, by: Ratios | None = None) -> list[Worst]:
    """Those that leave least of the limit of a statement, one in each band of frequency, the worst first."""
    found = worst_in_bands(statement, by)
    return [Worst(ratio, member_at(statement, shares), w.item() / (2 * pi)) for ratio, shares, w in found]


def member_at(statement: Statement, shares: np.ndarray) -> dict[str, fmpq]:
    """Parameters of the member at shares (1, k) of the ranges."""
    return parameters_at(statement, [fmpq(round(float(share) * _STEPS), _STEPS) for share in shares[0]])


def worst_in_bands(statement: Statement, by: Ratios | None = None) -> list[Found]:
    """The worst member found in each band of frequency, the worst first.

    A climb over all frequencies at once ends at whichever peak is in reach.
    """
    by = by or ratios
    bands, most = statement.pace * _BANDS_rad_per_s, statement.pace * _MOST_rad_per_s
    most = most if statement.until is None else nearest(statement.until)
    least = min(max(statement.pace * _LEAST_rad_per_s, nearest(statement.since)), most)
    edges = list(pairwise([least, *bands[(least < bands) & (bands < most)], most]))
    corners = np.random.default_rng(0).choice([0.0, 0.5, 1.0], size=(_CORNERS, len(statement.varying)))
    scores = [_largest(by, statement, np.geomspace(*ends, _IN_BAND)[None], corners) for ends in edges]
    near = min(_NEAR_ENOUGH, max(float(score.max()) for score in scores))
    found = [
        _worst_between(statement, by, *ends, only=None if score.max() >= near else corners[[score.argmax()]])
        for ends, score in zip(edges, scores, strict=True)
    ]
    return sorted(found, key=lambda one: -one[0])


def _worst_between(
    statement: Statement,
    by: Ratios,
    low: float,
    high: float,
    near: Sequence[Sequence[float]] = (),
    only: np.ndarray | None = None,
) -> Found:
    """The same of one band of frequencies (rad/s), from members (B, k) that may be near it; or of one only."""
    grid = np.geomspace(low, high, _IN_BAND)[None]
    best = only
    if best is None:
        largest = partial(_largest, by, statement, grid)
        *_, (shares, score) = ascend(largest, len(statement.varying), near, _CLIMBING, _TURNS)
        best = shares[[score.argmax()]]
    w, spread = grid, (high / low) ** (2 / _IN_BAND)
    for _ in range(_FINE):
        middle = w[0, by(statement, best, w).argmax()]
        w = np.clip(middle * np.geomspace(1 / spread, spread, 41), low, high)[None]
        spread **= 0.1
    over = by(statement, best, w)[0]
    k = int(over.argmax())
    return float(over[k]), best, w[:, [k]]


def worst_near(statement: Statement, by: Ratios, shares: np.ndarray, w: np.ndarray) -> Found:
    """The same about the worst of some members (B, k) at frequencies (B,), rad/s."""
    order = np.argsort(-by(statement, shares, w[:, None])[:, 0])
    at = float(w[order[0]])
    return _worst_between(statement, by, at / _ABOUT, at * _ABOUT, shares[order[:_CLIMBING]].tolist())


def _largest(by: Ratios, statement: Statement, grid: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Largest ratio (B,) of members over some frequencies."""
    return np.asarray(by(statement, shares, grid).max(axis=1))


def ratios(statement: Statement, shares: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Magnitudes (B, N) over their limit, or what is above 1 where they are, of members at frequencies (B or 1, N)."""
    centre, radius = map(nearest, statement.circles[UNKNOWN])
    plain, whole = with_unknown(statement, shares, w)
    slope = whole - plain
    return np.asarray(radius * np.abs(slope) / np.abs(plain + centre * slope))
