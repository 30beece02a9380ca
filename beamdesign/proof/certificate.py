"""The certificate of a prototype over a range of outer end masses: what is stable and guaranteed, and the proof."""

from dataclasses import dataclass
from functools import cached_property
from math import inf, isinf

from beamdesign.crossing import Crossing
from beamdesign.proof.performance import (
    Claim,
    Kind,
)
from beamdesign.proof.stability import StabilityMap
from beamdesign.prototype import Goal

METHOD = (
    "exact rational arithmetic: all masses with a root on the imaginary axis isolated by elimination,"
    " one Routh test per range between them; inequalities over mass and frequency by real-root isolation"
)

_COMPLIANCES = {
    "compliance": "compliance |x/F_d|",
    "tip_compliance": "compliance of the tip",
    "load_compliance": "compliance of the payload's centre",
}
_UNITS = {"controller_effort": " A/V", "decay_rate": " 1/s", "gain_margin": " times the gain"}


@dataclass(frozen=True)
class Asked:
    """A claim that is to be decided.

    Attributes:
        kind: what is claimed.
        limit: its figure: m/N, a plain number, A/V, 1/s or a factor.
        bandwidth_Hz: for a compliance, the frequency up to which it is claimed.
        from_Hz: for a loop gain, the frequency from which on it is claimed.
    """

    kind: Kind
    limit: float
    bandwidth_Hz: float = inf
    from_Hz: float = 0.0


@dataclass(frozen=True)
class Guaranteed:
    """The best figures that are proved of a loop that is stable over the whole range, rounded to the safe side.

    Attributes:
        bandwidth_Hz: for the goal's compliance.
        peak_sensitivity: max |1 / (1 + L)|.
        loop_gain: max |L| from the goal's frequency up; None where the goal sets it no limit.
        controller_effort_A_per_V: max |C / (1 + L)|; None likewise.
    """

    bandwidth_Hz: float
    peak_sensitivity: float
    loop_gain: float | None = None
    controller_effort_A_per_V: float | None = None


@dataclass(frozen=True)
class Certificate:
    """What is proved of a prototype over a range of outer end masses.

    Attributes:
        outer_end_mass_kg: the range.
        stability: ranges and crossings, exact.
        claims: what was asked, each held or refuted.
        guaranteed: bandwidth and peak sensitivity; None where the range is not stable throughout.
        text: the certificate as `beamdesign.checker` reads it.
        method: how it was proved, in words.
        scope: for a prototype with effects, per effect what is covered and what is not, in words.
    """

    outer_end_mass_kg: tuple[float, float]
    stability: StabilityMap
    claims: tuple[Claim, ...]
    guaranteed: Guaranteed | None
    text: str
    method: str = METHOD
    scope: tuple[str, ...] = ()

    @property
    def stable(self) -> bool:
        """Whether every mass of the closed range is stable."""
        return self.stability.stable

    @property
    def holds(self) -> bool:
        """Whether the range is stable and every claim that was asked holds."""
        return self.stable and all(claim.holds for claim in self.claims)

    @property
    def stable_ranges_kg(self) -> list[tuple[float, float]]:
        """The stable ranges inside what was asked, ends at crossings rounded inwards."""
        return self.stability.stable_ranges

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """The crossings inside the range."""
        return self.stability.crossings

    @cached_property
    def reason(self) -> str:
        """In words, why the answer is no; empty where it is yes."""
        refused = [f"{describe(claim)}: {claim.reason}" for claim in self.claims if not claim.holds]
        return "; ".join([self.stability.reason, *refused] if self.stability.reason else refused)


def goal_claims(goal: Goal) -> tuple[Asked, ...]:
    """The goal's limits of loop gain and effort as claims, as far as it sets any."""
    asked = []
    if goal.loop_gain is not None:
        asked.append(Asked("loop_gain", goal.loop_gain, from_Hz=goal.loop_gain_from_Hz))
    if goal.controller_effort_A_per_V is not None:
        asked.append(Asked("controller_effort", goal.controller_effort_A_per_V))
    return tuple(asked)


def implies(one: Claim, other: Claim) -> bool:
    """Whether a claim of the same kind, if it holds, says at least as much as another."""
    stronger = one.limit <= other.limit and (one.bandwidth_Hz or 0.0) >= (other.bandwidth_Hz or 0.0)
    stronger = stronger and (one.from_Hz or 0.0) <= (other.from_Hz or 0.0)
    return one.holds and one.kind == other.kind and stronger


def describe(claim: Claim) -> str:
    """A claim in words."""
    if claim.kind.endswith("compliance"):
        up_to = "at every frequency" if isinf(claim.bandwidth_Hz or 0) else f"up to {claim.bandwidth_Hz:.7g} Hz"
        return f"{_COMPLIANCES[claim.kind]} at most {claim.limit:.6g} m/N {up_to}"
    if claim.kind == "loop_gain":
        return f"loop gain |L| at most {claim.limit:.6g} from {claim.from_Hz or 0:.7g} Hz up"
    name = {
        "peak_sensitivity": "peak sensitivity max |1/(1+L)| at most",
        "controller_effort": "controller effort |C/(1+L)| at most",
        "decay_rate": "decay rate of every pole above",
        "gain_margin": "stable at every gain up to" if claim.limit >= 1 else "stable at every gain down to",
    }[claim.kind]
    return f"{name} {claim.limit:.6g}{_UNITS.get(claim.kind, '')}"
