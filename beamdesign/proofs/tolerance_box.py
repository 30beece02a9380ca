"""The box of a prototype's tolerances, end masses and delay, how far it can be scaled, and that of frozen figures."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from functools import partial
from math import inf, pi

from flint import arb, fmpq

from beamdesign.controllers import Proportional
from beamdesign.parameters import PARAMETERS, TOLERANCES, refuse_none_left
from beamdesign.plant.component import with_unit
from beamdesign.plant.members import family
from beamdesign.polynomial import bounds, exact, nearest, shortened
from beamdesign.proofs.box import Box, BoxVerdict, Dashpot, box_of, certify_box, unstable_member
from beamdesign.proofs.box_member import Worst, worst_of
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.performance import rounded_below, servo_off_of
from beamdesign.proofs.rig_family import effect_spans, performing_spans, rig_family, rig_values
from beamdesign.proofs.statement import Interval, PolynomialFamily
from beamdesign.prototype import Prototype
from beamdesign.quantities import decimal
from beamdesign.records import InputError, Problem
from beamdesign.time_limit import over, while_time

_OF_LOOP = {"controller_gain": ("A/V", 1.0), "delay": ("s", 1.0)}
"""Unit of further figures of the loop, and what to divide their values by; frequencies are shown in Hz."""


def figure_key(name: str) -> tuple[str, float]:
    """The key of a figure with its unit, and what to divide its SI value by: frequencies are shown in Hz."""
    if name in PARAMETERS:
        return PARAMETERS[name].shown_key, PARAMETERS[name].factor
    turns = name.startswith("controller_") or name.endswith("_frequency")
    unit, factor = _OF_LOOP.get(name, ("Hz", 2 * pi) if turns else ("1", 1.0))
    return with_unit(name, unit), factor


def tolerance_box(
    prototype: Prototype,
    sigmas: float = 3.0,
    names: Collection[str] | None = None,
    outer_end_mass: tuple[float, float] | None = None,
    delay_s: tuple[float, float] | None = None,
    spread: Mapping[str, float] | None = None,
) -> Box:
    """Ranges of the figures of a prototype: so many standard deviations to either side.

    A dashpot b = 2 zeta sqrt(K M) is a parameter of its own and spans all that its beam's damping ratio, stiffness and
    mass give within their tolerances. End masses and delay are ranges that are asked for: they do not scale with the
    tolerances, but a tolerance of an end mass widens its range. Spans of frozen figures of effects are those of all
    rigs within the ranges, of scaled ones too.

    Args:
        prototype: with a controller; its `tolerance` holds relative standard deviations.
        sigmas: how many standard deviations.
        names: which figures vary, as in `rig_values`; all that have a tolerance where it is None.
        outer_end_mass: kg; else the range of the payload, where there is one.
        delay_s: pure delay in the loop, s.
        spread: relative standard deviations beside those of the prototype, such as {"controller_gain": 0.01}.

    Raises:
        InputError: for a figure without tolerance or that the rig does not have, or a range that reaches zero.
        ValueError: without a controller.
    """
    payload = prototype.payload.outer_end_mass_kg if outer_end_mass is None else outer_end_mass
    values = rig_values(prototype, None if payload is None else payload[1])
    deviations = {n: getattr(prototype.tolerance, key) for n, key in TOLERANCES.items() if n in values}
    if unknown := sorted((set(spread or {}) | set(names or ())) - set(values)):
        reason = f"no such figure; there are {', '.join(values)}"
        raise InputError(prototype.name, [Problem(name, reason) for name in unknown])
    deviations |= spread or {}
    part = {name: exact(sigmas) * exact(deviation) for name, deviation in deviations.items()}
    least = values | {"outer_end_mass": fmpq(0) if payload is None else exact(payload[0])}
    refuse_none_left({name: size for name, size in deviations.items() if least[name] > 0}, sigmas)
    ranges = {name: (values[name] * (1 - share), values[name] * (1 + share)) for name, share in part.items()}
    dashpots: dict[str, Dashpot] = {}

    for beam in ("outer", "inner"):
        if f"{beam}_damping" in values and f"{beam}_damping" not in (spread or {}):
            dashpots[f"{beam}_damping"] = partial(_drawn, values, part, beam)
            ranges[f"{beam}_damping"] = _drawn(values, part, beam, {})
    rigid = set()
    for name, pair in (("outer_end_mass", payload), ("delay", delay_s)):
        if pair is not None:
            share = part.get(name, fmpq(0))
            ranges[name] = (exact(pair[0]) * (1 - share), exact(pair[1]) * (1 + share))
            rigid.add(name)
    heaviest = None if payload is None else nearest(ranges["outer_end_mass"][1])
    spanned = partial(_spanned, prototype, heaviest, dict(ranges))
    spans = spanned(ranges)
    ranges |= spans
    rigid |= set(spans)
    # One payload is a range too, where it is another than the expression has by itself.
    chosen = [name for name in values if name in ranges and ranges[name] != (values[name],) * 2]
    if names is not None:
        if fixed := sorted(set(names) - set(chosen)):
            raise InputError(prototype.name, [Problem(name, "has no tolerance and no range") for name in fixed])
        chosen = [name for name in chosen if name in names or name in rigid]
    nominal = {name: min(max(values[name], ranges[name][0]), ranges[name][1]) for name in chosen}
    kept = {name: of for name, of in dashpots.items() if name in chosen}
    return Box({name: ranges[name] for name in chosen}, nominal, frozenset(rigid & set(chosen)), kept, spanned)


def box_with_effects(
    prototype: Prototype,
    ranges: Mapping[str, tuple[float | fmpq, float | fmpq]],
    nominal: Mapping[str, float | fmpq] | None = None,
) -> Box:
    """A box from ranges by name, "outer_end_mass" among them, and the spans that effects have of all rigs in it.

    Args:
        prototype: whose effects they are.
        ranges: as of `box_of`.
        nominal: likewise.

    Raises:
        InputError: for effects for which no linear loop stands.
        ValueError: as of `box_of`.
    """
    box = box_of(ranges, nominal)
    heaviest = nearest(box.ranges["outer_end_mass"][1])
    values, spans = rig_values(prototype, heaviest), effect_spans(family(prototype, heaviest, box.ranges))
    rest = {name: min(max(values[name], low), high) for name, (low, high) in spans.items()}
    return replace(box, ranges={**box.ranges, **spans}, nominal={**box.nominal, **rest})


def _spanned(
    prototype: Prototype, heaviest: float | None, own: Mapping[str, Interval], drawn: Mapping[str, Interval]
) -> Mapping[str, Interval]:
    """Ranges of what effects freeze, of rigs whose other figures are within ranges."""
    return effect_spans(family(prototype, heaviest, {**own, **drawn}))


def _drawn(values: Mapping[str, fmpq], part: Mapping[str, fmpq], beam: str, factors: Mapping[str, fmpq]) -> Interval:
    """Range of a beam's dashpot 2 zeta sqrt(K M), rounded outwards, with factors on the deviations of K, M and zeta."""
    names = [f"{beam}_{figure}" for figure in ("stiffness", "mass", "damping")]
    value, (stiffness, mass, ratio) = values[names[2]], (part[name] * factors.get(name, fmpq(1)) for name in names)
    if (stiffness == 0 and mass == 0) or value == 0:
        return value * (1 - ratio), value * (1 + ratio)
    low = bounds(arb((1 - stiffness) * (1 - mass)).sqrt())[0] * (1 - ratio) * value
    high = bounds(arb((1 + stiffness) * (1 + mass)).sqrt())[1] * (1 + ratio) * value
    return shortened(low, 8), shortened(high, 8, up=True)


