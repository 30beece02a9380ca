"""What is claimed, proved and guaranteed of a prototype over a range of outer end masses: records and words."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from math import inf, isinf
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from flint import fmpq

from beamdesign.polynomial import Crossing, exact, nearest, shortened, text
from beamdesign.proofs.multiplier import Multiplier
from beamdesign.proofs.stability import StabilityMap
from beamdesign.proofs.writer import Tables, maybe_infinite
from beamdesign.prototype import Goal
from beamdesign.result import Result, finite, picked

if TYPE_CHECKING:
    from beamdesign.proofs.box import BoxVerdict

METHOD = (
    "exact rational arithmetic: all masses with a root on the imaginary axis isolated by elimination,"
    " one Routh test per range between them; inequalities over mass and frequency by real-root isolation"
)

Kind = Literal[
    "compliance", "peak_compliance", "tip_compliance", "load_compliance",
    "peak_sensitivity", "loop_gain", "controller_effort", "decay_rate", "gain_margin", "slope", "deviation",
]  # fmt: skip
"""A compliance is claimed up to a bandwidth, the peak compliance at every frequency. Of an arm the compliances are two,
of the tip and of the payload's centre."""

_WORDS = {
    "compliance": ("compliance |x/F_d| at most", " m/N"),
    "peak_compliance": ("compliance |x/F_d| at most", " m/N"),
    "tip_compliance": ("compliance of the tip at most", " m/N"),
    "load_compliance": ("compliance of the payload's centre at most", " m/N"),
    "peak_sensitivity": ("peak sensitivity max |1/(1+L)| at most", ""),
    "loop_gain": ("loop gain |L| at most", ""),
    "controller_effort": ("controller effort |C/(1+L)| at most", " A/V"),
    "decay_rate": ("decay rate of every pole above", " 1/s"),
    "gain_margin": ("stable at every gain", " times the gain"),
}
"""What is claimed, and the unit of the limit."""


class Weighed(NamedTuple):
    """How the response of the tip to an error at a place of `bounded_error.UNITS` is looked at over a box.

    Attributes:
        place: where the error is added.
        size: which it never exceeds, SI.
        decay: 1/s by which the axis is moved to the left.
        corner: rad/s; the response is multiplied by j w + corner.
        lead: of a force on the stroke, the flow that it is worth, in sizes at most lead[0] + lead[1] j w, m3/s per N.
    """

    place: str
    size: fmpq
    decay: fmpq
    corner: fmpq
    lead: tuple[fmpq, fmpq] = fmpq(1), fmpq(0)


@dataclass(frozen=True)
class Asked:
    """A claim that is to be decided.

    Attributes:
        kind: what is claimed.
        limit: its figure: m/N, a plain number, A/V, 1/s or a factor; a gain margin of zero is for every lower gain.
        bandwidth_Hz: for a compliance, the frequency up to which it is claimed.
        from_Hz: for a loop gain, the frequency from which on it is claimed.
        multiplier: for a slope, on what rests that the loop comes to rest with every static characteristic of a slope
            from 0 to the limit, which is one, in the current.
        error: for a deviation, of what error the limit is the most that it moves the tip by, m.
    """

    kind: Kind
    limit: float
    bandwidth_Hz: float = inf
    from_Hz: float = 0.0
    multiplier: Multiplier | None = None
    error: Weighed | None = None

    @property
    def for_odd_only(self) -> bool:
        """For a slope, whether it is about odd characteristics alone, without command and load."""
        return self.multiplier is not None and self.multiplier.for_odd_only

    def decided(self, outer_end_mass_kg: tuple[float, float], holds: bool, reason: str = "") -> "Claim":
        """The claim over a range of masses, with its verdict and, where it does not hold, the reason."""
        return Claim(**vars(self), outer_end_mass_kg=outer_end_mass_kg, holds=holds, reason=reason)


