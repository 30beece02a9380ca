"""The linear members of a prototype: a set of linear models that brackets it with its effects, one without any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import prod
from types import MappingProxyType

import numpy as np
from flint import fmpq

from beamdesign.plant.assembly import effect_parameters_of, wrong_effects
from beamdesign.plant.effects import Linear, Operation, Span, Spans, library
from beamdesign.plant.linear import LinearModel
from beamdesign.polynomial import exact, nearest, rounded_down, rounded_up
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure.lumped import figures, lumped_beam, weighing_mass

STANDARD_GRAVITY = 9.80665
"""m/s2; the load that a prototype is taken to carry is the weight of its largest outer end mass and the payload's
force."""


def own_sag_m(prototype: Prototype) -> float:
    """What its own weight and that of its added mass bend the inner beam of a link by that lies level, m."""
    mass = weighing_mass(prototype.inner_beam) + prototype.payload.inner_end_mass_kg
    return STANDARD_GRAVITY * mass / lumped_beam(prototype.inner_beam).stiffness


def bearable_travel_m(prototype: Prototype) -> float | None:
    """Travel of the inner tip at which its tube yields or a wall buckles, own sag included, m; None without sizes.

    As of a force at the tip, K x L being the moment at the clamp: f_o W_el, or the design resistance of EN 1999-1-1,
    6.2.5.1(2).
    """
    if (geometry := prototype.inner_beam.geometry) is None:
        return None
    alloy, tube, length = geometry
    strength = alloy.proof_strength_Pa
    moment = min(strength * tube.elastic_modulus, tube.bending_resistance(strength, alloy.buckling_constants))
    return float(moment / (lumped_beam(prototype.inner_beam).stiffness * length))


def weight_N(prototype: Prototype, payload_kg: float) -> float:
    """Weight of a payload and of the outer beam at the tip of a link that lies level, N."""
    return STANDARD_GRAVITY * (payload_kg + weighing_mass(prototype.outer_beam))


@dataclass(frozen=True)
class Interval:
    """Closed interval of factors on the loop gain."""

    low: float
    high: float


ONE = Interval(1.0, 1.0)


MOST_MEMBERS = 64
"""That a certificate states and its checker takes: twice what all effects with a law of their own come to."""

BEYOND = 0.03
"""Share of all payloads by which a law that is for some of them is stable beyond the heaviest."""


@dataclass(frozen=True)
class VertexModel:
    """One linear rig that stands for a prototype, with factors on its loop gain.

    Attributes:
        rig: its plant.
        gain: factors over which it is to be stable.
        performance: factors over which it is to perform, None where it only has to be stable.
        frozen: figures of its effects that are frozen at one end of their span, by effect.
    """

    rig: LinearModel
    gain: Interval = ONE
    performance: Interval | None = ONE
    frozen: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its frozen figures in words; empty for the only member."""
        return ", ".join(
            f"{effect}.{key} = {value:.6g}" for effect, t in self.frozen.items() for key, value in t.items()
        )


@dataclass(frozen=True)
class LinearFamily:
    """All linear members of a prototype.

    Attributes:
        members: at all ends of the spans of its effects.
        rest: the loop with everything at rest; its gain interval is a single factor, and it has no performance where
            claims about that are of others, as of friction while it slides, or of flows well beyond a dead band.
        spans: of the frozen figures, by EFFECT.FIGURE.
        load_N: largest steady force for which the spans are.
        depends_on_load: whether the spans would differ for another.
        gains: factors that effects put on the loop's gain, by effect.
    """

    members: tuple[VertexModel, ...]
    rest: VertexModel
    spans: Mapping[str, Span]
    load_N: float
    depends_on_load: bool = False
    gains: Mapping[str, Span] = field(default_factory=dict)


def refuse_unstated(prototype: Prototype, found: LinearFamily) -> None:
    """Refuse, before anything is proved, what no certificate states: too many members, or effects without elements.

    Raises:
        InputError: for more than `MOST_MEMBERS`, and for an effect whose laws its elements do not say.
    """
    linears = {name: linear_of(prototype, name) for name in prototype.effects}
    if nothing := [name for name, one in linears.items() if one and one.elements is None and one.laws != {}]:
        words = (
            "states no elements, from which a proof of it is checked, so that none is given; state `linear.elements`"
        )
        raise InputError(prototype.name, [Problem(f"effects.{name}", words) for name in nothing])
    if (count := len(found.members)) > MOST_MEMBERS:
        spanned = [key for key, span in found.spans.items() if span.low < span.high]
        words = f"freeze {', '.join(spanned)}, whose ends have {count} combinations, more than the {MOST_MEMBERS}"
        raise InputError(prototype.name, [Problem("effects", f"{words} that are proved; leave out what matters least")])


def served(
    prototype: Prototype, largest_kg: float, stage: tuple[tuple[float, float], tuple[float, float]] | None = None
) -> tuple[VertexModel, ...]:
    """Linear members that a law has to serve: its own payloads with performance, all payloads with stability.

    The second are members of their own: the same plants, their payload stretched from the law's range to the whole one
    and a little more, which only have to be stable.

    Args:
        prototype: with or without effects.
        largest_kg: as of `family`.
        stage: payloads (least, most) of the law, and all payloads; None where these are the same.

    Raises:
        InputError: as of `family`, and for more members than are proved.
    """
    found = family(prototype, largest_kg)
    refuse_unstated(prototype, found)
    own = found.members
    if stage is None:
        return own
    (low, high), (least, most) = stage
    factor = (1 + BEYOND) * (most - least) / (high - low)
    offset = least - factor * low
    stretched = [replace(one, rig=replace(one.rig, stretch=(offset, factor)), performance=None) for one in own]
    return (*own, *stretched)


