"""Valve hysteresis: Dahl friction on the spool, so that the current has to go back before the spool does.

As in `seal_friction` the friction settles no faster than a bound.
"""

from typing import Any

import casadi as ca

from beamdesign.plant.effect import Effect, Elements, Linear, Parameter, Site, Span

_QUICKEST = 1e4  # 1/s


def _law(signal: Any, site: Site) -> Any:
    width, state = site.parameter["half_width_A"], site.state["friction"]
    rate = site.port["flow_m3_per_s2"] / (site.figure["flow_gain"] * width * site.parameter["travel"])
    rate = rate / ca.sqrt(1 + (rate / _QUICKEST) ** 2)
    site.rate["friction"] = rate - ca.fabs(rate) * state
    return signal - width * state


EFFECT = Effect(
    name="valve_hysteresis",
    subsystem="servovalve",
    laws={"spool_A": _law},
    parameters=(
        Parameter("half_width_A", 0.1e-3, 1e-6, 5e-3, 0.8, "half the width of the loop of flow over current"),
        Parameter(
            "travel",
            1.0,
            0.15,
            5.0,
            0.7,
            "of the spool until its friction has turned about, over the half width; the quicker, the more like play",
        ),
    ),
    states=("friction",),
    memory=("friction",),
    source="P. R. Dahl, AIAA J. 14 (1976) 1675, here on the spool",
    linear=Linear(
        "the friction as a spring on the spool, from none while it slides to its stiffest just after a reversal;"
        " performance while it slides",
        "limit cycles",
        laws={
            "spool_A": lambda signal, site: (
                signal - site.parameter["spring"] * site.port["flow_m3_per_s"] / site.figure["flow_gain"]
            )
        },
        near_rest="compliance",
        figures={"spring": lambda own, at: Span(0.0, 2 / own["travel"], 1 / own["travel"], (0.0, 0.0))},
        elements=lambda own, figure: Elements(spool=own["spring"]),
    ),
)
