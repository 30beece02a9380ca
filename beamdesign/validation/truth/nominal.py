"""Figures of rigs as their designers believe them, and of the rig that is there: every tolerated one a little off."""

from collections.abc import Mapping
from math import exp, pi, sqrt
from typing import Any

import numpy as np

from beamdesign.validation.truth import arm
from beamdesign.validation.truth.beams import at_end, outer_modes
from beamdesign.validation.truth.effects import Shape, rounded

MODES = 4
"""Most bending modes of the outer beam that the equations carry."""

FIGURES: dict[str, float] = {
    # masses and springs of the beams, SI
    "inner_stiffness": 157500.0,
    "inner_mass": 1.6,
    "inner_damping": 50.0,
    "outer_end_mass": 0.0,
    "inner_end_mass": 0.0,
    "hardening": 0.0,  # 1/m2: stiffness grows by this times the square of the bending
    "loss_1": 0.0,  # N/m, springs of the relaxing elements that make structural damping
    "loss_2": 0.0,
    "loss_3": 0.0,
    "loss_4": 0.0,
    "cable": 0.0,  # N/m, of a spring that pulls on one side of the outer tip's place at rest
    "appendage_mass": 0.0,  # kg, of what swings on a tip
    "appendage_rate": 100.0,  # rad/s
    "appendage_damping_ratio": 0.02,
    "appendage_inner": 0.0,  # 1 where it is the inner tip
    "slosh_share": 0.0,  # of the payload that is free to move
    "slosh_frequency": 60.0,  # rad/s
    "slosh_damping_ratio": 0.05,
    # mount: turning (counted at the outer tip) and sliding
    "mount_on": 0.0,
    "mount_stiffness": 1e9,
    "mount_mass": 100.0,
    "mount_damping": 0.0,
    "mount_inner_ratio": 1.0,  # length of the inner beam over that of the outer
    "slide_stiffness": 1e12,
    "slide_mass": 300.0,
    "slide_damping": 0.0,
    "sensor_on_mount": 0.0,  # share of the mount's motion that the sensor's reference takes part in
    # joint
    "joint_on": 0.0,
    "play": 0.0,
    "contact": 2e10,  # N/m^1.5
    "contact_loss": 0.2,  # s/m, Hunt and Crossley
    "rod_mass": 0.3,
    # cylinder and oil
    "area_a": 1.13e-4,
    "area_b": 1.13e-4,
    "metering": 0.0,  # 0: the valve meters what goes in; 1: both edges, as orifices without load
    "bulk_modulus": 1.3e9,
    "chamber_length": 0.0226,  # m, volume of each chamber at rest over its area
    "stroke_on": 0.0,  # whether the volumes go with the stroke
    "air_share": 0.0,  # free air at one atmosphere over the volume
    "air_exponent": 1.2,
    "air_saturation": 2e8,  # Pa, all air dissolved above this (Henry)
    "drag": 0.0,  # N s2/m2, of the square of the stroke's speed
    "squeezed": 0.0,  # N/Pa, sliding friction per load pressure; N/N of a screw
    "squeezed_speed": 1e-3,  # m/s, over which it turns round
    "bristle_stiffness": 0.0,  # N/m; 0 takes the seal away
    "bristle_damping": 0.0,  # N s/m
    "coulomb": 0.0,
    "breakaway": 0.0,  # N, at least `coulomb`
    "stribeck_speed": 0.01,
    "stribeck_power": 2.0,
    "viscous": 0.0,
    # motor and ball screw in the place of cylinder and valve
    "lead": 0.0,  # m/rad; 0 is a cylinder
    "screw_stiffness": 8e7,
    "screw_damping": 600.0,
    "lost_motion": 0.0,  # m, of the nut from flank to flank
    "torque_constant": 1.2,
    "torque_drift": 0.0,  # relative, from start to end of the record
    "torque_ripple": 0.0,  # relative
    "ripple_per_turn": 36.0,
    "rotor_inertia": 8e-4,
    "rotor_friction": 5e-3,
    "speed_feedback": 0.5,
    "current_loop": 6283.0,  # rad/s
    "motor_limit": 0.0,  # A, of what the loop of the motor's own current is asked for; 0 is none
    "motor_knee": 10.0,
    # servovalve
    "flow_gain": 0.0113,
    "valve_frequency": 942.5,
    "valve_damping_ratio": 0.5,
    "leakage": 3.8e-13,
    "leakage_growth": 0.0,  # 1/Pa: leakage across the piston that grows with the load pressure
    "warming": 0.0,  # relative fall of the bulk modulus from start to end of the record; leakage doubles at a tenth
    "leakage_across": 0.5,  # share of the leakage that crosses the piston
    "supply": 20e6,
    "orifice": 0.0,  # 0: flow of a current whatever the load; 1: orifice law
    "laminar": 2e4,  # Pa, below which orifice flow is laminar
    "overlap": 0.0,  # A
    "overlap_rounding": 0.1,  # over the overlap
    "spool_friction": 0.0,  # A, Bouc-Wen
    "spool_travel": 1e-4,  # A, over which it builds up
    "spool_sharpness": 1.5,
    "magnet_width": 0.0,  # A, widest of the play operators
    "magnet_share": 0.0,  # of the current that goes through them
    "sag_droop": 0.0,  # Pa per m3/s: what the pump loses to flow
    "sag_rate": 0.0,  # 1/s; 0 takes the droop away
    "flow_drift": 0.0,  # relative, from start to end of the record
    # sensor
    "sensor_gain": 1180.0,
    "believed_sensor_gain": 1180.0,
    "filter_rate": 0.0,  # rad/s, the believed filter; 0 is none
    "lag_rate": 0.0,  # rad/s; 0 is none
    "lag_order": 1.0,
    "lag_damping_ratio": 0.8,
    "sensor_drift": 0.0,
    "sensor_cubic": 0.0,  # 1/m2
    "sensor_square": 0.0,  # 1/m
    "sensor_play": 0.0,  # m
    "bracket_rate": 0.0,  # rad/s, resonance of what holds the sensor; 0 is none
    "bracket_damping_ratio": 0.02,
    "bracket_share": 1.0,
    "dropouts_per_s": 0.0,
    "dropout_s": 0.02,
    # controller and amplifier
    "gain": 0.01,
    "law_order": 0.0,
    "delay": 0.0,  # s
    "current_limit": 0.0,  # A; 0 is none
    "current_knee": 10.0,
    "coil_rate": 0.0,  # rad/s; 0 is none
    "current_step": 0.0,  # A, of the digital output; 0 is none
    "current_hold": 0.0,  # s, its sampling interval
    "hum": 0.0,  # V
    "hum_rate": 314.159,
    "hum_phase": 0.0,
}
"""Names and values of a rig with nothing but the believed physics; the published rig's figures."""

