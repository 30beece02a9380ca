"""Square tubes: area, second moment, section modulus, mass and clearance, on floats, numpy arrays and CasADi symbols.

A rounded square of side a with corners of radius r is the sharp square less four corner pieces; a tube is the outside
square less the opening. The inside corner radius is what the wall leaves of the outside one, `max(r - wall, 0)`.
All results but the torsion constant are exact; nothing else is a thin-wall approximation.
"""

from math import pi
from typing import Any, NamedTuple, TypeAlias

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
