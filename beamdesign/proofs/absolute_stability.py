"""The nonlinear loop: what is proved of a prototype's effects while they move, and on what that rests.

- Static characteristics of slope 0 to 1 in the current (saturation, dead band, soft limits): a multiplier of Zames and
  Falb with a term of Popov's, see `beamdesign.proofs.multiplier`.
- What is linear is a part of the loop, and of every proof.

Every other effect is listed with why nothing is proved of it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq

from beamdesign.loop import Loop, rig_loop
from beamdesign.plant.effects import library
from beamdesign.plant.members import LinearFamily, family
from beamdesign.polynomial import exact
from beamdesign.proofs.multiplier import Multiplier
from beamdesign.proofs.multiplier_search import search
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.stability import is_stable_over
from beamdesign.prototype import Prototype
from beamdesign.rational import nearest, text

IN_THE_CURRENT = ("current_saturation", "current_saturation_soft")
BEHIND_THE_SPOOL = ("valve_deadband",)
"""Odd static characteristics of slope 0 to 1, by their place in the loop: cut at either, it has the same transfer."""
MULTIPLIER = "Zames-Falb multiplier with a Popov term, in rational arithmetic"
LINEAR = "linear, a part of the loop"
NONE_KNOWN = "none"
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
        return {
            "effects": list(self.effects),
            "method": self.method,
            "proved": self.proved,
            "covers": self.covers,
            "bound_m": self.bound_m,
        }


@dataclass(frozen=True)
class Members:
    """All linear members of a prototype as loops at the largest factor on their gain, over a range of masses, kg."""

    prototype: Prototype
    found: LinearFamily
    loops: tuple[Loop, ...]
    low: fmpq
    high: fmpq

    @property
    def frozen(self) -> str:
        """What the loops are beside what moves, in words, with a blank before them; empty without other effects."""
        return " with every other effect frozen at either end of what it spans" if len(self.loops) > 1 else ""


def members(prototype: Prototype, low_kg: float, high_kg: float) -> Members:
    """The loops of a prototype.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    found = family(prototype, high_kg)
    inner, law = prototype.payload.inner_end_mass_kg, prototype.controller
    loops = [rig_loop(one.rig, inner, law).scaled(exact(one.gain.high)) for one in found.members]
    return Members(prototype, found, tuple(loops), exact(low_kg), exact(high_kg))


def nonlinear_rows(prototype: Prototype, low_kg: float, high_kg: float) -> tuple[Row, ...]:
    """What is proved of each effect of a prototype, and of the saturation that every rig has, over a range of masses.

    Raises:
        ValueError: as `members`.
        InputError: likewise.
    """
    given = members(prototype, low_kg, high_kg)
    rows = list(_static(given))
    known = {name for row in rows for name in row.effects}
    rows += _linear(given, known)
    known |= {name for row in rows for name in row.effects}
    rows += [Row((name,), NONE_KNOWN, False, _OPEN) for name in sorted(prototype.effects) if name not in known]
    return tuple(rows)


_OPEN = (
    "No theorem here covers it while it moves; what `certify` proves of it is about linear loops that bracket it at"
    " frozen values."
)


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
    where = ""
    if inside is not None and inside.decided:
        where = f", {inside.factor:.4g} times its own, with an outer end mass of {inside.mass:.6g} kg"
    elif side is not None and side.mass is not None:
        crossed = [c.value for c in rectangle.loop.at(nearest(side.mass)).gain_crossings() if 0 < c.value < 1]
        where = (
            f" below {max(crossed, default=1.0):.4g} times its own with an outer end mass of {nearest(side.mass):g} kg"
        )
    return (
        f"The loop is conditionally stable: it is unstable at some gain{where}, and a lower gain is what a saturation"
        " comes to at large amplitudes, so that no such multiplier exists."
    )


def _static(given: Members) -> Iterator[Row]:
    own = set(given.prototype.effects)
    groups = [tuple(name for name in names if name in own) for names in (IN_THE_CURRENT, BEHIND_THE_SPOOL)]
    if not any(groups[:1]):
        groups[0] = IN_THE_CURRENT[:1]  # every servovalve has a rated current
    found = absolute_stability(given.loops, given.low, given.high)
    multiplier = found.multiplier
    words, statement = found.reason, None
    if multiplier is not None:
        words = in_words(multiplier, given)
        numbers = list(range(1, len(given.loops) + 1))
        statement = {"kind": "slope", "loops": numbers, "margin": text(found.margin)} | multiplier.table()
    for group in filter(None, groups):
        yield Row(group, MULTIPLIER, multiplier is not None, words, None, statement)
        statement = None  # one statement serves all places
    if len(groups[1]) and own.intersection(IN_THE_CURRENT):
        both = (*groups[0], *groups[1])
        yield Row(both, MULTIPLIER, False, "Both at once are not covered: the spool's dynamics stand between them.")


def in_words(multiplier: Multiplier, given: Members) -> str:
    """What the theorem says with a multiplier, in whole sentences."""
    odd = multiplier.for_odd_only
    which = "an odd static characteristic" if odd else "any static characteristic"
    where = "and with no command and no load" if odd else "under any constant command and load"
    return (
        f"From every state the loop comes to rest with {which} of slope 0 to 1 in the current, {where}, for every"
        f" payload that stays{given.frozen}; several such characteristics at this one place are one of them, elsewhere"
        f" and together with other effects that move they are not covered. M = {multiplier}."
    )


# What is linear.


def _linear(given: Members, known: set[str]) -> Iterator[Row]:
    names = []
    for name in sorted(given.prototype.effects):
        linear = library()[name].linear
        if name not in known and linear is not None and linear.laws is None and not linear.figures and not linear.gain:
            names.append(name)
    if names:
        stable = all(is_stable_over(loop.characteristic, given.low, given.high) for loop in given.loops)
        words = "Linear itself, as it is simulated: every loop here holds it, in every combination."
        yield Row(tuple(names), LINEAR, stable, words if stable else "The linear loop is not stable at every mass.")
