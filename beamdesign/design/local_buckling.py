"""Local buckling of thin walls by EN 1999-1-1:2007 (Eurocode 9), for square tubes in bending, without welds.

A wall too slender for its class limit counts with a reduced thickness where it is compressed (clauses 6.1.4 and 6.1.5),
and the bending resistance is that of the effective section (6.2.5). Elastic throughout: the reserve that 6.2.5 allows
to stocky (class 1 and 2) sections by plastic bending is left out, on the safe side.
"""

from typing import Literal

from beamdesign.section import Quantity, area, positive_part, second_moment

GAMMA_M1 = 1.1
"""Partial factor for the resistance of members, clause 6.1.3, Table 6.1."""

WEB_SLENDERNESS = 0.40
"""beta over b / t of an internal part whose neutral axis is at its centre, clause 6.1.4.3(1)."""


LOCAL_BUCKLING_CONSTANTS = {"A": (32.0, 220.0), "B": (29.0, 198.0)}
"""C1 and C2 of the local buckling factor of an internal part: Table 6.3, without welds."""

BucklingClass = Literal["A", "B"]


def flat_width(width: Quantity, wall: Quantity, corner_radius: Quantity = 0.0) -> Quantity:
    """Width b of the flat part of a wall, between the inside faces of its neighbours or between rounded corners, m."""
    return width - 2 * (wall + positive_part(corner_radius - wall))


def relative_slenderness(
    width: Quantity, wall: Quantity, proof_strength: float, corner_radius: Quantity = 0.0
) -> tuple[Quantity, Quantity]:
    """Relative slenderness beta / epsilon of the compressed flange and of the webs of a square tube in bending.

    epsilon = sqrt(250 MPa / f_o) (Table 6.2); the stress gradient in the webs is that of the gross section.

    Args:
        width: outside width, m.
        wall: wall thickness t, m.
        proof_strength: f_o, Pa.
        corner_radius: outside corner radius, m.

    Returns:
        Flange, beta = b / t, and web, beta = 0.40 b / t, each over epsilon.
    """
    epsilon = (250e6 / proof_strength) ** 0.5
    flange = flat_width(width, wall, corner_radius) / wall / epsilon
    return flange, WEB_SLENDERNESS * flange


def buckling_curve(slenderness: Quantity, buckling_class: BucklingClass) -> Quantity:
    """C1 / x - C2 / x^2 at x = beta / epsilon, held constant below its maximum at x = 2 C2 / C1.

    There it exceeds 1, so that `min(1, buckling_curve)` is the local buckling factor, while the curve itself has a
    continuous slope: an optimiser gets rho_c <= 1 and rho_c <= buckling_curve and never meets the kink between them.
    """
    first, second = LOCAL_BUCKLING_CONSTANTS[buckling_class]
    peak = 2 * second / first
    held = peak + positive_part(slenderness - peak)
    return first / held - second / held**2


def local_buckling_factor(slenderness: Quantity, buckling_class: BucklingClass) -> Quantity:
    """rho_c = t_eff / t of a compressed internal part of relative slenderness beta / epsilon, clause 6.1.5(2).

    1 up to the class 3 limit, C1 / x - C2 / x^2 beyond it.
    """
    return 1 - positive_part(1 - buckling_curve(slenderness, buckling_class))


def effective_modulus(
    width: Quantity,
    wall: Quantity,
    flange_factor: Quantity,
    web_factor: Quantity,
    corner_radius: Quantity = 0.0,
) -> Quantity:
    """Effective elastic section modulus W_eff of a square tube in bending, for its compressed edge, clause 6.2.5.2.

    The compressed flange counts with thickness rho t about its mid-plane; this lowers the neutral axis; the webs count
    with their own reduced thickness from there to the compressed flange. Corners and everything in tension stay whole.
    One pass: the web is not reclassified for the lowered axis.

    Args:
        width: outside width, m.
        wall: wall thickness t, m.
        flange_factor: rho_c of the compressed flange.
        web_factor: rho_c of the webs.
        corner_radius: outside corner radius, m.

    Returns:
        W_eff, m3; with both factors 1 the gross elastic modulus. It grows with each factor.
    """
    flat = flat_width(width, wall, corner_radius)
    flange_lost = (1 - flange_factor) * wall * flat
    flange_height = (width - wall) / 2
    area_left = area(width, wall, corner_radius) - flange_lost
    axis = -flange_lost * flange_height / area_left

    depth = flat / 2 - axis
    web_lost = 2 * (1 - web_factor) * wall * depth
    web_height = (flat / 2 + axis) / 2
    area_left = area_left - web_lost
    axis = -(flange_lost * flange_height + web_lost * web_height) / area_left

    about_middle = (
        second_moment(width, wall, corner_radius)
        - flange_lost * flange_height**2
        - flat * wall**3 * (1 - flange_factor**3) / 12
        - web_lost * (web_height**2 + depth**2 / 12)
    )
    return (about_middle - area_left * axis**2) / (width / 2 - axis)


def bending_resistance(
    width: Quantity,
    wall: Quantity,
    proof_strength: float,
    buckling_class: BucklingClass,
    corner_radius: Quantity = 0.0,
    factors: tuple[Quantity, Quantity] | None = None,
) -> Quantity:
    """Design bending resistance M_c,Rd = W_eff f_o / gamma_M1 of a square tube, clause 6.2.5.1(2).

    Args:
        width: outside width, m.
        wall: wall thickness, m.
        proof_strength: f_o, Pa.
        buckling_class: "A" or "B" of the alloy.
        corner_radius: outside corner radius, m.
        factors: local buckling factors of flange and webs, instead of those that follow from the slenderness.

    Returns:
        Moment, N m.
    """
    if factors is None:
        flange, web = relative_slenderness(width, wall, proof_strength, corner_radius)
        factors = local_buckling_factor(flange, buckling_class), local_buckling_factor(web, buckling_class)
    modulus = effective_modulus(width, wall, *factors, corner_radius)
    return modulus * proof_strength / GAMMA_M1
