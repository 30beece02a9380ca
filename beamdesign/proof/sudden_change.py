"""Payload that changes suddenly and then stays for a while: the shortest average time between changes proved stable."""

from collections.abc import Callable
from dataclasses import dataclass
from math import log

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proof.any_change import Status
from beamdesign.proof.decrease import Joining, dwell_suffices, holds_across_jumps, holds_at_rate, jump, jump_shares
from beamdesign.proof.lmi import Answer, Sought, slowest_decay, solve_across_jumps
from beamdesign.proof.mass_family import MassFamily, floats, rationals
from beamdesign.proof.rational import nearest, shortened

DECAY_SHARES = (0.3, 0.6, 0.9)
"""Decay rates to try, as shares of the slowest one of a mass that stays."""

Solve = Callable[[MassFamily, Sought, np.ndarray, str], Answer]


@dataclass(frozen=True)
class SuddenChange:
    """Stability for a mass that jumps within a range, at intervals that are long enough on average.

    V = x' P(m) x falls as exp(-2 decay t) while the mass stays and grows at most by `factor` at a jump. With no more
    than n0 + t / dwell jumps in any time t, for some n0, the loop is exponentially stable if
    dwell > log(factor) / (2 decay) (average dwell time; Hespanha and Morse, 1999).

    Attributes:
        status: see `beamdesign.proof.any_change.Status`.
        reason: in words, why it is not proved; empty where it is.
        joining: how payload joins.
        dwell_s: average time between changes that is proved to be enough; None where nothing is proved.
        factor: growth of V at a change.
        decay_per_s: decay rate of |x| while the mass stays.
        coefficients: of P(m), ascending in m, (n, n) each, exact, SI.
    """

    status: Status
    reason: str
    joining: Joining
    dwell_s: fmpq | None
    factor: fmpq
    decay_per_s: fmpq
    coefficients: tuple[fmpq_mat, ...]


def sudden_change(
    family: MassFamily,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    coordinates: np.ndarray,
    solve: Solve = solve_across_jumps,
) -> SuddenChange:
    """The shortest average time between sudden changes that can be proved, over a few decay rates.

    Args:
        family: the closed loop, stable at every mass that stays.
        low: least mass, kg.
        high: largest mass, kg, above `low`.
        joining: how payload joins.
        coordinates: (n, n), to begin in.
        solve: what finds candidates.
    """
    best = SuddenChange("undecided", "no function was found", joining, None, fmpq(0), fmpq(0), ())
    slowest = slowest_decay(family, low, high)
    for share in DECAY_SHARES:
        decay = shortened(exact(slowest * share), 3)
        sought, inner = Sought(low, high, 1, fmpq(0), joining, decay), coordinates
        for _ in range(2):  # the second time in the coordinates of the first answer
            answer = solve(family, sought, inner, "CLARABEL")
            if not answer.coefficients:
                break
            found = verified(family, sought, answer)
            best = found if _better(found, best) else best
            if answer.coordinates is None:
                break
            inner = answer.coordinates
    return best


def _better(found: SuddenChange, best: SuddenChange) -> bool:
    if found.dwell_s is None:
        return best.dwell_s is None and found.status == "unverified"
    return best.dwell_s is None or found.dwell_s < best.dwell_s


def verified(family: MassFamily, sought: Sought, answer: Answer) -> SuddenChange:
    """Round an answer to decimals, bound its growth at a jump, and check all of it exactly."""
    nothing = SuddenChange("undecided", "no function was found", sought.joining, None, fmpq(0), fmpq(0), ())
    if not all(np.all(np.isfinite(p)) for p in answer.coefficients):
        return nothing
    coefficients = tuple(rationals(p) for p in answer.coefficients)
    falls = holds_at_rate(family, coefficients, sought.low, sought.high, fmpq(0), sought.joining, sought.decay)
    if falls.holds:
        factor = shortened(exact(_growth(family, sought, answer) * (1 + 1e-5)), 6, up=True)
        across = holds_across_jumps(family, coefficients, sought.low, sought.high, factor, sought.joining)
        if across.holds:
            dwell = shortened(exact(log(nearest(factor)) / (2 * nearest(sought.decay)) * (1 + 1e-6)), 4, up=True)
            if dwell_suffices(dwell, factor, sought.decay):
                return SuddenChange("proved", "", sought.joining, dwell, factor, sought.decay, coefficients)
        falls = across
    if not answer.claims:
        return nothing
    words = f"{answer.solver} says {answer.status}, the exact check refuses it ({falls.reason})"
    return SuddenChange("unverified", words, sought.joining, None, fmpq(0), fmpq(0), ())


def _growth(family: MassFamily, sought: Sought, answer: Answer) -> float:
    """The largest ratio of V after and before a jump, in floats; at least a little above one."""
    from scipy.linalg import eigh

    if answer.coordinates is None:
        return 1.0
    inverse = np.linalg.inv(answer.coordinates)
    ends = [sum(p * float(mass) ** k for k, p in enumerate(answer.coefficients)) for mass in (sought.low, sought.high)]
    ratios = [1.0]
    for share in jump_shares(family, sought.low, sought.high, sought.joining):
        leap = floats(jump(family, share))
        for before in ends:
            for after in ends:
                top, bottom = (inverse.T @ p @ inverse for p in (leap @ after @ leap, before))
                ratios.append(float(eigh((top + top.T) / 2, (bottom + bottom.T) / 2, eigvals_only=True)[-1]))
    return max(ratios)
