"""What is stated of loops that are not linear: that they come to rest, and how far errors move the tip.

"slope": cut at the law's current, or a motor's with what its drive feeds back, u = -L i + r and i = phi(u), phi static
and of a slope from 0 to 1. With M(s) = 1 - sum c h(s) + q s, kernels h = (a / (a + s))^k or (a / (a - s))^k, sum |c| <
1, q >= 0, L stable and falling off as 1/s or faster, and Re[M (1 + L)] above a positive margin at every frequency, the
loop comes to rest (Zames and Falb, 1968, with Popov's term); where a c is negative, only for an odd phi and at the
equilibrium without current.

"sector": cut at the sensor's volts or at the flow, and with a gain there that changes in any way between two factors,
the circle criterion: the loop is stable at the lower one, and Re[(1 + most L) / (1 + least L)] is above a margin.

"both": a characteristic in the current as of "slope" and a gain as of "sector" at once. With a = least / most, L_a the
loop at the least gain, F from what the gain gives at its most to the current's demand, H from the current to what the
gain acts on, and a weight w above zero, they come to rest where 4 w (Re[M (1 + L_a)] - margin) is at least the square
of |(1 - a) M F - w conj(H)| at every frequency (integral quadratic constraints of both, weighted and added up).

"deviation": an error of at most a size moves the tip by at most that times the integral of the absolute impulse
response from its place, see below.

Re[M (1 + L)] - margin over |M_d D|^2 is a quadratic in the mass. On pieces of the range its three Bernstein
coefficients, polynomials in w^2, are shown to be nowhere negative, which the prover does not look at.
"""

from collections.abc import Sequence
from typing import Any

from flint import acb_mat, acb_poly, arb, ctx, fmpq, fmpq_poly

from beamdesign.checker import roots
from beamdesign.checker.reading import Statements, Table, Unreadable, judged, short, span
from beamdesign.checker.rig import PLACES, Loop
from beamdesign.checker.roots import NONE, ONE, ZERO, Family, Pair, Polynomials, S, inner, plus, scaled
from beamdesign.checker.work import height, of_roots, spend

MOST_STATEMENTS = 16
HIGHEST_ORDER = 16
MOST_ORDERS = 192
"""Of the kernels of one multiplier together: order 8, causal and not, at each of the prover's twelve rates."""
DEEPEST = 20
"""Halvings of a range of masses: the less damping there is, the narrower the pieces are on which it is seen."""


def nonlinear(tables: Sequence[Table], loops: Sequence[Loop], masses: Pair) -> Statements:
    """Every statement about nonlinear loops: whether it was proved, and it or its failure in words."""
    if len(tables) > MOST_STATEMENTS:
        raise Unreadable(f"it states more than {MOST_STATEMENTS} things of nonlinear loops")
    for table in tables:
        numbers = [Table({"loop": k}, table.place).whole("loop", 1, len(loops)) for k in table.entries("loops")]
        if not numbers or sorted(set(numbers)) != numbers:
            raise Unreadable(f"{table.place_of('loops')} must be numbers of loops in their order")
        held, words = _STATED[table.word("kind", *_STATED)](table, [loops[k - 1] for k in numbers], masses)
        if len(numbers) < len(loops):
            words += f"; of loops {', '.join(map(str, numbers))} of {len(loops)} alone"
        yield held, words


