"""A finished design run made in a moment: fixed sections and a given controller, certified but not tuned."""

from functools import cache
from pathlib import Path

import numpy as np

from beamdesign import certify, read_problem, size
from beamdesign.controllers import Lag
from beamdesign.synthesis.design_run import DesignRun, certified
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.tuning import Tuning

STUDY = Path(__file__).parent.parent / "studies" / "prototype.toml"


@cache
def finished_run() -> DesignRun:
    """The published sections with a lag that was chosen by hand, under a name that needs escaping everywhere."""
    study = read_problem(STUDY)
    problem = study.but(name='A <rig> & "co" | *x*', sections=study.sections.but(choose="fixed"))
    masses = problem.payload.outer_end_mass_kg
    assert masses is not None
    sizing = size(problem)
    rig = problem.prototype(sizing.outer, sizing.inner)
    controller, inner = Lag(gain_A_per_V=0.12, pole_Hz=1.3, zero_Hz=38.0), 2.0
    loaded = rig.but(controller=controller, payload=rig.payload.but(inner_end_mass_kg=inner))
    certificate = certify(loaded, *masses)
    assert certificate.guaranteed is not None
    best = Proved(
        controller, inner, certificate.guaranteed.bandwidth_Hz, certificate.guaranteed.peak_sensitivity, np.zeros(0)
    )
    tuning = Tuning(loaded, masses, best, (best.bandwidth_Hz,), 1)
    certificate, prototype = certified(loaded, best, masses)
    return DesignRun(problem, sizing, tuning, certificate, prototype)
