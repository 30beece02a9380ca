"""What a certificate over a box of parameters states: ranges, one member, and a tree that leaves no room for a root.

All members of the box are stable where one is, and no root can cross the axis (zero exclusion). Of a rig, the
polynomial that is looked at is that of its loop; of an expression alone nothing is said of any rig.
"""

from collections.abc import Mapping
from itertools import pairwise

from flint import acb, arb, ctx, fmpq, fmpq_mpoly

from beamdesign.checker.box_loop import alike, at_member, characteristic, figures, of_rig, opens_stable, spans, words_of
from beamdesign.checker.expressions import Circle, Expression
from beamdesign.checker.nonlinear import UNITS, Multiplier
from beamdesign.checker.reading import Statements, Table, Unreadable, judged, short, span
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import ONE, ZERO, Pair, S, ends, is_hurwitz, unstable_roots
from beamdesign.checker.zero_exclusion import PRECISION_BITS, walked

MASS = "outer_end_mass"
"""Of which a claim may be about a part of the box: a law performs over its own payloads and is stable with others."""


# What the certificate states.


def statements(table: Table, rig: Rig | None) -> Statements:
    """Every statement of a certificate over a box: whether it was proved, and it in words.

    Args:
        table: the certificate.
        rig: that it states; None for one of an expression alone.
    """
    expression = Expression(table)
    given = table.table("member")
    member = {name: given.number(name) for name in given.keys}
    stable = table.flag("stable")
    marks = [mark for line in table.words("tree") for mark in line.split()] if stable else []
    claims = [
        (Deviation if stated.word("kind", *CLAIMS, KIND) == KIND else Claim)(stated, table, expression.ranges)
        for stated in table.tables("claim")
    ]
    if rig is None:
        for name, (low, high) in expression.ranges.items():
            yield True, f"{name} from {span((low, high))}"
    else:
        yield from of_rig(table, expression, rig)
    inside = member.keys() == expression.ranges.keys() and all(
        low <= member[name] <= high for name, (low, high) in expression.ranges.items()
    )
    yield judged(inside, "the member lies in the box")
    if not inside:
        return
    at = ", ".join(f"{name} {short(member[name])}" for name, (low, high) in expression.ranges.items() if low < high)
    found = is_stable(expression, member)
    yield judged(found is stable, f"the member is {'' if stable else 'not '}stable: at {at or 'the only one'}")
    if found is not True or not stable:
        yield from ((False, f"{claim.words}: of a box that is not stable") for claim in claims)
        return
    count, where = walked(expression, marks)
    if where:
        yield False, f"piece {count + 1}, {where}, is not seen to be free of roots"
        return
    yield True, f"stable for every member of the box: {count} pieces free of roots on the axis"
    for claim in claims:
        yield claim.proved(rig, member)


CLAIMS = {
    "peak_sensitivity": "peak sensitivity max |1/(1+L)| below {}",
    "compliance": "compliance |x/F_d| below {} m/N {}",
    "peak_compliance": "compliance |x/F_d| below {} m/N {}",
    "loop_gain": "loop gain |L| below {} {}",
    "controller_effort": "controller effort |C/(1+L)| below {} A/V",
    "gain_margin": "stable with the gain times every number from {} to 1",
    "slope": "",
}
"""A magnitude |a / p| that is to stay below a limit, in words.

It reaches it where p + u a vanishes for some u of the size 1 / limit. Of S, where a is p less the loop's numerator N,
that is where p + (g - 1) N does for g = 1 / (1 + u), which goes around the circle over the real axis from
limit / (limit + 1) to limit / (limit - 1). Box, frequencies and circle being connected, a magnitude that reaches its
limit nowhere stays below it everywhere, if it does without motion at one member; and |L| as the leading coefficient
outweighs all others at the highest frequencies. A gain margin is stability over a box with a range of the gain.

A slope is what `beamdesign.checker.nonlinear` has under that name, without Popov's term: with D opened, N the loop's
numerator and M = (A + s B) / Q, 2 A D + ((A + s B) + u (A - s B)) N vanishes for no u of the size one. As 4 A Q |D|^2
Re[M (1 + L)] is the difference of the squared sizes of what is without u and what is with it, that is positive at every
frequency, as it is at the highest ones, where L vanishes. For one u what multiplies N vanishes, so that D has no root
on the axis. Of gains the largest is enough: less is a lower slope.
"""


