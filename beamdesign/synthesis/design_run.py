"""One design problem from a study file to a certified prototype."""

import hashlib
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any

from beamdesign.arguments import takes
from beamdesign.problem import DesignProblem
from beamdesign.progress import Progress, part_of, silent
from beamdesign.proofs.certificate import LOWER_GAINS, Asked, Certificate, goal_claims
from beamdesign.proofs.certifying import certify
from beamdesign.proofs.lyapunov import describe, stages_certificate
from beamdesign.prototype import Guarantee, Prototype
from beamdesign.quantities import Frequency, range_of
from beamdesign.result import Result
from beamdesign.synthesis import SIGMAS
from beamdesign.synthesis.changes import Way, carried, easier, in_words
from beamdesign.synthesis.holding import Holding, standing, working
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.sizing import Sizing, size
from beamdesign.synthesis.tuning import Tuning, limited, tune
from beamdesign.time_limit import leave_out, over, within

CERTIFICATE_NAME = "certificate.toml"


@dataclass(frozen=True, repr=False)
class DesignRun(Result):
    """What each step gave; a step after a failed one is None.

    Attributes:
        problem: as read from the study file.
        sizing: sections with their checks.
        tuning: controller and end mass with what was proved.
        certificate: the proof, as text.
        prototype: the result, with its guarantee; None where a step failed.
        reason: why there is no result, empty where there is one.
        suffix: what tells its files from those of other laws; empty where there is one law.
        laws: of a controller with several laws the run with each, over its own payloads; `tuning` and `certificate`
            are then those of the law of the least bandwidth, and `prototype` is with all of them.
        changes: certificate of changes between these.
        holding: whether the actuator holds load and weight, as far as that was asked.
        ways: where there is no result, changes of the study that lead to one; of laws that take long to tune, that are
            needed.
        left_out: what was not tried for want of time, in words.
    """

    problem: DesignProblem
    sizing: Sizing
    tuning: Tuning | None
    certificate: Certificate | None
    prototype: Prototype | None
    reason: str = ""
    suffix: str = ""
    laws: "tuple[DesignRun, ...]" = ()
    changes: str = ""
    holding: Holding | None = None
    ways: tuple[Way, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def change(self) -> tuple[str, ...]:
        """What to change in the study, in words, each entry enough by itself.

        Where no sections pass their checks, enough for some that do; what else they ask is asked of these.
        """
        sizing, ways = self.sizing, in_words(self.ways)
        if sizing.feasible:
            return ways
        free = ['sections.choose = "free"'] if sizing.choose == "stock" and sizing.free else []
        return (*ways, *free, *(f"{item.key} = {item.enough:g}" for item in sizing.relaxations))

    @property
    def guarantees(self) -> tuple[Guarantee, ...]:
        """What is proved with each law over its own payloads, that of the least bandwidth first."""
        found = [one.prototype.guarantee for one in self.laws or (self,) if one.prototype is not None]
        return tuple(sorted((one for one in found if one is not None), key=lambda one: one.bandwidth_Hz))

    @property
    def proved(self) -> list[dict[str, Any]]:
        """What is proved with each law as JSON files say it, in the same order."""
        found = [
            one.tuning.best.guaranteed(one.prototype, one.tuning.outer_end_mass_kg)
            for one in self.laws or (self,)
            if one.prototype is not None and one.tuning is not None and one.tuning.best is not None
        ]
        return sorted(found, key=lambda one: float(one["bandwidth_Hz"]))


@takes("DesignProblem")
def run_design(
    problem: DesignProblem, progress: Progress | None = None, sigmas: float = SIGMAS, minutes: float | None = None
) -> DesignRun:
    """Size, tune and certify; where that gives no design, seek what of the study to change.

    Args:
        problem: the design problem.
        progress: told the share done and what is being done.
        sigmas: as of `tune`, as `minutes`.
        minutes: after about which the best that was proved until then is the answer.
    """
    report = progress or silent

    def lacking(other: DesignProblem) -> Way | None:
        if over():
            leave_out("whether every change leads to a design")
            return None
        tried = _designed(other, silent, sigmas)
        ways = () if tried.holding is None else tried.holding.ways
        return () if tried.yes else next((way for way in ways if len(way) == 1), None)

    with within(minutes) as limit:
        found = _designed(problem, report, sigmas)
        if not found.yes and found.sizing.feasible:
            ways = () if found.holding is None else found.holding.ways
            if problem.controller.kind in _QUICK:
                report(0.5, "what to change")
                likely = ways or easier(problem)
                ways = carried(problem, ways, lacking) or carried(problem, easier(problem), lacking)
                if not ways and over():
                    untried = f"what may help, not tried for want of time: {' or '.join(in_words(likely))}"
                    found = replace(found, reason=f"{found.reason}; {untried}")
            found = replace(found, ways=ways)
    return replace(found, left_out=tuple(limit.left_out))


@takes("DesignProblem")
def run(
    problem: DesignProblem,
    progress: Progress | None = None,
    sigmas: float = SIGMAS,
    minutes: float | None = None,
    outer_end_mass_kg: tuple[float, float] | None = None,
) -> DesignRun:
    """The same by the name of the command, for payloads (least, most) or else the problem's; else as of `run_design`.

    Raises:
        InputError: for what is no pair of plausible masses.
        ValueError: for an empty range.
    """
    payload = problem.payload.but(outer_end_mass_kg=problem.asked_kg(outer_end_mass_kg))
    return run_design(problem.but(payload=payload), progress, sigmas, minutes)


_QUICK = ("lag", "proportional")
"""Kinds of controller that are tuned in seconds, so that a change is proposed only where it was carried to a design."""


def _designed(problem: DesignProblem, report: Progress, sigmas: float) -> DesignRun:
    report(0.0, "sizing the sections")
    sizing = size(problem)
    if not sizing.feasible:
        return DesignRun(problem, sizing, None, None, None, sizing.reason)
    rig = problem.prototype(sizing.outer, sizing.inner)
    masses = problem.asked_kg()
    held = standing(problem, rig, masses)
    if held.reason:
        return DesignRun(problem, sizing, None, None, None, held.reason, holding=held)
    sought = problem.controller
    asked = sought.sought | {"progress": part_of(report, 0.2, 0.8), "sigmas": sigmas}
    tuned = tune(limited(rig, sought.kind), masses, sought.kind, **asked)
    if tuned.reason:
        return DesignRun(problem, sizing, tuned, None, None, tuned.reason)
    assert tuned.best is not None
    held = working(problem, tuned.prototype, masses, tuned.best.bandwidth_Hz)
    if held.reason:
        return DesignRun(problem, sizing, tuned, None, None, held.reason, holding=held)
    report(0.9, "writing the proof")
    prototype, each = certified_laws(tuned)
    laws = tuple(
        DesignRun(problem, sizing, law, certificate, rig, suffix=stage.suffix, holding=held)
        for stage, law, (certificate, rig) in zip(tuned.stages, tuned.each, each, strict=True)
    )
    changes = tuned.switching
    if changes is None:
        return laws[0]
    words = "\n".join((f"{prototype.name}: changes between its laws", *describe(changes)))
    whole = min(laws, key=lambda one: one.guarantees[0].bandwidth_Hz)
    reason = "" if changes.stable else f"changes between its laws are not proved: {changes.reason}"
    proof = stages_certificate(prototype, changes, words)
    return replace(whole, prototype=None if reason else prototype, reason=reason, laws=laws, changes=proof)


def certified_laws(found: Tuning) -> tuple[Prototype, tuple[tuple[Certificate, Prototype], ...]]:
    """What was tuned, and each of its laws, proved once more: `certified` over the payloads that it is for.

    The certificates of a law go by `certificate_name`. The prototype states the guarantee where there is one law; of
    several no one certificate proves all.
    """
    each = [
        certified(stage.prototype, law.best, stage.outer_end_mass_kg, certificate_name(stage.suffix))
        for stage, law in zip(found.stages, found.each, strict=True)
        if law.best is not None
    ]
    return found.prototype if found.laws else each[0][1], tuple(each)


def certificate_name(suffix: str = "", box: bool = False) -> str:
    """Name of the certificate of a law, of exactly its figures or over the whole box."""
    stem, end = CERTIFICATE_NAME.split(".")
    return f"{stem}{suffix}{'.box' if box else ''}.{end}"


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
    peak, goal, box = proved.peak_compliance_m_per_N, prototype.goal, proved.over_box
    claims = (
        Asked("peak_sensitivity", proved.peak_sensitivity),
        *([Asked("peak_compliance", peak)] if peak < inf else []),
        Asked("compliance", goal.compliance_m_per_N, proved.bandwidth_Hz),
        *goal_claims(goal),
        *([LOWER_GAINS] if goal.lower_gains else []),
    )
    certificate = certify(prototype, *masses_kg, claims, nonlinear=not prototype.effects)
    if not certificate.holds and certificate.nonlinear:  # what the current does where it saturates is no part of a goal
        certificate = certify(prototype, *masses_kg, claims)
    text, sigmas = (certificate.text, 0.0) if box is None else (box.certificate, box.sigmas)
    path = Path(name)
    name = path if box is None else path.with_name(f"{path.stem}.box{path.suffix}")
    return certificate, stating(prototype, text, masses_kg, proved.bandwidth_Hz, proved.peak_sensitivity, name, sigmas)


def stating(
    prototype: Prototype,
    text: str,
    masses_kg: tuple[float, float],
    bandwidth_Hz: float,
    peak_sensitivity: float,
    name: str | Path = CERTIFICATE_NAME,
    sigmas: float = 0.0,
) -> Prototype:
    """A prototype that states what the text of a certificate, which will stand beside it, guarantees of it."""
    guarantee = Guarantee(
        bandwidth_Hz=min(bandwidth_Hz, range_of(Frequency).high),  # no file states an infinite one
        peak_sensitivity=peak_sensitivity,
        outer_end_mass_kg=masses_kg,
        certificate=str(name),
        certificate_sha256=hashlib.sha256(text.encode()).hexdigest(),
        sigmas=sigmas,
    )
    return prototype.but(guarantee=guarantee)