@dataclass(frozen=True)
class Witness:
    """Where a claim fails.

    Attributes:
        mass: outer end mass, kg.
        squared_frequency: (rad/s)^2 at which an inequality fails; None for a loop that is not stable.
        gain_factor: factor on the gain, for a gain margin.
        frequency_Hz: frequency at the failure: of the inequality, or of the slowest or growing oscillation.
        exact: whether these rationals themselves refute the claim; False where only a root on the axis at an
            irrational figure does, which they then approximate.
    """

    mass: fmpq
    squared_frequency: fmpq | None
    gain_factor: fmpq | None
    frequency_Hz: float
    exact: bool = True


@dataclass(frozen=True, kw_only=True)
class Claim(Asked):
    """A claim about every outer end mass of a range, decided exactly.

    Attributes:
        outer_end_mass_kg: the range.
        holds: whether it is proved; if not, it is refuted.
        reason: in words, why it does not hold; empty where it does.
        witness: what refutes it; None where it holds.
    """

    outer_end_mass_kg: tuple[float, float]
    holds: bool
    reason: str = ""
    witness: Witness | None = None

    @property
    def witness_outer_end_mass_kg(self) -> float | None:
        """A mass that refutes the claim, as a float."""
        return None if self.witness is None else nearest(self.witness.mass)

    def table(self, counterexamples: bool = True) -> Tables:
        """As a certificate states it, with what refutes it, where that is rational and is to be stated."""
        found: Tables = {"kind": self.kind, "limit": text(exact(self.limit)), "holds": self.holds}
        if self.kind.endswith("compliance"):
            found["bandwidth_Hz"] = maybe_infinite(self.bandwidth_Hz)
        if self.kind == "loop_gain":
            found["from_Hz"] = text(exact(self.from_Hz))
        if self.witness is not None and self.witness.exact and counterexamples:
            stated = picked(self.witness, "outer_end_mass_kg=mass squared_frequency gain_factor")
            found["witness"] = {name: text(value) for name, value in stated.items() if value is not None}
        return found


@dataclass(frozen=True)
class Guaranteed:
    """The best figures that are proved of a loop that is stable over the whole range, rounded to the safe side.

    Attributes:
        bandwidth_Hz: for the goal's compliance.
        peak_sensitivity: max |1 / (1 + L)|.
        loop_gain: max |L| from the goal's frequency up; None where the goal sets it no limit.
        controller_effort_A_per_V: max |C / (1 + L)|; None likewise.
        peak_compliance_m_per_N: max |x / F_d| over all frequencies.
        servo_off_m_per_N: the same with the servo off, for comparison: found by numerics, rounded down.
        peak_over_passive: how many times that the peak is.
    """

    bandwidth_Hz: float
    peak_sensitivity: float
    loop_gain: float | None = None
    controller_effort_A_per_V: float | None = None
    peak_compliance_m_per_N: float = inf
    servo_off_m_per_N: float = inf
    peak_over_passive: float = inf


@dataclass(frozen=True)
class Row:
    """What is proved of some effects while they move.

    Attributes:
        effects: their names.
        method: on what it rests.
        proved: whether it is proved.
        covers: in words, what is, and in which combinations; or why nothing is.
        bound_m: how far the tip strays from the linear response, m; None where that is not what is proved.
        statement: as a certificate states it; None where it states nothing of it.
    """

    effects: tuple[str, ...]
    method: str
    proved: bool
    covers: str
    bound_m: float | None = None
    statement: dict[str, Any] | None = None

    @property
    def rests(self) -> bool:
        """Whether the loop comes to rest while its law's current saturates, under any constant command and load."""
        stated = self.statement or {}
        if not self.proved or stated.get("kind") != "slope" or "place" in stated:
            return False
        return not any(term["coefficient"].startswith("-") for term in stated["term"])  # those are for odd ones alone

    def line(self) -> str:
        """It in words."""
        bound = "" if self.bound_m is None else f" (the tip strays by at most {self.bound_m:.4g} m)"
        return f"{'Proved' if self.proved else 'NOT proved'} of {', '.join(self.effects)}{bound}: {self.covers}"

    def to_dict(self) -> dict[str, Any]:
        """As it stands in JSON."""
        return picked(self, "effects method proved covers bound_m")


