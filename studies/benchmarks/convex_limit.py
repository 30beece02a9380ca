"""How far displacement feedback of any order goes at one payload: convex in the closed loop, on samples.

For a stable plant P every controller that steadies the loop is one stable T = L / (1 + L), and S = 1 - T, C S = T / P:
all limits are convex in T (S. P. Boyd and C. H. Barratt, Linear Controller Design: Limits of Performance, 1991). So is
|L| <= a, a disc for T as well. T is a sum of many fixed functions that fall off as fast as P has to; T / P is stable
where P has no zero on the right. What is found here neither bounds the bandwidth from above, for more
functions may reach further, nor is it a design, for it is sampled and of an order that nobody builds: it stands between
the designs and Bode's bound.
"""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamdesign.plant.equilibrium import StateSpace
from beamdesign.prototype import Goal

FREQUENCIES_HZ = np.concatenate(
    [np.geomspace(0.05, 5, 30), np.geomspace(5.1, 120, 260), np.geomspace(122, 1000, 80), np.geomspace(1050, 2e4, 12)]
)
"""Samples at which the limits are kept."""

_ROLL_OFF_HZ = (300.0, 300.0, 300.0, 300.0, 1500.0, 1500.0)
"""Of all functions: as many lags as P has poles more than zeros."""

_CLOSEST = 1.02
"""Ratio of the bandwidths between which the search ends."""


@dataclass(frozen=True)
class ConvexLimit:
    """How far the sum of functions goes.

    Attributes:
        bandwidth_Hz: largest at which all limits are kept at the samples.
        functions: how many there are.
    """

    bandwidth_Hz: float
    functions: int


def convex_limit(plant: StateSpace, goal: Goal, lowest_Hz: float = 1.0, highest_Hz: float = 100.0) -> ConvexLimit:
    """The largest bandwidth of displacement feedback of a high order, by bisection.

    Args:
        plant: stable, whose first sensor is the displacement's and sees no zero on the right.
        goal: the limits.
        lowest_Hz: where the search begins; 0 is the answer where not even that is reached.
        highest_Hz: where it ends.

    Raises:
        ValueError: for a plant with a zero on the right.
    """
    if _zeros(plant).real.max(initial=-np.inf) > 0:
        raise ValueError("the plant has a zero on the right, which these functions do not share")
    grid = np.union1d(FREQUENCIES_HZ, [goal.loop_gain_from_Hz])
    count = _functions(2j * np.pi * grid).shape[1]
    if _excess(plant, goal, grid, lowest_Hz) > 0:
        return ConvexLimit(0.0, count)
    low, high = lowest_Hz, highest_Hz
    while high / low > _CLOSEST:
        middle = float(np.sqrt(low * high))
        if _excess(plant, goal, grid, middle) > 0:
            high = middle
        else:
            low = middle
    return ConvexLimit(low, count)


def _zeros(plant: StateSpace) -> np.ndarray:
    """Finite zeros from current to the displacement sensor, rad/s: the pencil of the system loses rank there."""
    from scipy.linalg import eigvals

    n = len(plant.a)
    pencil = np.block([[plant.a, plant.b[:, 1:]], [plant.c[1:2], np.zeros((1, 1))]])
    found = eigvals(pencil, np.diag(np.append(np.ones(n), 0.0)))
    return np.asarray(found[np.isfinite(found) & (np.abs(found) < 2 * np.pi * 1e4)])


def _functions(s: np.ndarray) -> np.ndarray:
    """Responses (f, n) of the functions: orthonormal but for factors and the roll-off."""
    poles = [(w, 1.0) for w in np.geomspace(0.3, 400, 10)]
    poles += [(w, 0.15) for w in np.geomspace(8, 120, 16)]
    poles += [(w, 0.2) for w in np.geomspace(60, 400, 8)]
    through = np.prod([1 / (1 + s / (2 * np.pi * lag)) for lag in _ROLL_OFF_HZ], axis=0)
    found = []
    for frequency, damping in poles:
        u = s / (2 * np.pi * frequency)
        below = 1 + 2 * damping * u + u * u
        own = through * np.sqrt(4 * damping) / below
        found += [own, own * u]
        through = through * (1 - 2 * damping * u + u * u) / below
    return np.array(found).T


def _excess(plant: StateSpace, goal: Goal, grid: np.ndarray, bandwidth_Hz: float) -> float:
    """Share by which the goal's compliance has to be exceeded up to a frequency, all else being kept."""
    import cvxpy as cp

    response = plant.at(2j * np.pi * grid)
    open_loop, sensed = np.abs(response[:, 0, 0]), np.abs(response[:, 1, 1])
    functions = _functions(2j * np.pi * grid)
    weights, excess = cp.Variable(functions.shape[1]), cp.Variable()
    real, imaginary = functions.real @ weights, functions.imag @ weights

    def within(bound: Any, re: Any, im: Any, scale: np.ndarray) -> Any:
        return cp.SOC(bound, cp.vstack([cp.multiply(scale, re), cp.multiply(scale, im)]))

    low = grid <= bandwidth_Hz
    every = np.ones(len(grid))
    limits = [
        within(every, 1 - real, imaginary, every / goal.peak_sensitivity),
        within(
            np.ones(low.sum()) * (1 + excess), 1 - real[low], imaginary[low], open_loop[low] / goal.compliance_m_per_N
        ),
    ]
    if goal.controller_effort_A_per_V is not None:
        limits.append(within(every, real, imaginary, 1 / (sensed * goal.controller_effort_A_per_V)))
    if goal.loop_gain is not None and goal.loop_gain < 1:
        high = grid >= goal.loop_gain_from_Hz
        radius = goal.loop_gain / (1 - goal.loop_gain**2)  # of the disc that |L| <= a is for T, centred left of zero
        limits.append(
            within(every[high], real[high] + goal.loop_gain * radius, imaginary[high], np.full(high.sum(), 1 / radius))
        )
    problem = cp.Problem(cp.Minimize(excess), limits)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of inaccurate answers: nothing here is proved
            problem.solve(solver="CLARABEL")
    except cp.error.SolverError:
        return np.inf
    return float(np.asarray(excess.value)) if problem.status in ("optimal", "optimal_inaccurate") else np.inf
