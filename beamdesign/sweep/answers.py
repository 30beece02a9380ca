"""What is worked out of one case: a function per task, each of which loads the engine that it needs."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from beamdesign.problem import DesignProblem
from beamdesign.prototype import Prototype
from beamdesign.quantities import stated_range
from beamdesign.records import InputError
from beamdesign.result import picked
from beamdesign.sweep import case
from beamdesign.sweep.case import Answer, of_all
from beamdesign.synthesis import REMEDY, SIZED

if TYPE_CHECKING:
    from beamdesign.proofs.certificate import Certificate
    from beamdesign.synthesis.checks import Check
    from beamdesign.synthesis.sizing import Sizing
    from beamdesign.synthesis.tuning import Tuning


def size(problem: DesignProblem, options: Any) -> Answer:
    """Sections of least mass of one problem."""
    from beamdesign.synthesis.sizing import size as find_sections

    found = find_sections(problem)
    return Answer(*sizing_outputs(found), "" if found.feasible else found.reason)


def sizing_outputs(found: "Sizing") -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns of a sizing, and what governs it: checks, shadow prices, what to relax.

    A pair that misses a check, the nearest where nothing fits, has no mass and no sizes there: it is no answer.
    """
    prices = {name: float(price) for name, price in found.shadow_prices.items()}
    sections = picked(found, SIZED)
    outputs = (sections if found.feasible else dict.fromkeys(sections)) | {
        "governing": found.governing,
        "free_beam_mass_kg": found.free.pair.beam_mass_kg if found.free else None,
        "price_of_rounding_kg": found.price_of_rounding_kg,
        **{f"price_{name}": price for name, price in prices.items()},
    }
    details = {
        "checks": [check_fields(check) for check in found.checks],
        "shadow_prices": prices,
        "active": list(found.free.active) if found.free else [],
        "relaxations": [picked(item, "key asked enough") for item in found.relaxations],
    }
    return outputs, details


def check_fields(check: "Check") -> dict[str, Any]:
    """A check as plain values, in the unit that people read it in."""
    value, limit, unit = check.shown
    shown = {"name": check.name, "value": value, "limit": limit, "unit": unit}
    return shown | picked(check, "at_least utilisation") | {"satisfied": bool(check.satisfied)}


def run(problem: DesignProblem, options: Any) -> Answer:
    """One problem carried to a certified prototype."""
    from beamdesign.synthesis.design_run import run_design

    found = run_design(problem, sigmas=0.0)  # figures are varied by the sweep
    outputs, details = sizing_outputs(found.sizing)
    if found.tuning is not None and found.tuning.best is not None:
        outputs |= found.tuning.best.columns()
        outputs["moving_mass_kg"] = found.sizing.beam_mass_kg + found.tuning.best.inner_end_mass_kg
    if found.prototype is not None and found.prototype.guarantee is not None:
        outputs["certificate_sha256"] = found.prototype.guarantee.certificate_sha256
        details["prototype"] = found.prototype
    return Answer(outputs, details, found.reason)


def codesign(problem: DesignProblem, options: case.CodesignOptions) -> Answer:
    """Lightest proved design of one problem: sections, end mass and controller together."""
    from beamdesign.synthesis.codesign import codesign as find_design

    found = find_design(problem, problem.asked_kg(), options.bandwidth_Hz, sigmas=0.0)
    attempts = [attempt if isinstance(attempt, str) else f"{attempt:.6g} kg" for attempt in found.attempts]
    point = found.point
    if point is None:
        return Answer({}, {"attempts": attempts}, found.reason)
    checks = [check_fields(check) for check in point.checks]
    return Answer(point.columns(), {"checks": checks, "attempts": attempts, "prototype": point.prototype})


def remedy(problem: DesignProblem, options: case.RemediesOptions) -> Answer:
    """One of the paper's remedies for payload, optimised from the given sections and proved."""
    from beamdesign.synthesis.remedies import remedies

    asked = problem.asked_kg(), options.added_mass_kg
    (found,) = remedies(problem, *asked, sigmas=0.0, numbers=(options.remedy,))
    laws = {name: [getattr(law, name) for law in found.controllers] for name in ("gain_A_per_V", "pole_Hz", "zero_Hz")}
    outputs = {"remedy": found.name, **picked(found, REMEDY), **laws}
    return Answer(outputs, {"parts_kg": [list(part) for part in found.parts_kg]}, found.reason)


