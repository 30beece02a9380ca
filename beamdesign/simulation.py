"""Time records of a prototype's rig with its controller in the loop, and the oscillations at their ends.

A controller may work at sample times: held current, quantised volts, whole periods of delay.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from io import StringIO
from math import ceil, log
from pathlib import Path

import numpy as np

from beamdesign.controllers import SENSED, Controller
from beamdesign.files import write_whole
from beamdesign.plant.actuators import KINDS
from beamdesign.plant.assembly import OUTPUTS, Assembly, Structure, assemble, parameters_of, structure_of
from beamdesign.plant.compiled import NOT_SAMPLED, integrate, refuse_too_many, substeps_at
from beamdesign.plant.equilibrium import equilibrium
from beamdesign.plant.stepper import COMMAND, ERROR
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.result import Result
from beamdesign.scenario import Scenario, ScenarioRecord, inputs_of
from beamdesign.structure.lumped import figures


@dataclass(frozen=True)
class SampledLaw:
    """z+ = A z + B e, i = C z + D e at every sample: the difference equation that a specification states.

    Attributes:
        matrix: (n + 1, n + k), A and B above C and D.
        sensed: what each of the k readings is: `ERROR`, `COMMAND` or a place among the rig's outputs.
    """

    matrix: np.ndarray
    sensed: tuple[int, ...]

    def step(self, state: np.ndarray, readings: np.ndarray) -> tuple[np.ndarray, float]:
        """State (n,) after, and current (A) of, one sample."""
        after = self.matrix @ np.concatenate([state, readings])
        return after[:-1], float(after[-1])

    def readings(self, outputs: np.ndarray) -> np.ndarray:
        """(k,) what it hears of a row of the rig's outputs, without command."""
        known = {ERROR: -outputs[OUTPUTS.index("measured_V")], COMMAND: 0.0}
        return np.array([known[place] if place < 0 else outputs[place] for place in self.sensed])

    def at_rest(self, readings: np.ndarray) -> np.ndarray:
        """State (n,) under constant readings."""
        n = len(self.matrix) - 1
        return np.asarray(np.linalg.solve(np.eye(n) - self.matrix[:n, :n], self.matrix[:n, n:] @ readings))

    def after(self, readings: np.ndarray, current: float) -> np.ndarray:
        """State (n,) after a sample of these readings that gave this current: of first order at most there is one."""
        n = len(self.matrix) - 1
        own, through = self.matrix[n, :n], self.matrix[n, n:]
        before = np.linalg.pinv(own.reshape(1, n)) @ np.array([current - through @ readings])
        return self.step(before, readings)[0]

    def packed(
        self, period_steps: int, delay_periods: int, least_volt: float, state: np.ndarray, current: float
    ) -> np.ndarray:
        """As `beamdesign.plant.compiled.integrate` takes it.

        Args:
            period_steps: integration steps per period.
            delay_periods: whole periods between reading a sample and giving its current.
            least_volt: step of the converter that reads the sensor, V; 0 for none.
            state: (n,) at the first sample.
            current: before the record, A.
        """
        head = [period_steps, delay_periods, least_volt, current, len(self.matrix) - 1, len(self.sensed), *self.sensed]
        return np.concatenate([head, self.matrix.ravel(), state])


def sampled_law(controller: Controller, period_s: float) -> SampledLaw:
    """The difference equation of a controller at a period.

    Raises:
        ValueError: where it has none; see `beamdesign.build.realisation.law.difference_equation`.
    """
    from beamdesign.build.realisation.law import difference_equation
    from beamdesign.proofs.mass_family import floats

    law = difference_equation(controller, 1 / period_s).linear
    places = {SENSED[0]: ERROR, "command_V": COMMAND}
    places |= {kind.feels[0]: OUTPUTS.index("load_pressure_Pa") for kind in KINDS.values()}
    sensed = tuple(places[name] if name in places else OUTPUTS.index(name) for name in law.sensed)
    return SampledLaw(np.block([[floats(law.a), floats(law.b)], [floats(law.c), floats(law.d)]]), sensed)


@dataclass(frozen=True)
class Oscillation:
    """An oscillation about whatever slower motion carries it.

    Attributes:
        frequency_Hz: mean over the turning points looked at.
        amplitude: half the last swing, in the signal's unit.
        growth_per_s: exponential rate; negative where it dies out.
    """

    frequency_Hz: float
    amplitude: float
    growth_per_s: float


