"""The actuator on a bench as an assembly of components: servovalve and cylinder between end stops, in open loop.

Positions count from the retracted stop; chamber a is the cap's, and a positive command extends. What the twin beam
lumps at mid-stroke is worked out here from the volumes, which the stroke changes many times over.
"""

from typing import Any

import casadi as ca

from beamdesign.plant.component import Component, Rig, Signals
from beamdesign.plant.electronics import OPEN_LOOP, SENSOR, low_pass_rate
from beamdesign.plant.hydraulics import AREAS, CYLINDER, VALVE, port_leakage

STATES = (
    "piston_m",
    "piston_m_per_s",
    "pressure_a_Pa",
    "pressure_b_Pa",
    "flow_m3_per_s",
    "flow_m3_per_s2",
    "sag_Pa",
    "back_Pa",
    "seen_a_Pa",
    "seen_b_Pa",
)
FIGURES = (
    "piston_area",  # m2, mean of both sides
    "stroke",  # m
    "moving_mass",  # kg
    "dead_volume",  # m3, of each chamber with the piston against it, lines included
    "bulk_modulus",  # Pa
    "stop_stiffness",  # N/m
    "stop_damping",  # N s/m
    "constant_load",  # N, against extension
    "supply_pressure",  # Pa, with no flow
    "tank_pressure",  # Pa
    "line_loss",  # Pa s2/m6, of the lines to and from the valve each
    "edge_b",  # flow of the edge from the supply to chamber b over that of the others
    "flow_gain",  # m3/s/A
    "leakage",  # m3/s/Pa, of the closed valve
    "piston_leakage",  # m3/s/Pa, from chamber to chamber
    "valve_frequency",  # rad/s
    "valve_damping_ratio",
    "gain",  # A/V, of the amplifier
    "null",  # V, command at which the valve is shut
    "sensor_gain",  # V/m
    "sensor_zero",  # m, reading at the retracted stop
    "believed_sensor_gain",  # V/m
    "filter_frequency",  # rad/s, only with the filter
    "pressure_filter_frequency",  # rad/s
)
OUTPUTS = ("current_A", "displacement_m", "pressure_a_Pa", "pressure_b_Pa", "piston_m", "measured_V")

LINE_S = 5e-3  # how soon the pressure lost in a line comes and goes
_INDENTATION_M = 1e-5  # over which the damping of a stop comes on
_STALL = 0.02  # of the supply: a linear valve gives way to a chamber that comes this near to supply or tank


def stop_force(position: Any, speed: Any, stroke: Any, stiffness: Any, damping: Any) -> Any:
    """Force of the end stops on the piston, N: springs with damping that grows with indentation, which never pull."""

    def pressed(depth: Any, closing: Any) -> Any:
        inside = ca.fmax(depth, 0.0)
        return ca.fmax(stiffness * inside + damping * ca.fmin(inside / _INDENTATION_M, 1.0) * closing, 0.0)

    return pressed(-position, -speed) - pressed(position - stroke, speed)


def stalled(flow: Any, pressure: Any, supply: Any, tank: Any) -> Any:
    """Flow into a chamber through a linear valve, which ends where no pressure is left to drive it."""
    drop = ca.if_else(flow > 0, supply - pressure, pressure - tank)
    return flow * ca.fmin(ca.fmax(drop / (_STALL * (supply - tank)), 0.0), 1.0)


def _linear_port(side: str, sign: float, port: Signals, state: Signals) -> Any:
    into = stalled(
        sign * port[f"linear_{side}_m3_per_s"],
        state[f"pressure_{side}_Pa"],
        port["supply_pressure_Pa"],
        port["tank_pressure_Pa"],
    )
    return sign * into


def _leakage(side: str, other: str, port: Signals, figure: Signals, state: Signals) -> Any:
    own, facing = state[f"pressure_{side}_Pa"], state[f"pressure_{other}_Pa"]
    middle = port["supply_pressure_Pa"] + port["tank_pressure_Pa"]
    return port_leakage(figure["leakage"], own, middle) + figure["piston_leakage"] * (own - facing)


