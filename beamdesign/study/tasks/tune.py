"""Task `tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from typing import Any

from beamdesign.design.refinement import Proved
from beamdesign.design.schedule import LawsTuning, tune_laws
from beamdesign.design.tuning import limited
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer, of_all
from beamdesign.study.tasks import TuneOptions
from beamdesign.study.tasks.certify import payload_range


def compute(prototype: Prototype, options: TuneOptions) -> Answer:
    """Tune one prototype over its own payload range."""
    kind, rig = options.controller, prototype.but(goal=limited(prototype.goal, options.controller))
    found = tune_laws(rig, payload_range(prototype), kind, **options.sought)
    return outputs(found)


def outputs(found: LawsTuning) -> Answer:
    """Columns of what was tuned: of the law of the least bandwidth, and of several laws those of each."""
    if found.reason:
        one = found.laws[0] if found.laws else None
        starts = {} if one is None else {"starts_Hz": list(one.starts), "certificates": one.certificates}
        return Answer({}, starts, found.reason)
    answers = {}
    for stage, law in zip(found.stages, found.laws, strict=True):
        assert law.best is not None
        details = {"starts_Hz": list(law.starts), "certificates": law.certificates}
        details["controller"] = law.best.controller.model_dump(mode="json")
        answers[stage.prototype.name] = Answer(proved_outputs(law.best), details)
    return of_all(answers)


def proved_outputs(best: Proved) -> dict[str, Any]:
    """Columns of a proved loop."""
    law = best.controller
    breaks = {} if law.lag is None else {"pole_Hz": law.lag.pole_Hz, "zero_Hz": law.lag.zero_Hz}
    for k, section in enumerate(law.sections, start=1):
        breaks |= {f"section_{k}_{name}": value for name, value in section.model_dump().items()}
    return {
        "bandwidth_Hz": best.bandwidth_Hz,
        "peak_sensitivity": best.peak_sensitivity,
        "inner_end_mass_kg": best.inner_end_mass_kg,
        "gain_A_per_V": law.gain_A_per_V,
        **breaks,
    }
