"""For what a verdict holds, in words: which rigs, and which motion of those with effects that are not linear.

What is proved of a prototype with effects is proved of linear members. Where an effect is not linear they bracket it at
frozen values, and small motion about rest may follow none of them: within a dead band nothing opposes the load, held by
friction or hysteresis the valve or the piston does not answer, and within its play a joint is no joint. Then the
compliance, or stability itself, is a claim about larger motion alone (`beamdesign.plant.effects.Linear.near_rest`).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from decimal import ROUND_FLOOR
from functools import cached_property

from flint import fmpq

from beamdesign.loop import Loop, at_most
from beamdesign.plant.effects import library
from beamdesign.plant.members import LinearFamily, family, linear_of
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Asked, Row
from beamdesign.prototype import Prototype
from beamdesign.quantities import decimal, rigs_in_words, stated_range

LINEAR = "linear, a part of the loop"
NONE_KNOWN = "none"


@dataclass(frozen=True)
class Members:
    """All linear members of a prototype over a range of masses, kg."""

    prototype: Prototype
    found: LinearFamily
    low: fmpq
    high: fmpq

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """The loop of each at the largest factor on its gain."""
        return tuple(at_most(self.prototype, member) for member in self.found.members)

    def frozen(self, count: int, moving: Collection[str]) -> str:
        """What some of the loops are beside what moves, in words with a blank before them; empty where nothing is.

        Args:
            count: how many loops there are.
            moving: effects that are not frozen.
        """
        words = " with every other effect frozen at either end of what it spans" if count > 1 else ""
        return words + unraised(self.found, moving)


def unraised(found: LinearFamily, moving: Collection[str]) -> str:
    """Which effects but those that move raise the gain, of loops at its own, in words; empty where none does."""
    others = [name for name, span in found.gains.items() if name not in moving and span.high != 1]
    return f", at the gain without {' and '.join(others)}" if others else ""


def members(prototype: Prototype, low_kg: float, high_kg: float) -> Members:
    """Those of a prototype; what asks for their loops raises a ValueError where it has no controller.

    Raises:
        InputError: for effects for which no linear loop stands.
    """
    return Members(prototype, family(prototype, high_kg), exact(low_kg), exact(high_kg))


def scope(prototype: Prototype, found: LinearFamily) -> str:
    """What the proof is about, in one sentence."""
    members = "one linear loop stands" if len(found.members) == 1 else f"{len(found.members)} linear loops stand"
    effects = f"{members} for the effects {', '.join(sorted(prototype.effects))}"
    return f"{effects}, at frozen values" if bracketing(prototype) else effects


def covered(prototype: Prototype, found: LinearFamily, nonlinear: bool = False) -> list[str]:
    """Per effect what the proof covers and what it leaves out, in words; then the gains and the load.

    Args:
        prototype: with effects.
        found: its linear members.
        nonlinear: whether what holds of the nonlinear loop is stated beside.
    """
    lines = []
    for name in sorted(prototype.effects):
        linear = linear_of(prototype, name)
        assert linear is not None  # the family exists
        out = f"; not covered: {linear.leaves_out}" if linear.leaves_out else ""
        lines.append(f"{name}: {linear.covers}{out}.")
    gain = found.members[0].gain
    inside = next(member.performance for member in found.members if member.performance is not None)
    if gain.low != gain.high:
        lines.append(
            f"Stability is about every constant factor on the gain from {stated_range((gain.low, gain.high), 6)}."
        )
        if inside != gain:
            one = inside.low == inside.high
            factors = f"{inside.low:.6g}" if one else stated_range((inside.low, inside.high), 6)
            lines.append(f"Compliance and peak sensitivity are about factors of {factors}.")
    lines += [
        f"{name}: {' and '.join(f'{end:.6g}' for end in sorted({span.low, span.high}))}."
        for name, span in found.spans.items()
    ]
    if any(span.low < span.high for span in found.spans.values()):
        lines.append(
            "This proof is about the ends of these figures; `beamdesign certify-box` proves what lies between."
        )
    if found.depends_on_load:
        lines.append(f"These hold for a steady load of up to {decimal(found.load_N, 6, ROUND_FLOOR)} N.")
    lines.append(ALL_LINEAR if not bracketing(prototype) else BESIDE if nonlinear else NOT_COVERED)
    return lines


BESIDE = (
    "This is about linear loops that bracket the effects at frozen values; what holds while they move is stated beside."
)
NOT_COVERED = (
    "Proved are linear loops that bracket the effects at frozen values, not the nonlinear loop: limit cycles, and what"
    " changes while it moves, are not covered."
)
ALL_LINEAR = "These effects are linear: what is proved is the loop that `beamdesign simulate` runs."


def bracketing(prototype: Prototype) -> bool:
    """Whether an effect is not linear itself, so that its linear loops only bracket it."""
    members = [library()[name].linear for name in prototype.effects]
    return any(member is None or member.laws is not None for member in members)


def is_linear(name: str) -> bool:
    """Whether an effect is a part of the linear loop, and no more."""
    linear = library()[name].linear
    return linear is not None and linear.laws is None and not linear.figures and linear.gain is None


# Small motion about rest.


@dataclass(frozen=True)
class NearRest:
    """A claim that a prototype's linear members make and small motion does not keep.

    Attributes:
        effect: that is in the way.
        claim: "compliance" at any frequency; "stability", with which all claims fall.
        words: what of the effect the members are not.
    """

    effect: str
    claim: str
    words: str


def near_rest(prototype: Prototype, moving: Sequence[Row] = ()) -> tuple[NearRest, ...]:
    """What nothing is proved of while motion is small against the effects of a prototype, all of the library.

    Args:
        prototype: with or without effects.
        moving: what is proved of effects while they move; how far the tip strays says it of small motion too.
    """
    bounded = {name for row in moving if row.bound_m is not None for name in row.effects}
    found = []
    for name, given in sorted((name, given) for name, given in prototype.effects.items() if name not in bounded):
        effect, linear = library()[name], library()[name].linear
        # The first figure of each of these effects is its size, or each of its loops has one; without any it is none.
        sizes = [one for one in effect.parameters if one.name in effect.memory] or effect.parameters[:1]
        there = any(given.get(size.name, size.default) > 0 for size in sizes)
        if linear is not None and linear.near_rest and there:
            found.append(NearRest(name, linear.near_rest, linear.leaves_out))
    return tuple(found)


def uncovered(prototype: Prototype, moving: Sequence[Row], asked: Sequence[Asked]) -> str:
    """Why an answer cannot be yes: claims that were asked for and small motion does not keep; empty where it can.

    Stability is always asked for; a compliance where it is among the claims. Arguments are as of `near_rest`.
    """
    left, compliance = near_rest(prototype, moving), any(one.kind.endswith("compliance") for one in asked)
    words = [f"{one.claim} ({one.effect}: {one.words})" for one in left if compliance or one.claim == "stability"]
    return f"not proved of small motion: {'; '.join(words)}" if words else ""


def holds_for(prototype: Prototype, sigmas: float = 0.0) -> str:
    """Of which rigs and which motion a verdict on linear members is.

    Args:
        prototype: with or without effects.
        sigmas: standard deviations of each figure, as of `rigs_in_words`.
    """
    small = [f"no {one.claim} ({one.effect})" for one in near_rest(prototype)]
    only = ", linear members only" if bracketing(prototype) else ""
    return f"for {rigs_in_words(sigmas)}{only}" + (f"; of small motion {', '.join(small)}" if small else "")
