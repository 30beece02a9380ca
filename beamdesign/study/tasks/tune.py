"""Task `tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from typing import Any

from beamdesign.design.refinement import Proved
from beamdesign.design.tuning import limited, tune
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import TuneOptions
from beamdesign.study.tasks.certify import payload_range


def compute(prototype: Prototype, options: TuneOptions) -> Answer:
    """Tune one prototype over its own payload range."""
    kind, rig = options.controller, prototype.but(goal=limited(prototype.goal, options.controller))
    asked = (payload_range(prototype), kind, options.largest_inner_end_mass_kg)
    found = tune(rig, *asked, sections=options.sections, sensors=options.sensors)
    details = {"starts_Hz": list(found.starts), "certificates": found.certificates}
    if found.best:
        details["controller"] = found.best.controller.model_dump(mode="json")
    return Answer(proved_outputs(found.best) if found.best else {}, details, found.reason)


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
