"""Time records of a prototype's rig with its controller in the loop.

A controller may work at sample times: held current, quantised volts, whole periods of delay.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import ceil

import numpy as np

from beamdesign.arguments import takes
from beamdesign.bench_prototype import AnyPrototype, BenchPrototype
from beamdesign.controllers.scheduling import PayloadEstimator, next_stage
from beamdesign.oscillation import Oscillation, departing, oscillation, sustained
from beamdesign.plant.assembly import OUTPUTS, Assembly, Structure, assemble, parameters_of, structure_of
from beamdesign.plant.bench_simulation import BENCH_COLUMNS, simulate_bench
from beamdesign.plant.compiled import NOT_SAMPLED, half_steps, integrate, refined
from beamdesign.plant.equilibrium import equilibrium, linearise, refuse_too_many, substeps_for
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.result import Result
from beamdesign.sampling import sampled_law, sampled_stage
from beamdesign.scenario import COLUMNS, Course, Sampled, Scenario, ScenarioRecord, course_of, inputs_of
from beamdesign.structure import arm, lumped

_WALL_STEPS_PER_RADIAN = 4.0
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
        certain_until_s: up to which twice as many integration steps give the same, where they do not throughout: beyond
            it the course is one of many, as of motion that is chaotic, or stiffer than the steps tried.
    """

    name: str
    samples: np.ndarray = field(repr=False)
    stable: bool
    reason: str = ""
    diverged_at_s: float | None = None
    oscillation: Oscillation | None = None
    columns: tuple[str, ...] = COLUMNS
    changes: tuple[tuple[float, int], ...] = ()
    certain_until_s: float | None = None

    @property
    def uncertain(self) -> str:
        """Where its course is one of many, in words; empty where it is not."""
        if self.certain_until_s is None:
            return ""
        many = f"beyond {self.certain_until_s:.4g} s the course is one of many"
        return f"{many}: other steps of integration give another, as of motion that is chaotic or very stiff"

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

    @property
    def reason(self) -> str:
        """Which records are not, and why; empty where every record is."""
        return "; ".join(f"{record.name}: {record.reason}" for record in self.records if not record.stable)

    def rows(self) -> list[tuple[str, str, float, float | None]]:
        """Record, whether it is stable, largest displacement in m, and frequency in Hz of what does not die out."""
        return [
            (
                record.name,
                "yes" if record.stable else "no",
                float(abs(record.column("displacement_m")).max()),
                None if record.oscillation is None else record.oscillation.frequency_Hz,
            )
            for record in self.records
        ]


@takes("Prototype BenchPrototype", "Scenario")
def simulate(prototype: AnyPrototype, scenario: Scenario) -> Simulation:
    """Simulate the records of a scenario.

    Args:
        prototype: rig with its effects and, unless every record brings its own, a controller; or a bench, whose open
            loop stays between its end stops: of that every record is stable.
        scenario: what is done to it.

    Raises:
        InputError: where the prototype has no controller or an effect that cannot be, where no equilibrium is found
            from which to start, or for what its controller cannot be put through, as a payload that is to change.
    """
    if isinstance(prototype, BenchPrototype):
        made = simulate_bench(prototype, scenario)
        return Simulation(tuple(SimulatedRecord(*one, stable=True, columns=BENCH_COLUMNS) for one in made.items()))
    prototype = arm.in_plane(prototype)
    scenario = scenario.every(None if prototype.schedule is None else prototype.schedule.period_s)
    runs = [(prototype.but(controller=row.controller or prototype.controller), row) for row in scenario.record]
    for rig, _ in runs:
        structure_of(rig, True)  # which refuses effects that cannot be, and a rig without a controller
    if wrong := dict.fromkeys(problem for rig, row in runs for problem in _unfit(rig, scenario, row)):
        raise InputError(scenario.name, list(wrong))
    felt = {"load_pressure_Pa": prototype.actuator.feels[0]}
    found = [(_fixed if rig.schedule is None else _staged)(rig, scenario, row, k) for k, (rig, row) in enumerate(runs)]
    return Simulation(tuple(replace(one, columns=tuple(felt.get(c, c) for c in one.columns)) for one in found))


