"""Recorded runs of a bench beside their simulation, by the bench's prototype with what a diagnosis has found in it."""

from dataclasses import dataclass

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.bench_simulation import BENCH_COLUMNS, replay
from beamdesign.gap.bench.data import BenchRun, BenchSet, held
from beamdesign.gap.bench.fit import HeldOut, SteadyFit

_LEAST_COULOMB_N = 0.0


def parameters(prototype: BenchPrototype, fit: SteadyFit) -> dict[str, dict[str, tuple[float, float]]]:
    """Value and standard deviation of every parameter of a fit's causes, by contract names, SI."""
    amplifier = prototype.servovalve.amplifier_A_per_V
    named = {
        "unequal_piston_areas": {"asymmetry": ("asymmetry", 1.0)},
        "pressure_dependent_flow": {"supply_pressure_Pa": ("supply_pressure", 1.0)},
        "valve_deadband": {"half_width_A": ("deadband_V", amplifier)},
        "seal_friction": {
            "coulomb_N": ("coulomb_N", 1.0),
            "viscous_N_s_per_m": ("viscous", 1.0),
            "breakaway_ratio": ("breakaway_ratio", 1.0),
            "stribeck_m_per_s": ("stribeck_m_per_s", 1.0),
        },
        "parameter:piston_leakage": {"piston_leakage_m3_per_s_per_Pa": ("piston_leakage", 1.0)},
        "parameter:line_loss": {"line_loss_Pa_s2_per_m6": ("line_loss", 1.0)},
        "parameter:edge_b": {"edge_b_ratio": ("edge_b", 1.0)},
        "parameter:constant_load": {"constant_load_N": ("constant_load_N", 1.0)},
        "parameter:flow_gain": {"flow_gain_m3_per_s_per_V": ("flow_gain", 1.0)},
    }
    return {
        name: {
            key: (factor * fit.values[own], factor * fit.std[own])
            for key, (own, factor) in table.items()
            if own in fit.values
        }
        for name, table in named.items()
        if name in fit.hypothesis.names
    }


def amended(prototype: BenchPrototype, fit: SteadyFit, **readings: float | None) -> BenchPrototype:
    """The prototype with a fit's causes as effects and its figures in place of the believed ones.

    Args:
        prototype: what was believed.
        fit: of what is held responsible.
        readings: figures of its sensors that the data show; None: as believed.
    """
    found = {
        name: {key: value for key, (value, _) in table.items()} for name, table in parameters(prototype, fit).items()
    }
    effects = {name: table for name, table in found.items() if not name.startswith("parameter:")}
    if "seal_friction" in effects:
        effects["seal_friction"].setdefault("coulomb_N", _LEAST_COULOMB_N)
    value = fit.values
    actuator = prototype.actuator.but(
        piston_area_m2=value["piston_area"],
        supply_pressure_Pa=value["supply_pressure"],
        tank_pressure_Pa=value["tank_pressure"],
        piston_leakage_m3_per_s_per_Pa=value.get("piston_leakage", prototype.actuator.piston_leakage_m3_per_s_per_Pa),
        line_loss_Pa_s2_per_m6=value.get("line_loss", prototype.actuator.line_loss_Pa_s2_per_m6),
        constant_load_N=value.get("constant_load_N", prototype.actuator.constant_load_N),
    )
    valve = prototype.servovalve.but(
        flow_gain_m3_per_s_per_V=value["flow_gain"],
        edge_b_ratio=value.get("edge_b", prototype.servovalve.edge_b_ratio),
    )
    sensors = prototype.sensors.but(**{key: value for key, value in readings.items() if value is not None})
    return prototype.but(
        actuator=actuator, servovalve=valve, sensors=sensors, effects=dict(prototype.effects) | effects
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
