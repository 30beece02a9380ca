"""The two beams and the mount they are clamped in, as laws at ports."""

from collections.abc import Mapping
from typing import Any

from beamdesign.rig.twin_beam import beam_force


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
