"""The tip as a port: passivity, contact with walls, touching and letting go, apparent stiffness.

A tip is passive where its mobility s x / F is positive real. With x / F = n / p, Re(jw n / p) >= 0 says that what
pushes the tip at w gets no work out of it over a period. Springs and masses on the tip turn p to p + k n - m w^2 n and
leave Im(p conj n) as it is: so one polynomial in w^2 settles passivity for every payload. A tip that is passive and
stable is stable against every passive environment that takes up some energy, a wall among them (Colgate and Hogan, Int.
J. Control 48, 1988); against one that is not, `destabilising_environment` finds masses, springs and dashpots that it
oscillates with.

The characteristic polynomial p0 + (m s^2 + b s + k) n of a rig without effects, whose end mass moves with the tip that
the force acts on, is affine in m, b and k together and of constant degree, so that it is stable on the whole box if it
is on its edges (edge theorem of Bartlett, Hollot and Huang, 1988). This is the linear loop in lasting contact; touching
and letting go is what follows.

Touching and letting go: a spring that presses on one side only, at any distance and under any constant load, has a
slope between 0 and k. The loop with it comes to rest from anywhere if it is stable without it and, for some time q of
zero or more (H. K. Khalil, Nonlinear Systems, 3rd ed. 2002, theorem 7.3),

    1 / k + Re[(1 + j w q) n / p] > 0    at every w.

Over the end mass, |p|^2 / k + Re(n conj p) + q w Im(p conj n) is a quadratic, so that one exact test settles the whole
payload. It is proved, not negative, for a k that is a little larger; so it is positive for the one stated.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from math import inf, pi, sqrt

from flint import ctx, fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.polynomial import (
    Affine,
    bounds,
    exact,
    inner,
    is_hurwitz,
    nearest,
    real_roots,
    roots,
    shortened,
    simple_between,
    squared_magnitude,
    turned,
)
from beamdesign.proofs.quadratic import Coefficients, first_negative, kept_up_to_Hz, less, magnitude_slack, over_mass
from beamdesign.proofs.stability import is_stable_over, stable_ranges, unstable_at

_PRECISION_BITS = 128
_DIGITS = 15
_S = fmpq_poly([0, 1])


# Passivity, proved or refuted, band by band.
@dataclass(frozen=True)
class Band:
    """Frequencies at which the tip gives off work.

    Attributes:
        low: rationals just below and just above the lower end, as w^2 in (rad/s)^2; both 0 where it reaches down to
            rest.
        high: the same of the upper end; None where it has none.
        squared_frequency: a rational w^2 in the middle.
    """

    low: tuple[fmpq, fmpq]
    high: tuple[fmpq, fmpq] | None
    squared_frequency: fmpq

    @property
    def low_Hz(self) -> float:
        """Lower end, 0 where it reaches down to rest."""
        return _hertz(self.low)

    @property
    def sample_Hz(self) -> float:
        """In the middle."""
        return sqrt(nearest(self.squared_frequency)) / (2 * pi)

    @property
    def high_Hz(self) -> float:
        """Upper end, infinite where there is none."""
        return inf if self.high is None else _hertz(self.high)


@dataclass(frozen=True)
class Passivity:
    """Whether the mobility of a tip is positive real for every end mass of a range.

    Attributes:
        holds: whether it is proved; if not, it is refuted.
        bands: where work is given off, ascending; the same for every end mass.
        reason: in words, why it is not passive; empty where it is.
    """

    holds: bool
    bands: tuple[Band, ...]
    reason: str = ""


@dataclass(frozen=True)
class Environment:
    """What is fixed to the tip: a mass (kg) that a spring (N/m) and a dashpot (N s/m) hold to the ground."""

    mass: fmpq
    stiffness: fmpq
    damping: fmpq


def absorbed(loop: Loop) -> fmpq_poly:
    """Im(p conj n) / w at jw as a polynomial in x = w^2: not negative where the tip takes work in."""
    return turned(loop.characteristic.constant, loop.disturbance)


def passivity(loop: Loop, low: fmpq, high: fmpq) -> Passivity:
    """Decide whether the tip is stable and passive with every end mass (kg) from `low` to `high`."""
    bands = active_bands(loop)
    words = [f"work comes out of the tip {in_words(bands)}"] if bands else []
    stability = stable_ranges(loop.characteristic, low, high)
    if not stability.stable:
        words.insert(0, f"the loop is not stable for all of these masses: {stability.reason}")
    return Passivity(not words, bands, "; ".join(words))


def active_bands(loop: Loop) -> tuple[Band, ...]:
    """The bands in which the tip gives off work, decided exactly; a frequency where it only touches zero is none."""
    value = absorbed(loop)
    if value.is_zero():
        return ()
    with ctx.workprec(_PRECISION_BITS):
        found = [
            bounds(root)
            for root, count in real_roots(value, _PRECISION_BITS)
            if count % 2 and root > 0  # roots of even multiplicity change no sign
        ]
    edges = [(shortened(low, _DIGITS), shortened(high, _DIGITS, up=True)) for low, high in found]
    bands = []
    for start, end in pairwise([(fmpq(0), fmpq(0)), *edges, None]):
        assert start is not None  # None ends the list
        low, high = start[1], 2 * start[1] + 2 if end is None else end[0]
        while value(sample := simple_between(low, high)) == 0:  # a double root in the middle
            high = sample
        if value(sample) < 0:
            bands.append(Band(start, end, sample))
    return tuple(bands)


def _hertz(square: tuple[fmpq, fmpq]) -> float:
    return sqrt(nearest((square[0] + square[1]) / 2)) / (2 * pi)


def in_words(bands: tuple[Band, ...]) -> str:
    """Bands for a person."""

    def one(band: Band) -> str:
        if band.high is None:
            return f"above {band.low_Hz:.4g} Hz" if band.low_Hz else "at every frequency"
        return f"from {band.low_Hz:.4g} to {band.high_Hz:.4g} Hz" if band.low_Hz else f"below {band.high_Hz:.4g} Hz"

    return " and ".join(one(band) for band in bands)


def destabilising_environment(loop: Loop, bands: tuple[Band, ...], outer_end_mass: fmpq) -> Environment | None:
    """A passive environment that makes a stable loop grow, proved by an exact Routh test.

    At jw inside a band p / n = R - j w r with r > 0. A mass M on a spring M w^2 - R is in tune there, and with a
    dashpot of r / 2 its slow envelope grows at about r / 4 M: M is doubled until the linear loop is not stable.

    Args:
        loop: whose tip it is fixed to.
        bands: its active bands.
        outer_end_mass: what the tip carries beside the environment, kg.

    Returns:
        the one of least mass among a few per band; None where no mass up to a million times the first is enough.
    """
    found = []
    for band in bands:
        low, high = band.low[1], 2 * band.squared_frequency if band.high is None else band.high[0]
        # The band's sample, and some more for which nothing is known beforehand.
        squares = [band.squared_frequency, *(shortened(low + (high - low) * fmpq(k, 5), 3) for k in range(1, 5))]
        found += [_in_tune(loop, square, outer_end_mass) for square in squares]
    return min((one for one in found if one is not None), key=lambda one: one.mass, default=None)


def _in_tune(loop: Loop, square: fmpq, outer_end_mass: fmpq) -> Environment | None:
    p, n = loop.against(outer_end_mass), loop.disturbance
    below = squared_magnitude(n)(square)
    if below == 0 or (given := -turned(p, n)(square) / below / 2) <= 0:
        return None
    elastic = inner(p, n)(square) / below  # R = Re(p / n)
    damping = shortened(given, 3)  # r / 2
    mass = shortened(max(abs(elastic) / square, fmpq(1, 100)), 3, up=True)
    for _ in range(20):
        stiffness = mass * square - elastic
        if stiffness > 0:
            found = Environment(mass, shortened(stiffness, 4), damping)
            polynomial = loop.against(outer_end_mass + mass, found.stiffness, damping)
            if not is_hurwitz(polynomial) and max(root.real for root in roots(polynomial)) > 0:
                return found
        mass *= 2
    return None


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


@dataclass(frozen=True)
class Contact:
    """Whether the loop is stable against every wall of a range with every end mass of a range.

    Attributes:
        holds: whether it is proved; if not, it is refuted.
        reason: in words, why not; empty where it is.
        witness: end mass and wall at which it is not stable; None where it holds.
        exact: whether these figures refute it themselves, or only stand next to a root on the axis at irrational ones.
    """

    holds: bool
    reason: str = ""
    witness: Environment | None = None
    exact: bool = True


def _edges(sides: tuple[Ends, Ends, Ends]) -> Iterator[tuple[int, list[fmpq]]]:
    """The edges of a box of stiffness, damping and mass: which of them varies, and a corner, zero where that is."""
    wide = [k for k in range(3) if sides[k][0] < sides[k][1]] or [2]
    for varies in wide:
        for rest in product(*(sorted(set(side)) for k, side in enumerate(sides) if k != varies)):
            yield varies, [*rest[:varies], fmpq(0), *rest[varies:]]


def prove_contact(loop: Loop, masses: Ends, wall: Wall) -> Contact:
    """Decide whether the loop is stable for every end mass, wall stiffness and wall damping of a box.

    Raises:
        ValueError: for an empty range, or a negative figure.
    """
    sides = (wall.stiffness, wall.damping, masses)
    for name, (low, high) in zip(("stiffness", "damping", "mass"), sides, strict=True):
        if not 0 <= low <= high:
            raise ValueError(f"{name} must range from zero or more upwards, is {nearest(low)} to {nearest(high)}")
    p, n = loop.characteristic.constant, loop.disturbance
    for varies, corner in _edges(sides):
        family = Affine(p + fmpq_poly(corner) * n, _S**varies * n)
        if (there := unstable_at(family, *sides[varies])) is not None:
            corner[varies] = there.value
            found = Environment(corner[2], corner[0], corner[1])
            return Contact(False, _words(found), found, there.exact)
    return Contact(True)


def _words(found: Environment) -> str:
    wall = f"against a wall of {nearest(found.stiffness):.6g} N/m" if found.stiffness else "without a wall"
    if found.damping:
        wall += f" with {nearest(found.damping):.6g} N s/m"
    return f"not stable {wall} and with an outer end mass of {nearest(found.mass):.6g} kg"


def stiffest_wall(loop: Loop, masses: Ends, wall: Wall) -> float:
    """Largest wall stiffness (N/m) up to which every wall is proved to be stable with every mass, to four digits down.

    0 where even the softest is not; the range's own upper end where all of them are.
    """

    def proves(high: fmpq) -> bool:
        return prove_contact(loop, masses, Wall((wall.stiffness[0], high), wall.damping)).holds

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


MULTIPLIERS_S = tuple(float(f"{10.0 ** (k / 4):.4g}") for k in (*range(8, -21, -1), *range(9, 25)))
"""Values of q that are tried, s; the last and largest ask for little more than a passive tip."""

_STRICTLY = fmpq(1001, 1000)


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


def popov_slack(loop: Loop, stiffness: fmpq, multiplier: fmpq) -> Coefficients:
    """|p|^2 / k + Re(n conj p) + q w Im(p conj n) as a quadratic a m^2 + b m + c in the mass, polynomials in w^2."""
    p, n = loop.characteristic, Affine(-loop.disturbance)
    a, b, c = less(1 / stiffness, over_mass(inner, p, p), over_mass(inner, n, p))
    return a, b, c + multiplier * _S * absorbed(loop)


def unilateral_contact(loop: Loop, masses: tuple[fmpq, fmpq], stiffness: fmpq) -> UnilateralContact:
    """Find the stiffest one-sided spring, up to the one given (N/m), that is proved for every end mass (kg)."""
    if stiffness == 0 or not is_stable_over(loop.characteristic, *masses):
        return UnilateralContact(0.0, 0.0, False)

    def proves(wall: fmpq, multiplier: float) -> bool:
        return first_negative(popov_slack(loop, wall * _STRICTLY, exact(multiplier)), *masses) is None

    for multiplier in MULTIPLIERS_S:
        if proves(stiffness, multiplier):
            return UnilateralContact(nearest(stiffness), multiplier, True)
    best, found = fmpq(1), UnilateralContact(0.0, 0.0, False)
    for multiplier in MULTIPLIERS_S:
        if proves(better := best * fmpq(11, 10), multiplier):
            best = _stiffest(partial(proves, multiplier=multiplier), better, stiffness, fmpq(1005, 1000))
            found = UnilateralContact(nearest(shortened(best, 4)), multiplier, False)
    return found


# Up to which frequency the end has the stiffness that it is told to have, and follows its command.


_ROOT_OF_TWO = fmpq(14142, 10000)


def guaranteed_stiffness_band(loop: Loop, stiffness: fmpq, share: fmpq, low: fmpq, high: fmpq) -> float:
    """Frequency (Hz) up to which |F/x / k - 1| is proved to be at most `share` with every end mass from low to high.

    Rounded down; 0 where it is not even at rest, infinite where it is at every frequency. It says nothing about
    stability.
    """
    # (share k |n|)^2 - |p - k n|^2 is not negative where F / x = p / n is within that share of the stiffness k.
    p, n = loop.characteristic, loop.disturbance
    error = Affine(p.constant - stiffness * n, p.slope)
    return kept_up_to_Hz(magnitude_slack(share * stiffness, Affine(n), error), low, high)


def guaranteed_command_band(loop: Loop, commanded: fmpq_poly, low: fmpq, high: fmpq) -> float:
    """Frequency (Hz) up to which the end follows its command with at least 1 / sqrt(2) of it, for every end mass.

    Args:
        loop: closed.
        commanded: numerator of x F / command over p, of static gain one; free of the mass.
        low: least end mass, kg.
        high: largest.
    """
    return kept_up_to_Hz(magnitude_slack(_ROOT_OF_TWO, Affine(commanded), loop.characteristic), low, high)
