"""The library of effects: every file of this folder holds one, some with further laws of it; and laws to be learnt."""

import difflib
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from beamdesign.plant.effect import Effect
from beamdesign.plant.empirical import laws
from beamdesign.records import Problem


@cache
def library() -> dict[str, Effect]:
    """All effects by name, in alphabetical order: of each file `EFFECT`, which has its name, and other laws of it.

    Then the laws that are learnt from data.

    Raises:
        ValueError: where a file's name is not that of its effect.
    """
    found: dict[str, Effect] = {}
    for module in sorted(iter_modules(__path__), key=lambda item: item.name):
        held = import_module(f"{__name__}.{module.name}")
        if held.EFFECT.name != module.name:
            raise ValueError(f"{module.name} holds the effect {held.EFFECT.name}")
        found |= {each.name: each for each in vars(held).values() if isinstance(each, Effect)}
    return dict(sorted(found.items())) | {effect.name: effect for effect in laws()}


def causes() -> dict[str, Effect]:
    """Those that are causes by themselves."""
    return {name: effect for name, effect in library().items() if effect.nearest is None}


def register(effect: Effect) -> None:
    """Make one more effect known.

    Raises:
        ValueError: where there is one of that name.
    """
    if effect.name in library():
        raise ValueError(f"there is an effect {effect.name} already")
    library()[effect.name] = effect


def problems(tables: Mapping[str, Mapping[str, float]]) -> list[Problem]:
    """What is wrong with the `[effects.NAME]` tables of a prototype: unknown names, figures out of bounds."""
    known, found = library(), []
    for name, table in tables.items():
        if name not in known:
            found.append(Problem(f"effects.{name}", "unknown effect" + _suggestion(name, list(known))))
            continue
        parameters = {parameter.name: parameter for parameter in known[name].parameters}
        for key, value in table.items():
            where = f"effects.{name}.{key}"
            if key not in parameters:
                found.append(Problem(where, "unknown parameter" + _suggestion(key, list(parameters))))
            elif not parameters[key].low <= value <= parameters[key].high:
                found.append(
                    Problem(where, f"must be from {parameters[key].low:g} to {parameters[key].high:g}, is {value:g}")
                )
    return found


def _suggestion(word: str, known: list[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else f"; known are {', '.join(known)}"
