"""Causes fitted to steady motions, and judged on conditions that were left out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import lgamma, log, pi

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.bench.hypothesis import BenchHypothesis, unknowns
from beamdesign.diagnosis.bench.motions import CHANNELS, EDGES, Observations, averaged, errors
from beamdesign.diagnosis.fitting.hypothesis import Unknown
from beamdesign.diagnosis.judgement import SUSPICIOUS

_STALL_STD = 0.01  # of the supply: pressures against a stop are the supply's and the tank's, to the gauges' error
_DEGREES = 4.0  # of freedom of Student's distribution: the deviation comes from few conditions
_ROUNDS = 3
_FIRST_DEVIATION = 0.03
_STEPS, _CONVERGED, _DIFFERENCE = 30, 1e-2, 1e-4
_DAMPINGS = np.array([0.0, 1.0, 10.0, 100.0, 1e3, 1e4])  # beside priors, whose share of the normal matrix is one
_AT_BOUND, _INSIDE = 1e-3, 0.05  # of a prior standard deviation


@dataclass(frozen=True)
class SteadyFit:
    """Figures of one hypothesis.

    Attributes:
        hypothesis: the causes.
        unknowns: in the order of z.
        z: (K,) in prior standard deviations.
        covariance: (K, K) of z.
        deviation: by channel, what is left in units of `errors`, at least the scatter of runs.
    """

    hypothesis: BenchHypothesis
    unknowns: tuple[Unknown, ...]
    z: np.ndarray = field(repr=False)
    covariance: np.ndarray = field(repr=False)
    deviation: dict[str, float]

    @cached_property
    def values(self) -> dict[str, float]:
        """SI value of every unknown by name."""
        return {u.name: u.value(z) for u, z in zip(self.unknowns, self.z, strict=True)}

    @property
    def standard_errors(self) -> dict[str, float]:
        """SI, by name."""
        deviation = np.sqrt(np.diag(self.covariance))
        return {u.name: abs(u.slope(z)) * float(s) for u, z, s in zip(self.unknowns, self.z, deviation, strict=True)}

    @property
    def strain(self) -> float:
        """Sum of squares of how many tolerances the figures that have one are moved."""
        return float(sum(z**2 for u, z in zip(self.unknowns, self.z, strict=True) if u.kind == "figure"))

    @property
    def flags(self) -> tuple[str, ...]:
        """Figures at a bound, and figures more than two tolerances off, in words."""
        found = []
        for u, z in zip(self.unknowns, self.z, strict=True):
            low, high = u.bounds
            # A cause that is not there is no bound to be driven to.
            if z > high - _AT_BOUND or (z < low + _AT_BOUND and low != 0):
                found.append(f"{u.name} is driven to its bound")
            elif u.kind == "figure" and abs(z) > SUSPICIOUS:
                found.append(f"{u.name} is moved by {abs(z):.1f} tolerances")
        return tuple(found)


def fit(
    prototype: BenchPrototype,
    hypothesis: BenchHypothesis,
    seen: Observations,
    floor: Mapping[str, float],
    near: Mapping[str, float] | None = None,
) -> SteadyFit:
    """Fit a hypothesis with everything tolerated under its prior; what it cannot explain widens its errors.

    Levenberg-Marquardt steps within bounds; the deviation of each channel follows what is left in it.

    Args:
        prototype: what was believed.
        hypothesis: the causes.
        seen: what it is fitted to.
        floor: least deviation by channel.
        near: figures to start from, those of the priors where not given.
    """
    moved = unknowns(prototype, hypothesis, float(np.abs(seen.volts).max()))
    evidence = SteadyEvidence(moved, hypothesis.orifices, prototype.actuator.supply_pressure_Pa, seen)
    low, high = evidence.bounds
    z = np.clip([u.z(near[u.name]) if near else 0.0 for u in moved], low + _INSIDE, high - _INSIDE)
    deviation = {channel: max(floor[channel], _FIRST_DEVIATION) for channel in (*CHANNELS, EDGES)}
    for _ in range(_ROUNDS):
        z = _minimise(evidence, z, deviation)
        left = evidence.errors(z[None, :])
        deviation = {c: max(floor[c], float(np.sqrt(np.mean(left[c] ** 2)))) for c in (*CHANNELS, EDGES)}
    jacobian = evidence.linearised(z, deviation)[1]
    return SteadyFit(hypothesis, moved, z, np.linalg.inv(jacobian.T @ jacobian), deviation)


@dataclass(frozen=True)
class SteadyEvidence:
    """Steady motions as evidence, priors included: residuals over z, many points at a time.

    Attributes:
        unknowns: in the order of z.
        orifices: whether flow goes with the root of the pressure drop.
        supply: pressure that was believed, Pa.
        seen: the motions.
    """

    unknowns: tuple[Unknown, ...]
    orifices: bool
    supply: float
    seen: Observations

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest z, (K,) each."""
        low, high = zip(*(u.bounds for u in self.unknowns), strict=True)
        return np.array(low), np.array(high)

    def figures(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(m, 1) each, of m points."""
        moved = [(u, u.spread * z[:, k, None]) for k, u in enumerate(self.unknowns)]
        return {u.name: u.nominal + by if u.linear else u.nominal * np.exp(by) for u, by in moved}

    def errors(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(m, n) each, see `motions.errors`."""
        return errors(self.seen, self.figures(z), self.orifices, self.supply)

    def residual(self, z: np.ndarray, deviation: Mapping[str, float]) -> np.ndarray:
        """(m, r)."""
        figure = self.figures(z)
        error = errors(self.seen, figure, self.orifices, self.supply)
        held = np.where(self.seen.filled, figure["supply_pressure"], figure["tank_pressure"])
        stalls = (held - self.seen.stall) / (_STALL_STD * self.supply)
        return np.hstack([*(error[c] / deviation[c] for c in (*CHANNELS, EDGES)), stalls, z])

    def linearised(self, z: np.ndarray, deviation: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (r,) and their slopes (r, K), by differences that stay within the bounds."""
        step = np.where(z + _DIFFERENCE > self.bounds[1], -_DIFFERENCE, _DIFFERENCE)
        found = self.residual(np.vstack([z, z + np.diag(step)]), deviation)
        return found[0], ((found[1:] - found[0]) / step[:, None]).T


def _minimise(evidence: SteadyEvidence, z: np.ndarray, deviation: Mapping[str, float]) -> np.ndarray:
    low, high = evidence.bounds
    for _ in range(_STEPS):
        residual, jacobian = evidence.linearised(z, deviation)
        gradient = jacobian.T @ residual
        free = ~(((z <= low + 1e-9) & (gradient > 0)) | ((z >= high - 1e-9) & (gradient < 0)))
        normal, slope = jacobian[:, free].T @ jacobian[:, free], gradient[free]
        # Levenberg's steps, from Gauss and Newton's on down
        damped = normal + _DAMPINGS[:, None, None] * np.eye(len(slope))
        step = np.zeros((len(_DAMPINGS), len(z)))
        step[:, free] = -np.linalg.solve(damped, slope[:, None])[..., 0]
        trial = np.clip(z + step, low, high)
        cost = np.sum(evidence.residual(trial, deviation) ** 2, axis=1)
        best = int(np.argmin(cost))
        if not cost[best] < float(residual @ residual):
            break
        moved = float(np.max(np.abs(trial[best] - z)))
        z = trial[best]
        if moved < _CONVERGED:
            break
    return z


@dataclass(frozen=True)
class HeldOut:
    """How a hypothesis predicts conditions that its fit has not seen.

    Attributes:
        fit: to all conditions.
        error: by condition and channel, root of the mean square over both directions.
        density: by condition, logarithm of the predictive density of its mean speeds and pressures.
        without: by condition, the fit that has not seen it.
        probability: among the candidates that were tried.
    """

    fit: SteadyFit
    error: dict[str, dict[str, float]]
    density: dict[str, float]
    without: dict[str, SteadyFit] = field(repr=False)
    probability: float = np.nan

    @property
    def hypothesis(self) -> BenchHypothesis:
        """The causes."""
        return self.fit.hypothesis

    @property
    def total(self) -> float:
        """Root of the mean square over conditions and channels."""
        return float(np.sqrt(np.mean([value**2 for each in self.error.values() for value in each.values()])))


def held_out(
    prototype: BenchPrototype, hypothesis: BenchHypothesis, seen: Observations, floor: Mapping[str, float]
) -> HeldOut:
    """Fit a hypothesis once to everything and once without each condition."""
    conditions = list(dict.fromkeys(seen.condition.tolist()))
    supply = prototype.actuator.supply_pressure_Pa
    error, density, without = {}, {}, {}
    everything = fit(prototype, hypothesis, seen, floor)
    for condition in conditions:
        others = seen.of([c for c in conditions if c != condition])
        trained = without[condition] = fit(prototype, hypothesis, others, floor, everything.values)
        left = SteadyEvidence(trained.unknowns, hypothesis.orifices, supply, seen.of([condition]))
        found = left.errors(np.vstack([trained.z, trained.z + _DIFFERENCE * np.eye(len(trained.z))]))
        means = averaged(left.seen, found)
        error[condition] = {channel: float(np.sqrt(np.mean(means[channel][0] ** 2))) for channel in CHANNELS}
        density[condition] = _density(trained, means | {EDGES: found[EDGES]})
    return HeldOut(everything, error, density, without)


def _density(trained: SteadyFit, missed: Mapping[str, np.ndarray]) -> float:
    """Logarithm of Student's density of what was missed, means over replicates; uncertain figures widen it.

    Args:
        trained: the fit.
        missed: by channel, (K + 1, n) at its z and `_DIFFERENCE` beside it in each direction.
    """
    total = 0.0
    for channel, means in missed.items():
        slopes = (means[1:] - means[0]).T / _DIFFERENCE
        spread = trained.deviation[channel] ** 2 + np.sum(slopes @ trained.covariance * slopes, axis=1)
        constant = lgamma((_DEGREES + 1) / 2) - lgamma(_DEGREES / 2) - 0.5 * log(_DEGREES * pi)
        tail = (_DEGREES + 1) / 2 * np.log1p(means[0] ** 2 / spread / _DEGREES)
        total += float(np.sum(constant - 0.5 * np.log(spread) - tail))
    return total
