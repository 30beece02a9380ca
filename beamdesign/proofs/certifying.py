"""Certificates made: stability and claims of every linear member of a prototype decided, and the proof written."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import gcd, inf, lcm
from operator import attrgetter
from typing import Any

from flint import fmpq

from beamdesign.arguments import takes
from beamdesign.loop import Loop, member_loop
from beamdesign.plant.linear_reach import linear_part
from beamdesign.plant.members import LinearFamily, VertexModel, family, refuse_unstated
from beamdesign.polynomial import exact, nearest, shortened, simple_between, text
from beamdesign.proofs.absolute_stability import static_rows
from beamdesign.proofs.bounded_error import bounded_rows
from beamdesign.proofs.certificate import (
    METHOD,
    Asked,
    Certificate,
    Claim,
    Guaranteed,
    Row,
    as_claims,
    describe,
    implies,
    least_limits,
    limits,
    over_passive,
    peak_claim,
)
from beamdesign.proofs.changing_gain import both_rows, changing_rows
from beamdesign.proofs.performance import MAGNITUDES, bandwidth, least_limit, prove, servo_off_of
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.scope import LINEAR, NONE_KNOWN, Members, covered, is_linear, members, scope, uncovered
from beamdesign.proofs.stability import Range, StabilityMap, in_words, is_stable_over, stable_ranges
from beamdesign.proofs.tolerance_box import between
from beamdesign.proofs.writer import STABILITY_DIGITS, Tables, certificate, stability_table, texts
from beamdesign.prototype import Goal, Prototype
from beamdesign.quantities import stated_range
from beamdesign.records import InputError, Problem

_STEPS, _HALVINGS = 64, 24
"""Where a gain between its ends is unstable, a range of masses gives way by this share of itself at a time; how often
the last of these steps is halved."""


@dataclass(frozen=True)
class Proved:
    """A member with the rectangle over which it is to be stable, and that over which it is to perform, if it is."""

    member: VertexModel
    stable: Rectangle
    performing: Rectangle | None


def rectangles(given: Members) -> list[Proved]:
    """Each member's loop over masses and factors on the gain.

    Raises:
        ValueError: without a controller.
        InputError: for more members than are proved, or where mass and a gain that varies multiply each other.
    """
    refuse_unstated(given.prototype, given.found)
    found = []
    for member in given.found.members:
        loop = member_loop(given.prototype, member)
        stable = Rectangle(loop, given.low, given.high, exact(member.gain.low), exact(member.gain.high))
        inside = member.performance
        if inside is not None and inside.low < inside.high and not loop.gain_and_mass_apart:
            raise InputError(given.prototype.name, gain_and_mass(given.prototype, nearest(given.high)))
        performing = None if inside is None else replace(stable, least=exact(inside.low), most=exact(inside.high))
        found.append(Proved(member, stable, performing))
    return found


def gain_and_mass(prototype: Prototype, high_kg: float) -> list[Problem]:
    """What to change where mass and gain multiply each other: sides do not decide what is claimed of magnitudes."""
    reason = (
        "lets the gain vary where the loop is to perform, which is not proved where the end mass shows in what is fed"
        " back, as it does with added sensors or one that rides on the mount; remove it"
    )
    varying = []
    for name, table in prototype.effects.items():
        alone = family(prototype.but(effects={name: table}), high_kg).members
        spans = [member.performance for member in alone if member.performance is not None]
        varying += [name] if any(span.low < span.high for span in spans) else []
    return [Problem(f"effects.{name}", reason) for name in varying]


def common_ranges(proved: Sequence[Proved]) -> StabilityMap:
    """The masses at which all members are stable for all of their gains.

    Ends are crossings of some member at one end of its gains. Where a gain between the ends is not stable at a mass at
    which both ends are, the range gives way: what is left is proved, but need not be all.
    """
    parts = [one.stable for one in proved]
    low, high = parts[0].low, parts[0].high
    maps = [
        stable_ranges(part.loop.scaled(factor).characteristic, low, high)
        for part in parts
        for factor in sorted({part.least, part.most})
    ]
    if len(maps) == 1:
        return maps[0]
    common = [part for part in maps[0].ranges if part.stable]
    for other in maps[1:]:
        common = [piece for one in common for two in other.ranges if two.stable and (piece := _both(one, two))]
    common = [piece for one in common if (piece := _given_way(parts, one))]
    gaps = zip((low, *(one.high for one in common)), (*(one.low for one in common), high), strict=True)
    unproved = [Range(start, end, None, None, start, False) for start, end in gaps if start < end or not common]
    filled = sorted((*common, *unproved), key=attrgetter("low", "high"))
    mass = attrgetter("value")
    crossings = tuple(sorted((crossing for found in maps for crossing in found.crossings), key=mass))
    below = max((found.below for found in maps if found.below is not None), key=mass, default=None)
    above = min((found.above for found in maps if found.above is not None), key=mass, default=None)
    reason = in_words(filled, crossings).replace("unstable from", "not every loop is stable from")
    if not common:
        reason = "no range of masses was found over which every loop is stable"
    return StabilityMap(low, high, tuple(zip(crossings, strict=True)), tuple(filled), below, above, reason)


def _both(one: Range, two: Range) -> Range | None:
    """Masses in two stable ranges."""
    first, last = max((one, two), key=lambda part: part.low), min((one, two), key=lambda part: part.high)
    if first.low > last.high or (first.low == last.high and (first.opens_at or last.closes_at)):
        return None
    sample = first.low if first.low == last.high else simple_between(first.low, last.high)
    return Range(first.low, last.high, first.opens_at, last.closes_at, sample, True)


def _given_way(parts: Sequence[Rectangle], piece: Range) -> Range | None:
    """The range less what is needed for every gain between the ends to be stable, too; None where nothing is left."""
    step = (piece.high - piece.low) / _STEPS

    def stands(mass: fmpq) -> bool:
        return all(side.stable for part in parts for side in replace(part, low=mass, high=mass).sides())

    if step == 0:
        return piece if stands(piece.low) else None

    def first(start: fmpq, step: fmpq) -> fmpq:
        """The mass nearest to the start that was found to stand, in steps and then by halving the last."""
        if stands(start):
            return start
        failed, found = start, start + step
        while piece.low <= found <= piece.high and not stands(found):
            failed, found = found, found + step
        for _ in range(_HALVINGS):
            middle = (found + failed) / 2
            failed, found = (failed, middle) if stands(middle) else (middle, found)
        return found

    low, high = first(piece.low, step), first(piece.high, -step)
    if low > high or any(replace(part, low=low, high=high).inside() is not None for part in parts):
        return None
    opens, closes = (piece.opens_at if low == piece.low else None), (piece.closes_at if high == piece.high else None)
    sample = low if low == high else simple_between(low, high)
    return Range(low, high, opens, closes, sample, True)


# The certificate.


KIND = "beamdesign.mass_range"


def loop_table(loop: Loop) -> Tables:
    """A loop's polynomials over one common factor, so that every coefficient is a whole number.

    With m the outer end mass in kg the characteristic polynomial is p0 + m p1, the numerator of the loop gain is
    returned + m returned_slope, its denominator what the two differ by, and x / F_d is disturbance / (p0 + m p1).
    """
    named = {
        "p0": loop.characteristic.constant,
        "p1": loop.characteristic.slope,
        "returned": loop.loop_numerator.constant,
        "returned_slope": loop.loop_numerator.slope,
        "disturbance": loop.disturbance,
    }
    factor = lcm(*(int(polynomial.denom()) for polynomial in named.values()))
    divisor = gcd(*(int((polynomial * factor).numer().content()) for polynomial in named.values()))
    return {name: texts((polynomial * fmpq(factor, divisor)).coeffs()) for name, polynomial in named.items()}


def common_table(stability: StabilityMap) -> Tables:
    """Masses at which every one of several loops is stable at every factor on its gain."""
    ranges = [_closed(part) for part in stability.ranges if part.stable]
    return {"stable": stability.stable, "range": [{"low": text(low), "high": text(high)} for low, high in ranges]}


def _closed(part: Range) -> tuple[fmpq, fmpq]:
    """A closed range of short decimals inside a range that is open where it ends at a crossing."""
    low, high = part.low, part.high
    if part.opens_at is not None:
        low = shortened(low, STABILITY_DIGITS, up=True)
        low = low if part.low < low < part.sample else simple_between(part.low, part.sample)
    if part.closes_at is not None:
        high = shortened(high, STABILITY_DIGITS)
        high = high if part.sample < high < part.high else simple_between(part.sample, part.high)
    return low, high


def stability_over(prototype: Prototype, low_kg: float, high_kg: float, as_far: bool = False) -> StabilityMap:
    """Where from `low_kg` to `high_kg` every linear member is stable: of `certify` the stability alone, not written.

    Where no linear loop stands for its effects, that is refused, or `as_far` as those are linear by themselves.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    try:
        given = members(prototype, low_kg, high_kg)
    except InputError:
        if not as_far:
            raise
        given = members(linear_part(prototype), low_kg, high_kg)
    return common_ranges(rectangles(given))


