"""The box of a prototype's tolerances, end masses and delay."""

from collections.abc import Collection, Mapping
from math import pi

from flint import arb, fmpq

from beamdesign.members import family
from beamdesign.parameters import PARAMETERS, TOLERANCES, with_unit
from beamdesign.polynomial import exact
from beamdesign.proof.box import Box
from beamdesign.proof.rational import bounds, nearest, shortened
from beamdesign.proof.rig_family import effect_spans, rig_values
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem

_OF_LOOP = {
    "controller_gain": ("A/V", 1.0),
    "delay": ("s", 1.0),
}
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
    inner_end_mass: tuple[float, float] | None = None,
    delay_s: tuple[float, float] | None = None,
    spread: Mapping[str, float] | None = None,
) -> Box:
    """Ranges of the figures of a prototype: so many standard deviations to either side.

    A dashpot b = 2 zeta sqrt(K M) is a parameter of its own and spans all that its beam's damping ratio, stiffness and
    mass give within their tolerances. End masses and delay are ranges that are asked for: they do not scale with the
    tolerances, but a tolerance of an end mass widens its range. Nor do the spans of frozen figures of effects.

    Args:
        prototype: with a controller; its `tolerance` holds relative standard deviations.
        sigmas: how many standard deviations.
        names: which figures vary, as in `rig_values`; all that have a tolerance where it is None.
        outer_end_mass: kg; else the range of the payload, where there is one.
        inner_end_mass: kg; else the payload's one value.
        delay_s: pure delay in the loop, s.
        spread: relative standard deviations beside those of the prototype, such as {"controller_gain": 0.01}.

    Raises:
        InputError: for a figure without tolerance or that the rig does not have, or a range that reaches zero.
        ValueError: without a controller.
    """
    values = rig_values(prototype)
    deviations = {n: getattr(prototype.tolerance, key) for n, key in TOLERANCES.items() if n in values}
    if unknown := sorted((set(spread or {}) | set(names or ())) - set(values)):
        raise InputError("names", [Problem(name, f"no such figure; there are {', '.join(values)}") for name in unknown])
    deviations |= spread or {}
    part = {name: exact(sigmas) * exact(deviation) for name, deviation in deviations.items()}
    if wide := [name for name, share in part.items() if share >= 1 and values[name] > 0]:
        reason = "{:g} standard deviations of {:g} reach zero"
        raise InputError("tolerance", [Problem(n, reason.format(sigmas, deviations[n])) for n in wide])
    ranges = {name: (values[name] * (1 - share), values[name] * (1 + share)) for name, share in part.items()}
    for beam in ("outer", "inner"):
        if f"{beam}_damping" in values and f"{beam}_damping" not in (spread or {}):
            shares = [part[f"{beam}_{figure}"] for figure in ("stiffness", "mass", "damping")]
            ranges[f"{beam}_damping"] = _dashpot(values[f"{beam}_damping"], *shares)
    payload = prototype.payload.outer_end_mass_kg
    asked = {
        "outer_end_mass": outer_end_mass if outer_end_mass is not None else payload,
        "inner_end_mass": inner_end_mass,
        "delay": delay_s,
    }
    rigid = set()
    for name, pair in asked.items():
        if pair is not None:
            share = part.get(name, fmpq(0))
            ranges[name] = (exact(pair[0]) * (1 - share), exact(pair[1]) * (1 + share))
            rigid.add(name)
    largest = asked["outer_end_mass"]
    spans = effect_spans(family(prototype, None if largest is None else largest[1]))
    ranges |= spans
    rigid |= set(spans)
    chosen = [name for name in values if name in ranges and ranges[name][0] < ranges[name][1]]
    if names is not None:
        if fixed := sorted(set(names) - set(chosen)):
            raise InputError("names", [Problem(name, "has no tolerance and no range") for name in fixed])
        chosen = [name for name in chosen if name in names or name in rigid]
    nominal = [min(max(values[name], ranges[name][0]), ranges[name][1]) for name in chosen]
    lows, highs = ([ranges[name][side] for name in chosen] for side in (0, 1))
    return Box(tuple(chosen), tuple(lows), tuple(highs), tuple(nominal), frozenset(rigid & set(chosen)))


def _dashpot(value: fmpq, stiffness: fmpq, mass: fmpq, ratio: fmpq) -> tuple[fmpq, fmpq]:
    """Range of b = 2 zeta sqrt(K M), rounded outwards; the shares are those of K, M and zeta."""
    if (stiffness == 0 and mass == 0) or value == 0:
        return value * (1 - ratio), value * (1 + ratio)
    low = bounds(arb((1 - stiffness) * (1 - mass)).sqrt())[0] * (1 - ratio) * value
    high = bounds(arb((1 + stiffness) * (1 + mass)).sqrt())[1] * (1 + ratio) * value
    return shortened(low, 8), shortened(high, 8, up=True)


def in_units(point: Mapping[str, fmpq], names: Collection[str]) -> dict[str, float]:
    """Figures under their keys with units, as floats."""
    return {key: nearest(point[n]) / factor for n in names for key, factor in [figure_key(n)]}