def tune(prototype: Prototype, options: case.TuneOptions) -> Answer:
    """Controller and inner end mass with the largest guaranteed bandwidth over the payload range.

    Of several laws the one of the least bandwidth, with those of each in the details; a no where changes between them
    are looked at and not proved.
    """
    from beamdesign.synthesis import tuning

    kind, rig = options.controller, tuning.limited(prototype, options.controller)
    found = tuning.tune(rig, prototype.asked_kg(), kind, sigmas=0.0, **options.sought)
    if found.reason:
        return Answer({}, _effort(found), found.reason)
    answers = {}
    for stage, law in zip(found.stages, found.each, strict=True):
        assert law.best is not None
        details = _effort(law) | {"controller": law.best.controller.model_dump(mode="json")}
        answer = Answer(law.best.columns(), details)
        if rig.effects:
            answer = replace(answer, outputs=answer.outputs | _between(law), reason=law.open_between)
        answers[stage.prototype.name] = answer
    answer = of_all(answers)
    if found.switching is None or found.yes:
        return answer
    return replace(answer, reason=f"changes between its laws are not proved: {found.switching.reason}")


def _between(found: "Certificate | Tuning") -> dict[str, Any]:
    """Whether a loop is stable between the ends of what effects freeze too, where that is looked at."""
    return {"stable_between": found.between and found.between.stable}


def _effort(found: "Tuning") -> dict[str, Any]:
    return {"starts_Hz": list(found.starts), "certificates": found.certificates}


def certify(prototype: Prototype, options: case.CertifyOptions) -> Answer:
    """What is proved of one prototype over its own payload range, between the values that its effects freeze too."""
    from beamdesign.proofs.certificate import Asked, describe
    from beamdesign.proofs.certifying import certify as prove

    asked = []
    if options.bandwidth_Hz is not None:
        asked.append(Asked("compliance", prototype.goal.compliance_m_per_N, options.bandwidth_Hz))
    if options.peak_sensitivity is not None:
        asked.append(Asked("peak_sensitivity", options.peak_sensitivity))
    found = prove(prototype, *prototype.asked_kg(), asked)
    below, above = found.stability.below, found.stability.above
    low, high = found.outer_end_mass_kg
    covered = sum(most - least for least, most in found.stable_ranges_kg)
    outputs = {
        **_guaranteed(found, None),
        "stable_ranges_kg": [stated_range(ends) for ends in found.stable_ranges_kg],
        "stable_share": float(found.stable) if low == high else covered / (high - low),
        "unstable_below_kg": below.value if below is not None and below.value >= 0 else None,
        "unstable_above_kg": above.value if above is not None else None,
        **_crossings(found),
    }
    claims = [
        {"claim": describe(claim), **picked(claim, "holds reason mass_kg=witness_outer_end_mass_kg")}
        for claim in found.claims
    ]
    details = {"method": found.method, "scope": list(found.scope), "claims": claims}
    return Answer(outputs | (_between(found) if found.scope and found.stable else {}), details, found.reason)


def _guaranteed(found: "Certificate", no_bandwidth: float | None) -> dict[str, Any]:
    sure = found.guaranteed
    return {
        "stable": found.stable,
        "bandwidth_Hz": sure.bandwidth_Hz if sure else no_bandwidth,
        "peak_sensitivity": sure.peak_sensitivity if sure else None,
    }


def _crossings(found: "Certificate") -> dict[str, Any]:
    return {
        "crossings_kg": [crossing.value for crossing in found.crossings],
        "crossing_frequencies_Hz": [crossing.frequency_Hz for crossing in found.crossings],
    }


def stable_masses(prototype: Prototype, options: case.RangeOptions) -> Answer:
    """Exact stable ranges of mass on the outer tip, with the frequencies at the crossings; none at all is a no.

    So is what effects leave open: small motion, and where all of the range is stable the values between those frozen.
    """
    from beamdesign.proofs.certifying import certify as prove

    found = prove(prototype, options.from_kg, options.to_kg)
    ranges = found.stable_ranges_kg
    ends = {"stable_from_kg": [low for low, _ in ranges], "stable_to_kg": [high for _, high in ranges]}
    outputs = ends | _crossings(found) | (_between(found) if found.scope and found.stable else {})
    reason = found.small_motion or found.open_between if ranges else found.stability.reason
    return Answer(outputs, picked(found, "method scope"), reason)


