"""Square tubes: area, second moment, section modulus, mass and clearance, on floats, numpy arrays and CasADi symbols.

A rounded square of side a with corners of radius r is the sharp square less four corner pieces; a tube is the outside
square less the opening. The inside corner radius is what the wall leaves of the outside one, `max(r - wall, 0)`.
All results but the torsion constant are exact; nothing else is a thin-wall approximation.

Local buckling of thin walls is that of EN 1999-1-1:2007 (Eurocode 9), for square tubes in bending, without welds.
A wall too slender for its class limit counts with a reduced thickness where it is compressed (clauses 6.1.4 and 6.1.5),
and the bending resistance is that of the effective section (6.2.5). Elastic throughout: the reserve that 6.2.5 allows
to stocky (class 1 and 2) sections by plastic bending is left out, on the safe side.
"""

from collections.abc import Iterator, Mapping
from math import pi
from typing import Any, NamedTuple, TypeAlias

from beamdesign.records import Problem, numbers

Quantity: TypeAlias = Any
"""A float, a numpy array or a CasADi expression; the functions give back what they are given (broadcast)."""


class SquareTube(NamedTuple):
    """Outside width and wall of a square tube, in m."""

    width_m: float
    wall_m: float


def positive_part(value: Quantity) -> Quantity:
    """`max(value, 0)`, in operations that floats, arrays and symbols share; exact in floating point."""
    return (value + abs(value)) / 2


def area(width: Quantity, wall: Quantity, corner_radius: Quantity = 0.0) -> Quantity:
    """Cross-section area of a square tube.

    Args:
        width: outside width, m.
        wall: wall thickness, m, less than half the width.
        corner_radius: outside corner radius r, m; 0 is sharp, inside and out. At most half the width.

    Returns:
        Area, m2: 4 t (w - t) - (4 - pi) (r^2 - max(r - t, 0)^2).
    """
    inner_radius = positive_part(corner_radius - wall)
    return 4 * wall * (width - wall) - (4 - pi) * (corner_radius**2 - inner_radius**2)


def second_moment(width: Quantity, wall: Quantity, corner_radius: Quantity = 0.0) -> Quantity:
    """Second moment of area about either centroidal axis parallel to a side, symbol I.

    Args:
        width: outside width, m.
        wall: wall thickness, m.
        corner_radius: outside corner radius, m.

    Returns:
        Second moment, m4.
    """
    opening = width - 2 * wall
    # a^4 - b^4 factored, so that thin walls do not cancel.
    sharp = 4 * wall * (width - wall) * (width**2 + opening**2) / 12
    inner_radius = positive_part(corner_radius - wall)
    return sharp - _corners_second_moment(width, corner_radius) + _corners_second_moment(opening, inner_radius)


def _corners_second_moment(side: Quantity, radius: Quantity) -> Quantity:
    """What rounding the four corners of a square takes from its second moment.

    Each corner piece is a square of side r less a quarter disc of radius r about the inner vertex of that square; with
    h = side / 2, integrating y^2 over the difference gives the polynomial below.
    """
    half = side / 2
    return 4 * radius**2 * (
        (1 - pi / 4) * half**2 - (5 / 3 - pi / 2) * half * radius + (1 - 5 * pi / 16) * radius**2
    )  # fmt: skip


def elastic_modulus(width: Quantity, wall: Quantity, corner_radius: Quantity = 0.0) -> Quantity:
    """Elastic section modulus W = I / (w / 2), m3, from outside width, wall and outside corner radius in m."""
    return second_moment(width, wall, corner_radius) / (width / 2)


def flexural_rigidity(youngs_modulus: Quantity, second_moment_of_area: Quantity) -> Quantity:
    """E I, N m2, from E in Pa and I in m4."""
    return youngs_modulus * second_moment_of_area


def mass_per_length(width: Quantity, wall: Quantity, density: Quantity, corner_radius: Quantity = 0.0) -> Quantity:
    """Mass of the tube per unit length, symbol m in equation (1), kg/m, from m, m, kg/m3 and m."""
    return density * area(width, wall, corner_radius)


