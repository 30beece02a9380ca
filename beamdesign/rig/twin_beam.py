"""The twin-beam rig in CasADi: equations (7) to (18) of Zalucky and Hardt (1984), written once.

Sign and slips: the left side of the paper's (11) is read as F_c, and K_fx in its (12) is the sensor gain F. The
controller of (12) closes the loop outside this file, so that the plant runs from (disturbance force, current) to
(displacement, sensor voltage).
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca

from beamdesign.parameters import PARAMETERS

STATES = (
    "displacement_m",  # X_m, tip of the outer beam
    "velocity_m_per_s",
    "cylinder_m",  # X_c
    "inner_displacement_m",  # X_f
    "inner_velocity_m_per_s",
    "flow_m3_per_s",  # Q_0
    "flow_rate_m3_per_s2",
)
INPUTS = ("disturbance_N", "current_A")
OUTPUTS = ("displacement_m", "sensor_V")
ADDED_OUTPUTS = ("inner_displacement_m", "load_pressure_Pa")
"""What added sensors may read."""
FIGURES = tuple(PARAMETERS)
"""What its equations take; a filter's frequency counts only with the filter."""


def beam_force(stiffness: Any, damping: Any, position: Any, velocity: Any) -> Any:
    """Force of a beam against its tip: (9) or (10), with the fixed dashpot."""
    return stiffness * position + damping * velocity


def oil_force(stiffness: Any, cylinder: Any, outer: Any) -> Any:
    """Cylinder force F_c, equation (11)."""
    return stiffness * (cylinder - outer)


def leakage_flow(leakage: Any, force: Any, area: Any) -> Any:
    """Leakage Q_l through the valve, equation (14)."""
    return leakage * force / area


def spool_acceleration(frequency: Any, damping_ratio: Any, gain: Any, current: Any, flow: Any, rate: Any) -> Any:
    """Second derivative of the valve flow Q_0, equation (13)."""
    return frequency**2 * (gain * current - flow) - 2 * damping_ratio * frequency * rate


@dataclass(frozen=True)
class Descriptor:
    """The linear plant E x' = A x + B u, y = C x as a CasADi function of its figures.

    Attributes:
        function: figures in the order of `FIGURES` (vector of 16) to E, A (n x n), B (n x 2) and C (2 x n).
        states: names of the n states.
        added: the same figures to the rows (2 x n) of `ADDED_OUTPUTS`.
    """

    function: ca.Function
    states: tuple[str, ...]
    added: ca.Function


@cache
def descriptor(filtered: bool) -> Descriptor:
    """Linearise the rig at rest by algorithmic differentiation.

    Args:
        filtered: whether a first-order low-pass filter follows the sensor; it adds one state.
    """
    states = STATES + (("filtered_V",) if filtered else ())
    figures = ca.SX.sym("figures", len(FIGURES))
    figure = dict(zip(FIGURES, ca.vertsplit(figures), strict=True))
    x, rate, u = ca.SX.sym("x", len(states)), ca.SX.sym("rate", len(states)), ca.SX.sym("u", len(INPUTS))
    outer, outer_velocity, cylinder, inner, inner_velocity, flow, flow_rate = ca.vertsplit(x)[:7]
    disturbance, current = ca.vertsplit(u)

    force = oil_force(figure["oil_stiffness"], cylinder, outer)
    outer_reaction = beam_force(figure["outer_stiffness"], figure["outer_damping"], outer, outer_velocity)
    inner_reaction = beam_force(figure["inner_stiffness"], figure["inner_damping"], inner, inner_velocity)
    delivered = flow - leakage_flow(figure["leakage"], force, figure["piston_area"])
    sensed = figure["sensor_gain"] * outer

    # One row per state, each zero along a motion: mass times acceleration stays on the left, so that an
    # end mass enters E alone, and with rank one.
    rates = ca.vertsplit(rate)
    equations = [
        rates[0] - outer_velocity,
        (figure["outer_mass"] + figure["outer_end_mass"]) * rates[1] - (disturbance + force - outer_reaction),
        rates[2] - rates[3] - delivered / figure["piston_area"],
        rates[3] - inner_velocity,
        (figure["inner_mass"] + figure["inner_end_mass"]) * rates[4] - (-force - inner_reaction),
        rates[5] - flow_rate,
        rates[6]
        - spool_acceleration(
            figure["valve_frequency"], figure["valve_damping_ratio"], figure["flow_gain"], current, flow, flow_rate
        ),
    ]
    output = ca.vertcat(outer, sensed)
    if filtered:
        equations.append(rates[7] - figure["filter_frequency"] * (sensed - x[7]))
        output = ca.vertcat(outer, x[7])
    residual = ca.vertcat(*equations)
    matrices = [
        ca.jacobian(residual, rate),
        -ca.jacobian(residual, x),
        -ca.jacobian(residual, u),
        ca.jacobian(output, x),
    ]
    function = ca.Function(
        "descriptor", [figures], [ca.densify(m) for m in matrices], ["figures"], ["E", "A", "B", "C"]
    )
    added = ca.jacobian(ca.vertcat(inner, force / figure["piston_area"]), x)
    return Descriptor(function, states, ca.Function("added", [figures], [ca.densify(added)], ["figures"], ["C"]))