LAW_ORDER = 12
"""Most states of a controller."""
HEARD = ("displacement_m", "inner_displacement_m", "load_pressure_Pa", "command_V")
"""What a controller may hear: the error in V, less the inner tip's place, less the load pressure; and its command."""
RECORD = np.dtype([*((name, "f8") for name in FIGURES), ("law", "f8", (LAW_ORDER + 1, LAW_ORDER + len(HEARD)))])


def packed(given: Mapping[str, Any]) -> np.ndarray:
    """One record of all figures, those not given as in `FIGURES`.

    The key `law` is for the controller of unit gain: (n + 1, n + h) rows of z' = a z + b e, then that of c z + d e, e
    the first h of `HEARD`. Without it the law is e itself.

    Raises:
        KeyError: at a name that is not a figure.
        ValueError: for a law of more than `LAW_ORDER` states.
    """
    if unknown := given.keys() - FIGURES.keys() - {"law"}:
        raise KeyError(*sorted(unknown))
    law = np.asarray(given.get("law", [[1.0]]))
    order, inputs = len(law) - 1, law.shape[1] - len(law) + 1
    if order > LAW_ORDER:
        raise ValueError(f"a law of {order} states, at most {LAW_ORDER}")
    record = np.zeros(1, dtype=RECORD)
    for name, value in (FIGURES | dict(given) | {"law_order": order}).items():
        if name != "law":
            record[name] = value
    rows = [*range(order), LAW_ORDER]  # the output stands last, and inputs behind all states there may be
    record["law"][0][np.ix_(rows, [*range(order), *range(LAW_ORDER, LAW_ORDER + inputs)])] = law
    return record


Table = dict[str, Any]

TOLERANCE = {
    "stiffness": 0.03, "effective_mass": 0.02, "beam_damping_ratio": 0.2, "oil_stiffness": 0.1, "piston_area": 0.005,
    "flow_gain": 0.05, "leakage": 0.2, "valve_natural_frequency": 0.05, "valve_damping_ratio": 0.1,
    "sensor_gain": 0.005,
}  # fmt: skip
"""What a builder can vouch for, relative."""
_SHARED = ("stiffness", "effective_mass", "beam_damping_ratio", "sensor_gain", "sensor_filter")
_OF_SCREWS = {
    "screw_stiffness": 0.12, "screw_damping": 0.3, "torque_constant": 0.04, "rotor_inertia": 0.05,
    "rotor_friction": 0.3, "current_loop": 0.1,
}  # fmt: skip
"""The same of motor and screw; the lead is ground and the feedback set, both exact."""

