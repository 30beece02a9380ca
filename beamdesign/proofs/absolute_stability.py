"""Static characteristics of slope 0 to 1 in the loop: multipliers sought and proved for all members of a prototype.

The theorem and its exact proof are those of `beamdesign.proofs.multiplier`. A characteristic acts in the current, as
saturation does, or on the flow behind the spool, as a dead band does; cut at either place the loop has the same
transfer. Sides of the piston that are unequal pass on the flow times one of two factors, by its sign: over the larger
factor, which the loop is taken with, that is a characteristic of slope 0 to 1 as well, and no odd one.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq

from beamdesign.loop import Loop, at_most
from beamdesign.plant.members import LinearFamily, family
from beamdesign.polynomial import exact, nearest, text
from beamdesign.proofs.multiplier import Multiplier
from beamdesign.proofs.multiplier_search import search
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.stability import is_stable_over
from beamdesign.prototype import Prototype
from beamdesign.result import picked

IN_THE_CURRENT = ("current_saturation", "current_saturation_soft")
BEHIND_THE_SPOOL = ("unequal_piston_areas", "valve_deadband")
"""Static characteristics by their place in the loop."""
NOT_ODD = ("unequal_piston_areas", "uneven_leakage")
"""Effects that are not odd, or keep the valve from its null at rest."""
FOR_ODD = "for odd characteristics about zero current"
METHOD = "Zames-Falb multiplier with a Popov term, in rational arithmetic"
_ZERO, _ONE = fmpq(0), fmpq(1)


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

    def line(self) -> str:
        """It in words."""
        bound = "" if self.bound_m is None else f" (the tip strays by at most {self.bound_m:.4g} m)"
        return f"{'Proved' if self.proved else 'NOT proved'} of {', '.join(self.effects)}{bound}: {self.covers}"

    def to_dict(self) -> dict[str, Any]:
        """As it stands in JSON."""
        return picked(self, "effects method proved covers bound_m")


@dataclass(frozen=True)
class Members:
    """All linear members of a prototype as loops at the largest factor on their gain, over a range of masses, kg."""

    prototype: Prototype
    found: LinearFamily
    loops: tuple[Loop, ...]
    low: fmpq
    high: fmpq

    def frozen(self, count: int, moving: Collection[str]) -> str:
        """What some of the loops are beside what moves, in words with a blank before them; empty where nothing is.

        Args:
            count: how many loops there are.
            moving: effects that are not frozen.
        """
        words = " with every other effect frozen at either end of what it spans" if count > 1 else ""
        others = [name for name, span in self.found.gains.items() if name not in moving and span.high != 1]
        return words + (f", at the gain without {' and '.join(others)}" if others else "")


def members(prototype: Prototype, low_kg: float, high_kg: float) -> Members:
    """The loops of a prototype.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    found = family(prototype, high_kg)
    loops = tuple(at_most(prototype, member) for member in found.members)
    return Members(prototype, found, loops, exact(low_kg), exact(high_kg))


# Static characteristics.


@dataclass(frozen=True)
class Absolute:
    """What came of the search for a multiplier.

    Attributes:
        multiplier: None where there is none.
        margin: proved lower bound of Re[M (1 + L)].
        reason: in words, why there is none.
    """

    multiplier: Multiplier | None
    margin: fmpq = _ZERO
    reason: str = ""


def absolute_stability(loops: Sequence[Loop], low: fmpq, high: fmpq) -> Absolute:
    """Seek and prove one multiplier for loops at every mass (kg) from `low` to `high`, or say why there is none."""
    for loop in loops:
        if not is_stable_over(loop.loop_denominator, low, high):
            reason = "The open loop is not stable at every mass, which the theorem presupposes."
            return Absolute(None, reason=reason)
        if reason := _unstable_gain(Rectangle(loop, low, high, _ZERO, _ONE)):
            return Absolute(None, reason=reason)
    found = search(loops, low, high)
    if found is None:
        return Absolute(None, reason="No multiplier was found; that does not say that the loop oscillates.")
    return Absolute(*found)


