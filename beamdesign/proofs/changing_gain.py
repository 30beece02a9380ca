"""Gains that change while the rig moves, between two factors and in any way: the circle criterion, in rationals.

With the loop cut where the gain changes, of transfer L, it is stable for every k(t) from `least` to `most` times its
own if it is stable at `least` and Re[(1 + most L) / (1 + least L)] is above a positive number at every frequency (G.
Zames, IEEE Trans. Automatic Control 11 (1966) 465). That there is one quadratic Lyapunov function for all k, for each
payload, is the same statement (Kalman, Yakubovich, Popov). Over the mass it is a quadratic, as inequalities are here.

That the loop is singular with no complex gain of the disk through the two factors is the same; and a peak sensitivity
of at most m at some gain is that of the disk through m / (m + 1) and m / (m - 1) times it. So what is proved of the
peak sensitivity of every member of a box says of every member which gains may change.

A gain that changes by itself, as a ripple does, leaves a linear loop, whose motions then run together whatever the
command and load. One that changes with the motion does not, and is covered about rest without load.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from flint import fmpq

from beamdesign.loop import Loop, member_loop
from beamdesign.plant.assembly import effect_parameters_of
from beamdesign.polynomial import Affine, exact, text
from beamdesign.proofs.absolute_stability import Members, Row
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_claims import BoxClaim
from beamdesign.proofs.multiplier import Multiplier, fits
from beamdesign.proofs.rig_family import FACTOR
from beamdesign.proofs.stability import is_stable_over

OVER_BOX = "circle criterion, by the peak sensitivity that is proved of every member"
METHOD = "circle criterion, a quadratic Lyapunov function for each payload, in rational arithmetic"
_MARGINS = tuple(fmpq(1, 10**k) for k in (1, 2, 3, 4))
_MINUS = fmpq(-1)
_RIPPLE = "All its motions under one command and load run together."
_PLAIN = Multiplier((), fmpq(0))


@dataclass(frozen=True)
class Changing:
    """A gain that an effect changes.

    Attributes:
        effect: its name.
        place: where: "volts" of the sensor, or "flow" of the valve.
        least: factor.
        most: factor.
        words: what it comes to, and as long as what.
    """

    effect: str
    place: str
    least: fmpq
    most: fmpq
    words: str


def changing(given: Members) -> list[Changing]:
    """The gains that a prototype's effects change, each at one place of the loop."""
    own, found = effect_parameters_of(given.prototype), []
    ripple = own.get("carrier_ripple")
    if ripple is not None and ripple["depth"] > 0 and ripple["residual_V"] == 0:
        depth = exact(ripple["depth"])
        found.append(Changing("carrier_ripple", "volts", 1 - depth, 1 + depth, _RIPPLE))
    orifices = own.get("pressure_dependent_flow")
    if orifices is not None and not own.keys() & {"unequal_piston_areas", "uneven_leakage"}:
        span = given.found.gains["pressure_dependent_flow"]
        words = (
            "It comes to rest without a load, as long as the load pressure stays within that of"
            f" {given.found.load_N:.6g} N, with equal sides and from chambers at half the supply pressure."
        )
        found.append(Changing("pressure_dependent_flow", "flow", exact(span.low), exact(span.high), words))
    return found


def cut(loop: Loop, place: str) -> tuple[Affine, Affine]:
    """Denominator and numerator of the loop cut at a place: what is not cut stays closed."""
    if place == "volts":
        return loop.cut, loop.loop_numerator + loop.added * _MINUS
    return loop.loop_denominator, loop.loop_numerator


def margin_of(loop: Loop, place: str, least: fmpq, most: fmpq, low: fmpq, high: fmpq) -> fmpq | None:
    """A proved lower bound of Re[(1 + most L) / (1 + least L)] at every mass (kg) and frequency; None where none is.

    It is none, too, where the loop is not stable at the least factor.
    """
    denominator, numerator = cut(loop, place)
    under, over = denominator + numerator * least, denominator + numerator * most
    if not is_stable_over(under, low, high):
        return None
    return next((margin for margin in _MARGINS if fits(_PLAIN, over, under, low, high, margin)), None)


def changing_rows(given: Members) -> Iterator[Row]:
    """A row for each gain that changes."""
    loops = [member_loop(given.prototype, member) for member in given.found.members]
    for one in changing(given):
        margins = [margin_of(loop, one.place, one.least, one.most, given.low, given.high) for loop in loops]
        known = [margin for margin in margins if margin is not None]
        between = f"between {float(one.least):.4g} and {float(one.most):.4g} times its own"
        if len(known) < len(loops):
            words = f"The circle criterion does not hold for a gain that changes {between}, which need not mean unrest."
            yield Row((one.effect,), METHOD, False, words)
            continue
        statement = {
            "kind": "sector",
            "loops": list(range(1, len(loops) + 1)),
            "place": one.place,
            "gain": [text(one.least), text(one.most)],
            "margin": text(min(known)),
        }
        frozen = given.frozen(len(loops), (one.effect,))
        words = (
            f"The loop is stable while this gain changes {between}, in any way and at any rate, for every payload that"
            f" stays{frozen}. {one.words} Not covered, but where that is said of both at once, is what moves elsewhere"
            " at the same time."
        )
        yield Row((one.effect,), METHOD, True, words, None, statement)


def covered(peak: fmpq) -> tuple[fmpq, fmpq | None]:
    """Between what factors a gain may change of a loop with |1 + L| at least 1 / peak; None for any number.

    The disc about -1 with the radius 1 / peak is that of the circle criterion from peak / (peak + 1) to
    peak / (peak - 1). At a peak of one it reaches the origin: from one half up, however far.
    """
    return peak / (peak + 1), peak / (peak - 1) if peak > 1 else None


def changing_over_box(given: Members, box: Box, claims: Iterable[BoxClaim]) -> Iterator[Row]:
    """A row for each gain that changes, of every member of a box, from what is claimed of it.

    Args:
        given: the prototype with its payloads.
        box: the ranges.
        claims: what is proved of every member.
    """
    found = next((one for one in claims if one.holds and one.asked.kind == "peak_sensitivity"), None)
    gain = {**box.ranges, **(found.own if found else {})}.get(FACTOR, (fmpq(1), fmpq(1)))
    for one in changing(given):
        if found is None:
            yield Row((one.effect,), OVER_BOX, False, "No peak sensitivity is proved of every member.")
            continue
        peak = exact(found.asked.limit)
        centre = min(max(one.least * (peak + 1) / peak, gain[0]), gain[1])
        low, high = covered(peak)
        low, high = centre * low, None if high is None else centre * high
        most = "any number" if high is None else f"{float(high):.4g}"
        words = (
            f"The peak sensitivity {found.asked.limit:g} proved of every member covers a gain that changes between"
            f" {float(low):.4g} and {most} times its own, in any way and at any rate, for every payload that"
            f" stays; this one does so between {float(one.least):.4g} and {float(one.most):.4g}"
        )
        alone = one.place == "flow" or all(loop.added.constant.is_zero() for loop in given.loops)
        if low <= one.least and (high is None or one.most <= high) and alone:
            words += f". {one.words} Not covered is what moves elsewhere at the same time."
            yield Row((one.effect,), OVER_BOX, True, words)
        else:
            yield Row((one.effect,), OVER_BOX, False, f"{words}, or beside other sensors, which need not mean unrest.")
