"""The worst rigs of a prototype's tolerances: those that a robust tuning proves beside the nominal one, or sought anew.

Limits are held on samples at the worst rig of every point; of the best design the worst rigs are collected, and each is
proved over the whole payload range as the nominal one is. The rigs between are not proved.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamdesign.design.law_search import Search
from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.worst_samples import WorstSamples, worst_rigs
from beamdesign.members import family
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem


@dataclass(frozen=True)
class WorstRigs:
    """The worst rigs of a prototype that has a controller.

    Attributes:
        rigs: as prototypes.
        factors: of each, what its figures are multiplied by.
    """

    rigs: tuple[Prototype, ...]
    factors: tuple[dict[str, float], ...]


def rigs_of(spread: RigSpread, deviations: Sequence[np.ndarray]) -> WorstRigs:
    """Rigs that are off by (d,) standard deviations each."""
    return WorstRigs(tuple(map(spread.rig, deviations)), tuple(map(spread.factors, deviations)))


def worst_of(spread: RigSpread, outer_end_mass_kg: tuple[float, float]) -> WorstRigs:
    """Seek the rigs of a spread that are worst for the limits of the goal, on samples.

    Args:
        spread: of a prototype with a controller.
        outer_end_mass_kg: range of outer end mass.

    Raises:
        InputError: for a controller that a tuner has no form for, or none.
    """
    prototype, law = spread.prototype, spread.prototype.controller
    if law is None or (opened := law.form()) is None:
        reason = "worst rigs are sought for a controller that a tuner has a form for"
        raise InputError(prototype.name, [Problem("controller.kind", reason)])
    members = family(prototype, outer_end_mass_kg[1]).members
    task = Search(members, prototype.goal, outer_end_mass_kg, (0.0, 0.0), law.senses, spread)
    assert isinstance(task.points, WorstSamples)  # there is a spread
    form, variables = opened
    inside = prototype.payload.inner_end_mass_kg
    found = worst_rigs(task.points, prototype.goal, form, np.append(variables, inside))
    return rigs_of(spread, found)
