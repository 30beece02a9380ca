"""Which kinds of rigs there are, and which effects and wrong figures each of them can have."""

from collections.abc import Iterable
from typing import Literal

from beamdesign.validation.truth.effects import OF_CYLINDERS, OF_SCREWS

Rig = Literal["lag", "structured", "ball_screw", "observer", "arm"]
"""A cylinder whose law is a lag, a lag with sections, or (`observer`) an observer; a motor with a screw, and a lag; and
one plane of an arm with a cylinder and a lag."""

_PARAMETERS: dict[str, tuple[tuple[str, ...], str]] = {
    "flow_gain": (("flow_gain",), "servovalve"),
    "effective_mass": (("outer_mass", "inner_mass"), "structure"),
    "stiffness": (("outer_stiffness", "inner_stiffness", "torsional_stiffness"), "structure"),
    "oil_stiffness": (("oil_stiffness",), "oil"),
    "valve_natural_frequency": (("valve_frequency",), "servovalve"),
    "valve_damping_ratio": (("valve_damping_ratio",), "servovalve"),
    "piston_area": (("piston_area",), "actuator"),
    "sensor_gain": (("sensor_gain",), "sensor"),
    "beam_damping_ratio": (("outer_damping_ratio", "inner_damping_ratio", "torsional_damping_ratio"), "structure"),
}
_MOTOR = {
    "screw_stiffness": "actuator", "lead": "actuator", "torque_constant": "actuator", "rotor_inertia": "actuator",
    "speed_feedback": "amplifier", "current_loop": "amplifier",
}  # fmt: skip
_HYDRAULIC = ("flow_gain", "oil_stiffness", "valve_natural_frequency", "valve_damping_ratio", "piston_area")
PARAMETERS = _PARAMETERS | {name: ((name,), where) for name, where in _MOTOR.items()}
"""Plain wrong figures, by key of [tolerance]: which of those that a rig has may be wrong (one is), and subsystem."""


def on(rig: Rig, names: Iterable[str]) -> tuple[str, ...]:
    """Those of some effects, or of some keys of [tolerance], that a rig can have."""
    lacks = {
        "ball_screw": (*OF_CYLINDERS, *_HYDRAULIC),
        # A second bending mode would have a part in how the end slopes, which no model beside a lever has.
        "arm": (*OF_SCREWS, *_MOTOR, "second_beam_mode"),
    }.get(rig, (*OF_SCREWS, *_MOTOR))
    return tuple(name for name in names if name not in lacks)
