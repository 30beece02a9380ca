"""Exact stable ranges of p0(s) + m p1(s) over one mass m: crossings isolated, one exact Routh test per range."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, groupby, pairwise
from math import inf, nextafter, pi
from operator import attrgetter

from flint import arb, ctx, fmpq

from beamdesign.polynomial import (
    Affine,
    Crossing,
    bounds,
    crossings,
    degree_drop,
    elimination,
    even_odd,
    exact,
    is_hurwitz,
    nearest,
    real_roots,
    roots,
    rounded_down,
    rounded_up,
    shares_axis_root,
    simple_between,
    value_at,
)
from beamdesign.quantities import stated_range


@dataclass(frozen=True)
class Range:
    """Masses between neighbouring crossings, all of them stable or none.

    Attributes:
        low: rational from below which nothing is claimed; a closed end, or just above a crossing's enclosure.
        high: the same from above.
        opens_at: the crossing at the lower end, None where the range begins at the end of what was asked.
        closes_at: the crossing at the upper end.
        sample: the mass inside that was settled by an exact Routh test.
        stable: its verdict, which is that of the whole range.
    """

    low: fmpq
    high: fmpq
    opens_at: Crossing | None
    closes_at: Crossing | None
    sample: fmpq
    stable: bool


@dataclass(frozen=True)
class StabilityMap:
    """What is stable between two masses, decided exactly.

    Stable means that all roots lie in the open left half plane, as many as the family has at most of its members:
    where the leading coefficient vanishes a root has gone through infinity, and that mass counts as a crossing.

    Attributes:
        low: least mass asked about.
        high: largest mass asked about.
        groups: all crossings inside the closed range, ascending, those at one mass together.
        ranges: the ranges between them; they and the crossings together make up [low, high].
        below: the nearest crossing below `low`, if any.
        above: the nearest crossing above `high`, if any.
        reason: in words, why the answer is no; empty where it is yes.
    """

    low: fmpq
    high: fmpq
    groups: tuple[tuple[Crossing, ...], ...]
    ranges: tuple[Range, ...]
    below: Crossing | None
    above: Crossing | None
    reason: str

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """All crossings inside the closed range, ascending."""
        return tuple(chain(*self.groups))

    @property
    def stable(self) -> bool:
        """Whether every mass of the closed range is stable."""
        return not self.groups and all(part.stable for part in self.ranges)

    @property
    def stable_ranges(self) -> list[tuple[float, float]]:
        """The stable ranges as floats, open where they end at a crossing, which is rounded inwards."""
        return [
            (
                rounded_up(part.low) if part.opens_at else nearest(part.low),
                rounded_down(part.high) if part.closes_at else nearest(part.high),
            )
            for part in self.ranges
            if part.stable
        ]

    @property
    def closed_ranges(self) -> list[tuple[float, float]]:
        """The same, closed: without a crossing that is a float itself."""
        at = {crossing.rational for crossing in self.crossings}
        return [
            (nextafter(low, inf) if exact(low) in at else low, nextafter(high, -inf) if exact(high) in at else high)
            for low, high in self.stable_ranges
        ]


def stable_ranges(family: Affine, low: fmpq, high: fmpq, precision_bits: int = 64) -> StabilityMap:
    """Split a closed range of masses into ranges that are stable or unstable throughout.

    Roots move continuously with m, so stability can change only where one crosses the axis (a real root of the
    elimination polynomial), the origin, or infinity (the degree drops). Between such masses one exact Routh test
    settles all. A mass at which roots only touch the axis is a crossing with stable neighbours.

    Args:
        family: the characteristic polynomials, affine in m.
        low: least mass.
        high: largest mass; may equal `low`.
        precision_bits: least accuracy of the crossings.

    Raises:
        ValueError: for an empty range.
    """
    if low > high:
        raise ValueError(f"empty range: {low} is above {high}")
    if shares_axis_root(family):
        lone = Range(low, high, None, None, low, False)
        reason = "a root lies on the imaginary axis at every mass"
        return StabilityMap(low, high, (), (lone,), None, None, reason)
    groups = _located(family, low, high, precision_bits)
    below = [group[-1] for group in groups if group[0].ends[1] < low]
    above = [group[0] for group in groups if group[0].ends[0] > high]
    inside = groups[len(below) : len(groups) - len(above)]
    parts, beside = _split(family, low, high, inside), (below[-1] if below else None, above[0] if above else None)
    return StabilityMap(low, high, tuple(map(tuple, inside)), tuple(parts), *beside, in_words(parts, [*chain(*inside)]))


def _split(family: Affine, low: fmpq, high: fmpq, inside: Sequence[Sequence[Crossing]]) -> list[Range]:
    """The ranges between the crossings inside; the ends of the range asked may be crossings themselves."""
    if low == high:
        return [] if inside else [Range(low, high, None, None, low, is_hurwitz(family.at(low)))]
    edges: list[tuple[fmpq, fmpq, Crossing | None]] = [(low, low, None)]
    for group in inside:
        least, most = zip(*(crossing.ends for crossing in group), strict=True)
        edges.append((min(least), max(most), group[0]))
    edges.append((high, high, None))
    if len(edges) > 2 and edges[1][0] == low:  # a crossing at the very end: the range is open there
        edges.pop(0)
    if len(edges) > 2 and edges[-2][1] == high:
        edges.pop()
    parts = []
    for (_, start, opens_at), (end, _, closes_at) in pairwise(edges):
        sample = simple_between(start, end)
        parts.append(Range(start, end, opens_at, closes_at, sample, is_hurwitz(family.at(sample))))
    return parts


def in_words(parts: Sequence[Range], listed: Sequence[Crossing]) -> str:
    """What is wrong, in words: unstable stretches (neighbours joined), or single masses on the axis."""
    stretches = [[*stretch] for stable, stretch in groupby(parts, attrgetter("stable")) if not stable]
    if stretches and not any(part.stable for part in parts):
        return "no mass of the range is stable"
    if stretches:
        ends = ((nearest(stretch[0].low), nearest(stretch[-1].high)) for stretch in stretches)
        return f"unstable from {', '.join(f'{stated_range(each)} kg' for each in ends)}"
    if listed:
        masses = ", ".join(dict.fromkeys(f"{crossing.value:.7g} kg" for crossing in listed))
        return f"a root lies on the imaginary axis or at infinity at {masses}"
    return ""


_MOST_BITS = 1024
"""Crossings whose masses cannot be told apart with so many are of one group, between which nothing is claimed."""


def _located(family: Affine, low: fmpq, high: fmpq, precision: int) -> list[list[Crossing]]:
    """All crossings, in groups of equal mass, each group told apart from the others and from both ends."""
    dropped = degree_drop(family)
    infinite = [] if dropped is None else [Crossing(arb(dropped), arb.pos_inf(), dropped)]
    while True:
        with ctx.workprec(precision):
            found = [*infinite, *crossings(family, precision)]
            found = [_at_end(family, crossing, (low, high), precision) for crossing in found]
        groups: list[list[Crossing]] = []
        for crossing in sorted(found, key=lambda crossing: crossing.ends[0]):
            if groups and any(other.ends[1] >= crossing.ends[0] for other in groups[-1]):
                groups[-1].append(crossing)
            else:
                groups.append([crossing])
        separated = all(len(group) == 1 or None not in {one.rational for one in group} for group in groups)
        ends = all(_clear_of(crossing, end) for crossing in found for end in (low, high))
        if ends and (separated or precision > _MOST_BITS):
            return groups
        precision *= 2


def _clear_of(crossing: Crossing, end: fmpq) -> bool:
    least, most = crossing.ends
    return crossing.rational is not None or end < least or most < end


def _at_end(family: Affine, crossing: Crossing, ends: tuple[fmpq, fmpq], precision: int) -> Crossing:
    """The crossing, with its mass known exactly where it is proved to be one of the ends."""
    if crossing.rational is None and crossing.parameter.is_exact():
        return crossing.known(bounds(crossing.parameter)[0])
    for end in ends:
        if not _clear_of(crossing, end):
            even, odd = even_odd(family.at(end))
            common = even.gcd(odd)
            # Enclosures of the elimination polynomial's roots are disjoint and hold one root each.
            if common.degree() > 0 and any(
                root.overlaps(crossing.squared_frequency) for root, _ in real_roots(common, precision)
            ):
                return crossing.known(end)
    return crossing


def is_stable_over(family: Affine, low: fmpq, high: fmpq) -> bool:
    """Whether every mass of the closed range is stable: exact, and quick enough for the inside of an optimiser.

    One end is settled by a Routh test. The rest follows if neither the leading nor the last coefficient vanishes in
    the range and no crossing lies in it, which enclosures mostly show at once; what they leave open goes to
    `stable_ranges`.
    """
    degree, first = max(family.constant.degree(), family.slope.degree()), family.at(low)
    if not is_hurwitz(first):
        return False
    if low == high:
        return first.degree() == degree
    if any(first[power] * family.at(high)[power] <= 0 for power in (0, degree)):
        return False
    equation, parts = elimination(family), [*zip(even_odd(family.constant), even_odd(family.slope), strict=True)]
    if equation.is_zero():
        return stable_ranges(family, low, high).stable
    with ctx.workprec(64):
        ends = arb(low).union(arb(high))
        for square, _ in real_roots(equation, 32):
            # The crossing's mass solves constant + m slope = 0 of either part: one clear miss is enough.
            if square > 0 and all((value_at(a, square) + ends * value_at(b, square)).contains(0) for a, b in parts):
                return stable_ranges(family, low, high).stable
    return True


@dataclass(frozen=True)
class Unstable:
    """Where a family is not stable, or fails in what else is claimed of it.

    Attributes:
        value: of the parameter.
        exact: whether it is not stable itself; False where it only stands next to a root on the axis at an irrational
            one.
        frequency_Hz: of the slowest or growing oscillation there.
        reason: in words, all that is not stable.
        squared_frequency: (rad/s)^2 at which a magnitude is beyond its limit; None where it is stability that fails.
    """

    value: fmpq
    exact: bool
    frequency_Hz: float
    reason: str
    squared_frequency: fmpq | None = None


def unstable_at(family: Affine, low: fmpq, high: fmpq) -> Unstable | None:
    """A parameter of the closed range at which the family is not stable; None where it is stable throughout."""
    if is_stable_over(family, low, high):
        return None
    found = stable_ranges(family, low, high)
    settled = [part.sample for part in found.ranges if not part.stable]
    settled += [crossing.rational for crossing in found.crossings if crossing.rational is not None]
    value = settled[0] if settled else sum(bounds(found.crossings[0].parameter), fmpq(0)) / 2
    rightmost = max(roots(family.at(value)), key=lambda root: root.real)
    return Unstable(value, bool(settled), float(abs(rightmost.imag)) / (2 * pi), found.reason)
