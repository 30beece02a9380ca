"""The believed prototype with what a fit has found: figures re-tuned, effects added."""

from collections.abc import Mapping
from math import sqrt
from typing import Any

from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import SUPPLY
from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Beam, Prototype
from beamdesign.records import Record
from beamdesign.structure import lumped


def updated_prototype(prototype: Prototype, found: Fit) -> Prototype:
    """Put a fit's figures and effects into a prototype.

    A proof that stood for the believed figures does not stand for the new ones, so the guarantee is dropped.
    """
    figures = lumped.figures(prototype) | {u: v for u, v in found.values.items() if "." not in u}
    # The model's dashpot goes with the root of K M of its beam; so does the fitted one.
    nominal = lumped.figures(prototype)
    for beam in ("outer", "inner"):
        for part in ("stiffness", "mass"):
            figures[f"{beam}_damping"] *= sqrt(figures[f"{beam}_{part}"] / nominal[f"{beam}_{part}"])
    effects: dict[str, dict[str, float]] = {name: dict(table) for name, table in prototype.effects.items()}
    for name in found.hypothesis.effects:
        own = {
            u.name.removeprefix(name + "."): u.value(z)
            for u, z in zip(found.unknowns, found.z, strict=True)
            if u.name.startswith(name + ".")
        }
        effects[name] = {key: float(value) for key, value in own.items()}
    changes: dict[str, Any] = {
        "outer_beam": _beam(prototype.outer_beam, "outer", figures),
        "inner_beam": _beam(prototype.inner_beam, "inner", figures),
        **_others(prototype, figures),
        "supply": prototype.supply.but(pressure_Pa=found.values.get(SUPPLY, prototype.supply.pressure_Pa)),
        "effects": effects,
        "guarantee": None,
    }
    return prototype.but(**changes)


def _others(prototype: Prototype, figures: Mapping[str, float]) -> dict[str, Record]:
    """Tables of a prototype beside its beams, with new figures where it states any."""
    changes: dict[str, dict[str, float]] = {}
    for name, row in PARAMETERS.items():
        table, key = row.place.split(".")
        if name in figures and "_beam" not in table and row.stated(prototype) is not None:
            changes.setdefault(table, {})[key] = figures[name] / row.factor
    return {table: getattr(prototype, table).but(**new) for table, new in changes.items()}


def _beam(beam: Beam, name: str, figures: dict[str, float]) -> Beam:
    stiffness, mass, dashpot = (figures[f"{name}_{part}"] for part in ("stiffness", "mass", "damping"))
    ratio = dashpot / (2 * sqrt(stiffness * mass))
    return beam.but(stiffness_N_per_m=stiffness, effective_mass_kg=mass, damping_ratio=ratio)
