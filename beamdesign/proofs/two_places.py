"""A static characteristic in the current and, elsewhere in the loop, a gain that changes: both at once, in rationals.

The gain is k(t) = most (a + (1 - a) psi(t)) with a = least / most and psi from 0 to 1, at the sensor's volts or at the
flow behind the spool. With v what it acts on, u = -(L_a i + (1 - a) F j) and v = H i, where i = phi(u), j = psi v, L_a
is the loop with the gain at its least, and F H is what runs through the gain at its most. For phi the multiplier M
holds (see `beamdesign.proofs.multiplier`), for psi any w > 0 (circle criterion). Together they prove that the loop
comes to rest where the Hermitian matrix of both is positive definite at every frequency (A. Megretski and A. Rantzer,
IEEE Trans. Automatic Control 42 (1997) 819): where

    4 w (Re[M (1 + L_a)] - margin) >= |(1 - a) M F - w conj(H)|^2.

Times |Q D|^2 it is a quadratic in the mass again. The gain may be a static characteristic itself, as the unequal sides
of a piston are; then it may be seen from any equilibrium, else from rest without command and load.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop, rig_loop
from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import Affine, even_odd, exact
from beamdesign.proofs.absolute_stability import IN_THE_CURRENT, Members, Row
from beamdesign.proofs.changing_gain import Changing, changing
from beamdesign.proofs.multiplier import Multiplier, is_proper, ratio, slack
from beamdesign.proofs.performance import Coefficients
from beamdesign.proofs.quadratic import quadratic_nonnegative
from beamdesign.proofs.stability import is_stable_over
from beamdesign.proofs.two_places_search import search
from beamdesign.rational import nearest, text

METHOD = "Zames-Falb multiplier and circle criterion at once, in rational arithmetic"
_X = fmpq_poly([0, 1])
_NONE = fmpq(0)

Axis = tuple[fmpq_poly, fmpq_poly]
"""Real part, and imaginary part over w, on the imaginary axis, polynomials in x = w^2."""


def _times(one: Axis, other: Axis) -> Axis:
    return one[0] * other[0] - _X * one[1] * other[1], one[0] * other[1] + one[1] * other[0]


def _conjugate(one: Axis) -> Axis:
    return one[0], -one[1]


def _inner(one: Axis, other: Axis) -> fmpq_poly:
    return one[0] * other[0] + _X * one[1] * other[1]


@dataclass(frozen=True)
class Pair:
    """A loop with a characteristic in its current and a gain that changes at another place.

    Attributes:
        opened: D, denominator of the loop cut at the current.
        closed: D (1 + L_a).
        share: 1 - a.
        onto: numerator and denominator of F.
        by: numerator and denominator of H.
    """

    opened: Affine
    closed: Affine
    share: fmpq
    onto: tuple[Affine, Affine]
    by: tuple[Affine, Affine]

    @property
    def falls(self) -> bool:
        """Whether F falls off at least as 1/s, so that a term of Popov's is allowed."""
        return _degree(self.onto[0]) < _degree(self.onto[1])

    def slack(self, multiplier: Multiplier, weight: fmpq, margin: fmpq) -> Coefficients:
        """What is not negative where the matrix is positive definite, as a quadratic in the mass."""
        real, imaginary, below = multiplier.parts
        ends = []
        for k in (0, 1):
            # D is the product of the denominators of F and H, of which one alone is over the mass
            left = _product(self.onto[0], self.by[1], k)
            right = _product(self.by[0], self.onto[1], k, first=True)
            one, two = _times((real, imaginary), left), right
            ends.append(tuple(self.share * a - weight * below * b for a, b in zip(one, two, strict=True)))
        (e0, o0), (e1, o1) = ends
        a, b, c = slack(multiplier, self.closed, self.opened, margin)
        factor = 4 * weight * below
        return (
            factor * a - _inner((e1, o1), (e1, o1)),
            factor * b - 2 * _inner((e0, o0), (e1, o1)),
            factor * c - _inner((e0, o0), (e0, o0)),
        )

    def fits(self, multiplier: Multiplier, weight: fmpq, low: fmpq, high: fmpq, margin: fmpq) -> bool:
        """Whether the matrix is positive definite, to a margin, at every mass (kg) and frequency."""
        coefficients = self.slack(multiplier, weight, margin)
        return quadratic_nonnegative(*coefficients, low, high, _NONE, None).holds

    def responses(self, masses: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """1 + L_a, (1 - a) F and H at jw in floats, (masses, frequencies) each."""
        share = nearest(self.share)
        onto, by = (ratio(*one, masses, w) for one in (self.onto, self.by))
        return ratio(self.closed, self.opened, masses, w), share * onto, by


def _degree(family: Affine) -> int:
    return max(family.constant.degree(), family.slope.degree())


def _product(one: Affine, other: Affine, power: int, first: bool = False) -> Axis:
    """Coefficient of m^power of one times the other on the axis, the other conjugate, or the first.

    One of both is free of m.
    """
    assert one.slope.is_zero() or other.slope.is_zero()
    if power == 0:
        left, right = even_odd(one.constant), even_odd(other.constant)
    elif one.slope.is_zero():
        left, right = even_odd(one.constant), even_odd(other.slope)
    else:
        left, right = even_odd(one.slope), even_odd(other.constant)
    return _times(_conjugate(left), right) if first else _times(left, _conjugate(right))


def _free(polynomial: fmpq_poly) -> Affine:
    return Affine(polynomial, fmpq_poly([0]))


def pair(given: Members, member: VertexModel, change: Changing) -> Pair | None:
    """The loop of a member with a gain that changes; None where it does not come to this form."""
    prototype, controller = given.prototype, given.prototype.controller
    assert controller is not None  # there are loops
    law = controller.sensed_law()
    plant = member.rig.plant(prototype.payload.inner_end_mass_kg, law.sensors)
    loop = rig_loop(member.rig, prototype.payload.inner_end_mass_kg, controller)
    opened = loop.loop_denominator
    if change.place == "volts":
        own = loop.loop_numerator + loop.added * fmpq(-1)
        closed = opened + loop.added + own * change.least
        if member.rig.sensor_rides:
            return None
        # between the volts and the controller there may be filters: what it hears over what the tip does
        hears = plant.control[0].constant / exact(prototype.sensor.gain_V_per_m)
        shared = hears.gcd(plant.displaced)
        above, below = hears / shared, plant.displaced / shared
        if any(not (part % below).is_zero() for part in (plant.denominator.constant, plant.denominator.slope)):
            return None
        rest = Affine(plant.denominator.constant / below, plant.denominator.slope / below)
        onto = _free(law.numerators[0] * above * change.most), _free(law.denominator * below)
        by = _free(shared * exact(prototype.sensor.gain_V_per_m)), rest
    else:
        w, damping = (exact(member.rig.figures[key]) for key in ("valve_frequency", "valve_damping_ratio"))
        spring = exact(member.frozen.get("valve_hysteresis", {}).get("spring", 0.0))
        spool = fmpq_poly([1 + spring, 2 * damping / w, 1 / (w * w)])
        parts = opened.constant, opened.slope
        if any(not (part % spool).is_zero() for part in parts):
            return None
        closed = opened + loop.loop_numerator * change.least
        onto = loop.loop_numerator * change.most, Affine(*(part / spool for part in parts))
        by = _free(fmpq_poly([1])), _free(spool)
    found = Pair(opened, closed, 1 - change.least / change.most, onto, by)
    one_free = all(
        one.slope.is_zero() or other.slope.is_zero()
        for one, other in ((found.onto[0], found.by[1]), (found.by[0], found.onto[1]))
    )
    return found if one_free and change.least > 0 else None


def unequal(given: Members) -> list[Changing]:
    """The sides of a piston as a gain that changes with the direction of the flow."""
    own = given.prototype.effects.keys()
    if "unequal_piston_areas" not in own or own & {"pressure_dependent_flow", "valve_deadband"}:
        return []
    span = given.found.gains["unequal_piston_areas"]
    return [Changing("unequal_piston_areas", "flow", exact(span.low), exact(span.high), "")]


def both_rows(given: Members) -> Iterator[Row]:
    """A row for each gain that changes while the current saturates."""
    current = tuple(name for name in IN_THE_CURRENT if name in given.prototype.effects) or IN_THE_CURRENT[:1]
    for change in (*changing(given), *unequal(given)):
        static = change.effect == "unequal_piston_areas"
        pairs = [pair(given, member, change) for member in given.found.members]
        known = [one for one in pairs if one is not None]
        presupposed = all(
            is_stable_over(one.opened, given.low, given.high) and is_proper(_looped(one), given.low, given.high)
            for one in known
        )
        found = search(known, given.low, given.high) if presupposed and len(known) == len(pairs) else None
        names = (*current, change.effect)
        if found is None:
            words = "Both at once: no multiplier was found; that does not say that the loop oscillates."
            yield Row(names, METHOD, False, words)
            continue
        multiplier, weight, margin = found
        statement = {
            "kind": "both",
            "loops": list(range(1, len(pairs) + 1)),
            "place": change.place,
            "gain": [text(change.least), text(change.most)],
            "weight": text(weight),
            "margin": text(margin),
        } | multiplier.table()
        where = "under any constant command and load" if static else "where there is no command and no load"
        how = "with the direction of the flow" if static else "in any way and at any rate"
        frozen = given.frozen(len(pairs), (change.effect,))
        between = f"{nearest(change.least):.4g} and {nearest(change.most):.4g}"
        words = (
            "Both at once: from every state the loop comes to rest with any static characteristic of slope 0 to 1 in"
            f" the current while its gain changes between {between} times its own {how}, {where}, for every payload"
            f" that stays{frozen}. M = {multiplier}, w = {text(weight)}."
        )
        yield Row(names, METHOD, True, words, None, statement)


def _looped(one: Pair) -> Loop:
    """What is around the loop with the gain at its least, as a loop."""
    nothing = fmpq_poly([0])
    return replace(Loop(one.opened, _free(nothing), nothing), loop_numerator=one.closed + one.opened * fmpq(-1))