def robust(prototype: Prototype, options: case.RangeOptions) -> Answer:
    """Prove one rig over its payload range, and find its longest stable range between the masses of the options.

    Everything is exact for this one set of figures. A loop that is not stable over its payload has no bandwidth: 0.
    """
    from beamdesign.proofs.certifying import certify as prove

    found = prove(prototype, *prototype.asked_kg())
    around = prove(prototype, options.from_kg, options.to_kg)
    low, high = max(around.stable_ranges_kg, key=lambda ends: ends[1] - ends[0], default=(0.0, 0.0))
    longest = {"stable_from_kg": low, "stable_to_kg": high, "stable_width_kg": high - low}
    return Answer(_guaranteed(found, 0.0) | longest, {"method": found.method}, found.reason)


def lag_breaks(prototype: Prototype, options: Any) -> Answer:
    """Exact zero frequencies with which a lag is stable for every payload, at its pole and gain.

    The prototype's own zero only tells whether it is inside.
    """
    from beamdesign.proofs.rectangle import stable_zeros

    law = prototype.controller
    if law is None or law.lacks("lag") or (lag := law.lag) is None:
        raise InputError(prototype.name, [("controller", "must be a lag")])
    low, high = prototype.asked_kg()
    found = stable_zeros(prototype, lag.pole_Hz, law.gain_A_per_V, (low, high))
    outputs = {
        "stable_zero_from_Hz": [least for least, _ in found],
        "stable_zero_to_Hz": [most for _, most in found],
        "own_zero_stable": any(least <= lag.zero_Hz <= most for least, most in found),
    }
    return Answer(outputs, reason="" if found else f"no zero is stable for every mass from {low:g} to {high:g} kg")


def at_mass(prototype: Prototype, options: case.AtMassOptions) -> Answer:
    """Stability, margins and bandwidth at one mass on the outer tip; an unstable loop is a no."""
    from beamdesign.loop import critical_gain, loop

    there = loop(prototype).at(options.outer_end_mass_kg)
    outputs: dict[str, Any] = {"stable": there.stable}
    try:
        critical = critical_gain(prototype, options.outer_end_mass_kg)
        outputs |= picked(critical, "critical_gain_A_per_V=gain_A_per_V critical_frequency_Hz=frequency_Hz")
    except ValueError:  # it oscillates at no gain, or at every low one: there is no such figure
        outputs |= {"critical_gain_A_per_V": None, "critical_frequency_Hz": None}
    if not there.stable:
        return Answer(outputs, reason=f"unstable with {options.outer_end_mass_kg:g} kg on the outer tip")
    outputs |= {
        "bandwidth_Hz": there.bandwidth_Hz(prototype.goal.compliance_m_per_N),
        "peak_sensitivity": there.peak_sensitivity(),
        **picked(there.margins(), "gain_margin=gain_up phase_margin_deg=phase_deg"),
        "static_compliance_m_per_N": there.static_compliance(),
    }
    return Answer(outputs)


def arm(prototype: Prototype, options: case.ArmOptions) -> Answer:
    """Both planes with torsion over the payload range, and the error that a load leaves; "no" where not stable."""
    from beamdesign.proofs.arm.result import arm as work_out
    from beamdesign.proofs.arm.result import usual_load_N

    masses = prototype.asked_kg()
    force = -usual_load_N(prototype, masses[1])[2] if options.force_N is None else options.force_N
    found = work_out(prototype, masses, (0.0, 0.0, -force))
    outputs: dict[str, Any] = {"stable": found.stable, "force_N": force, "error_alone_m": found.without.size_m}
    if found.with_servo is not None:
        outputs["error_m"] = found.with_servo.size_m
        outputs |= {f"error_by_{cause}_m": size for cause, size in found.with_servo.shares_m.items()}
        outputs |= dict(zip(case.ERRORS.split(), found.with_servo.rotation_rad, strict=True))
    outputs["torsion_tip_held_Hz"] = found.frequencies[-1].torsion_held_Hz
    sure = [plane.guaranteed for plane in found.planes if plane.guaranteed is not None]
    if sure and len(sure) == len(found.planes):  # the worse of both; nothing where the payload couples them
        worse = {"peak_sensitivity": max, "tip_bandwidth_Hz": min, "load_bandwidth_Hz": min}
        outputs |= {name: of(getattr(plane, name) for plane in sure) for name, of in worse.items()}
    return Answer(outputs, {"notes": list(found.figures.notes)}, found.reason)


