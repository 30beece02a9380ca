"""Entrained air: free air in the oil, which gives way more the lower the pressure."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from beamdesign.plant.effect import Effect, Elements, Law, Linear, Operation, Parameter, Site, Span, Spans

_ATMOSPHERE_PA = 101_325.0
POLYTROPIC = 1.4
_LEAST_PRESSURE_PA = 20_000.0  # absolute; below this the oil would cavitate


def _law(pressure: Any, site: Site) -> Any:
    return bulk_ratio(pressure, site.parameter["air_fraction"], site.parameter["oil_bulk_modulus_Pa"])


def bulk_ratio(pressure: Any, air: Any, modulus: Any, exponent: Any = POLYTROPIC) -> Any:
    """Bulk modulus over that of air-free oil, from volumes of oil and air that share one pressure.

    Args:
        pressure: gauge, Pa.
        air: share of the volume that is free air at atmospheric pressure.
        modulus: of the oil free of air, Pa.
        exponent: polytropic, of the air: 1 where its temperature stays, 1.4 where it exchanges no heat.
    """
    absolute = ca.fmax(pressure + _ATMOSPHERE_PA, _LEAST_PRESSURE_PA)
    shrunk = air * (_ATMOSPHERE_PA / absolute) ** (1 / exponent)
    return (1 - air + shrunk) / (1 - air + shrunk * modulus / (exponent * absolute))


def _stiffness(own: Mapping[str, float], at: Operation) -> Span:
    difference = at.load_N / at.figure["piston_area"]

    def ratio(pressure: float) -> float:
        return float(bulk_ratio(pressure, own["air_fraction"], own["oil_bulk_modulus_Pa"]))

    return Span(ratio((at.supply_Pa - difference) / 2), 1.0, ratio(at.supply_Pa / 2))


def soft_oil(covers: str, leaves_out: str, stiffness: Spans) -> Linear:
    """Both chambers alike, their stiffness a share of that of oil free of air which lies in a span."""
    laws: dict[str, Law] = {
        f"bulk_ratio_{side}": lambda signal, site: signal * site.parameter["stiffness_factor"] for side in "ab"
    }
    return Linear(
        covers,
        leaves_out,
        laws=laws,
        figures={"stiffness_factor": stiffness},
        with_load=True,
        elements=lambda own, figure: Elements(oil=own["stiffness_factor"]),
    )


AIR = (
    Parameter("air_fraction", 0.05, 1e-4, 0.3, 0.8, "share of the volume that is free air at atmospheric pressure"),
    Parameter("oil_bulk_modulus_Pa", 1.4e9, 0.7e9, 2.2e9, 0.15, "of the oil free of air"),
)

EFFECT = Effect(
    name="entrained_air",
    subsystem="oil",
    laws={
        "bulk_ratio_a": lambda signal, site: signal * _law(site.port["pressure_a_Pa"], site),
        "bulk_ratio_b": lambda signal, site: signal * _law(site.port["pressure_b_Pa"], site),
    },
    parameters=AIR,
    states=(),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 2: oil and air (n = 1.4) at one pressure",
    linear=soft_oil(
        "oil spring from that at the lowest pressure of a chamber to that of oil free of air, alike in both chambers",
        "chambers of different stiffness",
        _stiffness,
    ),
)
