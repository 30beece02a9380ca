"""The tip as a port: contact with walls, touching and letting go, apparent stiffness.

The characteristic polynomial p0 + (m s^2 + b s + k) n is affine in m, b and k together and of constant degree, so that
it is stable on the whole box if it is on its edges (edge theorem of Bartlett, Hollot and Huang, 1988). This is the
linear loop in lasting contact; touching and letting go is what follows.

Touching and letting go: a spring that presses on one side only, at any distance and under any constant load, has a
slope between 0 and k. The
loop with it comes to rest from anywhere if it is stable without it and, for some time q of zero or more (H. K. Khalil,
Nonlinear Systems, 3rd ed. 2002, theorem 7.3),

    1 / k + Re[(1 + j w q) n / p] > 0    at every w.

Over the end mass, |p|^2 / k + Re(n conj p) + q w Im(p conj n) is a quadratic, so that one exact test settles the whole
payload. It is proved, not negative, for a k that is a little larger; so it is positive for the one stated.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product

from flint import fmpq, fmpq_poly

from beamdesign.loop import Tip
from beamdesign.polynomial import Affine, exact
from beamdesign.proofs.passivity import Environment, absorbed
from beamdesign.proofs.performance import Coefficients, inner, kept_up_to_Hz, magnitude_slack
from beamdesign.proofs.quadratic import quadratic_nonnegative
from beamdesign.proofs.stability import is_stable_over, unstable_at
from beamdesign.rational import nearest, shortened

# Lasting contact.


Ends = tuple[fmpq, fmpq]
_NO_DAMPING = (fmpq(0), fmpq(0))


@dataclass(frozen=True)
class Wall:
    """Walls that the tip may lean on.

    Attributes:
        stiffness: least and largest, N/m; zero is no wall.
        damping: least and largest, N s/m.
    """

    stiffness: Ends
    damping: Ends = _NO_DAMPING


EVERY_WALL = Wall((fmpq(0), fmpq(10**9)))
"""Where nothing is said of the walls."""


@dataclass(frozen=True)
class Contact:
    """Whether the loop is stable against every wall of a range with every end mass of a range.

    Attributes:
        holds: whether it is proved; if not, it is refuted.
        reason: in words, why not; empty where it is.
        witness: end mass and wall at which it is not stable; None where it holds.
        exact: whether these figures refute it themselves, or only stand next to a root on the axis at irrational ones.
        frequency_Hz: of the oscillation there.
    """

    holds: bool
    reason: str = ""
    witness: Environment | None = None
    exact: bool = True
    frequency_Hz: float | None = None


@dataclass(frozen=True)
class _Edge:
    """One edge of the box: figures of one corner, and which of them varies (0 stiffness, 1 damping, 2 mass)."""

    corner: tuple[fmpq, ...]
    varies: int
    family: Affine
    low: fmpq
    high: fmpq

    def environment(self, value: fmpq) -> Environment:
        stiffness, damping, mass = (value if k == self.varies else given for k, given in enumerate(self.corner))
        return Environment(mass, stiffness, damping)


def _edges(tip: Tip, masses: Ends, wall: Wall) -> Iterator[_Edge]:
    sides = (wall.stiffness, wall.damping, masses)
    wide = [k for k in range(3) if sides[k][0] < sides[k][1]] or [2]
    for varies in wide:
        for rest in product(*(sorted(set(side)) for k, side in enumerate(sides) if k != varies)):
            corner = (*rest[:varies], fmpq(0), *rest[varies:])
            slope = fmpq_poly([fmpq(0)] * varies + [fmpq(1)]) * tip.moved
            family = Affine(tip.against(corner[2], corner[0], corner[1]), slope)
            yield _Edge(corner, varies, family, *sides[varies])


def prove_contact(tip: Tip, masses: Ends, wall: Wall) -> Contact:
    """Decide whether the loop is stable for every end mass, wall stiffness and wall damping of a box.

    Raises:
        ValueError: for an empty range, or a negative figure.
    """
    for name, (low, high) in (("mass", masses), ("stiffness", wall.stiffness), ("damping", wall.damping)):
        if not 0 <= low <= high:
            raise ValueError(f"{name} must range from zero or more upwards, is {nearest(low)} to {nearest(high)}")
    for edge in _edges(tip, masses, wall):
        if (there := unstable_at(edge.family, edge.low, edge.high)) is not None:
            found = edge.environment(there.value)
            return Contact(False, _words(found), found, there.exact, there.frequency_Hz)
    return Contact(True)


def _words(found: Environment) -> str:
    wall = f"against a wall of {nearest(found.stiffness):.6g} N/m" if found.stiffness else "without a wall"
    if found.damping:
        wall += f" with {nearest(found.damping):.6g} N s/m"
    return f"not stable {wall} and with an outer end mass of {nearest(found.mass):.6g} kg"


def stiffest_wall(tip: Tip, masses: Ends, wall: Wall) -> float:
    """Largest wall stiffness (N/m) up to which every wall is proved to be stable with every mass, to four digits down.

    0 where even the softest is not; the range's own upper end where all of them are.
    """

    def proves(high: fmpq) -> bool:
        return prove_contact(tip, masses, Wall((wall.stiffness[0], high), wall.damping)).holds

    low, high = wall.stiffness
    if proves(high):
        return nearest(high)
    if not proves(low):
        return 0.0
    # What is stable up to some wall is so up to every softer one.
    lower, upper = max(low, fmpq(1)), high
    if not proves(lower):
        return nearest(low)
    lower = _stiffest(proves, lower, upper, fmpq(10002, 10000))
    return nearest(shortened(lower, 4)) if shortened(lower, 4) >= low else nearest(lower)


def _stiffest(proves: Callable[[fmpq], bool], low: fmpq, high: fmpq, near: fmpq) -> fmpq:
    """The stiffest wall that is proved, between one that is and one that is not, to a factor."""
    while high > low * near:
        middle = shortened(min(max(exact((nearest(low) * nearest(high)) ** 0.5), low), high), 6)
        low, high = (middle, high) if proves(middle) else (low, middle)
    return low


# Touching and letting go.


MULTIPLIERS_S = tuple(float(f"{10.0 ** (k / 4):.4g}") for k in range(8, -21, -1))
"""Values of q that are tried, s."""

_STRICTLY = fmpq(1001, 1000)
_S = fmpq_poly([0, 1])


@dataclass(frozen=True)
class UnilateralContact:
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


def unilateral_contact(tip: Tip, masses: tuple[fmpq, fmpq], stiffness: fmpq) -> UnilateralContact:
    """Find the stiffest one-sided wall, up to the one given (N/m), that is proved for every end mass (kg)."""
    if not is_stable_over(tip.over_mass, *masses):
        return UnilateralContact(0.0, 0.0, False)

    def proves(wall: fmpq, multiplier: float) -> bool:
        slack = popov_slack(tip, wall * _STRICTLY, exact(multiplier))
        return quadratic_nonnegative(*slack, *masses, fmpq(0), None).holds

    for multiplier in MULTIPLIERS_S:
        if proves(stiffness, multiplier):
            return UnilateralContact(nearest(stiffness), multiplier, True)
    best, chosen = fmpq(1), None
    for multiplier in MULTIPLIERS_S:
        if not proves(best * fmpq(11, 10), multiplier):
            continue
        best, chosen = best * fmpq(11, 10), multiplier
        best = _stiffest(partial(proves, multiplier=multiplier), best, stiffness, fmpq(1005, 1000))
    if chosen is None:
        return UnilateralContact(0.0, 0.0, False)
    return UnilateralContact(nearest(shortened(best, 4)), chosen, False)


# Up to which frequency the end has the stiffness that it is told to have, and follows its command.


_NONE = fmpq_poly([0])
_ROOT_OF_TWO = fmpq(14142, 10000)


def stiffness_slack(tip: Tip, stiffness: fmpq, share: fmpq) -> Coefficients:
    """(share k |n|)^2 - |p - k n|^2: not negative where F / x = p / n is within that share of the stiffness k."""
    error = Affine(tip.bare - stiffness * tip.moved, _S * _S * tip.moved)
    return magnitude_slack(share * stiffness, Affine(tip.moved, _NONE), error)


def guaranteed_stiffness_band(tip: Tip, stiffness: fmpq, share: fmpq, low: fmpq, high: fmpq) -> float:
    """Frequency (Hz) up to which |F/x / k - 1| is proved to be at most `share` with every end mass from low to high.

    Rounded down; 0 where it is not even at rest, infinite where it is at every frequency. It says nothing about
    stability.
    """
    return kept_up_to_Hz(stiffness_slack(tip, stiffness, share), low, high)


def guaranteed_command_band(tip: Tip, commanded: fmpq_poly, low: fmpq, high: fmpq) -> float:
    """Frequency (Hz) up to which the end follows its command with at least 1 / sqrt(2) of it, for every end mass.

    Args:
        tip: of the loop.
        commanded: numerator of x F / command over p, of static gain one; free of the mass.
        low: least end mass, kg.
        high: largest.
    """
    return kept_up_to_Hz(magnitude_slack(_ROOT_OF_TWO, Affine(commanded, _NONE), tip.over_mass), low, high)
