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

With a static characteristic in the current at the same time, the gain being k(t) = most (a + (1 - a) psi(t)) with a =
least / most and psi from 0 to 1, at the sensor's volts or at the flow behind the spool, and v what it acts on, u =
-(L_a i + (1 - a) F j) and v = H i, where i = phi(u), j = psi v, L_a is the loop with the gain at its least, and F H is
what runs through the gain at its most. For phi the multiplier M holds (see `beamdesign.proofs.multiplier`), for psi any
w > 0 (circle criterion). Together they prove that the loop comes to rest where the Hermitian matrix of both is positive
definite at every frequency (A. Megretski and A. Rantzer, IEEE Trans. Automatic Control 42 (1997) 819): where

    4 w (Re[M (1 + L_a)] - margin) >= |(1 - a) M F - w conj(H)|^2.

Times |Q D|^2 it is a quadratic in the mass again. The gain may be a static characteristic itself, as the unequal sides
of a piston are; then it may be seen from any equilibrium, else from rest without command and load.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_FLOOR
from math import inf, log10
from typing import Any

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop, member_loop
from beamdesign.plant.assembly import effect_parameters_of
from beamdesign.plant.members import VertexModel, family
from beamdesign.polynomial import Affine, exact, inner, nearest, ratio, text
from beamdesign.proofs.absolute_stability import DEADBANDS, IN_THE_CURRENT, OFF_NULL
from beamdesign.proofs.bounded_error import acts_ahead
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_claims import BoxClaim
from beamdesign.proofs.certificate import Row
from beamdesign.proofs.multiplier import Multiplier, fits, is_proper, slack
from beamdesign.proofs.multiplier_search import ENDS_rad_per_s, Grid, kernels
from beamdesign.proofs.quadratic import Coefficients, first_negative, less, over_mass
from beamdesign.proofs.rig_family import FACTOR
from beamdesign.proofs.scope import Members
from beamdesign.proofs.stability import is_stable_over
from beamdesign.quantities import decimal, stated_range

OVER_BOX = "circle criterion, by the peak sensitivity that is proved of every member"
METHOD = "circle criterion, a quadratic Lyapunov function for each payload, in rational arithmetic"
_MARGINS = tuple(fmpq(1, 10**k) for k in range(1, 6))
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
        drives: whether the effect drives the loop besides, so that it never comes to rest.
    """

    effect: str
    place: str
    least: fmpq
    most: fmpq
    words: str
    drives: bool = False

    @property
    def between(self) -> str:
        """Between what it changes, rounded inwards."""
        return stated_range((nearest(self.least), nearest(self.most)), 4, " and ")

    def table(self, kind: str, loops: int, **figures: fmpq) -> dict[str, Any]:
        """As a certificate states it of so many loops, beside further figures."""
        gain = [text(self.least), text(self.most)]
        found = {"kind": kind, "loops": list(range(1, loops + 1)), "place": self.place, "gain": gain}
        return found | {name: text(value) for name, value in figures.items()}


def changing(given: Members) -> list[Changing]:
    """The gains that a prototype's effects change, each at one place of the loop."""
    own, found = effect_parameters_of(given.prototype), []
    ripple = own.get("carrier_ripple")
    if ripple is not None and ripple["depth"] > 0 and "carrier_ripple" in given.found.gains:  # else it is frozen
        depth = exact(ripple["depth"])
        found.append(Changing("carrier_ripple", "volts", 1 - depth, 1 + depth, _RIPPLE, ripple["residual_V"] > 0))
    orifices = own.get("pressure_dependent_flow")
    if orifices is not None and not own.keys() & {"unequal_piston_areas", "uneven_leakage"}:
        span = given.found.gains["pressure_dependent_flow"]
        words = (
            "It comes to rest without a load, as long as the load pressure stays within that of"
            f" {decimal(given.found.load_N, 6, ROUND_FLOOR)} N, with equal sides and from chambers at half the supply"
            " pressure."
        )
        found.append(Changing("pressure_dependent_flow", "flow", exact(span.low), exact(span.high), words))
    return found


