"""Passivity at the tip: whether its mobility s x / F is positive real, proved or refuted, band by band.

With x / F = n / p, Re(jw n / p) >= 0 says that what pushes the tip at w gets no work out of it over a period. Springs
and masses on the tip turn p to p + k n - m w^2 n and leave Im(p conj n) as it is: so one polynomial in w^2 settles
passivity for every payload. A tip that is passive and stable is stable against every passive environment that takes up
some energy, a wall among them (Colgate and Hogan, Int. J. Control 48, 1988); against one that is not,
`destabilising_environment` finds masses, springs and dashpots that it oscillates with.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import inf, pi, sqrt

from flint import ctx, fmpq, fmpq_poly

from beamdesign.loop import Tip
from beamdesign.polynomial import even_odd, is_hurwitz, real_roots, roots
from beamdesign.proofs.stability import stable_ranges
from beamdesign.rational import bounds, nearest, shortened, simple_between

_PRECISION_BITS = 128
_DIGITS = 15
_SHARES = (fmpq(1, 5), fmpq(2, 5), fmpq(3, 5), fmpq(4, 5))


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


def absorbed(tip: Tip) -> fmpq_poly:
    """Im(p conj n) / w at jw as a polynomial in x = w^2: not negative where the tip takes work in."""
    even, odd = even_odd(tip.bare)
    even_moved, odd_moved = even_odd(tip.moved)
    return odd * even_moved - even * odd_moved


def passivity(tip: Tip, low: fmpq, high: fmpq) -> Passivity:
    """Decide whether the tip is stable and passive with every end mass (kg) from `low` to `high`."""
    bands = active_bands(tip)
    words = [f"work comes out of the tip {in_words(bands)}"] if bands else []
    stability = stable_ranges(tip.over_mass, low, high)
    if not stability.stable:
        words.insert(0, f"the loop is not stable for all of these masses: {stability.reason}")
    return Passivity(not words, bands, "; ".join(words))


def active_bands(tip: Tip) -> tuple[Band, ...]:
    """The bands in which the tip gives off work, decided exactly; a frequency where it only touches zero is none."""
    value = absorbed(tip)
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
        sample = _clear_sample(value, start[1], None if end is None else end[0])
        if value(sample) < 0:
            bands.append(Band(start, end, sample))
    return tuple(bands)


def _clear_sample(value: fmpq_poly, start: fmpq, end: fmpq | None) -> fmpq:
    """A rational inside a cell at which the polynomial does not vanish: in its middle unless a double root is there."""
    end = 2 * start + 2 if end is None else end
    while value(sample := simple_between(start, end)) == 0:
        end = sample
    return sample


def _hertz(square: tuple[fmpq, fmpq]) -> float:
    return sqrt(nearest((square[0] + square[1]) / 2)) / (2 * pi)


def in_words(bands: tuple[Band, ...]) -> str:
    """Bands for a person."""

    def one(band: Band) -> str:
        if band.high is None:
            return f"above {band.low_Hz:.4g} Hz" if band.low_Hz else "at every frequency"
        return f"from {band.low_Hz:.4g} to {band.high_Hz:.4g} Hz" if band.low_Hz else f"below {band.high_Hz:.4g} Hz"

    return " and ".join(one(band) for band in bands)


def destabilising_environment(tip: Tip, bands: tuple[Band, ...], outer_end_mass: fmpq) -> Environment | None:
    """A passive environment that makes a stable loop grow, proved by an exact Routh test.

    At jw inside a band p / n = R - j w r with r > 0. A mass M on a spring M w^2 - R is in tune there, and with a
    dashpot of r / 2 its slow envelope grows at about r / 4 M: M is doubled until the linear loop is not stable.

    Args:
        tip: of the loop.
        bands: its active bands.
        outer_end_mass: what the tip carries beside the environment, kg.

    Returns:
        the one of least mass among a few per band; None where no mass up to a million times the first is enough.
    """
    found = [_in_tune(tip, square, outer_end_mass) for band in bands for square in _inside(band)]
    return min((one for one in found if one is not None), key=lambda one: one.mass, default=None)


def _inside(band: Band) -> list[fmpq]:
    """The band's sample, and some more for which nothing is known beforehand."""
    low, high = band.low[1], 2 * band.squared_frequency if band.high is None else band.high[0]
    return [band.squared_frequency, *(shortened(low + (high - low) * share, 3) for share in _SHARES)]


def _in_tune(tip: Tip, square: fmpq, outer_end_mass: fmpq) -> Environment | None:
    even, odd = (part(square) for part in even_odd(tip.against(outer_end_mass)))
    even_moved, odd_moved = (part(square) for part in even_odd(tip.moved))
    below = even_moved**2 + square * odd_moved**2
    if below == 0 or (given := (even * odd_moved - odd * even_moved) / below / 2) <= 0:
        return None
    elastic = (even * even_moved + square * odd * odd_moved) / below  # R = Re(p / n)
    damping = shortened(given, 3)  # r / 2
    mass = shortened(max(abs(elastic) / square, fmpq(1, 100)), 3, up=True)
    for _ in range(20):
        stiffness = mass * square - elastic
        if stiffness > 0:
            found = Environment(mass, shortened(stiffness, 4), damping)
            polynomial = tip.against(outer_end_mass + mass, found.stiffness, damping)
            if not is_hurwitz(polynomial) and max(root.real for root in roots(polynomial)) > 0:
                return found
        mass *= 2
    return None
