"""Sensor lag: a first-order low-pass between the displacement and the volts the controller gets."""

from math import pi
from typing import Any

from flint import fmpq

from beamdesign.plant.effects import TWO_PI, Effect, Elements, Exact, Linear, Parameter, Site


def _law(signal: Any, site: Site) -> Any:
    site.rate["lagged_V"] = 2 * pi * site.parameter["break_Hz"] * (signal - site.state["lagged_V"])
    return site.state["lagged_V"]


def _elements(own: Exact, figure: Exact) -> Elements:
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


def _second_order(signal: Any, site: Site) -> Any:
    # 1 + T s + (T / 2 zeta)^2 s^2, so that the break is that of the first-order lag with the same delay T.
    natural = 4 * pi * site.parameter["damping_ratio"] * site.parameter["break_Hz"]
    slope = site.state["slope_V_per_s"]
    site.rate["lagged_V"] = slope
    site.rate["slope_V_per_s"] = (
        natural**2 * (signal - site.state["lagged_V"]) - 2 * site.parameter["damping_ratio"] * natural * slope
    )
    return site.state["lagged_V"]


def _second_order_elements(own: Exact, figure: Exact) -> Elements:
    ratio = own["damping_ratio"]
    natural = 2 * TWO_PI * ratio * own["break_Hz"]
    return Elements(volts=(((natural**2,), (natural**2, 2 * ratio * natural, fmpq(1))),))


SECOND_ORDER = Effect(
    name="sensor_lag_second_order",
    meaning="Sensor lag of second order: what a Butterworth or Bessel filter is, and many a demodulator.",
    subsystem="sensor",
    laws={"sensor_V": _second_order},
    parameters=(
        Parameter(
            "break_Hz", 400.0, 20.0, 2000.0, 0.7, "break of the first-order lag that delays slow signals as much"
        ),
        Parameter("damping_ratio", 0.75, 0.4, 1.5, 0.25, "0.71 Butterworth, 0.87 Bessel, 1 two equal lags in a row"),
    ),
    states=("lagged_V", "slope_V_per_s"),
    source="low-pass of second order; Franklin, Powell, Emami-Naeini, Feedback Control of Dynamic Systems",
    linear=Linear("as it is", elements=_second_order_elements),
    realises="sensor_lag",
)