def oscillation(times: np.ndarray, signal: np.ndarray, turns: int | None = None) -> Oscillation | None:
    """The oscillation at the end of a record, from its turning points; None where there are fewer than six.

    Args:
        times: (N,) equally spaced, s.
        signal: (N,).
        turns: how many of the last turning points to look at; all of them by default.
    """
    slope = np.diff(signal)
    at = np.nonzero(slope[:-1] * slope[1:] < 0)[0]
    at = at if turns is None else at[-turns:]
    if len(at) < 6:
        return None
    # The turning point between samples, by a parabola through three.
    bend = slope[at + 1] - slope[at]
    share = -(slope[at] + slope[at + 1]) / (2 * bend)
    when = times[at + 1] + share * (times[1] - times[0])
    height = signal[at + 1] - bend * share**2 / 2
    swings = np.abs(np.diff(height)) / 2
    middle = (when[1:] + when[:-1]) / 2
    frequency = (len(when) - 1) / (2 * (when[-1] - when[0]))
    growth = float(np.polyfit(middle - middle.mean(), np.log(np.maximum(swings, 1e-300)), 1)[0])
    return Oscillation(float(frequency), float(swings[-1]), growth)


def sustained(times: np.ndarray, signal: np.ndarray, least_amplitude: float, forced: bool) -> Oscillation | None:
    """The oscillation of a record whose inputs are constant, unless it dies out.

    Args:
        times: (N,) s.
        signal: (N,) under constant inputs.
        least_amplitude: below this it counts as died out.
        forced: whether something in the rig keeps shaking it, so that only growth counts.
    """
    half = len(times) // 2
    late = oscillation(times[half:], signal[half:])
    if late is None or late.amplitude < least_amplitude:
        return None
    span = times[-1] - times[half]
    least = log(1.05) / span if forced else log(0.95) / span
    return late if late.growth_per_s > least else None


COLUMNS = (
    "t_s",
    "disturbance_N",
    "command_V",
    "current_A",
    "displacement_m",
    "load_pressure_Pa",
    "inner_displacement_m",
)
_STEPS_PER_RADIAN = 1.0
_WALL_STEPS_PER_RADIAN = 4.0
_TEST_LOAD_N = 1000.0
_LEAST_AMPLITUDE_M = 1e-8


@dataclass(frozen=True)
class SimulatedRecord:
    """One record.

    Attributes:
        name: as in the scenario.
        samples: (M, 7) columns as in `COLUMNS`, and behind them what else `columns` names; it ends where the loop
            diverged.
        stable: whether it stayed within bounds and any oscillation under constant inputs died out.
        reason: why not, in words; empty where stable.
        diverged_at_s: when the tip passed the scenario's limit; None where it did not.
        oscillation: of the displacement where not stable, None where its turns are too few to tell.
        columns: what the samples are of; in the place of the load pressure what another actuator feels.
        changes: (time in s, number from 1) of every change to another law of several.
    """

    name: str
    samples: np.ndarray = field(repr=False)
    stable: bool
    reason: str = ""
    diverged_at_s: float | None = None
    oscillation: Oscillation | None = None
    columns: tuple[str, ...] = COLUMNS
    changes: tuple[tuple[float, int], ...] = ()

    def column(self, name: str) -> np.ndarray:
        """(M,) one of its columns."""
        return np.asarray(self.samples[:, self.columns.index(name)])


@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """All records of a scenario."""

    records: tuple[SimulatedRecord, ...]

    @property
    def stable(self) -> bool:
        """Whether every record is."""
        return all(record.stable for record in self.records)


def simulate(prototype: Prototype, scenario: Scenario) -> Simulation:
    """Simulate the records of a scenario.

    Args:
        prototype: rig with its effects and, unless every record brings its own, a controller.
        scenario: what is done to it.

    Raises:
        InputError: where the prototype has no controller or an effect that cannot be, where no equilibrium is found
            from which to start, or for what its controller cannot be put through, as a payload that is to change.
    """
    runs = [(prototype.but(controller=row.controller or prototype.controller), row) for row in scenario.record]
    if wrong := dict.fromkeys(problem for rig, row in runs for problem in _unfit(rig, scenario, row)):
        raise InputError(scenario.name, list(wrong))
    felt = {"load_pressure_Pa": prototype.actuator.feels[0]}
    found = [_simulated(rig, scenario, row, k) for k, (rig, row) in enumerate(runs)]
    return Simulation(tuple(replace(one, columns=tuple(felt.get(c, c) for c in one.columns)) for one in found))