@dataclass(frozen=True, repr=False)
class Decided(Result):
    """Stability of a loop over a range of outer end masses, with its proof.

    Attributes:
        outer_end_mass_kg: the range.
        stability: ranges and crossings, exact.
        text: the certificate as `beamdesign.checker` reads it.
    """

    outer_end_mass_kg: tuple[float, float]
    stability: StabilityMap
    text: str

    @property
    def stable(self) -> bool:
        """Whether every mass of the closed range is stable."""
        return self.stability.stable

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """The crossings inside the range."""
        return self.stability.crossings

    @property
    def reason(self) -> str:
        """In words, why the answer is no; empty where it is yes."""
        return self.stability.reason


@dataclass(frozen=True, repr=False)
class Certificate(Decided):
    """What is proved of a prototype over a range of outer end masses.

    Attributes:
        claims: what was asked, each held or refuted.
        guaranteed: bandwidth and peak sensitivity; None where the range is not stable throughout.
        method: how it was proved, in words.
        scope: for a prototype with effects, per effect what is covered and what is not, in words.
        nonlinear: where that was asked for, what is proved of effects while they move.
        small_motion: what is proved of linear members and not of small motion about rest, in words; empty where all is.
        between: where members are stable and freeze figures, whether the loop is at every value between.
        linear: whether the answer was asked of linear members alone.
    """

    claims: tuple[Claim, ...]
    guaranteed: Guaranteed | None
    method: str = METHOD
    scope: tuple[str, ...] = ()
    nonlinear: tuple[Row, ...] = ()
    small_motion: str = ""
    between: "BoxVerdict | None" = None
    linear: bool = False

    @property
    def holds(self) -> bool:
        """Whether the range is stable and every claim that was asked holds, of the linear members."""
        return self.stable and all(claim.holds for claim in self.claims) and all(row.proved for row in self.nonlinear)

    @property
    def stable_ranges_kg(self) -> list[tuple[float, float]]:
        """The stable ranges inside what was asked, ends at crossings rounded inwards."""
        return self.stability.closed_ranges

    @property
    def next_crossings(self) -> dict[str, Crossing | None]:
        """The next crossings outside the range, as far as masses go."""
        below, above = self.stability.below, self.stability.above
        return {"below": below if below is not None and below.value >= 0 else None, "above": above}

    @property
    def yes(self) -> bool:
        """Whether all that was asked holds: of small motion and between the ends of what effects freeze too."""
        return self.holds and (self.linear or not (self.small_motion or self.open_between))

    @property
    def open_between(self) -> str:
        """Why the loop is not proved stable between the ends of what effects freeze, in words; empty where it is."""
        return "" if self.between is None or self.between.stable else self.between.of_frozen

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign certify` writes of it, without the text of the proof."""

        def place(crossing: Crossing | None) -> dict[str, float] | None:
            return None if crossing is None else picked(crossing, "outer_end_mass_kg=value frequency_Hz")

        fields = {
            **picked(self, "stable stable_ranges_kg method scope outer_end_mass_kg holds reason guaranteed"),
            **({"nonlinear": [row.to_dict() for row in self.nonlinear]} if self.nonlinear else {}),
            **({"stable_between": self.between and self.between.stable} if self.scope else {}),
            "crossings": [place(crossing) for crossing in self.crossings],
            "next_crossings": {side: place(crossing) for side, crossing in self.next_crossings.items()},
            "claims": [
                {
                    **picked(claim, "kind limit bandwidth_Hz from_Hz holds reason"),
                    **({} if claim.kind == "loop_gain" else {"from_Hz": None}),
                    "witness": claim.witness
                    and picked(claim.witness, "outer_end_mass_kg=mass frequency_Hz gain_factor"),
                }
                for claim in self.claims
            ],
        }
        return finite(fields)

    @property
    def reason(self) -> str:
        """In words, why the answer is no; empty where it is yes."""
        refused = [f"{describe(claim)}: {claim.reason}" for claim in self.claims if not claim.holds]
        refused += [row.line() for row in self.nonlinear if not row.proved]
        refused += [] if self.linear else [self.small_motion, self.open_between]
        return "; ".join(words for words in (self.stability.reason, *refused) if words)


def goal_claims(goal: Goal) -> tuple[Asked, ...]:
    """The goal's limits of loop gain and effort as claims, as far as it sets any."""
    asked = []
    if goal.loop_gain is not None:
        asked.append(Asked("loop_gain", goal.loop_gain, from_Hz=goal.loop_gain_from_Hz))
    if goal.controller_effort_A_per_V is not None:
        asked.append(Asked("controller_effort", goal.controller_effort_A_per_V))
    return tuple(asked)


def peak_claim(goal: Goal, servo_off_m_per_N: float) -> tuple[Asked, ...]:
    """The goal's limit of the largest compliance at any frequency, if it sets one.

    Args:
        goal: how many times the largest with the servo off it may be.
        servo_off_m_per_N: that, see `beamdesign.proofs.performance`.
    """
    most = goal.peak_over_passive * servo_off_m_per_N
    return (Asked("peak_compliance", nearest(shortened(exact(most), 9))),) if 0 < most < inf else ()


def over_passive(peak_m_per_N: float, servo_off_m_per_N: float) -> float:
    """How many times the largest compliance with the servo off one is; none of it where that alone is infinite."""
    if peak_m_per_N < inf == servo_off_m_per_N:
        return 0.0
    if not (peak_m_per_N < inf and 0 < servo_off_m_per_N < inf):
        return inf
    return nearest(exact(peak_m_per_N) / exact(servo_off_m_per_N))  # no more than a goal whose limit is kept


LOWER_GAINS = Asked("gain_margin", 0.0)
"""Stable at every lower gain."""


def least_limits(goal: Goal, least: Callable[[Kind, float, float], float]) -> list[Asked]:
    """Peak sensitivity first, then what else the goal limits, each at the least limit that is proved.

    Args:
        goal: whose own limits count only where a least limit would be rounded past them.
        least: least limit of a kind of claim, from a frequency (Hz) on, by the goal's limit.
    """
    asked = (Asked("peak_sensitivity", goal.peak_sensitivity), *goal_claims(goal))
    return [replace(one, limit=least(one.kind, one.from_Hz, one.limit)) for one in asked]


def limits(proved: Iterable[Asked]) -> tuple[float, float | None, float | None]:
    """Peak sensitivity, loop gain and effort of what is proved, as they end what is guaranteed."""
    found = {one.kind: one.limit for one in proved}
    return found["peak_sensitivity"], found.get("loop_gain"), found.get("controller_effort")


def as_claims(proved: Iterable[Asked], outer_end_mass_kg: tuple[float, float]) -> list[Claim]:
    """What is proved over a range of masses as claims, without what says nothing."""
    return [one.decided(outer_end_mass_kg, True) for one in proved if one.limit < inf and one.bandwidth_Hz > 0]


def implies(one: Claim, other: Claim) -> bool:
    """Whether a claim of the same kind, if it holds, says at least as much as another."""
    further = one.bandwidth_Hz >= other.bandwidth_Hz and one.from_Hz <= other.from_Hz
    return one.holds and one.kind == other.kind and one.limit <= other.limit and further


def describe(claim: Asked) -> str:
    """A claim in words."""
    if claim.kind == "gain_margin" and claim.limit == 0:
        return "stable at every lower gain"
    if claim.kind == "slope":
        where = "without command and load" if claim.for_odd_only else "under any constant command and load"
        return f"comes to rest from every state while the law's current saturates, {where}"
    (words, unit), band = _WORDS[claim.kind], ""
    if claim.kind.endswith("compliance"):
        band = " at every frequency" if isinf(claim.bandwidth_Hz) else f" up to {claim.bandwidth_Hz:.15g} Hz"
    elif claim.kind == "loop_gain":
        band = f" from {claim.from_Hz:.15g} Hz up"
    elif claim.kind == "gain_margin":
        words += " up to" if claim.limit >= 1 else " down to"
    return f"{words} {claim.limit:.15g}{unit}{band}"
