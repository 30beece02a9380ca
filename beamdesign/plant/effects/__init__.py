"""Effects: laws at one or more ports of a rig, with their parameters, states and source; and the library of them.

Every file of this folder holds one, some with further laws of it; and there are laws to be learnt.
"""

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from math import pi
from pkgutil import iter_modules
from typing import Any, Literal, Self

import casadi as ca
from flint import fmpq

from beamdesign.code_digest import count_origin
from beamdesign.polynomial import exact
from beamdesign.records import Problem

TWO_PI = exact(2 * pi)
"""As it stands in the laws of the effects; a proof takes its decimal form as exact."""

QUICKEST = 1e4
"""1/s, of a deflection under friction."""
_FOLLOWING, _FORGETTING = 4e3, 1e-4  # 1/s, of a play

SUBSYSTEMS = ("structure", "oil", "actuator", "servovalve", "amplifier", "sensor", "controller")


@dataclass(frozen=True)
class Parameter:
    """One figure of an effect.

    Attributes:
        name: with its SI unit as a suffix where it has one.
        default: nominal magnitude, which a prototype that names the effect alone gets.
        low: least value that makes sense.
        high: largest value that makes sense.
        spread: prior standard deviation of the natural logarithm (of the value itself where `low` is not positive).
        meaning: in words, with where the magnitude comes from.
        size: of a rig, with which default, bounds and a spread of the value itself go, one of those that
            `beamdesign.plant.assembly.sizes` tells; empty where they are those of any rig.
    """

    name: str
    default: float
    low: float
    high: float
    spread: float
    meaning: str
    size: str = ""

    def of(self, sizes: Mapping[str, float]) -> Self:
        """The same of a rig with these sizes, each over that of the published rig."""
        factor = sizes[self.size] if self.size else 1.0
        spread = self.spread if self.low > 0 else factor * self.spread
        default, low, high = (factor * value for value in (self.default, self.low, self.high))
        return replace(self, default=default, low=low, high=high, spread=spread)


@dataclass
class Site:
    """What a law sees of the rig while it is assembled.

    Attributes:
        port: signals computed so far, by port name.
        figure: figures of the rig by name.
        parameter: the effect's own parameters.
        state: the effect's own states.
        rate: to be filled with the time derivative of each of them.
        time: s.
    """

    port: Mapping[str, Any]
    figure: Mapping[str, Any]
    parameter: Mapping[str, Any]
    state: Mapping[str, Any]
    rate: dict[str, Any]
    time: Any


Law = Callable[[Any, Site], Any]
"""From a port's signal without the effect, and the site, to its signal with it; in CasADi."""


@dataclass(frozen=True)
class Operation:
    """What the figures of an effect's linear members may depend on.

    Attributes:
        figure: lumped figures of the rig by name, as in `beamdesign.parameters.PARAMETERS`.
        load_N: largest steady force that the cylinder carries.
        supply_Pa: supply pressure.
        asymmetry: of the piston's sides, (A_a - A_b) / (A_a + A_b).
        orifices: whether the flows of the valve's ports go with the pressures there.
    """

    figure: Mapping[str, float]
    load_N: float
    supply_Pa: float
    asymmetry: float = 0.0
    orifices: bool = False

    @property
    def difference_Pa(self) -> float:
        """Of the supply pressure less this, half is the lowest pressure of a chamber at rest under the load.

        Without load unequal sides balance at pressures that differ by the asymmetry times the supply. A load adds its
        own difference: with orifices, which feed both chambers alike, the load pressure; else, the flow being that of
        the side that fills, up to (1 + a) / (1 + a^2) times it for the larger side, a being the size of the asymmetry.
        """
        size, load = abs(self.asymmetry), self.load_N / self.figure["piston_area"]
        return load * (1.0 if self.orifices else (1 + size) / (1 + size**2)) + size * self.supply_Pa


@dataclass(frozen=True)
class Span:
    """Values that a figure of a linear member takes.

    Attributes:
        low: least value.
        high: largest value.
        rest: value with everything at rest.
        performance: the part of the span over which more than stability is asked; all of it where None.
    """

    low: float
    high: float
    rest: float
    performance: tuple[float, float] | None = None

    @property
    def performing(self) -> tuple[float, float]:
        """The part of the span over which more than stability is asked."""
        return self.performance or (self.low, self.high)

    def performs(self, value: float) -> bool:
        """Whether a value lies there."""
        return self.performing[0] <= value <= self.performing[1]


Weights = Mapping[str, fmpq]
"""A motion: weights of coordinates, or of the points "tip", "rod" (of the cylinder), "base" (of both beams)."""


