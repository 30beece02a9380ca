"""Sensor lag: a first-order low-pass between the displacement and the volts the controller gets."""

from math import pi
from typing import Any

from beamdesign.rig.effect import Effect, Linear, Parameter, Site


def _law(signal: Any, site: Site) -> Any:
    site.rate["lagged_V"] = 2 * pi * site.parameter["break_Hz"] * (signal - site.state["lagged_V"])
    return site.state["lagged_V"]


EFFECT = Effect(
    name="sensor_lag",
    subsystem="sensor",
    laws={"sensor_V": _law},
    parameters=(
        Parameter("break_Hz", 400.0, 20.0, 2000.0, 0.7, "break frequency; 400 Hz is the filter of the published rig"),
    ),
    states=("lagged_V",),
    source="Zalucky and Hardt (1984), low-pass filter of the displacement signal",
    linear=Linear("as it is"),
)
