"""What a certificate states of stability over the mass: ranges, crossings between them, and how far they reach."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

from flint import arb, arb_poly, fmpq, fmpq_poly

from beamdesign.checker.reading import Table, Unreadable, rational, short
from beamdesign.checker.roots import Pair, bound, ends, halve, isolate, on_axis, parts, square_free
from beamdesign.checker.stability import Family

Statements = Iterator[tuple[bool, str]]
"""Of a certificate: whether each was proved, and it or its failure in words."""


def stability(table: Table, family: Family, low: fmpq, high: fmpq) -> Statements:
    """The ranges tile what was asked, each with its verdict; the crossings are where they are said to be, and all."""
    parts = [(*_ends(p), p.number("sample"), p.flag("stable")) for p in table.tables("range")]
    listed = [Listed(entry) for entry in table.tables("crossing")]
    exact = {entry.mass[0] for entry in listed if entry.mass[0] == entry.mass[1]}
    tiles = sorted({*((a, b, 0) for a, b, *_ in parts if a < b), *((*entry.mass, 1) for entry in listed)})
    whole = [(a, b) for a, b, _, _ in parts] == [(low, high)] if not listed else _tile(tiles, low, high)
    yield whole, "the ranges and crossings make up the range" if whole else "the ranges leave out some masses"
    for a, b, sample, stable in parts:
        span = f"{short(a)} to {short(b)} kg"
        inside = a <= sample <= b and family.is_stable(sample) == stable
        at_ends = all(family.is_stable(end) == stable for end in (a, b) if end not in exact)
        proved = inside and at_ends and family.verdict(a, b) is stable
        words = f"{'stable' if stable else 'unstable'} from {span}"
        yield proved, words if proved else f"not proved: {words}"
    yield from _crossings(family, listed, low, high)
    yield agrees(table, "stable", not listed and all(stable for *_, stable in parts))
    for key in ("stays_stable_from_kg", "stays_stable_to_kg"):
        if key in table:
            upwards = key == "stays_stable_to_kg"
            stated = table.word(key)
            far = rational(stated, key) if stated != "infinite" or not upwards else _reach(family, high)
            a, b = (high, far) if upwards else (far, low)
            proved = 0 <= a <= b and family.is_stable_over(a, b)
            words = f"stays stable {'up' if upwards else 'down'} to {stated if stated == 'infinite' else short(far)} kg"
            yield proved, words if proved else f"not proved: {words}"


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
    return max([least, *(bound(polynomial) for polynomial in family.critical if polynomial.degree() > 0)])


def _tile(tiles: Sequence[tuple[fmpq, fmpq, int]], low: fmpq, high: fmpq) -> bool:
    """Whether intervals follow each other without a gap from low to high; crossings may share an enclosure."""
    if not tiles or tiles[0][0] != low or tiles[-1][1] != high:
        return False
    return all(before[1] == after[0] for before, after in pairwise(tiles))


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


def _crossings(family: Family, listed: Sequence[Listed], low: fmpq, high: fmpq) -> Iterator[tuple[bool, str]]:
    """Every root on the axis for a mass of the range is listed, and every one listed is there."""
    shared = family.p0.gcd(family.p1)
    if on_axis(shared, (fmpq(0), bound(shared))) or shared(0) == 0:
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
                yield (
                    False,
                    f"a root passes through {'infinity' if infinite else 'zero'} at {short(mass)} kg: not listed",
                )
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
    (even0, odd0), (even1, odd1) = parts(family.p0), parts(family.p1)
    equation, endless = even0 * odd1 - odd0 * even1, even1.gcd(odd1)
    if equation.is_zero():
        return
    while (common := equation.gcd(endless)).degree() > 0:
        equation = equation / common
    if equation.degree() < 1:
        return
    equation = square_free(equation)
    ends = {end for pair in (*listed, (low, high)) for end in pair}
    for found in isolate(equation, fmpq(0), bound(equation)):
        interval = found
        for round_ in range(2000):
            interval = halve(equation, interval)
            mass = _mass(even0, odd0, even1, odd1, interval)
            if mass is None:
                continue
            if mass[1] < low or mass[0] > high or take(mass, interval):
                break
            known = [end for end in ends if mass[0] <= end <= mass[1]] if round_ % 50 == 49 else []
            hit = [end for end in known if on_axis(family.at(end), interval)]
            if hit and take((hit[0], hit[0]), interval):
                break
            edges = (*listed, (low, low), (high, high))
            if hit or not any(pair[0] <= mass[1] and mass[0] <= pair[1] for pair in edges):
                for _ in range(40):
                    interval = halve(equation, interval)
                mass = _mass(even0, odd0, even1, odd1, interval) or mass
                yield f"a root crosses the axis near {short(mass[0])} kg: not listed, or not at the frequency listed"
                break
        else:
            yield f"a crossing near {short(interval[0])} (rad/s)^2 could not be placed"


def _mass(even0: fmpq_poly, odd0: fmpq_poly, even1: fmpq_poly, odd1: fmpq_poly, interval: Pair) -> Pair | None:
    """Bounds of the mass that belongs to a root in the interval; None where it is too wide to tell."""
    middle, radius = (interval[0] + interval[1]) / 2, (interval[1] - interval[0]) / 2
    x = arb(middle) + arb(0, arb(radius).upper())
    for constant, slope in ((even0, even1), (odd0, odd1)):
        below = arb_poly(slope)(x)
        if not below.contains(0):
            return ends(-arb_poly(constant)(x) / below)
    return None
