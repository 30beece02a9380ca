"""Records of a scenario as courses for a scheduled controller."""

from beamdesign.records import Problem
from beamdesign.scenario import Scenario, ScenarioRecord, inputs_of
from beamdesign.scheduling.record import Scheduled
from beamdesign.scheduling.simulation import Course


def course_of(row: ScenarioRecord, scenario: Scenario) -> Course:
    """What a record does to the rig: force, command, and payload with its change."""
    inputs, begun = inputs_of(row, scenario), (0.0, row.outer_end_mass_kg)
    force, command = inputs[:, 0] + row.preload_N, inputs[:, 1]
    if (change := row.payload_change) is None:
        return Course(force, (begun,), command_V=command)
    return Course(force, (begun, (change.at_s, change.outer_end_mass_kg)), change.joining, command)


def unfit(scenario: Scenario, schedule: Scheduled) -> list[Problem]:
    """What of a scenario a scheduled controller cannot be put through."""
    found = []
    if abs(scenario.sample_s - schedule.period_s) > 1e-9:
        words = f"must be the period of the scheduled controller, {schedule.period_s:g}, is {scenario.sample_s:g}"
        found.append(Problem("sample_s", words))
    if scenario.sampled is not None:
        found.append(Problem("sampled", "a scheduled controller is sampled at its own period; take this out"))
    if scenario.start != "loaded":
        found.append(Problem("start", "a scheduled controller starts at rest under the preload, 'loaded'"))
    found += [
        Problem(f"record.{row.name}.{name}", "is not for a scheduled controller")
        for row in scenario.record
        for name in ("controller", "inner_end_mass_kg", "start_m")
        if getattr(row, name) is not None
    ]
    return found
