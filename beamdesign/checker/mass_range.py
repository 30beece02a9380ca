"""Stability and performance over a range of outer end masses, of every loop that the rig's effects allow.

Stability is settled in the mass: the real roots of the last but one Hurwitz determinant are isolated, and between two
of them one loop is put to the Routh test. Inequalities are settled by cutting the frequency axis at every sign change
of everything that decides them. Where the gain varies, the sides of the rectangle of mass and gain decide.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from flint import arb, arb_poly, fmpq, fmpq_poly

from beamdesign.checker import roots
from beamdesign.checker.nonlinear import nonlinear
from beamdesign.checker.reading import Statements, Table, Unreadable, judged, rational, short, span
from beamdesign.checker.rig import ONCE, Loop, Rig
from beamdesign.checker.roots import NONE, ZERO, Family, Pair, Polynomials, S, Slack, plus, scaled, squared

# What is stated of stability: ranges, crossings between them, and how far they reach.


def stability(table: Table, family: Family, low: fmpq, high: fmpq) -> Statements:
    """The ranges tile what was asked, each with its verdict; the crossings are where they are said to be, and all."""
    parts = [(*_ends(p), p.number("sample"), p.flag("stable")) for p in table.tables("range")]
    listed = [Listed(entry) for entry in table.tables("crossing")]
    exact = {entry.mass[0] for entry in listed if entry.mass[0] == entry.mass[1]}
    tiles = sorted({*((a, b, 0) for a, b, *_ in parts if a < b), *((*entry.mass, 1) for entry in listed)})
    if listed:  # crossings may share an enclosure
        whole = tiles[0][0] == low and tiles[-1][1] == high and all(a[1] == b[0] for a, b in pairwise(tiles))
    else:
        whole = [(a, b) for a, b, _, _ in parts] == [(low, high)]
    yield whole, "the ranges and crossings make up the range" if whole else "the ranges leave out some masses"
    for a, b, sample, stable in parts:
        inside = a <= sample <= b and family.is_stable(sample) == stable
        at_ends = all(family.is_stable(end) == stable for end in (a, b) if end not in exact)
        proved = inside and at_ends and family.verdict(a, b) is stable
        but = "".join(f", not at {short(end)} kg itself" for end in (a, b) if stable and end in exact)
        yield judged(proved, f"{'stable' if stable else 'unstable'} from {span((a, b))} kg{but}")
    yield from _crossings(family, listed, low, high)
    yield agrees(table, "stable", not listed and all(stable for *_, stable in parts))
    for key in ("stays_stable_from_kg", "stays_stable_to_kg"):
        if key in table:
            upwards = key == "stays_stable_to_kg"
            stated = table.word(key)
            far = rational(stated, key) if stated != "infinite" or not upwards else _reach(family, high)
            a, b = (high, far) if upwards else (far, low)
            proved = 0 <= a <= b and family.is_stable_over(a, b)
            end = stated if stated == "infinite" else short(far, up=not upwards)
            yield judged(proved, f"stays stable {'up' if upwards else 'down'} to {end} kg")


def agrees(table: Table, key: str, found: bool) -> tuple[bool, str]:
    """That a flag of a certificate is what was found."""
    same = table.flag(key) is found
    return same, f"{key}: {'yes' if found else 'no'}" if same else f"`{table.place_of(key)}` contradicts what is found"


def _ends(table: Table) -> Pair:
    low, high = table.number("low"), table.number("high")
    if low > high:
        raise Unreadable(f"{table.place} is empty")
    return low, high


def _reach(family: Family, least: fmpq) -> fmpq:
    """A mass from `least` up above which nothing critical remains."""
    return max([least, *(roots.bound(polynomial) for polynomial in family.critical if polynomial.degree() > 0)])


class Listed:
    """A crossing of the certificate: enclosures of its mass and of its squared frequency (zero at infinity)."""

    def __init__(self, entry: Table):
        self.mass = entry.range("outer_end_mass_kg")
        self.infinite = entry.take("squared_frequency") == "infinite"
        self.square = (fmpq(0), fmpq(0)) if self.infinite else entry.range("squared_frequency")
        hertz = entry.range("frequency_Hz", least=0) if "frequency_Hz" in entry else None
        radians = [2 * arb.pi() * arb(value) for value in hertz or ()]
        self.agrees = hertz is None or bool(
            radians[0] * radians[0] <= arb(self.square[0]) and arb(self.square[1]) <= radians[1] * radians[1]
        )


def _crossings(family: Family, listed: Sequence[Listed], low: fmpq, high: fmpq) -> Statements:
    """Every root on the axis for a mass of the range is listed, and every one listed is there."""
    shared = family.p0.gcd(family.p1)
    if roots.on_axis(shared, (fmpq(0), roots.bound(shared))) or shared(0) == 0:
        yield not listed, "a root lies on the axis for every mass, so that none crosses"
        return
    left = list(listed)

    def take(mass: Pair, square: Pair, infinite: bool = False) -> bool:
        for entry in left:
            within = entry.mass[0] <= mass[0] and mass[1] <= entry.mass[1]
            there = entry.square[0] <= square[0] and square[1] <= entry.square[1]
            if within and there and entry.infinite == infinite and entry.agrees:
                left.remove(entry)
                return True
        return False

    zero = (fmpq(0), fmpq(0))
    for power, infinite in ((0, False), (family.degree, True)):
        if family.p1[power] != 0:
            mass = -family.p0[power] / family.p1[power]
            if low <= mass <= high and not take((mass, mass), zero, infinite):
                where = "infinity" if infinite else "zero"
                yield False, f"a root passes through {where} at {short(mass)} kg: not listed"
    for words in _axis_crossings(family, take, [entry.mass for entry in listed], low, high):
        yield False, words
    if left:
        masses = ", ".join(short(entry.mass[0]) for entry in left)
        yield False, f"no root crosses where it is said to, with an end mass of {masses} kg"
    else:
        yield True, f"crossings in the range: {len(listed)}, as listed"


def _axis_crossings(
    family: Family, take: Callable[[Pair, Pair], bool], listed: Sequence[Pair], low: fmpq, high: fmpq
) -> Iterator[str]:
    """What is wrong with the crossings at frequencies above zero.

    Eliminating the mass from both parts leaves an equation in x = w^2; at each of its roots the mass follows.
    """
    (even0, odd0), (even1, odd1) = roots.parts(family.p0), roots.parts(family.p1)
    equation, endless = even0 * odd1 - odd0 * even1, even1.gcd(odd1)
    if equation.is_zero():
        return
    while (common := equation.gcd(endless)).degree() > 0:
        equation = equation / common
    if equation.degree() < 1:
        return
    equation = roots.square_free(equation)

    def mass_of(interval: Pair) -> Pair | None:
        """Bounds of the mass that belongs to a root in the interval; None where it is too wide to tell."""
        x = roots.around(interval)
        for constant, slope in ((even0, even1), (odd0, odd1)):
            below = arb_poly(slope)(x)
            if not below.contains(0):
                return roots.ends(-arb_poly(constant)(x) / below)
        return None

    known = {end for pair in (*listed, (low, high)) for end in pair}
    for found in roots.isolate(equation, fmpq(0), roots.bound(equation)):
        interval = found
        for round_ in range(2000):
            interval = roots.halve(equation, interval)
            mass = mass_of(interval)
            if mass is None:
                continue
            if mass[1] < low or mass[0] > high or take(mass, interval):
                break
            met = [end for end in known if mass[0] <= end <= mass[1]] if round_ % 50 == 49 else []
            hit = [end for end in met if roots.on_axis(family.at(end), interval)]
            if hit and take((hit[0], hit[0]), interval):
                break
            edges = (*listed, (low, low), (high, high))
            if hit or not any(pair[0] <= mass[1] and mass[0] <= pair[1] for pair in edges):
                for _ in range(40):
                    interval = roots.halve(equation, interval)
                mass = mass_of(interval) or mass
                yield f"a root crosses the axis near {short(mass[0])} kg: not listed, or not at the frequency listed"
                break
        else:
            yield f"a crossing near {short(interval[0])} (rad/s)^2 could not be placed"


# What is claimed of magnitudes.

INEQUALITIES = ("compliance", "peak_compliance", "peak_sensitivity", "loop_gain", "controller_effort")


class Bound:
    """What a claim says of a magnitude.

    Attributes:
        kind: of the claim.
        limit: of the magnitude.
        start: least w^2 for which it is claimed.
        until: largest, None where there is no end.
        words: the claim.
    """

    def __init__(self, claim: Table, kind: str):
        self.kind, self.limit, holds = kind, claim.at_least("limit", 0, above=True), claim.flag("holds")
        self.start, self.until, unit, band = NONE, None, "", ""
        if kind.endswith("compliance"):
            unit, (self.until, band) = " m/N", up_to(claim, holds)
        elif kind == "loop_gain":
            hertz = claim.at_least("from_Hz", 0)
            self.start, band = max(squared(hertz)[0], NONE), f"from {short(hertz, up=holds)} Hz up"
        elif kind == "controller_effort":
            unit = " A/V"
        self.words = f"{kind.replace('_', ' ')} at most {short(self.limit, up=holds)}{unit} {band}".rstrip()

    def covers(self, square: fmpq) -> bool:
        """Whether it says something of a w^2."""
        return self.start <= square and (self.until is None or square <= self.until)


def up_to(table: Table, holds: bool = True) -> tuple[fmpq | None, str]:
    """The largest w^2 of a bandwidth, None where it has no end, and it in words, of what holds or does not."""
    if table.take("bandwidth_Hz") == "infinite":
        return None, "at every frequency"
    hertz = table.at_least("bandwidth_Hz", 0)
    return squared(hertz)[1], f"up to {short(hertz, up=not holds)} Hz"


def magnitudes(
    kind: str, denominator: Polynomials, numerator: Polynomials, disturbance: fmpq_poly, law: Polynomials
) -> tuple[Polynomials, Polynomials]:
    """Denominator and numerator of what a claim bounds, each over the mass; `law` is the controller.

    With D the loop's denominator, N its numerator and p = D + N: x / F_d = disturbance / p, S = D / p, L = N / D, and
    C S is (D / law denominator) (law numerator) / p, the controller's denominator being a factor of D; C is from
    the displacement sensor's volts to the current.
    """
    closed = plus(denominator, numerator)
    match kind:
        case "compliance" | "peak_compliance":
            return closed, (disturbance, ZERO)
        case "peak_sensitivity":
            return closed, denominator
        case "loop_gain":
            return denominator, numerator
    if any(divmod(part, law[1])[1] != 0 for part in denominator):
        raise Unreadable("the controller's poles are not those of the open loop")
    above, below = law
    return closed, (denominator[0] / below * above, denominator[1] / below * above)


# What the certificate states.


def statements(table: Table, rig: Rig) -> Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    masses = table.range("outer_end_mass_kg", least=0)
    loops = list(rig.loops())
    same = _same(table.tables("loop"), loops)
    yield same, f"the polynomials {'are' if same else 'are not'} those of the rig and its elements"
    if not any(loop.performing for loop in loops):
        raise Unreadable("no combination of the ends of the spans is to perform")
    claims = table.tables("claim")
    stated, whole = table.table("stability"), all(_is_stable_over(loop, masses) for loop in loops)
    if len(loops) == 1 and loops[0].gain == (1, 1):
        yield from stability(stated, Family(*loops[0].at(loops[0].gain[0])), *masses)
    else:
        for part in stated.tables("range"):
            ends = part.number("low"), part.number("high")
            inside = masses[0] <= ends[0] <= ends[1] <= masses[1]
            proved = inside and all(_is_stable_over(loop, ends) for loop in loops)
            yield judged(proved, f"stable from {span(ends)} kg")
        held, words = agrees(stated, "stable", whole)
        yield held, f"{words}, of every loop from {span(masses)} kg"
    for claim in claims:
        yield _claim(claim, loops, whole, masses)
    yield from nonlinear(table.tables("nonlinear"), loops, masses)


def _same(stated: Sequence[Table], loops: Sequence[Loop]) -> bool:
    """Whether the polynomials stated are those of the loops, of each but for one common factor.

    Whoever wrote them has them from the effects' laws, and not from the elements.
    """
    names = ("p0", "p1", "returned", "returned_slope", "disturbance")
    found = [[table.polynomial(name) for name in names] for table in stated]
    return len(found) == len(loops) and all(map(_proportional, found, loops))


def _proportional(stated: Sequence[fmpq_poly], loop: Loop) -> bool:
    own = (*loop.closed, *loop.loop_numerator, loop.disturbance)
    lead = own[1].degree()
    factor = stated[1][lead] / own[1][lead]
    return factor != 0 and all(one * factor == other for one, other in zip(own, stated, strict=True))


# Of one loop, over the rectangle of masses and gains.


def _is_stable_over(loop: Loop, masses: Pair, s: fmpq_poly = S, times: Pair = ONCE) -> bool:
    """Whether it is stable on the rectangle, with s replaced, its gains also times any factor of a range."""
    denominator, numerator = ((p[0](s), p[1](s)) for p in (loop.loop_denominator, loop.loop_numerator))
    return roots.stable_on_rectangle(denominator, numerator, masses, (loop.gain[0] * times[0], loop.gain[1] * times[1]))


def _slack(loop: Loop, bound: Bound, gain: fmpq) -> Slack:
    numerator, disturbance = scaled(loop.loop_numerator, gain), loop.disturbance + (gain - 1) * loop.crossed
    return Slack(bound.limit, *magnitudes(bound.kind, loop.loop_denominator, numerator, disturbance, loop.law))


def _keeps(loop: Loop, bound: Bound, masses: Pair) -> bool:
    """Whether an inequality holds on the rectangle: on its sides, on which both magnitudes are least."""
    gains = loop.performing
    if gains is None:
        return True
    over_mass = {gains[1]} if bound.kind == "loop_gain" else set(gains)  # a loop gain grows with the factor
    if not all(_slack(loop, bound, gain).nonnegative(*masses, bound.until, bound.start) for gain in over_mass):
        return False
    if bound.kind == "loop_gain" or gains[0] == gains[1]:
        return True
    denominator, numerator = loop.loop_denominator, loop.loop_numerator
    if numerator[1] != 0 or (bound.kind.endswith("compliance") and loop.crossed != 0):
        raise Unreadable("mass and gain multiply each other, so that sides do not decide what is to be performed")
    for mass in {*masses}:
        at = denominator[0] + mass * denominator[1]
        (_, _), top = magnitudes(bound.kind, (at, ZERO), (ZERO, ZERO), loop.disturbance, loop.law)
        if not Slack(bound.limit, (at, numerator[0]), top).nonnegative(*gains, bound.until, bound.start):
            return False
    return True


def _claim(claim: Table, loops: Sequence[Loop], whole: bool, masses: Pair) -> tuple[bool, str]:
    """One claim about all loops: it holds if it says so, and fails, at its witness if it has one, if it says so."""
    kind, holds = claim.word("kind", *INEQUALITIES, "decay_rate", "gain_margin"), claim.flag("holds")
    witness = claim.optional("witness")
    at_witness, mass, gain = False, fmpq(0), fmpq(1)
    if witness.keys:
        mass = witness.number("outer_end_mass_kg")
        gain = witness.number("gain_factor") if "gain_factor" in witness else gain
        at_witness = masses[0] <= mass <= masses[1]

    def unstable(s: fmpq_poly = S, least: fmpq = gain, most: fmpq = gain) -> bool:
        """Whether some loop is not stable at the witness, its factor being one of those claimed."""
        return any(
            loop.gain[0] * least <= gain <= loop.gain[1] * most
            and not Family(*(p(s) for p in loop.at(gain))).is_stable(mass)
            for loop in loops
        )

    if kind in INEQUALITIES:
        bound = Bound(claim, kind)
        words, truth = bound.words, whole and all(_keeps(loop, bound, masses) for loop in loops)
        if "squared_frequency" in witness:
            square = witness.at_least("squared_frequency", 0)
            asked = (one for one in loops if one.performing and one.performing[0] <= gain <= one.performing[1])
            broken = any(_slack(loop, bound, gain).at(mass, square) < 0 for loop in asked)
            at_witness = at_witness and bound.covers(square) and broken
        else:
            at_witness = at_witness and unstable()
    else:
        limit = claim.at_least("limit", 0, above=kind == "decay_rate")
        if kind == "decay_rate":
            words = f"every pole decays faster than {short(limit, up=not holds)} 1/s"
            truth = all(_is_stable_over(loop, masses, S - limit) for loop in loops)
            at_witness = at_witness and unstable(S - limit)
        else:
            words = f"stable with the gain times every number from 1 to {short(limit, up=(limit < 1) is holds)}"
            times = min(limit, fmpq(1)), max(limit, fmpq(1))
            truth = all(_is_stable_over(loop, masses, times=times) for loop in loops)
            at_witness = at_witness and unstable(least=times[0], most=times[1])
    if witness.keys and (holds or not at_witness):
        return False, f"the witness does not refute: {words}"
    return judged(truth, words, holds)
