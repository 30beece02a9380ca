"""What destabilises a loop: a mass that stays, decided exactly, or two masses or stages in turn, by ball arithmetic."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from flint import arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.polynomial import exact, is_hurwitz
from beamdesign.proofs.lmi import at, modal_coordinates
from beamdesign.proofs.mass_family import Families, MassFamily
from beamdesign.proofs.stability import stable_ranges
from beamdesign.rational import nearest

PRECISION_BITS = 384
DOUBLINGS = 13
"""Of the number of cycles, until a proof of growth is given up; a factor of 1.001 per cycle needs about 11."""


Corner = tuple[int, fmpq]
"""A stage, numbered from 0, and an outer end mass, kg."""


@dataclass(frozen=True)
class Cycle:
    """Sudden changes between two stages, or between two masses, matched, under which the loop's motion grows.

    Attributes:
        stages: the stage at each, numbered from 0.
        outer_end_mass_kg: the mass at each.
        time_s: time spent at each.
        factor: growth per cycle, the spectral radius over one cycle, in floats.
        cycles: repetitions after which growth is proved; 0 where it was only computed in floats.
    """

    stages: tuple[int, int]
    outer_end_mass_kg: tuple[float, float]
    time_s: tuple[float, float]
    factor: float
    cycles: int

    @property
    def proved(self) -> bool:
        """Whether ball arithmetic confirms the growth."""
        return self.cycles > 0


def masses_in_turn(families: Families, low: fmpq, high: fmpq) -> Iterator[tuple[Corner, Corner]]:
    """The least and the largest mass in turn, with each stage that stays."""
    return (((k, low), (k, high)) for k in range(len(families)))


def stages_in_turn(families: Families, low: fmpq, high: fmpq) -> Iterator[tuple[Corner, Corner]]:
    """Any two stages in turn, at a few masses that stay."""
    pairs = list(combinations(range(len(families)), 2))
    return (((i, mass), (j, mass)) for mass in (low, (low + high) / 2, high) for i, j in pairs)


def proved_growth(first: fmpq_mat, second: fmpq_mat, time_first: fmpq, time_second: fmpq) -> int:
    """The number of cycles after which growth is proved, or 0.

    With M = exp(A2 t2) exp(A1 t1), enclosed by balls, |trace M^k| > n for one k proves that the spectral radius of M
    exceeds one, since |trace M^k| is at most n times its k-th power.
    """
    order = first.nrows()
    with ctx.workprec(PRECISION_BITS):
        power = arb_mat(second * time_second).exp() * arb_mat(first * time_first).exp()
        before = power
        for doubling in range(DOUBLINGS + 1):
            # Between powers of two lies a second chance for a complex pair, whose trace may be small at one of them.
            for k, candidate in ((2**doubling, power), (3 * 2**doubling // 2, power * before if doubling else power)):
                if abs(candidate.trace()) > order:
                    return k
            before, power = power, power * power
    return 0


def growing_cycle(families: Families, turns: Iterable[tuple[Corner, Corner]]) -> Cycle | None:
    """The cycle under which the motion grows fastest; finding none proves nothing.

    Args:
        families: the closed loop with each stage.
        turns: pairs of corners to go between.
    """
    best: Cycle | None = None
    for (i, first), (j, second) in turns:
        found = growing_times(at(families[i], first), at(families[j], second))
        if found is None or (best is not None and found[2] <= best.factor):
            continue
        *times, factor = found
        cycles = proved_growth(families[i].at(first), families[j].at(second), *map(exact, times))
        best = Cycle((i, j), (nearest(first), nearest(second)), (times[0], times[1]), factor, cycles)
    return best


def growing_times(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float] | None:
    """Times (s) at two matrices in turn under which the motion grows, and the growth per cycle, in floats.

    Times are tried on a logarithmic grid from a fraction of the fastest pole's period to the slowest's, and the best
    pair is refined; so finding none proves nothing.
    """
    from scipy.linalg import expm
    from scipy.optimize import minimize

    t = modal_coordinates(first)
    inverse = np.linalg.inv(t)
    ends = [t @ a @ inverse for a in (first, second)]
    speeds = np.abs(np.concatenate([np.linalg.eigvals(a) for a in ends]))
    times = np.geomspace(0.2 / speeds.max(), 2 * np.pi / max(speeds.min(), speeds.max() * 1e-4), 48)
    steps = [expm(np.multiply.outer(times, a)) for a in ends]
    products = steps[1][:, None] @ steps[0][None, :]  # [time at high, time at low]
    radii = np.abs(np.linalg.eigvals(products)).max(axis=-1)
    # Growth per second, not per cycle, would favour the shortest times, whose factor is too near one to prove.
    j, i = np.unravel_index(int(radii.argmax()), radii.shape)

    def decline(logs: np.ndarray) -> float:
        at_low, at_high = np.clip(np.exp(logs), times[0], times[-1])
        return -float(np.abs(np.linalg.eigvals(expm(ends[1] * at_high) @ expm(ends[0] * at_low))).max())

    best = minimize(decline, np.log([times[i], times[j]]), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
    if best.fun >= -1.0:
        return None
    at_low, at_high = (float(f"{value:.6g}") for value in np.clip(np.exp(best.x), times[0], times[-1]))
    return at_low, at_high, -float(best.fun)


@dataclass(frozen=True)
class Frozen:
    """Whether every mass that stays is stable with every stage that stays, exactly.

    Attributes:
        stable: for the whole range.
        reason: what is wrong, in words; empty where it is stable.
        unstable_at: a mass at which an exact Routh test fails, kg; None where there is none (or only single masses,
            at which a root lies on the axis).
        stage: with which it fails, numbered from 0.
    """

    stable: bool
    reason: str
    unstable_at: fmpq | None
    stage: int = 0


def frozen(families: Families, low: fmpq, high: fmpq) -> Frozen:
    """Decide the stability of all masses and stages that stay.

    A family whose characteristic polynomial is not affine in the mass is settled at its two ends only.
    """
    for k, family in enumerate(families):
        stays = _frozen(family, low, high)
        if not stays.stable:
            stage = f"stage {k + 1}: " if len(families) > 1 else ""
            return replace(stays, reason=stage + stays.reason, stage=k)
    return Frozen(True, "", None)


def _frozen(family: MassFamily, low: fmpq, high: fmpq) -> Frozen:
    try:
        characteristic = family.characteristic()
    except ValueError:
        for mass in (low, high):
            if not is_hurwitz(family.at(mass).charpoly()):
                return Frozen(False, f"unstable at {nearest(mass):.7g} kg", mass)
        return Frozen(True, "", None)
    found = stable_ranges(characteristic, low, high)
    samples = [part.sample for part in found.ranges if not part.stable]
    return Frozen(found.stable, found.reason, samples[0] if samples else None)
