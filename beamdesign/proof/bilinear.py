"""Roots on the imaginary axis inside a rectangle of masses m and factors g on the gain that multiply each other.

With added sensors the characteristic polynomial is p = o_0 + m o_1 + g (r_0 + m r_1). It is not affine, so that the
sides of a rectangle do not decide. Where they are stable, though, neither the leading coefficient nor p(0) vanishes
inside: both are bilinear, and of one sign at the corners. So the points with a root at jw, if there are any, are a
compact set inside the rectangle and above w = 0. At the largest x = w^2 of it the even part E and the odd part O of p
have dependent gradients in (m, g), else x could grow (implicit function theorem). With subscripts for derivatives,

    R(g) = E O_m - O E_m

is free of m and quadratic in g; there, R = 0 and R' = E_g O_m - O_g E_m = 0. So x is a root of R's discriminant, a
polynomial. Each such root gives one g and one m, which are inside the rectangle or not.
"""

from dataclasses import dataclass
from math import pi, sqrt

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.polynomial import Affine, even_odd, real_roots, value_at

_PRECISIONS = (128, 512, 2048)
"""Bits, tried in turn."""


@dataclass(frozen=True)
class Inside:
    """A point inside a rectangle with a root on the axis.

    Attributes:
        mass: kg.
        factor: on the gain.
        frequency_Hz: of the root.
        decided: whether it was found; False where it could not be told from one that is none.
    """

    mass: float
    factor: float
    frequency_Hz: float
    decided: bool = True


def axis_inside(
    opened: Affine, returned: Affine, masses: tuple[fmpq, fmpq], factors: tuple[fmpq, fmpq]
) -> Inside | None:
    """A point inside a rectangle at which opened + g returned has a root on the imaginary axis; None if there is none.

    Args:
        opened: over the mass.
        returned: likewise.
        masses: least and largest.
        factors: least and largest; all four sides are stable.
    """
    if masses[0] == masses[1] or factors[0] == factors[1] or returned.slope.is_zero():
        return None  # the sides decide
    parts = _Parts(opened, returned)
    if parts.discriminant.is_zero():
        return Inside(float("nan"), float("nan"), float("nan"), decided=False)
    left = None
    for bits in _PRECISIONS:
        with ctx.workprec(bits):
            found = [
                parts.judged(root, masses, factors) for root, _ in real_roots(parts.discriminant, bits) if root > 0
            ]
        if any(isinstance(one, Inside) and one.decided for one in found):
            return next(one for one in found if isinstance(one, Inside) and one.decided)
        left = next((one for one in found if one is not None), None)
        if left is None:
            return None
    return left


class _Parts:
    """E and O as bilinear functions of m and g, and R(g) = q_0 + q_1 g + q_2 g^2, all over x = w^2."""

    def __init__(self, opened: Affine, returned: Affine):
        self.even, self.odd = zip(
            *(even_odd(p) for p in (opened.constant, opened.slope, returned.constant, returned.slope)), strict=True
        )
        (e, e_m, e_g, e_mg), (o, o_m, o_g, o_mg) = self.even, self.odd
        self.q0 = e * o_m - o * e_m
        self.q1 = e * o_mg + e_g * o_m - o * e_mg - o_g * e_m
        self.q2 = e_g * o_mg - o_g * e_mg
        self.discriminant: fmpq_poly = self.q1 * self.q1 - 4 * self.q0 * self.q2

    def judged(self, x: arb, masses: tuple[fmpq, fmpq], factors: tuple[fmpq, fmpq]) -> Inside | None:
        """Where a root of the discriminant has its point: None outside, else inside or not to be told."""
        q0, q1, q2 = (value_at(q, x) for q in (self.q0, self.q1, self.q2))
        if not q2.contains(0):
            factor = -q1 / (2 * q2)
        elif not q1.contains(0):
            factor = -2 * q0 / q1
        else:
            return Inside(_float(masses), _float(factors), _hertz(x), decided=False)
        if outside(factor, factors):
            return None
        for part in (self.even, self.odd):
            p, p_m, p_g, p_mg = (value_at(q, x) for q in part)
            below = p_m + p_mg * factor
            if below.contains(0):
                continue
            mass = -(p + p_g * factor) / below
            if outside(mass, masses):
                return None
            sure = within(mass, masses) and within(factor, factors)
            return Inside(float(mass.mid()), float(factor.mid()), _hertz(x), sure)
        return Inside(_float(masses), float(factor.mid()), _hertz(x), decided=False)


def outside(ball: arb, ends: tuple[fmpq, fmpq]) -> bool:
    """Whether all of a ball is outside an interval."""
    return bool(ball < arb(ends[0])) or bool(ball > arb(ends[1]))


def within(ball: arb, ends: tuple[fmpq, fmpq]) -> bool:
    """Whether all of a ball is inside an open interval."""
    return bool(ball > arb(ends[0])) and bool(ball < arb(ends[1]))


def _float(pair: tuple[fmpq, fmpq]) -> float:
    middle = (pair[0] + pair[1]) / 2
    return int(middle.p) / int(middle.q)


def _hertz(x: arb) -> float:
    return sqrt(float(x.mid())) / (2 * pi)
