"""Task `size`: sections of least mass."""

from typing import Any

from beamdesign.design.checks import Check
from beamdesign.design.sizing import Sizing
from beamdesign.design.sizing import size as find_sections
from beamdesign.problem import DesignProblem
from beamdesign.study.answer import Answer


def compute(problem: DesignProblem, options: Any) -> Answer:
    """Size the sections of one problem."""
    found = find_sections(problem)
    return Answer(outputs(found), details(found), "" if found.feasible else found.reason)


def outputs(found: Sizing) -> dict[str, Any]:
    """Columns of a sizing."""
    prices = {f"price_{name}": float(price) for name, price in found.shadow_prices.items()}
    return {
        "beam_mass_kg": found.beam_mass_kg,
        "outer_width_m": found.outer.width_m,
        "outer_wall_m": found.outer.wall_m,
        "inner_width_m": found.inner.width_m,
        "inner_wall_m": found.inner.wall_m,
        "governing": found.governing,
        "free_beam_mass_kg": found.free.pair.beam_mass_kg if found.free else None,
        "price_of_rounding_kg": found.price_of_rounding_kg,
        **prices,
    }


def details(found: Sizing) -> dict[str, Any]:
    """What governs a sizing: checks, shadow prices, what to relax."""
    return {
        "checks": [check_fields(check) for check in found.checks],
        "shadow_prices": {name: float(price) for name, price in found.shadow_prices.items()},
        "active": list(found.free.active) if found.free else [],
        "relaxations": [{"key": item.key, "asked": item.asked, "enough": item.enough} for item in found.relaxations],
    }


def check_fields(check: Check) -> dict[str, Any]:
    """A check as plain values, in the unit that people read it in."""
    value, limit, unit = check.shown
    return {
        "name": check.name,
        "value": value,
        "limit": limit,
        "unit": unit,
        "at_least": check.at_least,
        "utilisation": check.utilisation,
        "satisfied": bool(check.satisfied),
    }
