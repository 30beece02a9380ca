"""Zero frequencies of a lag for which every outer end mass of a range is stable: exact, not from a grid.

The characteristic polynomial is p0(s) + m p1(s) + u p2(s), affine in the mass m and in the inverse zero u, at a given
gain and pole. A root pair lies at jw where two linear equations in (m, u) hold, so that all such pairs are one rational
curve (m(x), u(x)) over x = w^2. Whether every mass of the range is stable can change over u only where that curve, cut
to the range, begins, ends or turns back: at crossings of the range's two ends, and where du/dx vanishes. Between these
values of u one proof over the whole range settles all.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import pi

from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.controllers import Lag
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, crossings, even_odd, exact, real_roots, value_at
from beamdesign.proofs.stability import is_stable_over
from beamdesign.prototype import Prototype
from beamdesign.rational import bounds, nearest, rounded_down, rounded_up, simple_between

LEAST_HZ = 1e-3
LARGEST_HZ = 1e5
"""Zero frequencies outside these are not looked at."""

_BITS = 128


@dataclass(frozen=True)
class StableZeros:
    """Zero frequencies between two neighbouring critical ones, proved stable for every mass.

    Attributes:
        low_Hz: rounded inwards.
        high_Hz: rounded inwards.
        sample_Hz: the frequency in between that was settled by a proof over the whole range of masses.
    """

    low_Hz: float
    high_Hz: float
    sample_Hz: float


def stable_zeros(
    prototype: Prototype, pole_Hz: float, gain_A_per_V: float, outer_end_mass_kg: tuple[float, float]
) -> list[StableZeros]:
    """All stable intervals of the lag's zero frequency at a pole and a gain, ascending.

    Args:
        prototype: the rig and its inner end mass; its own controller does not matter.
        pole_Hz: lower break of the lag.
        gain_A_per_V: its gain at zero frequency.
        outer_end_mass_kg: range of masses, each of which is to be stable.

    Raises:
        InputError: for a prototype with effects.
    """
    plant = paper_model(prototype).plant(prototype.payload.inner_end_mass_kg)
    lag = Lag(gain_A_per_V=gain_A_per_V, pole_Hz=pole_Hz, zero_Hz=1.0)
    pole = fmpq_poly([1, 1 / exact(2 * pi * lag.pole_Hz)])
    denominator = plant.denominator * pole
    numerator = plant.control[0].constant * exact(lag.gain_A_per_V)
    p0, p1, p2 = denominator.constant + numerator, denominator.slope, numerator * fmpq_poly([0, 1])
    low, high = (exact(mass) for mass in outer_end_mass_kg)
    ends = tuple(1 / exact(2 * pi * frequency) for frequency in (LARGEST_HZ, LEAST_HZ))
    edges: list[tuple[fmpq, fmpq]] = [(ends[0], ends[0])]
    edges += _merged(
        bounds(value) for value in critical_values(p0, p1, p2, low, high) if value > ends[0] and value < ends[1]
    )
    edges.append((ends[1], ends[1]))
    found = []
    for (_, start), (end, _) in pairwise(edges):
        sample = simple_between(start, end)
        if is_stable_over(Affine(p0 + sample * p2, p1), low, high):
            found.append(StableZeros(_hertz(end, up=True), _hertz(start, up=False), nearest(1 / sample) / (2 * pi)))
    return found[::-1]


def critical_values(p0: fmpq_poly, p1: fmpq_poly, p2: fmpq_poly, low: fmpq, high: fmpq) -> Iterator[arb]:
    """Enclosures of all u at which stability over the whole range of m can change for p0 + m p1 + u p2.

    The leading coefficient is taken not to vanish in the range, and the last to be free of m and u: so it is for a rig,
    whose end mass acts on accelerations.

    Raises:
        ArithmeticError: where the leading coefficient may vanish.
    """
    degree = max(polynomial.degree() for polynomial in (p0, p1, p2))
    if p2[degree] != 0 or p2[0] != 0 or p1[0] != 0 or (p0 + low * p1)[degree] * (p0 + high * p1)[degree] <= 0:
        raise ArithmeticError("a root of this family passes through the origin or through infinity")
    with ctx.workprec(_BITS):
        for mass in {low, high}:
            for crossing in crossings(Affine(p0 + mass * p1, p2), _BITS):
                yield crossing.parameter
        (even0, odd0), (even1, odd1), (even2, odd2) = (even_odd(p) for p in (p0, p1, p2))
        determinant = even1 * odd2 - odd1 * even2
        of_mass, of_zero = even2 * odd0 - odd2 * even0, odd1 * even0 - even1 * odd0
        # At a shared root a whole line of (m, u) has a root pair: it begins and ends at the range's ends, found above.
        shared = determinant.gcd(of_mass).gcd(of_zero)
        if not shared.is_zero():
            determinant, of_mass, of_zero = determinant / shared, of_mass / shared, of_zero / shared
        turning = of_zero.derivative() * determinant - of_zero * determinant.derivative()
        for square, _ in [] if turning.is_zero() else real_roots(turning, _BITS):
            below = value_at(determinant, square)
            if not square > 0 or below.contains(0):
                continue
            there = value_at(of_mass, square) / below
            if there < arb(low) or there > arb(high):
                continue
            yield value_at(of_zero, square) / below


def _merged(found: Iterator[tuple[fmpq, fmpq]]) -> list[tuple[fmpq, fmpq]]:
    """Enclosures in ascending order, those that overlap as one."""
    merged: list[tuple[fmpq, fmpq]] = []
    for low, high in sorted(found):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return merged


def _hertz(inverse: fmpq, up: bool) -> float:
    """Zero frequency of an inverse zero, s; a last digit inwards, for the division and pi."""
    value = (rounded_up if up else rounded_down)(1 / inverse) / (2 * pi)
    return value * (1 + 1e-12 if up else 1 - 1e-12)