class Claim:
    """One claim about every member of the box, as it is stated."""

    def __init__(self, stated: Table, table: Table, whole: Mapping[str, Pair]) -> None:
        self.kind = stated.word("kind", *CLAIMS)
        limit = stated.at_least("limit", 0, above=self.kind != "gain_margin")
        if self.kind == "peak_sensitivity" and limit <= 1:
            raise Unreadable("no loop has a peak sensitivity of one or less")
        self.since, self.until, above = fmpq(0), None, "at every frequency"
        if self.kind == "compliance" and "bandwidth_Hz" in stated:
            bandwidth = stated.at_least("bandwidth_Hz", 0, above=True)
            self.until, above = bandwidth * _OVER_TURN, f"up to {short(bandwidth, up=False)} Hz"
        if self.kind == "loop_gain":
            start = stated.at_least("from_Hz", 0)
            self.since, above = start * _UNDER_TURN, f"from {short(start, up=True)} Hz up"
        self.words, self.multiplier = CLAIMS[self.kind].format(short(limit, up=True), above), None
        if self.kind == "slope":
            self.multiplier = Multiplier(stated)
            if limit != 1 or self.multiplier.popov:
                raise Unreadable("over a box a slope is up to one, with a multiplier without Popov's term")
            words = f"{self.multiplier.characteristics()}: Zames and Falb's multiplier of {self.multiplier.words}"
            self.words = words.removesuffix(" and 0 s")
        circle = None
        if self.kind == "peak_sensitivity":
            circle = Circle(*(one / (limit * limit - 1) for one in (limit * limit, limit)))
        elif self.kind != "gain_margin":
            circle = Circle(fmpq(0), 1 / limit)  # 1 of a slope
        self.expression = Expression(stated, table, circle)
        self.marks = [mark for line in stated.words("tree") for mark in line.split()]
        self.limit, self.whole = limit, whole
        own = (n for n in sorted(self.expression.own.keys) if n != "controller_gain")
        self.of_masses = " and".join(f" with {n} {words_of(self.expression.ranges[n])}" for n in own)

    def _covers(self, rig: Rig) -> bool:
        """Whether ranges of its own hold the gains claimed, and of effects all at which performance is asked.

        Of the outer end mass they may be less than the box, which is stated.
        """
        own, asked = {*self.expression.own.keys}, spans(rig, performing=True)
        if self.kind == "gain_margin":
            low, high = self.whole.get("controller_gain", (fmpq(-1), fmpq(0)))
            asked = {"controller_gain": (low * self.limit, high)}
            if not 0 <= self.limit <= 1 or low < 0 or "controller_gain" not in own:
                return False
        if self.kind == "slope":
            gains = (name for name in ("controller_gain", "effect_gain") if name in self.whole)
            asked = {name: (self.whole[name][1],) * 2 for name in gains if self.whole[name][0] >= 0}
        ranges = self.expression.ranges
        if MASS in own:  # the claim is said to be about these alone
            own -= {MASS}
            if not self.whole[MASS][0] <= ranges[MASS][0] <= ranges[MASS][1] <= self.whole[MASS][1]:
                return False
        return all(n in asked and ranges[n][0] <= asked[n][0] and asked[n][1] <= ranges[n][1] for n in own)

    def proved(self, rig: Rig | None, member: Mapping[str, fmpq]) -> tuple[bool, str]:
        """Whether it is, and it in words."""
        waits = any(self.expression.ranges.get("delay", ()))
        if self.expression.delay != "delay" and (waits or self.expression.delay is not None):
            return False, f"{self.words}: of a loop with another delay"
        weights = () if self.multiplier is None else self.multiplier.weights()
        if rig is None or not alike(self.expression, characteristic(self.expression, rig, self.kind, weights)):
            return False, f"{self.words}: the expression is not that of a rig's loop"
        if not self._covers(rig):
            return False, f"{self.words}: over ranges of its own that are not those of what is claimed"
        ranges = self.expression.ranges
        member = {name: min(max(value, ranges[name][0]), ranges[name][1]) for name, value in member.items()}
        if self.kind == "gain_margin":
            if is_stable(self.expression, member) is not True:
                return False, f"{self.words}: the member is not seen to be stable"
        elif self.kind == "slope" and not opens_stable(self.expression, rig, member):
            return False, f"{self.words}: the member is not stable when opened, or its loop does not fall off"
        elif self.kind != "loop_gain" and not _below(self.expression, member):
            return False, f"{self.words}: not without motion at the member"
        count, where = walked(self.expression, self.marks, self.since, self.until)
        if where:
            return False, f"{self.words}: piece {count + 1}, {where}, is not seen to be clear"
        return True, f"{self.words} for every member of the box{self.of_masses}: {count} pieces"


