"""What a certificate is about, in words: its rig, its controller, its effects with their sizes, and what is asked."""

from collections.abc import Iterator
from typing import Any

from beamdesign.checker.reading import Table, short
from beamdesign.checker.rig import Effect, Rig
from beamdesign.checker.roots import Pair

_ASKED = ("payload", "goal", "arm", "compliance", "material")


def about(table: Table, rig: Rig) -> Iterator[str]:
    """The rig as it is stated, a line for each part, figures with their units in their names."""
    yield f"label (not proved): {table.word('name')[:200]!r}"
    figures = ", ".join(f"{name} {short(value)}" for name, value in rig.figures.items())
    yield f"rig: {figures}, inner_end_mass_kg {short(rig.inner_end_mass)}"
    if rig.law is not None:
        yield f"controller: {_words(rig.law.figures)}"
    for effect in rig.effects:
        yield from _effect(effect)
    for name in _ASKED:
        if entries := table.optional(name).whole_of_it():
            yield f"{name}: {_words(entries)}"


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