@takes("Prototype")
def certify(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float] | float | None = None,
    high_kg: float | None = None,
    claims: Sequence[Asked] = (),
    nonlinear: bool = False,
    linear: bool = False,
) -> Certificate:
    """Decide stability and claims over every mass on the outer tip, and write the proof.

    Where the range is stable, the guaranteed bandwidth (for the goal's compliance) and the guaranteed peak sensitivity
    are worked out and proved as well. Everything is about all linear members of the prototype, of which there is one
    without effects: stability, decay and gain margin at every factor on the gain that the effects allow; the rest at
    those at which the effects are to let the loop perform. `between` tells of what lies between the values that members
    freeze, `small_motion` what small motion does not keep of it.

    Args:
        prototype: with a controller of one law.
        outer_end_mass_kg: range, or its lower end where the upper one follows; else the prototype's payload.
        high_kg: upper end.
        claims: to decide beside what is guaranteed.
        nonlinear: prove as well what holds while effects move, and while the law's current saturates.
        linear: let the answer `yes` be about linear members alone, where effects are in the way of more.

    Raises:
        ValueError: for an empty range, or without a controller.
        InputError: without a range, for masses that are not plausible, or for effects for which no linear loop stands.
    """
    low_kg, high_kg = prototype.asked_kg(outer_end_mass_kg if high_kg is None else (outer_end_mass_kg, high_kg))
    given = members(prototype, low_kg, high_kg)
    found, proved = given.found, rectangles(given)
    stability = common_ranges(proved)
    decided = [_decide(proved, asked) for asked in claims]
    guaranteed: Guaranteed | None = None
    reached: list[Claim] = []
    if stability.stable:
        off = servo_off_of(found.members, prototype.payload.inner_end_mass_kg, (low_kg, high_kg))
        guaranteed, reached = _guarantees(proved, prototype.goal, (low_kg, high_kg), off.compliance_m_per_N)
    written = decided + [claim for claim in reached if not any(implies(other, claim) for other in decided)]
    rows = nonlinear_rows(given) if nonlinear else ()
    summary = "\n".join([_summary(prototype, found, stability, written, nonlinear), *(row.line() for row in rows)])
    alone = len(proved) == 1 and proved[0].stable.least == proved[0].stable.most == 1
    body: dict[str, Any] = {
        "outer_end_mass_kg": texts((given.low, given.high)),
        "stability": stability_table(stability) if alone else common_table(stability),
    }
    body |= {"claim": [claim.table(alone) for claim in written]} if written else {}
    body |= {"loop": [loop_table(part.stable.loop) for part in proved]}
    if statements := [row.statement for row in rows if row.statement is not None]:
        body["nonlinear"] = statements
    written_text = certificate(KIND, prototype, body, summary, high_kg)
    method = f"{METHOD}; {scope(prototype, found)}" if prototype.effects else METHOD
    about = tuple(covered(prototype, found, nonlinear)) if prototype.effects else ()
    inside = between(prototype, low_kg, high_kg) if prototype.effects and stability.stable else None
    more = method, about, rows, uncovered(prototype, rows, claims), inside, linear
    return Certificate((low_kg, high_kg), stability, written_text, tuple(decided), guaranteed, *more)


