"""Task `remedy`: one of the paper's remedies for payload, optimised and proved."""

from beamdesign.design.remedies import one_remedy
from beamdesign.problem import DesignProblem
from beamdesign.records import InputError
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import RemediesOptions


def compute(problem: DesignProblem, options: RemediesOptions) -> Answer:
    """Optimise one remedy from the given sections of one problem."""
    masses = problem.payload.outer_end_mass_kg
    assert masses is not None  # a DesignProblem is validated to have the range
    missing = [name for name in ("outer_beam", "inner_beam") if getattr(problem, name).width_m is None]
    if missing:
        reason = "the remedies start from given sections: width_m and wall_m are needed"
        raise InputError(problem.name, [(name, reason) for name in missing])
    found = one_remedy(problem, options.remedy, masses, options.added_mass_kg)
    outputs = {
        "remedy": found.name,
        "bandwidth_Hz": found.bandwidth_Hz,
        "peak_sensitivity": found.peak_sensitivity,
        "added_mass_kg": found.added_mass_kg,
        "inner_end_mass_kg": found.inner_end_mass_kg,
        "outer_width_m": found.outer.width_m,
        "outer_wall_m": found.outer.wall_m,
        "inner_width_m": found.inner.width_m,
        "inner_wall_m": found.inner.wall_m,
        "gain_A_per_V": [law.gain_A_per_V for law in found.controllers],
        "pole_Hz": [law.pole_Hz for law in found.controllers],
        "zero_Hz": [law.zero_Hz for law in found.controllers],
    }
    return Answer(outputs, {"parts_kg": [list(part) for part in found.parts_kg]}, found.reason)
