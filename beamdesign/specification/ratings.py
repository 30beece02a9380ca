"""What cylinder, valve and supply must give to hold a load, by the linear loop."""

from dataclasses import dataclass

import numpy as np

from beamdesign.operating_limits import Envelope, demand, envelope, smaller_side
from beamdesign.prototype import Prototype

MARGIN = 1.25
"""On what the linear loop asks of flow, current and stroke."""
PRESSURE_SHARE = 2 / 3
"""Of the supply pressure that the load should use at most: there a valve gives the most power (H. E. Merritt, Hydraulic
Control Systems (1967), section 7-3)."""
_LOWEST_HZ, _POINTS, _PHASES = 0.01, 60, 360
SHOWN_HZ = (0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


@dataclass(frozen=True)
class Ratings:
    """Ratings for a sinusoidal force on the tip of one amplitude, at any frequency up to a bandwidth.

    Attributes:
        load_N: amplitude of the force.
        up_to_Hz: bandwidth.
        cylinder_force_N: largest.
        load_pressure_Pa: that on the smaller side of the piston.
        supply_pressure_Pa: least, so that the load pressure is two thirds of it.
        flow_m3_per_s: largest through the valve under load.
        no_load_flow_m3_per_s: flow the valve must give without a load at the prototype's supply pressure, margin
            included; infinite where the load pressure reaches the supply's.
        rated_current_A: current that gives it, the spool's lag included, margin included.
        stroke_m: from end to end, margin included.
        supply_flow_m3_per_s: margin included.
        given: what the prototype states, by the names above; None where it does not.
        envelope: largest amplitude over frequency that the prototype's own ratings allow, with the largest payload.
    """

    load_N: float
    up_to_Hz: float
    cylinder_force_N: float
    load_pressure_Pa: float
    supply_pressure_Pa: float
    flow_m3_per_s: float
    no_load_flow_m3_per_s: float
    rated_current_A: float
    stroke_m: float
    supply_flow_m3_per_s: float
    given: dict[str, float | None]
    envelope: Envelope


def ratings(prototype: Prototype, masses_kg: tuple[float, float], load_N: float, up_to_Hz: float) -> Ratings:
    """Ratings over both ends and the middle of a payload range, of each law its own; the largest of each.

    Args:
        prototype: with a controller whose loop is stable at these masses.
        masses_kg: range of outer end mass.
        load_N: amplitude of the force on the tip.
        up_to_Hz: highest frequency of it.
    """
    grid = np.geomspace(_LOWEST_HZ, max(up_to_Hz, 2 * _LOWEST_HZ), _POINTS)
    area, supply = smaller_side(prototype), prototype.supply.pressure_Pa
    stall = supply * area
    force = flow = current = stroke = no_load = 0.0
    turn = np.exp(2j * np.pi * np.arange(_PHASES) / _PHASES)
    stages = prototype.stages(masses_kg)
    for law, mass in ((stage.prototype, mass) for stage in stages for mass in stage.looked_at_kg):
        asked = demand(law, mass, grid)
        force = max(force, load_N * float(np.abs(asked.force).max()))
        flow = max(flow, load_N * float(np.abs(asked.flow).max()))
        stroke = max(stroke, load_N * float(np.abs(asked.stroke).max()))
        moved, held = (load_N * np.real(one[:, None] * turn) for one in (asked.flow, asked.force))
        left = 1 - np.sign(moved) * held / stall
        # Orifice flow at a load pressure: q = q_0 sqrt(1 - p_L / p_S); asked the other way round for q_0.
        through = np.where(left > 0, np.abs(moved) / np.sqrt(np.maximum(left, 1e-12)), np.inf).max(axis=1)
        no_load = max(no_load, float(through.max()))
        per_flow = np.abs(asked.current) / np.maximum(np.abs(asked.flow), 1e-300)
        current = max(current, float((through * per_flow).max()))
    given = {
        "supply_pressure_Pa": supply,
        "rated_current_A": prototype.servovalve.rated_current_A,
        "stroke_m": prototype.actuator.stroke_m,
        "supply_flow_m3_per_s": prototype.supply.flow_m3_per_s,
    }
    shown = np.array(SHOWN_HZ)
    return Ratings(
        load_N, up_to_Hz, force, force / area, force / area / PRESSURE_SHARE, flow, MARGIN * no_load, MARGIN * current,
        2 * MARGIN * stroke, MARGIN * flow, given, envelope(stages[-1].prototype, masses_kg[1], 0.0, shown),
    )  # fmt: skip
