"""The text of a certificate over one mass: TOML that a person can read and `beamdesign.proof.replay` proves again."""

import hashlib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import isinf, pi
from typing import Any

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.controllers import Stage
from beamdesign.crossing import Crossing
from beamdesign.loop import Loop
from beamdesign.lumped import figures
from beamdesign.parameters import PARAMETERS
from beamdesign.polynomial import exact
from beamdesign.proof.performance import Claim
from beamdesign.proof.rational import bounds, simple_between, text
from beamdesign.proof.stability import StabilityMap
from beamdesign.prototype import Prototype
from beamdesign.spelling import one_line

KIND = "beamdesign.mass_range"
VERSION = 1

_DIGITS = 12


def document(prototype: Prototype, loop: Loop, stability: StabilityMap, claims: Sequence[Claim], summary: str) -> str:
    """Write the certificate.

    Args:
        prototype: whose figures it states.
        loop: its closed loop.
        stability: what was found over the range.
        claims: statements of performance, held or refuted.
        summary: the result in words, put on top as a comment.
    """
    above = [
        *remarks(summary),
        "#",
        "# To prove it again with python-flint alone: python replay.py THIS-FILE  (beamdesign/proof/replay.py).",
        "# Lines that begin with # explain; the others are proved. All numbers are exact: decimals or quotients, as",
        "# text. Polynomials list the coefficients of s^0, s^1, ... The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    below = [
        f"name = {quoted(prototype.name)}",
        'parameter = "outer_end_mass_kg"',
        f'low = "{text(stability.low)}"',
        f'high = "{text(stability.high)}"',
        "",
        *rig_lines(prototype),
        *controller_lines(prototype),
        *polynomial_lines(loop),
        *stability_lines(stability),
        *(line for claim in claims for line in claim_lines(claim)),
    ]
    return sealed(above, below)


def remarks(summary: str) -> list[str]:
    """Lines of words as comments of TOML."""
    return [f"# {one_line(line)}".rstrip() for line in summary.splitlines()]


def sealed(above: Sequence[str], below: Sequence[str]) -> str:
    """The text of a certificate, with the checksum of its lines between those above and those below it."""
    head, body = "\n".join(above), "\n".join(below)
    return f'{head}sha256 = "{hashlib.sha256((head + body).encode()).hexdigest()}"\n{body}'


def quoted(value: str) -> str:
    """A TOML string."""
    import tomli_w

    return tomli_w.dumps({"value": value}).removeprefix("value = ").rstrip("\n")


def rig_lines(prototype: Prototype) -> Iterator[str]:
    """The table of the lumped figures."""
    yield "# The lumped figures of the model, end masses not included; damping is that of fixed dashpots."
    yield "[rig]"
    yield f'kind = "{prototype.kind}"'
    valve, sensor = prototype.servovalve, prototype.sensor
    for name, value in figures(prototype).items():
        if name == "filter_frequency" and sensor.filter_Hz is None:
            continue
        yield f'{PARAMETERS[name].key} = "{text(exact(value))}"'
    yield f'valve_frequency_Hz = "{text(exact(valve.natural_frequency_Hz))}"'
    if sensor.filter_Hz is not None:
        yield f'filter_frequency_Hz = "{text(exact(sensor.filter_Hz))}"'
    yield f'inner_end_mass_kg = "{text(exact(prototype.payload.inner_end_mass_kg))}"'
    yield ""


def controller_lines(prototype: Prototype) -> Iterator[str]:
    """The table of the controller, its figures and its polynomials; of several laws the figures of each."""
    if prototype.schedule is not None:
        for stage in prototype.schedule.stage:
            yield from _stage_lines(stage)
        return
    controller = prototype.controller
    assert controller is not None  # there is a loop
    law = controller.sensed_law()
    yield from controller.comment
    yield "[controller]"
    figures: dict[str, Any] = controller.model_dump() if controller.checked else {"kind": "transfer_function"}
    sections = figures.pop("section", ())
    for name, value in figures.items():
        yield f"{name} = {_stated(value)}"
    yield f"numerator = {_list(law.numerators[0])}"
    yield f"denominator = {_list(law.denominator)}"
    yield ""
    for section in sections:
        yield "[[controller.section]]"
        yield from (f'{name} = "{text(exact(value))}"' for name, value in section.items())
        yield ""


def _stage_lines(stage: Stage) -> Iterator[str]:
    yield "# A law, from error voltage (V) to current (A)."
    yield "[[stage]]"
    yield f'gain_A_per_V = "{text(exact(stage.gain_A_per_V))}"'
    for name in ("pole", "zero"):
        yield from _break(name, getattr(stage, f"{name}_Hz"))
    for section in stage.section:
        yield "[[stage.section]]"
        for name in ("pole", "zero"):
            yield from _break(name, getattr(section, f"{name}_Hz"))
            yield f'{name}_damping_ratio = "{text(exact(getattr(section, f"{name}_damping_ratio")))}"'
    yield ""


def _break(name: str, frequency_Hz: float) -> Iterator[str]:
    yield f'{name}_Hz = "{text(exact(frequency_Hz))}"'
    yield f'{name}_rad_per_s = "{text(exact(2 * pi * frequency_Hz))}"'


def _stated(value: str | float | tuple[Any, ...]) -> str:
    """A word, a figure as exact text, or a list of either."""
    if isinstance(value, tuple):
        return "[" + ", ".join(_stated(entry) for entry in value) + "]"
    return f'"{value if isinstance(value, str) else text(exact(value))}"'