def _unfit(rig: Prototype, scenario: Scenario, row: ScenarioRecord) -> list[Problem]:
    """What of a record its controller cannot be put through."""
    if rig.schedule is not None:
        from beamdesign.controllers.scheduling import unfit

        return unfit(scenario, row, rig.schedule)
    words = "is for a scheduled controller"
    return [] if row.payload_change is None else [Problem(f"record.{row.name}.payload_change", words)]


def half_steps(samples: np.ndarray, substeps: int) -> np.ndarray:
    """Samples interpolated to every half integration step by cubics through four neighbours.

    Args:
        samples: (N, m), N at least 4.
        substeps: steps per sample interval.

    Returns:
        (2 substeps (N - 1) + 1, m), the samples themselves among them.
    """
    share = np.arange(2 * substeps) / (2 * substeps)
    nodes = np.array([-1.0, 0.0, 1.0, 2.0])
    weights = np.ones((len(share), 4))
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= (share - nodes[j]) / (nodes[i] - nodes[j])
    # At both ends the neighbour that is missing lies on the cubic through the first (last) four samples.
    ghost = np.array([4.0, -6.0, 4.0, -1.0])
    padded = np.vstack([ghost @ samples[:4], samples, ghost @ samples[:-5:-1]])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 4, axis=0)
    fine = np.einsum("nmk,sk->nsm", windows, weights, optimize=True).reshape(-1, samples.shape[1])
    return np.vstack([fine, samples[-1:]])


def substeps_for(assembly: Assembly, parameters: np.ndarray, times: np.ndarray) -> int:
    """Integration steps per sample of a record: one per radian of the fastest pole at rest and under load.

    Raises:
        InputError: where the record would take too many; see `beamdesign.plant.compiled`.
    """
    places = []
    for load in (0.0, _TEST_LOAD_N, -_TEST_LOAD_N):
        u = np.array([load, 0.0, 0.0])
        try:
            places.append((equilibrium(assembly, u, parameters), u))
        except ValueError:
            continue
    return substeps_at(assembly, places, parameters, times, _STEPS_PER_RADIAN)


def _simulated(rig: Prototype, scenario: Scenario, row: ScenarioRecord, position: int) -> SimulatedRecord:
    if rig.schedule is not None:
        from beamdesign.controllers.scheduling import simulate_stages

        return simulate_stages(rig, scenario, row, position)
    walled = row.wall is not None
    kinds = replace(structure_of(rig, scenario.sampled is not None), wall=walled)
    assembly = assemble(kinds)
    inner = row.inner_end_mass_kg
    inner = rig.payload.inner_end_mass_kg if inner is None else inner
    wall = () if row.wall is None else row.wall.model_dump().values()  # in the order of `plant.rigs.WALL_FIGURES`
    parameters = np.array([*parameters_of(rig, row.outer_end_mass_kg, inner).values(), *wall])

    times, inputs = scenario.times, inputs_of(row, scenario)
    before = np.array([row.preload_N if scenario.start == "loaded" else 0.0, 0.0, 0.0])
    continuous = assemble(replace(structure_of(rig), wall=walled))
    try:
        start = equilibrium(continuous, before, parameters)
    except ValueError as error:
        raise InputError(rig.name, [(f"record.{row.name}", str(error))]) from error
    substeps = max(substeps_for(continuous, parameters, times), _wall_substeps(rig, row, times))
    inputs[:, 0] += row.preload_N

    digital = NOT_SAMPLED
    if scenario.sampled is not None and rig.controller is not None:
        y = np.asarray(continuous.function(0.0, start, before, parameters)[1]).ravel()
        start = start[[continuous.states.index(name) for name in assembly.states]]
        steps = round(scenario.sampled.period_s / scenario.sample_s) * substeps
        try:
            law = sampled_law(rig.controller, steps * scenario.sample_s / substeps)
        except ValueError as error:
            raise InputError(scenario.name, [("sampled.period_s", str(error))]) from error
        readings = law.readings(y)
        rest = law.at_rest(readings)
        sampled = scenario.sampled
        digital = law.packed(steps, sampled.delay_periods, sampled.least_volt_V, rest, law.step(rest, readings)[1])
    y, _ = integrate(
        kinds, times, half_steps(inputs, substeps), start, parameters, substeps, scenario.displacement_limit_m, digital
    )
    count = len(y)
    samples = np.column_stack([times[:count], inputs[:count], y[:, :4]])
    return _judged(row, scenario, as_measured(samples, scenario, position), samples, inputs, kinds)


