"""Causes fitted to steady motions, and judged on conditions that were left out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import lgamma, log, pi

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.gap.bench.hypothesis import BenchHypothesis
from beamdesign.gap.bench.model import NOTHING, steady
from beamdesign.gap.bench.observed import CHANNELS, EDGES, Observations, averaged, errors
from beamdesign.gap.bench.priors import Prior, priors

_STALL_STD = 0.01  # of the supply: pressures against a stop are the supply's and the tank's, to the gauges' error
_DEGREES = 4.0  # of freedom of Student's distribution: the deviation comes from few conditions
_ROUNDS = 3
_FIRST_DEVIATION = 0.03


@dataclass(frozen=True)
class SteadyFit:
    """Figures of one hypothesis.

    Attributes:
        hypothesis: the causes.
        values: by figure.
        covariance: (n, n) of the coordinates, logarithms where the prior is relative.
        std: standard deviation by figure, in its own unit.
        deviation: by channel, what is left in units of `errors`, at least the scatter of runs.
        flags: figures at a bound or more than two deviations off their tolerance, in words.
        strain: sum of squares of how many tolerances the figures that have one are moved.
    """

    hypothesis: BenchHypothesis
    values: dict[str, float]
    covariance: np.ndarray = field(repr=False)
    std: dict[str, float]
    deviation: dict[str, float]
    flags: tuple[str, ...] = ()
    strain: float = 0.0


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
    problem = _Problem(prototype, hypothesis, seen)
    z = problem.start(near or {})
    deviation = {channel: max(floor[channel], _FIRST_DEVIATION) for channel in (*CHANNELS, EDGES)}
    for _ in range(_ROUNDS):
        z = _minimise(problem, z, deviation)
        left = problem.errors(z[None, :])
        deviation = {c: max(floor[c], float(np.sqrt(np.mean(left[c] ** 2)))) for c in (*CHANNELS, EDGES)}
    jacobian = problem.jacobian(z, deviation)[1]
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    values = {name: float(value[0, 0]) for name, value in problem.figures(z[None, :]).items()}
    root = np.sqrt(np.diag(covariance))
    slopes = [values[name] if prior.relative else 1.0 for name, prior in problem.prior.items()]
    std = {name: float(r * slope) for name, r, slope in zip(problem.prior, root, slopes, strict=True)}
    return SteadyFit(hypothesis, values, covariance, std, deviation, tuple(problem.flags(z)), problem.strain(z))


class _Problem:
    """Residuals of one fit over coordinates z, many points at a time."""

    def __init__(self, prototype: BenchPrototype, hypothesis: BenchHypothesis, seen: Observations):
        self.prior = priors(prototype, hypothesis, float(np.abs(seen.volts).max()))
        self.orifices, self.seen = hypothesis.orifices, seen
        self.supply = prototype.actuator.supply_pressure_Pa
        self.volts, self.row = np.unique(seen.volts, return_inverse=True)
        self.out, self.back = (
            np.array([int(np.searchsorted(self.volts, pair[k])) for pair in seen.both_ways]) for k in (1, 2)
        )
        self.measured = seen.contrasts()
        self.low, self.high, self.middle = (
            np.array([_coordinate(prior, getattr(prior, name)) for prior in self.prior.values()])
            for name in ("low", "high", "middle")
        )
        self.spread = np.array([prior.spread for prior in self.prior.values()])

    def start(self, near: Mapping[str, float]) -> np.ndarray:
        given = [
            _coordinate(p, near[n]) if n in near else m
            for (n, p), m in zip(self.prior.items(), self.middle, strict=True)
        ]
        margin = 0.05 * self.spread
        return np.clip(given, self.low + margin, self.high - margin)

    def figures(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(m, 1) each, of m points."""
        return {
            name: (np.exp(z[:, k]) if prior.relative else z[:, k])[:, None]
            for k, (name, prior) in enumerate(self.prior.items())
        }

    def errors(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(m, n) each: as `errors`, less the rows of the chamber not recorded."""
        found = steady(dict(NOTHING) | self.figures(z), self.volts, self.orifices)
        seen, error = self.seen, {"speed": found.speed[:, self.row] / self.seen.speed - 1}
        for side in "ab":
            there = seen.side == side
            error[f"pressure_{side}"] = (found.pressure(side)[:, self.row[there]] - seen.pressure[there]) / self.supply
        speeds = found.speed[:, self.out], -found.speed[:, self.back]
        empty = found.pressure_b[:, self.out], found.pressure_a[:, self.back]
        return error | {EDGES: seen.contrast(speeds, empty) - self.measured}

    def residuals(self, z: np.ndarray, deviation: Mapping[str, float]) -> np.ndarray:
        """(m, r)."""
        error, figure = self.errors(z), self.figures(z)
        held = np.where(self.seen.filled, figure["supply_pressure"], figure["tank_pressure"])
        stalls = (held - self.seen.stall) / (_STALL_STD * self.supply)
        return np.hstack(
            [*(error[c] / deviation[c] for c in (*CHANNELS, EDGES)), stalls, (z - self.middle) / self.spread]
        )

    def jacobian(self, z: np.ndarray, deviation: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (r,) and their slopes (r, n), by differences that stay within the bounds."""
        step = np.where(z + _DIFFERENCE * self.spread > self.high, -1, 1) * _DIFFERENCE * self.spread
        found = self.residuals(np.vstack([z, z + np.diag(step)]), deviation)
        return found[0], ((found[1:] - found[0]) / step[:, None]).T

    def strain(self, z: np.ndarray) -> float:
        """Sum of squared deviations of the tolerated figures."""
        moved = [(z[k] - self.middle[k]) / self.spread[k] for k, name in enumerate(self.prior) if name in _TOLERATED]
        return float(np.sum(np.square(moved)))

    def flags(self, z: np.ndarray) -> list[str]:
        """Figures at a bound, and figures more than two tolerances off, in words."""
        found = []
        for k, name in enumerate(self.prior):
            away, near = abs(z[k] - self.middle[k]) / self.spread[k], 1e-3 * self.spread[k]
            at_none = self.low[k] == self.middle[k]  # a cause that is not there is no bound to be driven to
            if z[k] > self.high[k] - near or (z[k] < self.low[k] + near and not at_none):
                found.append(f"{name} is driven to its bound")
            elif name in _TOLERATED and away > 2:
                found.append(f"{name} is moved by {away:.1f} tolerances")
        return found


def _minimise(problem: _Problem, z: np.ndarray, deviation: Mapping[str, float]) -> np.ndarray:
    for _ in range(_STEPS):
        residual, jacobian = problem.jacobian(z, deviation)
        gradient = jacobian.T @ residual
        margin = 1e-9 * problem.spread
        stuck = ((z <= problem.low + margin) & (gradient > 0)) | ((z >= problem.high - margin) & (gradient < 0))
        free = ~stuck
        scaled = jacobian[:, free] * problem.spread[free]
        normal, slope = scaled.T @ scaled, scaled.T @ residual
        step = np.zeros((len(_DAMPINGS), len(z)))  # Levenberg's, from Gauss and Newton's on down
        for k, damping in enumerate(_DAMPINGS):
            step[k, free] = -np.linalg.solve(normal + damping * np.eye(len(slope)), slope) * problem.spread[free]
        trial = np.clip(z + step, problem.low, problem.high)
        cost = np.sum(problem.residuals(trial, deviation) ** 2, axis=1)
        best = int(np.argmin(cost))
        if not cost[best] < float(residual @ residual):
            break
        moved = float(np.max(np.abs(trial[best] - z) / problem.spread))
        z = trial[best]
        if moved < _CONVERGED:
            break
    return z


_STEPS, _CONVERGED, _DIFFERENCE = 30, 1e-2, 1e-4
_DAMPINGS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4)  # beside priors, whose share of the normal matrix is one


