"""Equations (7) to (18) of Zalucky and Hardt (1984) as a descriptor system, written apart from the assembled rig.

Sign and slips: the left side of the paper's (11) is read as F_c, and K_fx in its (12) is the sensor gain F. The
controller of (12) closes the loop outside this file, so that the plant runs from (disturbance force, current) to
(displacement, sensor voltage, inner displacement, load pressure).
"""

from functools import cache
from typing import Any

import casadi as ca

from beamdesign.plant.actuators.servo_cylinder import spool_acceleration
from beamdesign.plant.rigs import FIGURES, beam_force


def oil_force(stiffness: Any, cylinder: Any, outer: Any) -> Any:
    """Cylinder force F_c, equation (11)."""
    return stiffness * (cylinder - outer)


def leakage_flow(leakage: Any, force: Any, area: Any) -> Any:
    """Leakage Q_l through the valve, equation (14)."""
    return leakage * force / area


@cache
def descriptor(filtered: bool) -> ca.Function:
    """E, A (n, n), B (n, 2) and C (4, n) of E x' = A x + B u, y = C x by `FIGURES`, the end masses among them.

    Args:
        filtered: whether a first-order low-pass filter follows the sensor; it adds one state.
    """
    figures = ca.SX.sym("figures", len(FIGURES))
    figure = dict(zip(FIGURES, ca.vertsplit(figures), strict=True))
    x, rate, u = (ca.SX.sym(name, count) for name, count in (("x", 7 + filtered), ("rate", 7 + filtered), ("u", 2)))
    outer, outer_velocity, cylinder, inner, inner_velocity, flow, flow_rate = ca.vertsplit(x)[:7]
    disturbance, current = ca.vertsplit(u)

    force = oil_force(figure["oil_stiffness"], cylinder, outer)
    outer_reaction = beam_force(figure["outer_stiffness"], figure["outer_damping"], outer, outer_velocity)
    inner_reaction = beam_force(figure["inner_stiffness"], figure["inner_damping"], inner, inner_velocity)
    delivered = flow - leakage_flow(figure["leakage"], force, figure["piston_area"])
    sensed = figure["sensor_gain"] * outer
    rates = ca.vertsplit(rate)
    equations = [  # each zero along a motion
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
    if filtered:
        equations.append(rates[7] - figure["filter_frequency"] * (sensed - x[7]))
        sensed = x[7]
    residual = ca.vertcat(*equations)
    output = ca.vertcat(outer, sensed, inner, force / figure["piston_area"])
    matrices = [
        ca.jacobian(residual, rate),
        -ca.jacobian(residual, x),
        -ca.jacobian(residual, u),
        ca.jacobian(output, x),
    ]
    return ca.Function("descriptor", [figures], [ca.densify(m) for m in matrices], ["figures"], ["E", "A", "B", "C"])
