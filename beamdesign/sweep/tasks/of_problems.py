"""Tasks on design problems: what is found from a study file. Each loads the engine that it needs."""

from typing import TYPE_CHECKING, Any

from beamdesign.json_text import picked
from beamdesign.problem import DesignProblem
from beamdesign.records import InputError
from beamdesign.sweep.tasks import (
    POINT,
    REMEDY,
    SIZED,
    Answer,
    CodesignOptions,
    RemediesOptions,
    payload_range,
    proved_outputs,
)

if TYPE_CHECKING:
    from beamdesign.synthesis.checks import Check
    from beamdesign.synthesis.sizing import Sizing


def size(problem: DesignProblem, options: Any) -> Answer:
    """Sections of least mass of one problem."""
    from beamdesign.synthesis.sizing import size as find_sections

    found = find_sections(problem)
    return Answer(*sizing_outputs(found), "" if found.feasible else found.reason)


def sizing_outputs(found: "Sizing") -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns of a sizing, and what governs it: checks, shadow prices, what to relax."""
    prices = {name: float(price) for name, price in found.shadow_prices.items()}
    outputs = picked(found, SIZED) | {
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

    found = run_design(problem)
    outputs, details = sizing_outputs(found.sizing)
    if found.tuning is not None and found.tuning.best is not None:
        outputs |= proved_outputs(found.tuning.best)
        outputs["moving_mass_kg"] = found.sizing.beam_mass_kg + found.tuning.best.inner_end_mass_kg
    if found.prototype is not None and found.prototype.guarantee is not None:
        outputs["certificate_sha256"] = found.prototype.guarantee.certificate_sha256
        details["prototype"] = found.prototype.model_dump(mode="json", exclude_none=True)
    return Answer(outputs, details, found.reason)


def codesign(problem: DesignProblem, options: CodesignOptions) -> Answer:
    """Lightest proved design of one problem: sections, end mass and controller together."""
    from beamdesign.synthesis.codesign import codesign as find_design

    found = find_design(problem, payload_range(problem), options.bandwidth_Hz)
    attempts = [attempt if isinstance(attempt, str) else f"{attempt:.6g} kg" for attempt in found.attempts]
    point = found.point
    if point is None:
        return Answer({}, {"attempts": attempts}, found.reason)
    details = {
        "checks": [check_fields(check) for check in point.checks],
        "attempts": attempts,
        "prototype": point.prototype.model_dump(mode="json", exclude_none=True),
    }
    return Answer(picked(point, f"{POINT} governing") | proved_outputs(point.proved), details)


def remedy(problem: DesignProblem, options: RemediesOptions) -> Answer:
    """One of the paper's remedies for payload, optimised from the given sections and proved."""
    from beamdesign.synthesis.remedies import one_remedy

    if missing := [name for name in ("outer_beam", "inner_beam") if getattr(problem, name).width_m is None]:
        reason = "the remedies start from given sections: width_m and wall_m are needed"
        raise InputError(problem.name, [(name, reason) for name in missing])
    found = one_remedy(problem, options.remedy, payload_range(problem), options.added_mass_kg)
    laws = {name: [getattr(law, name) for law in found.controllers] for name in ("gain_A_per_V", "pole_Hz", "zero_Hz")}
    outputs = {"remedy": found.name, **picked(found, REMEDY), **laws}
    return Answer(outputs, {"parts_kg": [list(part) for part in found.parts_kg]}, found.reason)
