"""Payload that changes suddenly and then stays for a while: the shortest average time between changes proved stable."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import log

import numpy as np
from flint import fmpq

from beamdesign.polynomial import exact
from beamdesign.proof.decrease import ZERO, Joining, dwell_suffices, holds_across_jumps, jump, jump_shares
from beamdesign.proof.lmi import Answer, Solve, Sought, slowest_decay, solve_across_jumps
from beamdesign.proof.mass_family import Families, floats
from beamdesign.proof.rational import nearest, shortened
from beamdesign.proof.verified import Coefficients, Status, checked, refusal

DECAY_SHARES = (0.3, 0.6, 0.9)
"""Decay rates to try, as shares of the slowest one of a mass that stays."""


@dataclass(frozen=True)
class SuddenChange:
    """Stability for a mass that jumps within a range, at long enough intervals on average, whichever stage acts when.

    V = x' P(m) x falls as exp(-2 decay t) while the mass stays and grows at most by `factor` at a jump. With no more
    than n0 + t / dwell jumps in any time t, for some n0, the loop is exponentially stable if
    dwell > log(factor) / (2 decay) (average dwell time; Hespanha and Morse, 1999).

    Attributes:
        status: see `beamdesign.proof.verified.Status`.
        reason: in words, why it is not proved; empty where it is.
        joining: how payload joins.
        dwell_s: average time between changes that is proved to be enough; None where nothing is proved.
        factor: growth of V at a change.
        decay_per_s: decay rate of |x| while the mass stays.
        coefficients: of P(m).
    """

    status: Status
    reason: str
    joining: Joining
    dwell_s: fmpq | None
    factor: fmpq
    decay_per_s: fmpq
    coefficients: Coefficients


def sudden_change(
    families: Families,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    coordinates: np.ndarray,
    solve: Solve = solve_across_jumps,
) -> SuddenChange:
    """The shortest average time between sudden changes that can be proved, over a few decay rates.

    Args:
        families: the closed loop with each stage, stable at every mass that stays.
        low: least mass, kg.
        high: largest mass, kg, above `low`.
        joining: how payload joins.
        coordinates: (n, n), to begin in.
        solve: what finds candidates.
    """
    best = SuddenChange("undecided", "no function was found", joining, None, ZERO, ZERO, ())
    for decay in decays(families, low, high):
        sought, inner = Sought(low, high, 1, ZERO, joining, decay), coordinates
        for _ in range(2):  # the second time in the coordinates of the first answer
            answer = solve(families, sought, inner, "CLARABEL")
            if not answer.coefficients:
                break
            found = verified(families, sought, answer)
            best = found if _better(found, best) else best
            if answer.coordinates is None:
                break
            inner = answer.coordinates
    return best


def decays(families: Families, low: fmpq, high: fmpq) -> Iterator[fmpq]:
    """Decay rates to try, 1/s."""
    slowest = slowest_decay(families, low, high)
    return (shortened(exact(slowest * share), 3) for share in DECAY_SHARES)


def _better(found: SuddenChange, best: SuddenChange) -> bool:
    if found.dwell_s is None:
        return best.dwell_s is None and found.status == "unverified"
    return best.dwell_s is None or found.dwell_s < best.dwell_s


def verified(families: Families, sought: Sought, answer: Answer) -> SuddenChange:
    """Round an answer to decimals, bound its growth at a jump, and check all of it exactly."""
    coefficients, wrong = checked(families, sought, answer.coefficients)
    if not wrong:
        leaps = [
            floats(jump(families[0], s)) for s in jump_shares(families[0], sought.low, sought.high, sought.joining)
        ]
        ends = [at_mass(coefficients, mass) for mass in (sought.low, sought.high)]
        factor = least_factor((leap @ after @ leap, before) for leap in leaps for before in ends for after in ends)
        across = holds_across_jumps(families[0], coefficients, sought.low, sought.high, factor, sought.joining)
        dwell = least_dwell(factor, sought.decay)
        if across.holds and dwell is not None:
            return SuddenChange("proved", "", sought.joining, dwell, factor, sought.decay, coefficients)
        wrong = across.reason
    status: Status = "unverified" if answer.claims else "undecided"
    words = refusal(answer, wrong) if answer.claims else "no function was found"
    return SuddenChange(status, words, sought.joining, None, ZERO, ZERO, ())


def at_mass(coefficients: Coefficients, mass: fmpq) -> np.ndarray:
    """P(m) in floats, (n, n)."""
    return np.sum([floats(p) * nearest(mass) ** k for k, p in enumerate(coefficients)], axis=0)


def least_factor(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> fmpq:
    """A little more than the largest ratio of V after and before a change, from pairs of P after and P before."""
    largest = 1.0
    for after, before in pairs:
        scale = 1 / np.sqrt(np.diag(before))
        inverse = np.linalg.inv(np.linalg.cholesky(before * np.outer(scale, scale)))
        ratio = inverse @ (after * np.outer(scale, scale)) @ inverse.T
        largest = max(largest, float(np.linalg.eigvalsh((ratio + ratio.T) / 2)[-1]))
    return shortened(exact(largest * (1 + 1e-5)), 6, up=True)


def least_dwell(factor: fmpq, decay: fmpq) -> fmpq | None:
    """A little more than log(factor) / (2 decay), s; None where that is not proved to be enough."""
    dwell = shortened(exact(log(nearest(factor)) / (2 * nearest(decay)) * (1 + 1e-6)), 4, up=True)
    return dwell if dwell_suffices(dwell, factor, decay) else None