_UNDER_TURN, _OVER_TURN = fmpq(333, 53), fmpq(710, 113)
"""Somewhat below and above 2 pi: 333/106 is below pi and 355/113 above."""


def _below(expression: Expression, member: Mapping[str, fmpq]) -> bool:
    """Whether p without motion vanishes only for unknowns outside of the circle, at one member without delay."""
    at_zero = [expression.value(member, fmpq(unknown)) for unknown in (0, 1)]
    centre, radius = expression.circle or (fmpq(0), fmpq(0))
    slope = at_zero[1] - at_zero[0]
    return bool(abs(at_zero[0] + centre * slope) > radius * abs(slope))


def is_stable(expression: Expression, member: dict[str, fmpq]) -> bool | None:
    """Whether a member has all roots that the others have, in the open left half plane; None where that is not seen."""
    plain, late, delay = expression.member(member)
    if delay == 0:
        plain, late = plain + late, ZERO
    if plain.degree() < expression.degree:
        return False  # a root passes through infinity
    if late == 0:
        return is_hurwitz(plain)
    if late.degree() >= plain.degree():
        return None
    count = unstable_roots(plain, late, delay)
    return None if count is None else count == 0


# How far an error that never exceeds a size moves the tip of every member of a box, as a certificate states it.
#
# It moves it by at most its size times the integral of |g|, g being the impulse response from its place. Where all
# poles lie left of -a, that integral is at most sqrt(I / (2 a)), I being the integral of (g exp(a t))^2, which by
# Parseval is that of |G(j w - a)|^2 over w from zero over pi (Cauchy and Schwarz; Dahleh and Diaz-Bobillo, 1995,
# section 2.2).
#
# Stated are bands of frequency and in each a limit of |(j w + c) G(j w - a)|. With G = n / p it is reached where p + u
# (j w + c) n vanishes at j w - a for some u of the size 1 / limit. Box, band and circle being connected, what reaches
# it nowhere stays below where it is below at one member and frequency. As it is infinite nowhere, no member has a pole
# on the line at -a, and all have theirs left of it where one has.
#
# A force on the stroke is worth the flow (Q / A + A s / K) F behind the spool. At j w - a this is no larger than that
# of `lead`, r + t j w, which has the largest of either part; then n is that of the flow times r + t j w.


KIND = "deviation"
MOST_BANDS = 200
_STROKE = "leakage", "piston_area", "oil_stiffness"


