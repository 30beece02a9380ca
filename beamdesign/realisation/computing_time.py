"""Stability for every computing time from nothing to one period, the same at every sample.

With a computing time tau the old current is held for tau and the new one for the rest of the period,

    x[k+1] = Phi x[k] + (Gamma(T) - Gamma(T - tau)) i[k-1] + Gamma(T - tau) i[k],

in which Gamma(T - tau) is enclosed for all tau of an interval (K. J. Astrom and B. Wittenmark, Computer-Controlled
Systems, 3rd ed. (1997), section 3.2). Intervals are halved where the proof over the masses is not found.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb, arb_mat, fmpq

from beamdesign.polynomial import exact
from beamdesign.proof.rational import nearest
from beamdesign.realisation.loop import RealisedLoop, middle
from beamdesign.specification.sampled_loop import SampledVerdict, prove_sampled

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
        seen, kept, now, own = self.loop.parts()
        n, m = len(now), len(own)
        current = [*now, arb(0), *own]
        memory = [[*seen[i], arb(0), *kept[i]] for i in range(m)]
        rows = []
        for i in range(n):
            before = [*(moved[i, j] for j in range(n)), moved[i, n] - rest[i, n], *[arb(0)] * m]
            rows.append([value + rest[i, n] * added for value, added in zip(before, current, strict=True)])
        return arb_mat([*rows, current, *memory])

    def matrix(self, mass: fmpq) -> np.ndarray:
        """The same at one mass in the middle of the interval, in floats."""
        return middle(self.enclosed(mass, mass))


def prove_any_computing_time(
    loop: RealisedLoop[Any],
    low_kg: float,
    high_kg: float,
    progress: Callable[[float, str], None] = lambda share, words: None,
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
