"""What a certificate over the outer end mass states, as tables of texts: stable ranges, crossings, claims."""

from collections.abc import Sequence
from itertools import pairwise
from math import gcd, isinf, lcm

from flint import arb, ctx, fmpq

from beamdesign.loop import Loop
from beamdesign.polynomial import Crossing, bounds, exact, shortened, simple_between, text
from beamdesign.proofs.certificate import Claim
from beamdesign.proofs.stability import Range, StabilityMap
from beamdesign.proofs.writer import Tables, coefficients, texts

KIND = "beamdesign.mass_range"
_DIGITS = 12


def loop_table(loop: Loop) -> Tables:
    """A loop's polynomials over one common factor, so that every coefficient is a whole number.

    With m the outer end mass in kg the characteristic polynomial is p0 + m p1, the numerator of the loop gain is
    returned + m returned_slope, its denominator what the two differ by, and x / F_d is disturbance / (p0 + m p1).
    """
    named = {
        "p0": loop.characteristic.constant,
        "p1": loop.characteristic.slope,
        "returned": loop.loop_numerator.constant,
        "returned_slope": loop.loop_numerator.slope,
        "disturbance": loop.disturbance,
    }
    factor = lcm(*(int(polynomial.denom()) for polynomial in named.values()))
    divisor = gcd(*(int((polynomial * factor).numer().content()) for polynomial in named.values()))
    return {name: coefficients(polynomial * fmpq(factor, divisor)) for name, polynomial in named.items()}


def common_table(stability: StabilityMap) -> Tables:
    """Masses at which every one of several loops is stable at every factor on its gain."""
    ranges = [_closed(part) for part in stability.ranges if part.stable]
    return {"stable": stability.stable, "range": [{"low": text(low), "high": text(high)} for low, high in ranges]}


def _closed(part: Range) -> tuple[fmpq, fmpq]:
    """A closed range of short decimals inside a range that is open where it ends at a crossing."""
    low, high = part.low, part.high
    if part.opens_at is not None:
        low = shortened(low, _DIGITS, up=True)
        low = low if part.low < low < part.sample else simple_between(part.low, part.sample)
    if part.closes_at is not None:
        high = shortened(high, _DIGITS)
        high = high if part.sample < high < part.high else simple_between(part.sample, part.high)
    return low, high


def stability_table(stability: StabilityMap) -> Tables:
    """Ranges, each settled at its sample, and the crossings between them, as decimal enclosures."""
    groups = _groups(stability)
    enclosures = _mass_enclosures(groups, stability)
    starts = {id(group[0]): pair for group, pair in zip(groups, enclosures, strict=True)}
    ranges = []
    for part in stability.ranges:
        low = starts[id(part.opens_at)][1] if part.opens_at else part.low
        high = starts[id(part.closes_at)][0] if part.closes_at else part.high
        ends = {"low": text(low), "high": text(high), "sample": text(part.sample)}
        ranges.append(ends | {"stable": part.stable})
    crossings = []
    for group, pair in zip(groups, enclosures, strict=True):
        for crossing in group:
            entry: Tables = {"outer_end_mass_kg": texts(pair), "squared_frequency": "infinite"}
            if crossing.finite:
                square = _decimals(*bounds(crossing.squared_frequency), _DIGITS)
                entry |= {"squared_frequency": texts(square), "frequency_Hz": texts(_frequencies(square))}
            crossings.append(entry)
    reach = _beyond(stability) if stability.stable else {}
    return {"stable": stability.stable, **reach, "range": ranges, "crossing": crossings}


def _beyond(stability: StabilityMap) -> Tables:
    """How far a stable range reaches past what was asked, up to the next crossing or down to no mass at all."""
    above, below, found = stability.above, stability.below, {}
    if above is None:
        found["stays_stable_to_kg"] = "infinite"
    else:
        most = _enclosure(above)[0]
        if above.rational is not None:
            most = simple_between(stability.high, above.rational)
        if most > stability.high:
            found["stays_stable_to_kg"] = text(most)
    if stability.low > 0:
        least = fmpq(0)
        if below is not None and below.rational is not None and below.rational >= 0:
            least = simple_between(below.rational, stability.low)
        elif below is not None:
            least = max(least, _enclosure(below)[1])
        if least < stability.low:
            found["stays_stable_from_kg"] = text(least)
    return found