class Multiplier:
    """M = above / below, and what the theorem asks of it.

    Attributes:
        above: numerator.
        below: denominator, without roots on the axis.
        odd: whether phi has to be odd.
        popov: the coefficient of s.
        words: its terms.
    """

    def __init__(self, table: Table) -> None:
        popov, terms = table.at_least("popov_s", 0), []
        for one in table.tables("term"):
            rate, order = one.at_least("rate_per_s", 0, above=True), one.whole("order", 1, HIGHEST_ORDER)
            terms.append((one.number("coefficient"), rate, order, one.flag("causal")))
        if not sum((abs(term[0]) for term in terms), NONE) < 1:
            raise Unreadable(
                f"{table.place}: the norm of the kernels is not below one, so that the theorem does not hold"
            )
        largest: dict[tuple[fmpq, bool], int] = {}
        for _, rate, order, causal in terms:
            key = rate, causal
            largest[key] = max(order, largest.get(key, 0))
        if sum(largest.values()) > MOST_ORDERS:
            raise Unreadable(f"{table.place}: its kernels are of a higher order together than {MOST_ORDERS}")
        spend(len(terms) * sum(largest.values()) ** 3 * max((height(rate) for rate, _ in largest), default=0) / 1_000)
        self.below = ONE
        for (rate, causal), order in largest.items():
            self.below *= _factor(rate, causal) ** order
        self.above = self.below * (1 + popov * S)
        for coefficient, rate, order, causal in terms:
            kernel = self.below / _factor(rate, causal) ** order
            self.above -= coefficient * rate**order * kernel
        self.rates = {rate: max(o for (r, _), o in largest.items() if r == rate) for rate, _ in largest}
        self.odd, self.popov = any(term[0] < 0 for term in terms), popov
        self.words = f"{len(terms)} kernels and {short(popov)} s"

    def weights(self) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly]:
        """2 A, A + s B and A - s B where M = (A + s B) / Q on the axis, A and B even and Q positive there."""
        positive = ONE
        for rate, order in self.rates.items():
            positive *= (_factor(rate, True) * _factor(rate, False)) ** order
        whole = positive / self.below * self.above
        mirrored = whole(-S)
        return whole + mirrored, whole, mirrored

    def characteristics(self, place: str = "law's current") -> str:
        """Which they are, in words, and about what the loop comes to rest."""
        which, where = ("an odd", "zero current") if self.odd else ("any", "every equilibrium")
        return f"comes to rest about {where} with {which} static characteristic of slope 0 to 1 in its {place}"


def _factor(rate: fmpq, causal: bool) -> fmpq_poly:
    return rate + S if causal else rate - S


def _slope(table: Table, loops: Sequence[Loop], masses: Pair) -> tuple[bool, str]:
    margin, multiplier = table.at_least("margin", 0, above=True), Multiplier(table)
    place = table.word("place", *PLACES) if "place" in table else "law"

    def fits(loop: Loop) -> bool:
        """Whether the theorem holds of it: stable without and with feedback, L falling off, and the real part."""
        denominator, closed = loop.cut(place)
        falls = max(p.degree() for p in plus(closed, denominator, -1)) < denominator[0].degree()
        stable = all(Family(*family).is_stable_over(*masses) for family in (denominator, closed))
        above, below = scaled(closed, multiplier.above), scaled(denominator, multiplier.below)
        return falls and stable and _real_part_above(above, below, margin, masses)

    words = f"{multiplier.characteristics(PLACES[place])}, {len(loops)} loops, margin {short(margin, up=False)}"
    return judged(all(map(fits, loops)), f"{words}: Zames and Falb's multiplier of {multiplier.words}")


def _real_part_above(
    above: Polynomials, below: Polynomials, margin: fmpq, masses: Pair, less: Polynomials = (ZERO, ZERO)
) -> bool:
    """Whether Re[above / below] is at least a margin, and |less / below|^2 where given, at every frequency and mass."""

    def value(one: fmpq, two: fmpq) -> fmpq_poly:
        """The polar form of the quadratic at two masses: at one mass twice, the quadratic itself."""
        (p, p_other), (o, o_other), (off, off_other) = (
            [constant + mass * slope for mass in (one, two)] for constant, slope in (above, below, less)
        )
        return inner(p, o_other) + inner(p_other, o) - 2 * margin * inner(o, o_other) - 2 * inner(off, off_other)

    def clear(low: fmpq, high: fmpq, left: int) -> bool:
        """On a piece at whose ends it is known, with so many halvings left."""
        if left == 0 or nowhere_negative(value(low, high)):
            return left > 0
        half = (low + high) / 2
        return nowhere_negative(value(half, half)) and clear(low, half, left - 1) and clear(half, high, left - 1)

    return all(nowhere_negative(value(mass, mass)) for mass in {*masses}) and clear(*masses, DEEPEST)


