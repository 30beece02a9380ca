"""The twin-beam rig as an assembly of components: Zalucky and Hardt (1984), with a controller in the loop."""

from typing import Any

from beamdesign.parameters import PARAMETERS
from beamdesign.rig.component import Rig, Signals
from beamdesign.rig.electronics import CONTROLLER, SENSOR
from beamdesign.rig.hydraulics import AREAS, CYLINDER, VALVE, VOLUMES
from beamdesign.rig.structure import BEAMS, TIPS

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