def worst_of(found: Sequence[Guaranteed]) -> Guaranteed:
    """The worst of what is proved with each of some laws."""
    worst: dict[str, Any] = {
        name: max((limit for one in found if (limit := getattr(one, name)) is not None), default=None)
        for name in ("loop_gain", "controller_effort_A_per_V")
    }
    return replace(
        max(found, key=attrgetter("peak_over_passive")),
        bandwidth_Hz=min(one.bandwidth_Hz for one in found),
        peak_sensitivity=max(one.peak_sensitivity for one in found),
        **worst,
    )


def _decide(proved: Sequence[Proved], asked: Asked) -> Claim:
    """A claim about every member: the first that refutes it, or that it holds."""
    performance = asked.kind in MAGNITUDES  # as opposed to a claim about poles
    alone = len(proved) == 1 and proved[0].stable.least == proved[0].stable.most  # so that the proof says where
    if performance and not alone and not all(part.stable.stable for part in proved):
        masses = nearest(proved[0].stable.low), nearest(proved[0].stable.high)
        return asked.decided(
            masses, False, "not every member is stable for all of these masses and factors on the gain"
        )
    claim: Claim | None = None
    for part in proved:
        rectangle = part.performing if performance else part.stable
        if rectangle is None:
            continue
        claim = prove(rectangle, asked)
        if not claim.holds:
            where = f" (with {part.member.name})" if part.member.name else ""
            return replace(claim, reason=claim.reason + where)
    assert claim is not None  # some member performs
    return claim


