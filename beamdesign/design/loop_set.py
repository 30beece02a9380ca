"""The loops that one controller has to serve: those of all linear members of a rig."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import inf, log

import casadi as ca
import numpy as np

from beamdesign.controllers import Controller
from beamdesign.design.loop_constraints import member_slack
from beamdesign.design.loop_search import GridPlant, grid_plant
from beamdesign.linear import LinearModel
from beamdesign.loop import Loop, rig_loop
from beamdesign.members import Member
from beamdesign.polynomial import exact
from beamdesign.proof.certificate import goal_claims
from beamdesign.proof.performance import Claim
from beamdesign.proof.rectangle import (
    Rectangle,
    at_mass,
    bandwidth,
    largest_effort,
    largest_loop_gain,
    peak_sensitivity,
    prove,
    prove_peak,
    scaled,
)
from beamdesign.prototype import Goal

LOOSER_PEAK = 3.0
"""An optimiser keeps members that only have to be stable within the limit of sensitivity times this."""


@dataclass(frozen=True)
class Constraint:
    """What an optimiser enforces of one loop at its check points.

    Attributes:
        slack: see `beamdesign.design.loop_constraints.loop_slack`.
        looser: logarithm of what the limit of sensitivity is raised by.
        performs: whether compliance and the limits of loop gain and effort are enforced as well.
        limits: slacks of those, see `beamdesign.design.loop_constraints.limit_slack`.
    """

    slack: ca.Function
    limits: ca.Function
    looser: float = 0.0
    performs: bool = True


def constraints(kind: str, members: Sequence[Member], active: Collection[int]) -> list[Constraint]:
    """Of the members with the given numbers, at both ends of their gains."""
    return [
        Constraint(
            member_slack(kind, rig.polynomials(), factor),
            member_slack(kind, rig.polynomials(), factor, limits=True),
            0.0 if performs else log(LOOSER_PEAK),
            performs,
        )
        for rig, factor, performs in ends([members[k] for k in sorted(active)])
    ]


def first_active(members: Sequence[Member]) -> set[int]:
    """The member that an optimiser begins with; proofs add the others that matter."""
    return {next((k for k, member in enumerate(members) if member.performance is not None), 0)}


def ends(members: Sequence[Member]) -> list[tuple[LinearModel, float, bool]]:
    """Rig, factor on the gain and whether it is to perform, of every member at the ends of what it is asked."""
    found = []
    for member in members:
        inside = member.performance
        asked = member.gain if inside is None else inside
        found += [(member.rig, factor, inside is not None) for factor in sorted({asked.low, asked.high}) if factor > 0]
    return found


def grids(members: Sequence[Member], frequency_Hz: np.ndarray) -> list[GridPlant]:
    """Responses of everything that is to perform."""
    return [grid_plant(rig.polynomials(), frequency_Hz, factor) for rig, factor, performs in ends(members) if performs]


@dataclass(frozen=True)
class LoopSet:
    """All loops of one controller and inner end mass over a range of outer end masses.

    Attributes:
        stable: by number of the member, rectangles of masses and gains that are to be stable.
        performing: likewise, those that are to perform.
    """

    stable: Mapping[int, Rectangle]
    performing: Mapping[int, Rectangle]

    def unstable(self) -> list[int]:
        """Numbers of the members that are not stable throughout: exact."""
        return [k for k, rectangle in self.stable.items() if rectangle.unstable_side() is not None]

    def refuted_peak(self, limit: float) -> tuple[Claim, int] | None:
        """A claim that this limit of the sensitivity is kept, refuted with mass and frequency, and the member.

        None where it holds.
        """
        for k, rectangle in self.performing.items():
            for side in rectangle.sides():
                claim = prove_peak(side, limit)
                if not claim.holds:
                    return at_mass(side, claim), k
        return None

    def refuted(self, goal: Goal) -> list[tuple[Claim, int]]:
        """The goal's limits of sensitivity, loop gain and effort that are refuted, each with a member's number."""
        peak = self.refuted_peak(goal.peak_sensitivity)
        found = [] if peak is None else [peak]
        for asked in goal_claims(goal):
            for k, rectangle in self.performing.items():
                claim = prove(rectangle, asked)
                if not claim.holds:
                    found.append((claim, k))
                    break
        return found

    def excess(self, goal: Goal) -> float:
        """Logarithm of the largest share by which one of these limits is proved to be kept or may be exceeded."""
        performing = list(self.performing.values())
        shares = [self.peak_sensitivity() / goal.peak_sensitivity]
        if goal.loop_gain is not None:
            shares.append(largest_loop_gain(performing, goal.loop_gain_from_Hz) / goal.loop_gain)
        if goal.controller_effort_A_per_V is not None:
            shares.append(largest_effort(performing) / goal.controller_effort_A_per_V)
        return log(max(shares)) if max(shares) < inf else inf

    def bandwidths(self, limit_m_per_N: float) -> dict[int, float]:
        """Proved of each member that is to perform, Hz."""
        return {k: bandwidth([rectangle], limit_m_per_N) for k, rectangle in self.performing.items()}

    def peak_sensitivity(self) -> float:
        """Proved for every loop that is to perform."""
        return peak_sensitivity(list(self.performing.values()))

    def ends(self, also: Collection[int] = ()) -> list[Loop]:
        """The loops over the mass at the ends of the gains, those that are to perform and others by their numbers."""
        others = [rectangle for k, rectangle in self.stable.items() if k in also and k not in self.performing]
        return [
            scaled(rectangle.loop, factor)
            for rectangle in [*self.performing.values(), *others]
            for factor in sorted({rectangle.least, rectangle.most})
        ]


def loop_set(
    members: Sequence[Member], controller: Controller, inner_end_mass: float, masses_kg: tuple[float, float]
) -> LoopSet:
    """Close the loops of all members of a rig."""
    low, high = (exact(mass) for mass in masses_kg)
    stable, performing = {}, {}
    for k, member in enumerate(members):
        loop = rig_loop(member.rig, inner_end_mass, controller)
        stable[k] = Rectangle(loop, low, high, exact(member.gain.low), exact(member.gain.high))
        if (inside := member.performance) is not None:
            performing[k] = Rectangle(loop, low, high, exact(inside.low), exact(inside.high))
    return LoopSet(stable, performing)