def _wall_substeps(rig: Prototype, row: ScenarioRecord, times: np.ndarray) -> int:
    """Steps per sample with which a bounce of the outer beam's mass alone on the wall keeps its energy to 1e-3."""
    if row.wall is None:
        return 1
    mass = figures(rig)["outer_mass"] + row.outer_end_mass_kg
    fastest = max((row.wall.stiffness_N_per_m / mass) ** 0.5, row.wall.damping_N_s_per_m / mass)
    needed = (times[1] - times[0]) * _WALL_STEPS_PER_RADIAN * fastest
    reason = f"{mass:g} kg bounces at {fastest / (2 * np.pi):.3g} Hz"
    refuse_too_many(needed * len(times), f"record.{row.name}.wall.stiffness_N_per_m", reason)
    return ceil(needed)


def _judged(
    row: ScenarioRecord,
    scenario: Scenario,
    measured: np.ndarray,
    samples: np.ndarray,
    inputs: np.ndarray,
    kinds: Structure,
) -> SimulatedRecord:
    """Say whether a record is one of a stable loop."""
    times, displacement = samples[:, 0], samples[:, COLUMNS.index("displacement_m")]
    if len(samples) < len(inputs):
        ended = diverged(row.name, samples, scenario.displacement_limit_m, scenario.sample_s)
        return replace(ended, samples=measured)
    moving = np.nonzero(np.any(np.diff(inputs, axis=0) != 0, axis=1))[0]
    quiet = int(moving[-1]) + 1 if len(moving) else 0
    found = None
    if len(samples) - quiet > 20:
        shaken = any(assemble(kinds).function.which_depends("t", ["rate"]))
        found = sustained(times[quiet:], displacement[quiet:], _LEAST_AMPLITUDE_M, shaken)
    if found is None:
        return SimulatedRecord(row.name, measured, True)
    how = "grows" if found.growth_per_s > 0 else "does not die out"
    reason = f"under constant inputs an oscillation at {found.frequency_Hz:.4g} Hz {how}"
    return SimulatedRecord(row.name, measured, False, reason, None, found)


def diverged(name: str, samples: np.ndarray, limit_m: float, sample_s: float) -> SimulatedRecord:
    """A record whose samples (M, 7 or more) end where the tip passed a limit."""
    found = None
    if len(samples) > 8:
        found = oscillation(samples[:, 0], samples[:, COLUMNS.index("displacement_m")], turns=20)
    at = len(samples) * sample_s
    how = "" if found is None else f", oscillating at {found.frequency_Hz:.4g} Hz"
    reason = f"the outer tip passed {limit_m:g} m at {at:.4g} s{how}"
    return SimulatedRecord(name, samples, False, reason, at, found)


def as_measured(samples: np.ndarray, scenario: Scenario, position: int) -> np.ndarray:
    """Samples as the instruments give them; a seed gives the same noise whatever other records there are."""
    given = scenario.measurement
    random = np.random.default_rng([given.seed, position])
    measured = samples.copy()
    for name, deviation in (
        ("disturbance_N", given.disturbance_std_N),
        ("current_A", given.current_std_A),
        ("displacement_m", given.displacement_std_m),
    ):
        measured[:, COLUMNS.index(name)] += deviation * random.standard_normal(len(samples))
    if given.displacement_step_m > 0:
        column = COLUMNS.index("displacement_m")
        measured[:, column] = given.displacement_step_m * np.round(measured[:, column] / given.displacement_step_m)
    return measured


def write_tables(tables: Mapping[str, tuple[tuple[str, ...], np.ndarray]], folder: Path) -> list[Path]:
    """Write one CSV file per table of columns (C) and samples (N, C), named after it, each whole or not at all.

    Raises:
        OSError: naming what cannot be written.
    """
    paths = [folder / f"{name}.csv" for name in tables]
    for (columns, table), path in zip(tables.values(), paths, strict=True):
        text = StringIO()
        np.savetxt(text, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
        write_whole(path, text.getvalue())
    return paths