def nowhere_negative(polynomial: fmpq_poly) -> bool:
    """Whether a polynomial in w^2 is not negative from zero up."""
    if all(value >= 0 for value in polynomial.coeffs()):
        return True
    ends_well = polynomial.leading_coefficient() > 0 and polynomial(0) >= 0
    return ends_well and all(polynomial(x) >= 0 for x in roots.pieces([polynomial], NONE, roots.bound(polynomial))[0])


# Gains that change.


_WHOSE = {"volts": "sensor's", "flow": "valve's"}


def _sector(table: Table, loops: Sequence[Loop], masses: Pair) -> tuple[bool, str]:
    place, margin = table.word("place", *_WHOSE), table.at_least("margin", 0, above=True)
    factors = table.range("gain", least=0)

    def fits(loop: Loop) -> bool:
        """Whether the circle criterion holds of it, cut at the place."""
        denominator, numerator = loop.loop_denominator, loop.loop_numerator
        if place == "volts":  # what is fed back beside stays closed
            denominator, numerator = plus(loop.closed, loop.displacement, -1), loop.displacement
        low, high = (plus(denominator, numerator, g) for g in factors)
        falls = max(numerator[0].degree(), numerator[1].degree()) < denominator[0].degree()
        stable = falls and Family(*low).is_stable_over(*masses)
        return stable and _real_part_above(high, low, margin, masses)

    words = f"stable while the {_WHOSE[place]} gain changes in any way between {span(factors, ' and ')} times its own"
    proved = all(map(fits, loops))
    return judged(proved, f"{words}, {len(loops)} loops: circle criterion, margin {short(margin, up=False)}")


# Both at once.


def _both(table: Table, loops: Sequence[Loop], masses: Pair) -> tuple[bool, str]:
    place, factors, multiplier = table.word("place", *_WHOSE), table.range("gain", least=0), Multiplier(table)
    margin, weight = (table.at_least(key, 0, above=True) for key in ("margin", "weight"))
    least, most = factors
    if least == 0:
        raise Unreadable(f"{table.place_of('gain')} must be above zero")

    def fits(loop: Loop) -> bool:
        """Whether the inequality of both holds of it, and what that presupposes."""
        denominator, numerator, own = loop.loop_denominator, loop.loop_numerator, loop.displacement
        if place == "flow":
            own = numerator
            if any(divmod(part, loop.spool)[1] != 0 for part in denominator):
                raise Unreadable("the spool is not a part of this loop")
            onto, back = scaled(own, most * loop.spool(-S)), (denominator[0] / loop.spool, denominator[1] / loop.spool)
            slow = max(own[0].degree(), own[1].degree()) - back[0].degree()
        else:
            above, below = (one * other for one, other in zip(loop.law, loop.filters, strict=True))
            pairs = (own, above), (denominator, below)
            if any(divmod(part, factor)[1] != 0 for parts, factor in pairs for part in parts):
                raise Unreadable("the controller is not a part of this loop")
            onto = most * above * (denominator[0] / below)(-S), most * above * (denominator[1] / below)(-S)
            back = below * (own[0] / above)(-S), below * (own[1] / above)(-S)
            slow = above.degree() - below.degree()
        looped, turned = plus(numerator, own, least - 1), (1 - least / most) * multiplier.above
        falls = max(part.degree() for part in looped) < denominator[0].degree() and (slow < 0 or not multiplier.popov)
        less = plus(scaled(onto, turned), scaled(back, multiplier.below), -weight)
        stable = falls and Family(*denominator).is_stable_over(*masses)
        closed = scaled(plus(denominator, looped), 4 * weight * multiplier.above)
        opened = scaled(denominator, multiplier.below)
        return stable and _real_part_above(closed, opened, 4 * weight * margin, masses, less)

    proved = not multiplier.odd and all(map(fits, loops))
    words = (
        f"comes to rest with any static characteristic of slope 0 to 1 in its law's current while the {_WHOSE[place]}"
        f" gain changes between {span(factors, ' and ')} times its own, about zero current without command and load, or"
        f" under constant ones where that gain is static too, {len(loops)} loops, margin {short(margin, up=False)}"
    )
    return judged(proved, f"{words}: multiplier of {multiplier.words}, weight {short(weight)}")


