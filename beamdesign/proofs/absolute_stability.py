"""Static characteristics of slope 0 to 1 in the loop: multipliers sought and proved for all members of a prototype.

The theorem and its exact proof are those of `beamdesign.proofs.multiplier`. A characteristic acts in the current, as
saturation does, or on the flow behind the spool, as a dead band does; cut at either place the loop has the same
transfer. Sides of the piston that are unequal pass on the flow times one of two factors, by its sign: over the larger
factor, which the loop is taken with, that is a characteristic of slope 0 to 1 as well, and no odd one. A limit of a
motor's own current takes what its drive feeds back with the law: cut there the loop has another transfer, and a proof
of its own.
"""

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from itertools import product
from math import inf
from typing import Any

import numpy as np
from flint import fmpq

from beamdesign.loop import Loop, drive_loop
from beamdesign.plant.effects import laws_of
from beamdesign.polynomial import exact, nearest, ratio, roots, text
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_claims import BoxClaim, claim_over_box, over_own_ranges
from beamdesign.proofs.box_member import worst_in_bands
from beamdesign.proofs.certificate import LOWER_GAINS, Asked, Row
from beamdesign.proofs.multiplier import Multiplier, angle_ratios, closed_over_denominator, fits, is_proper
from beamdesign.proofs.multiplier_search import ENDS_rad_per_s, Grid, kernels
from beamdesign.proofs.read_once import NotCovered
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.scope import NONE_KNOWN, Members, is_linear
from beamdesign.proofs.stability import is_stable_over
from beamdesign.proofs.statement import Statement
from beamdesign.prototype import Prototype

IN_THE_CURRENT, DEADBANDS = laws_of("current_saturation"), laws_of("valve_deadband")
IN_THE_MOTOR = laws_of("motor_current_limit")
BEHIND_THE_SPOOL = ("unequal_piston_areas", *DEADBANDS)
"""Static characteristics by their place in the loop."""
OFF_NULL = ("uneven_leakage",)
"""Effects that keep the valve from its null at rest."""
NOT_ODD = ("unequal_piston_areas", *OFF_NULL)
"""Those, and effects that are not odd."""
FOR_ODD = "for odd characteristics about zero current"
_AT_THE_MOTOR = (
    "Loop and gain are here those of law and speed feedback together: more of that feedback, more friction of the rotor"
    " or less gain of the law may help."
)
METHOD = "Zames-Falb multiplier with a Popov term, in rational arithmetic"
_ZERO, _ONE = fmpq(0), fmpq(1)


# Static characteristics.


Found = tuple[Multiplier, fmpq]
"""A multiplier, and a proved lower bound of Re[M (1 + L)]."""


def absolute_stability(loops: Sequence[Loop], low: fmpq, high: fmpq) -> tuple[Found | None, str]:
    """Seek and prove one multiplier for loops at every mass (kg) from `low` to `high`; or say why there is none."""
    for loop in loops:
        if not is_stable_over(loop.loop_denominator, low, high):
            return None, "The open loop is not stable at every mass, which the theorem presupposes."
        if reason := _unstable_gain(Rectangle(loop, low, high, _ZERO, _ONE)):
            return None, reason
    found = search(loops, low, high)
    return found, "" if found else "No multiplier was found; that does not say that the loop oscillates."


def _unstable_gain(rectangle: Rectangle) -> str:
    """Where a loop is not stable at some gain between none and its own, in words; empty where it is at all.

    A gain between them is a characteristic of slope 0 to 1 itself, so that then no multiplier exists.
    """
    if (side := rectangle.unstable_side()) is not None:
        if side.mass is None:
            return "The linear loop itself is not stable at every mass."
        mass = nearest(side.mass)
        factors = [one.value for one in rectangle.loop.at(mass).gain_crossings()]
        crossed = max((factor for factor in factors if 0 < factor < 1), default=1.0)
        where = f" below {crossed:.4g} times its own with an outer end mass of {mass:g} kg"
    elif (inside := rectangle.inside()) is None:
        return ""
    elif inside.decided:
        where = f" about {inside.factor:.4g} times its own with an outer end mass of {inside.mass:.6g} kg"
    else:
        return "Whether the loop is stable at every lower gain could not be decided."
    return (
        f"The loop is conditionally stable: it is unstable at a gain{where}, and a lower gain is what a saturation"
        " comes to at large amplitudes, so that no such multiplier exists."
    )


def static_rows(given: Members) -> Iterator[Row]:
    """A row for the characteristics at either place of the loop, and for both places at once."""
    motor = tuple(_motor_rows(given))
    alone = not any(row.proved for row in motor)
    yield from rows_of(given.prototype, *_proved(given, given.loops, given.found.gains), alone)
    yield from motor


Proved = tuple[Multiplier | None, str, str, dict[str, Any]]
"""A multiplier, why there is none, of what it is proved, and what a certificate states beside it."""


