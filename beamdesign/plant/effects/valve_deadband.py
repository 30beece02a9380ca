"""Valve deadband: an overlapped spool meters nothing until it has crossed the overlap."""

from dataclasses import replace
from math import hypot
from typing import Any

import casadi as ca

from beamdesign.plant.effects import Effect, Figures, Linear, Operation, Parameter, Site, Span, limited


def _law(signal: Any, site: Site) -> Any:
    return signal - limited(signal, site.figure["flow_gain"] * site.parameter["half_width_A"])


LINEAR = Linear(
    "gain from none to the whole, the sector in which a dead band lies; performance for flows well beyond it",
    "limit cycles, and the motion within the dead band, which nothing opposes",
    laws={},
    gain=lambda own, at: Span(0.0, 1.0, 1.0, (1.0, 1.0)),
    near_rest="compliance",
)

EFFECT = Effect(
    name="valve_deadband",
    subsystem="servovalve",
    laws={"metered_m3_per_s": _law},
    parameters=(
        Parameter(
            "half_width_A", 0.2e-3, 0.0, 5e-3, 0.3e-3, "current to either side of null that opens nothing", "current"
        ),
    ),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 5, overlapped spool valves",
    linear=LINEAR,
)


def _rounded(signal: Any, site: Site) -> Any:
    overlap = site.figure["flow_gain"] * site.parameter["half_width_A"]
    clearance = overlap * site.parameter["clearance_ratio"]
    before, past = (ca.sqrt((signal - side * overlap) ** 2 + clearance**2) for side in (1, -1))
    return signal + (before - past) / 2


def _at_rest(own: Figures, at: Operation) -> Span:
    """Slope at null, where it is least, to that far beyond the overlap."""
    least = 1 - 1 / hypot(1, own["clearance_ratio"])
    return Span(least, 1.0, least, (1.0, 1.0))


ROUNDED = Effect(
    name="valve_deadband_rounded",
    meaning="""Rounded valve deadband: an overlapped spool with clearance and rounded edges opens gradually.

        An edge that is y past its port, at the clearance c, opens (y + sqrt(y^2 + c^2)) / 2: the whole way far beyond
        the edge, and a little before it. The flow is what one edge opens less what the other one does.""",
    subsystem="servovalve",
    laws={"metered_m3_per_s": _rounded},
    parameters=(
        Parameter(
            "half_width_A", 0.2e-3, 1e-7, 5e-3, 0.8, "current to either side of null at which an edge opens", "current"
        ),
        Parameter("clearance_ratio", 0.1, 0.02, 0.5, 0.5, "clearance and rounding of the edges over the overlap"),
    ),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 5: orifices with radial clearance, overlapped",
    linear=replace(
        LINEAR,
        covers="gain from that at null, where the edges leave little open, to the whole; performance for flows well"
        " beyond the overlap",
        leaves_out="limit cycles, and how little opposes motion within the overlap",
        gain=_at_rest,
    ),
    realises="valve_deadband",
)
