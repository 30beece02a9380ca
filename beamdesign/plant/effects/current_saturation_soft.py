"""Soft current saturation: an amplifier that reaches its limit gradually."""

from typing import Any

import casadi as ca

from beamdesign.plant.effect import Effect, Parameter, Site
from beamdesign.plant.effects.current_saturation import LIMIT, LINEAR

_LEAST = 1e-6  # of the limit: below it the demand counts as that much in the power, which has no slope at none


def _law(signal: Any, site: Site) -> Any:
    limit, sharpness = site.parameter["limit_A"], site.parameter["sharpness"]
    level = ca.log((signal / limit) ** 2 + _LEAST**2) / 2
    return signal * ca.exp(-ca.log1p(ca.exp(sharpness * level)) / sharpness)


EFFECT = Effect(
    name="current_saturation_soft",
    subsystem="amplifier",
    laws={"current_A": _law},
    parameters=(
        LIMIT,
        Parameter("sharpness", 8.0, 2.0, 30.0, 0.5, "i = u / (1 + |u/limit|^n)^(1/n); the larger n, the harder"),
    ),
    states=(),
    source="C. Rapp, solid-state power amplifiers, 2nd European Conf. on Satellite Communications (1991) 179",
    linear=LINEAR,
    realises="current_saturation",
)