# Errors that are bounded.


UNITS = {"current": "A in the current", "flow": "m3/s behind the spool", "volts": "V at the sensor",
         "stroke": "N between piston and cylinder", "nut": "N on the nut"}  # fmt: skip


def _deviation(table: Table, loops: Sequence[Loop], masses: Pair) -> tuple[bool, str]:
    count, listed = table.whole("pieces", 1, MOST_PIECES), []
    for one in table.tables("error"):
        place = one.word("place", *UNITS)
        listed.append((place, one.at_least("size", 0), one.at_least("bound_m", 0)))
    if not listed:
        raise Unreadable(f"{table.place} states no error")
    proved = True
    for loop in loops:
        if any(place not in loop.strayed for place, _, _ in listed):
            raise Unreadable(f"{table.place}: what such an error does to the tip is not known of this rig")
        if not Family(*loop.closed).is_stable_over(*masses):
            proved = False
            break
        units = integrals([loop.strayed[place] for place, _, _ in listed], loop.closed, masses, count)
        proved = proved and all(unit * size <= bound for unit, (_, size, bound) in zip(units, listed, strict=True))
    each = " and ".join(
        f"{short(bound, up=True)} m by errors of at most {short(size, up=False)} {UNITS[place]}"
        for place, size, bound in listed
    )
    words = f"the tip strays from the linear response at its own gain by at most {each}, {len(loops)} loops"
    return judged(proved, words)


# Upper bounds of integrals of absolute impulse responses over a range of masses, in balls.
#
# A response is a sum of exponentials. Over a step from t to t + h it is its value and slope at t to within h^2 / 2
# times what bounds its second derivative, so that its integral is at most that of the straight line and h^3 / 6 times
# that bound; the step follows the response as it dies down. What is left at the end counts without regard to signs.
# From a mass M to m, p = p0 + m p1 multiplies the response by 1 / (1 + (m - M) p1 / p(M)), whose terms are bounded
# alike.


MOST_PIECES = 2000
MOST_STEPS = 4_000_000
"""Of all pieces together."""
LEFT = fmpq(1, 500)
"""At the end, over what has been summed up."""
FINE = fmpq(1, 200)
"""Of a step, what the second derivative may add over the absolute exponentials; made less while it adds up to more than
a share of the whole."""
MOST_BENT = fmpq(1, 100)
SHORTEST = fmpq(1, 2**40)
PRECISION_BITS = 96
AT_ONCE = 16
"""Steps of one length."""


def integrals(numerators: Sequence[fmpq_poly], closed: Polynomials, masses: Pair, pieces: int) -> list[fmpq]:
    """For each numerator a bound of the absolute integral of numerator / (p0 + m p1) at every mass of a range.

    Raises:
        Unreadable: where a piece of the range is too long, or the responses too slow.
    """
    reach = (masses[1] - masses[0]) / (2 * pieces)
    found, steps = [fmpq(0) for _ in numerators], MOST_STEPS
    for k in range(pieces):
        at = closed[0] + (masses[0] + (2 * k + 1) * reach) * closed[1]
        with ctx.workprec(PRECISION_BITS):
            response = _Response([*numerators, closed[1]], at)
            *own, share = response.integrals(steps)
        steps -= response.steps
        if (left := 1 - reach * share) <= 0:
            raise Unreadable("a piece of the masses is too long to say anything of all of it")
        found = [max(one, other / left) for one, other in zip(found, own, strict=True)]
    return found


