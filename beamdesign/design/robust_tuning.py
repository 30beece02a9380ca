"""Robust tuning: the largest bandwidth that is guaranteed for a nominal rig and for the worst rigs of its tolerances.

Limits are held on samples at the worst rig of every point; of the best design the worst rigs are collected, and each is
proved over the whole payload range as the nominal one is. The rigs between are not proved.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamdesign.controllers import SENSED, Sensed
from beamdesign.design.law_search import Search
from beamdesign.design.rig_spread import RigSpread, Shape, rig_spread
from beamdesign.design.tuning import Progress, Tuning, tune
from beamdesign.design.worst_samples import WorstSamples, worst_rigs
from beamdesign.members import family
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem


@dataclass(frozen=True)
class RobustTuning:
    """Outcome of `tune_robust`.

    Attributes:
        tuning: as of `beamdesign.design.tuning.tune`; its figures are proved for the nominal rig and for `rigs`.
        spread: of the tuned prototype.
        rigs: the worst rigs that were proved, as prototypes with the tuned controller.
        factors: of each, what its figures are multiplied by.
    """

    tuning: Tuning
    spread: RigSpread
    rigs: tuple[Prototype, ...]
    factors: tuple[dict[str, float], ...]


def tune_robust(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    sigmas: float,
    kind: str = "lag",
    largest_inner_end_mass_kg: float = 6.0,
    progress: Progress | None = None,
    sections: int = 3,
    shape: Shape = "ball",
    sensors: Sequence[Sensed] = SENSED[:1],
) -> RobustTuning:
    """Tune controller and inner end mass for the largest bandwidth that rigs within the tolerances keep.

    Args:
        prototype: the rig with its `[tolerance]`; its goal sets the limits, which all rigs are to keep.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed.
        sigmas: how many standard deviations rigs may be off, above 0.
        kind: as of `beamdesign.design.tuning.tune`.
        largest_inner_end_mass_kg: most mass that may be added to the inner tip.
        progress: told the share done and what is being done.
        sections: second-order sections of a structured controller.
        shape: what so many standard deviations are, see `beamdesign.design.rig_spread.RigSpread`.
        sensors: what an observer reads.

    Raises:
        InputError: where no figure has a tolerance, or for effects for which no linear loop stands.
        ValueError: for sigmas that are not positive.
    """
    if not sigmas > 0:
        raise ValueError("robust against nothing: sigmas must be positive")
    masses, most = outer_end_mass_kg, largest_inner_end_mass_kg
    spread = rig_spread(prototype.but(controller=None, guarantee=None), masses[1], sigmas, shape)
    found = tune(prototype, masses, kind, most, progress, sections, sensors, spread)
    if found.best is None:
        return RobustTuning(found, spread, (), ())
    spread = rig_spread(found.prototype, masses[1], sigmas, shape)
    rigs, factors = tuple(map(spread.rig, found.worst)), tuple(map(spread.factors, found.worst))
    return RobustTuning(found, spread, rigs, factors)


@dataclass(frozen=True)
class WorstRigs:
    """The worst rigs of a prototype that has a controller.

    Attributes:
        rigs: as prototypes.
        factors: of each, what its figures are multiplied by.
    """

    rigs: tuple[Prototype, ...]
    factors: tuple[dict[str, float], ...]


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
    return WorstRigs(tuple(spread.rig(z) for z in found), tuple(spread.factors(z) for z in found))
