"""An actuator on a bench, simulated: the figures of its rig, and what piston and chambers do under a command."""

from collections.abc import Iterator
from math import pi
from operator import attrgetter

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.plant.assembly import Assembly, Structure, assemble, effect_figures, wrong_effects
from beamdesign.plant.compiled import integrate
from beamdesign.plant.equilibrium import Place, substeps_at, supply_Pa
from beamdesign.plant.rigs import BENCH_STATED
from beamdesign.records import InputError, Problem
from beamdesign.scenario import Scenario, inputs_of

BENCH_COLUMNS = ("t_s", "command_V", "displacement_m", "pressure_a_Pa", "pressure_b_Pa")
_STEPS_PER_RADIAN = 0.5  # classical Runge-Kutta is stable to 2.78 radians of a decaying pole
_BOUND = 2.0  # strokes: end stops hold the piston, so that only a failed integration passes this
_STOP_DAMPING_RATIO = 0.5
_SENSED = (
    "filtered_V", "sensor_lag.lagged_V", "sensor_lag_second_order.lagged_V", "transport_delay.smooth_V",
    "empirical_sensor_lag.late", "empirical_sensor_resonance.seen", "empirical_sensor_play.followed",
)  # fmt: skip
"""States that stand at the volts of the sensor while the piston stands."""
SENSOR_V_PER_M = 50.0
"""Volts of the displacement sensor; effects in volts count on it, nothing else does."""


def bench_structure(prototype: BenchPrototype) -> Structure:
    """What decides the equations of a bench.

    Raises:
        InputError: where an effect or one of its parameters is unknown, out of bounds or not for a bench.
    """
    if wrong := wrong_effects(prototype):
        raise InputError(prototype.name, wrong)
    filtered = prototype.sensors.displacement_filter_Hz is not None
    return Structure(None, filtered, tuple(sorted(prototype.effects)), prototype.rig)


def bench_parameters(prototype: BenchPrototype) -> dict[str, float]:
    """Parameters of the bench's assembly in its order, SI: figures of the rig and of its effects."""
    actuator, valve, sensors = prototype.actuator, prototype.servovalve, prototype.sensors
    stop = (actuator.stop_stiffness_N_per_m * actuator.moving_mass_kg) ** 0.5
    stated: dict[str, float] = {name: attrgetter(place)(prototype) for name, place in BENCH_STATED.items()}
    worked_out = {
        "stop_damping": 2 * _STOP_DAMPING_RATIO * stop,
        "flow_gain": valve.flow_gain_m3_per_s_per_V / valve.amplifier_A_per_V,
        "valve_frequency": 2 * pi * valve.natural_frequency_Hz,
        "sensor_gain": SENSOR_V_PER_M,
        "believed_sensor_gain": SENSOR_V_PER_M,
        "filter_frequency": 2 * pi * (sensors.displacement_filter_Hz or 1.0),
        "pressure_filter_frequency": 2 * pi * sensors.pressure_filter_Hz,
    }
    return stated | worked_out | effect_figures(prototype)


def bench_start(prototype: BenchPrototype, start_m: float | None = None) -> np.ndarray:
    """(n,) states of a piston that stands still under no command.

    Args:
        prototype: the bench.
        start_m: where it stands, from the retracted stop. None: against that stop, the cap's chamber at tank and the
            rod's at supply pressure, as a retraction leaves them. Elsewhere the chambers share the supply, without
            force.

    Raises:
        InputError: where the piston would stand beyond its stops.
    """
    structure = bench_structure(prototype)
    states, actuator = assemble(structure).states, prototype.actuator
    figure, tank, stroke = bench_parameters(prototype), actuator.tank_pressure_Pa, actuator.stroke_m
    supply = supply_Pa(figure)
    asymmetry = figure.get("unequal_piston_areas.asymmetry", 0.0)
    x = dict.fromkeys(states, 0.0)
    if start_m is None:
        pressure_a, pressure_b = tank, supply
        held = supply * actuator.piston_area_m2 * (1 - asymmetry) - tank * actuator.piston_area_m2 * (1 + asymmetry)
        x["piston_m"] = -held / actuator.stop_stiffness_N_per_m
    elif start_m <= stroke:
        total = supply + tank
        pressure_a, pressure_b = total / 2 * (1 - asymmetry), total / 2 * (1 + asymmetry)
        x["piston_m"] = start_m
    else:
        raise InputError(prototype.name, [("start_m", f"{start_m:g} is beyond the stroke, {stroke:g} m")])
    x["pressure_a_Pa"] = x["seen_a_Pa"] = pressure_a
    x["pressure_b_Pa"] = x["seen_b_Pa"] = pressure_b
    volts = (x["piston_m"] + prototype.sensors.displacement_zero_m) * figure["sensor_gain"]
    x |= {name: volts for name in _SENSED if name in x}
    return np.array(list(x.values()))


