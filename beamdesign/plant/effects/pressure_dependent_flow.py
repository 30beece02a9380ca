"""Pressure-dependent valve flow: sharp-edged orifices, whose flow goes with the root of the pressure drop.

With the chambers at half the supply pressure it is the linear valve, so that it linearises to it there. The opening
alone counts, not what a valve that heeds no pressure would pass through either port.
"""

from math import sqrt
from typing import Any

import casadi as ca

from beamdesign.plant.component import SIGN, either
from beamdesign.plant.effects import Effect, Figures, Linear, Operation, Parameter, Site, Span

_SMOOTH = 1e-3  # of the supply pressure: below this drop the root goes over to a straight line


def _root(drop: Any) -> Any:
    """Signed root of a relative pressure drop, with a finite slope at none."""
    return drop / ca.sqrt(ca.sqrt(drop**2 + _SMOOTH**2))


def _orifice(side: str, signal: Any, site: Site) -> Any:
    """Flow through a port, which opens to the supply where it goes into the chamber, and to the tank elsewhere."""
    flow, pressure = SIGN[side] * site.port[f"opening_{side}_m3_per_s"], site.port[f"pressure_{side}_Pa"]
    supply, tank = site.port["supply_pressure_Pa"], site.port["tank_pressure_Pa"]
    drop = ca.if_else(flow > 0, supply - pressure, pressure - tank)
    return SIGN[side] * (flow * _root(drop / site.parameter["supply_pressure_Pa"]) / float(_root(0.5)))


def _gain(own: Figures, at: Operation) -> Span:
    """Root of the pressure drop over that at half the supply, at the largest load either way."""
    share = at.difference_Pa / own["supply_pressure_Pa"]
    if share >= 1:
        raise ValueError(
            f"a load of {at.load_N:g} N takes all of the supply pressure, so that the valve passes nothing"
        )
    return Span(sqrt(1 - share), sqrt(1 + share), 1.0)


EFFECT = Effect(
    name="pressure_dependent_flow",
    subsystem="servovalve",
    laws={
        # its own supply instead of the rig's, less what the rig takes off it
        "supply_pressure_Pa": lambda signal, site: (
            site.parameter["supply_pressure_Pa"] + (signal - site.figure["supply_pressure"])
        ),
        **either("orifice_{}_m3_per_s", _orifice),
    },
    parameters=(Parameter("supply_pressure_Pa", 20e6, 2e6, 60e6, 0.3, "20 MPa is the supply of the published rig"),),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 5, critical-centre valve",
    linear=Linear(
        "flow gain from that against the largest load to that with it, the valve near null",
        "flow that gives way to pressure while the valve is open",
        laws={},
        gain=_gain,
        with_load=True,
    ),
)
