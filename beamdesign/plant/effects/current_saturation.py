"""Current saturation: the servo-amplifier gives no more than its limit."""

from typing import Any

import casadi as ca

from beamdesign.plant.effects import Effect, Linear, Parameter, Site, Span, limited

LIMIT = Parameter(
    "limit_A", 10e-3, 0.2e-3, 1e3, 0.7,
    "largest current; rated currents are 8 to 40 mA, a motor's default is its drive's", "current",
)  # fmt: skip
LINEAR = Linear(
    "gain from none to the whole, the sector in which a saturation lies; performance below the limit",
    "limit cycles and recovery from large signals",
    laws={},
    gain=lambda own, at: Span(0.0, 1.0, 1.0, (1.0, 1.0)),
)

EFFECT = Effect(
    name="current_saturation",
    subsystem="amplifier",
    laws={"current_A": lambda signal, site: limited(signal, site.parameter["limit_A"])},
    parameters=(LIMIT,),
    source="limit of a servo-amplifier; Zalucky and Hardt (1984) filtered the sensor to keep it from saturating",
    linear=LINEAR,
)


_LEAST = 1e-6  # of the limit: below it the demand counts as that much in the power, which has no slope at none


def _soft(signal: Any, site: Site) -> Any:
    limit, sharpness = site.parameter["limit_A"], site.parameter["sharpness"]
    level = ca.log((signal / limit) ** 2 + _LEAST**2) / 2
    return signal * ca.exp(-ca.log1p(ca.exp(sharpness * level)) / sharpness)


SOFT = Effect(
    name="current_saturation_soft",
    meaning="Soft current saturation: an amplifier that reaches its limit gradually.",
    subsystem="amplifier",
    laws={"current_A": _soft},
    parameters=(
        LIMIT,
        Parameter("sharpness", 8.0, 2.0, 30.0, 0.5, "i = u / (1 + |u/limit|^n)^(1/n); the larger n, the harder"),
    ),
    source="C. Rapp, solid-state power amplifiers, 2nd European Conf. on Satellite Communications (1991) 179",
    linear=LINEAR,
    realises="current_saturation",
)
