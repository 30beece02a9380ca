"""Members of a box: polynomials, exact, and how many of their roots are unstable; and a search for one that has any."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from flint import acb, arb, fmpq, fmpq_poly

from beamdesign.polynomial import even_odd, is_hurwitz
from beamdesign.proofs.statement import Point, Statement
from beamdesign.proofs.value_set import delays, values
from beamdesign.proofs.zero_exclusion import unit


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
    plain, late = statement.split(lambda name: statement.leaf_at(name, point), fmpq_poly([0]), fmpq_poly([1]))
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


# Members that are not stable: looked for in floats, confirmed in exact arithmetic.


_PADE = 3
"""exp(-x) is taken as ((1 - x / 6) / (1 + x / 6))^3 where roots are only looked for."""

_UNSTABLE = 1e-3
"""A root with a real part of this share of its size will be confirmed."""

_POPULATION, _ROUNDS, _STEPS = 32, 6, 1000
"""How many members climb, in how many rounds; a share of a range is rounded to so many steps before it is confirmed."""


def unstable_member(statement: Statement, near: Sequence[Sequence[float]] = ()) -> dict[str, fmpq] | None:
    """Parameters of a member that is proved not to be stable, or None where none was found.

    A population of corners and midpoints climbs, one variable at a time, towards less damping of the least damped
    root, until one is not stable. Finding nothing means nothing.

    Args:
        statement: the family over its box.
        near: members to start from, as shares of the varying variables' ranges, beside those drawn.
    """

    def confirmed(some: np.ndarray) -> dict[str, fmpq] | None:
        point = parameters_at(statement, [fmpq(round(float(share) * _STEPS), _STEPS) for share in some])
        return point if stable_at(statement, point) is False else None

    above = _UNSTABLE
    for shares, score in climb(partial(undamping, statement), len(statement.varying), near, _POPULATION, _ROUNDS):
        order = np.argsort(-score)
        if score[order[0]] > above and (point := confirmed(shares[order[0]])):
            return point
        above = max(above, score[order[0]])
    return next((point for some in shares[order[:3]] if (point := confirmed(some))), None)


def climb(
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
                others = fmpq(1)
                for other in members:
                    others *= point[other] if other != one else 1
                point[one] = min(statement.parameters[one][1], value / others) if others != 0 else point[one]
        else:
            point[name] = value
    return point
