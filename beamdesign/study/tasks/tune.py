"""Task `tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from typing import Any

from beamdesign.design.refinement import Proved
from beamdesign.design.tuning import tune
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import TuneOptions
from beamdesign.study.tasks.certify import payload_range


def compute(prototype: Prototype, options: TuneOptions) -> Answer:
    """Tune one prototype over its own payload range."""
    found = tune(
        prototype,
        payload_range(prototype),
        options.controller,
        options.largest_inner_end_mass_kg,
        sections=options.sections,
    )
    details = {"starts_Hz": list(found.starts), "certificates": found.certificates}
    return Answer(proved_outputs(found.best) if found.best else {}, details, found.reason)


def proved_outputs(best: Proved) -> dict[str, Any]:
    """Columns of a proved loop."""
    breaks = {name: value for name, value in best.controller.model_dump().items() if name != "kind"}
    for k, section in enumerate(breaks.pop("section", ()), start=1):
        breaks |= {f"section_{k}_{name}": value for name, value in section.items()}
    return {
        "bandwidth_Hz": best.bandwidth_Hz,
        "peak_sensitivity": best.peak_sensitivity,
        "inner_end_mass_kg": best.inner_end_mass_kg,
        **breaks,
    }
