"""Unequal piston areas: the rod takes room on one side, so that the same flow moves the piston faster one way.

The valve meters the oil into the chamber it fills, and the other chamber empties as the piston drives it: the piston's
speed is the flow over the area of the side being filled. Where the flow is near null, the side of chamber b counts.
"""

from typing import Any

import casadi as ca

from beamdesign.rig.effect import Effect, Parameter, Site


def _per_side(signal: Any, site: Site) -> Any:
    """Metered flow, as that which would move a piston of the mean area at the same speed."""
    asymmetry = site.parameter["asymmetry"]
    return signal * ca.if_else(signal > 0, 1 / (1 + asymmetry), 1 / (1 - asymmetry))


EFFECT = Effect(
    name="unequal_piston_areas",
    subsystem="actuator",
    laws={"metered_m3_per_s": _per_side},
    parameters=(
        Parameter(
            "asymmetry",
            0.121,
            -0.5,
            0.5,
            0.12,
            "(A_a - A_b)/(A_a + A_b); 0.121 is a bore of 12.7 mm with the published mean area of 1.13 cm2",
        ),
    ),
    states=(),
    source="Zalucky and Hardt (1984), Appendix and experimental results: the smaller side governs",
)
