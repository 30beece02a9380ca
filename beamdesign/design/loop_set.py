"""The loops that one controller has to serve: those of all linear members of a rig."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, log

from beamdesign.controllers import Controller
from beamdesign.linear import LinearModel
from beamdesign.loop import Loop, rig_loop
from beamdesign.members import Member
from beamdesign.polynomial import exact
from beamdesign.proof.certificate import Asked, Claim, Kind, goal_claims
from beamdesign.proof.performance import bandwidth, least_limit, prove
from beamdesign.proof.rectangle import Rectangle, scaled
from beamdesign.prototype import Goal

LIMITED: tuple[Kind, ...] = ("peak_sensitivity", "compliance", "loop_gain", "controller_effort")
"""What a goal limits, in the order of everything that is listed by limit."""


def goal_limits(goal: Goal) -> dict[Kind, float]:
    """The limits that a goal sets, in this order."""
    given = (goal.peak_sensitivity, goal.compliance_m_per_N, goal.loop_gain, goal.controller_effort_A_per_V)
    return {kind: limit for kind, limit in zip(LIMITED, given, strict=True) if limit is not None}


LOOSER_PEAK = 3.0
"""An optimiser keeps members that only have to be stable within the limit of sensitivity times this."""


def ends(members: Sequence[Member]) -> list[tuple[LinearModel, float, bool]]:
    """Rig, factor on the gain and whether it is to perform, of every member at the ends of what it is asked."""
    found = []
    for member in members:
        inside = member.performance
        asked = member.gain if inside is None else inside
        found += [(member.rig, factor, inside is not None) for factor in sorted({asked.low, asked.high}) if factor > 0]
    return found


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
            claim = prove(rectangle, Asked("peak_sensitivity", limit))
            if not claim.holds:
                return claim, k
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
        asked = (Asked("peak_sensitivity", goal.peak_sensitivity), *goal_claims(goal))
        most = max(least_limit(performing, one.kind, one.from_Hz) / one.limit for one in asked)
        return log(most) if most < inf else inf

    def bandwidths(self, limit_m_per_N: float) -> dict[int, float]:
        """Proved of each member that is to perform, Hz."""
        return {k: bandwidth([rectangle], limit_m_per_N) for k, rectangle in self.performing.items()}

    def peak_sensitivity(self) -> float:
        """Proved for every loop that is to perform."""
        return least_limit(list(self.performing.values()), "peak_sensitivity")

    def ends(self) -> list[Loop]:
        """The loops over the mass at the ends of the gains, those that are to perform."""
        return [
            scaled(rectangle.loop, factor)
            for rectangle in self.performing.values()
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