def _guarantees(
    proved: Sequence[Proved], goal: Goal, ends: tuple[float, float], servo_off_m_per_N: float
) -> tuple[Guaranteed, list[Claim]]:
    """The best figures that every member has, and each as a claim that holds."""
    performing = [part.performing for part in proved if part.performing is not None]
    reached = Asked("compliance", goal.compliance_m_per_N, bandwidth(performing, goal.compliance_m_per_N))
    peak, *others = least_limits(goal, lambda *asked: least_limit(performing, *asked))
    asked = max((one.limit for one in peak_claim(goal, servo_off_m_per_N)), default=inf)
    softest = Asked("peak_compliance", least_limit(performing, "peak_compliance", goal=asked))
    beside = softest.limit, servo_off_m_per_N, over_passive(softest.limit, servo_off_m_per_N)
    guaranteed = Guaranteed(reached.bandwidth_Hz, *limits((peak, *others)), *beside)
    return guaranteed, as_claims((peak, reached, *others, softest), ends)


def _summary(
    prototype: Prototype, found: LinearFamily, stability: StabilityMap, claims: Sequence[Claim], nonlinear: bool
) -> str:
    """The result in words, for the top of the certificate."""
    low, high = nearest(stability.low), nearest(stability.high)
    effects = " with effects" if prototype.effects else ""
    lines = [f"Certificate of {prototype.name!r}{effects} for every outer end mass from {low:.15g} to {high:.15g} kg."]
    if prototype.effects:
        lines += [f"{scope(prototype, found).capitalize()}.", *covered(prototype, found, nonlinear)]
    every, all_of_it = ("Every member", "") if len(found.members) > 1 else ("It", "The closed loop is ")
    if stability.stable:
        lines.append(f"{all_of_it or 'Every member is '}stable over the whole range.")
    else:
        lines.append(f"{all_of_it}NOT stable over the whole range: {stability.reason}.")
        lines += [f"{every} is stable from {stated_range(ends, 9)} kg." for ends in stability.closed_ranges]
    lines += [f"{'Proved' if claim.holds else 'Refuted'}: {describe(claim)}." for claim in claims]
    return "\n".join(lines)


# The nonlinear loop: for each effect of a prototype, what is proved of it while it moves, and on what that rests.
#
# - Static characteristics in the current or behind the spool (saturation, dead band, unequal sides): a multiplier of
#   Zames and Falb with a term of Popov's, `beamdesign.proofs.absolute_stability`.
# - Gains that change: the circle criterion, `beamdesign.proofs.changing_gain`.
# - One of the first in the current and one of the second, or unequal sides, at once: likewise.
# - What is linear plus a bounded error (friction, hysteresis, dead band, ripple, quantisation): how far the tip strays,
#   `beamdesign.proofs.bounded_error`.
# - What is linear is a part of the loop, and of every proof.
#
# Every other effect is listed with why nothing is proved of it.


_OPEN = (
    "No theorem here covers it while it moves; what `certify` proves of it is about linear loops that bracket it at"
    " frozen values"
)
_WHY = {
    "joint_backlash": "the joint's damping depends on how far it is pressed, so that the play is no bounded error",
    "joint_backlash_nut": "a flank damps while it touches and never pulls, so that the play is no bounded error",
    "entrained_air": "the oil's stiffness changes with the pressure, which is no gain at one place of the loop",
    "entrained_air_with_stroke": "the oil's stiffness changes with pressure and stroke, which is no gain at one place",
    "pressure_dependent_flow": "with unequal sides the flows of both ports do not act as one gain",
    "unequal_piston_areas": "with orifices the sides act through both pressures, and not as one characteristic",
}


def nonlinear_rows(given: Members) -> tuple[Row, ...]:
    """What is proved of each effect of a prototype, and of the saturation that every rig has, over a range of masses.

    Raises:
        ValueError: without a controller.
    """
    rows = [*static_rows(given), *changing_rows(given), *both_rows(given), *bounded_rows(given), *_linear(given)]
    known = {name for row in rows for name in row.effects}
    for name in sorted(given.prototype.effects.keys() - known):
        why = f": {_WHY[name]}" if name in _WHY else ""
        rows.append(Row((name,), NONE_KNOWN, False, f"{_OPEN}{why}."))
    return tuple(rows)


def _linear(given: Members) -> Iterator[Row]:
    """One row for all effects that are linear themselves."""
    names = [name for name in sorted(given.prototype.effects) if is_linear(name)]
    if names:
        stable = all(is_stable_over(loop.characteristic, given.low, given.high) for loop in given.loops)
        words = "Linear itself, as it is simulated: every loop here holds it, in every combination."
        yield Row(tuple(names), LINEAR, stable, words if stable else "The linear loop is not stable at every mass.")