_BEAMS = {
    "outer_stiffness": ("outer_beam", "stiffness_N_per_m", "stiffness"),
    "outer_mass": ("outer_beam", "effective_mass_kg", "effective_mass"),
    "outer_damping_ratio": ("outer_beam", "damping_ratio", "beam_damping_ratio"),
    "inner_stiffness": ("inner_beam", "stiffness_N_per_m", "stiffness"),
    "inner_mass": ("inner_beam", "effective_mass_kg", "effective_mass"),
    "inner_damping_ratio": ("inner_beam", "damping_ratio", "beam_damping_ratio"),
}
_ACTUATORS = {
    "servo_cylinder": {
        "oil_stiffness": ("actuator", "oil_stiffness_N_per_m", "oil_stiffness"),
        "piston_area": ("actuator", "piston_area_m2", "piston_area"),
        "flow_gain": ("servovalve", "flow_gain_m3_per_s_per_A", "flow_gain"),
        "leakage": ("servovalve", "leakage_m3_per_s_per_Pa", "leakage"),
        "valve_frequency": ("servovalve", "natural_frequency_Hz", "valve_natural_frequency"),
        "valve_damping_ratio": ("servovalve", "damping_ratio", "valve_damping_ratio"),
    },
    "ball_screw": {
        "lead": ("actuator", "lead_m", "lead"),
        "screw_stiffness": ("actuator", "screw_stiffness_N_per_m", "screw_stiffness"),
        "screw_damping": ("actuator", "screw_damping_N_s_per_m", "screw_damping"),
        "torque_constant": ("actuator", "torque_constant_N_m_per_A", "torque_constant"),
        "rotor_inertia": ("actuator", "rotor_inertia_kg_m2", "rotor_inertia"),
        "rotor_friction": ("actuator", "rotor_friction_N_m_s_per_rad", "rotor_friction"),
        "speed_feedback": ("actuator", "speed_feedback_A_s_per_rad", "speed_feedback"),
        "current_loop": ("actuator", "current_loop_Hz", "current_loop"),
    },
}
_SENSOR = {
    "sensor_gain": ("sensor", "gain_V_per_m", "sensor_gain"),
    "filter_rate": ("sensor", "filter_Hz", "sensor_filter"),
}


def _stated(table: Table) -> dict[str, tuple[str, str, str]]:
    """Where a believed prototype states a figure, and the key of its tolerance."""
    own = _BEAMS | _ACTUATORS[table["actuator"].get("kind", "servo_cylinder")] | _SENSOR
    return own | (arm.STATED if "arm" in table else {})


_TURN = {"_Hz": 2 * pi, "lead_m": 1 / (2 * pi)}
"""Figures that are stated per turn, by the end of their key, become figures per radian."""


def draw_nominal(rng: np.random.Generator, name: str, screw: bool = False) -> Table:
    """A believed prototype as nested tables: around the published rig, from half to twice its figures.

    Args:
        rng: drawn from.
        name: of the rig.
        screw: whether a motor and a screw stand in the place of cylinder and servovalve.
    """

    def about(value: float, factor: float) -> float:
        return rounded(value * exp(rng.uniform(-np.log(factor), np.log(factor))))

    damping = rounded(rng.uniform(0.02, 0.06), 2)
    size = exp(rng.uniform(np.log(0.6), np.log(1.4)))
    table: Table = {
        "name": name,
        **{
            f"{beam}_beam": {
                "stiffness_N_per_m": about(stiffness * size, 1.25),
                "effective_mass_kg": about(mass * size, 1.25),
                "damping_ratio": damping,
            }
            for beam, stiffness, mass in (("outer", 486800, 3.9), ("inner", 157500, 1.6))
        },
        "actuator": {"piston_area_m2": about(1.13e-4 * size, 1.2), "oil_stiffness_N_per_m": about(1.3e7 * size, 1.3)},
        "servovalve": {
            "flow_gain_m3_per_s_per_A": about(0.0113 * size, 1.3),
            "leakage_m3_per_s_per_Pa": about(3.8e-13 * size, 1.4),
            "natural_frequency_Hz": about(150, 1.4),
            "damping_ratio": rounded(rng.uniform(0.45, 0.8), 2),
        },
        "sensor": {"gain_V_per_m": about(1180, 1.5)},
        "tolerance": {key: rounded(value * exp(rng.uniform(-0.3, 0.3)), 2) for key, value in TOLERANCE.items()},
    }
    if rng.uniform() < 0.1:
        table["sensor"]["filter_Hz"] = about(500, 1.3)
        table["tolerance"]["sensor_filter"] = 0.05
    if screw:
        del table["servovalve"]
        table["actuator"] = {
            "kind": "ball_screw",
            "lead_m": float(rng.choice([0.01, 0.016, 0.02, 0.025])),
            "screw_stiffness_N_per_m": about(8e7 * size, 1.5),
            "screw_damping_N_s_per_m": about(600 * size, 1.5),
            "torque_constant_N_m_per_A": about(1.2, 1.4),
            "rotor_inertia_kg_m2": about(8e-4, 1.4),
            "rotor_friction_N_m_s_per_rad": about(5e-3, 1.5),
            "current_loop_Hz": about(1000, 1.3),
        }
        loop = 2 * pi * about(120, 1.25)  # the break of the speed loop is what a drive is set to
        own = table["actuator"]
        feedback = loop * own["rotor_inertia_kg_m2"] / own["torque_constant_N_m_per_A"]
        own["speed_feedback_A_s_per_rad"] = rounded(feedback)
        kept = {key: value for key, value in table["tolerance"].items() if key in _SHARED}
        drawn = {key: rounded(value * exp(rng.uniform(-0.3, 0.3)), 2) for key, value in _OF_SCREWS.items()}
        table["tolerance"] = kept | drawn
    return table