def _chamber(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    """Pressure gained per volume forced into a chamber, beta/V."""
    filled = state["piston_m"] if side == "a" else figure["stroke"] - state["piston_m"]
    volume = figure["dead_volume"] + port[f"area_{side}_m2"] * ca.fmax(filled, 0.0)
    return port[f"bulk_ratio_{side}"] * figure["bulk_modulus"] / volume


def _motion(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    force = port["actuator_force_N"] + port["stop_N"] + port["disturbance_N"] - figure["constant_load"]
    a, b = port["orifice_a_m3_per_s"], port["orifice_b_m3_per_s"]
    drawn, given = ca.fmax(a, 0.0) + ca.fmax(-b, 0.0), ca.fmax(-a, 0.0) + ca.fmax(b, 0.0)
    seen = figure["pressure_filter_frequency"]
    return {
        "piston_m": state["piston_m_per_s"],
        "piston_m_per_s": force / figure["moving_mass"],
        "sag_Pa": (figure["line_loss"] * drawn**2 - state["sag_Pa"]) / LINE_S,
        "back_Pa": (figure["line_loss"] * given**2 - state["back_Pa"]) / LINE_S,
        "seen_a_Pa": low_pass_rate(seen, state["pressure_a_Pa"], state["seen_a_Pa"]),
        "seen_b_Pa": low_pass_rate(seen, state["pressure_b_Pa"], state["seen_b_Pa"]),
    }


def _outputs(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    return {
        "current_A": port["current_A"],
        "displacement_m": port["measured_V"] / figure["believed_sensor_gain"],
        "pressure_a_Pa": state["seen_a_Pa"],
        "pressure_b_Pa": state["seen_b_Pa"],
        "piston_m": state["piston_m"],
        "measured_V": port["measured_V"],
    }


BENCH = Rig(
    "the actuator bench",
    (
        Component(
            {
                "stroke_m": lambda port, figure, state: state["piston_m"],
                "stroke_m_per_s": lambda port, figure, state: state["piston_m_per_s"],
                "sensed_m": lambda port, figure, state: state["piston_m"] + figure["sensor_zero"],
            }
        ),
        SENSOR,
        OPEN_LOOP.but(demanded_A=lambda port, figure, state: figure["gain"] * (port["command_V"] - figure["null"])),
        AREAS,
        VALVE.but(
            supply_pressure_Pa=lambda port, figure, state: figure["supply_pressure"] - state["sag_Pa"],
            tank_pressure_Pa=lambda port, figure, state: figure["tank_pressure"] + state["back_Pa"],
            opening_b_m3_per_s=lambda port, figure, state: (
                port["metered_m3_per_s"] * ca.if_else(port["metered_m3_per_s"] < 0, figure["edge_b"], 1.0)
            ),
            null_adjusted=lambda port, figure, state: 0.0,
            orifice_a_m3_per_s=lambda port, figure, state: _linear_port("a", 1.0, port, state),
            orifice_b_m3_per_s=lambda port, figure, state: _linear_port("b", -1.0, port, state),
            leakage_a_m3_per_s=lambda port, figure, state: _leakage("a", "b", port, figure, state),
            leakage_b_m3_per_s=lambda port, figure, state: _leakage("b", "a", port, figure, state),
        ),
        CYLINDER.but(
            chamber_a_Pa_per_m3=lambda port, figure, state: _chamber("a", port, figure, state),
            chamber_b_Pa_per_m3=lambda port, figure, state: _chamber("b", port, figure, state),
        ),
        Component(
            {
                "stop_N": lambda port, figure, state: stop_force(
                    state["piston_m"],
                    state["piston_m_per_s"],
                    figure["stroke"],
                    figure["stop_stiffness"],
                    figure["stop_damping"],
                ),
            },
            _motion,
        ),
    ),
    STATES,
    FIGURES,
    _outputs,
    OUTPUTS,
)
