"""The twin-beam rig as an assembly of components: Zalucky and Hardt (1984), with a controller in the loop."""

from functools import partial
from typing import Any

from casadi import sqrt

from beamdesign.parameters import PARAMETERS
from beamdesign.plant.component import Component, Rig, Signals
from beamdesign.plant.electronics import CONTROLLER, SENSOR
from beamdesign.plant.hydraulics import AREAS, CYLINDER, VALVE, VOLUMES


def beam_force(stiffness: Any, damping: Any, position: Any, velocity: Any) -> Any:
    """Force of a beam against its tip, equations (9) and (10) of Zalucky and Hardt (1984), with the fixed dashpot."""
    return stiffness * position + damping * velocity


def _reaction(beam: str, port: Signals, figure: Signals, state: Signals) -> Any:
    """Force of a beam against its tip, N; bending is what the tip moves beyond its mount."""
    bent, rate = state[f"{beam}_m"] - port["mount_m"], state[f"{beam}_m_per_s"] - port["mount_m_per_s"]
    return beam_force(figure[f"{beam}_stiffness"], figure[f"{beam}_damping"], bent, rate)


def end_mass_force(mass: Any, end_mass: Any, driving: Any) -> Any:
    """Force that an end mass takes off the tip to be accelerated with the beam's own mass, N."""
    return driving * end_mass / (mass + end_mass)


WALL_FIGURES = ("wall_at", "wall_stiffness", "wall_damping", "wall_rounding")
"""Of a wall before the outer tip: m, N/m, N s/m, m."""


def wall_force(at: Any, stiffness: Any, damping: Any, rounding: Any, position: Any, velocity: Any) -> Any:
    """Force of a wall against the tip, N: a spring and a dashpot on one side, smooth over a rounding.

    With d the way into the wall and e the rounding, the spring is pressed by (d + sqrt(d^2 + e^2)) / 2, a function of
    place alone: it gives back what it took. The dashpot acts in the share of the spring's slope, and takes only.
    """
    inward = position - at
    distance = sqrt(inward**2 + rounding**2)
    share = (1 + inward / distance) / 2
    return stiffness * (inward + distance) / 2 + damping * share * velocity


def _wall(port: Signals, figure: Signals, state: Signals) -> Any:
    if "wall_at" not in figure:
        return 0.0
    at, stiffness, damping, rounding = (figure[name] for name in WALL_FIGURES)
    return wall_force(at, stiffness, damping, rounding, port["outer_tip_m"], port["outer_tip_m_per_s"])


def _motion(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    driving = port["outer_force_N"] - port["outer_reaction_N"] - port["outer_end_mass_N"]
    inner_mass = figure["inner_mass"] + figure["inner_end_mass"]
    return {
        "outer_m": state["outer_m_per_s"],
        "outer_m_per_s": driving / figure["outer_mass"],
        "inner_m": state["inner_m_per_s"],
        "inner_m_per_s": (port["inner_force_N"] - port["inner_reaction_N"]) / inner_mass,
    }


BEAMS = Component(
    {
        "outer_tip_m": lambda port, figure, state: state["outer_m"],
        "outer_tip_m_per_s": lambda port, figure, state: state["outer_m_per_s"],
        "mount_m": lambda port, figure, state: 0.0,
        "mount_m_per_s": lambda port, figure, state: 0.0,
        "outer_reaction_N": partial(_reaction, "outer"),
        "inner_reaction_N": partial(_reaction, "inner"),
        "mount_force_N": lambda port, figure, state: port["outer_reaction_N"] + port["inner_reaction_N"],
        "sensed_m": lambda port, figure, state: port["outer_tip_m"],
        "rod_m": lambda port, figure, state: state["inner_m"],
        "stroke_m": lambda port, figure, state: port["outer_tip_m"] - port["rod_m"],
        "rod_m_per_s": lambda port, figure, state: state["inner_m_per_s"],
        "stroke_m_per_s": lambda port, figure, state: port["outer_tip_m_per_s"] - port["rod_m_per_s"],
    }
)
"""Where the tips and their mount are, and what the beams hold against that."""

TIPS = Component(
    {
        "inner_force_N": lambda port, figure, state: -port["cylinder_force_N"],
        "wall_N": _wall,
        "outer_force_N": lambda port, figure, state: port["cylinder_force_N"] + port["disturbance_N"] - port["wall_N"],
        "outer_end_mass_N": lambda port, figure, state: end_mass_force(
            figure["outer_mass"], figure["outer_end_mass"], port["outer_force_N"] - port["outer_reaction_N"]
        ),
    },
    _motion,
)
"""Forces that move the tips."""


OUTPUTS = (
    "current_A",
    "displacement_m",  # the controller's input over the believed sensor gain
    "load_pressure_Pa",
    "inner_displacement_m",
    "outer_displacement_m",  # of the tip itself
    "measured_V",
)
FIGURES = tuple(PARAMETERS)
"""Of the linear plant; the frequency of a filter counts only with the filter."""

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


def _outputs(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    return {
        "current_A": port["current_A"],
        "displacement_m": port["measured_V"] / figure["believed_sensor_gain"],
        "load_pressure_Pa": state["pressure_a_Pa"] - state["pressure_b_Pa"],
        "inner_displacement_m": state["inner_m"],
        "outer_displacement_m": port["outer_tip_m"],
        "measured_V": port["measured_V"],
    }


TWIN_BEAM = Rig(
    "the twin beam",
    (BEAMS, SENSOR, CONTROLLER, AREAS, VALVE, VOLUMES, CYLINDER, TIPS),
    STATES,
    FIGURES + MORE_FIGURES,
    _outputs,
    OUTPUTS,
)