@dataclass(frozen=True)
class Elements:
    """Of what a linear member is made beside the rig's own parts, with its numbers, exact.

    The rig's coordinates are "first" (its outer beam's mode) and "inner"; any other name is one more, and the same one
    for all effects that give it. Those of several effects add up: impedances, points and polynomials one after the
    other, factors by multiplication.

    Attributes:
        impedances: motion, and spring (N/m), dashpot (N s/m) and mass (kg) that resist it.
        points: what is added to the motion of "tip", "rod" and "base", and "sensed" to what the sensor sees of the tip.
        oil: factor on the stiffness of the oil, or on stiffness and damping of a screw.
        spool: spring on the spool, relative to the pilot's.
        asymmetry: of the piston's sides, (A_a - A_b) / (A_a + A_b).
        volts: numerators and denominators in s, ascending, of what filters the sensor's volts.
    """

    impedances: tuple[tuple[Weights, tuple[fmpq, ...]], ...] = ()
    points: Mapping[str, Weights] = field(default_factory=dict)
    oil: fmpq = field(default_factory=lambda: fmpq(1))
    spool: fmpq = field(default_factory=fmpq)
    asymmetry: fmpq = field(default_factory=fmpq)
    volts: tuple[tuple[tuple[fmpq, ...], tuple[fmpq, ...]], ...] = ()


def limited(signal: Any, most: Any) -> Any:
    """A signal held between a figure and as much below zero."""
    return ca.fmin(ca.fmax(signal, -most), most)


def bounded(speed: Any) -> Any:
    """A rate, 1/s, that stays below `QUICKEST`, so that equations are no stiffer; it shows only where it is high."""
    return speed / ca.sqrt(1 + (speed / QUICKEST) ** 2)


def dahl_rate(speed: Any, deflection: Any) -> Any:
    """Rate of a deflection that settles at the direction of motion, as Dahl's friction does, 1/s.

    Args:
        speed: over the travel within which the deflection settles, 1/s; see `bounded`.
        deflection: of it, from -1 to 1.
    """
    speed = bounded(speed)
    return speed - ca.fabs(speed) * deflection


def play(signal: Any, threshold: Any, site: Site, left: str) -> Any:
    """What a play passes on of a signal: where it has been left, held between its two ends, which move with the signal.

    So without delay while it is pushed. What has been left there follows at a rate that shows only at reversals. It is
    counted from the signal, followed likewise by the state `followed`, so that whatever rests at any signal is at zero.
    Left alone, a play forgets slowly: in hours, but it makes of the many oscillations that idle plays would allow the
    one about zero.

    Args:
        signal: given to it.
        threshold: half the way from one end to the other, in the signal's unit.
        site: of an effect with the state `followed`.
        left: name of the state of this play.
    """
    tracked, before = site.state["followed"], site.state[left]
    site.rate["followed"] = _FOLLOWING * (signal - tracked)
    passed = ca.fmin(ca.fmax(tracked + before, signal - threshold), signal + threshold)
    site.rate[left] = _FOLLOWING * (passed - signal - before) - _FORGETTING * before
    return passed


Figures = Mapping[str, float]
Exact = Mapping[str, fmpq]
"""Figures by name, in floats or in rationals."""

ElementsOf = Callable[[Exact, Exact], Elements]
"""From an effect's parameters with its frozen figures, and figures of the rig, to the elements of a linear member."""

Spans = Callable[[Figures, Operation], Span]
"""From the effect's own parameters and the operation to a span."""


@dataclass(frozen=True)
class Linear:
    """The linear loops that stand for an effect in a proof: frozen values of what the effect lets vary.

    Attributes:
        covers: in words, which loops these are.
        leaves_out: in words, what of the effect they are not.
        laws: linear laws by port in place of the effect's own; None where its own laws are linear already, and empty
            where the loop is as it is without it but for a factor on its gain, if any.
        states: names of the states that these laws add.
        figures: spans of figures that these laws see beside the effect's parameters.
        gain: span of a factor on the loop gain; proofs hold for every value between its ends.
        with_load: whether spans depend on the load.
        elements: of what its members are made, for whoever checks a proof of them; it says the same as the laws. None
            where these add nothing to the loop (`laws` is empty); of others nothing is proved then.
        near_rest: what the members say wrongly of motion that is small against the effect: the compliance, where the
            rig follows none of those that perform; stability too, where it follows none at all.
        swings: whether a loop that is stable by these members may oscillate for good once it is pushed.
    """

    covers: str
    leaves_out: str = ""
    laws: Mapping[str, Law] | None = field(default=None, hash=False)
    states: tuple[str, ...] = ()
    figures: Mapping[str, Spans] = field(default_factory=dict, hash=False)
    gain: Spans | None = None
    with_load: bool = False
    elements: ElementsOf | None = field(default=None, hash=False)
    near_rest: Literal["", "compliance", "stability"] = ""
    swings: bool = False


def in_volts(linear: Linear) -> Linear:
    """The same with its factor on the gain frozen, and on the sensor's volts alone."""
    assert linear.gain is not None  # else there is no such factor
    return replace(
        linear,
        covers=f"{linear.covers}; here at either end, and on the volts alone, beside which the controller hears more",
        laws={"sensor_V": lambda signal, site: signal * site.parameter["factor"]},
        figures={"factor": linear.gain},
        gain=None,
        elements=lambda own, figure: Elements(volts=(((own["factor"],), (fmpq(1),)),)),
    )


