"""Masses that destabilise a loop: one that stays, decided exactly, or a cycle of two, proved by ball arithmetic."""

from dataclasses import dataclass

import numpy as np
from flint import arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.polynomial import exact, is_hurwitz
from beamdesign.proof.lmi import at, modal_coordinates
from beamdesign.proof.mass_family import MassFamily
from beamdesign.proof.rational import nearest
from beamdesign.proof.stability import stable_ranges

PRECISION_BITS = 384
DOUBLINGS = 13
"""Of the number of cycles, until a proof of growth is given up; a factor of 1.001 per cycle needs about 11."""


@dataclass(frozen=True)
class Cycle:
    """Sudden matched changes between two masses, again and again, under which the loop's motion grows.

    Attributes:
        outer_end_mass_kg: the two masses.
        time_s: time spent at each.
        factor: growth per cycle, the spectral radius over one cycle, in floats.
        cycles: repetitions after which growth is proved; 0 where it was only computed in floats.
    """

    outer_end_mass_kg: tuple[float, float]
    time_s: tuple[float, float]
    factor: float
    cycles: int

    @property
    def proved(self) -> bool:
        """Whether ball arithmetic confirms the growth."""
        return self.cycles > 0


def proved_cycles(family: MassFamily, low: fmpq, high: fmpq, time_low: fmpq, time_high: fmpq) -> int:
    """The number of cycles after which growth is proved, or 0.

    With M = exp(A(high) t_high) exp(A(low) t_low), enclosed by balls, |trace M^k| > n for one k proves that the
    spectral radius of M exceeds one, since |trace M^k| is at most n times its k-th power.
    """
    return proved_growth(family.at(low), family.at(high), time_low, time_high)


def proved_growth(first: fmpq_mat, second: fmpq_mat, time_first: fmpq, time_second: fmpq) -> int:
    """The same for any two matrices in turn."""
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


def growing_cycle(family: MassFamily, low: fmpq, high: fmpq) -> Cycle | None:
    """Search for a cycle between the two end masses under which the motion grows."""
    found = growing_times(at(family, low), at(family, high))
    if found is None:
        return None
    at_low, at_high, factor = found
    cycles = proved_cycles(family, low, high, exact(at_low), exact(at_high))
    return Cycle((nearest(low), nearest(high)), (at_low, at_high), factor, cycles)


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
    """Whether every mass that stays is stable, exactly.

    Attributes:
        stable: for the whole range.
        reason: what is wrong, in words; empty where it is stable.
        unstable_at: a mass at which an exact Routh test fails, kg; None where there is none (or only single masses,
            at which a root lies on the axis).
    """

    stable: bool
    reason: str
    unstable_at: fmpq | None


def frozen(family: MassFamily, low: fmpq, high: fmpq) -> Frozen:
    """Decide the stability of all masses that stay.

    A family whose characteristic polynomial is not affine in the mass is settled at its two ends only.
    """
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