# Scaling: the largest that is proved stable, and the least that is refuted.


_TRIES, _DIGITS = 10, 6
"""Most factors to try to prove, and to how many digits a factor is rounded down."""


@dataclass(frozen=True)
class Scaling:
    """How far the ranges of a box can be drawn out around its nominal values.

    Attributes:
        proved: largest factor at which the whole box was proved stable; 0 if none was.
        refuted: least factor at which a member of the box was proved not to be stable; None where none was found.
        limit: factor beyond which a figure would reach zero, or about which no linear loop stands for an effect any
            more; nothing above it was asked.
        verdict: that of the box scaled by `proved`, with its certificate; None if `proved` is 0.
        unstable_point: the member that refutes at `refuted`.
        reason: in words, what is known between the two factors.
    """

    proved: float
    refuted: float | None
    limit: float
    verdict: BoxVerdict | None
    unstable_point: Mapping[str, fmpq] | None
    reason: str


def largest_scaling(
    subject: Prototype | PolynomialFamily,
    box: Box,
    within: float = 0.02,
    budget: int = 4000,
    most: float = 10.0,
    numbers: bool = False,
) -> Scaling:
    """Draw the ranges of a box out until a member refutes it, and prove as much of that as can be.

    First the least factor is bracketed at which a member is found that is not stable. Then boxes a little smaller are
    tried, ever farther from it, until one is proved. Rigid ranges keep their size.

    Args:
        subject: a prototype with a controller, or any family.
        box: the tolerances at factor 1.
        within: how near to each other, relatively, the two factors should come.
        budget: most pieces to look at for each factor.
        most: largest factor to try.
        numbers: as of `rig_family`, where the figures of the member that refutes do not matter.

    Raises:
        ValueError: as `certify_box`.
    """
    family = rig_family(subject, varying=box.ranges, numbers=numbers) if isinstance(subject, Prototype) else subject
    limit = _limit(family, box, most)
    refuted, point, searched = _least_refuted(family, box, limit, within / 4)
    proved, verdict, above = fmpq(0), None, limit if refuted is None else refuted
    factor = limit if refuted is None else shortened(refuted * (1 - exact(within)), _DIGITS)
    for _ in while_time(range(_TRIES), lambda _: "the scaling as near as was asked"):
        if not above * (1 - exact(1.001 * within)) > proved or factor <= 0:
            break
        scaled = box.scaled(factor)
        found = certify_box(subject, scaled, budget, volumes=False, searched=factor <= searched, family=family)
        if found.stable:
            proved, verdict = factor, found
        else:
            above = factor
            if found.stable is False:
                refuted, point = factor, found.unstable_point
        if proved == limit:
            break
        factor = shortened((proved + above) / 2, _DIGITS)
    known = None if refuted is None else nearest(refuted)
    reason = _bracket(proved, above, refuted, limit)
    return Scaling(nearest(proved), known, nearest(limit), verdict, point, reason)


