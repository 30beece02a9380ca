"""A scheduled controller in the loop with the nonlinear rig: sampled law, estimator, switch, payload that changes.

Stages change by hysteresis through their overlaps, no sooner than the dwell time after the last change. What is done to
the rig is a `Course`; a record of a scenario can be put as one.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beamdesign.controllers import Scheduled
from beamdesign.controllers.scheduling.estimator import Estimate, PayloadEstimator
from beamdesign.plant.assembly import OUTPUTS, assemble, parameters_of, structure_of
from beamdesign.plant.compiled import integrate_on
from beamdesign.plant.equilibrium import equilibrium
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.sampled import sampled_law
from beamdesign.scenario import Sampled, Scenario, ScenarioRecord, inputs_of
from beamdesign.simulation import COLUMNS as SIMULATED
from beamdesign.simulation import SimulatedRecord, as_measured, diverged, half_steps, substeps_for
from beamdesign.structure import lumped

COLUMNS = (*SIMULATED, "sensor_V", "outer_end_mass_kg", "stage", "estimate_kg", "estimate_std_kg")
LIMIT_M = 0.02
"""Displacement at which a loop has diverged, where nothing else is said."""


@dataclass(frozen=True)
class Course:
    """What is done to a rig.

    Attributes:
        force_N: (N,) on the tip, one figure for each sample of the law.
        payload_kg: (time in s, payload) pairs from time 0 on; each lasts until the next.
        joining: whether payload joins with the tip's velocity, or at rest, which takes some of it.
        command_V: (N,) on top of the sensor's noise; none where left out.
        before_N: force that it rests under before; the first of force_N where left out.
    """

    force_N: np.ndarray
    payload_kg: tuple[tuple[float, float], ...]
    joining: Literal["matched", "from_rest"] = "matched"
    command_V: np.ndarray | None = None
    before_N: float | None = None


def simulate_scheduled(
    rig: Prototype,
    course: Course,
    built: Prototype | None = None,
    first_stage: int = 0,
    adaptive: bool = True,
    noise_V: float = 0.0,
    seed: int = 0,
    limit_m: float = LIMIT_M,
) -> SimulatedRecord:
    """Simulate a scheduled controller; the record has the `COLUMNS`, and is called stable where it did not diverge.

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
        InputError: for effects that cannot be.
        ValueError: where there is no equilibrium to start from.
    """
    schedule = rig.schedule
    assert schedule is not None  # the caller has seen that there are several laws
    laws = [stage.law for stage in schedule.stage]
    plant = (built or rig).but(controller=laws[0])
    inner, period = plant.payload.inner_end_mass_kg, schedule.period_s
    kinds, continuous = structure_of(plant, True), assemble(structure_of(plant))
    states = assemble(kinds).states
    velocity = states.index("outer_m_per_s")

    def figures(mass: float) -> np.ndarray:
        return np.array(list(parameters_of(plant, mass, inner).values()))

    count = len(course.force_N)
    times = np.arange(count) * period
    substeps = max(substeps_for(continuous, figures(mass), times) for _, mass in course.payload_kg)
    noise = noise_V * np.random.default_rng(seed).standard_normal(count)
    command = np.zeros(count) if course.command_V is None else course.command_V
    inputs = half_steps(np.column_stack([course.force_N, np.zeros(count)]), substeps)
    inputs[:: 2 * substeps, 1] = command - noise  # read at the samples of the law alone
    before = np.array([course.force_N[0] if course.before_N is None else course.before_N, 0.0, 0.0])
    mass = course.payload_kg[0][1]
    rest = equilibrium(continuous, before, figures(mass))
    measured = float(np.asarray(continuous.function(0.0, rest, before, figures(mass))[1]).ravel()[-1])
    state = rest[[continuous.states.index(name) for name in states]]
    error, current = -measured, laws[first_stage].gain_A_per_V * -measured

    hop = round(schedule.estimator.update_s / period)
    estimator = PayloadEstimator(rig, schedule)
    stage, changed = first_stage, -np.inf
    rows: list[np.ndarray] = []
    changes: list[tuple[float, int]] = []
    pending = list(course.payload_kg[1:])
    bare = lumped.figures(plant)["outer_mass"]
    for begin in range(0, count - 1, hop):
        end = min(begin + hop, count - 1)
        now = begin * period
        while pending and pending[0][0] <= now + 1e-12:
            new = pending.pop(0)[1]
            if course.joining == "from_rest" and new > mass:
                state[velocity] *= (bare + mass) / (bare + new)
            mass = new
        law = sampled_law(laws[stage], period)
        z = law.after(np.array([error]), current)
        y, state = integrate_on(
            kinds,
            np.arange(begin, end + 1) * period,
            inputs[2 * substeps * begin : 2 * substeps * end + 1],
            state,
            figures(mass),
            substeps,
            limit_m,
            law.packed(substeps, 0, 0.0, z, current),
        )
        whole = len(y) == end - begin + 1
        y = y[: end - begin]  # the last sample is the first of what follows
        here = slice(begin, begin + len(y))
        volts = y[:, OUTPUTS.index("measured_V")] + noise[here]
        for value in command[here] - volts:
            z, current = law.step(z, np.array([value]))
            error = value
        estimate = estimator.advance(volts, y[:, OUTPUTS.index("current_A")]) if whole else estimator.estimate
        noted = (mass, stage + 1, estimate.outer_end_mass_kg, estimate.std_kg)
        times = np.arange(begin, begin + len(y)) * period
        given = (times, course.force_N[here], command[here])
        rows.append(np.column_stack([*given, y[:, :4], volts, np.tile(noted, (len(y), 1))]))
        if not whole:
            record = diverged(rig.name, np.vstack(rows), limit_m, period)
            return replace(record, columns=COLUMNS, changes=tuple(changes))
        chosen = next_stage(schedule, stage, estimate, end * period - changed) if adaptive else stage
        if chosen != stage:
            stage, changed = chosen, end * period
            changes.append((end * period, stage + 1))
    return SimulatedRecord(rig.name, np.vstack(rows), True, columns=COLUMNS, changes=tuple(changes))


def next_stage(schedule: Scheduled, stage: int, estimate: Estimate, since_s: float) -> int:
    """The stage to go on with.

    A stage keeps acting while the estimate lies within its range, less the estimator's band towards its neighbours:
    then the payload itself is in the range as long as the estimate errs by no more than the band. Ranges overlap by
    more than two bands; the rest is hysteresis.

    Args:
        schedule: stages and figures.
        stage: number of the one that acts, from 0.
        estimate: of the payload.
        since_s: time since the last change.
    """
    if since_s < schedule.dwell_s or estimate.std_kg > schedule.estimator.largest_std_kg:
        return stage
    mass = estimate.outer_end_mass_kg
    spare = [min(mass - least, most - mass) for least, most in schedule.kept_kg]
    if spare[stage] >= 0:
        return stage
    return max(range(len(spare)), key=lambda k: spare[k])


def course_of(row: ScenarioRecord, scenario: Scenario) -> Course:
    """What a record does to the rig: force, command, and payload with its change."""
    inputs, begun = inputs_of(row, scenario), (0.0, row.outer_end_mass_kg)
    force, command = inputs[:, 0] + row.preload_N, inputs[:, 1]
    before = row.preload_N if scenario.start == "loaded" else 0.0
    if (change := row.payload_change) is None:
        return Course(force, (begun,), command_V=command, before_N=before)
    return Course(force, (begun, (change.at_s, change.outer_end_mass_kg)), change.joining, command, before)


def unfit(scenario: Scenario, row: ScenarioRecord, schedule: Scheduled) -> list[Problem]:
    """What of a record in its scenario a scheduled controller cannot be put through."""
    found = []
    if abs(scenario.sample_s - schedule.period_s) > 1e-9:
        words = f"must be the period of the scheduled controller, {schedule.period_s:g}, is {scenario.sample_s:g}"
        found.append(Problem("sample_s", words))
    if scenario.sampled not in (None, Sampled(period_s=schedule.period_s)):
        words = f"must be as the scheduled controller is: every {schedule.period_s:g} s, without delay and quantisation"
        found.append(Problem("sampled", words))
    if row.wall is not None:
        found.append(Problem(f"record.{row.name}.wall", "is not for a scheduled controller"))
    return found


def simulate_stages(prototype: Prototype, scenario: Scenario, row: ScenarioRecord, position: int) -> SimulatedRecord:
    """Simulate a record of a scenario, at a position there, begun with the first stage.

    Law and estimator work at the schedule's period and hear the sensor with its noise where the prototype states it.
    Under noise nothing comes to rest, so that a record is called stable as long as the tip stays within the limit.

    Raises:
        InputError: where there is no equilibrium to start from.
    """
    noise, seed = prototype.sensor.noise_V or 0.0, scenario.measurement.seed + position
    course, limit, built = course_of(row, scenario), scenario.displacement_limit_m, prototype
    if row.inner_end_mass_kg is not None:
        built = prototype.but(payload=prototype.payload.but(inner_end_mass_kg=row.inner_end_mass_kg))
    try:
        found = simulate_scheduled(prototype, course, built, noise_V=noise, seed=seed, limit_m=limit)
    except ValueError as error:
        raise InputError(prototype.name, [(f"record.{row.name}", str(error))]) from error
    return replace(found, name=row.name, samples=as_measured(found.samples, scenario, position))
