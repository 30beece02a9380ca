"""Task `run`: a design problem carried to a certified prototype."""

from typing import Any

from beamdesign.problem import DesignProblem
from beamdesign.study.answer import Answer
from beamdesign.study.design_run import run_design
from beamdesign.study.tasks import size
from beamdesign.study.tasks.tune import proved_outputs


def compute(problem: DesignProblem, options: Any) -> Answer:
    """Size, tune and certify one problem."""
    found = run_design(problem)
    outputs = size.outputs(found.sizing)
    details = size.details(found.sizing)
    if found.tuning is not None and found.tuning.best is not None:
        outputs |= proved_outputs(found.tuning.best)
        outputs["moving_mass_kg"] = found.sizing.beam_mass_kg + found.tuning.best.inner_end_mass_kg
    if found.prototype is not None and found.prototype.guarantee is not None:
        outputs["certificate_sha256"] = found.prototype.guarantee.certificate_sha256
        details["prototype"] = found.prototype.model_dump(mode="json", exclude_none=True)
    return Answer(outputs, details, found.reason)