def _proved(given: Members, loops: Sequence[Loop], moving: Collection[str], only: int | None = None) -> Proved:
    """Of the loops of all members, or of one alone, counted from one; with effects that are not frozen."""
    found, reason = absolute_stability(loops, given.low, given.high)
    multiplier, margin = found or (None, _ZERO)
    numbers, of = list(range(1, len(loops) + 1)), "for every payload that stays"
    if only is not None:
        numbers, of = [only], f"{of} with {given.found.members[only - 1].name}"
    statement = {"kind": "slope", "loops": numbers, "margin": text(margin)}
    return multiplier, reason, f"{of}{given.frozen(len(loops), moving)}", statement


def _motor_rows(given: Members) -> Iterator[Row]:
    """A row for a limit of the motor's own current, and one for that of the law's at once; none where there is none.

    Where no multiplier fits all loops, each may have one of its own, and a row.
    """
    own = given.prototype.effects
    motor, current = (tuple(name for name in names if name in own) for names in (IN_THE_MOTOR, IN_THE_CURRENT))
    if not motor:
        return
    loops = [drive_loop(given.prototype, member) for member in given.found.members]
    found = [_proved(given, loops, ())]
    if found[0][0] is None and len(loops) > 1:
        each = [_proved(given, [loop], (), k) for k, loop in enumerate(loops, start=1)]
        found = next(([one] for one in each if one[0] is None), each)
    for multiplier, reason, of, statement in found:
        if multiplier is None:
            words, stated = f"{reason} {_AT_THE_MOTOR}", None
        else:
            words, stated = in_words(multiplier, of), statement | {"place": "motor"} | multiplier.table()
        yield Row(motor, METHOD, multiplier is not None, words, None, stated)
    if current:
        words = "Both places at once are not covered: the drive's feedback of the speed comes in between them."
        yield Row((*current, *motor), METHOD, False, words)