def limits(prototype: Prototype, options: case.LimitsOptions) -> Answer:
    """Largest force on the tip at 1, 10 and 100 Hz with one mass there, what governs it, and the static error."""
    import numpy as np

    from beamdesign.synthesis.operating_limits import envelope, sensor_reach

    shown_Hz, mass = np.array([1.0, 10.0, 100.0]), options.outer_end_mass_kg
    if mass is None:
        mass = (prototype.outer_end_mass_kg or (0.0, 0.0))[1]
    found = envelope(prototype, mass, frequency_Hz=shown_Hz)
    outputs: dict[str, Any] = {}
    for k, frequency in enumerate(shown_Hz if not found.reason else ()):
        outputs[f"load_at_{frequency:g}_Hz_N"] = float(found.load_N[k])
        outputs[f"governing_at_{frequency:g}_Hz"] = found.governing[k]
        outputs[f"displacement_at_{frequency:g}_Hz_m"] = float(found.displacement_m[k])
    if not found.reason:
        outputs["static_error_m_per_N"] = sensor_reach(prototype, mass).static_error_m_per_N
    return Answer(outputs, {"missing": found.missing}, found.reason)


def sim_to_real(prototype: Prototype, options: case.SimToRealOptions) -> Answer:
    """Design, build a virtual rig, take records, diagnose, redesign, and look at the rig again.

    Bandwidths are proved of the model that they name. Whether a design runs is simulated on the virtual rig; gain
    margins are those of the linearised one, told only where that has the effect in it.
    """
    from beamdesign.diagnosis.data.dataset import read_dataset
    from beamdesign.diagnosis.diagnose import diagnose
    from beamdesign.diagnosis.redesign import redesign
    from beamdesign.synthesis.tuning import tune as designed_for
    from beamdesign.validation.truth.case import write_case
    from beamdesign.validation.virtual_rig import LINEAR, RunawayError, gain_margin, runs, virtual_rig

    masses = prototype.asked_kg()
    designed = designed_for(prototype, masses)
    if designed.best is None:
        return Answer({}, reason=designed.reason)
    built = (options.effect, options.severity, options.seed, options.duration_s)
    try:
        rig = virtual_rig(designed.prototype, masses, *built)
    except RunawayError as error:
        return Answer({"believed_bandwidth_Hz": designed.best.bandwidth_Hz}, reason=str(error))
    with TemporaryDirectory() as folder:
        write_case(rig, Path(folder))
        data = read_dataset(folder)
    found = diagnose(data, workers=1)
    renewed = redesign(found.prototype, masses)
    linear, new = options.effect in LINEAR, renewed.prototype
    outputs = {
        "believed_bandwidth_Hz": designed.best.bandwidth_Hz,
        "believed_design_runs": runs(rig, designed.prototype, masses),
        "believed_design_gain_margin": gain_margin(rig, designed.prototype, masses) if linear else None,
        "verdict": found.verdict,
        "named": list(found.chosen),
        "named_rightly": list(found.chosen) == list(rig.names if rig.departures else ()),
        "gap_before": found.gap.before,
        "gap_after": found.gap.after,
        "gap_closed": found.gap.closed,
        "redesigned_bandwidth_Hz": new.guarantee.bandwidth_Hz if new is not None and new.guarantee else None,
        "redesign_runs": None if new is None else runs(rig, new, masses),
        "redesign_gain_margin": gain_margin(rig, new, masses) if new is not None and linear else None,
    }
    return Answer(outputs, {"sentences": found.sentences, "diagnosed": found.prototype, "redesign": renewed.reason})
