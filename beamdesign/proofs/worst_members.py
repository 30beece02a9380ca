"""Members of a box that come nearest to the limit of a claim: what a search finds of them, which proves nothing."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from math import pi
from typing import NamedTuple

import numpy as np
from flint import fmpq

from beamdesign.proofs.box_member import climb, parameters_at
from beamdesign.proofs.slope_claim import UNKNOWN
from beamdesign.proofs.statement import Statement
from beamdesign.proofs.value_set import with_unknown
from beamdesign.rational import nearest

_LEAST_rad_per_s, _MOST_rad_per_s = 1e-2, 1e5
_BANDS_rad_per_s, _IN_BAND, _FINE = np.geomspace(6.0, 2500.0, 25), 30, 3
"""Bands of frequency in which worst members are sought, and at how many frequencies in each at first."""
_POPULATION, _ROUNDS, _STEPS = 12, 4, 1000
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
    most = _MOST_rad_per_s if statement.until is None else nearest(statement.until)
    least = min(max(_LEAST_rad_per_s, nearest(statement.since)), most)
    inner = _BANDS_rad_per_s[(least < _BANDS_rad_per_s) & (_BANDS_rad_per_s < most)]
    edges = list(pairwise([least, *inner, most]))
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
        *_, (shares, score) = climb(largest, len(statement.varying), near, _POPULATION, _ROUNDS)
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
    return _worst_between(statement, by, at / _ABOUT, at * _ABOUT, shares[order[:_POPULATION]].tolist())


def _largest(by: Ratios, statement: Statement, grid: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Largest ratio (B,) of members over some frequencies."""
    return np.asarray(by(statement, shares, grid).max(axis=1))


def ratios(statement: Statement, shares: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Magnitudes (B, N) over their limit, or what is above 1 where they are, of members at frequencies (B or 1, N)."""
    centre, radius = map(nearest, statement.circles[UNKNOWN])
    plain, whole = with_unknown(statement, shares, w)
    slope = whole - plain
    return np.asarray(radius * np.abs(slope) / np.abs(plain + centre * slope))