def nominal_figures(table: Table) -> Shape:
    """The figures that a believed prototype states, flat, in SI per radian; 0 for a filter that is not there."""
    found = {}
    for name, (part, key, _) in _stated(table).items():
        turns = next((factor for end, factor in _TURN.items() if key.endswith(end)), 1.0)
        found[name] = turns * ({"filter_Hz": 0.0} | table[part])[key]
    return found


def tolerance_of(table: Table, figure: str) -> float:
    """Relative standard deviation that a prototype states for one of its figures."""
    return float(table["tolerance"].get(_stated(table)[figure][2], 0.0))


def draw_true(table: Table, rng: np.random.Generator) -> Shape:
    """Factors of the true figures on the believed ones, log-normal by the stated tolerances."""
    return {name: exp(tolerance_of(table, name) * rng.normal()) for name in _stated(table)}


def rig_figures(table: Table, factors: Shape, habits: Shape) -> Shape:
    """Figures of the true rig, without effects, masses or controller; keys `modes.*` and `arm.*` are of its outer beam.

    Args:
        table: the believed prototype.
        factors: of truth on belief, by figure; what is not named is as believed.
        habits: figures of a cylinder that no prototype states (bulk modulus, supply, where the leakage goes).
    """
    own = {name: value * factors.get(name, 1.0) for name, value in nominal_figures(table).items()}

    def dashpot(beam: str) -> float:
        return 2 * own[f"{beam}_damping_ratio"] * sqrt(own[f"{beam}_stiffness"] * own[f"{beam}_mass"])

    figures = {
        **{name: value for name, value in own.items() if name in FIGURES},
        "modes.stiffness": own["outer_stiffness"],
        "modes.mass": own["outer_mass"],
        "modes.damping": dashpot("outer"),
        "inner_damping": dashpot("inner"),
        "believed_sensor_gain": table["sensor"]["gain_V_per_m"],
        **arm.arm_figures(table, own),
    }
    if table["actuator"].get("kind") == "ball_screw":
        return figures
    bulk = habits.get("bulk_modulus", FIGURES["bulk_modulus"])
    return {
        **figures,
        "area_a": own["piston_area"],
        "area_b": own["piston_area"],
        # Chambers of this length have, in parallel, the stiffness of the oil spring: 2 bulk A / length.
        "chamber_length": 2 * bulk * own["piston_area"] / own["oil_stiffness"],
        **habits,
        "bulk_modulus": bulk,
    }


def assembled(figures: Shape) -> tuple[np.ndarray, np.ndarray]:
    """The record that the equations read and the (7, n) modes of the outer beam's end, from flat figures."""
    parts: dict[str, Shape] = {"modes": {}, "arm": {}, "": {}}
    for key, value in figures.items():
        part, _, name = key.rpartition(".")
        parts[part][name] = value
    bending = outer_modes(**parts["modes"])
    carried = parts[""].get("outer_end_mass", 0.0)
    modes = arm.arm_modes(bending, carried, **parts["arm"]) if parts["arm"] else at_end(bending)
    return packed(parts[""]), modes