def _unstable_gain(rectangle: Rectangle) -> str:
    """Where a loop is not stable at some gain between none and its own, in words; empty where it is at all.

    A gain between them is a characteristic of slope 0 to 1 itself, so that then no multiplier exists.
    """
    side = rectangle.unstable_side()
    inside = rectangle.inside() if side is None else None
    if side is None and inside is None:
        return ""
    if side is not None and side.mass is None:
        return "The linear loop itself is not stable at every mass."
    if side is not None and side.mass is not None:
        mass, crossed = nearest(side.mass), 1.0
        factors = [one.value for one in rectangle.loop.at(mass).gain_crossings()]
        crossed = max((factor for factor in factors if 0 < factor < 1), default=1.0)
        where = f" below {crossed:.4g} times its own with an outer end mass of {mass:g} kg"
    elif inside is not None and inside.decided:
        where = f" about {inside.factor:.4g} times its own with an outer end mass of {inside.mass:.6g} kg"
    else:
        return "Whether the loop is stable at every lower gain could not be decided."
    return (
        f"The loop is conditionally stable: it is unstable at a gain{where}, and a lower gain is what a saturation"
        " comes to at large amplitudes, so that no such multiplier exists."
    )


def static_rows(given: Members) -> Iterator[Row]:
    """A row for the characteristics at either place of the loop, and for both places at once."""
    found = absolute_stability(given.loops, given.low, given.high)
    several = " with every other effect frozen at either end of what it spans" if len(given.loops) > 1 else ""
    statement = {"kind": "slope", "loops": list(range(1, len(given.loops) + 1)), "margin": text(found.margin)}
    of = f"for every payload that stays{several}"
    yield from rows_of(given.prototype, found.multiplier, found.reason, of, statement)


def rows_of(
    prototype: Prototype, multiplier: Multiplier | None, reason: str, of: str, statement: dict[str, Any] | None = None
) -> Iterator[Row]:
    """A row for the characteristics at either place of the loop, and for both at once, from a multiplier that fits.

    Args:
        prototype: with its effects.
        multiplier: None where there is none.
        reason: in words, why.
        of: what it is proved of, in words.
        statement: what a certificate states beside the multiplier; None where it states this elsewhere.
    """
    own = set(prototype.effects)
    current = tuple(name for name in IN_THE_CURRENT if name in own) or IN_THE_CURRENT[:1]  # every valve has a rating
    flow = tuple(name for name in BEHIND_THE_SPOOL if name in own)
    if "pressure_dependent_flow" in own:
        flow = ()  # orifices pass the flow on by the pressures
    words, stated = reason, None
    if multiplier is not None and multiplier.for_odd_only and own.intersection(NOT_ODD):
        multiplier, words = None, f"The multiplier that was found is {FOR_ODD} alone, which this rig has not."
    elif multiplier is not None:
        words, stated = in_words(multiplier, of), statement and statement | multiplier.table()
    yield Row(current, METHOD, multiplier is not None, words, None, stated)
    if flow:
        yield Row(flow, METHOD, multiplier is not None, words)
        if "valve_deadband" in flow and own.intersection(IN_THE_CURRENT):
            both = "Both places at once are not covered: the spool's dynamics stand between them."
            yield Row((*current, *flow), METHOD, False, both)


def in_words(multiplier: Multiplier, of: str) -> str:
    """What the theorem says with a multiplier, in whole sentences; of what it says that in words."""
    odd = multiplier.for_odd_only
    which = "an odd static characteristic" if odd else "any static characteristic"
    where = "and with no command and no load" if odd else "under any constant command and load"
    return (
        f"From every state the loop comes to rest with {which} of slope 0 to 1 at its place, {where}, {of};"
        " several in a row at one place are one of them. Not covered, but where that is said of both at once, is what"
        f" moves elsewhere at the same time. M = {multiplier}."
    )