def cut(loop: Loop, place: str) -> tuple[Affine, Affine]:
    """Denominator and numerator of the loop cut at a place: what is not cut stays closed."""
    if place == "volts":
        return loop.cut, loop.loop_numerator - loop.added
    return loop.loop_denominator, loop.loop_numerator


def margin_of(loop: Loop, place: str, least: fmpq, most: fmpq, low: fmpq, high: fmpq) -> fmpq | None:
    """A proved lower bound of Re[(1 + most L) / (1 + least L)] at every mass (kg) and frequency; None where none is.

    It is none, too, where the loop is not stable at the least factor.
    """
    denominator, numerator = cut(loop, place)
    under, over = denominator + numerator * least, denominator + numerator * most
    if not is_stable_over(under, low, high):
        return None
    return next((margin for margin in _MARGINS[:4] if fits(_PLAIN, over, under, low, high, margin)), None)


def changing_rows(given: Members) -> Iterator[Row]:
    """A row for each gain that changes."""
    loops = [member_loop(given.prototype, member) for member in given.found.members]
    for one in changing(given):
        margins = [margin_of(loop, one.place, one.least, one.most, given.low, given.high) for loop in loops]
        known = [margin for margin in margins if margin is not None]
        between = f"between {one.between} times its own"
        if len(known) < len(loops):
            words = f"The circle criterion does not hold for a gain that changes {between}, which need not mean unrest."
            yield Row((one.effect,), METHOD, False, words)
            continue
        frozen = given.frozen(len(loops), (one.effect,))
        words = (
            f"The loop is stable while this gain changes {between}, in any way and at any rate, for every payload that"
            f" stays{frozen}. {one.words} Not covered, but where that is said of both at once, is what moves elsewhere"
            " at the same time."
        )
        yield Row((one.effect,), METHOD, True, words, None, one.table("sector", len(loops), margin=min(known)))


def covered(peak: fmpq) -> tuple[fmpq, fmpq | None]:
    """Between what factors a gain may change of a loop with |1 + L| at least 1 / peak; None for any number.

    The disc about -1 with the radius 1 / peak is that of the circle criterion from peak / (peak + 1) to
    peak / (peak - 1). At a peak of one it reaches the origin: from one half up, however far.
    """
    return peak / (peak + 1), peak / (peak - 1) if peak > 1 else None


def changing_over_box(given: Members, box: Box, claims: Iterable[BoxClaim]) -> Iterator[Row]:
    """A row for each gain that changes, of every member of a box, from what is claimed of it.

    Args:
        given: the prototype with its payloads, whose gains count as they are of any member.
        box: the ranges.
        claims: what is proved of every member.
    """
    heaviest = nearest(box.ranges.get("outer_end_mass", (given.low, given.high))[1])
    given = replace(given, found=family(given.prototype, heaviest, box.ranges))
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
        reach = stated_range((nearest(low), inf if high is None else nearest(high)), 4, " and ")
        words = (
            f"The peak sensitivity {found.asked.limit:g} proved of every member"
            f"{' at which its effects perform' if found.own else ''} covers a gain that changes between"
            f" {reach.replace('∞', 'any number')} times its own, in any way and at any rate, for every payload that"
            f" stays; this one does so between {float(one.least):.4g} and {float(one.most):.4g}"
        )
        alone = one.place == "flow" or all(loop.added.constant.is_zero() for loop in given.loops)
        proved = low <= one.least and (high is None or one.most <= high) and alone
        own = f". {one.words} Not covered is what moves elsewhere at the same time."
        words += own if proved else ", or beside other sensors, which need not mean unrest."
        yield Row((one.effect,), OVER_BOX, proved, words)


# While the current saturates.


