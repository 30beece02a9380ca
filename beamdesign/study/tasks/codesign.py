"""Task `codesign`: sections, end mass and controller together, at least moving mass."""

from beamdesign.design.codesign import codesign
from beamdesign.problem import DesignProblem
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import CodesignOptions
from beamdesign.study.tasks.size import check_fields
from beamdesign.study.tasks.tune import proved_outputs


def compute(problem: DesignProblem, options: CodesignOptions) -> Answer:
    """Lightest proved design of one problem."""
    masses = problem.payload.outer_end_mass_kg
    assert masses is not None  # a DesignProblem is validated to have the range
    found = codesign(problem, masses, options.bandwidth_Hz)
    attempts = [attempt if isinstance(attempt, str) else f"{attempt:.6g} kg" for attempt in found.attempts]
    point = found.point
    if point is None:
        return Answer({}, {"attempts": attempts}, found.reason)
    outputs = {
        "moving_mass_kg": point.moving_mass_kg,
        "beam_mass_kg": point.beam_mass_kg,
        "outer_width_m": point.outer.width_m,
        "outer_wall_m": point.outer.wall_m,
        "inner_width_m": point.inner.width_m,
        "inner_wall_m": point.inner.wall_m,
        "governing": point.governing,
        **proved_outputs(point.proved),
    }
    details = {
        "checks": [check_fields(check) for check in point.checks],
        "attempts": attempts,
        "prototype": point.prototype.model_dump(mode="json", exclude_none=True),
    }
    return Answer(outputs, details)
