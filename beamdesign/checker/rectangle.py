"""Stability over a mass and a gain at once: on the sides of their rectangle, and inside it where they multiply."""

from flint import arb, arb_poly, fmpq

from beamdesign.checker.roots import Family, Pair, Polynomials, around, bound, halve, isolate, parts, plus, square_free


def stable_on_rectangle(denominator: Polynomials, numerator: Polynomials, masses: Pair, gains: Pair) -> bool:
    """Whether denominator + g numerator is stable for every mass and factor g, both affine in the mass.

    On a polytope of polynomials of constant degree the edges decide (Bartlett, Hollot and Huang, 1988). Where mass and
    factor multiply each other it is none, and what is inside is looked at as well.
    """
    over_mass = [Family(*plus(denominator, numerator, g)) for g in {*gains}]
    over_gain = [Family(denominator[0] + m * denominator[1], numerator[0] + m * numerator[1]) for m in {*masses}]
    sides = all(side.is_stable_over(*masses) for side in over_mass)
    sides = sides and (gains[0] == gains[1] or all(side.is_stable_over(*gains) for side in over_gain))
    flat = masses[0] == masses[1] or gains[0] == gains[1] or numerator[1] == 0
    return sides and (flat or _clear_inside(denominator, numerator, masses, gains))


def _clear_inside(denominator: Polynomials, numerator: Polynomials, masses: Pair, gains: Pair) -> bool:
    """Whether no point inside a rectangle with stable sides has a root on the axis.

    If some had, one would have the least w^2 of all, since they keep away from the sides and from w = 0. There the two
    equations for g, E = e + e' g = 0 and O = o + o' g = 0 with coefficients affine in m, would be solved by m in
    e o' - o e' = 0 twice at once, else a slightly smaller w^2 would be, too. So w^2 is a root of the discriminant of
    that quadratic in m. Each of these is followed until its m, or the g that goes with it, is seen to be outside.

    Raises:
        ArithmeticError: where that is not decided, as both equations depend on mass and gain in one way.
    """
    (e, o), (e_m, o_m), (e_g, o_g), (e_mg, o_mg) = (parts(p) for p in (*denominator, *numerator))
    square, straight, constant = (
        e_m * o_mg - o_m * e_mg,
        e_m * o_g + e * o_mg - o_m * e_g - o * e_mg,
        e * o_g - o * e_g,
    )
    discriminant = straight * straight - 4 * square * constant
    if discriminant == 0:
        raise ArithmeticError("whether roots cross the axis inside a range of masses and gains is not decided")
    discriminant = square_free(discriminant)

    most = max(map(abs, masses))

    def place(x: arb) -> bool | None:
        """Whether the point of a root is inside (True), or is none of the rectangle (False); None for neither."""
        two, one, none = (arb_poly(p)(x) for p in (square, straight, constant))
        if abs(two) * most * most + abs(one) * most < abs(none):
            return False  # no mass of the range solves it
        if two.contains(0) and one.contains(0):
            return None
        mass = -one / (2 * two) if not two.contains(0) else -2 * none / one
        if _apart(mass, masses):
            return False
        sure = None
        for constants in ((e, e_m, e_g, e_mg), (o, o_m, o_g, o_mg)):
            free, by_mass, by_gain, by_both = (arb_poly(p)(x) for p in constants)
            below = by_gain + by_both * mass
            if below.contains(0):
                continue
            gain = -(free + by_mass * mass) / below
            if _apart(gain, gains):
                return False
            sure = sure or (_within(mass, masses) and _within(gain, gains)) or None
        return sure

    for found in isolate(discriminant, fmpq(0), bound(discriminant)):
        interval = found
        for _ in range(400):
            if (there := place(around(interval))) is not None:
                break
            interval = halve(discriminant, interval)
        if there is None:
            raise ArithmeticError("whether roots cross the axis inside a range of masses and gains is not decided")
        if there:
            return False
    return True


def _within(ball: arb, ends: Pair) -> bool:
    return bool(ball > arb(ends[0])) and bool(ball < arb(ends[1]))


def _apart(ball: arb, ends: Pair) -> bool:
    return bool(ball < arb(ends[0])) or bool(ball > arb(ends[1]))
