"""A square tube with rounded corners, in balls: area, second moment, torsion constant.

Zalucky and Hardt (1984), equations (3) and (5), for bending; for torsion Bredt's formula with what a thin wall has by
itself, as EN 10219-2:2006, Annex B.
"""

from flint import arb, fmpq

from beamdesign.checker.law import FLOAT_ROUNDING

ROUNDING = 1000 * FLOAT_ROUNDING
"""Of a figure that floats have worked out of a section's geometry."""


def agree(stated: fmpq, value: arb) -> bool:
    """Whether a figure is one that floats have worked out."""
    return bool(abs(arb(stated) - value) <= abs(value) * arb(ROUNDING))


def area(width: arb, wall: arb, radius: arb) -> arb:
    """Of the cross-section, m2, from outside width, wall and outside corner radius in m."""
    return width**2 - (width - 2 * wall) ** 2 - (4 - arb.pi()) * (radius**2 - _positive(radius - wall) ** 2)


def second_moment(width: arb, wall: arb, radius: arb) -> arb:
    """About an axis parallel to a side, m4; the polar one is twice that."""
    opening = width - 2 * wall
    return (width**4 - opening**4) / 12 - _corners(width, radius) + _corners(opening, _positive(radius - wall))


def torsion_constant(width: arb, wall: arb, radius: arb) -> arb:
    """4 A^2 t / p + p t^3 / 3 of the wall's middle line, m4."""
    side, turn = width - wall, _positive(radius - wall / 2)
    straight, arc = side - 2 * turn, arb.pi() * turn / 2
    around, within = 4 * (straight + arc), straight**2 + 4 * straight * turn + arb.pi() * turn**2
    return 4 * within**2 * wall / around + around * wall**3 / 3


def _positive(value: arb) -> arb:
    return value if value > 0 else arb(0)


def _corners(side: arb, radius: arb) -> arb:
    """Second moment of what rounding takes from a square's corners: four squares less four quarter discs."""
    to_centre = side / 2 - radius
    square = radius**4 / 12 + radius**2 * (to_centre + radius / 2) ** 2
    centroid = 4 * radius / (3 * arb.pi())
    disc = arb.pi() * radius**2 / 4
    quarter = arb.pi() * radius**4 / 16 - disc * centroid**2 + disc * (to_centre + centroid) ** 2
    return 4 * (square - quarter)
