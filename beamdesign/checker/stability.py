"""Stability of polynomials over a mass, and over a mass and a gain: Hurwitz determinants, Routh's test, crossings."""

from flint import arb, arb_poly, fmpq, fmpq_mat, fmpq_poly

from beamdesign.checker.roots import Pair, Polynomials, S, bound, halve, isolate, parts, pieces, square_free


def _hurwitz_matrix(polynomial: fmpq_poly, degree: int) -> fmpq_mat:
    size = max(degree - 1, 0)
    entries = [
        polynomial[k] if 0 <= (k := degree - 1 - 2 * column + row) <= degree else fmpq(0)
        for row in range(size)
        for column in range(size)
    ]
    return fmpq_mat(size, size, entries)


def is_hurwitz(polynomial: fmpq_poly) -> bool:
    """Whether all roots lie in the open left half plane: the quotients of Euclid's algorithm on the two parts."""
    coefficients = polynomial.coeffs()
    degree = polynomial.degree()
    if degree < 0:
        return False

    def part(parity: int) -> fmpq_poly:
        return fmpq_poly([c if (degree - i) % 2 == parity else 0 for i, c in enumerate(coefficients)])

    upper, lower = part(0), part(1)
    for left in range(degree, 0, -1):
        if lower.degree() != left - 1 or lower[left - 1] * upper[left] <= 0:
            return False
        upper, lower = lower, upper - fmpq_poly([0, upper[left] / lower[left - 1]]) * lower
    return True


class Family:
    """p0 + m p1 with the polynomials in m that vanish wherever stability can change."""

    def __init__(self, p0: fmpq_poly, p1: fmpq_poly):
        self.p0, self.p1 = p0, p1
        self.degree = max(p0.degree(), p1.degree())
        # Orlando: the last but one determinant vanishes where two roots add up to zero. It is a polynomial in m of
        # at most this degree, and found by interpolation.
        points = [fmpq(k) for k in range(max(self.degree, 1))]
        values = [_hurwitz_matrix(self.at(m), self.degree).det() for m in points]
        determinant, basis = fmpq_poly([0]), fmpq_poly([1])
        for point, value in zip(points, values, strict=True):
            determinant += basis * ((value - determinant(point)) / basis(point))
            basis *= S - point
        self.critical = [determinant, *(fmpq_poly([p0[k], p1[k]]) for k in (0, self.degree))]

    def at(self, mass: fmpq) -> fmpq_poly:
        """The member at one mass."""
        return self.p0 + self.p1 * mass

    def is_critical(self, mass: fmpq) -> bool:
        """Whether a root lies on the axis or at infinity, or two of them are symmetric about the origin."""
        return any(polynomial(mass) == 0 for polynomial in self.critical)

    def is_stable(self, mass: fmpq) -> bool:
        """Whether one member has all its roots, and in the open left half plane."""
        return self.at(mass).degree() == self.degree and is_hurwitz(self.at(mass))

    def verdict(self, low: fmpq, high: fmpq) -> bool | None:
        """Whether all masses strictly between are stable (True), none is (False), or some are (None)."""
        if low == high:
            return self.is_stable(low)
        samples, cuts = pieces(self.critical, low, high)
        stable = [self.is_stable(mass) for mass in samples]
        if not any(stable):
            return False  # at the cuts themselves roots lie on the axis, at infinity, or on both sides of it
        return True if all(stable) and cuts == 0 and not any(q.is_zero() for q in self.critical) else None

    def is_stable_over(self, low: fmpq, high: fmpq) -> bool:
        """Whether all masses of a closed range are stable."""
        return self.is_stable(low) and self.is_stable(high) and self.verdict(low, high) is True


def stable_on_rectangle(opened: Polynomials, returned: Polynomials, masses: Pair, gains: Pair) -> bool:
    """Whether opened + g returned is stable for every mass and every factor g, both polynomials affine in the mass.

    On a polytope of polynomials of constant degree the edges decide (Bartlett, Hollot and Huang, 1988). Where mass and
    factor multiply each other it is none, and what is inside is looked at as well.
    """
    over_mass = [Family(opened[0] + g * returned[0], opened[1] + g * returned[1]) for g in {*gains}]
    over_gain = [Family(opened[0] + m * opened[1], returned[0] + m * returned[1]) for m in {*masses}]
    sides = all(side.is_stable_over(*masses) for side in over_mass)
    sides = sides and (gains[0] == gains[1] or all(side.is_stable_over(*gains) for side in over_gain))
    flat = masses[0] == masses[1] or gains[0] == gains[1] or returned[1] == 0
    return sides and (flat or _clear_inside(opened, returned, masses, gains))


def _clear_inside(opened: Polynomials, returned: Polynomials, masses: Pair, gains: Pair) -> bool:
    """Whether no point inside a rectangle with stable sides has a root on the axis.

    If some had, one would have the least w^2 of all, since they keep away from the sides and from w = 0. There the two
    equations for g, E = e + e' g = 0 and O = o + o' g = 0 with coefficients affine in m, would be solved by m in
    e o' - o e' = 0 twice at once, else a slightly smaller w^2 would be, too. So w^2 is a root of the discriminant of
    that quadratic in m. Each of these is followed until its m, or the g that goes with it, is seen to be outside.
    """
    (e, o), (e_m, o_m), (e_g, o_g), (e_mg, o_mg) = (parts(p) for p in (*opened, *returned))
    square, straight, constant = (
        e_m * o_mg - o_m * e_mg,
        e_m * o_g + e * o_mg - o_m * e_g - o * e_mg,
        e * o_g - o * e_g,
    )
    discriminant = straight * straight - 4 * square * constant
    if discriminant == 0:
        return False
    discriminant = square_free(discriminant)

    def outside(x: arb) -> bool:
        two, one, none = (arb_poly(p)(x) for p in (square, straight, constant))
        if two.contains(0) and one.contains(0):
            return False
        mass = -one / (2 * two) if not two.contains(0) else -2 * none / one
        if _apart(mass, masses):
            return True
        for constants in ((e, e_m, e_g, e_mg), (o, o_m, o_g, o_mg)):
            free, by_mass, by_gain, by_both = (arb_poly(p)(x) for p in constants)
            below = by_gain + by_both * mass
            if not below.contains(0) and _apart(-(free + by_mass * mass) / below, gains):
                return True
        return False

    for found in isolate(discriminant, fmpq(0), bound(discriminant)):
        interval = found
        for _ in range(400):
            middle, radius = (interval[0] + interval[1]) / 2, (interval[1] - interval[0]) / 2
            if outside(arb(middle) + arb(0, arb(radius).upper())):
                break
            interval = halve(discriminant, interval)
        else:
            return False
    return True


def _apart(ball: arb, ends: Pair) -> bool:
    return bool(ball < arb(ends[0])) or bool(ball > arb(ends[1]))
