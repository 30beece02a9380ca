"""Entrained air: free air in the oil, which gives way more the lower the pressure."""

from typing import Any

import casadi as ca

from beamdesign.plant.component import SIGN, Signals, either
from beamdesign.plant.effects import Effect, Elements, Figures, Linear, Operation, Parameter, Site, Span, Spans, limited

_ATMOSPHERE_PA = 101_325.0
POLYTROPIC = 1.4
_LEAST_PRESSURE_PA = 20_000.0  # absolute; below this the oil would cavitate


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


def _of(pressure: Any, own: Signals) -> Any:
    exponent = own.get("polytropic_exponent", POLYTROPIC)
    return bulk_ratio(pressure, own["air_fraction"], own["oil_bulk_modulus_Pa"], exponent)


def _stiffness(own: Figures, at: Operation, most: float = 1.0) -> Span:
    return Span(float(_of((at.supply_Pa - at.difference_Pa) / 2, own)), most, float(_of(at.supply_Pa / 2, own)))


def soft_oil(covers: str, leaves_out: str, stiffness: Spans) -> Linear:
    """Both chambers alike, their stiffness a share of that of oil free of air which lies in a span."""
    return Linear(
        covers,
        leaves_out,
        laws=either("bulk_ratio_{}", lambda side, signal, site: signal * site.parameter["stiffness_factor"]),
        figures={"stiffness_factor": stiffness},
        with_load=True,
        elements=lambda own, figure: Elements(oil=own["stiffness_factor"]),
    )


def _softened(side: str, signal: Any, site: Site) -> Any:
    return signal * _of(site.port[f"pressure_{side}_Pa"], site.parameter)


_LAWS = either("bulk_ratio_{}", _softened)
AIR = (
    Parameter("air_fraction", 0.05, 1e-4, 0.3, 0.8, "share of the volume that is free air at atmospheric pressure"),
    Parameter("oil_bulk_modulus_Pa", 1.4e9, 0.7e9, 2.2e9, 0.15, "of the oil free of air"),
)

EFFECT = Effect(
    name="entrained_air",
    subsystem="oil",
    laws=_LAWS,
    parameters=AIR,
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 2: oil and air (n = 1.4) at one pressure",
    linear=soft_oil(
        "oil spring from that at the lowest pressure of a chamber to that of oil free of air, alike in both chambers",
        "chambers of different stiffness",
        _stiffness,
    ),
)


_MOST = 0.9  # of the length of a chamber: no stroke empties it


def chamber_length(modulus: Any, figure: Signals) -> Any:
    """Volume of either chamber at mid-stroke over its area, m: both in parallel are the oil spring 2 beta A / L."""
    return 2 * modulus * figure["piston_area"] / figure["oil_stiffness"]


def _volume(side: str, signal: Any, site: Site) -> Any:
    share = site.port["stroke_m"] / chamber_length(site.parameter["oil_bulk_modulus_Pa"], site.figure)
    return signal * (1 + SIGN[side] * limited(share, _MOST))


def _leakage(side: str, signal: Any, site: Site) -> Any:
    """With equal chambers the difference of pressures heeds no share; it moves their mean alone."""
    between, share = site.port["pressure_a_Pa"] - site.port["pressure_b_Pa"], site.parameter["leakage_between_share"]
    return (1 - share) * signal + share * site.figure["leakage"] * SIGN[side] * between


def _stiffness_with_stroke(own: Figures, at: Operation) -> Span:
    """Of both chambers in parallel, (r_a/(1 + x) + r_b/(1 - x))/2 with x the stroke over the length.

    With each ratio r from that at the lowest pressure to 1, it is from the former to 1/(1 - x^2). A steady load bends
    the outer beam or the inner one, or parts of it both, in opposite senses; the stroke is largest where it is one.
    """
    stroke = at.load_N / min(at.figure["outer_stiffness"], at.figure["inner_stiffness"])
    share = min(stroke / float(chamber_length(own["oil_bulk_modulus_Pa"], at.figure)), _MOST)
    return _stiffness(own, at, 1 / (1 - share**2))


WITH_STROKE = Effect(
    name="entrained_air_with_stroke",
    meaning="""Entrained air in chambers whose volumes follow the stroke.

        With oil free of air the softer, larger chamber and the stiffer, smaller one make up for each other: both in
        parallel change with the square of the stroke. Air makes one chamber softer than the other under load, and then
        the stroke counts in the first order, so that a cylinder with air shows it where one without does not.

        The volume at mid-stroke, lines included, is that with which oil of the modulus given has the rig's own
        stiffness. The paper's leakage is that of the load pressure and does not say which share of it passes between
        the chambers and which at the edges of the valve, to supply and tank. Only the latter holds the mean pressure,
        and with air that matters too.""",
    subsystem="oil",
    laws={**_LAWS, **either("volume_ratio_{}", _volume), **either("leakage_{}_m3_per_s", _leakage)},
    parameters=(
        *AIR,
        Parameter(
            "polytropic_exponent", 1.2, 1.0, 1.4, 0.1, "1 for bubbles that keep their temperature, 1.4 without heat"
        ),
        Parameter(
            "leakage_between_share", 0.5, 0.0, 1.0, 0.29, "of the leakage, what passes from one chamber to the other"
        ),
    ),
    source="Merritt, Hydraulic Control Systems (1967), chapters 2 and 6: oil and air; volumes of the chambers",
    linear=soft_oil(
        "oil spring from that at the lowest pressure of a chamber to that of oil free of air at the stroke of the "
        "largest load, alike in both chambers",
        "chambers of different stiffness, and the share of the leakage between them; strokes beyond that of the load",
        _stiffness_with_stroke,
    ),
    realises="entrained_air",
)
