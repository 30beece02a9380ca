"""Sensor carrier ripple: what the demodulator of a carrier-fed displacement sensor lets through."""

from math import pi
from typing import Any

import casadi as ca

from beamdesign.plant.effects import Effect, Linear, Parameter, Site, Span


def _law(signal: Any, site: Site) -> Any:
    wave = ca.sin(2 * pi * site.parameter["frequency_Hz"] * site.time)
    return signal * (1 + site.parameter["depth"] * wave) + site.parameter["residual_V"] * wave


EFFECT = Effect(
    name="carrier_ripple",
    subsystem="sensor",
    laws={"sensor_V": _law},
    parameters=(
        Parameter("frequency_Hz", 700.0, 50.0, 2000.0, 0.5, "of the ripple: twice the carrier, or its alias"),
        Parameter("depth", 0.02, 0.0, 0.5, 0.02, "ripple over signal"),
        Parameter("residual_V", 0.0, 0.0, 0.5, 0.01, "ripple at no displacement, from imbalance of the windings"),
    ),
    source="amplitude demodulation; E. O. Doebelin, Measurement Systems, differential transformers",
    linear=Linear(
        "the sensor's gain times every frozen factor from 1 - depth to 1 + depth",
        "the ripple in time: what it drives, and what it does by varying the gain",
        laws={},
        gain=lambda own, at: Span(1 - own["depth"], 1 + own["depth"], 1.0),
    ),
)
