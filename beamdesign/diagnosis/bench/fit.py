"""Causes fitted to steady motions, and how they predict conditions that were left out, their whole records too."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.stats import f as f_ratio
from scipy.stats import t as student_t

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.bench.data import BenchRun, BenchSet, held
from beamdesign.diagnosis.bench.hypothesis import (
    FIGURES,
    NO_CAUSE,
    ORIFICES,
    BenchHypothesis,
    SteadyPlacement,
    parameters,
    placed,
    steady_placement,
)
from beamdesign.diagnosis.bench.motions import CHANNELS, EDGES, Observations, averaged, steady
from beamdesign.diagnosis.diagnosis import RecordGap
from beamdesign.diagnosis.fitting.fit import Fit, Fitted, fit
from beamdesign.diagnosis.fitting.hypothesis import WRONG
from beamdesign.plant.bench_simulation import BENCH_COLUMNS, replay

_STALL, _STALL_STD = "stall", 0.01  # of the supply: pressures at a stop are the supply's and tank's, to gauges' errors
_DEGREES = 4.0  # of freedom of Student's distribution: the deviation comes from few conditions
_ROUNDS = 3
_FIRST_DEVIATION, _LEAST_DEVIATION = 0.03, 1e-6
_DIFFERENCE, _INSIDE = 1e-4, 0.05  # of a prior standard deviation


@dataclass(frozen=True)
class SteadyEvidence(Fitted):
    """Steady motions in units of misfit; many points of z at a time, (m, K), where one will do.

    Attributes:
        seen: the motions.
        deviation: by channel, of what is left in units of `predicted`.
    """

    seen: Observations
    deviation: Mapping[str, float]

    def predicted(self, placement: SteadyPlacement, z: np.ndarray) -> dict[str, np.ndarray]:
        """(..., n) errors by channel: relative ones of speeds, of pressures over the supply, of the contrast `EDGES`.

        Of speeds there is one per row, of a pressure one per row that recorded it, of edges one per condition.
        """
        seen, figure, rows = self.seen, placement.figures(z), self.seen.rows
        found = steady(figure, seen.volts, placement.orifices)
        error = {"speed": found["speed"] / rows.speed - 1}
        for side in "ab":
            there, channel = rows.side == side, f"pressure_{side}"
            error[channel] = (found[channel][..., there] - rows.pressure[there]) / seen.supply_Pa
        out, back = seen.both_ways
        speeds = found["speed"][..., out], -found["speed"][..., back]
        empty = found["pressure_b"][..., out], found["pressure_a"][..., back]
        error[EDGES] = seen.contrast(speeds, empty) - seen.contrasts
        held = np.where(seen.filled, figure["supply_pressure"], figure["tank_pressure"])
        return error | {_STALL: (held - rows.stall) / seen.supply_Pa}

    def left(
        self, condition: str, placement: SteadyPlacement, z: np.ndarray
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Errors at one condition as `predicted` has them, and their means as `averaged` has them."""
        own = replace(self, seen=self.seen.of([condition]))
        found = own.predicted(placement, z)
        return found, averaged(own.seen, found)

    def misfit(self, predicted: Mapping[str, np.ndarray]) -> np.ndarray:
        """(..., M) errors, weighed."""
        return np.concatenate([predicted[c] / self.deviation[c] for c in (*CHANNELS, EDGES, _STALL)], axis=-1)

    def linearised(self, placement: SteadyPlacement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their slopes, by differences that stay within the bounds."""
        high = np.array([u.bounds[1] for u in placement.unknowns])
        step = np.where(z + _DIFFERENCE > high, -_DIFFERENCE, _DIFFERENCE)
        found = self.misfit(self.predicted(placement, np.vstack([z, z + np.diag(step)])))
        return found[0], ((found[1:] - found[0]) / step[:, None]).T


def moving(found: Fit, volts: np.ndarray) -> dict[str, np.ndarray]:
    """Steady motion at commands (N,) from the null, as a fit has it; see `steady`."""
    return steady(NO_CAUSE | found.values, volts, ORIFICES in found.hypothesis.names)


def fit_steady(
    prototype: BenchPrototype,
    hypothesis: BenchHypothesis,
    seen: Observations,
    floor: Mapping[str, float],
    near: Mapping[str, float] | None = None,
) -> tuple[Fit, SteadyEvidence]:
    """Fit a hypothesis with everything tolerated under its prior; what it cannot explain widens its errors.

    Args:
        prototype: what was believed.
        hypothesis: the causes.
        seen: what it is fitted to.
        floor: least deviation by channel.
        near: figures to start from, those of the priors where not given.

    Returns:
        the fit, and the motions as they were weighed in the end.
    """
    placement = steady_placement(prototype, hypothesis, float(np.abs(seen.volts).max()))
    first = {c: max(least, _FIRST_DEVIATION) for c, least in floor.items()} | {_STALL: _STALL_STD}
    piece = SteadyEvidence(seen, first)
    low, high = (np.array(side) for side in zip(*(u.bounds for u in placement.unknowns), strict=True))
    start = np.array([u.z(near[u.name]) if near else 0.0 for u in placement.unknowns])
    z = np.clip(start, low + _INSIDE, high - _INSIDE)
    for _ in range(_ROUNDS):
        z = fit(hypothesis, placement, [piece], z).z
        left = piece.predicted(placement, z)
        own = {c: max(least, np.sqrt(np.mean(left[c] ** 2)), _LEAST_DEVIATION) for c, least in floor.items()}
        piece = replace(piece, deviation={**piece.deviation, **own})
    return fit(hypothesis, placement, [piece], z, 0), piece


@dataclass(frozen=True)
class HeldOut:
    """How a hypothesis predicts conditions that its fit has not seen.

    Attributes:
        hypothesis: the causes.
        fit: to all conditions.
        deviation: by channel, of what that fit leaves.
        error: by condition and channel, root of the mean square over both directions.
        density: by condition, logarithm of the predictive density of its mean speeds and pressures.
        without: by condition, the fit that has not seen it.
        lack: by channel, p of its lack of fit, see `lack_of_fit`.
        probability: among the candidates that were tried.
    """

    hypothesis: BenchHypothesis
    fit: Fit
    deviation: Mapping[str, float]
    error: dict[str, dict[str, float]]
    density: dict[str, float]
    without: dict[str, Fit] = field(repr=False)
    lack: Mapping[str, float] = field(repr=False)
    probability: float = np.nan

    @property
    def total(self) -> float:
        """Root of the mean square over conditions and channels."""
        return float(np.sqrt(np.mean([value**2 for each in self.error.values() for value in each.values()])))


def held_out(prototype: BenchPrototype, hypothesis: BenchHypothesis, seen: Observations) -> HeldOut:
    """Fit a hypothesis once to everything and once without each condition."""
    error, density, without = {}, {}, {}
    everything, whole = fit_steady(prototype, hypothesis, seen, seen.scatter)
    for condition in seen.conditions:
        others = seen.of([c for c in seen.conditions if c != condition])
        trained, weighed = fit_steady(prototype, hypothesis, others, seen.scatter, everything.values)
        beside = np.vstack([trained.z, trained.z + _DIFFERENCE * np.eye(len(trained.z))])
        found, means = whole.left(condition, placed(trained), beside)
        error[condition] = {channel: float(np.sqrt(np.mean(means[channel][0] ** 2))) for channel in CHANNELS}
        density[condition] = _density(trained, weighed.deviation, means | {EDGES: found[EDGES]})
        without[condition] = trained
    lack = lack_of_fit(whole, everything)
    return HeldOut(hypothesis, everything, whole.deviation, error, density, without, lack)


def lack_of_fit(piece: SteadyEvidence, found: Fit) -> dict[str, float]:
    """Probability that replicates which scatter as they do are missed by a right model as far as by a fit, by channel.

    The test of lack of fit against pure error (N. R. Draper and H. Smith, Applied Regression Analysis, 3rd ed. 1998,
    section 2.1), with means of replicates as cells; the figures that were fitted take no degrees from it, so that it
    rejects too seldom. NaN where nothing was repeated.

    Args:
        piece: the motions.
        found: the fit to them.
    """
    squares, cells, runs = dict.fromkeys(CHANNELS, 0.0), dict.fromkeys(CHANNELS, 0), dict.fromkeys(CHANNELS, 0)
    for condition in piece.seen.conditions:
        left, averages = piece.left(condition, placed(found), found.z)
        for channel, means in averages.items():
            count = len(left[channel])
            squares[channel] += float(np.sum(means**2)) * count / len(means)
            cells[channel] += len(means)
            runs[channel] += count
    freedom = {c: runs[c] - cells[c] for c in CHANNELS}
    ratio = {c: squares[c] / cells[c] / piece.seen.scatter[c] ** 2 for c in CHANNELS}
    return {c: float(f_ratio.sf(ratio[c], cells[c], freedom[c])) if freedom[c] > 0 else np.nan for c in CHANNELS}


def _density(trained: Fit, deviation: Mapping[str, float], missed: Mapping[str, np.ndarray]) -> float:
    """Logarithm of Student's density of what was missed, means over replicates; uncertain figures widen it.

    Args:
        trained: the fit.
        deviation: of it by channel.
        missed: by channel, (K + 1, n) at its z and `_DIFFERENCE` beside it in each direction.
    """
    total = 0.0
    for channel, means in missed.items():
        slopes = (means[1:] - means[0]).T / _DIFFERENCE
        spread = deviation[channel] ** 2 + np.sum(slopes @ trained.covariance * slopes, axis=1)
        total += float(np.sum(student_t.logpdf(means[0], _DEGREES, scale=np.sqrt(spread))))
    return total


def updated_prototype(prototype: BenchPrototype, fit: Fit, **readings: float | None) -> BenchPrototype:
    """The prototype with a fit's causes as effects and its figures in place of the believed ones.

    Args:
        prototype: what was believed.
        fit: of what is held responsible.
        readings: figures of its sensors that the data show; None: as believed.
    """
    effects = {
        name: {key: estimate.value for key, estimate in table.items()}
        for name, table in parameters(prototype, fit).items()
        if not name.startswith(WRONG)
    }
    if "seal_friction" in effects:
        effects["seal_friction"].setdefault("coulomb_N", 0.0)
    tables: dict[str, dict[str, float]] = {"actuator": {}, "servovalve": {}}
    for figure in FIGURES:
        if figure.place and figure.name in fit.values:
            table, _, key = figure.place.partition(".")
            tables[table][key] = fit.values[figure.name]
    return prototype.but(
        **{table: getattr(prototype, table).but(**new) for table, new in tables.items()},
        sensors=prototype.sensors.but(**{key: value for key, value in readings.items() if value is not None}),
        effects=dict(prototype.effects) | effects,
    )


REPLAYED = ("displacement_m", "pressure_a_Pa", "pressure_b_Pa")


def replayed(data: BenchSet, chosen: HeldOut) -> tuple[RecordGap, ...]:
    """Simulate every condition under its recorded command and compare with all its runs, channel by channel.

    Root mean square errors over the stroke or the supply pressure: as believed, and with the chosen causes, fitted
    without the condition. The floor is half the mean square difference of replicates, as its root; NaN with one.

    The reading of the displacement at the retracted stop is taken from the record: it is where the sensor was mounted,
    and neither model speaks of it.
    """
    rows = []
    for condition, trained in chosen.without.items():
        runs = [run for run in data.runs if run.condition == condition]
        rigs = data.prototype, updated_prototype(data.prototype, trained)
        before, after = (_rms(data.prototype, _missed(rig, runs)) for rig in rigs)
        floor = _rms(data.prototype, _scattered(runs))
        rows += [RecordGap(f"{condition}, {c}", True, before[c], np.nan, after[c], floor[c]) for c in REPLAYED]
    return tuple(rows)


def simulated(prototype: BenchPrototype, run: BenchRun) -> np.ndarray:
    """A run's record as `prototype` makes it, columns as in `BENCH_COLUMNS`, read by the run's own sensor."""
    zero, top = float(np.median(run.displacement_m[held(run, -1)])), float(np.max(run.displacement_m))
    sensors = prototype.sensors.but(displacement_zero_m=zero, displacement_most_m=top)
    return replay(prototype.but(sensors=sensors), run.times, run.command_V)


def _rms(prototype: BenchPrototype, squares: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Roots of the means of squares by channel, over the stroke or the supply pressure; NaN where there are none."""
    actuator = prototype.actuator
    over = dict(zip(REPLAYED, (actuator.stroke_m, *(actuator.supply_pressure_Pa,) * 2), strict=True))
    of: dict[str, list[float]] = {channel: [] for channel in REPLAYED}
    for channel, square in squares:
        of[channel].append(square / over[channel] ** 2)
    return {channel: float(np.sqrt(np.mean(each))) if each else np.nan for channel, each in of.items()}


def _missed(prototype: BenchPrototype, runs: Sequence[BenchRun]) -> Iterator[tuple[str, float]]:
    """By channel, what a model misses of each run."""
    made: dict[bytes, np.ndarray] = {}
    for run in runs:
        key = run.command_V.tobytes()
        if key not in made:
            made[key] = simulated(prototype, run)
        for channel, measured in run.channels.items():
            yield channel, float(np.mean((made[key][:, BENCH_COLUMNS.index(channel)] - measured) ** 2))


def _scattered(runs: Sequence[BenchRun]) -> Iterator[tuple[str, float]]:
    """By channel, half of what each two replicates differ in."""
    for one, other in combinations(runs, 2):
        for channel, measured in one.channels.items():
            theirs = other.channels.get(channel, np.zeros(0))
            if len(theirs) == len(measured):
                yield channel, float(np.mean((theirs - measured) ** 2)) / 2