def torsion_constant(width: Quantity, wall: Quantity, corner_radius: Quantity = 0.0) -> Quantity:
    """Torsion constant of a square tube of thin wall, symbol J, m4.

    Bredt's 4 A^2 t / p of the wall's middle line, and what the wall has by itself, p t^3 / 3; EN 10219-2:2006, Annex B,
    has the same. A tube whose wall is a tenth of its width is within a few per cent of the exact solution; sharp inside
    corners add a little that is left out. Since all four walls are alike the section does not warp, so that a clamped
    end hinders nothing (thin-walled theory).

    Args:
        width: outside width, m.
        wall: wall thickness t, m.
        corner_radius: outside corner radius, m; 0 is sharp.
    """
    side, middle_radius = width - wall, positive_part(corner_radius - wall / 2)
    enclosed = side**2 - (4 - pi) * middle_radius**2
    perimeter = 4 * side - (8 - 2 * pi) * middle_radius
    return 4 * enclosed**2 * wall / perimeter + perimeter * wall**3 / 3


def clearance(outer_width: Quantity, outer_wall: Quantity, inner_width: Quantity) -> Quantity:
    """Gap per side between the inner tube, centred, and the inside of the outer one, m; negative if it does not fit."""
    return (outer_width - 2 * outer_wall - inner_width) / 2


GAMMA_M1 = 1.1
"""Partial factor for the resistance of members, clause 6.1.3, Table 6.1."""

WEB_SLENDERNESS = 0.40
"""beta over b / t of an internal part whose neutral axis is at its centre, clause 6.1.4.3(1)."""


LOCAL_BUCKLING_CONSTANTS = {"A": (32.0, 220.0), "B": (29.0, 198.0)}
"""C1 and C2 of the local buckling factor of an internal part: Table 6.3, without welds."""


def elastic_buckling_constants(modulus: float, poissons_ratio: float) -> tuple[float, float]:
    """C1 and C2 of a plate of a modulus (Pa), by Winter's curve rho = 1 / lambda - 0.22 / lambda^2.

    The slenderness lambda is sqrt(f / sigma_cr) with sigma_cr = 4 pi^2 E / (12 (1 - nu^2)) (t / b)^2, as in
    EN 1993-1-5:2006, clause 4.4. For aluminium that is row A of Table 6.3 of EN 1999-1-1; for webs it is on the safe
    side, since there EN 1993 has 0.11 in the place of 0.22.
    """
    first = (4 * pi**2 * modulus / (12 * (1 - poissons_ratio**2)) / 250e6) ** 0.5
    return first, 0.22 * first**2


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


def buckling_curve(slenderness: Quantity, constants: tuple[float, float]) -> Quantity:
    """C1 / x - C2 / x^2 at x = beta / epsilon, held constant below its maximum at x = 2 C2 / C1.

    There it exceeds 1, so that `min(1, buckling_curve)` is the local buckling factor, while the curve itself has a
    continuous slope: an optimiser gets rho_c <= 1 and rho_c <= buckling_curve and never meets the kink between them.
    """
    first, second = constants
    peak = 2 * second / first
    held = peak + positive_part(slenderness - peak)
    return first / held - second / held**2


def local_buckling_factor(slenderness: Quantity, constants: tuple[float, float]) -> Quantity:
    """rho_c = t_eff / t of a compressed internal part of relative slenderness beta / epsilon, clause 6.1.5(2).

    1 up to the class 3 limit, C1 / x - C2 / x^2 beyond it.
    """
    return 1 - positive_part(1 - buckling_curve(slenderness, constants))


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
    constants: tuple[float, float],
    corner_radius: Quantity = 0.0,
    factors: tuple[Quantity, Quantity] | None = None,
) -> Quantity:
    """Design bending resistance M_c,Rd = W_eff f_o / gamma_M1 of a square tube, clause 6.2.5.1(2).

    Args:
        width: outside width, m.
        wall: wall thickness, m.
        proof_strength: f_o, Pa.
        constants: C1 and C2 of the local buckling factor.
        corner_radius: outside corner radius, m.
        factors: local buckling factors of flange and webs, instead of those that follow from the slenderness.

    Returns:
        Moment, N m.
    """
    if factors is None:
        flange, web = relative_slenderness(width, wall, proof_strength, corner_radius)
        factors = local_buckling_factor(flange, constants), local_buckling_factor(web, constants)
    modulus = effective_modulus(width, wall, *factors, corner_radius)
    return modulus * proof_strength / GAMMA_M1


def impossible_tube(table: Mapping[str, Any]) -> Iterator[Problem]:
    """Walls that do not fit in widths, and free lengths not in lengths."""
    if (pair := numbers(table, "wall_m", "width_m")) and pair[0] >= pair[1] / 2 > 0:
        yield Problem("wall_m", f"{pair[0]} is not less than half the width, {pair[1] / 2}")
    if (pair := numbers(table, "free_length_m", "length_m")) and pair[0] > pair[1] > 0:
        yield Problem("free_length_m", f"{pair[0]} exceeds length_m, {pair[1]}")
