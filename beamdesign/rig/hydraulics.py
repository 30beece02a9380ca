"""Cylinder, oil and servovalve as laws at ports.

The paper's leakage K_pq and oil spring K_c belong to the load pressure; here each chamber has its half of them, so that
for equal chambers the difference of their pressures obeys the paper's equations (11), (13) and (14), and the mean
pressure is a state which nothing drives and nothing sees.
"""

from collections.abc import Mapping
from typing import Any

SUPPLY_PRESSURE_PA = 20e6
"""Supply of the published rig. It sets the chambers' mean pressure and has no part in the linear model."""


def port_leakage(leakage: Any, pressure: Any, supply: Any) -> Any:
    """Flow that leaves a chamber through the closed valve, m3/s: none at half the supply pressure."""
    return 2 * leakage * (pressure - supply / 2)


def chamber_stiffness(oil_stiffness: Any, nominal_area: Any, area: Any, ratio: Any) -> Any:
    """Pressure gained per volume forced into one chamber, Pa/m3.

    The volume at mid-stroke goes with the area, so that the two chambers in parallel are the oil spring K_c whatever
    their areas.

    Args:
        oil_stiffness: K_c, N/m.
        nominal_area: A, mean of both sides, m2.
        area: of this side, m2.
        ratio: bulk modulus over that of air-free oil.
    """
    return ratio * oil_stiffness / (2 * nominal_area * area)


def pressure_force(port: Mapping[str, Any], state: Mapping[str, Any]) -> Any:
    """Force of the oil on the outer beam (and its opposite on the rod), N."""
    return port["area_a_m2"] * state["pressure_a_Pa"] - port["area_b_m2"] * state["pressure_b_Pa"]
