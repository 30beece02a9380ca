"""Stability and performance over a range of outer end masses, of every loop that the rig's effects allow.

Stability is settled in the mass: the real roots of the last but one Hurwitz determinant are isolated, and between two
of them one loop is put to the Routh test. Inequalities are settled by cutting the frequency axis at every sign change
of everything that decides them. Where the gain varies, the sides of the rectangle of mass and gain decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from flint import fmpq, fmpq_poly

from beamdesign.checker.inequalities import INEQUALITIES, Bound, Slack, magnitudes
from beamdesign.checker.ranges import Statements, agrees, stability
from beamdesign.checker.reading import MOST_WORK, Table, Unreadable, short
from beamdesign.checker.rig import ONCE, Loop, Rig
from beamdesign.checker.roots import Pair, S
from beamdesign.checker.stability import Family, stable_on_rectangle


def statements(table: Table, rig: Rig) -> Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    masses = table.range("outer_end_mass_kg", least=0)
    members = [Member(loop) for loop in rig.loops()]
    same = _same(table.tables("loop"), [member.loop for member in members])
    yield same, f"the polynomials {'are' if same else 'are not'} those of the rig and its elements"
    if not any(member.loop.performing for member in members):
        raise Unreadable("no combination of the ends of the spans is to perform")
    claims = table.tables("claim")
    degree = max(p.degree() for member in members for p in member.loop.closed)
    if (work := len(members) * (1 + len(claims)) * degree**5) > MOST_WORK:
        raise Unreadable(f"{len(members)} loops of degree {degree} with {len(claims)} claims are too much work: {work}")
    stated, alone = table.table("stability"), members[0] if len(members) == 1 else None
    if alone is not None and alone.loop.gain[0] == alone.loop.gain[1]:
        yield from stability(stated, Family(*alone.at(alone.loop.gain[0])), *masses)
        whole = alone.is_stable_over(masses)
    else:
        whole = all(member.is_stable_over(masses) for member in members)
        for part in stated.tables("range"):
            ends = part.number("low"), part.number("high")
            words = f"stable from {short(ends[0])} to {short(ends[1])} kg"
            inside = masses[0] <= ends[0] <= ends[1] <= masses[1]
            proved = inside and all(member.is_stable_over(ends) for member in members)
            yield proved, words if proved else f"not proved: {words}"
        yield agrees(stated, "stable", whole)
    for claim in claims:
        yield _claim(claim, members, whole, masses)


def _same(stated: Sequence[Table], loops: Sequence[Loop]) -> bool:
    """Whether the polynomials stated are those of the loops, of each but for one common positive factor.

    Whoever wrote them has them from the effects' laws, and not from the elements.
    """
    names = ("p0", "p1", "returned", "returned_slope", "disturbance")
    found = [[table.polynomial(name) for name in names] for table in stated]
    return len(found) == len(loops) and all(map(_proportional, found, loops))


def _proportional(stated: Sequence[fmpq_poly], loop: Loop) -> bool:
    own = (*loop.closed, *loop.returned, loop.disturbance)
    lead = own[1].degree()
    factor = stated[1][lead] / own[1][lead]
    return factor > 0 and all(one * factor == other for one, other in zip(own, stated, strict=True))


@dataclass(frozen=True)
class Member:
    """A loop over the rectangle of masses and gains."""

    loop: Loop

    def at(self, gain: fmpq) -> tuple[fmpq_poly, fmpq_poly]:
        """Its characteristic polynomial at one gain, constant and slope in the mass."""
        opened, returned = self.loop.opened, self.loop.returned
        return opened[0] + gain * returned[0], opened[1] + gain * returned[1]

    def is_stable_over(self, masses: Pair, s: fmpq_poly = S, times: Pair = ONCE) -> bool:
        """Whether it is stable on the rectangle, with s replaced, its gains also times any factor of a range."""
        opened, returned = ((p[0](s), p[1](s)) for p in (self.loop.opened, self.loop.returned))
        gain = self.loop.gain
        return stable_on_rectangle(opened, returned, masses, (gain[0] * times[0], gain[1] * times[1]))

    def _slack(self, bound: Bound, gain: fmpq) -> Slack:
        loop = self.loop
        returned = gain * loop.returned[0], gain * loop.returned[1]
        return Slack(bound.limit, *magnitudes(bound.kind, loop.opened, returned, loop.disturbance, loop.law))

    def keeps(self, bound: Bound, masses: Pair) -> bool:
        """Whether an inequality holds on the rectangle: on its sides, on which both magnitudes are least."""
        gains = self.loop.performing
        if gains is None:
            return True
        over_mass = {gains[1]} if bound.kind == "loop_gain" else set(gains)  # a loop gain grows with the factor
        if not all(self._slack(bound, gain).nonnegative(*masses, bound.until, bound.start) for gain in over_mass):
            return False
        if bound.kind == "loop_gain" or gains[0] == gains[1]:
            return True
        opened, returned = self.loop.opened, self.loop.returned
        if returned[1] != 0:
            raise Unreadable("mass and gain multiply each other, so that sides do not decide what is to be performed")
        none = fmpq_poly([0])
        for mass in {*masses}:
            at = opened[0] + mass * opened[1]
            (_, _), top = magnitudes(bound.kind, (at, none), (none, none), self.loop.disturbance, self.loop.law)
            if not Slack(bound.limit, (at, returned[0]), top).nonnegative(*gains, bound.until, bound.start):
                return False
        return True

    def breaks(self, bound: Bound, mass: fmpq, square: fmpq, gain: fmpq) -> bool:
        """Whether an inequality fails at one mass, w^2 and gain at which it is to perform."""
        gains = self.loop.performing
        return gains is not None and gains[0] <= gain <= gains[1] and self._slack(bound, gain).at(mass, square) < 0


def _claim(claim: Table, members: Sequence[Member], whole: bool, masses: Pair) -> tuple[bool, str]:
    """One claim about all members: it holds if it says so, and fails, at its witness if it has one, if it says so."""
    kind, holds = claim.word("kind", *INEQUALITIES, "decay_rate", "gain_margin"), claim.flag("holds")
    witness = claim.optional("witness")
    at_witness, mass, gain = False, fmpq(0), fmpq(1)
    if witness.keys:
        mass = witness.number("outer_end_mass_kg")
        gain = witness.number("gain_factor") if "gain_factor" in witness else gain
        at_witness = masses[0] <= mass <= masses[1]

    def unstable(s: fmpq_poly = S, least: fmpq = gain, most: fmpq = gain) -> bool:
        """Whether some member is not stable at the witness, its factor being one of those claimed."""
        return any(
            member.loop.gain[0] * least <= gain <= member.loop.gain[1] * most
            and not Family(*(p(s) for p in member.at(gain))).is_stable(mass)
            for member in members
        )

    if kind in INEQUALITIES:
        bound = Bound(claim, kind)
        words, truth = bound.words, whole and all(member.keeps(bound, masses) for member in members)
        if "squared_frequency" in witness:
            square = witness.at_least("squared_frequency", 0)
            broken = any(member.breaks(bound, mass, square, gain) for member in members)
            at_witness = at_witness and bound.covers(square) and broken
        else:
            at_witness = at_witness and unstable()
    else:
        limit = claim.at_least("limit", 0, above=True)
        if kind == "decay_rate":
            words = f"every pole decays faster than {short(limit)} 1/s"
            truth = all(member.is_stable_over(masses, S - limit) for member in members)
            at_witness = at_witness and unstable(S - limit)
        else:
            words = f"stable with the gain times every number from 1 to {short(limit)}"
            times = min(limit, fmpq(1)), max(limit, fmpq(1))
            truth = all(member.is_stable_over(masses, times=times) for member in members)
            at_witness = at_witness and unstable(least=times[0], most=times[1])
    if witness.keys and (holds or not at_witness):
        return False, f"the witness does not refute: {words}"
    if truth is not holds:
        return False, f"{'not proved' if holds else 'holds after all'}: {words}"
    return True, words if holds else f"refuted: {words}"
