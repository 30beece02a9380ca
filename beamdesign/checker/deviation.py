"""How far an error that never exceeds a size moves the tip of every member of a box, as a certificate states it.

It moves it by at most its size times the integral of |g|, g being the impulse response from its place. Where all poles
lie left of -a, that integral is at most sqrt(I / (2 a)), I being the integral of (g exp(a t))^2, which by Parseval is
that of |G(j w - a)|^2 over w from zero over pi (Cauchy and Schwarz; Dahleh and Diaz-Bobillo, 1995, section 2.2).

Stated are bands of frequency and in each a limit of |(j w + c) G(j w - a)|. With G = n / p it is reached where p + u (j
w + c) n vanishes at j w - a for some u of the size 1 / limit. Box, band and circle being connected, what reaches it
nowhere stays below where it is below at one member and frequency. As it is infinite nowhere, no member has a pole on
the line at -a, and all have theirs left of it where one has.

A force on the stroke is worth the flow (Q / A + A s / K) F behind the spool. At j w - a this is no larger than that of
`lead`, r + t j w, which has the largest of either part; then n is that of the flow times r + t j w.
"""

from collections.abc import Mapping
from itertools import pairwise

from flint import acb, arb, ctx, fmpq, fmpq_mpoly

from beamdesign.checker.box_loop import alike, at_member, characteristic, figures, words_of
from beamdesign.checker.expressions import Circle, Expression
from beamdesign.checker.nonlinear import UNITS
from beamdesign.checker.reading import Table, Unreadable, judged, short
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import Pair, ends, is_hurwitz
from beamdesign.checker.zero_exclusion import PRECISION_BITS, walked

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
        self.marks = [[mark for line in one.words("tree") for mark in line.split()] for one in bands]
        own = (f" with {name} {words_of(self.expression.ranges[name])}" for name in sorted(self.expression.own.keys))
        self.words = (
            f"an error of at most {short(self.size)} {UNITS[self.place]} moves the tip by at most {short(self.bound)} m"
            f" for every member of the box{' and'.join(own)}"
        )

    def proved(self, rig: Rig | None, member: Mapping[str, fmpq]) -> tuple[bool, str]:
        """Whether it is, and it in words."""
        expression, ranges = self.expression, self.expression.ranges
        if expression.delay is not None or any(ranges.get("delay", ())):
            return False, f"{self.words}: of a loop with a delay"
        if any(not self.whole[n][0] <= ranges[n][0] <= ranges[n][1] <= self.whole[n][1] for n in expression.own.keys):
            return False, f"{self.words}: over ranges of its own that are not within the box"
        moved = None if rig is None else self._moved(rig)
        if moved is None or not alike(expression, moved := self._left(moved)):
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
        for since, until, limit, marks in zip(
            self.edges, [*self.edges[1:], None], self.limits, self.marks, strict=True
        ):
            expression.circle = Circle(fmpq(0), 1 / limit)
            with ctx.workprec(PRECISION_BITS):
                without, with_it = (expression.value(member, fmpq(u), acb(0, arb(since))) for u in (0, 1))
                if not abs(with_it - without) < limit * abs(without):
                    return False, f"{self.words}: not at the member at {short(since)} rad/s"
            for where, settled in walked(expression, marks, since, until):
                count += 1
                if not settled:
                    return False, f"{self.words}: piece {count}, {where}, is not seen to be clear"
        return judged(True, f"{self.words}: {len(self.limits)} bands, {count} pieces")

    def _moved(self, rig: Rig) -> fmpq_mpoly | None:
        """The rig's polynomial with the unknown, before it is moved; None where the lead is not large enough."""
        stated, ranges = self.expression, self.expression.ranges

        def of(place: str) -> fmpq_mpoly:
            return characteristic(stated, rig, KIND, None, (place, self.corner + self.decay))

        if not self.lead:
            return of(self.place)
        force, flow = of(self.place), of("flow")
        plain = flow.subs({"unknown": fmpq(0)})
        ends = {name: ranges.get(name, (value, value)) for name, value in figures(rig).items()}
        variable = dict(zip(force.context().names(), force.context().gens(), strict=True))
        leakage, area, oil = (variable.get(name, ends[name][0]) for name in _STROKE)
        s, (r, t), ((least, most), (small, large), (soft, _)) = variable["s"], self.lead, (ends[n] for n in _STROKE)
        if (force - plain) * (area * oil) != (flow - plain) * (leakage * oil + area**2 * s):
            return None
        if r < max(most / small, self.decay * large / soft - least / large) or t < large / soft:
            return None
        return plain + (flow - plain) * (r + t * (s + self.decay))

    def _left(self, polynomial: fmpq_mpoly) -> fmpq_mpoly:
        """A polynomial at s - a, s being the first variable."""
        s, *others = polynomial.context().gens()
        return polynomial.compose(s - self.decay, *others, ctx=polynomial.context())
