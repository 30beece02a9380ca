"""Stability over a mass and a gain at once: on the sides of their rectangle, and inside it where they multiply."""

from itertools import product

from flint import fmpq

from beamdesign.checker.roots import Family, Pair, Polynomials, plus

MOST_HALVINGS = 16


def stable_on_rectangle(
    denominator: Polynomials, numerator: Polynomials, masses: Pair, gains: Pair, halvings: int = MOST_HALVINGS
) -> bool:
    """Whether denominator + g numerator is stable for every mass and factor g, both affine in the mass.

    On a polytope of polynomials of constant degree the edges decide (Bartlett, Hollot and Huang, 1988). Where mass and
    factor multiply each other the rectangle is none, but all of it lies in the polytope of its corners, whose edges are
    its sides and diagonals. While a diagonal is not stable the rectangle is cut in four; a side that is not stable
    refutes, as it consists of loops.

    Raises:
        ArithmeticError: where that is not decided after so many halvings.
    """

    def between(one: tuple[fmpq, fmpq], other: tuple[fmpq, fmpq]) -> bool:
        """Whether the polynomials on the way from one mass and factor to another are stable."""
        start, end = (Family(*plus(denominator, numerator, g)).at(m) for m, g in (one, other))
        return Family(start, end - start).is_stable_over(fmpq(0), fmpq(1))

    over_mass = [Family(*plus(denominator, numerator, g)) for g in {*gains}]
    over_gain = [Family(denominator[0] + m * denominator[1], numerator[0] + m * numerator[1]) for m in {*masses}]
    sides = all(side.is_stable_over(*masses) for side in over_mass)
    sides = sides and (gains[0] == gains[1] or all(side.is_stable_over(*gains) for side in over_gain))
    flat = masses[0] == masses[1] or gains[0] == gains[1] or numerator[1] == 0
    diagonals = zip(masses, gains, strict=True), zip(masses, gains[::-1], strict=True)
    if not sides or flat or all(between(*diagonal) for diagonal in diagonals):
        return sides
    if not halvings:
        raise ArithmeticError("whether roots cross the axis inside a range of masses and gains is not decided")
    light_heavy, low_high = (((a, (a + b) / 2), ((a + b) / 2, b)) for a, b in (masses, gains))
    parts = product(light_heavy, low_high)
    return all(stable_on_rectangle(denominator, numerator, *part, halvings - 1) for part in parts)
