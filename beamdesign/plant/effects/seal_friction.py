"""Friction of the piston's seal or of a screw: Stribeck curve with presliding (Dahl) and a viscous share.

The seal's deflection over the presliding distance is a state that follows the stroke and settles at the direction of
motion. It settles no faster than `beamdesign.plant.effects.QUICKEST`, which bounds the stiffness of the equations and
shows only at speeds above that rate times the presliding distance.
"""

from math import e, sqrt
from typing import Any

import casadi as ca
from flint import fmpq

from beamdesign.plant.effects import Effect, Elements, Figures, Linear, Operation, Parameter, Site, Span, dahl_rate


def _law(signal: Any, site: Site) -> Any:
    speed, deflection = site.port["sliding_m_per_s"], site.state["deflection"]
    figure = site.parameter
    site.rate["deflection"] = dahl_rate(speed / figure["presliding_m"], deflection)
    excess = (figure["breakaway_ratio"] - 1) * ca.exp(-((speed / figure["stribeck_m_per_s"]) ** 2))
    return signal + figure["coulomb_N"] * (1 + excess) * deflection + figure["viscous_N_s_per_m"] * speed


def _spring(own: Figures, at: Operation) -> Span:
    """Slope of friction over stroke: at most twice that at rest, where the deflection is turned back from full."""
    slope = own["coulomb_N"] * own["breakaway_ratio"] / own["presliding_m"]
    return Span(0.0, 2 * slope, slope, (0.0, 0.0))


def _dashpot(own: Figures, at: Operation) -> Span:
    """Slope of friction over speed: least where exp(-v^2/vs^2) falls most steeply."""
    fall = own["coulomb_N"] * (own["breakaway_ratio"] - 1) * sqrt(2 / e) / own["stribeck_m_per_s"]
    return Span(own["viscous_N_s_per_m"] - fall, own["viscous_N_s_per_m"], own["viscous_N_s_per_m"])


EFFECT = Effect(
    name="seal_friction",
    subsystem="actuator",
    laws={"friction_N": _law},
    parameters=(
        Parameter("coulomb_N", 60.0, 0.0, 1000.0, 50.0, "friction of steady sliding", "force"),
        Parameter("breakaway_ratio", 1.0, 1.0, 3.0, 0.3, "friction at the onset of sliding over that at speed"),
        Parameter("stribeck_m_per_s", 0.005, 1e-4, 0.1, 0.7, "speed at which the excess has gone to 1/e"),
        Parameter("presliding_m", 10e-6, 1e-6, 200e-6, 0.8, "deflection of the seal before it slides"),
        Parameter("viscous_N_s_per_m", 0.0, 0.0, 5000.0, 200.0, "force per speed", "force"),
    ),
    states=("deflection",),
    memory=("deflection",),
    source="P. R. Dahl, AIAA J. 14 (1976) 1675; B. Armstrong-Helouvry et al., Automatica 30 (1994) 1083 (Stribeck)",
    linear=Linear(
        "the seal as a spring between piston and cylinder, from none while it slides to its stiffest just after a"
        " reversal, and a dashpot from the falling to the level part of the Stribeck curve; performance while it"
        " slides",
        "stick-slip",
        laws={
            "friction_N": lambda signal, site: (
                signal
                + site.parameter["spring_N_per_m"] * site.port["sliding_m"]
                + site.parameter["dashpot_N_s_per_m"] * site.port["sliding_m_per_s"]
            )
        },
        figures={"spring_N_per_m": _spring, "dashpot_N_s_per_m": _dashpot},
        elements=lambda own, figure: Elements(
            (({"slide": fmpq(1)}, (own["spring_N_per_m"], own["dashpot_N_s_per_m"])),)
        ),
        near_rest="compliance",
    ),
)
