"""The most probable figures under a hypothesis, by Gauss and Newton with the model's own derivatives.

Derivatives cost five times what residuals do (and of a joint that hammers, where secants stand for them, forty times).
So they are worked out anew only where a step has led to something else than they had promised; until then the
residuals themselves correct them along every step, as C. G. Broyden has shown (Mathematics of Computation 19, 1965,
577-593; with damping, K. Madsen, H. B. Nielsen and O. Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed.
2004, section 3.5).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import erfc, sqrt
from typing import Any, Protocol

import numpy as np
from scipy.special import chdtrc

from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, Placement, Unknown
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.time_limit import heed

ITERATIONS = 12
_SETTLED = 2e-4  # relative fall of the cost at which a fit has settled
_FURTHEST = 2.0  # in z, of a step; where steps lead to what was promised, twice as far each time,
_WIDEST = 0.6  # but no further than this of a logarithm: a figure may be off by many times a small tolerance
_ASTRAY = 0.3  # of the fall that slopes promise: where it is off by more, they are others
_LITTLE = 1.0  # of the cost, so one standard deviation: no further than this from where they were worked out
_STEPS = 2  # for each working out of derivatives: on a slope that never ends figures would go beyond all rigs
_HUGE = 1e9
_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e4

Rows = Sequence[tuple[np.ndarray, np.ndarray]]
"""Of every piece of evidence the residual (M,) and its derivative (M, K)."""


class Fitted(Protocol):
    """What a fit brings down, in units of misfit."""

    def predicted(self, placement: Placement, z: np.ndarray) -> Any:
        """What the model makes of it; None where it cannot say (its loop diverges)."""
        ...

    def misfit(self, predicted: Any) -> np.ndarray:
        """(M,) measured less predicted, weighed."""
        ...

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual, and (M, K) its derivative by z."""
        ...

    def residual(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(M,) measured less predicted, weighed; None where the model cannot say."""
        found = self.predicted(placement, z)
        return None if found is None else self.misfit(found)

    def error(self, residual: np.ndarray) -> float:
        """Mean square of the displacement's error over that of the displacement; 0 for what is no record of it."""
        return 0.0


class Evidence(Fitted, Protocol):
    """A piece of what was measured: a kind says what its model predicts and how that is weighed."""

    @property
    def name(self) -> str:
        """Of the record or the figure measured."""
        ...

    @property
    def condition(self) -> object:
        """Under which it was measured; pieces of one condition are held out together."""
        ...

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves."""
        ...

    @property
    def floor(self) -> float:
        """Mean square of the displacement's noise over that of the displacement; 0 for what is no record of it."""
        return 0.0


@dataclass(frozen=True)
class Share:
    """A quadratic in z that stands for one piece of evidence about a fit: c + 2 g'(z - z0) + (z - z0)' A (z - z0).

    Attributes:
        c: misfit at the fit.
        g: (K,) half its slope there.
        a: (K, K) half its curvature.
        error: of the displacement, see `Evidence.error`.
    """

    c: float
    g: np.ndarray = field(repr=False)
    a: np.ndarray = field(repr=False)
    error: float = 0.0


@dataclass(frozen=True)
class Fit:
    """A hypothesis with its most probable figures.

    Attributes:
        hypothesis: fitted.
        unknowns: in the order of z.
        z: (K,) in prior standard deviations.
        cost: misfit of all evidence, and z'z of the priors.
        shares: one per piece of evidence, at z.
        reason: why there is no fit (the model's loop diverges wherever it was tried); empty otherwise.
    """

    hypothesis: Hypothesis
    unknowns: tuple[Unknown, ...] = ()
    z: np.ndarray = field(default_factory=lambda: np.zeros(0))
    cost: float = np.inf
    shares: tuple[Share, ...] = field(default=(), repr=False)
    reason: str = ""

    @property
    def misfit(self) -> float:
        """Of the evidence alone."""
        return float(sum(share.c for share in self.shares)) if not self.reason else np.inf

    @property
    def strain(self) -> float:
        """Of the priors of tolerated figures: what is left for a wrong figure, or an effect, to ease."""
        return sum(z**2 for z in self.moved.values())

    @property
    def error(self) -> float:
        """Mean square errors of the displacement, all records together, each over its own mean square."""
        return float(sum(share.error for share in self.shares)) if not self.reason else np.inf

    @property
    def values(self) -> dict[str, float]:
        """SI value of every unknown by name; none without a fit."""
        return {u.name: u.value(z) for u, z in zip(self.unknowns, self.z, strict=not self.reason)}

    @property
    def moved(self) -> dict[str, float]:
        """Tolerances by which it has moved each tolerated figure, by name; none without a fit."""
        return {u.name: float(z) for u, z in zip(self.unknowns, self.z, strict=not self.reason) if u.kind == "figure"}

    @property
    def strained(self) -> tuple[str, ...]:
        """Tolerated figures moved further than anyone would believe: causes stand for others, or one is missing."""
        moved, most = self.moved, THRESHOLDS.strained
        # All together are where the sum of their squares is as improbable as that of one which is.
        together = chdtrc(len(moved), self.strain) < erfc(most / sqrt(2))
        return tuple(name for name, z in moved.items() if abs(z) > (1.0 if together else most))

    @property
    def covariance(self) -> np.ndarray:
        """(K, K) of z, from the curvature at the fit."""
        values, vectors = np.linalg.eigh(np.eye(len(self.z)) + sum(share.a for share in self.shares))
        # No less than the priors' own curvature, which rounding may lose beside that of a motion hard to repeat.
        return (vectors / np.maximum(values, 1.0)) @ vectors.T

    @property
    def standard_errors(self) -> dict[str, float]:
        """SI, by name."""
        deviation = np.sqrt(np.diag(self.covariance))
        return {u.name: abs(u.slope(z)) * float(s) for u, z, s in zip(self.unknowns, self.z, deviation, strict=True)}


def fit(
    hypothesis: Hypothesis,
    placement: Placement,
    evidence: Sequence[Fitted],
    start: np.ndarray,
    iterations: int = ITERATIONS,
) -> Fit:
    """Minimise misfit plus z'z from a start.

    Args:
        hypothesis: being fitted.
        placement: its unknowns in the equations.
        evidence: what it has to explain.
        start: (K,) z.
        iterations: at most, of those that work derivatives out.
    """
    low, high = (np.array(side) for side in zip(*(u.bounds for u in placement.unknowns), strict=True))
    nowhere = _Point(np.clip(start, low, high))
    if (here := nowhere.anew(evidence, placement)) is None:
        return Fit(hypothesis, placement.unknowns, reason="the model's loop is unstable where the fit begins")
    widest = np.array([_FURTHEST if u.linear else max(_FURTHEST, _WIDEST / u.spread) for u in placement.unknowns])
    damping, furthest, steps = 1e-3, _FURTHEST, 0
    while here.worked_out <= iterations and steps < _STEPS * iterations and damping <= _MOST_DAMPING:
        reach = np.minimum(furthest, widest)
        trial, promised = here.step(damping, reach, low, high)
        found = residuals_at(evidence, placement, trial, here.cost) if np.any(trial != here.z) else None
        if found is None:
            if not here.stale:
                damping, furthest = damping * 10, _FURTHEST
            elif (fresh := here.anew(evidence, placement)) is not None:
                here = fresh
            else:
                break
            continue
        damping, steps = max(damping / 10, _LEAST_DAMPING), steps + 1
        before, here = here, here.moved(evidence, trial, found)
        fall = before.cost - here.cost
        settled, astray = fall < _SETTLED * before.cost, abs(fall - promised) > _ASTRAY * promised
        furthest = _FURTHEST if astray else 2 * furthest
        if here.far if settled else astray:
            if (fresh := here.anew(evidence, placement)) is None:
                here = before  # no further than where the slopes are known
                break
            here = fresh
            settled = settled and here.step(damping, reach, low, high)[1] < _SETTLED * here.cost
        if settled:
            break
    if here.far:
        here = here.anew(evidence, placement) or here
    return Fit(hypothesis, placement.unknowns, here.z, here.cost, here.shares)


@dataclass(frozen=True)
class _Point:
    """Where a fit is.

    Attributes:
        z: (K,).
        rows: worked out here, or residuals here beside derivatives of an earlier point, corrected since.
        shares: of every piece, by these.
        cost: here.
        sloped: cost where the derivatives were worked out.
        worked_out: how often they were on the way.
    """

    z: np.ndarray
    rows: Rows = ()
    shares: tuple[Share, ...] = ()
    cost: float = np.inf
    sloped: float = np.inf
    worked_out: int = 0

    @property
    def stale(self) -> bool:
        """Whether the derivatives are those of an earlier point."""
        return self.sloped > self.cost

    @property
    def far(self) -> bool:
        """Whether it is so far from there that they may say something else about the fit."""
        return self.sloped - self.cost > _LITTLE

    def step(self, damping: float, reach: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
        """The point (K,) to try next, and by how much the cost is promised to fall there."""
        slope, curvature = self.z + sum(s.g for s in self.shares), np.eye(len(self.z)) + sum(s.a for s in self.shares)
        trial = _step(self.z, slope, curvature, damping, reach, low, high)
        move = trial - self.z
        return trial, -float(2 * slope @ move + move @ curvature @ move)

    def anew(self, evidence: Sequence[Fitted], placement: Placement) -> "_Point | None":
        """The same with derivatives worked out here; None where the model cannot say."""
        if (rows := linearised(evidence, placement, self.z)) is None:
            return None
        found = self._at(evidence, self.z, rows)
        return replace(found, sloped=found.cost, worked_out=self.worked_out + 1)

    def moved(self, evidence: Sequence[Fitted], to: np.ndarray, residuals: Sequence[np.ndarray]) -> "_Point":
        """Another point with the residuals there, derivatives corrected by what these have changed along the way.

        They are corrected in place: of long records two of them would be too large.
        """
        move = to - self.z
        along = move / (move @ move)
        rows = []
        for there, (here, slopes) in zip(residuals, self.rows, strict=True):
            unforeseen = there - here - slopes @ move
            for column, share in enumerate(along):
                slopes[:, column] += share * unforeseen
            rows.append((there, slopes))
        return self._at(evidence, to, rows)

    def _at(self, evidence: Sequence[Fitted], z: np.ndarray, rows: Rows) -> "_Point":
        each = zip(evidence, rows, strict=True)
        shares = tuple(Share(float(r @ r), j.T @ r, j.T @ j, piece.error(r)) for piece, (r, j) in each)
        return replace(self, z=z, rows=rows, shares=shares, cost=float(sum(s.c for s in shares) + z @ z))


def _step(
    z: np.ndarray,
    slope: np.ndarray,
    curvature: np.ndarray,
    damping: float,
    reach: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """A damped Newton step within reach and bounds: what a bound stops is held there, the rest is solved again."""
    held = ((z <= low) & (slope > 0)) | ((z >= high) & (slope < 0))
    move = np.zeros_like(z)
    for _ in range(len(z)):
        free = ~held
        if not free.any():
            break
        damped = curvature + damping * np.diag(np.diag(curvature))
        move = np.zeros_like(z)
        try:
            move[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
        except np.linalg.LinAlgError:  # too steep to be solved in floats: no step until it is damped more
            break
        out = free & ((z + move < low - 1e-12) | (z + move > high + 1e-12))
        if not out.any():
            break
        at = np.where(z + move < low, low, high)
        z = np.where(out, at, z)
        held = held | out
    beyond = float((np.abs(move) / reach).max(initial=1.0))
    return np.clip(z + move / beyond, low, high)


def linearised(evidence: Sequence[Fitted], placement: Placement, z: np.ndarray) -> Rows | None:
    """Residuals and derivatives; None where the model cannot say, or is about to diverge."""
    rows = []
    for piece in evidence:
        heed()
        found = piece.linearised(placement, z)
        if found is None or not (np.abs(found[0]).max() < _HUGE and np.abs(found[1]).max() < _HUGE):
            return None
        rows.append(found)
    return rows


def residuals_at(
    evidence: Iterable[Fitted], placement: Placement, z: np.ndarray, enough: float = np.inf
) -> list[np.ndarray] | None:
    """Residuals (M,) of every piece at z; None as soon as the cost is known to be enough, or the model cannot say."""
    total, found = float(z @ z), []
    for piece in evidence:
        heed()
        r = piece.residual(placement, z)
        if r is None or not np.all(np.isfinite(r)) or (total := total + float(r @ r)) >= enough:
            return None
        found.append(r)
    return found


def misfit_at(evidence: Iterable[Fitted], placement: Placement, z: np.ndarray, enough: float = np.inf) -> float:
    """Cost at z without a fit, or infinity as soon as it is known to be more than enough."""
    found = residuals_at(evidence, placement, z, enough)
    return np.inf if found is None else float(z @ z) + sum(float(r @ r) for r in found)
