"""For what a verdict holds, in words: which rigs, and which motion of those with effects that are not linear.

What is proved of a prototype with effects is proved of linear members. Where an effect is not linear they bracket it at
frozen values, and small motion about rest may follow none of them: within a dead band nothing opposes the load, held by
friction or hysteresis the valve or the piston does not answer, and within its play a joint is no joint. Then the
compliance, or stability itself, is a claim about larger motion alone (`beamdesign.plant.effect.Linear.near_rest`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from beamdesign.plant.effects import library
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.certifying import bracketing
from beamdesign.prototype import Prototype
from beamdesign.quantities import rigs_in_words


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


def near_rest(prototype: Prototype) -> tuple[NearRest, ...]:
    """What nothing is proved of while motion is small against the effects of a prototype, all of the library."""
    found = []
    for name, given in sorted(prototype.effects.items()):
        size, linear = library()[name].parameters[0], library()[name].linear
        # The first figure of each of these effects is its size; without any there is no such effect.
        if linear is not None and linear.near_rest and given.get(size.name, size.default) > 0:
            found.append(NearRest(name, linear.near_rest, linear.leaves_out))
    return tuple(found)


def uncovered(left: Sequence[NearRest], asked: Sequence[Asked]) -> str:
    """Why an answer cannot be yes: claims that were asked for and small motion does not keep; empty where it can.

    Stability is always asked for; a compliance where it is among the claims.
    """
    compliance = any(one.kind.endswith("compliance") for one in asked)
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
