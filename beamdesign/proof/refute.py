"""Members of a box that are not stable: looked for in floats, confirmed in exact arithmetic."""

from collections.abc import Mapping, Sequence

import numpy as np
from flint import fmpq

from beamdesign.proof.box_member import Undecided, is_stable, member_at
from beamdesign.proof.box_statement import Statement
from beamdesign.proof.value_set import delays, values

_PADE = 3
"""exp(-x) is taken as ((1 - x / 6) / (1 + x / 6))^3 where roots are only looked for."""

_STEPS = 1000
"""Shares of a range are rounded to this many steps before a member is confirmed."""


def unstable_member(
    statement: Statement, near: Sequence[Sequence[float]] = (), population: int = 32, rounds: int = 6
) -> dict[str, fmpq] | None:
    """Parameters of a member that is proved not to be stable, or None where none was found.

    A population of corners and midpoints climbs, one variable at a time, towards less damping of the least damped
    root. Finding nothing means nothing.

    Args:
        statement: the family over its box.
        near: members to start from, as shares of the varying variables' ranges, beside those drawn.
        population: how many members climb; at most half of them start from those given.
        rounds: most rounds over all variables.
    """
    k = len(statement.varying)
    generator = np.random.default_rng(0)
    shares = generator.choice([0.0, 0.5, 1.0], size=(population, k))
    shares[:3] = np.array([0.0, 0.5, 1.0])[:, None]
    if near:
        given = np.array(near)[generator.permutation(len(near))[: population // 2]]
        shares[-len(given) :] = given
    score = undamping(statement, shares)
    for turn in range(rounds if k else 0):
        before = score.copy()
        for i in generator.permutation(k):
            here = shares[:, i]
            nudge = 0.3 * generator.random(population) / (turn + 1)
            tried = np.stack([0 * here, 0 * here + 0.5, 0 * here + 1, here - nudge, here + nudge]).clip(0, 1)
            options = np.repeat(shares[None], len(tried), axis=0)
            options[:, :, i] = tried
            found = undamping(statement, options.reshape(-1, k)).reshape(len(tried), population)
            best = found.argmax(axis=0)
            better = found.max(axis=0) > score
            shares[better, i] = tried[best, np.arange(population)][better]
            score = np.maximum(score, found.max(axis=0))
        if np.all(score - before < 1e-4):
            break
    for i in np.argsort(-score)[:3]:
        point = parameters_at(statement, [fmpq(round(float(share) * _STEPS), _STEPS) for share in shares[i]])
        if refutes(statement, point):
            return point
    return None


def refutes(statement: Statement, parameters: Mapping[str, fmpq]) -> bool:
    """Whether a member is proved not to be stable."""
    ranges = statement.merged({name: (value, value) for name, value in parameters.items()})
    try:
        return not is_stable(statement, member_at(statement, {name: low for name, (low, _) in ranges.items()}))
    except Undecided:
        return False


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
