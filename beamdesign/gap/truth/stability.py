"""The true rig linearised at rest by differences, and the gain at which its loop begins to oscillate."""

import numpy as np

from beamdesign.gap.truth.rates import STATES, rates_at


def jacobian(figures: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """(n, n) derivative of the rates by those states that take part, by central differences about rest.

    Dead time, play and digital steps are left out.
    """
    matrix = np.zeros((STATES, STATES))
    for k in range(STATES):
        step = 1.0 if k in (12, 13, 27) else 1e-9  # pressures are in Pa
        ahead, behind = np.zeros(STATES), np.zeros(STATES)
        ahead[k], behind[k] = step, -step
        matrix[:, k] = (rates_at(ahead, figures, modes) - rates_at(behind, figures, modes)) / (2 * step)
    used = np.nonzero(matrix.any(axis=1))[0]
    return matrix[np.ix_(used, used)]


def is_stable(figures: np.ndarray, modes: np.ndarray) -> bool:
    """Whether all poles of the linearised loop lie in the left half plane, but for one at rest of the mean pressure."""
    matrix = jacobian(figures, modes)
    return bool(np.linalg.eigvals(_balanced(matrix)).real.max() < 0.0)


def linear_critical_gain(figures: np.ndarray, modes: np.ndarray) -> float:
    """Least gain in A/V at which the linearised loop is not stable, by bisection; infinite where there is none to 100.

    Args:
        figures: whose own gain does not matter.
        modes: of the outer beam.
    """
    trial = figures.copy()

    def stable(gain: float) -> bool:
        trial["gain"] = gain
        return is_stable(trial, modes)

    low = 1e-5
    high = low
    while stable(high):
        low, high = high, 2 * high
        if high > 100:
            return float("inf")
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return 0.5 * (low + high)


def _balanced(matrix: np.ndarray) -> np.ndarray:
    from scipy.linalg import matrix_balance

    return np.asarray(matrix_balance(matrix, permute=False)[0])