def family(
    prototype: Prototype,
    largest_outer_end_mass: float | None = None,
    varying: Mapping[str, tuple[fmpq, fmpq]] = MappingProxyType({}),
) -> LinearFamily:
    """The linear members of a prototype; of spans of effects all that any rig within ranges of its figures has.

    Args:
        prototype: with or without effects.
        largest_outer_end_mass: kg, whose weight is the load where an effect depends on it; else that of the payload.
        varying: ranges of figures of the rig, in which spans are looked at.

    Raises:
        InputError: where an effect or a figure of it is unknown or out of bounds, or no linear loop can stand for it.
    """
    if wrong := wrong_effects(prototype):
        raise InputError(prototype.name, wrong)
    if largest_outer_end_mass is None:
        largest_outer_end_mass = (prototype.payload.outer_end_mass_kg or (0.0, 0.0))[1]
    load = largest_outer_end_mass * STANDARD_GRAVITY + (prototype.payload.largest_force_N or 0.0)
    own = effect_parameters_of(prototype)
    supply = own.get("pressure_dependent_flow", {}).get("supply_pressure_Pa", prototype.supply.pressure_Pa)
    lumped, filtered = figures(prototype), prototype.sensor.filter_Hz is not None
    sides = own.get("unequal_piston_areas", {}).get("asymmetry", 0.0)
    operation = Operation(lumped, load, supply, sides, "pressure_dependent_flow" in own)
    # Spans go one way with each figure that they see, so that the corners of their ranges have the extremes.
    seen = {name: {*map(nearest, varying[name])} for name in _OF_OPERATION if name in varying}
    corners = [replace(operation, figure=lumped | dict(zip(seen, at, strict=True))) for at in product(*seen.values())]
    spans: dict[tuple[str, str], Span] = {}
    gains: dict[str, Span] = {}
    linears = {name: linear for name in own if (linear := linear_of(prototype, name)) is not None}
    for name, parameters in own.items():
        if (linear := linears.get(name)) is None:
            wrong.append(Problem(f"effects.{name}", "no linear loop stands for this effect, so that nothing is proved"))
            continue
        try:
            spans |= {(name, key): _over(one, parameters, operation, corners) for key, one in linear.figures.items()}
            gains |= {name: _over(linear.gain, parameters, operation, corners)} if linear.gain else {}
        except ValueError as error:
            wrong.append(Problem(f"effects.{name}", str(error)))
    if wrong:
        raise InputError(prototype.name, wrong)
    kept = [name for name, linear in linears.items() if linear.laws != {}]
    whole = _outwards([(span.low, span.high) for span in gains.values()])
    performing = _outwards([span.performing for span in gains.values()])

    def member(values: Sequence[float], gain: Interval, performance: Interval | None) -> VertexModel:
        frozen: dict[str, dict[str, float]] = {}
        for (name, key), value in zip(spans, values, strict=True):
            frozen.setdefault(name, {})[key] = value
        effects = {name: own[name] | frozen.get(name, {}) for name in kept}
        rig = LinearModel(lumped, filtered, effects, rig=prototype.rig)
        performs = all(span.performs(value) for span, value in zip(spans.values(), values, strict=True))
        return VertexModel(rig, gain, performance if performs else None, frozen)

    ends = product(*(sorted({span.low, span.high}) for span in spans.values()))
    members = tuple(member(values, whole, performing) for values in ends)
    factor = float(np.prod([span.rest for span in gains.values()]))
    still = Interval(factor, factor)
    performs_still = all(span.performs(span.rest) for span in gains.values())
    rest = member([span.rest for span in spans.values()], still, still if performs_still else None)
    named = {f"{name}.{key}": span for (name, key), span in spans.items()}
    with_load = any(linear.with_load for linear in linears.values())
    return LinearFamily(members, rest, named, load, with_load, gains)


def linear_of(prototype: Prototype, name: str) -> Linear | None:
    """What stands for an effect in the proofs of a prototype, with what its controller hears."""
    return library()[name].beside(() if prototype.controller is None else prototype.controller.senses)


_OF_OPERATION = ("piston_area", "oil_stiffness", "outer_stiffness", "inner_stiffness")
"""Figures of the rig on which spans of effects depend."""


def _over(span: Spans, parameters: Mapping[str, float], nominal: Operation, corners: Sequence[Operation]) -> Span:
    """What a span comes to over several rigs, with the rest of the nominal one."""
    own, each = span(parameters, nominal), [span(parameters, at) for at in corners]
    least, most = (min(one.performing[0] for one in each), max(one.performing[1] for one in each))
    return Span(min(one.low for one in each), max(one.high for one in each), own.rest, (least, most))


def paper_model(prototype: Prototype) -> LinearModel:
    """The linear model of a prototype without effects, equations (7) to (18) of Zalucky and Hardt (1984).

    Raises:
        InputError: where the prototype carries effects, which these equations do not have.
    """
    why = "is not taken: this is worked out of the rig without effects alone, equations (7) to (18); remove it"
    if prototype.effects:
        raise InputError(prototype.name, [(f"effects.{name}", why) for name in prototype.effects])
    return family(prototype).rest.rig


def _outwards(spans: Sequence[tuple[float, float]]) -> Interval:
    """Products of the ends of ranges of factors, so rounded that the exact ones lie between."""
    least, most = (prod((exact(span[end]) for span in spans), start=fmpq(1)) for end in (0, 1))
    down, up = (rounded_down, rounded_up) if len(spans) > 1 else (nearest, nearest)
    return Interval(down(least), up(most))
