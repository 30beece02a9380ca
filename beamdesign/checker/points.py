"""Points whose convex hull holds what is not affine: powers of a parameter, arcs, and inverses."""

from collections.abc import Sequence
from functools import reduce
from math import comb

from flint import acb, arb, fmpq, fmpq_poly

TANGENTS = 6
"""Around the arc of exp(-jwT)."""


def polar(low: fmpq, high: fmpq, degree: int, highs: int, power: int) -> fmpq:
    """The polar form of x^power, as of a degree, at `highs` times the high end and else the low end.

    It is the mean over all products of `power` of these arguments: the coefficient of t^power in
    (1 + low t)^(degree - highs) (1 + high t)^highs over the number of such products.
    """
    return (fmpq_poly([1, low]) ** (degree - highs) * fmpq_poly([1, high]) ** highs)[power] / comb(degree, power)


def arc(start: arb, sweep: arb) -> list[acb]:
    """The ends of the arc exp(-j angle) over some angles, and corners of tangents around it."""
    if sweep == 0:
        return [_turned(start)]
    sweep = sweep.min(2 * arb.pi())
    part = sweep / (2 * TANGENTS)
    corners = [_turned(start + (2 * k + 1) * part) / part.cos() for k in range(TANGENTS)]
    return [_turned(start), *corners, _turned(start + sweep)]


def _turned(angle: arb) -> acb:
    return acb(angle.cos(), -angle.sin())


def inverses(points: Sequence[acb]) -> list[acb]:
    """Points whose hull holds 1 / f wherever that of some points a holds f; nowhere where that is not seen.

    f is a mean sum l a, and |f|^2 the sum of l m Re(a conj(b)) over all pairs with their weights l and m. So where all
    these real parts are positive, 1 / f = conj(f) / |f|^2 is a mean of (conj(a) + conj(b)) / (2 Re(a conj(b))).
    """
    pairs = [(a.conjugate(), b) for k, a in enumerate(points) for b in points[: k + 1]]
    if not all((a * b).real > 0 for a, b in pairs):
        return [acb("nan")]
    return [(a + b.conjugate()) / (2 * (a * b).real) for a, b in pairs]


def apart(points: Sequence[acb]) -> arb:
    """Lower bound of the distance of a hull from zero: the root of the least Re(a conj(b)); no number where none is."""
    return reduce(arb.min, ((a.conjugate() * b).real for k, a in enumerate(points) for b in points[: k + 1])).sqrt()
