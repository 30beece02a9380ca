"""A prototype with some of its figures multiplied: a member of a box of tolerances."""

from collections.abc import Mapping
from math import sqrt
from typing import Any

from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Beam, Prototype
from beamdesign.structure.lumped import lumped_beam

_PARTS = {name: row.place for name, row in PARAMETERS.items() if "_beam." not in row.place and name != "outer_end_mass"}
_PARTS |= {
    "controller_gain": "controller.gain_A_per_V",
    "controller_pole": "controller.pole_Hz",
    "controller_zero": "controller.zero_Hz",
}
_BEAMS = tuple(name for name, row in PARAMETERS.items() if "_beam." in row.place)
CHANGEABLE = (*_BEAMS, *_PARTS)
"""Figures that can be changed, named as in `beamdesign.proofs.rig_family.rig_values`."""


def with_figures(prototype: Prototype, factors: Mapping[str, float]) -> Prototype:
    """Multiply figures; those that are not named keep their values, a dashpot too when its beam's stiffness changes.

    Raises:
        KeyError: for a name that is not in `CHANGEABLE`.
    """
    if unknown := sorted(set(factors) - set(CHANGEABLE)):
        raise KeyError(f"cannot change {', '.join(unknown)}")
    changed: dict[str, Any] = {"guarantee": None}
    for name in ("outer", "inner"):
        changed[f"{name}_beam"] = _beam(
            getattr(prototype, f"{name}_beam"),
            *(factors.get(f"{name}_{figure}", 1.0) for figure in ("stiffness", "mass", "damping")),
        )
    for name, place in _PARTS.items():
        if name in factors:
            part, key = place.split(".")
            record = changed.get(part, getattr(prototype, part))
            changed[part] = record.but(**{key: _short(getattr(record, key) * factors[name])})
    return prototype.but(**changed)


def _beam(record: Beam, stiffness: float, mass: float, damping: float) -> Beam:
    if stiffness == mass == damping == 1.0:
        return record
    found = lumped_beam(record)
    return record.but(
        stiffness_N_per_m=_short(found.stiffness * stiffness),
        effective_mass_kg=_short(found.mass * mass),
        damping_ratio=_short(record.damping_ratio * damping / sqrt(stiffness * mass)),
    )


def _short(value: float) -> float:
    """To ten digits: exact arithmetic on figures with all digits of a float takes several times as long."""
    return float(f"{value:.10g}")
