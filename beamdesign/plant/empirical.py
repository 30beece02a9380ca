"""Laws learnt from data: what stands at a port of a rig for a cause that no effect of the library is.

Each adds to a port's signal a function of a local variable: a static curve, loops, dynamics, a slow change. They are
effects like any other, named `empirical_PORT_LAW`. Those of their parameters that say for which size of motion they
stand (`reach`, `size`) a diagnosis takes from the data, and fits the others.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import pi
from typing import Any

import casadi as ca
from flint import fmpq

from beamdesign.plant import effects
from beamdesign.plant.effects import Effect, Elements, Exact, Figures, Law, Linear, Operation, Parameter, Site, Span
from beamdesign.plant.effects.valve_hysteresis import MAGNETIC
from beamdesign.plant.learnt_places import PLACES, Place, Signal

_USUAL = {"m": 1e-3, "N": 500.0, "m_per_s": 0.1, "Pa": 5e6, "m3_per_s": 5e-5, "A": 5e-3, "V": 1.0}
"""Sizes that a prototype which names a law alone gets."""
_TERMS = {"odd_square": "u |u|", "cube": "u^3", "square": "u^2", "one_sided": "|u|"}
_ODD, _CUBE, _EVEN, _SIDED = _TERMS
_POINTS = 10  # of a curve's table, to either side
_FURTHEST = 2.0  # of the reach: beyond, where no data were, a curve is level
_WIDTHS = {"narrow": 0.1, "wide": 0.5}  # of the reach: what the deflection of a loop settles within


def laws() -> tuple[Effect, ...]:
    """All laws at all places."""
    return tuple(_KINDS[kind][0](place, kind) for place in PLACES for kind in place.laws)


Like = str | Callable[[Figures], str]
"""What a law is like with its parameters, in words: a template that takes them, or a function."""


def _effect(
    place: Place, kind: str, law: Law, parameters: tuple[Parameter, ...], linear: Linear | None, like: Like, **more: Any
) -> Effect:
    """An effect of what a law adds at its place, with what more fields of it there are."""

    def at(sign: int) -> Law:
        return lambda signal, site: signal + sign * law(signal, site)

    return Effect(
        name=f"empirical_{place.name}_{kind}",
        subsystem=place.subsystem,
        laws={port: at(sign) for port, sign in place.ports.items()},
        parameters=parameters,
        meaning=f"{_KINDS[kind][1]} at the port {place.name.replace('_', ' ')}, learnt from the records of a rig.",
        source="no law of physics",
        linear=linear,
        realises=f"empirical:{place.name}",
        nearest=like.format_map if isinstance(like, str) else like,
        **more,
    )


def _scale(name: str, of: tuple[str, str], words: str) -> tuple[Parameter, dict[str, str]]:
    """A parameter that is taken from the data, and the signal that it is the size of."""
    unit, signal = of
    return Parameter(f"{name}_{unit}", _USUAL[unit], 1e-15, 1e12, 0.5, words), {f"{name}_{unit}": signal}


def _slope(
    place: Place, words: str, leaves_out: str, span: Callable[[Figures], Span], of: Signal | None = None
) -> Linear | None:
    """What stands for a law by its slopes: springs or dashpots from the least to the largest, or factors on the gain.

    Args:
        place: of the law.
        words: what the slopes are of.
        leaves_out: of the effect.
        span: slopes, of what is added over what it is a function of.
        of: that, where the place has a motion.
    """
    # Nothing that proofs are made of leaks; and the motor's demand has the drive's own speed feedback in it.
    if len(place.ports) > 1 or place.name == "motor_demand":
        return None
    if place.motion is None or of is None:

        def gain(own: Figures, at: Operation) -> Span:
            found = span(own)
            if found.low <= -1:
                raise ValueError("it takes all of the loop's gain within its reach")
            return Span(1 + found.low, 1 + found.high, 1 + found.rest)

        return Linear(f"{words}, as a factor on the gain", leaves_out, laws={}, gain=gain)
    motion, (port,), dashpot = place.motion, place.ports, place.dashpot and of is place.argument[0]
    key, before = ("slope_N_s_per_m", (fmpq(0),)) if dashpot else ("slope_N_per_m", ())
    return Linear(
        f"{words}, as a {'dashpot' if dashpot else 'spring'}",
        leaves_out,
        laws={port: lambda signal, site: signal + site.parameter[key] * of(signal, site)},
        figures={key: lambda own, at: span(own)},
        elements=lambda own, figure: Elements(((motion, (*before, own[key])),)),
    )


def _between(*slopes: float) -> Span:
    """From the least to the largest slope, with none at rest."""
    return Span(min(slopes), max(slopes), 0.0)


def _curve(place: Place, kind: str) -> Effect:
    argument, *of = place.argument
    reach, read = _scale("reach", (of[0], of[1]), "size of the local variable in the data, u = 1")
    size, sized = _scale("size", place.size, "size of the port's own signal in the data")

    def law(signal: Any, site: Site) -> Any:
        u = effects.limited(argument(signal, site) / site.parameter[reach.name], _FURTHEST)
        return site.parameter[size.name] * curve(site.parameter, u)

    def slopes(own: Figures) -> Span:
        return _between(*(slope * own[size.name] / own[reach.name] for slope in _slopes(own)))

    def nearest(own: Figures) -> str:
        odd, even = own[_ODD] + own[_CUBE], own[_EVEN] + own[_SIDED]
        return place.like[2 if abs(even) > abs(odd) else int(odd > 0)]

    terms = (Parameter(term, 0.0, -30.0, 30.0, 0.3, f"of the size, times {u}") for term, u in _TERMS.items())

    def table(own: Figures) -> Mapping[str, tuple[float, ...]]:
        places = [k / _POINTS for k in range(-_POINTS, _POINTS + 1)]
        added = tuple(float(own[size.name] * curve(own, u)) for u in places)
        return {of[1]: tuple(own[reach.name] * u for u in places), f"added_{place.size[0]}": added}

    words = "every slope of the curve within its reach"
    linear = _slope(place, words, "motion beyond the reach", slopes, argument)
    return _effect(place, kind, law, (*terms, reach, size), linear, nearest, scales=read | sized, table=table)


def curve(own: Mapping[str, Any], u: Any) -> Any:
    """Sum of the terms of a curve at u, of the size."""
    return own[_ODD] * u * ca.fabs(u) + own[_CUBE] * u**3 + own[_EVEN] * u**2 + own[_SIDED] * ca.fabs(u)


def over_reach(own: Figures, share: float) -> dict[str, float]:
    """The terms of the same curve over a share of its reach."""
    powers = {_ODD: 2, _CUBE: 3, _EVEN: 2, _SIDED: 1}
    return {term: own[term] * share**power for term, power in powers.items()}


def _slopes(own: Figures) -> list[float]:
    """The least and the largest slope of a curve within its reach among others; either side of 0 has a parabola."""
    found = []
    for side in (1, -1):
        constant, linear, square = own[_SIDED] * side, 2 * (own[_ODD] * side + own[_EVEN]), 3 * own[_CUBE]
        turn = -linear / (2 * square) if square else 0.0
        places = (0.0, float(side), *((turn,) if 0 < turn * side < 1 else ()))
        found += [constant + linear * u + square * u**2 for u in places]
    return found


def _loop(place: Place, kind: str) -> Effect:
    assert place.travel is not None  # else it takes none
    travel, rate, unit, signal = place.travel
    reach, read = _scale("reach", (unit, signal), "size of the travel in the data")
    size, sized = _scale("size", place.size, "size of the port's own signal in the data")

    def law(signal: Any, site: Site) -> Any:
        own, added = site.parameter, 0.0
        for name, width in _WIDTHS.items():
            site.rate[name] = effects.dahl_rate(rate(signal, site) / (width * own[reach.name]), site.state[name])
            added += own[name] * site.state[name]
        return own[size.name] * added

    def slopes(own: Figures) -> Span:
        """At most twice that at rest, where deflections are turned back from full."""
        slope = sum(own[name] / width for name, width in _WIDTHS.items()) * own[size.name] / own[reach.name]
        return Span(0.0, 2 * slope, slope, (0.0, 0.0))

    words = "the loops from none while they slide to their stiffest after a reversal, performance while they slide"
    linear = _slope(place, words, "stick-slip", slopes, travel)
    assert linear is not None  # there is a motion
    heights = (
        Parameter(name, 0.05, 0.0, 3.0, 0.2, f"height over the size of a loop that turns over in {w:g} of the reach")
        for name, w in _WIDTHS.items()
    )
    own, parameters = tuple(_WIDTHS), (*heights, reach, size)
    words = "friction" if place.dashpot else "friction between layers, or of a cable"
    near = replace(linear, near_rest="compliance")
    return _effect(place, kind, law, parameters, near, words, states=own, memory=own, scales=read | sized)


def _play(place: Place, kind: str) -> Effect:
    """A share that comes after a play. It differs from the loops of a spring: nothing is felt before it is through."""
    size, sized = _scale("size", place.size, "size of the port's own signal in the data")

    def law(signal: Any, site: Site) -> Any:
        own = site.parameter
        return own["held_share"] * (effects.play(signal, own["half_width"] * own[size.name], site, "left") - signal)

    parameters = (
        Parameter("half_width", 0.03, 1e-4, 1.0, 1.2, "half the way through the play, over the size"),
        Parameter("held_share", 0.8, 0.05, 0.98, 0.5, "of the signal that the play holds back"),
        size,
    )
    like = f"a {place.name} that sticks: it follows only after {{half_width:.1%}} of its range"
    states = ("followed", "left")
    return _effect(place, kind, law, parameters, MAGNETIC.linear, like, states=states, memory=states[1:], scales=sized)


def _lag(place: Place, kind: str) -> Effect:
    """A share that comes late. Of a spring: a part that relaxes (Zener's solid)."""
    argument = place.argument[0]

    def law(signal: Any, site: Site) -> Any:
        late, value = site.state["late"], argument(signal, site)
        site.rate["late"] = 2 * pi * site.parameter["break_Hz"] * (value - late)
        of = site.figure[place.stiffness] if place.stiffness else -1
        return of * site.parameter["share"] * (value - late)

    def elements(own: Exact, figure: Exact) -> Elements:
        w, share = effects.TWO_PI * own["break_Hz"], own["share"]
        if place.motion is None:
            return Elements(volts=(((w, 1 - share), (w, fmpq(1))),))
        spring = figure[place.stiffness] * share
        late = f"{place.name}_late"
        return Elements((({**place.motion, late: fmpq(-1)}, (spring,)), ({late: fmpq(1)}, (fmpq(0), spring / w))))

    # A lag of what goes to the valve is none of what all sensors of a law say, which is all that elements know.
    linear = Linear("as it is", elements=elements) if place.name == "sensor" or place.motion is not None else None
    what, whole, words = "a lag", "signal", "of the signal that comes late"
    if place.stiffness:
        what, whole, words = "material that relaxes", "beam", "of the beam's stiffness, in series with a dashpot"
    parameters = (
        Parameter("share", 0.1, -0.45, 1.5, 0.2, words),
        Parameter("break_Hz", 30.0, 0.2, 2000.0, 1.2, "of the lag", "frequency"),
    )
    like = f"{what} at {{break_Hz:.3g}} Hz, {{share:.0%}} of the {whole}"
    return _effect(place, kind, law, parameters, linear, like, states=("late",))


def _appendage(place: Place, kind: str) -> Effect:
    assert place.travel is not None  # else it takes none
    assert place.motion is not None
    (travel, rate), beam = place.travel[:2], place.name.removesuffix("_force")

    def law(signal: Any, site: Site) -> Any:
        own, state, w = site.parameter, site.state, 2 * pi * site.parameter["frequency_Hz"]
        apart, opening = travel(signal, site) - state["at_m"], rate(signal, site) - state["at_m_per_s"]
        pull = w**2 * apart + 2 * own["damping_ratio"] * w * opening
        site.rate["at_m"], site.rate["at_m_per_s"] = state["at_m_per_s"], pull
        return own["mass_kg"] * pull

    def elements(own: Exact, figure: Exact) -> Elements:
        w, mass, swings = effects.TWO_PI * own["frequency_Hz"], own["mass_kg"], f"{place.name}_appendage"
        tied = (mass * w**2, 2 * own["damping_ratio"] * w * mass)
        return Elements((({**motion, swings: fmpq(-1)}, tied), ({swings: fmpq(1)}, (fmpq(0), fmpq(0), mass))))

    motion = place.motion
    parameters = (
        Parameter("mass_kg", 0.1, 1e-3, 20.0, 1.2, "of what swings on the tip", "mass"),
        Parameter("frequency_Hz", 40.0, 2.0, 500.0, 0.8, "of it with the tip held", "frequency"),
        Parameter("damping_ratio", 0.03, 1e-3, 1.0, 0.8, "of it with the tip held"),
    )

    linear = Linear("as it is", elements=elements)
    like = f"a mass of {{mass_kg:.2g}} kg that swings on the {beam} beam at {{frequency_Hz:.3g}} Hz"
    return _effect(place, kind, law, parameters, linear, like, states=("at_m", "at_m_per_s"))


def _resonance(place: Place, kind: str) -> Effect:
    def law(signal: Any, site: Site) -> Any:
        own, state, w = site.parameter, site.state, 2 * pi * site.parameter["frequency_Hz"]
        apart = signal - state["seen"]
        site.rate["seen"] = state["seen_per_s"]
        site.rate["seen_per_s"] = w**2 * apart - 2 * own["damping_ratio"] * w * state["seen_per_s"]
        return -own["share"] * apart

    def elements(own: Exact, figure: Exact) -> Elements:
        w, kept = effects.TWO_PI * own["frequency_Hz"], 1 - own["share"]
        below = (w**2, 2 * own["damping_ratio"] * w, fmpq(1))
        return Elements(volts=(((w**2, kept * below[1], kept), below),))

    parameters = (
        Parameter("share", 0.5, -1.0, 1.0, 0.4, "of the signal that passes the resonance"),
        Parameter("frequency_Hz", 200.0, 20.0, 1500.0, 0.8, "of the resonance", "frequency"),
        Parameter("damping_ratio", 0.03, 1e-3, 1.0, 0.8, "of the resonance"),
    )

    linear, like = Linear("as it is", elements=elements), f"a resonance of the {place.name} at {{frequency_Hz:.3g}} Hz"
    return _effect(place, kind, law, parameters, linear, f"{like}, as of its holder", states=("seen", "seen_per_s"))


def _droop(place: Place, kind: str) -> Effect:
    size, sized = _scale("size", place.size, "size of the port's own signal in the data")

    def law(signal: Any, site: Site) -> Any:
        own = site.parameter
        site.rate["used"] = own["rate_per_s"] * (ca.fabs(signal) / own[size.name] - site.state["used"])
        return -own["depth"] * site.state["used"] * signal

    parameters = (
        Parameter("depth", 0.05, -0.5, 0.9, 0.2, "share lost under a steady signal of the size"),
        Parameter("rate_per_s", 10.0, 0.1, 1000.0, 1.2, "at which it is lost, and comes back", "frequency"),
        size,
    )
    words, left = "no loss, to that of a steady signal of the size", "what the loss does while it changes"
    linear = _slope(place, words, left, lambda own: _between(0.0, -own["depth"]))
    like = "a supply that droops under flow"
    found = _effect(place, kind, law, parameters, linear, like, states=("used",), scales=sized)
    return replace(found, subsystem="oil")  # which the supply belongs to


def _drift(place: Place, kind: str) -> Effect:
    def law(signal: Any, site: Site) -> Any:
        return site.parameter["change_per_s"] * site.time * signal

    meaning = "relative change of the gain in time, from the start on"
    change = Parameter("change_per_s", 0.02, -5.0, 5.0, 0.3, meaning, "frequency")
    within = Parameter("within_s", 4.0, 1e-3, 1e6, 0.5, "length of the records")
    words, left = "every gain from start to end of a record", "longer runs, and what the change does while it goes on"
    linear = _slope(place, words, left, lambda own: _between(0.0, own["change_per_s"] * own["within_s"]))
    like = "a gain that drifts, as by oil or electronics that warm up"
    return _effect(place, kind, law, (change, within), linear, like, scales={within.name: ""})


_KINDS = {
    "curve": (_curve, "A static curve"), "loop": (_loop, "Two loops of friction"), "play": (_play, "A play"),
    "lag": (_lag, "A share that comes late"), "appendage": (_appendage, "A mass on a spring"),
    "resonance": (_resonance, "A share that passes a resonance"),
    "droop": (_droop, "A loss that follows the signal's size"), "drift": (_drift, "A gain that changes in time"),
}  # fmt: skip
"""What makes the effect of a kind at a place, and what it is."""
