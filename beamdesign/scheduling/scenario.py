"""A record of a scenario as a course for a scheduled controller, and what comes of them."""

from dataclasses import replace

from beamdesign.controllers import Scheduled
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.scenario import Sampled, Scenario, ScenarioRecord, inputs_of
from beamdesign.scheduling.simulation import Course, simulate_scheduled
from beamdesign.simulate import SimulatedRecord, as_measured


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