class Deviation:
    """One such statement."""

    def __init__(self, stated: Table, table: Table, whole: Mapping[str, Pair]) -> None:
        self.place, self.whole = stated.word("place", *UNITS), whole
        self.size, self.bound = stated.at_least("size", 0), stated.at_least("limit", 0)
        self.decay, self.corner = (stated.at_least(key, 0, above=True) for key in ("decay_per_s", "corner_rad_per_s"))
        self.lead = stated.numbers("lead", 2) if self.place == "stroke" else []
        self.expression = Expression(stated, table, Circle(fmpq(0), fmpq(1)))
        bands = stated.tables("band")
        if not 0 < len(bands) <= MOST_BANDS or any("until_rad_per_s" in one for one in bands[-1:]):
            raise Unreadable(f"{stated.place}: its bands must end with one without end, and be {MOST_BANDS} at most")
        untils = [one.at_least("until_rad_per_s", 0, above=True) for one in bands[:-1]]
        self.edges = [fmpq(0), *untils]
        if any(not a < b for a, b in pairwise(self.edges)):
            raise Unreadable(f"{stated.place}: its bands must ascend")
        self.limits = [one.at_least("limit", 0, above=True) for one in bands]
        self.trees = [[mark for line in one.words("tree") for mark in line.split()] for one in bands]
        own = (f" with {name} {words_of(self.expression.ranges[name])}" for name in sorted(self.expression.own.keys))
        self.words = (
            f"an error of at most {short(self.size, up=False)} {UNITS[self.place]} moves the tip by at most"
            f" {short(self.bound, up=True)} m for every member of the box{' and'.join(own)}"
        )

    def proved(self, rig: Rig | None, member: Mapping[str, fmpq]) -> tuple[bool, str]:
        """Whether it is, and it in words."""
        expression, ranges = self.expression, self.expression.ranges
        if expression.delay is not None or any(ranges.get("delay", ())):
            return False, f"{self.words}: of a loop with a delay"
        if any(not self.whole[n][0] <= ranges[n][0] <= ranges[n][1] <= self.whole[n][1] for n in expression.own.keys):
            return False, f"{self.words}: over ranges of its own that are not within the box"
        moved = None if rig is None else self._moved(rig)
        if moved is None or not alike(expression, moved):
            return False, f"{self.words}: the expression is not that of a rig's loop"
        member = {name: min(max(value, ranges[name][0]), ranges[name][1]) for name, value in member.items()}
        if not is_hurwitz(at_member(moved.subs({"unknown": fmpq(0)}), member)):
            return False, f"{self.words}: the member decays more slowly than {short(self.decay)} 1/s"
        with ctx.workprec(PRECISION_BITS):
            angles = [*(arb(edge / self.corner).atan() for edge in self.edges), arb.pi() / 2]
            parts = (limit**2 * (b - a) for limit, (a, b) in zip(self.limits, pairwise(angles), strict=True))
            integral = sum(parts, arb(0)) / (2 * arb.pi() * self.decay * self.corner)
            if not ends(self.size * integral.sqrt())[1] <= self.bound:
                return False, f"{self.words}: its limits come to more"
        count = 0
        for since, until, limit, tree in zip(self.edges, [*self.edges[1:], None], self.limits, self.trees, strict=True):
            expression.circle = Circle(fmpq(0), 1 / limit)
            with ctx.workprec(PRECISION_BITS):
                without, with_it = (expression.value(member, fmpq(u), acb(0, arb(since))) for u in (0, 1))
                if not abs(with_it - without) < limit * abs(without):
                    return False, f"{self.words}: not at the member at {short(since)} rad/s"
            clear, where = walked(expression, tree, since, until)
            count += clear
            if where:
                return False, f"{self.words}: piece {count + 1}, {where}, is not seen to be clear"
        return judged(True, f"{self.words}: {len(self.limits)} bands, {count} pieces")

    def _moved(self, rig: Rig) -> fmpq_mpoly | None:
        """The rig's polynomial with the unknown at s - a; None where the lead is not large enough."""
        stated, ranges = self.expression, self.expression.ranges

        def of(place: str) -> fmpq_mpoly:
            whole = characteristic(stated, rig, KIND, (ONE, ONE, S + self.corner + self.decay), place)
            s, *others = whole.context().gens()
            return whole.compose(s - self.decay, *others, ctx=whole.context())

        if not self.lead:
            return of(self.place)
        force, flow = of(self.place), of("flow")
        plain = flow.subs({"unknown": fmpq(0)})
        ends = {name: ranges.get(name, (value, value)) for name, value in figures(rig).items()}
        variable = dict(zip(force.context().names(), force.context().gens(), strict=True))
        leakage, area, oil = (variable.get(name, ends[name][0]) for name in _STROKE)
        s, (r, t), ((least, most), (small, large), (soft, _)) = variable["s"], self.lead, (ends[n] for n in _STROKE)
        if (force - plain) * (area * oil) != (flow - plain) * (leakage * oil + area**2 * (s - self.decay)):
            return None
        if r < max(most / small, self.decay * large / soft - least / large) or t < large / soft:
            return None
        return plain + (flow - plain) * (r + t * s)
