"""Touching a wall and letting go: the tip against one-sided springs, proved by Popov's criterion.

A spring that presses on one side only, at any distance and under any constant load, has a slope between 0 and k. The
loop with it comes to rest from anywhere if it is stable without it and, for some time q of zero or more (H. K. Khalil,
Nonlinear Systems, 3rd ed. 2002, theorem 7.3),

    1 / k + Re[(1 + j w q) n / p] > 0    at every w.

Over the end mass, |p|^2 / k + Re(n conj p) + q w Im(p conj n) is a quadratic, so that one exact test settles the whole
payload. It is proved, not negative, for a k that is a little larger; so it is positive for the one stated.
"""

from dataclasses import dataclass

from flint import fmpq, fmpq_poly

from beamdesign.loop import Tip
from beamdesign.polynomial import exact
from beamdesign.proof.passivity import absorbed
from beamdesign.proof.performance import Coefficients, inner
from beamdesign.proof.quadratic import quadratic_nonnegative
from beamdesign.proof.rational import nearest, shortened
from beamdesign.proof.stability import is_stable_over

MULTIPLIERS_S = tuple(float(f"{10.0 ** (k / 4):.4g}") for k in range(8, -21, -1))
"""Values of q that are tried, s."""

_STRICTLY = fmpq(1001, 1000)
_S = fmpq_poly([0, 1])


@dataclass(frozen=True)
class Bouncing:
    """One-sided springs with which the loop comes to rest, for every end mass of a range.

    Attributes:
        stiffness_N_per_m: up to which every one of them is proved; 0 where none is.
        multiplier_s: q of the proof.
        whole: whether that is all that was asked about. Where it is not, nothing is refuted.
    """

    stiffness_N_per_m: float
    multiplier_s: float
    whole: bool


def popov_slack(tip: Tip, stiffness: fmpq, multiplier: fmpq) -> Coefficients:
    """|p|^2 / k + Re(n conj p) + q w Im(p conj n) as a quadratic a m^2 + b m + c in the mass, polynomials in w^2."""
    p0, n = tip.bare, tip.moved
    carried = _S * _S * n
    return (
        inner(carried, carried) / stiffness,
        2 * inner(p0, carried) / stiffness + inner(n, carried),
        inner(p0, p0) / stiffness + inner(n, p0) + multiplier * _S * absorbed(tip),
    )


def bouncing(tip: Tip, masses: tuple[fmpq, fmpq], stiffness: fmpq) -> Bouncing:
    """Find the stiffest one-sided wall, up to the one given (N/m), that is proved for every end mass (kg)."""
    if not is_stable_over(tip.over_mass, *masses):
        return Bouncing(0.0, 0.0, False)

    def proves(wall: fmpq, multiplier: float) -> bool:
        slack = popov_slack(tip, wall * _STRICTLY, exact(multiplier))
        return quadratic_nonnegative(*slack, *masses, fmpq(0), None).holds

    for multiplier in MULTIPLIERS_S:
        if proves(stiffness, multiplier):
            return Bouncing(nearest(stiffness), multiplier, True)
    best, chosen = fmpq(1), None
    for multiplier in MULTIPLIERS_S:
        if not proves(best * fmpq(11, 10), multiplier):
            continue
        low, high, chosen = best * fmpq(11, 10), stiffness, multiplier
        while high > low * fmpq(1005, 1000):
            middle = shortened(exact((nearest(low) * nearest(high)) ** 0.5), 6)
            low, high = (middle, high) if proves(middle, multiplier) else (low, middle)
        best = low
    if chosen is None:
        return Bouncing(0.0, 0.0, False)
    return Bouncing(nearest(shortened(best, 4)), chosen, False)