@dataclass(frozen=True)
class Effect:
    """One departure from the linear rig.

    Attributes:
        name: as prototypes and diagnoses spell it.
        subsystem: one of `SUBSYSTEMS`.
        laws: by port, what replaces the signal there; see `beamdesign.plant.component.Rig.ports`.
        parameters: its figures.
        source: of the law.
        states: names of the states it adds, with units.
        memory: those of its states that stay where they are while nothing moves (friction); they start at 0.
        linear: what stands for it in proofs; None where nothing does.
        meaning: what it is; of one that the docstring of its file tells of, empty.
        realises: the effect of which this is another law, so that a diagnosis names that one; empty where it is itself.
        nearest: of a law that is learnt from data, the physics that it is like with its parameters, in words; None of
            an effect that is a cause by itself.
        scales: parameters that a diagnosis takes from the data, and the signal that each is the size of; empty for the
            length of the records.
        table: of a static law, what it adds over its local variable, by names with units; None of others.
        impossible: why its parameters cannot be of a rig with these figures, in words; empty where they can.
        unlike: why with these parameters, on a rig with these figures, it is rather something else that moves alike, in
            words; empty where it may be what it is called.
    """

    name: str
    subsystem: str
    laws: Mapping[str, Law] = field(hash=False)
    parameters: tuple[Parameter, ...]
    source: str
    states: tuple[str, ...] = ()
    memory: tuple[str, ...] = ()
    linear: Linear | None = None
    meaning: str = ""
    realises: str = ""
    nearest: Callable[[Figures], str] | None = field(default=None, hash=False)
    scales: Mapping[str, str] = field(default_factory=dict, hash=False)
    table: Callable[[Figures], Mapping[str, tuple[float, ...]]] | None = field(default=None, hash=False)
    impossible: Callable[[Figures, Figures], str] = field(default=lambda own, figure: "", hash=False)
    unlike: Callable[[Figures, Figures], str] = field(default=lambda own, figure: "", hash=False)

    def __post_init__(self) -> None:
        if self.subsystem not in SUBSYSTEMS:
            raise ValueError(f"{self.name}: no subsystem {self.subsystem}")

    def beside(self, sensors: Sequence[str]) -> Linear | None:
        """What stands for it in proofs with a law that hears these.

        A factor on the sensor's volts is one on the loop's gain only where the law hears nothing else.
        """
        linear = self.linear
        if linear is None or linear.gain is None or self.subsystem != "sensor" or len(sensors) < 2:
            return linear
        return in_volts(linear)


@cache
def library() -> dict[str, Effect]:
    """All effects by name, in alphabetical order: of each file `EFFECT`, which has its name, and other laws of it.

    Then the laws that are learnt from data.

    Raises:
        ValueError: where a file's name is not that of its effect.
    """
    found: dict[str, Effect] = {}
    learnt = import_module("beamdesign.plant.empirical")
    for module in sorted(iter_modules(__path__), key=lambda item: item.name):
        held = import_module(f"{__name__}.{module.name}")
        if held.EFFECT.name != module.name:
            raise ValueError(f"{module.name} holds the effect {held.EFFECT.name}")
        found |= {each.name: each for each in vars(held).values() if isinstance(each, Effect)}
    return dict(sorted(found.items())) | {effect.name: effect for effect in learnt.laws()}


def causes() -> dict[str, Effect]:
    """Those that are causes by themselves."""
    return {name: effect for name, effect in library().items() if effect.nearest is None}


def laws_of(*realised: str) -> tuple[str, ...]:
    """Some effects of the library with all further laws of theirs, in its order."""
    return tuple(name for name, effect in library().items() if name in realised or effect.realises in realised)


def register(effect: Effect) -> None:
    """Make one more effect known.

    Raises:
        ValueError: where there is one of that name.
    """
    if effect.name in library():
        raise ValueError(f"there is an effect {effect.name} already")
    library()[effect.name] = effect
    count_origin(library(), effect.name)


def problems(tables: Mapping[str, Mapping[str, float]], sizes: Mapping[str, float]) -> list[Problem]:
    """What is wrong with the `[effects.NAME]` tables of a prototype: unknown names, figures out of bounds.

    Bounds are those of the published rig and of one with these sizes, see `Parameter.of`, with all that lies between.
    """
    known, found = library(), []
    for name, table in tables.items():
        if name not in known:
            found.append(Problem(f"effects.{name}", "unknown effect" + _suggestion(name, list(known))))
            continue
        parameters = {parameter.name: parameter for parameter in known[name].parameters}
        for key, value in table.items():
            where = f"effects.{name}.{key}"
            if key not in parameters:
                found.append(Problem(where, "unknown parameter" + _suggestion(key, list(parameters))))
            else:
                both = parameters[key], parameters[key].of(sizes)
                low, high = min(q.low for q in both), max(q.high for q in both)
                if not low <= value <= high:
                    found.append(Problem(where, f"must be from {low:g} to {high:g}, is {value:g}"))
    return found


def _suggestion(word: str, known: list[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else f"; known are {', '.join(known)}"