def replay(
    bench: BenchPrototype, times: np.ndarray, command_V: np.ndarray, start_m: float | None = None, load_N: float = 0.0
) -> np.ndarray:
    """Simulate a bench under a recorded command, taken to go straight from sample to sample.

    Args:
        bench: with its effects.
        times: (N,) equally spaced, s.
        command_V: (N,).
        start_m: see `bench_start`.
        load_N: constant force on the rod, positive extending.

    Returns:
        (N, 5) columns as in `BENCH_COLUMNS`.

    Raises:
        InputError: for effects that cannot be, and where the equations are too stiff for the step.
    """
    structure = bench_structure(bench)
    assembly = assemble(structure)
    parameters = np.array(list(bench_parameters(bench).values()))
    start = bench_start(bench, start_m)
    places = _stiff_places(assembly, parameters, start, command_V)
    substeps = substeps_at(assembly, places, parameters, times, _STEPS_PER_RADIAN)
    fine = np.arange(2 * substeps * (len(times) - 1) + 1) / (2 * substeps)
    inputs = np.zeros((len(fine), 2))
    inputs[:, 0] = load_N
    inputs[:, 1] = np.interp(fine, np.arange(len(times)), command_V)
    bound = _BOUND * bench.actuator.stroke_m
    y, _ = integrate(structure, times, inputs, start, parameters, substeps, bound)
    if len(y) < len(times):
        raise InputError(bench.name, [("(figures)", "the simulation fails: its equations are too stiff")])
    most = bench.sensors.displacement_most_m
    displacement = y[:, 1] if most is None else np.minimum(y[:, 1], most)
    return np.column_stack([times, command_V, displacement, y[:, 2], y[:, 3]])


def simulate_bench(prototype: BenchPrototype, scenario: Scenario) -> dict[str, np.ndarray]:
    """Simulate the records of a scenario, whose inputs are commands and, as preload, a force on the rod.

    Returns:
        by record, (N, 5) columns as in `BENCH_COLUMNS`.

    Raises:
        InputError: for effects that cannot be, and for what the scenario asks and a bench does not have.
    """
    bench_structure(prototype)  # which refuses these
    wrong: list[Problem] = []
    if scenario.sampled is not None:
        wrong.append(Problem("sampled", "a bench has no controller"))
    if scenario.measurement != type(scenario.measurement)():
        wrong.append(Problem("measurement", "instrument noise is made for twin beams only"))
    driven = {}
    for row in scenario.record:
        given = inputs_of(row, scenario)
        if np.any(given[:, 0]):
            wrong.append(Problem(f"record.{row.name}.input", "a bench takes command_V; give a force as preload_N"))
        if row.controller is not None:
            wrong.append(Problem(f"record.{row.name}.controller", "a bench has no controller"))
        if row.outer_end_mass_kg or row.inner_end_mass_kg:
            wrong.append(Problem(f"record.{row.name}", "a bench has no beams and no end masses"))
        given_too = (key for key in ("wall", "payload_change") if getattr(row, key) is not None)
        wrong.extend(Problem(f"record.{row.name}.{key}", "is for a twin beam") for key in given_too)
        driven[row.name] = given[:, 1], row.start_m, row.preload_N
    if wrong:
        raise InputError(scenario.name, wrong)
    return {name: replay(prototype, scenario.times, *how) for name, how in driven.items()}


def _stiff_places(
    assembly: Assembly, parameters: np.ndarray, start: np.ndarray, command: np.ndarray
) -> Iterator[Place]:
    """Where the equations are stiffest: at either stop, with the valve open."""
    place = {name: k for k, name in enumerate(assembly.states)}
    figure = dict(zip(assembly.parameters, parameters, strict=True))
    supply, tank = supply_Pa(figure), figure["tank_pressure"]
    volts = float(np.abs(command - figure["null"]).max())
    for sign, where, pressures in ((1.0, figure["stroke"], (supply, tank)), (-1.0, 0.0, (tank, supply))):
        for pressed in (1e-5, -1e-5):
            for share in (0.0, 0.01, 0.5):  # of the way from the stall to the middle
                x = start.copy()
                x[place["piston_m"]] = where + sign * pressed
                x[place["flow_m3_per_s"]] = sign * figure["flow_gain"] * figure["gain"] * volts
                for side, pressure in zip("ab", pressures, strict=True):
                    x[place[f"pressure_{side}_Pa"]] = pressure + share * (supply + tank - 2 * pressure)
                yield x, np.array([0.0, sign * volts, 0.0])
