"""What a bench's diagnosis holds beside any other: its prototype amended, records simulated, motion by condition."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.bench.data import BenchRun, BenchSet, held
from beamdesign.diagnosis.bench.fit import HeldOut, SteadyFit
from beamdesign.diagnosis.bench.hypothesis import FIGURES, NOTHING, parameters
from beamdesign.diagnosis.bench.motions import SteadyMotion, steady
from beamdesign.diagnosis.diagnosis import Cause, Diagnosis, Indicator, NextExperiment, RecordGap, Where
from beamdesign.diagnosis.fitting.hypothesis import WRONG
from beamdesign.plant.bench_simulation import BENCH_COLUMNS, replay

_LEAST_COULOMB_N = 0.0


def updated_prototype(prototype: BenchPrototype, fit: SteadyFit, **readings: float | None) -> BenchPrototype:
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
        after = updated_prototype(data.prototype, chosen.without[condition])
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


@dataclass(frozen=True)
class ConditionRow:
    """What one condition says in one direction.

    Attributes:
        condition: name.
        direction: 1 extending, -1 retracting.
        command_V: while it moves.
        speed: m/s, mean of all runs.
        pressures: Pa, of chambers a and b.
        net_force_N: A_a p_a - A_b p_b with the areas of bore and rod: what friction and load take.
        opening: m3/s per root of Pa, flow over root of pressure drop of the edges (filling, emptying); they are alike
            where orifices and areas are the whole story.
        predicted: speed and both pressures by the chosen causes, fitted without this condition.
    """

    condition: str
    direction: int
    command_V: float
    speed: float
    pressures: tuple[float, float]
    net_force_N: float
    opening: tuple[float, float]
    predicted: tuple[float, float, float]


@dataclass(frozen=True)
class BenchDiagnosis(Diagnosis[BenchPrototype]):
    """A diagnosis from steady motions; its gap is that of these on conditions held out.

    Its rows are of simulated records, by condition and channel; nothing lies between believed and diagnosed there.

    Attributes:
        ranked: sets of causes that were fitted, most probable first.
        table: by condition and direction.
        replay: errors of the simulated records, before and after, on conditions held out.
    """

    MEASURE = (
        "Together: relative errors of steady speed and of chamber pressures over the supply, each condition predicted"
        " from the others. By condition: errors of the simulated records over the stroke or the supply pressure."
    )

    ranked: tuple[HeldOut, ...] = field(default=(), repr=False)
    table: tuple[ConditionRow, ...] = field(default=(), repr=False)
    replay: tuple[ReplayError, ...] = field(default=(), repr=False)

    @property
    def confirmed(self) -> bool:
        """Whether the replay is better with the chosen causes on every condition and in every channel."""
        return all(each.after[channel] < each.before[channel] for each in self.replay for channel in each.before)


def condition_rows(
    prototype: BenchPrototype, motions: Sequence[SteadyMotion], chosen: HeldOut
) -> tuple[ConditionRow, ...]:
    """Steady motion by condition and direction, beside that of the fit without the condition."""
    actuator = prototype.actuator
    areas = {
        1: actuator.piston_area_m2 * (1 + actuator.asymmetry),
        -1: actuator.piston_area_m2 * (1 - actuator.asymmetry),
    }
    supply = float(np.mean([m.stall for m in motions if (m.direction > 0) == (m.side == "a")]))
    tank = float(np.mean([m.stall for m in motions if (m.direction > 0) == (m.side == "b")]))
    rows = []
    for condition, direction in dict.fromkeys((m.condition, m.direction) for m in motions):
        own = [m for m in motions if (m.condition, m.direction) == (condition, direction)]
        speeds = np.array([m.speed for m in own])
        a, b = (float(np.mean([m.pressure for m in own if m.side == side])) for side in "ab")
        full, empty = (a, b) if direction > 0 else (b, a)
        speed, volts = float(speeds.mean()), own[0].command_V
        into, out = areas[direction] * abs(speed), areas[-direction] * abs(speed)
        opening = (into / max(supply - full, 1.0) ** 0.5, out / max(empty - tank, 1.0) ** 0.5)
        fitted = chosen.without[condition]
        opened = volts - prototype.servovalve.null_V
        found = steady(NOTHING | fitted.values, np.array([opened]), fitted.hypothesis.orifices)
        rows.append(
            ConditionRow(
                condition,
                direction,
                volts,
                speed,
                (a, b),
                areas[1] * a - areas[-1] * b,
                opening,
                (float(found.speed[0]), float(found.pressure_a[0]), float(found.pressure_b[0])),
            )
        )
    return tuple(rows)


_NAMES = {1: "extending", -1: "retracting"}


def where_of(table: Sequence[ConditionRow], stroke_m: float, causes: Sequence[Cause], chosen: Sequence[str]) -> Where:
    """Steady motion is slow: the band ends at the strokes per second of the fastest condition."""
    fastest = max(abs(row.speed) for row in table) / stroke_m
    worst = max(table, key=lambda row: abs(row.predicted[0] - row.speed))
    place = next((c.subsystem for c in causes if c.name in chosen), "")
    shown: dict[str, tuple[object, ...]] = {
        "condition": tuple(row.condition for row in table),
        "direction": tuple(_NAMES[row.direction] for row in table),
        "speed_m_per_s": tuple(row.speed for row in table),
        "predicted_m_per_s": tuple(row.predicted[0] for row in table),
        "pressure_a_Pa": tuple(row.pressures[0] for row in table),
        "pressure_b_Pa": tuple(row.pressures[1] for row in table),
        "net_force_N": tuple(row.net_force_N for row in table),
    }
    text = (
        "Speed and pressures while the piston moves steadily, against those of the chosen causes fitted without each"
        f" condition; the largest error of speed is left at {worst.condition}, {_NAMES[worst.direction]}."
    )
    indicator = Indicator("steady motions", place, 1.0 if place else 0.0, text, shown)
    condition = "in steady motion, at every command that was tried"
    return Where(place, (0.0, float(f"{fastest:.3g}")), condition if place else "", "static", (indicator,))


def rows_of(replayed: Sequence[ReplayError]) -> tuple[RecordGap, ...]:
    """Errors of the simulated records, by condition and channel."""
    return tuple(
        RecordGap(f"{each.condition}, {key}", True, before, np.nan, each.after[key], float(each.floor.get(key, np.nan)))
        for each in replayed
        for key, before in each.before.items()
    )


def asked_for(separation: float, command_V: float, channel: str, ranked: Sequence[HeldOut]) -> NextExperiment:
    """A run at a command both ways, and the channel in which what is left differs there."""
    text = (
        f"Run the piston out and back at {command_V:.3g} V and measure {channel.replace('_', ' ')}:"
        " there the sets of causes that are left differ most."
    )
    names = tuple(" + ".join(each.hypothesis.names) or "no cause" for each in ranked[:4])
    return NextExperiment(text, names, separation, {"command_V": command_V, "channel": channel})
