"""The two beams and the mount they are clamped in, as components, and their laws."""

from collections.abc import Mapping
from typing import Any

from casadi import sqrt

from beamdesign.rig.component import Component, Signals


def beam_force(stiffness: Any, damping: Any, position: Any, velocity: Any) -> Any:
    """Force of a beam against its tip, equations (9) and (10) of Zalucky and Hardt (1984), with the fixed dashpot."""
    return stiffness * position + damping * velocity


def outer_reaction(port: Mapping[str, Any], figure: Mapping[str, Any], state: Mapping[str, Any]) -> Any:
    """Force of the outer beam against its tip, N; bending is what the tip moves beyond its mount."""
    bent, rate = state["outer_m"] - port["mount_m"], state["outer_m_per_s"] - port["mount_m_per_s"]
    return beam_force(figure["outer_stiffness"], figure["outer_damping"], bent, rate)


def inner_reaction(port: Mapping[str, Any], figure: Mapping[str, Any], state: Mapping[str, Any]) -> Any:
    """Force of the inner beam against its tip, N."""
    bent, rate = state["inner_m"] - port["mount_m"], state["inner_m_per_s"] - port["mount_m_per_s"]
    return beam_force(figure["inner_stiffness"], figure["inner_damping"], bent, rate)


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
        "outer_reaction_N": outer_reaction,
        "inner_reaction_N": inner_reaction,
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
