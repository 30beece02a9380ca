"""Robust tuning: the largest bandwidth that is guaranteed for a nominal rig and for the worst rigs of its tolerances.

Limits are held on samples at the worst rig of every point; of the best design the worst rigs are collected, and each is
proved over the whole payload range as the nominal one is. The rigs between are not proved.
"""

from dataclasses import dataclass

import numpy as np

from beamdesign.design.controller_forms import lag_and_sections
from beamdesign.design.rig_samples import rig_samples
from beamdesign.design.rig_spread import RigSpread, Shape, rig_spread
from beamdesign.design.structured_tuning import grow
from beamdesign.design.tuning import SMALLEST_BANDWIDTH_HZ, Progress, Tuning, no_answer, tuned
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
) -> RobustTuning:
    """Tune controller and inner end mass for the largest bandwidth that rigs within the tolerances keep.

    Args:
        prototype: the rig with its `[tolerance]`; its goal sets the limits, which all rigs are to keep.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed.
        sigmas: how many standard deviations rigs may be off, above 0.
        kind: lag, proportional or structured.
        largest_inner_end_mass_kg: most mass that may be added to the inner tip.
        progress: told the share done and what is being done.
        sections: second-order sections of a structured controller.
        shape: what so many standard deviations are, see `beamdesign.design.rig_spread.RigSpread`.

    Raises:
        InputError: where no figure has a tolerance, or for effects for which no linear loop stands.
        ValueError: for a kind that is none of these, or sigmas that are not positive.
    """
    if kind not in ("lag", "proportional", "structured"):
        raise ValueError(f"no robust tuning of kind {kind!r}")
    if not sigmas > 0:
        raise ValueError("robust against nothing: sigmas must be positive")
    masses, most = outer_end_mass_kg, largest_inner_end_mass_kg
    spread = rig_spread(prototype.but(controller=None, guarantee=None), masses[1], sigmas, shape)
    grown = grow(
        family(prototype, masses[1]).members,
        prototype.goal,
        masses,
        most,
        sections if kind == "structured" else 0,
        progress or (lambda share, text: None),
        spread,
        proportional=kind == "proportional",
    )
    best = grown.proved
    if best is None or best.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
        why = no_answer(f"robust {kind}", prototype.goal, masses, grown.reason)
        found = Tuning(prototype, masses, None, grown.sampled, (grown.reason,), grown.certificates, why)
        return RobustTuning(found, spread, (), ())
    built = tuned(prototype, best, masses)
    spread = rig_spread(built, masses[1], sigmas, shape)
    found = Tuning(built, masses, best, grown.sampled, (), grown.certificates)
    return RobustTuning(
        found, spread, tuple(spread.rig(z) for z in grown.worst), tuple(spread.factors(z) for z in grown.worst)
    )


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
        spread: of a prototype with a controller, proportional, lag or structured.
        outer_end_mass_kg: range of outer end mass.

    Raises:
        InputError: for another controller, or none.
    """
    prototype = spread.prototype
    members = family(prototype, outer_end_mass_kg[1]).members
    points = rig_samples(members, prototype.goal, outer_end_mass_kg, spread)
    assert isinstance(points, WorstSamples)  # there is a spread
    found = worst_rigs(points, prototype.goal, _variables(prototype))
    return WorstRigs(tuple(spread.rig(z) for z in found), tuple(spread.factors(z) for z in found))


def _variables(prototype: Prototype) -> np.ndarray:
    """The variables of `beamdesign.design.sampled_loops` at which a prototype stands."""
    law = prototype.controller
    if law is None or law.lacks("lag and sections"):
        reason = "worst rigs are sought for a proportional, lag or structured controller"
        raise InputError(prototype.name, [Problem("controller.kind", reason)])
    return np.append(np.log(lag_and_sections(law)), prototype.payload.inner_end_mass_kg)