def _coordinate(prior: Prior, value: float) -> float:
    return log(value) if prior.relative else value


_TOLERATED = ("flow_gain", "piston_area", "supply_pressure")


@dataclass(frozen=True)
class HeldOut:
    """How a hypothesis predicts conditions that its fit has not seen.

    Attributes:
        fit: to all conditions.
        error: by condition and channel, root of the mean square over both directions.
        density: by condition, logarithm of the predictive density of its mean speeds and pressures.
        without: by condition, the fit that has not seen it.
    """

    fit: SteadyFit
    error: dict[str, dict[str, float]]
    density: dict[str, float]
    without: dict[str, SteadyFit] = field(repr=False)

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
        trained = fit(prototype, hypothesis, others, floor, everything.values)
        left = seen.of([condition])
        missed = averaged(left, errors(left, trained.values, hypothesis.orifices, supply))
        error[condition] = {channel: float(np.sqrt(np.mean(missed[channel] ** 2))) for channel in CHANNELS}
        density[condition] = _density(trained, left, prototype)
        without[condition] = trained
    return HeldOut(everything, error, density, without)


def _density(trained: SteadyFit, left: Observations, prototype: BenchPrototype) -> float:
    """Logarithm of Student's density of what was missed, means over replicates; uncertain figures widen it."""
    problem = _Problem(prototype, trained.hypothesis, left)
    z = np.array([_coordinate(prior, trained.values[name]) for name, prior in problem.prior.items()])
    step = _DIFFERENCE * problem.spread
    error = problem.errors(np.vstack([z, z + np.diag(step)]))
    total = 0.0
    for channel, values in error.items():
        groups = [np.full(values.shape[1], True)]
        if channel != EDGES:
            volts = left.volts if channel == "speed" else left.volts[left.side == channel[-1]]
            groups = [np.sign(volts) == sign for sign in (-1, 1)]
        means = np.array([values[:, group].mean(axis=1) for group in groups])
        slopes = (means[:, 1:] - means[:, :1]) / step
        spread = trained.deviation[channel] ** 2 + np.sum(slopes @ trained.covariance * slopes, axis=1)
        constant = lgamma((_DEGREES + 1) / 2) - lgamma(_DEGREES / 2) - 0.5 * log(_DEGREES * pi)
        tail = (_DEGREES + 1) / 2 * np.log1p(means[:, 0] ** 2 / spread / _DEGREES)
        total += float(np.sum(constant - 0.5 * np.log(spread) - tail))
    return total
