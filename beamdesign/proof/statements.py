"""What each claim of performance says in polynomials: inequalities quadratic in the mass, and families to be stable."""

from dataclasses import dataclass

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.polynomial import Affine, even_odd
from beamdesign.proof.rational import bounds

Coefficients = tuple[fmpq_poly, fmpq_poly, fmpq_poly]


def _inner(left: fmpq_poly, right: fmpq_poly) -> fmpq_poly:
    """Real part of left(jw) times the conjugate of right(jw), a polynomial in x = w^2."""
    even_left, odd_left = even_odd(left)
    even_right, odd_right = even_odd(right)
    return even_left * even_right + fmpq_poly([0, 1]) * odd_left * odd_right


def magnitude_slack(limit: fmpq, denominator: Affine, numerator: Affine) -> Coefficients:
    """limit^2 |denominator|^2 - |numerator|^2 at jw as a quadratic a m^2 + b m + c in the mass."""
    square = limit * limit
    return (
        square * _inner(denominator.slope, denominator.slope) - _inner(numerator.slope, numerator.slope),
        2 * square * _inner(denominator.constant, denominator.slope) - 2 * _inner(numerator.constant, numerator.slope),
        square * _inner(denominator.constant, denominator.constant) - _inner(numerator.constant, numerator.constant),
    )


def squared_frequency_above(frequency_Hz: fmpq) -> fmpq:
    """A rational at or just above (2 pi f)^2, (rad/s)^2."""
    with ctx.workprec(128):
        return bounds((2 * arb.pi() * arb(frequency_Hz)) ** 2)[1]


def frequency_below(squared_frequency: fmpq) -> fmpq:
    """A rational at or just below sqrt(x) / (2 pi), Hz."""
    if squared_frequency <= 0:
        return fmpq(0)
    with ctx.workprec(128):
        return bounds(arb(squared_frequency).sqrt() / (2 * arb.pi()))[0]


def compliance_slack(loop: Loop, limit_m_per_N: fmpq) -> Coefficients:
    """limit^2 |p|^2 - |n|^2 for the closed-loop compliance n / p; n is free of the mass."""
    return magnitude_slack(limit_m_per_N, loop.characteristic, Affine(loop.disturbance, fmpq_poly([0])))


def sensitivity_slack(loop: Loop, limit: fmpq) -> Coefficients:
    """limit^2 |p|^2 - |opened|^2 for the sensitivity opened / p."""
    return magnitude_slack(limit, loop.characteristic, loop.opened)


def loop_gain_slack(loop: Loop, limit: fmpq) -> Coefficients:
    """limit^2 |opened|^2 - |returned|^2 for the loop gain returned / opened."""
    return magnitude_slack(limit, loop.opened, loop.returned)


def effort_slack(loop: Loop, limit_A_per_V: fmpq) -> Coefficients:
    """limit^2 |p|^2 - |demanded|^2 for the controller effort C S = demanded / p.

    Raises:
        ValueError: for a loop whose controller is not known.
    """
    if loop.demanded is None:
        raise ValueError("the controller of this loop is not known apart from its plant")
    return magnitude_slack(limit_A_per_V, loop.characteristic, loop.demanded)


def squared_frequency_below(frequency_Hz: fmpq) -> fmpq:
    """A rational at or just below (2 pi f)^2, (rad/s)^2."""
    with ctx.workprec(128):
        return bounds((2 * arb.pi() * arb(frequency_Hz)) ** 2)[0]


def shifted(family: Affine, rate: fmpq) -> Affine:
    """The family in s - rate: stable exactly where every root of the given one lies to the left of -rate."""
    shift = fmpq_poly([-rate, 1])
    return Affine(family.constant(shift), family.slope(shift))


@dataclass(frozen=True)
class Edge:
    """One side of the rectangle of masses and gain factors.

    Attributes:
        family: affine in the quantity that varies along this side.
        low: least value of that quantity.
        high: its largest value.
        mass: the fixed mass, None where the mass varies.
        factor: the fixed factor on the gain, None where the factor varies.
    """

    family: Affine
    low: fmpq
    high: fmpq
    mass: fmpq | None = None
    factor: fmpq | None = None


def gain_edges(loop: Loop, factor: fmpq, low: fmpq, high: fmpq) -> list[Edge]:
    """The sides of the rectangle of masses in [low, high] and gain factors between 1 and `factor`.

    opened + factor returned is affine in the mass and the factor together where the displacement alone is fed back, so
    it is stable on the whole rectangle if it is on the four sides (edge theorem of Bartlett, Hollot and Huang, 1988,
    for polytopes of constant degree). Else `beamdesign.proof.bilinear` decides the inside.
    """
    least, most = min(factor, fmpq(1)), max(factor, fmpq(1))
    opened, returned = loop.opened, loop.returned
    over_mass = [Edge(opened + returned * k, low, high, factor=k) for k in (fmpq(1), factor)]
    over_gain = [Edge(Affine(opened.at(mass), returned.at(mass)), least, most, mass=mass) for mass in (low, high)]
    return [*over_mass, *over_gain]