def rows_of(
    prototype: Prototype,
    multiplier: Multiplier | None,
    reason: str,
    of: str,
    statement: dict[str, Any] | None = None,
    alone: bool = True,
) -> Iterator[Row]:
    """A row for the characteristics at either place of the loop, and for both at once, from a multiplier that fits.

    Args:
        prototype: with its effects.
        multiplier: None where there is none.
        reason: in words, why.
        of: what it is proved of, in words.
        statement: what a certificate states beside the multiplier; None where it states this elsewhere.
        alone: whether nothing is proved of a limit of the actuator's own.
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
        words += prototype.actuator.law_alone if alone else ""
    yield Row(current, METHOD, multiplier is not None, words, None, stated)
    if flow:
        yield Row(flow, METHOD, multiplier is not None, words)
        if {*flow}.intersection(DEADBANDS) and own.intersection(IN_THE_CURRENT):
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


_MASSES, _FREQUENCIES = 9, 700


def search(loops: Sequence[Loop], low: fmpq, high: fmpq) -> Found | None:
    """A multiplier that is proved to fit every loop at every mass (kg) from `low` to `high`, with a margin of its own.

    Those that need no odd characteristic are sought first. None where none is found.
    """
    if not all(is_proper(loop.loop_numerator, loop.loop_denominator, low, high) for loop in loops):
        return None
    masses = np.linspace(nearest(low), nearest(high), _MASSES if low < high else 1)
    places = [
        abs(pole.imag) for loop in loops for mass in masses for pole in roots(loop.characteristic.at(exact(mass)))
    ]
    near = np.unique(np.round([p * f for p in places if p > 0 for f in (0.9, 1.0, 1.1)], 2))
    w = np.unique(np.concatenate([np.geomspace(*ENDS_rad_per_s, _FREQUENCIES), near]))
    closed = [1 + ratio(loop.loop_numerator, loop.loop_denominator, masses, w) for loop in loops]
    grid, families = Grid(w, np.concatenate(closed)), [(loop.characteristic, loop.loop_denominator) for loop in loops]
    for odd in (False, True):
        for multiplier, _, least in grid.candidates(kernels(), odd):
            margin = exact(float(f"{0.1 * least:.1g}"))
            if multiplier.admissible and all(fits(multiplier, *one, low, high, margin) for one in families):
                return multiplier, margin
    return None


# Multipliers over a box of tolerances: sought on its worst members, and proved of every member at once.
#
# A linear program finds one multiplier for all members on a list; a search over the box in bands of frequency then
# finds members that it does not fit, or hardly, and these join the list, until none is found. What is found is a guess,
# which `claim_over_box` proves or not.


_PLAIN = Multiplier((), fmpq(0))
_FEW_ORDERS = ((1, 2), (1, 2, 4))
"""Orders of kernels that are tried: the lower they are the less there is to prove."""
_TURNS, _SHARES = 10, 9
_KEPT, _GOOD = 0.3, 0.75
"""What part of the least Re z / |z| of its samples every member is to keep, and what part of the best one is enough."""
_LEAST_REAL = 2e-3
"""Of what is less no proof is tried."""
_FEW_FREQUENCIES, _NEAR_rad_per_s = 500, np.geomspace(20.0, 2000.0, 400)
_NOT_FOUND = "No multiplier was found for the whole box; that does not say that a loop of it oscillates."


def slope_over_box(
    prototype: Prototype,
    box: Box,
    budget: int = 20_000,
    seconds: float = inf,
    lower: BoxClaim | None = None,
    may_be_odd: bool = True,
) -> tuple[BoxClaim | None, str]:
    """Prove that every member comes to rest with every static characteristic of slope 0 to 1 in its law's current.

    Args:
        prototype: with a controller of one law.
        box: ranges of its parameters; the others keep their values.
        budget: most pieces to look at in one proof.
        seconds: most time for one proof.
        lower: what is known of stability at every lower gain, where that was asked before.
        may_be_odd: whether a multiplier for odd characteristics alone, without command and load, will do.

    Returns:
        The claim, proved; or None, and why there is none.
    """
    lower = claim_over_box(prototype, box, LOWER_GAINS, budget, seconds) if lower is None else lower
    if lower.holds is False:
        return None, (
            f"Of the box {lower.reason}, and a lower gain is what a saturation comes to at large amplitudes, so that no"
            " such multiplier exists."
        )
    if lower.holds is None:
        return None, f"Whether every member is stable at every lower gain: {lower.reason}."
    try:
        statement = over_own_ranges(prototype, box, _asked(_PLAIN))
    except NotCovered as error:
        return None, f"Not covered: {error}."
    for multiplier in _multipliers(statement, may_be_odd and not {*NOT_ODD} & {*prototype.effects}):
        claim = claim_over_box(prototype, box, _asked(multiplier), budget, seconds)
        return (claim, "") if claim.holds else (None, f"The multiplier that was found was not proved: {claim.reason}.")
    return None, _NOT_FOUND


def box_rows(prototype: Prototype, claim: BoxClaim | None, reason: str, moved: Sequence[Row] = ()) -> tuple[Row, ...]:
    """What is proved of the effects of every member while they move, in words, from what `slope_over_box` found.

    Args:
        prototype: with its effects.
        claim: as found.
        reason: why there is none.
        moved: what is proved of bounded errors.
    """
    of = "for every member of the box and every payload that stays"
    multiplier = None if claim is None else claim.asked.multiplier
    rows = [*rows_of(prototype, multiplier, reason, of), *moved]
    known = {name for row in rows for name in row.effects}
    if left := tuple(n for n in sorted(prototype.effects) if n not in known and not is_linear(n)):
        why = "Not covered over a box while it moves; `certify --nonlinear` says what is proved of the nominal figures."
        rows.append(Row(left, NONE_KNOWN, False, why))
    return tuple(rows)


def _asked(multiplier: Multiplier) -> Asked:
    return Asked("slope", 1.0, multiplier=multiplier)


def _multipliers(statement: Statement, may_be_odd: bool) -> Iterator[Multiplier]:
    """Multipliers that fit every member that a search found, those that need no odd characteristic first."""
    w = np.unique(np.concatenate([np.geomspace(*ENDS_rad_per_s, _FEW_FREQUENCIES), _NEAR_rad_per_s]))
    shares = np.full((_SHARES, len(statement.varying)), 0.5)
    for k in (k for k, name in enumerate(statement.varying) if "outer_end_mass" in name):
        shares[:, k] = np.linspace(0, 1, _SHARES)
    for odd, orders in product((False, True) if may_be_odd else (False,), _FEW_ORDERS):
        for _ in range(_TURNS):
            z = closed_over_denominator(_PLAIN, statement, shares, w[None])
            found = _best(Grid(w, z, popov=False), orders, odd)
            if found is None:
                break
            multiplier, least = found
            worst = worst_in_bands(statement, partial(angle_ratios, multiplier, _PLAIN))
            near = [one for one in worst if one[0] > 1 - _KEPT * least]
            if not near:
                yield multiplier
                break
            shares = np.concatenate([shares, *(some for _, some, _ in near)])
            w = np.unique(np.concatenate([w, *(at[0] for _, _, at in near)]))


def _best(grid: Grid, orders: Sequence[int], odd: bool) -> tuple[Multiplier, float] | None:
    """A multiplier of low degree that fits the samples almost as well as any, and the least Re z / |z| of these."""
    found = [
        (multiplier, least)
        for multiplier, _, least in grid.candidates(kernels(orders), odd)
        if multiplier.admissible and multiplier.popov_s == 0
    ]
    enough = _GOOD * max((least for _, least in found), default=0.0)
    good = [one for one in found if one[1] >= max(enough, _LEAST_REAL)]
    return min(good, key=lambda one: one[0].below.degree(), default=None)
