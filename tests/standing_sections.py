"""Sections of a rig that may not change: no variables, so that whoever searches them has the law alone to search."""

from typing import Any

import casadi as ca
import numpy as np

from beamdesign.plant.members import family
from beamdesign.prototype import Prototype
from beamdesign.synthesis.sections import Sections


def standing(rig: Prototype, /, **other: Any) -> Sections:
    """Sections of a rig with one member and no filter; `other` has fields that are to be otherwise."""
    (only,) = family(rig).members
    none, figures = np.zeros(0), ca.DM(list(only.rig.figures.values()))
    fields: dict[str, Any] = {
        "start": none,
        "lower": none,
        "upper": none,
        "figures": lambda chosen: ca.MX(figures),
        "filtered": False,
        "rig": rig.rig,
        "prototype": lambda chosen, rounded: rig,
        "structure": lambda inner, chosen: ca.DM(0, 1),
        "moving_mass": lambda inner, chosen: 10.0 + inner,
        "flaw": lambda inner, chosen: "",
    }
    return Sections(**fields | other)
