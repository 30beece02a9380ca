"""What a certificate is about, in words: its rig, its controller, its effects with their sizes, and what is asked."""

from collections.abc import Iterable, Iterator
from typing import Any

from beamdesign.checker.reading import Table, Unreadable, rational, short
from beamdesign.checker.rig import Effect, Rig
from beamdesign.checker.roots import Pair

ASKED = {
    "payload": ("outer_end_mass_kg", "inner_end_mass_kg", "largest_force_N"),
    "goal": ("compliance_m_per_N", "peak_sensitivity", "loop_gain", "loop_gain_from_Hz", "controller_effort_A_per_V"),
    "arm": (
        "offset_m", "tool_m", "sensor_m", "end_polar_inertia_kg_m2", "payload_polar_inertia_kg_m2",
        "torsional_stiffness_N_m_per_rad", "torsional_damping_ratio", "second_controller",
    ),
    "compliance": ("end_stiffness_N_per_m", "force_filter_Hz", "servo"),
    "tolerance": (
        "stiffness", "effective_mass", "beam_damping_ratio", "oil_stiffness", "piston_area", "flow_gain", "leakage",
        "valve_natural_frequency", "valve_damping_ratio", "sensor_gain", "sensor_filter", "outer_end_mass",
        "inner_end_mass",
    ),
}  # fmt: skip
_ALLOY = ("youngs_modulus_Pa", "shear_modulus_Pa", "density_kg_per_m3")
_LENGTHS = {"outer_end_mass_kg": 2, "offset_m": 3, "tool_m": 3, "sensor_m": 3}
_LAWS = ("second_controller", "servo")


def about(table: Table, rig: Rig | None) -> Iterator[str]:
    """The rig as it is stated, a line for each part, figures with their units in their names."""
    yield f"label (not proved): {table.word('name')[:200]!r}"
    if rig is None:
        yield "an expression, and no rig"
        return
    figures = ", ".join(f"{name} {short(value)}" for name, value in rig.figures.items())
    yield f"rig: {figures}, inner_end_mass_kg {short(rig.inner_end_mass)}"
    if (controller := rig.law or rig.schedule) is not None:
        yield f"controller: {_words(controller.figures)}"
    for effect in rig.effects:
        yield from _effect(effect)
    for name, known in ASKED.items():
        yield from _figures(table.optional(name), known)
    alloys = table.optional("material")
    for name in alloys.keys:
        yield from _figures(alloys.table(name), _ALLOY)


def _figures(table: Table, known: Iterable[str]) -> Iterator[str]:
    """A table of which nothing is proved, but whose keys are known and whose figures are numbers."""
    entries = {key: table.take(key) for key in known if key in table}
    for key in entries:
        if key in _LAWS:
            _refuse_words(entries[key], table.place_of(key))
        elif key not in _LENGTHS:
            table.number(key)
        elif len(table.numbers(key)) != _LENGTHS[key]:
            raise Unreadable(f"{table.place_of(key)} must be {_LENGTHS[key]} numbers")
    if entries:
        yield f"{table.place}: {_words(entries)}"


def _refuse_words(value: Any, place: str) -> None:
    """Refuse whatever is no number in a controller's figures, but for its kind and its sensors."""
    if not isinstance(value, dict | list):
        rational(value, place)
        return
    for key, item in value.items() if isinstance(value, dict) else enumerate(value, start=1):
        if key not in ("kind", "sensors"):
            _refuse_words(item, f"{place}.{key}")


def _effect(effect: Effect) -> Iterator[str]:
    sizes = ", ".join(f"{key} {short(value)}" for key, value in effect.parameters.items())
    yield f"effect {effect.name}: {sizes}"
    if effect.gain[0] != 1 or effect.gain[1] != 1:
        yield f"effect {effect.name}: gain times {_range(effect.gain)}, {_range(effect.performing)} to perform"
    for name, span in effect.spans.items():
        yield f"effect {effect.name}: {name} at {_range(span.ends, ' and ')}, {_range(span.performing)} to perform"


def _range(pair: Pair, between: str = " to ") -> str:
    return f"{short(pair[0])}{between}{short(pair[1])}"


def _words(value: Any) -> str:
    """Entries as they stand, with their names."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items())[:2000]
    if isinstance(value, list):
        return f"[{', '.join(map(_words, value))}]"
    return str(value)
