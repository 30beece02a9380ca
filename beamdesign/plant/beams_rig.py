"""The twin-beam rig as an assembly of components: Zalucky and Hardt (1984), with a controller in the loop."""

from functools import partial
from typing import Any

from casadi import sqrt

from beamdesign.parameters import rows_of
from beamdesign.plant.actuators import KINDS, Actuator
from beamdesign.plant.component import Component, Rig, Signals
from beamdesign.plant.electronics import CONTROLLER, SENSOR


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
        "inner_force_N": lambda port, figure, state: -port["actuator_force_N"],
        "wall_N": _wall,
        "outer_force_N": lambda port, figure, state: port["actuator_force_N"] + port["disturbance_N"] - port["wall_N"],
        "outer_end_mass_N": lambda port, figure, state: end_mass_force(
            figure["outer_mass"], figure["outer_end_mass"], port["outer_force_N"] - port["outer_reaction_N"]
        ),
    },
    _motion,
)
"""Forces that move the tips."""


MORE_FIGURES = ("supply_pressure", "believed_sensor_gain", "gain", "pole", "zero")
"""Figures beside those of the linear plant: Pa, V/m, A/V, rad/s, rad/s."""

_BEAM_STATES = ("outer_m", "outer_m_per_s", "inner_m", "inner_m_per_s")


def outputs_of(actuator: type[Actuator]) -> tuple[str, ...]:
    """What is recorded of a rig with an actuator, in order."""
    return (
        "current_A",
        "displacement_m",  # the controller's input over the believed sensor gain
        actuator.feels[0],
        "inner_displacement_m",
        "outer_displacement_m",  # of the tip itself
        "measured_V",
    )


def twin_beam(actuator: type[Actuator]) -> Rig:
    """Two beams with an actuator between their tips, and a law that goes by the outer tip's displacement."""
    felt, feel = actuator.feels

    def outputs(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        return {
            "current_A": port["current_A"],
            "displacement_m": port["measured_V"] / figure["believed_sensor_gain"],
            felt: feel(port, figure, state),
            "inner_displacement_m": state["inner_m"],
            "outer_displacement_m": port["outer_tip_m"],
            "measured_V": port["measured_V"],
        }

    return Rig(
        "the twin beam",
        (BEAMS, SENSOR, CONTROLLER, *actuator.components, TIPS),
        _BEAM_STATES + actuator.states,
        (*rows_of(actuator), *MORE_FIGURES),
        outputs,
        outputs_of(actuator),
        actuator,
    )


TWIN_BEAMS = {"twin_beam" if name == Actuator.where_none_is_stated else name: twin_beam(a) for name, a in KINDS.items()}
"""By actuator; the one of Zalucky and Hardt (1984) is the twin beam by itself."""

TWIN_BEAM = TWIN_BEAMS["twin_beam"]
STATES, OUTPUTS = TWIN_BEAM.states, TWIN_BEAM.output_names


def figures_of(rig: str) -> tuple[str, ...]:
    """Those of the linear plant of a twin beam, end masses last; the frequency of a filter counts only with one."""
    return TWIN_BEAMS[rig].figures[: -len(MORE_FIGURES)]


FIGURES = figures_of("twin_beam")
