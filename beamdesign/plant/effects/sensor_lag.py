"""Sensor lag: a first-order low-pass between the displacement and the volts the controller gets."""

from collections.abc import Mapping
from math import pi
from typing import Any

from flint import fmpq

from beamdesign.plant.effect import TWO_PI, Effect, Elements, Linear, Parameter, Site


def _law(signal: Any, site: Site) -> Any:
    site.rate["lagged_V"] = 2 * pi * site.parameter["break_Hz"] * (signal - site.state["lagged_V"])
    return site.state["lagged_V"]


def _elements(own: Mapping[str, fmpq], figure: Mapping[str, fmpq]) -> Elements:
    rate = TWO_PI * own["break_Hz"]
    return Elements(volts=(((rate,), (rate, fmpq(1))),))


EFFECT = Effect(
    name="sensor_lag",
    subsystem="sensor",
    laws={"sensor_V": _law},
    parameters=(
        Parameter("break_Hz", 400.0, 20.0, 2000.0, 0.7, "break frequency; 400 Hz is the filter of the published rig"),
    ),
    states=("lagged_V",),
    source="Zalucky and Hardt (1984), low-pass filter of the displacement signal",
    linear=Linear("as it is", elements=_elements),
)
