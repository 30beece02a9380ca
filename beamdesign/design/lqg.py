"""The linear-quadratic-Gaussian controller of a weighted plant: state feedback with a Kalman filter."""

import numpy as np
from scipy.linalg import solve_continuous_are

from beamdesign.design.state_space import GeneralisedPlant, StateSpace


def lqg(plant: GeneralisedPlant) -> StateSpace:
    """The controller from y to u of least variance of z under white noise w, of the plant's order.

    Args:
        plant: with d11 = 0, no cost between states and input (d12'c1 = 0) and none between noises (b1 d21' = 0).

    Raises:
        numpy.linalg.LinAlgError: where a Riccati equation has no stabilising solution.
    """
    k = feedback_gain(plant.a, plant.b2, plant.c1.T @ plant.c1, plant.d12.T @ plant.d12)
    f = feedback_gain(plant.a.T, plant.c2.T, plant.b1 @ plant.b1.T, plant.d21 @ plant.d21.T).T
    inside = plant.a - plant.b2 @ k - f @ plant.c2
    return StateSpace(inside, f, -k, np.zeros((plant.b2.shape[1], plant.c2.shape[0])))


def feedback_gain(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Gain k of u = -k x that minimises the integral of x'qx + u'ru; of a', c' and noises the Kalman filter's."""
    return np.asarray(np.linalg.solve(r, b.T @ solve_continuous_are(a, b, q, r)))