def scaling_of_each(
    subject: Prototype | PolynomialFamily, box: Box, within: float = 0.1, budget: int = 4000
) -> dict[str, Scaling]:
    """The same of each range by itself, the others staying as wide as they are; the first is the one to tighten first.

    Args:
        subject: as of `largest_scaling`, as what follows; the largest factor is 4.
        box: the tolerances at factor 1.
        within: see there.
        budget: see there.

    Raises:
        ValueError: as `certify_box`.
    """
    found = {
        name: largest_scaling(subject, replace(box, rigid=frozenset({*box.names} - {name})), within, budget, 4.0)
        for name in while_time([name for name in box.names if name not in box.rigid], lambda _: "some figures alone")
    }
    return dict(sorted(found.items(), key=lambda pair: (pair[1].proved, pair[1].refuted or inf)))


def _limit(family: PolynomialFamily, box: Box, most: float) -> fmpq:
    """The largest factor to try, beyond which a positive figure would reach zero, or nothing stand for an effect."""

    def stands(factor: fmpq) -> bool:
        try:
            box.scaled(factor)
        except InputError:
            return False
        return True

    limit = exact(most)
    for name, (low, _) in box.ranges.items():
        middle = box.nominal[name]
        if name in family.positive and name not in box.rigid and low < middle and middle > 0:
            limit = min(limit, middle / (middle - low) * fmpq(999, 1000))
    while not stands(limit):
        limit *= fmpq(9, 10)
    return shortened(limit, _DIGITS)