def polynomial_lines(loop: Loop, table: str = "polynomials") -> Iterator[str]:
    """All of them over one common factor, so that every coefficient is an integer."""
    named = {
        "p0": loop.characteristic.constant,
        "p1": loop.characteristic.slope,
        "returned": loop.returned.constant,
        "disturbance": loop.disturbance,
    }
    if not loop.returned.slope.is_zero():
        named["returned_slope"] = loop.returned.slope
    factor = fmpq(1)
    for polynomial in named.values():
        factor *= (polynomial * factor).denom()
    divisor = fmpq(0)
    for polynomial in named.values():
        for value in (polynomial * factor).coeffs():
            divisor = fmpq(value.p.gcd(divisor.p))
    yield "# The closed loop's characteristic polynomial is p0 + m p1, m the outer end mass in kg; the open loop is"
    yield "# returned / (p0 - returned + m p1), and the closed-loop compliance x / F_d is disturbance / (p0 + m p1)."
    if "returned_slope" in named:
        yield "# For p0 - returned + m p1 read p0 - returned + m (p1 - returned_slope), and for returned read"
        yield "# returned + m returned_slope: what added sensors feed back depends on the mass."
    yield f"[{table}]"
    for name, polynomial in named.items():
        yield f"{name} = {_list(polynomial * (factor / divisor), one_per_line=True)}"
    yield ""


def _list(polynomial: fmpq_poly, one_per_line: bool = False) -> str:
    values = [f'"{text(value)}"' for value in polynomial.coeffs()]
    return "[\n  " + ",\n  ".join(values) + ",\n]" if one_per_line and values else "[" + ", ".join(values) + "]"


def stability_lines(stability: StabilityMap) -> Iterator[str]:
    """Ranges, each settled at its sample, and the crossings between them, as decimal enclosures."""
    groups = _groups(stability)
    enclosures = _mass_enclosures(groups, stability)
    yield "# Roots cross the imaginary axis at the crossings and nowhere else; each range is settled by its sample."
    yield "[stability]"
    yield f"stable = {_bool(stability.stable)}"
    if stability.stable:
        yield from _beyond(stability)
    if not stability.ranges:
        yield "range = []"
    if not groups:
        yield "crossing = []"
    yield ""
    starts = {id(group[0]): pair for group, pair in zip(groups, enclosures, strict=True)}
    for part in stability.ranges:
        low = starts[id(part.opens_at)][1] if part.opens_at else part.low
        high = starts[id(part.closes_at)][0] if part.closes_at else part.high
        yield "[[stability.range]]"
        yield f'low = "{text(low)}"'
        yield f'high = "{text(high)}"'
        yield f'sample = "{text(part.sample)}"'
        yield f"stable = {_bool(part.stable)}"
        yield ""
    for group, pair in zip(groups, enclosures, strict=True):
        for crossing in group:
            yield "[[stability.crossing]]"
            yield f"outer_end_mass_kg = {_texts(pair)}"
            if not crossing.finite:
                yield 'squared_frequency = "infinite"'
            else:
                square = _decimals(*bounds(crossing.squared_frequency), _DIGITS)
                yield f"squared_frequency = {_texts(square)}"
                yield f"frequency_Hz = {_texts(_frequencies(square))}"
            yield ""


def _beyond(stability: StabilityMap) -> Iterator[str]:
    """How far a stable range reaches past what was asked, up to the next crossing or down to no mass at all."""
    above, below = stability.above, stability.below
    if above is None:
        yield 'stays_stable_to_kg = "infinite"'
    else:
        most = _enclosure(above)[0]
        if above.rational is not None:
            most = simple_between(stability.high, above.rational)
        if most > stability.high:
            yield f'stays_stable_to_kg = "{text(most)}"'
    if stability.low > 0:
        least = fmpq(0)
        if below is not None and below.rational is not None and below.rational >= 0:
            least = simple_between(below.rational, stability.low)
        elif below is not None:
            least = max(least, _enclosure(below)[1])
        if least < stability.low:
            yield f'stays_stable_from_kg = "{text(least)}"'


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
        edges = [(stability.low, stability.low), *found, (stability.high, stability.high)]
        apart = all(before[1] < after[0] for before, after in pairwise(found))
        clear = all(not low <= sample <= high for sample in samples for low, high in found)
        inside = all(edges[0][0] <= low and high <= edges[-1][1] for low, high in found)
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


def claim_lines(claim: Claim) -> Iterator[str]:
    """The table of one claim."""
    yield "[[claim]]"
    yield f'kind = "{claim.kind}"'
    yield f'limit = "{text(exact(claim.limit))}"'
    if claim.bandwidth_Hz is not None:
        yield f'bandwidth_Hz = "{_finite(claim.bandwidth_Hz)}"'
    if claim.from_Hz is not None:
        yield f'from_Hz = "{text(exact(claim.from_Hz))}"'
    yield f"holds = {_bool(claim.holds)}"
    if not claim.holds:
        yield f"reason = {quoted(claim.reason)}"
        yield from _witness(claim)
    yield ""


def _witness(claim: Claim) -> Iterator[str]:
    """Figures that refute the claim, where there are rational ones."""
    witness = claim.witness
    if witness is None or not witness.exact:
        return
    yield "[claim.witness]"
    yield f'outer_end_mass_kg = "{text(witness.mass)}"'
    if witness.squared_frequency is not None:
        yield f'squared_frequency = "{text(witness.squared_frequency)}"'
    if witness.gain_factor is not None:
        yield f'gain_factor = "{text(witness.gain_factor)}"'


def _finite(value: float) -> str:
    return "infinite" if isinf(value) else text(exact(value))


def _texts(pair: tuple[fmpq, fmpq]) -> str:
    return f'["{text(pair[0])}", "{text(pair[1])}"]'


def _bool(value: bool) -> str:
    return "true" if value else "false"
