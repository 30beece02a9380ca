"""The sampled-data loop of a controller as realised: hold, word by word, and the time for computing.

With a computing time tau the old current is held for tau and the new one for the rest of the period,

    x[k+1] = Phi x[k] + (Gamma(T) - Gamma(T - tau)) i[k-1] + Gamma(T - tau) i[k].

For a proof of every computing time, the same at every sample, Gamma(T - tau) is enclosed for all tau of an interval
(K. J. Astrom and B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997), section 3.2). Intervals are halved where
the proof over the masses is not found.
"""

from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.build.realisation.law import LinearLaw
from beamdesign.build.realisation.realise import Realisation, floats
from beamdesign.build.sampled_loop import HeldPlant, SampledVerdict, held_plant, prove_sampled
from beamdesign.polynomial import exact
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.rational import nearest

_BITS = 128


class Sampled(Protocol):
    """A law at a rate."""

    @property
    def rate_Hz(self) -> float:
        """Sampling rate."""

    @property
    def linear(self) -> LinearLaw:
        """With the coefficients that it has."""


L = TypeVar("L", bound=Sampled)


@dataclass(frozen=True)
class RealisedLoop(Generic[L]):
    """The loop over the outer end mass, without command; roundings and limits left out, which are bounded elsewhere.

    States are those of the plant, the current being put out where it is late, and those of the law.

    Attributes:
        plant: between samples.
        realisation: the controller.
        delayed: whether the current is put out one period after its sample.
    """

    plant: HeldPlant
    realisation: L
    delayed: bool

    def parts(self) -> tuple[list[list[arb]], list[list[arb]], list[arb], list[arb]]:
        """Of the law's states after a sample what that of the plant's and their own adds; of its current likewise."""
        law = self.realisation.linear
        given = self.plant.readings(law.heard)

        def balls(matrix: fmpq_mat) -> list[list[arb]]:
            return [[arb(matrix[i, j]) for j in range(matrix.ncols())] for i in range(matrix.nrows())]

        return balls(law.b * given), balls(law.a), balls(law.d * given)[0], balls(law.c)[0]

    def closed(self, moved: arb_mat, fresh: arb_mat | None) -> arb_mat:
        """The closed loop's matrix from sample to sample.

        Args:
            moved: of the plant's states and a current held for a period.
            fresh: likewise for the part of a period in which the new current is out, the old one being out before; None
                where that is the whole of it, so that the old current is no state.
        """
        seen, kept, now, own = self.parts()
        n, held = len(now), [] if fresh is None else [arb(0)]
        current, memory = [*now, *held, *own], [[*one, *held, *other] for one, other in zip(seen, kept, strict=True)]
        rows = []
        for i in range(n):
            new = moved[i, n] if fresh is None else fresh[i, n]
            old = [] if fresh is None else [moved[i, n] - new]
            before = [*(moved[i, j] for j in range(n)), *old, *[arb(0)] * len(own)]
            rows.append([value + new * added for value, added in zip(before, current, strict=True)])
        return arb_mat([*rows, *([current] if held else []), *memory])

    def enclosed(self, low: fmpq, high: fmpq) -> arb_mat:
        """The same, enclosed for all masses from `low` to `high`."""
        moved = self.plant.moved(low, high, self.realisation.rate_Hz)
        return self.closed(moved, arb_mat(moved.nrows(), moved.ncols()) if self.delayed else None)

    def matrix(self, mass: fmpq) -> np.ndarray:
        """The same at one mass, in floats."""
        return middle(self.enclosed(mass, mass))