BOTH = "Zames-Falb multiplier and circle criterion at once, in rational arithmetic"
_S = fmpq_poly([0, 1])


@dataclass(frozen=True)
class Pair:
    """A loop with a characteristic in its current and a gain that changes at another place.

    Attributes:
        denominator: D, of the loop cut at the current.
        closed: D (1 + L_a).
        share: 1 - a.
        onto: numerator and denominator of F.
        by: numerator and denominator of H.
    """

    denominator: Affine
    closed: Affine
    share: fmpq
    onto: tuple[Affine, Affine]
    by: tuple[Affine, Affine]

    @property
    def falls(self) -> bool:
        """Whether F falls off at least as 1/s, so that a term of Popov's is allowed."""
        above, below = (max(part.constant.degree(), part.slope.degree()) for part in self.onto)
        return above < below

    def slack(self, multiplier: Multiplier, weight: fmpq, margin: fmpq) -> Coefficients:
        """What is not negative where the matrix is positive definite, as a quadratic in the mass."""
        below = multiplier.below
        # D is the product of the denominators of F and H, of which one alone is over the mass. On the axis what is
        # taken at -s is the conjugate.
        left = _product(self.onto[0], self.by[1](-_S)) * (self.share * multiplier.above)
        right = _product(self.by[0](-_S), self.onto[1]) * (-weight * below(-_S * _S))
        off = left + right
        own = slack(multiplier, self.closed, self.denominator, margin)
        return less(4 * weight * below, own, over_mass(inner, off, off))

    def fits(self, multiplier: Multiplier, weight: fmpq, low: fmpq, high: fmpq, margin: fmpq) -> bool:
        """Whether the matrix is positive definite, to a margin, at every mass (kg) and frequency."""
        return first_negative(self.slack(multiplier, weight, margin), low, high) is None

    def responses(self, masses: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """1 + L_a, (1 - a) F and H at jw in floats, (masses, frequencies) each."""
        share = nearest(self.share)
        onto, by = (ratio(*one, masses, w) for one in (self.onto, self.by))
        return ratio(self.closed, self.denominator, masses, w), share * onto, by


def _product(one: Affine, other: Affine) -> Affine:
    """Of two of which one is free of the mass."""
    assert one.slope.is_zero() or other.slope.is_zero()
    return one * other.constant + Affine(fmpq_poly(), one.constant * other.slope)


def pair(given: Members, member: VertexModel, change: Changing) -> Pair | None:
    """The loop of a member with a gain that changes; None where it does not come to this form."""
    prototype, loop = given.prototype, member_loop(given.prototype, member)
    if acts_ahead(prototype, change.effect, change.place) or not change.least > 0:
        return None
    law = prototype.own_controller.sensed_law()
    plant = member.rig.plant(prototype.payload.inner_end_mass_kg, law.sensors)
    denominator, (open_, fed) = loop.loop_denominator, cut(loop, change.place)
    if change.place == "volts":
        if member.rig.sensor_rides:
            return None
        # between the volts and the controller there may be filters: what it hears over what the tip does
        hears = plant.control[0].constant / exact(prototype.sensor.gain_V_per_m)
        shared = hears.gcd(plant.displaced)
        above, below = hears / shared, plant.displaced / shared
        if any(not (part % below).is_zero() for part in (plant.denominator.constant, plant.denominator.slope)):
            return None
        rest = Affine(plant.denominator.constant / below, plant.denominator.slope / below)
        onto = Affine(law.numerators[0] * above * change.most), Affine(law.denominator * below)
        by = Affine(shared * exact(prototype.sensor.gain_V_per_m)), rest
    else:
        w, damping = (exact(member.rig.figures[key]) for key in ("valve_frequency", "valve_damping_ratio"))
        spring = exact(member.frozen.get("valve_hysteresis", {}).get("spring", 0.0))
        spool = fmpq_poly([1 + spring, 2 * damping / w, 1 / (w * w)])
        parts = denominator.constant, denominator.slope
        if any(not (part % spool).is_zero() for part in parts):
            return None
        onto = fed * change.most, Affine(*(part / spool for part in parts))
        by = Affine(fmpq_poly([1])), Affine(spool)
    return Pair(denominator, open_ + fed * change.least, 1 - change.least / change.most, onto, by)


def unequal(given: Members) -> list[Changing]:
    """The sides of a piston as a gain that changes with the direction of the flow."""
    own = given.prototype.effects.keys()
    if "unequal_piston_areas" not in own or own & {"pressure_dependent_flow", *DEADBANDS}:
        return []
    span = given.found.gains["unequal_piston_areas"]
    return [Changing("unequal_piston_areas", "flow", exact(span.low), exact(span.high), "")]


def both_rows(given: Members) -> Iterator[Row]:
    """A row for each gain that changes while the current saturates."""
    current = tuple(name for name in IN_THE_CURRENT if name in given.prototype.effects) or IN_THE_CURRENT[:1]
    for change in (*changing(given), *unequal(given)):
        if change.drives:
            continue
        static = change.effect == "unequal_piston_areas"
        names = (*current, change.effect)
        if not static and (off := sorted({*OFF_NULL} & {*given.prototype.effects})):
            words = (
                f"Both at once: with {', '.join(off)} the valve rests off its null, where this gain drives the loop."
            )
            yield Row(names, BOTH, False, words)
            continue
        pairs = [pair(given, member, change) for member in given.found.members]
        known = [one for one in pairs if one is not None]
        presupposed = all(
            is_stable_over(one.denominator, given.low, given.high)
            and is_proper(one.closed - one.denominator, one.denominator, given.low, given.high)
            for one in known
        )
        found = search(known, given.low, given.high) if presupposed and len(known) == len(pairs) else None
        if found is None:
            words = "Both at once: no multiplier was found; that does not say that the loop oscillates."
            yield Row(names, BOTH, False, words)
            continue
        multiplier, weight, margin = found
        statement = change.table("both", len(pairs), weight=weight, margin=margin) | multiplier.table()
        where = "under any constant command and load" if static else "where there is no command and no load"
        how = "with the direction of the flow" if static else "in any way and at any rate"
        frozen = given.frozen(len(pairs), (change.effect,))
        words = (
            "Both at once: from every state the loop comes to rest with any static characteristic of slope 0 to 1 in"
            f" the current while its gain changes between {change.between} times its own {how}, {where}, for every"
            f" payload that stays{frozen}. M = {multiplier}, w = {text(weight)}."
        )
        words += f" {change.words}" if change.place == "flow" and change.words else ""  # how far orifices keep within
        yield Row(names, BOTH, True, words, None, statement)


_W = np.geomspace(*ENDS_rad_per_s, 500)
_MASSES = 7


def search(pairs: Sequence[Pair], low: fmpq, high: fmpq) -> tuple[Multiplier, fmpq, fmpq] | None:
    """A multiplier, a weight and a margin proved to fit every loop at every mass (kg); None where none is found."""
    masses = np.linspace(nearest(low), nearest(high), _MASSES if low < high else 1)
    parts = zip(*(one.responses(masses, _W) for one in pairs), strict=True)
    closed, onto, by = (np.concatenate(arrays) for arrays in parts)
    if not (largest := float(abs(onto).max())) > 0:
        return None
    scale = 10.0 ** round(log10(largest))
    grid = Grid(_W, closed, all(pair.falls for pair in pairs), (onto / scale, by * scale))
    for multiplier, scaled, _ in grid.candidates(kernels()):
        weight = scaled * exact(scale) ** 2
        for margin in _MARGINS[1:]:
            if all(pair.fits(multiplier, weight, low, high, margin) for pair in pairs):
                return multiplier, weight, margin
    return None
