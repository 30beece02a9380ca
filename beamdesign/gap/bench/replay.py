"""Recorded runs of a bench beside their simulation, by the bench's prototype with what a diagnosis has found in it."""

from dataclasses import dataclass

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.bench_simulation import BENCH_COLUMNS, replay
from beamdesign.gap.bench.data import BenchRun, BenchSet, held
from beamdesign.gap.bench.fit import HeldOut, SteadyFit
from beamdesign.gap.bench.hypothesis import FIGURES, parameters
from beamdesign.gap.fitting.hypothesis import WRONG

_LEAST_COULOMB_N = 0.0


def amended(prototype: BenchPrototype, fit: SteadyFit, **readings: float | None) -> BenchPrototype:
    """The prototype with a fit's causes as effects and its figures in place of the believed ones.

    Args:
        prototype: what was believed.
        fit: of what is held responsible.
        readings: figures of its sensors that the data show; None: as believed.
    """
    effects = {
        name: {key: estimate.value for key, estimate in table.items()}
        for name, table in parameters(prototype, fit.hypothesis.names, fit.values, fit.standard_errors).items()
        if not name.startswith(WRONG)
    }
    if "seal_friction" in effects:
        effects["seal_friction"].setdefault("coulomb_N", _LEAST_COULOMB_N)
    tables: dict[str, dict[str, float]] = {"actuator": {}, "servovalve": {}}
    for figure in FIGURES:
        if figure.place and figure.name in fit.values:
            table, _, key = figure.place.partition(".")
            tables[table][key] = fit.values[figure.name]
    return prototype.but(
        actuator=prototype.actuator.but(**tables["actuator"]),
        servovalve=prototype.servovalve.but(**tables["servovalve"]),
        sensors=prototype.sensors.but(**{key: value for key, value in readings.items() if value is not None}),
        effects=dict(prototype.effects) | effects,
    )


REPLAYED = ("displacement_m", "pressure_a_Pa", "pressure_b_Pa")


@dataclass(frozen=True)
class ReplayError:
    """One condition. Root mean square errors by channel, over the stroke or the supply pressure.

    Attributes:
        condition: its name.
        before: of the prototype as it was believed.
        after: with the chosen causes, fitted without this condition.
        floor: half the mean square difference of replicates, as its root; NaN with one replicate.
    """

    condition: str
    before: dict[str, float]
    after: dict[str, float]
    floor: dict[str, float]


def replay_errors(data: BenchSet, chosen: HeldOut) -> tuple[ReplayError, ...]:
    """Simulate every condition under its recorded command and compare with all its runs.

    The reading of the displacement at the retracted stop is taken from the record: it is where the sensor was mounted,
    and neither model speaks of it.
    """
    found = []
    for condition in data.conditions:
        runs = [run for run in data.runs if run.condition == condition]
        after = amended(data.prototype, chosen.without[condition])
        found.append(
            ReplayError(condition, _errors(data.prototype, runs), _errors(after, runs), _floor(data.prototype, runs))
        )
    return tuple(found)


def simulated(prototype: BenchPrototype, run: BenchRun) -> np.ndarray:
    """A run's record as `prototype` makes it, columns as in `BENCH_COLUMNS`, read by the run's own sensor."""
    zero, top = float(np.median(run.displacement_m[held(run, -1)])), float(np.max(run.displacement_m))
    sensors = prototype.sensors.but(displacement_zero_m=zero, displacement_most_m=top)
    return replay(prototype.but(sensors=sensors), run.times, run.command_V)


def _channels(prototype: BenchPrototype, run: BenchRun) -> dict[str, tuple[np.ndarray, float]]:
    """Measured channels of a run, and what their errors are told over."""
    return {
        "displacement_m": (run.displacement_m, prototype.actuator.stroke_m),
        f"pressure_{run.side}_Pa": (run.pressure_Pa, prototype.actuator.supply_pressure_Pa),
    }


def _errors(prototype: BenchPrototype, runs: list[BenchRun]) -> dict[str, float]:
    squares: dict[str, list[float]] = {channel: [] for channel in REPLAYED}
    made: dict[bytes, np.ndarray] = {}
    for run in runs:
        key = run.command_V.tobytes()
        if key not in made:
            made[key] = simulated(prototype, run)
        for channel, (measured, over) in _channels(prototype, run).items():
            error = made[key][:, BENCH_COLUMNS.index(channel)] - measured
            squares[channel].append(float(np.mean(error**2)) / over**2)
    return {channel: float(np.sqrt(np.mean(values))) for channel, values in squares.items()}


def _floor(prototype: BenchPrototype, runs: list[BenchRun]) -> dict[str, float]:
    squares: dict[str, list[float]] = {channel: [] for channel in REPLAYED}
    for k, one in enumerate(runs):
        for other in runs[k + 1 :]:
            theirs = _channels(prototype, other)
            for channel, (measured, over) in _channels(prototype, one).items():
                if channel in theirs and len(theirs[channel][0]) == len(measured):
                    squares[channel].append(float(np.mean((theirs[channel][0] - measured) ** 2)) / 2 / over**2)
    return {c: float(np.sqrt(np.mean(values))) if values else float("nan") for c, values in squares.items()}
