"""Valve deadband: an overlapped spool meters nothing until it has crossed the overlap."""

from typing import Any

import casadi as ca

from beamdesign.plant.effects import Effect, Linear, Parameter, Site, Span


def _law(signal: Any, site: Site) -> Any:
    overlap = site.figure["flow_gain"] * site.parameter["half_width_A"]
    return signal - ca.fmin(ca.fmax(signal, -overlap), overlap)


EFFECT = Effect(
    name="valve_deadband",
    subsystem="servovalve",
    laws={"metered_m3_per_s": _law},
    parameters=(
        Parameter("half_width_A", 0.2e-3, 0.0, 5e-3, 0.3e-3, "current to either side of null that opens nothing"),
    ),
    source="H. E. Merritt, Hydraulic Control Systems (1967), chapter 5, overlapped spool valves",
    linear=Linear(
        "gain from none to the whole, the sector in which a dead band lies; performance for flows well beyond it",
        "limit cycles, and the motion within the dead band, which nothing opposes",
        laws={},
        gain=lambda own, at: Span(0.0, 1.0, 1.0, (1.0, 1.0)),
        near_rest="compliance",
    ),
)