def _unfit(rig: Prototype, scenario: Scenario, row: ScenarioRecord) -> Iterator[Problem]:
    """What of a record its rig and its controller cannot be put through."""
    if row.start_m is not None:
        yield Problem(f"record.{row.name}.start_m", "is for an actuator bench")
    if (schedule := rig.schedule) is None:
        if row.payload_change is not None:
            yield Problem(f"record.{row.name}.payload_change", "is for a scheduled controller")
        return
    period = schedule.period_s
    is_to_be = f"must be the period of the scheduled controller, {period:g}"
    if abs(scenario.sample_s - period) > 1e-9:
        yield Problem("sample_s", f"{is_to_be}, is {scenario.sample_s:g}")
    if scenario.sampled not in (None, Sampled(period_s=period)):
        yield Problem("sampled", f"{is_to_be}, without delay and quantisation")
    if row.wall is not None:
        yield Problem(f"record.{row.name}.wall", "is not for a scheduled controller")
    if (change := row.payload_change) is not None and change.at_s >= (end := scenario.times[-1]):
        words = f"must be less than {end:g}, where the record ends, is {change.at_s:g}"
        yield Problem(f"record.{row.name}.payload_change.at_s", words)


def _at_rest(
    continuous: Assembly, states: tuple[str, ...], force_N: float, parameters: np.ndarray, limit_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and states of those named, with the rig at rest under a constant force on the tip.

    Raises:
        ValueError: where it has no equilibrium, or one beyond the displacement at which a loop has diverged.
    """
    u = np.array([force_N, 0.0, 0.0])
    x = equilibrium(continuous, u, parameters)
    y = np.asarray(continuous.function(0.0, x, u, parameters)[1]).ravel()
    if abs(at := y[OUTPUTS.index("outer_displacement_m")]) > limit_m:
        raise ValueError(f"rests at {at:.4g} m under {force_N:g} N, beyond the displacement limit, {limit_m:g} m")
    return y, x[[continuous.states.index(name) for name in states]]


def _fixed(rig: Prototype, scenario: Scenario, row: ScenarioRecord, position: int) -> SimulatedRecord:
    """Simulate a record, at a position in its scenario, of a rig whose controller has one law."""
    walled, sampled = row.wall is not None, scenario.sampled
    kinds = replace(structure_of(rig, sampled is not None), wall=walled)
    inner = rig.payload.inner_end_mass_kg if row.inner_end_mass_kg is None else row.inner_end_mass_kg
    wall = () if row.wall is None else row.wall.model_dump().values()  # in the order of `plant.rigs.WALL_FIGURES`
    parameters = np.array([*parameters_of(rig, row.outer_end_mass_kg, inner).values(), *wall])

    times, inputs = scenario.times, inputs_of(row, scenario)
    continuous = assemble(replace(structure_of(rig), wall=walled))
    before, limit = row.preload_N if scenario.start == "loaded" else 0.0, scenario.displacement_limit_m
    try:
        rest, start = _at_rest(continuous, assemble(kinds).states, before, parameters, limit)
    except ValueError as error:
        raise InputError(scenario.name, [(f"record.{row.name}", str(error))]) from error
    substeps = max(substeps_for(continuous, parameters, times), _wall_substeps(rig, row, times))
    inputs[:, 0] += row.preload_N

    law, periods = None, 0
    how: tuple[int, float, np.ndarray, float] = (0, 0.0, np.zeros(0), 0.0)
    if sampled is not None and rig.controller is not None:
        periods = round(sampled.period_s / scenario.sample_s)
        try:
            law = sampled_law(rig.controller, periods * scenario.sample_s)
        except ValueError as error:
            raise InputError(scenario.name, [("sampled.period_s", str(error))]) from error
        readings = law.readings(rest)
        z = law.at_rest(readings)
        how = sampled.delay_periods, sampled.least_volt_V, z, law.step(z, readings)[1]

    def course(factor: int) -> np.ndarray:
        fine = factor * substeps
        digital = NOT_SAMPLED if law is None else law.packed(periods * fine, *how)
        return integrate(kinds, times, half_steps(inputs, fine), start, parameters, fine, limit, digital)[0]

    y, same = refined(course, np.asarray, OUTPUTS, substeps * len(times))
    count = len(y)
    samples = np.column_stack([times[:count], inputs[:count], y[:, :4]])
    judged = _judged(row, scenario, samples, inputs, kinds)
    found = replace(judged, samples=scenario.measurement.of(samples, position))
    return found if same == count else replace(found, certain_until_s=float(times[same]))


def _staged(rig: Prototype, scenario: Scenario, row: ScenarioRecord, position: int) -> SimulatedRecord:
    """Simulate a record, at a position in its scenario, of a rig with a scheduled controller, from the first stage on.

    Law and estimator work at the schedule's period and hear the sensor with its noise where the prototype states it.
    Under noise nothing comes to rest, so that a record is called stable as long as the tip stays within the limit.
    """
    noise, seed = rig.sensor.noise_V or 0.0, scenario.measurement.seed + position
    course, limit, built = course_of(row, scenario), scenario.displacement_limit_m, rig
    if row.inner_end_mass_kg is not None:
        built = rig.but(payload=rig.payload.but(inner_end_mass_kg=row.inner_end_mass_kg))
    try:
        found = simulate_scheduled(rig, course, built, noise_V=noise, seed=seed, limit_m=limit)
    except ValueError as error:
        raise InputError(scenario.name, [(f"record.{row.name}", str(error))]) from error
    return replace(found, name=row.name, samples=scenario.measurement.of(found.samples, position))


STAGED = (*COLUMNS, "sensor_V", "outer_end_mass_kg", "stage", "estimate_kg", "estimate_std_kg")
"""Columns of a record with a scheduled controller."""
_MOVES = slice(COLUMNS.index("current_A"), len(COLUMNS))


def simulate_scheduled(
    rig: Prototype,
    course: Course,
    built: Prototype | None = None,
    first_stage: int = 0,
    adaptive: bool = True,
    noise_V: float = 0.0,
    seed: int = 0,
    limit_m: float = 0.02,
) -> SimulatedRecord:
    """Simulate a scheduled controller; the record has the columns `STAGED`, and is stable where it did not diverge.

    Law and estimator hear the sensor with its noise at sample times; the estimator believes the prototype of `rig`.

    Args:
        rig: the prototype with a controller that has several laws.
        course: what is done to it.
        built: the rig that really moves, with its effects; that of the prototype where left out.
        first_stage: that acts at first, from 0.
        adaptive: whether the stage follows the estimate; else it stays.
        noise_V: standard deviation of the sensor's noise.
        seed: of the noise.
        limit_m: displacement at which the loop has diverged.

    Raises:
        InputError: for effects that cannot be, and for a period that is too long for a law.
        ValueError: where there is no equilibrium to start from.
    """
    schedule = rig.schedule
    assert schedule is not None  # the caller has seen that there are several laws
    try:
        sampled = [sampled_stage(stage, schedule.period_s) for stage in schedule.stage]
    except ValueError as slow:
        raise InputError(rig.name, [("controller.period_s", str(slow))]) from slow
    plant = (built or rig).but(controller=schedule.stage[0].law)
    inner, period = plant.payload.inner_end_mass_kg, schedule.period_s
    kinds, continuous = structure_of(plant, True), assemble(structure_of(plant))
    moving, still = assemble(kinds), np.zeros(3)

    def figures(mass: float) -> np.ndarray:
        return np.array(list(parameters_of(plant, mass, inner).values()))

    count = len(course.force_N)
    times = np.arange(count) * period
    substeps = max(substeps_for(continuous, figures(mass), times) for _, mass in course.payload_kg)
    noise = noise_V * np.random.default_rng(seed).standard_normal(count)
    command = np.zeros(count) if course.command_V is None else course.command_V

    def run(factor: int) -> SimulatedRecord:
        fine = factor * substeps
        inputs = half_steps(np.column_stack([course.force_N, np.zeros(count)]), fine)
        inputs[:: 2 * fine, 1] = command - noise  # read at the samples of the law alone
        before, mass = course.force_N[0] if course.before_N is None else course.before_N, course.payload_kg[0][1]
        y, state = _at_rest(continuous, moving.states, before, figures(mass), limit_m)
        z = sampled[first_stage].whole.at_rest(np.array([-y[-1]]))
        passed = np.tile(sampled[first_stage].step(z, -float(y[-1]))[1], (2, 1))  # nothing has moved before

        hop = round(schedule.estimator.update_s / period)
        estimator = PayloadEstimator(rig, schedule)
        stage, changed = first_stage, -np.inf
        rows: list[np.ndarray] = []
        changes: list[tuple[float, int]] = []
        pending = list(course.payload_kg[1:])
        unread: list[np.ndarray] = []  # volts and current since the last estimate
        joins = (ceil(at / period - 1e-9) for at, _ in pending)
        cuts = sorted({*range(0, count - 1, hop), *(at for at in joins if at < count - 1)})
        for begin, end in pairwise([*cuts, count - 1]):
            while pending and pending[0][0] <= (begin + 1e-9) * period:
                new = pending.pop(0)[1]
                if course.joining == "from_rest" and new > mass:
                    # Of the same forces M a = F: what has the momentum M v has the speeds that follow from F = M v.
                    lone, both = (linearise(moving, state, still, figures(m)).a for m in (mass, new))
                    speeds = np.nonzero((lone != both).any(axis=1))[0]
                    state[speeds] = both[speeds] @ np.linalg.lstsq(lone[speeds], state[speeds], rcond=None)[0]
                mass = new
            law = sampled[stage]
            when, given = np.arange(begin, end + 1) * period, inputs[2 * fine * begin : 2 * fine * end + 1]
            digital = law.whole.packed(fine, 0, 0.0, z, passed[-1, -1])
            y, state = integrate(kinds, when, given, state, figures(mass), fine, limit_m, digital)
            whole = len(y) == end - begin + 1
            y = y[: end - begin + (end == count - 1)]  # else its last sample is the first of what follows
            here = slice(begin, begin + len(y))
            volts = y[:, OUTPUTS.index("measured_V")] + noise[here]
            for value in command[here] - volts:
                z, signals = law.step(z, value)
                passed = np.vstack([passed[1:], signals])
            unread.append(np.column_stack([volts, y[:, OUTPUTS.index("current_A")]])[: end - begin])
            due = whole and (end % hop == 0 or end == count - 1)
            estimate = estimator.advance(*np.vstack(unread).T) if due else estimator.estimate
            noted = (mass, stage + 1, estimate.outer_end_mass_kg, estimate.std_kg)
            done = (np.arange(begin, begin + len(y)) * period, course.force_N[here], command[here])
            rows.append(np.column_stack([*done, y[:, :4], volts, np.tile(noted, (len(y), 1))]))
            if not whole:
                record = diverged(rig.name, np.vstack(rows), limit_m, period)
                return replace(record, columns=STAGED, changes=tuple(changes))
            if not due:
                continue
            unread.clear()
            chosen = next_stage(schedule, stage, estimate, end * period - changed) if adaptive else stage
            if chosen != stage:
                stage, changed = chosen, end * period
                changes.append((end * period, stage + 1))
                z = sampled[stage].after(passed)
        return SimulatedRecord(rig.name, np.vstack(rows), True, columns=STAGED, changes=tuple(changes))

    found, same = refined(run, lambda record: record.samples[:, _MOVES], COLUMNS[_MOVES], substeps * count)
    return found if same == len(found.samples) else replace(found, certain_until_s=same * period)


def _wall_substeps(rig: Prototype, row: ScenarioRecord, times: np.ndarray) -> int:
    """Steps per sample with which a bounce of the outer beam's mass alone on the wall keeps its energy to 1e-3."""
    if row.wall is None:
        return 1
    mass = lumped.figures(rig)["outer_mass"] + row.outer_end_mass_kg
    fastest = max((row.wall.stiffness_N_per_m / mass) ** 0.5, row.wall.damping_N_s_per_m / mass)
    needed = (times[1] - times[0]) * _WALL_STEPS_PER_RADIAN * fastest
    reason = f"{mass:g} kg bounces at {fastest / (2 * np.pi):.3g} Hz"
    refuse_too_many(needed * len(times), f"record.{row.name}.wall.stiffness_N_per_m", reason)
    return ceil(needed)


def _judged(
    row: ScenarioRecord, scenario: Scenario, samples: np.ndarray, inputs: np.ndarray, kinds: Structure
) -> SimulatedRecord:
    """Say whether a record is one of a stable loop."""
    times, displacement = samples[:, 0], samples[:, COLUMNS.index("displacement_m")]
    if len(samples) < len(inputs):
        return diverged(row.name, samples, scenario.displacement_limit_m, scenario.sample_s)
    moving = np.nonzero(np.any(np.diff(inputs, axis=0) != 0, axis=1))[0]
    quiet = int(moving[-1]) + 1 if len(moving) else 0
    found = None
    if len(samples) - quiet > 20:
        shaken = any(assemble(kinds).function.which_depends("t", ["rate"]))
        found = sustained(times[quiet:], displacement[quiet:], _LEAST_AMPLITUDE_M, shaken)
        if found is None and departing(displacement[quiet:], _LEAST_AMPLITUDE_M):
            return SimulatedRecord(row.name, samples, False, "under constant inputs the tip moves ever further")
    if found is None:
        return SimulatedRecord(row.name, samples, True)
    how = "grows" if found.growth_per_s > 0 else "does not die out"
    reason = f"under constant inputs an oscillation at {found.frequency_Hz:.4g} Hz {how}"
    return SimulatedRecord(row.name, samples, False, reason, None, found)


def diverged(name: str, samples: np.ndarray, limit_m: float, sample_s: float) -> SimulatedRecord:
    """A record whose samples (M, 7 or more) end where the tip passed a limit."""
    found, at = None, len(samples) * sample_s
    if len(samples) > 8:
        found = oscillation(samples[:, 0], samples[:, COLUMNS.index("displacement_m")], turns=20)
    how = "" if found is None else f", oscillating at {found.frequency_Hz:.4g} Hz"
    reason = f"the outer tip passed {limit_m:g} m at {at:.4g} s{how}"
    return SimulatedRecord(name, samples, False, reason, at, found)
