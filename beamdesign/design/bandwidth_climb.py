"""Climb to a larger bandwidth within sampled limits: linear programs in a trust region, with exact derivatives.

At each step the least slack of compliance up to a little beyond the bandwidth reached is maximised, linearised, with
the other limits as constraints (sequential linear programming; R. Fletcher and E. Sainz de la Maza, Nonlinear
programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43, 1989). At such an
optimum nearly as many limits are active as there are variables, so that steps of first order are enough.
"""

from dataclasses import dataclass, replace

import numpy as np

from beamdesign.controllers.form import Form
from beamdesign.design.loop_samples import COMPLIANCE, OTHERS, Samples, Slacks, sampled_bandwidth, slacks
from beamdesign.prototype import Goal

_BEYOND = 1.06
"""Up to how many times the bandwidth reached the compliance is bettered."""

_PENALTY = 20.0
"""What a violation of the other limits costs, over the slack of compliance."""

_SMALLEST_REACH, _LARGEST_REACH = 1e-4, 0.5


@dataclass(frozen=True)
class Climb:
    """Where a climb ended.

    Attributes:
        variables: as in `beamdesign.design.loop_samples`.
        bandwidth_Hz: sampled.
        steps: how many linear programs were solved.
    """

    variables: np.ndarray
    bandwidth_Hz: float
    steps: int


def climb(
    points: Samples,
    goal: Goal,
    form: Form,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    most: int = 600,
    reach: float = 0.3,
) -> Climb:
    """Climb from a start whose loop is stable.

    Args:
        points: where the limits are kept.
        goal: the limits.
        form: of the law.
        start: (v,) variables.
        lower: (v,) their bounds.
        upper: (v,)
        most: linear programs at most.
        reach: how far a variable may move in the first step.
    """
    here = np.clip(start, lower, upper)
    now = slacks(points, goal, form, here)
    if not now.settled:
        return Climb(here, 0.0, 0)
    aim = _aim(points, now)
    steps, still = 0, 0
    while steps < most and reach > _SMALLEST_REACH and still < 12:
        steps += 1
        least, greatest = np.maximum(lower - here, -reach), np.minimum(upper - here, reach)
        merit = _merit(points, now, aim)
        move, foreseen = _step(points, now, aim, least, greatest)
        tried = here + move
        then = slacks(points, goal, form, tried)
        gained = _merit(points, then, aim) - merit
        if gained < 0.7 * (foreseen - merit) or not then.settled:
            # Curvature spoilt the step: linearise again with what the limits are at its end,
            # taken back along it with the slopes of its beginning.
            bent = replace(now, values=then.values - now.slopes @ move)
            again, _ = _step(points, bent, aim, least, greatest)
            tried_again = here + again
            then_again = slacks(points, goal, form, tried_again)
            if then_again.settled and (not then.settled or _merit(points, then_again, aim) - merit > gained):
                tried, then, gained = tried_again, then_again, _merit(points, then_again, aim) - merit
        if not then.settled or gained <= 0:
            reach /= 3
            continue
        if gained < 0.3 * (foreseen - merit):
            reach /= 2
        still = still + 1 if gained < 1e-4 else 0
        here, now = tried, then
        if gained > 0.5 * (foreseen - merit):
            reach = min(reach * 2, _LARGEST_REACH)
        aim = _aim(points, now)
    reached = sampled_bandwidth(points, now.compliance) if now.violation < 1e-3 else 0.0
    return Climb(here, reached, steps)


def _aim(points: Samples, now: Slacks) -> float:
    """Up to which frequency the compliance is to be bettered."""
    return max(sampled_bandwidth(points, now.compliance), float(points.frequency_Hz.min())) * _BEYOND


def _merit(points: Samples, found: Slacks, aim: float) -> float:
    return float(found.compliance[points.frequency_Hz <= aim].min()) - _PENALTY * found.violation


def _step(points: Samples, now: Slacks, aim: float, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, float]:
    """The best move within bounds by the linearised slacks, and the merit that is foreseen of it."""
    from scipy.optimize import linprog

    widest = np.maximum(np.abs(least), np.abs(most))
    below = points.frequency_Hz <= aim
    compliance, slopes = now.compliance[below], now.slopes[COMPLIANCE][below]
    # What cannot become active within these bounds is left out.
    worst = float(compliance.min()) + float((np.abs(slopes) @ widest).max())
    near = compliance - np.abs(slopes) @ widest < worst
    count = len(least)
    rows, right = [np.hstack([-slopes[near], np.ones((near.sum(), 1)), np.zeros((near.sum(), 1))])], [compliance[near]]
    for slack, slope in zip(now.values[OTHERS], now.slopes[OTHERS], strict=True):
        near = slack - np.abs(slope) @ widest < 0
        rows.append(np.hstack([-slope[near], np.zeros((near.sum(), 1)), -np.ones((near.sum(), 1))]))
        right.append(slack[near])
    cost = np.zeros(count + 2)
    cost[count], cost[count + 1] = -1.0, _PENALTY
    bounds = [*zip(least, most, strict=True), (None, None), (0.0, None)]
    found = linprog(cost, np.vstack(rows), np.concatenate(right), bounds=bounds, method="highs")
    if found.x is None:
        return np.zeros(count), -np.inf
    return np.asarray(found.x[:count]), -float(found.fun)
