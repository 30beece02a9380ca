"""Entrained air: free air in the oil, which gives way more the lower the pressure."""

from typing import Any

import casadi as ca

from beamdesign.rig.effect import Effect, Parameter, Site

_ATMOSPHERE_PA = 101_325.0
_POLYTROPIC = 1.4
_LEAST_PRESSURE_PA = 20_000.0  # absolute; below this the oil would cavitate


def _law(pressure: Any, site: Site) -> Any:
    """Bulk modulus over that of air-free oil, from volumes of oil and air that share one pressure."""
    absolute = ca.fmax(pressure + _ATMOSPHERE_PA, _LEAST_PRESSURE_PA)
    air, modulus = site.parameter["air_fraction"], site.parameter["oil_bulk_modulus_Pa"]
    shrunk = air * (_ATMOSPHERE_PA / absolute) ** (1 / _POLYTROPIC)
    return (1 - air + shrunk) / (1 - air + shrunk * modulus / (_POLYTROPIC * absolute))


EFFECT = Effect(
    name="entrained_air",
    subsystem="oil",
    laws={
        "bulk_ratio_a": lambda signal, site: signal * _law(site.port["pressure_a_Pa"], site),
        "bulk_ratio_b": lambda signal, site: signal * _law(site.port["pressure_b_Pa"], site),
    },
    parameters=(
        Parameter("air_fraction", 0.05, 1e-4, 0.3, 0.8, "share of the volume that is free air at atmospheric pressure"),
        Parameter("oil_bulk_modulus_Pa", 1.4e9, 0.7e9, 2.2e9, 0.15, "of the oil free of air"),
    ),
    states=(),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 2: oil and air (n = 1.4) at one pressure",
)