def _least_refuted(
    family: PolynomialFamily, box: Box, limit: fmpq, within: float
) -> tuple[fmpq | None, Mapping[str, fmpq] | None, fmpq]:
    """The least factor, about, at which a member is found that is not stable, that member, and where none was found."""

    def found(factor: fmpq) -> Mapping[str, fmpq] | None:
        return unstable_member(family.over(box.scaled(factor).ranges))

    low, high, point = fmpq(0), limit, found(limit)
    if point is None:
        return None, None, limit
    while high - low > exact(within) * high and high > limit / 1000 and not over():
        middle = shortened((low + high) / 2, _DIGITS)
        if (nearer := found(middle)) is not None:
            high, point = middle, nearer
        else:
            low = middle
    return high, point, low


def _bracket(proved: fmpq, above: fmpq, refuted: fmpq | None, limit: fmpq) -> str:
    low = decimal(nearest(proved), rounding=ROUND_FLOOR)
    high, least = (decimal(nearest(one), rounding=ROUND_CEILING) for one in (above, refuted or above))
    if proved == limit:
        return f"proved up to {low}, the largest factor that was tried"
    start = f"proved up to {low}" if proved > 0 else "no factor was proved"
    if refuted is None:
        return f"{start}, undecided at {high}; no member was found that is not stable"
    if above < refuted:
        return f"{start}, undecided at {high}, refuted at {least}"
    return f"{start}, refuted at {high}"


# The largest compliance with the servo off, which limits of the closed loop's are multiples of.


_ABOUT = 0.5, 2.0
"""About the nominal rig's peak, as shares of its frequency, the worst rig of a box is sought."""


def servo_off_over_box(prototype: Prototype, box: Box) -> tuple[float, Worst]:
    """The largest compliance with the servo off that a search finds over the rigs of a box, m/N, and that rig.

    Whatever it misses makes the figure less, and a limit that is a multiple of it stricter. The box need not have the
    same rig worst with the servo off as with it on: worst is compared with worst.

    Args:
        prototype: any controller does, as no part of it counts.
        box: ranges of its figures; those of the controller do not count.
    """
    idle = prototype.but(controller=Proportional(gain_A_per_V=1.0))
    asked = {**box.ranges, **box.performing}
    payloads = asked.get("outer_end_mass", (fmpq(0), fmpq(0)))
    low, high = map(nearest, payloads)
    found = family(idle, high)
    about = servo_off_of(found.members, prototype.payload.inner_end_mass_kg, (low, high))
    if about.compliance_m_per_N == inf:  # nothing damps it
        return inf, Worst(inf, {**box.nominal, "outer_end_mass": payloads[0]}, about.frequency_Hz)
    shape = rig_family(idle, claim=Asked("compliance", about.compliance_m_per_N), delayed=False, varying=box.ranges)
    ranges = {**asked, **performing_spans(found)}
    kept = {name: ends for name, ends in ranges.items() if name in shape.values and name in box.ranges}
    since, until = (exact(2 * pi * about.frequency_Hz * share) for share in _ABOUT)
    near = replace(shape, since=since, until=until)
    worst = worst_of(near.over({**kept, "controller_gain": (fmpq(0), fmpq(0))}))[0]
    return max(about.compliance_m_per_N, rounded_below(worst.ratio * about.compliance_m_per_N)), worst


# Between the ends of effects' frozen figures, which linear members stand at.


BUDGET = 4000


def between(prototype: Prototype, low_kg: float, high_kg: float) -> BoxVerdict | None:
    """Prove or refute stability for every value of every frozen figure, factor on the gain and outer end mass at once.

    None where there is no frozen figure, so that the members leave nothing open.

    Raises:
        InputError: for effects for which no linear loop stands.
        ValueError: without a controller.
    """
    found = family(prototype, high_kg)
    if not any(span.low < span.high for span in found.spans.values()):
        return None
    box = tolerance_box(prototype, 0.0, None, (low_kg, high_kg))
    few = rig_family(prototype, varying=box.ranges, numbers=True)
    return certify_box(prototype, box, BUDGET, volumes=False, family=few)
