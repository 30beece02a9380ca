"""Uneven valve leakage: worn edges let more oil from the supply into chamber a, and from b to the tank.

Each port leaks from the supply and to the tank; where the two differ, the closed valve holds a load pressure of the
imbalance times the supply, and nulls at a current of that pressure over the pressure gain.
"""

from typing import Any

from beamdesign.plant.component import SIGN, either
from beamdesign.plant.effects import Effect, Elements, Linear, Parameter, Site


def _law(side: str, signal: Any, site: Site) -> Any:
    more = site.figure["leakage"] * site.port["supply_pressure_Pa"] * site.parameter["imbalance"]
    return signal - SIGN[side] * more


EFFECT = Effect(
    name="uneven_leakage",
    subsystem="servovalve",
    laws=either("leakage_{}_m3_per_s", _law),
    parameters=(
        Parameter("imbalance", 0.1, -0.95, 0.95, 0.2, "leakage from the supply less that to the tank, over their sum"),
    ),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 5, leakage of worn and of new spool valves",
    linear=Linear(
        "as it is: it shifts where the valve nulls",
        "that the load pressure at rest is not zero",
        elements=lambda own, figure: Elements(),
    ),
)
