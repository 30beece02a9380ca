"""Servovalve and cylinder as components, and their laws.

The paper's leakage K_pq and oil spring K_c belong to the load pressure; here each chamber has its half of them, so that
for equal chambers the difference of their pressures obeys the paper's equations (11), (13) and (14), and the mean
pressure is a state which nothing drives and nothing sees.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from beamdesign.plant.component import Component, PortLaw, Signals

SUPPLY_PRESSURE_PA = 20e6
"""Supply of the published rig. It sets the chambers' mean pressure and has no part in the linear model."""


def spool_acceleration(frequency: Any, damping_ratio: Any, gain: Any, current: Any, flow: Any, rate: Any) -> Any:
    """Second derivative of the valve flow Q_0, equation (13) of Zalucky and Hardt (1984)."""
    return frequency**2 * (gain * current - flow) - 2 * damping_ratio * frequency * rate


def port_leakage(leakage: Any, pressure: Any, supply: Any) -> Any:
    """Flow that leaves a chamber through the closed valve, m3/s: none at half the supply pressure."""
    return 2 * leakage * (pressure - supply / 2)


def chamber_stiffness(oil_stiffness: Any, nominal_area: Any, area: Any, ratio: Any) -> Any:
    """Pressure gained per volume forced into one chamber at mid-stroke, Pa/m3.

    The volume there goes with the area, so that both chambers in parallel are the oil spring K_c whatever their areas.

    Args:
        oil_stiffness: K_c, N/m.
        nominal_area: A, mean of both sides, m2.
        area: of this side, m2.
        ratio: bulk modulus over that of air-free oil, over the volume's own ratio to that at mid-stroke.
    """
    return ratio * oil_stiffness / (2 * nominal_area * area)


def pressure_force(port: Mapping[str, Any], state: Mapping[str, Any]) -> Any:
    """Force of the oil on the outer beam (and its opposite on the rod), N."""
    return port["area_a_m2"] * state["pressure_a_Pa"] - port["area_b_m2"] * state["pressure_b_Pa"]


def _leakage(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    return port_leakage(figure["leakage"], state[f"pressure_{side}_Pa"], port["supply_pressure_Pa"])


def _spool(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    return {
        "flow_m3_per_s": state["flow_m3_per_s2"],
        "flow_m3_per_s2": spool_acceleration(
            figure["valve_frequency"],
            figure["valve_damping_ratio"],
            figure["flow_gain"],
            port["spool_A"],
            state["flow_m3_per_s"],
            state["flow_m3_per_s2"],
        ),
    }


def _chambers(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    into_a = port["orifice_a_m3_per_s"] - port["leakage_a_m3_per_s"] - port["area_a_m2"] * port["stroke_m_per_s"]
    into_b = port["area_b_m2"] * port["stroke_m_per_s"] - port["orifice_b_m3_per_s"] - port["leakage_b_m3_per_s"]
    return {
        "pressure_a_Pa": port["chamber_a_Pa_per_m3"] * into_a,
        "pressure_b_Pa": port["chamber_b_Pa_per_m3"] * into_b,
    }


def _mid_stroke(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    ratio = port[f"bulk_ratio_{side}"] / port[f"volume_ratio_{side}"]
    return chamber_stiffness(figure["oil_stiffness"], figure["piston_area"], port[f"area_{side}_m2"], ratio)


def _metered(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    return port["metered_m3_per_s"]


def _either(port: str, law: Callable[[str, Signals, Signals, Signals], Any]) -> dict[str, PortLaw]:
    """A port on either side of the cylinder, a and b, by a law that is told the side."""
    return {port.format(side): partial(law, side) for side in "ab"}


AREAS = Component(_either("area_{}_m2", lambda side, port, figure, state: figure["piston_area"]))
"""The two sides of the piston."""

VOLUMES = Component(_either("volume_ratio_{}", lambda side, port, figure, state: 1.0))
"""Volume of either chamber over that at mid-stroke, which the linear rig has at every stroke."""

VALVE = Component(
    {
        "spool_A": lambda port, figure, state: port["current_A"],
        # what the opening would pass with half the supply pressure across each edge
        "metered_m3_per_s": lambda port, figure, state: state["flow_m3_per_s"],
        "supply_pressure_Pa": lambda port, figure, state: figure["supply_pressure"],
        "tank_pressure_Pa": lambda port, figure, state: 0.0,
        # 1 where somebody has adjusted the null so that the rig rests without load
        "null_adjusted": lambda port, figure, state: 1.0,
        # the same for the edges that are then open at either port
        **_either("opening_{}_m3_per_s", _metered),
        # what a valve lets through either port that heeds no pressure
        **_either("linear_{}_m3_per_s", _metered),
        # into chamber a, out of chamber b
        **_either("orifice_{}_m3_per_s", lambda side, port, figure, state: port[f"linear_{side}_m3_per_s"]),
        **_either("leakage_{}_m3_per_s", _leakage),
    },
    _spool,
)
"""From current to the flows through both ports."""

CYLINDER = Component(
    {
        **_either("bulk_ratio_{}", lambda side, port, figure, state: 1.0),
        **_either("chamber_{}_Pa_per_m3", _mid_stroke),
        "pressure_force_N": lambda port, figure, state: pressure_force(port, state),
        "sliding_m": lambda port, figure, state: port["stroke_m"],
        "sliding_m_per_s": lambda port, figure, state: port["stroke_m_per_s"],
        "friction_N": lambda port, figure, state: 0.0,
        "actuator_force_N": lambda port, figure, state: port["pressure_force_N"] - port["friction_N"],
    },
    _chambers,
)
"""From flows and the speed of the stroke to the force between piston and cylinder."""
