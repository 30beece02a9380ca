"""Unequal piston areas: the rod takes room on one side.

The sides themselves are unequal: in the force A_a p_a - A_b p_b and in what each chamber takes up as the piston moves.
A valve with orifices then finds the flows of its ports by itself, from the pressures. A valve that heeds no pressure
cannot feed two unequal sides at one speed; it meters the oil into the chamber that fills, and the other empties as the
piston drives it. So the speed is the flow over the area of the side being filled, faster one way than the other; about
null, where either side may be the one that fills, the smaller side counts.

At half the supply in both chambers such a cylinder would push. Where a rig's null is adjusted so that it rests without
load, the leakage of the closed valve holds the pressures at which the two sides balance.
"""

from typing import Any

import casadi as ca

from beamdesign.plant.component import SIGN, either
from beamdesign.plant.effects import Effect, Elements, Figures, Linear, Operation, Parameter, Site, Span


def _share(side: str, signal: Any, site: Site) -> Any:
    """A signal of the mean area as it is on the side whose area is 1 + asymmetry, or 1 - asymmetry, times that."""
    return signal * (1 + SIGN[side] * site.parameter["asymmetry"])


def _passed(side: str, signal: Any, site: Site) -> Any:
    """Flow through the port of a side."""
    asymmetry = site.parameter["asymmetry"]
    fills_a = ca.if_else(asymmetry > 0, signal > 0, signal >= 0)  # at null: the smaller side
    return _share(side, signal, site) / ca.if_else(fills_a, 1 + asymmetry, 1 - asymmetry)


def _null(side: str, signal: Any, site: Site) -> Any:
    """With leakage at half the supply pressure that brings the chambers to the pressures of no load, m3/s."""
    leakage = site.port["null_adjusted"] * site.figure["leakage"]
    return signal + SIGN[side] * (leakage * site.port["supply_pressure_Pa"] * site.parameter["asymmetry"])


def _gain(own: Figures, at: Operation) -> Span:
    """Over the flow of the mean area, which each side takes in the share of its own, as the linear member has it."""
    size = abs(own["asymmetry"])
    if at.orifices:  # feed both sides alike: as much force at once, less at rest, where the mean pressure gives way
        return Span(1 / (1 + size**2), 1.0, 1.0)
    return Span(1 / (1 + size), 1 / (1 - size), 1 / (1 - size))


EFFECT = Effect(
    name="unequal_piston_areas",
    subsystem="actuator",
    laws={
        **either("area_{}_m2", _share),
        **either("linear_{}_m3_per_s", _passed),
        **either("leakage_{}_m3_per_s", _null),
    },
    parameters=(
        Parameter(
            "asymmetry", 0.121, -0.5, 0.5, 0.12,
            "(A_a - A_b)/(A_a + A_b); 0.121 is a bore of 12.7 mm with the published mean area of 1.13 cm2",
        ),
    ),
    source="Zalucky and Hardt (1984), Appendix and experimental results: the smaller side governs",
    linear=Linear(
        "flow gain from that of the larger side to that of the smaller one; with orifices that of the mean area, down"
        " to what leakage leaves of it at rest",
        "the change of sides within one motion",
        laws={**either("area_{}_m2", _share), **either("linear_{}_m3_per_s", _share)},
        gain=_gain,
        elements=lambda own, figure: Elements(asymmetry=own["asymmetry"]),
    ),
)  # fmt: skip
