"""Shadow prices in words: what asking for a little more would cost in beam mass."""

from beamdesign.report.quantity import decimal

_REQUIREMENTS = {
    "tip_force": "tip force",
    "safety_strength": "safety factor on strength",
    "safety_local_buckling": "safety factor on local buckling",
    "clearance_assembly": "clearance at assembly",
    "clearance_under_load": "clearance under load",
    "least_wall": "least wall",
    "largest_width": "largest width",
    "width_to_wall_at_most": "largest width to wall",
}
_STEPS = {"percent": ("1 % more", 1.0), "mm": ("0.1 mm more", 0.1)}
"""Small enough that a slope is a fair account of the change: in words, and in the price's unit."""

NEGLIGIBLE_KG = 1e-6
"""Prices below this are called none."""


def price_words(prices: dict[str, float]) -> list[str]:
    """One sentence per requirement that has a price, the dearest first, and one that names those that have none.

    Args:
        prices: kg per unit, by names such as "tip_force_kg_per_percent".
    """
    dear = sorted((name for name in prices if abs(prices[name]) > NEGLIGIBLE_KG), key=lambda name: -abs(prices[name]))
    said = [_sentence(name, prices[name]) for name in dear]
    free = [_split(name)[0] for name in prices if name not in dear]
    if free:
        said.append(f"A little more or less of these changes nothing: {', '.join(free)}.")
    return said


def _split(name: str) -> tuple[str, str]:
    requirement, _, unit = name.partition("_kg_per_")
    return _REQUIREMENTS.get(requirement, requirement.replace("_", " ")), unit


def _sentence(name: str, price: float) -> str:
    requirement, unit = _split(name)
    step, share = _STEPS.get(unit, (f"one {unit} more", 1.0))
    effect = f"{'costs' if price > 0 else 'saves'} {decimal(abs(price) * share, 3)} kg"
    return f"{step[:1].upper()}{step[1:]} {requirement} {effect} of beam mass."
