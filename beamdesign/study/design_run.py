"""One design problem from a study file to a certified prototype."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from beamdesign.design.refinement import Proved
from beamdesign.design.sizing import Sizing, size
from beamdesign.design.tuning import Tuning, limited, tune
from beamdesign.problem import DesignProblem
from beamdesign.proof.certificate import Asked, Certificate, goal_claims
from beamdesign.proof.certifying import certify
from beamdesign.prototype import Guarantee, Prototype

CERTIFICATE_NAME = "certificate.toml"


@dataclass(frozen=True)
class DesignRun:
    """What each step gave; a step after a failed one is None.

    Attributes:
        problem: as read from the study file.
        sizing: sections with their checks.
        tuning: controller and end mass with what was proved.
        certificate: the proof, as text.
        prototype: the result, with its guarantee; None where a step failed.
        reason: why there is no result, empty where there is one.
    """

    problem: DesignProblem
    sizing: Sizing
    tuning: Tuning | None
    certificate: Certificate | None
    prototype: Prototype | None
    reason: str = ""


def run_design(problem: DesignProblem, progress: Callable[[float, str], None] | None = None) -> DesignRun:
    """Size, tune and certify.

    Args:
        problem: the design problem.
        progress: told the share done and what is being done.
    """
    told = progress or (lambda fraction, text: None)
    told(0.0, "sizing the sections")
    sizing = size(problem)
    if not sizing.feasible:
        return DesignRun(problem, sizing, None, None, None, sizing.reason)
    outer, inner = sizing.outer, sizing.inner
    rig = problem.prototype((outer.width_m, outer.wall_m), (inner.width_m, inner.wall_m))
    masses = problem.payload.outer_end_mass_kg
    assert masses is not None  # a DesignProblem is validated to have the range
    sought = problem.controller
    tuning = tune(
        rig.but(goal=limited(rig.goal, sought.kind)),
        masses,
        sought.kind,
        sought.largest_inner_end_mass_kg,
        lambda fraction, text: told(0.2 + 0.6 * fraction, text),
        sought.sections,
        sought.sensors,
    )
    if tuning.best is None:
        return DesignRun(problem, sizing, tuning, None, None, tuning.reason)
    told(0.9, "writing the proof")
    certificate, prototype = certified(tuning.prototype, tuning.best, masses)
    return DesignRun(problem, sizing, tuning, certificate, prototype)


def claims_of(prototype: Prototype, proved: Proved) -> tuple[Asked, ...]:
    """What was found of a prototype, as claims of a certificate."""
    return (
        Asked("peak_sensitivity", proved.peak_sensitivity),
        Asked("compliance", prototype.goal.compliance_m_per_N, proved.bandwidth_Hz),
        *goal_claims(prototype.goal),
    )


def certified(
    prototype: Prototype, proved: Proved, masses_kg: tuple[float, float], name: str | Path = CERTIFICATE_NAME
) -> tuple[Certificate, Prototype]:
    """Prove what was found once more as claims of a certificate, and state them in the prototype.

    Args:
        prototype: with controller and inner end mass.
        proved: its guaranteed figures.
        masses_kg: the range of outer end mass.
        name: file name under which the certificate will stand beside the prototype.
    """
    certificate = certify(prototype, *masses_kg, claims_of(prototype, proved))
    guarantee = Guarantee(
        bandwidth_Hz=proved.bandwidth_Hz,
        peak_sensitivity=proved.peak_sensitivity,
        outer_end_mass_kg=masses_kg,
        certificate=str(name),
        certificate_sha256=hashlib.sha256(certificate.text.encode()).hexdigest(),
    )
    return certificate, prototype.but(guarantee=guarantee)