class _Response:
    """Impulse responses of several numerators over one denominator.

    Attributes:
        steps: that were needed.
    """

    def __init__(self, numerators: Sequence[fmpq_poly], denominator: fmpq_poly) -> None:
        self.steps, degree = 0, denominator.degree()
        if max(one.degree() for one in numerators) > degree:
            raise Unreadable("an error that is differentiated")
        self._straight = [abs(arb(one[degree] / denominator[degree])) for one in numerators]
        spend(of_roots(denominator))
        found: list[Any] = denominator.complex_roots()
        if any(count > 1 or not root.real < 0 for root, count in found):
            raise Unreadable("poles that coincide, or are not stable")
        self._poles = poles = [root for root, _ in found if not root.imag < 0]
        shares = [(1 if pole.imag == 0 else 2) / acb_poly(denominator.derivative())(pole) for pole in poles]
        # at a root the part that passes straight through adds nothing
        self._weights = [[acb_poly(one)(p) * by for p, by in zip(poles, shares, strict=True)] for one in numerators]

    def integrals(self, most: int) -> list[fmpq]:
        """Bounds of the absolute integrals, what passes straight through included."""
        fine = FINE
        while True:
            sums, bent = self._summed(fine, most)
            if all(bool(off <= total * arb(MOST_BENT)) for off, total in zip(bent, sums, strict=True)):
                whole = (a + b + c for a, b, c in zip(sums, bent, self._straight, strict=True))
                return [roots.ends(one)[1] for one in whole]
            fine /= 4

    def _summed(self, fine: fmpq, most: int) -> tuple[list[arb], list[arb]]:
        """Sums over straight lines, with what is left at the end, and what the bends may add."""
        count, poles = len(self._poles), self._poles
        shown = acb_mat([w for row in self._weights for w in (row, [a * p for a, p in zip(row, poles, strict=True)])])
        sizes = [[abs(a) for a in row] for row in self._weights]
        bends = [[size * abs(p) ** 2 for size, p in zip(row, poles, strict=True)] for row in sizes]
        sums, bent, time = [arb(0) for _ in sizes], [arb(0) for _ in sizes], fmpq(0)
        while True:
            now = [(p * arb(time)).exp() for p in poles]
            fallen = [abs(one) for one in now]
            size = [_along(row, fallen) for row in sizes]
            left = [_along(row, [f / abs(p.real) for f, p in zip(fallen, poles, strict=True)]) for row in sizes]
            if time > 0 and all(bool(a <= s * arb(LEFT)) for a, s in zip(left, sums, strict=True)):
                return [a + b for a, b in zip(sums, left, strict=True)], bent
            bend, step = [_along(row, fallen) for row in bends], fmpq(1)
            while not all(bool(b * arb(step * step / 6) <= a * arb(fine)) for a, b in zip(size, bend, strict=True)):
                step /= 2
                if step < SHORTEST:
                    raise Unreadable("the responses are too fast to be summed up")
            spend(50 + 15 * count + AT_ONCE * (len(sums) * (5 + count / 2) + count) / 2)
            turned = [(p * arb(step)).exp() for p in poles]
            for _ in range(AT_ONCE):
                values = shown * acb_mat(count, 1, now)
                for k in range(len(sums)):
                    sums[k] += _straight_line(values[2 * k, 0].real, values[2 * k + 1, 0].real, step)
                now = [a * b for a, b in zip(now, turned, strict=True)]
            bent = [total + one * arb(AT_ONCE * step**3 / 6) for total, one in zip(bent, bend, strict=True)]
            time += AT_ONCE * step
            self.steps += AT_ONCE
            if self.steps > most:
                raise Unreadable("the responses are too slow to be summed up")


def _along(one: Sequence[arb], other: Sequence[arb]) -> arb:
    return sum((a * b for a, b in zip(one, other, strict=True)), arb(0))


def _straight_line(start: arb, slope: arb, step: fmpq) -> arb:
    """A bound of the integral of |start + slope u| over u from none to a step."""
    end = start + slope * arb(step)
    a, b = abs(start), abs(end)
    return ((a * a + b * b) / (a + b) if start * end < 0 else a + b) * arb(step / 2)


_STATED = {"slope": _slope, "sector": _sector, "both": _both, "deviation": _deviation}
