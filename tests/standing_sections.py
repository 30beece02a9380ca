"""Sections of a rig that may not change: no variables, so that whoever searches them has the law alone to search."""

from typing import Any

import casadi as ca
import numpy as np

from beamdesign import Prototype
from beamdesign.plant.members import family
from beamdesign.synthesis.loop_program import sized_slack
from beamdesign.synthesis.sections import Sections


def standing(rig: Prototype, /, **other: Any) -> Sections:
    """Sections of a rig with one member and no filter; `other` has what is to be otherwise."""
    (only,) = family(rig).members
    none, figures = np.zeros(0), ca.DM(list(only.rig.figures.values()))
    own: dict[str, Any] = {
        "figures": lambda chosen: ca.MX(figures),
        "slack": lambda shape, kind: sized_slack(shape, kind, False, rig.rig),
        "prototype": lambda chosen, rounded: rig,
        "structure": lambda inner, chosen: ca.DM(0, 1),
        "moving_mass": lambda inner, chosen: 10.0 + inner,
        "flaw": lambda inner, chosen: "",
    }
    needed = other.pop("needed_Hz", None)
    methods = {name: staticmethod(method) for name, method in (own | other).items()}
    kind = type("Standing", (Sections,), methods | {"bounds": (none, none), "start": none, "mass_unit_kg": 1.0})
    return kind(problem=None, begun=none, needed_Hz=needed)
