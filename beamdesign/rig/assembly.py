"""Components joined at named ports to one right-hand side x' = f(t, x, u, p), with any set of effects.

Equations (7) to (16) of Zalucky and Hardt (1984) are what remains of it with every effect off.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import casadi as ca

from beamdesign.rig import electronics, hydraulics, structure
from beamdesign.rig.effect import Site
from beamdesign.rig.effects import library
from beamdesign.rig.twin_beam import FIGURES, spool_acceleration

INPUTS = ("disturbance_N", "command_V", "sampled_current_A")
OUTPUTS = (
    "current_A",
    "displacement_m",  # the controller's input over the believed sensor gain
    "load_pressure_Pa",
    "inner_displacement_m",
    "outer_displacement_m",  # of the tip itself
    "measured_V",
)
MORE_FIGURES = ("supply_pressure", "believed_sensor_gain", "gain", "pole", "zero")
"""Figures beside those of the linear plant: Pa, V/m, A/V, rad/s, rad/s."""

STATES = (
    "outer_m",
    "outer_m_per_s",
    "inner_m",
    "inner_m_per_s",
    "pressure_a_Pa",
    "pressure_b_Pa",
    "flow_m3_per_s",
    "flow_m3_per_s2",
)

Signals = Mapping[str, Any]
PORTS: dict[str, Callable[[Signals, Signals, Signals], Any]] = {
    # structure: where the tips and their mount are
    "outer_tip_m": lambda port, figure, state: state["outer_m"],
    "outer_tip_m_per_s": lambda port, figure, state: state["outer_m_per_s"],
    "mount_m": lambda port, figure, state: 0.0,
    "mount_m_per_s": lambda port, figure, state: 0.0,
    "outer_reaction_N": structure.outer_reaction,
    "inner_reaction_N": structure.inner_reaction,
    "mount_force_N": lambda port, figure, state: port["outer_reaction_N"] + port["inner_reaction_N"],
    # sensor, controller, amplifier
    "sensed_m": lambda port, figure, state: port["outer_tip_m"],
    "sensor_V": lambda port, figure, state: figure["sensor_gain"] * port["sensed_m"],
    "measured_V": lambda port, figure, state: state.get("filtered_V", port["sensor_V"]),
    "error_V": lambda port, figure, state: port["command_V"] - port["measured_V"],
    "demanded_A": lambda port, figure, state: _controller(port, figure, state),
    "current_A": lambda port, figure, state: port["demanded_A"],
    # servovalve
    "spool_A": lambda port, figure, state: port["current_A"],
    "metered_m3_per_s": lambda port, figure, state: state["flow_m3_per_s"],
    "supply_pressure_Pa": lambda port, figure, state: figure["supply_pressure"],
    "orifice_a_m3_per_s": lambda port, figure, state: port["metered_m3_per_s"],
    "orifice_b_m3_per_s": lambda port, figure, state: port["metered_m3_per_s"],
    "leakage_a_m3_per_s": lambda port, figure, state: hydraulics.port_leakage(
        figure["leakage"], state["pressure_a_Pa"], port["supply_pressure_Pa"]
    ),
    "leakage_b_m3_per_s": lambda port, figure, state: hydraulics.port_leakage(
        figure["leakage"], state["pressure_b_Pa"], port["supply_pressure_Pa"]
    ),
    # cylinder and oil
    "area_a_m2": lambda port, figure, state: figure["piston_area"],
    "area_b_m2": lambda port, figure, state: figure["piston_area"],
    "bulk_ratio_a": lambda port, figure, state: 1.0,
    "bulk_ratio_b": lambda port, figure, state: 1.0,
    "rod_m_per_s": lambda port, figure, state: state["inner_m_per_s"],
    "stroke_m_per_s": lambda port, figure, state: port["outer_tip_m_per_s"] - port["rod_m_per_s"],
    "pressure_force_N": lambda port, figure, state: hydraulics.pressure_force(port, state),
    "friction_N": lambda port, figure, state: 0.0,
    "cylinder_force_N": lambda port, figure, state: port["pressure_force_N"] - port["friction_N"],
    # forces that move the tips
    "inner_force_N": lambda port, figure, state: -port["cylinder_force_N"],
    "outer_force_N": lambda port, figure, state: port["cylinder_force_N"] + port["disturbance_N"],
    "outer_end_mass_N": lambda port, figure, state: structure.end_mass_force(
        figure["outer_mass"], figure["outer_end_mass"], port["outer_force_N"] - port["outer_reaction_N"]
    ),
}
"""Law of every port with all effects off, in the order in which they are worked out."""


def _controller(port: Signals, figure: Signals, state: Signals) -> Any:
    if "slow_error_V" in state:
        return electronics.lag_current(
            figure["gain"], figure["pole"], figure["zero"], port["error_V"], state["slow_error_V"]
        )
    return port.get("sampled_current_A", figure["gain"] * port["error_V"])


@dataclass(frozen=True)
class Structure:
    """What decides the equations of a rig, as opposed to its figures.

    Attributes:
        controller: `lag` and `proportional` are continuous; with `sampled` the current is an input.
        filtered: whether the prototype's own low-pass filter follows the sensor.
        effects: names, sorted.
    """

    controller: Literal["lag", "proportional", "sampled"]
    filtered: bool = False
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Assembly:
    """A rig's equations.

    Attributes:
        function: (t, x, u, p) to (x', y), a CasADi SX function.
        states: names of x.
        parameters: names of p: figures of the linear plant, `MORE_FIGURES`, then `EFFECT.PARAMETER`.
        inputs: names of u.
        outputs: names of y.
        kinds: what decided the equations.
    """

    function: ca.Function
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    kinds: Structure
    inputs: tuple[str, ...] = INPUTS
    outputs: tuple[str, ...] = OUTPUTS


@cache
def assemble(kinds: Structure) -> Assembly:
    """Join the components of a rig and its effects.

    Raises:
        KeyError: for an effect that is not in the library, or one that changes a port that does not exist.
    """
    effects = [library()[name] for name in kinds.effects]
    for effect in effects:
        for name in effect.laws:
            PORTS[name]
    states = STATES + (("filtered_V",) if kinds.filtered else ())
    states += ("slow_error_V",) if kinds.controller == "lag" else ()
    states += tuple(f"{effect.name}.{state}" for effect in effects for state in effect.states)
    parameters = FIGURES + MORE_FIGURES + tuple(f"{e.name}.{q.name}" for e in effects for q in e.parameters)
    x, u, p = (ca.SX.sym(name, len(names)) for name, names in (("x", states), ("u", INPUTS), ("p", parameters)))
    time = ca.SX.sym("t")
    state, figure, given = (
        dict(zip(names, ca.vertsplit(vector), strict=True))
        for names, vector in ((states, x), (parameters, p), (INPUTS, u))
    )
    if kinds.controller != "sampled":
        del given["sampled_current_A"]

    port: dict[str, Any] = state | given  # effects may read any state of the rig
    sites = {
        effect.name: Site(port, figure, _own(effect.name, figure), _own(effect.name, state), {}, time)
        for effect in effects
    }
    for name, law in PORTS.items():
        signal = law(port, figure, state)
        for effect in effects:
            if name in effect.laws:
                signal = effect.laws[name](signal, sites[effect.name])
        port[name] = signal

    rate = _rates(port, figure, state)
    for effect in effects:
        rate |= {f"{effect.name}.{name}": value for name, value in sites[effect.name].rate.items()}
    output = {
        "current_A": port["current_A"],
        "displacement_m": port["measured_V"] / figure["believed_sensor_gain"],
        "load_pressure_Pa": state["pressure_a_Pa"] - state["pressure_b_Pa"],
        "inner_displacement_m": state["inner_m"],
        "outer_displacement_m": port["outer_tip_m"],
        "measured_V": port["measured_V"],
    }
    function = ca.Function(
        "rig",
        [time, x, u, p],
        [ca.vertcat(*(rate[name] for name in states)), ca.vertcat(*(output[name] for name in OUTPUTS))],
        ["t", "x", "u", "p"],
        ["rate", "y"],
    )
    return Assembly(function, states, parameters, kinds)


def _rates(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    """Time derivatives of the states that every rig has."""
    driving = port["outer_force_N"] - port["outer_reaction_N"] - port["outer_end_mass_N"]
    inner_mass = figure["inner_mass"] + figure["inner_end_mass"]
    into_a = port["orifice_a_m3_per_s"] - port["leakage_a_m3_per_s"] - port["area_a_m2"] * port["stroke_m_per_s"]
    into_b = port["area_b_m2"] * port["stroke_m_per_s"] - port["orifice_b_m3_per_s"] - port["leakage_b_m3_per_s"]
    stiffness_a, stiffness_b = (
        hydraulics.chamber_stiffness(
            figure["oil_stiffness"], figure["piston_area"], port[f"area_{side}_m2"], port[f"bulk_ratio_{side}"]
        )
        for side in "ab"
    )
    rate = {
        "outer_m": state["outer_m_per_s"],
        "outer_m_per_s": driving / figure["outer_mass"],
        "inner_m": state["inner_m_per_s"],
        "inner_m_per_s": (port["inner_force_N"] - port["inner_reaction_N"]) / inner_mass,
        "pressure_a_Pa": stiffness_a * into_a,
        "pressure_b_Pa": stiffness_b * into_b,
        "flow_m3_per_s": state["flow_m3_per_s2"],
        "flow_m3_per_s2": spool_acceleration(
            figure["valve_frequency"],
            figure["valve_damping_ratio"],
            figure["flow_gain"],
            port["spool_A"],
            state["flow_m3_per_s"],
            state["flow_m3_per_s2"],
        ),
    }
    if "filtered_V" in state:
        rate["filtered_V"] = electronics.low_pass_rate(
            figure["filter_frequency"], port["sensor_V"], state["filtered_V"]
        )
    if "slow_error_V" in state:
        rate["slow_error_V"] = electronics.low_pass_rate(figure["pole"], port["error_V"], state["slow_error_V"])
    return rate


def _own(effect: str, signals: Signals) -> dict[str, Any]:
    prefix = effect + "."
    return {name.removeprefix(prefix): value for name, value in signals.items() if name.startswith(prefix)}