@dataclass(frozen=True)
class RoundedLoop:
    """The loop at one mass with everything that enters it, in floats: x+ = A x + B u, y = C x + D u.

    Attributes:
        a, b, c, d: inputs u are the force on the tip (N, held) and the roundings of the law; outputs y the displacement
            of the tip (m), the current (A) computed at the sample, and the error (V).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


def realised_loop(prototype: Prototype, realisation: L, delayed: bool = True) -> RealisedLoop[L]:
    """The loop of a prototype's plant and a realised controller.

    Raises:
        InputError: for a prototype with effects; its plant is not that of equations (7) to (18).
    """
    return RealisedLoop(held_plant(prototype), realisation, delayed)


def rounded_loop(loop: RealisedLoop[Realisation], mass_kg: float) -> RoundedLoop:
    """The loop at one outer end mass with its roundings as inputs."""
    mass, law, plant = exact(mass_kg), loop.realisation.linear, loop.plant
    with ctx.workprec(_BITS):
        a = loop.matrix(mass)
        pushed = middle(plant.pushed(mass, loop.realisation.rate_Hz))
        moved = middle(plant.moved(mass, mass, loop.realisation.rate_Hz))
    n, m, late = plant.a.nrows(), len(law.states), int(loop.delayed)
    inputs = 1 + len(law.roundings)
    tip, seen = floats(plant.tip), floats(plant.readings(law.heard))
    b = np.zeros((n + late + m, inputs))
    b[:n, 0] = pushed[:n, n]
    given = floats(law.g)
    if late:
        b[n, 1:] = given
    else:
        b[:n, 1:] = moved[:n, n : n + 1] @ given
    b[n + late :, 1:] = floats(law.f)
    c, d = np.zeros((3, n + late + m)), np.zeros((3, inputs))
    c[0, :n], c[2, :n] = tip[0], seen[0]
    c[1, :n], c[1, n + late :] = (floats(law.d) @ seen)[0], floats(law.c)[0]
    d[1, 1:] = given
    return RoundedLoop(a, b, c, d)


def middle(balls: arb_mat) -> np.ndarray:
    """Midpoints in floats."""
    return np.array([[float(balls[i, j].mid()) for j in range(balls.ncols())] for i in range(balls.nrows())])


_FIRST = 32
"""Intervals to begin with: where they are too wide, finding that out costs as much as ten that are not."""
_LEAST = fmpq(1, 512)


@dataclass(frozen=True)
class ComputedLate:
    """The loop for all computing times of an interval.

    Attributes:
        loop: whose own delay plays no part.
        first, last: ends of the interval, as shares of the period.
    """

    loop: RealisedLoop[Any]
    first: fmpq
    last: fmpq

    def enclosed(self, low: fmpq, high: fmpq) -> arb_mat:
        """The closed loop's matrix from sample to sample, for all masses from `low` to `high` and all times."""
        plant = self.loop.plant
        period = arb(1) / arb(exact(self.loop.realisation.rate_Hz))
        moved = plant.moved_for(low, high, period)
        rest = plant.moved_for(low, high, period * arb(1 - self.first).union(arb(1 - self.last)))
        return self.loop.closed(moved, rest)

    def matrix(self, mass: fmpq) -> np.ndarray:
        """The same at one mass in the middle of the interval, in floats."""
        return middle(self.enclosed(mass, mass))


def prove_any_computing_time(
    loop: RealisedLoop[Any],
    low_kg: float,
    high_kg: float,
    progress: Progress = silent,
) -> SampledVerdict:
    """Prove stability for every outer end mass of a closed range and every computing time up to one period.

    It stays open where two characteristic values meet on the way, in whose modal coordinates nothing contracts.

    Args:
        loop: of the realised controller.
        low_kg: least mass.
        high_kg: largest mass.
        progress: told the share done, and what is looked at.
    """
    open_intervals = [(fmpq(k, _FIRST), fmpq(k + 1, _FIRST)) for k in range(_FIRST)]  # the latest first
    pieces, largest, seen = 0, 0.0, 0
    while open_intervals:
        first, last = open_intervals.pop()
        progress(1 - nearest(last), f"computing time of {nearest(last):.3g} periods")
        found = prove_sampled(ComputedLate(loop, first, last), low_kg, high_kg)
        pieces, largest, seen = pieces + found.pieces, max(largest, found.largest_modulus), seen + found.looked_at
        if found.stable:
            continue
        where = f"at a computing time of {nearest(first):.6g} to {nearest(last):.6g} periods: {found.reason}"
        if found.stable is False or last - first <= _LEAST:
            return SampledVerdict(found.stable, where, pieces, largest, seen)
        open_intervals += [(first, (first + last) / 2), ((first + last) / 2, last)]
    return SampledVerdict(True, "", pieces, largest, seen)