def _groups(stability: StabilityMap) -> list[list[Crossing]]:
    """The crossings by mass; the ranges name the first of each group."""
    firsts = {id(part.opens_at) for part in stability.ranges} | {id(part.closes_at) for part in stability.ranges}
    groups: list[list[Crossing]] = []
    for crossing in stability.crossings:
        if not groups or id(crossing) in firsts:
            groups.append([])
        groups[-1].append(crossing)
    return groups


def _mass_enclosures(groups: Sequence[Sequence[Crossing]], stability: StabilityMap) -> list[tuple[fmpq, fmpq]]:
    """Short decimals around each group, with as many digits as it takes to keep them and the samples apart."""
    digits = _DIGITS
    samples = [part.sample for part in stability.ranges]
    while True:
        found = []
        for group in groups:
            pairs = [_enclosure(crossing, digits) for crossing in group]
            found.append((min(pair[0] for pair in pairs), max(pair[1] for pair in pairs)))
        apart = all(before[1] < after[0] for before, after in pairwise(found))
        clear = all(not low <= sample <= high for sample in samples for low, high in found)
        inside = all(stability.low <= low and high <= stability.high for low, high in found)
        if (apart and clear and inside) or digits > 1000:
            return found
        digits *= 2


def _enclosure(crossing: Crossing, digits: int = _DIGITS) -> tuple[fmpq, fmpq]:
    if crossing.rational is not None:
        return crossing.rational, crossing.rational
    return _decimals(*bounds(crossing.parameter), digits)


def _decimals(low: fmpq, high: fmpq, digits: int) -> tuple[fmpq, fmpq]:
    """Decimals around a narrow interval, to so many digits of its larger end."""
    if low == high and text(low).find("/") < 0:
        return low, high
    step = fmpq(1)
    size = max(abs(low), abs(high))
    while step * 10**digits < size:
        step *= 10
    while step * 10 ** (digits - 1) > size:
        step /= 10
    return (low / step).floor() * step, (high / step).ceil() * step


def _frequencies(square: tuple[fmpq, fmpq]) -> tuple[fmpq, fmpq]:
    """Decimals around sqrt(x) / (2 pi) for x in an enclosure."""
    if square == (0, 0):
        return fmpq(0), fmpq(0)
    with ctx.workprec(128):
        low, high = (bounds(arb(value).sqrt() / (2 * arb.pi())) for value in square)
    return _decimals(low[0], high[1], _DIGITS)


def claim_tables(claims: Sequence[Claim], counterexamples: bool = True) -> Tables:
    """The claims, under their key.

    Args:
        claims: held or refuted.
        counterexamples: whether to state what refutes them, where that is rational.
    """
    return {"claim": [_claim(claim, counterexamples) for claim in claims]} if claims else {}


def _claim(claim: Claim, counterexamples: bool) -> Tables:
    found: Tables = {"kind": claim.kind, "limit": text(exact(claim.limit)), "holds": claim.holds}
    if claim.kind.endswith("compliance"):
        found["bandwidth_Hz"] = finite(claim.bandwidth_Hz)
    if claim.kind == "loop_gain":
        found["from_Hz"] = text(exact(claim.from_Hz))
    witness = claim.witness
    if witness is not None and witness.exact and counterexamples:
        figures = {
            "outer_end_mass_kg": witness.mass,
            "squared_frequency": witness.squared_frequency,
            "gain_factor": witness.gain_factor,
        }
        found["witness"] = {name: text(value) for name, value in figures.items() if value is not None}
    return found


def finite(value: float) -> str:
    """A number as text, or that it is infinite."""
    return "infinite" if isinf(value) else text(exact(value))
