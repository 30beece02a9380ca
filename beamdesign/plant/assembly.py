"""Components joined at named ports to one right-hand side x' = f(t, x, u, p), with any set of effects.

A rig is a set of components (`RIGS`). Equations (7) to (16) of Zalucky and Hardt (1984) are what remains of the twin
beam with every effect off. A prototype gives the structure and the figures of its rig.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import log2, sqrt
from typing import Any

import casadi as ca

from beamdesign.bench_prototype import AnyPrototype
from beamdesign.plant.actuators import WithActuator
from beamdesign.plant.component import SAMPLED, Law, PortLaw
from beamdesign.plant.effects import Effect, Site, laws_of, library, problems
from beamdesign.plant.rigs import OUTPUTS, RIGS, TWIST, WALL_FIGURES
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure import lumped
from beamdesign.structure.arm import LEVER_FIGURES, lever_figures, off_axis

INPUTS = ("disturbance_N", "command_V", "sampled_current_A")
NO_CONTROLLER = Problem("controller", "missing; a simulation closes the loop")


@dataclass(frozen=True)
class Structure:
    """What decides the equations of a rig, as opposed to its figures.

    Attributes:
        controller: its equations, such as `LAG` or `SAMPLED` of `beamdesign.plant.component`; None leaves the rig's
            own, such as the open loop of a bench.
        filtered: whether the prototype's own low-pass filter follows the sensor.
        effects: names, sorted.
        rig: one of `RIGS`.
        own_share: of the model's own volts that its controller hears; the rest has to come with the command, from a
            record that the model is made to follow.
        wall: whether a wall stands before the outer tip.
        off_axis: whether the payload stands off the axis of an outer beam that twists, as in one plane of an arm.
    """

    controller: Law | None
    filtered: bool = False
    effects: tuple[str, ...] = ()
    rig: str = "twin_beam"
    own_share: float = 1.0
    wall: bool = False
    off_axis: bool = False


@dataclass(frozen=True)
class Assembly:
    """A rig's equations.

    Attributes:
        function: (t, x, u, p) to (x', y), a CasADi SX function.
        states: names of x.
        parameters: names of p: figures of the rig, those of the controller, then `EFFECT.PARAMETER`, then those of a
            wall.
        outputs: names of y.
        kinds: what decided the equations.
    """

    function: ca.Function
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    kinds: Structure
    outputs: tuple[str, ...] = OUTPUTS


@cache
def assemble(kinds: Structure) -> Assembly:
    """Join the components of a rig and its effects.

    Raises:
        KeyError: for an effect that is not in the library, or one that changes a port that does not exist.
    """
    return join(kinds, tuple(library()[name] for name in kinds.effects))


def join(kinds: Structure, effects: Sequence[Effect], outputs: Mapping[str, PortLaw] | None = None) -> Assembly:
    """Join the components of a rig and any effects, such as the linear members of others.

    Args:
        kinds: what else decides the equations.
        effects: joined in this order.
        outputs: what is recorded, where that is something else than of every rig of this kind.

    Raises:
        KeyError: for an effect that changes a port that does not exist.
        InputError: where a state or a figure of the controller or the actuator is called as another one of the rig.
    """
    law = kinds.controller
    rig = RIGS[kinds.rig].with_law(law)
    laws = rig.ports
    for effect in effects:
        for name in effect.laws:
            laws[name]
    states = rig.states + (("filtered_V",) if kinds.filtered else ()) + (TWIST if kinds.off_axis else ())
    states += law.states if law is not None else ()
    states += tuple(f"{effect.name}.{state}" for effect in effects for state in effect.states)
    parameters = rig.figures + (LEVER_FIGURES if kinds.off_axis else ())
    parameters += tuple(f"{e.name}.{q.name}" for e in effects for q in e.parameters)
    parameters += WALL_FIGURES if kinds.wall else ()
    reserved = () if kinds.filtered else ("filtered_V",)  # by which the rig knows that it has a filter
    if twice := [name for names in ((*states, *reserved), parameters) for name, n in Counter(names).items() if n > 1]:
        words = "is a name that the rig has already; a controller's law and an actuator need names of their own"
        raise InputError(kinds.rig, [Problem(name, words) for name in twice])
    x, u, p = (ca.SX.sym(name, len(names)) for name, names in (("x", states), ("u", INPUTS), ("p", parameters)))
    time = ca.SX.sym("t")
    state, figure, given = (
        dict(zip(names, ca.vertsplit(vector), strict=True))
        for names, vector in ((states, x), (parameters, p), (INPUTS, u))
    )

    port: dict[str, Any] = state | given  # effects may read any state of the rig
    sites = {one.name: Site(port, figure, _own(one.name, figure), _own(one.name, state), {}, time) for one in effects}
    for name, signal_of in laws.items():
        if name == "error_V" and kinds.own_share != 1.0:  # what a record brings with the command, taken out of it again
            port["command_V"] += (1 - kinds.own_share) * port["measured_V"]
        signal = signal_of(port, figure, state)
        for effect in effects:
            if name in effect.laws:
                signal = effect.laws[name](signal, sites[effect.name])
        port[name] = signal

    rate = rig.rates(port, figure, state)
    for effect in effects:
        rate |= {f"{effect.name}.{name}": value for name, value in sites[effect.name].rate.items()}
    outputs = rig.outputs if outputs is None else outputs
    output = [law(port, figure, state) for law in outputs.values()]
    found = [ca.vertcat(*(rate[name] for name in states)), ca.vertcat(*output)]
    function = ca.Function("rig", [time, x, u, p], found, ["t", "x", "u", "p"], ["rate", "y"])
    return Assembly(function, states, parameters, kinds, outputs=tuple(outputs))


def _own(effect: str, signals: Mapping[str, Any]) -> dict[str, Any]:
    prefix = effect + "."
    return {name.removeprefix(prefix): value for name, value in signals.items() if name.startswith(prefix)}


def structure_of(prototype: Prototype, sampled: bool = False) -> Structure:
    """What decides the equations of a prototype's rig.

    Args:
        prototype: with a controller, and with the effects its rig has.
        sampled: whether the controller is a sampled one, outside the equations.

    Raises:
        InputError: where an effect or one of its parameters is unknown or out of bounds, or without a controller.
    """
    law, wrong = prototype.controller, wrong_effects(prototype)
    if law is None or wrong:
        raise InputError(prototype.name, wrong if law is not None else [*wrong, NO_CONTROLLER])
    filtered, effects = prototype.sensor.filter_Hz is not None, tuple(sorted(prototype.effects))
    own = SAMPLED if sampled else law.equations
    return Structure(own, filtered, effects, prototype.rig, off_axis=off_axis(prototype))


def parameters_of(prototype: Prototype, outer_end_mass: float, inner_end_mass: float) -> dict[str, float]:
    """Parameters of the assembly in its order, SI: figures of the rig, of the controller and of its effects.

    Args:
        prototype: as for `structure_of`, which checks it.
        outer_end_mass: payload, kg.
        inner_end_mass: kg, added to the inner beam's tip.
    """
    controller = prototype.controller
    if controller is None:
        raise InputError(prototype.name, [NO_CONTROLLER])
    values = lumped.figures(prototype) | {
        "outer_end_mass": outer_end_mass,
        "inner_end_mass": inner_end_mass,
        "supply_pressure": prototype.supply.pressure_Pa,
        "believed_sensor_gain": prototype.sensor.gain_V_per_m,
        "gain": controller.gain_A_per_V,
        "pole": 1.0,
        "zero": 1.0,
    }
    return values | controller.figures() | lever_figures(prototype) | effect_figures(prototype)


def effect_figures(prototype: AnyPrototype) -> dict[str, float]:
    """Parameters of a prototype's effects by `EFFECT.PARAMETER`, in the order of the assembly."""
    own = effect_parameters_of(prototype)
    return {f"{name}.{key}": value for name, table in own.items() for key, value in table.items()}


def effect_parameters_of(prototype: AnyPrototype) -> dict[str, dict[str, float]]:
    """Parameters of a prototype's effects, sorted by name: as given, else the rig's own or the default."""
    own = of_rig(prototype)
    return {
        name: {
            q.name: float(prototype.effects[name].get(q.name, own.get(f"{name}.{q.name}", q.default)))
            for q in library()[name].parameters
        }
        for name in sorted(prototype.effects)
    }


def of_rig(prototype: AnyPrototype) -> dict[str, float]:
    """Figures of effects, by `EFFECT.PARAMETER`, that the rig itself gives where none is stated."""
    supply = "pressure_dependent_flow.supply_pressure_Pa"
    if isinstance(prototype, Prototype):
        return {supply: prototype.supply.pressure_Pa} | of_drive(prototype)
    cylinder = prototype.actuator
    return {supply: cylinder.supply_pressure_Pa, "unequal_piston_areas.asymmetry": cylinder.asymmetry}


def of_drive(prototype: WithActuator) -> dict[str, float]:
    """Usual figures of effects, by `EFFECT.PARAMETER`, where its drive gives them."""
    limits = prototype.actuator.usual_limits_A().items()
    return {f"{name}.limit_A": limit for effect, limit in limits for name in laws_of(effect)}


_PUBLISHED = {"outer_stiffness": 486800.0, "inner_mass": 1.6, "outer_mass": 3.9}  # N/m, kg
_PUBLISHED_PAYLOAD_KG = 6.8
_PUBLISHED_A_S_PER_M = 0.01  # piston area over flow gain
_BENCH_N, _BENCH_A_PER_V = 700.0, 1e-3  # of a bench: supply pressure times piston area, and of its amplifier


def natural_frequency_ratio(figures: Mapping[str, float]) -> float:
    """Natural frequency of the outer beam, of the figures of a rig, over that of the published one."""
    stiffness, mass = (figures[name] / _PUBLISHED[name] for name in ("outer_stiffness", "outer_mass"))
    return sqrt(stiffness / mass)


def pace(figures: Mapping[str, float]) -> float:
    """How many times as quick as that of the published rig an outer beam is, to a power of two: neighbours are alike.

    A rig whose stiffness is so many times squared, and whose valve, leakage and law are as quick, moves as that one
    does in so much less time.
    """
    return float(2.0 ** round(log2(natural_frequency_ratio(figures))))


def mass_unit_kg(figures: Mapping[str, float]) -> float:
    """How many times as heavy, likewise, with its end but without payload."""
    return float(2.0 ** round(log2(figures["outer_mass"] / _PUBLISHED["outer_mass"])))


def most_inside_kg(figures: Mapping[str, float], largest_outer_kg: float) -> float:
    """Most mass inside that is usually enough, kg: 6 of the published rig with its payloads of 6.8.

    Of a rig or of a payload that is so many times as heavy so many times that, to powers of two.
    """
    loaded = (figures["outer_mass"] + largest_outer_kg) / (_PUBLISHED["outer_mass"] + _PUBLISHED_PAYLOAD_KG)
    return 6.0 * max(mass_unit_kg(figures), float(2.0 ** round(log2(loaded))))


def widened(prototype: Prototype, low_Hz: float, high_Hz: float) -> tuple[float, float]:
    """A band of frequency that suits the published rig, for one that is quicker or slower: so much higher or lower."""
    times = pace(lumped.figures(prototype))
    return low_Hz * min(1.0, times), high_Hz * max(1.0, times)


def sizes(prototype: AnyPrototype) -> dict[str, float]:
    """How large a rig is over that of Zalucky and Hardt (1984), whose figures of effects are the usual ones.

    A rig of twice the forces, masses and flows moves as that one does under twice the load, and its seal rubs twice as
    much; one whose valve needs twice the current has twice the dead band in amperes.

    Returns:
        "force" of the actuator, "stiffness", "mass" and natural "frequency" of the beams, and "current" for a speed of
        the piston; 1 for what a rig does not have.
    """
    if not isinstance(prototype, Prototype):
        actuator = prototype.actuator
        force = actuator.supply_pressure_Pa * actuator.piston_area_m2 / _BENCH_N
        current = prototype.servovalve.amplifier_A_per_V / _BENCH_A_PER_V
        return {"force": force, "stiffness": 1.0, "mass": 1.0, "frequency": 1.0, "current": current}
    figures = lumped.figures(prototype)
    stiffness, mass = (figures[name] / _PUBLISHED[name] for name in ("outer_stiffness", "inner_mass"))
    force = prototype.actuator.strength_N(prototype) / prototype.actuator.usual_strength_N
    per_speed = figures["piston_area"] / figures["flow_gain"] if "flow_gain" in figures else _PUBLISHED_A_S_PER_M
    beams = {"stiffness": stiffness, "mass": mass, "frequency": natural_frequency_ratio(figures)}
    return {"force": force, **beams, "current": per_speed / _PUBLISHED_A_S_PER_M}


def wrong_effects(prototype: AnyPrototype) -> list[Problem]:
    """What is wrong with a prototype's effects: unknown, out of bounds, on what it does not have, impossible there."""
    known, rig = library(), RIGS[prototype.rig]
    found = problems(prototype.effects, sizes(prototype)) if prototype.effects else []
    for name in filter(known.__contains__, prototype.effects):
        if missing := [port for port in known[name].laws if port not in rig.ports]:
            words = f"{', '.join(missing)}, which the actuator bench"
            if rig.actuator is not None:
                words = f"what a rig with a {rig.actuator.model_fields['kind'].default}"
            found.append(Problem(f"effects.{name}", f"acts on {words} does not have"))
        elif off_axis(prototype) and _END_MASS in known[name].laws:
            found.append(Problem(f"effects.{name}", "is worked out for a payload on the axis; [arm] has it beside it"))
        elif isinstance(prototype, Prototype):
            own = {q.name: prototype.effects[name].get(q.name, q.default) for q in known[name].parameters}
            if reason := known[name].impossible(own, lumped.figures(prototype)):
                found.append(Problem(f"effects.{name}", reason))
    return found


_END_MASS = "outer_end_mass_N"


def suits(effect: str, prototype: Prototype) -> bool:
    """Whether a prototype's rig has what an effect acts on, its payload where that has it; true of one unknown."""
    return fits(effect, prototype.rig) and not (
        effect in library() and off_axis(prototype) and _END_MASS in library()[effect].laws
    )


def fits(effect: str, rig: str) -> bool:
    """Whether a rig has what an effect of the library acts on; true of an effect that is unknown."""
    return effect not in library() or library()[effect].laws.keys() <= RIGS[rig].ports.keys()
