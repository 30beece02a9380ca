"""Linear models as matrices, and two syntheses of a controller for a weighted plant by a pair of Riccati equations.

The regulator of least variance is state feedback with a Kalman filter. That of least norm is the central controller of
J. C. Doyle, K. Glover, P. Khargonekar and B. Francis, State-space solutions to standard H2 and H-infinity control
problems, IEEE Transactions on Automatic Control 34, 1989, of which the first is the case of an infinite level.
"""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy.linalg import block_diag, solve_continuous_are


@dataclass(frozen=True)
class StateSpace:
    """x' = a x + b u, y = c x + d u."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the open left half plane."""
        return bool((np.linalg.eigvals(self.a).real < 0).all())

    def responses(self, s: np.ndarray) -> np.ndarray:
        """(n, outputs, inputs) at the complex frequencies s (n,)."""
        inside = np.linalg.solve(s[:, None, None] * np.eye(len(self.a)) - self.a, self.b[None].astype(complex))
        return np.asarray(self.c @ inside + self.d)

    def behind(self, first: "StateSpace") -> "StateSpace":
        """In series: what comes out of the first goes into this."""
        zero = np.zeros((len(first.a), len(self.a)))
        return StateSpace(
            np.block([[first.a, zero], [self.b @ first.c, self.a]]),
            np.vstack([first.b, self.b @ first.d]),
            np.hstack([self.d @ first.c, self.c]),
            self.d @ first.d,
        )


@dataclass(frozen=True)
class GeneralisedPlant:
    """x' = a x + b1 w + b2 u, z = c1 x + d12 u, y = c2 x + d21 w.

    w disturbs, z is to be small, y is measured and u acts. There is no cost between states and input (d12'c1 = 0), and
    none between noises (b1 d21' = 0).
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    d12: np.ndarray
    d21: np.ndarray

    def closed(self, law: StateSpace) -> StateSpace:
        """From w to z with u = law y."""
        a = np.block([[self.a + self.b2 @ law.d @ self.c2, self.b2 @ law.c], [law.b @ self.c2, law.a]])
        b = np.vstack([self.b1 + self.b2 @ law.d @ self.d21, law.b @ self.d21])
        c = np.hstack([self.c1 + self.d12 @ law.d @ self.c2, self.d12 @ law.c])
        return StateSpace(a, b, c, self.d12 @ law.d @ self.d21)


def lqg(plant: GeneralisedPlant) -> StateSpace:
    """The controller from y to u of least variance of z under white noise w, of the plant's order.

    Raises:
        numpy.linalg.LinAlgError: where a Riccati equation has no stabilising solution.
    """
    return central(plant, inf)


SLACK = 1.05
"""Factor on the least norm at which a controller is taken: the optimum itself is singular."""

_TOLERANCE, _SMALLEST, _LARGEST = 1e-6, 1e-9, 1e9
"""Relative tolerance of the least norm, and between what it is sought."""


def hinf(plant: GeneralisedPlant) -> StateSpace:
    """The central controller from y to u a little above the least H-infinity norm from w to z.

    Raises:
        numpy.linalg.LinAlgError: where there is none.
    """
    return central(plant, SLACK * least_norm(plant))


def least_norm(plant: GeneralisedPlant) -> float:
    """Least H-infinity norm from w to z that a controller reaches, by bisection, on its upper side.

    Raises:
        numpy.linalg.LinAlgError: where there is none.
    """

    def reached(level: float) -> bool:
        try:
            central(plant, level)
        except np.linalg.LinAlgError:
            return False
        return True

    high = 1.0
    while not reached(high):
        high *= 2
        if high > _LARGEST:
            raise np.linalg.LinAlgError("no controller keeps any norm")
    low = high / 2
    while low > _SMALLEST and reached(low):
        low, high = low / 2, low
    while high / low > 1 + _TOLERANCE:
        middle = sqrt(low * high)
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high


def central(plant: GeneralisedPlant, level: float) -> StateSpace:
    """The central controller from y to u that keeps the H-infinity norm from w to z below a level.

    Raises:
        numpy.linalg.LinAlgError: where no controller does.
    """
    cost, noise = plant.d12.T @ plant.d12, plant.d21 @ plant.d21.T
    x = _stabilising(plant.a, plant.b2, plant.c1.T @ plant.c1, cost, plant.b1 / level)
    y = _stabilising(plant.a.T, plant.c2.T, plant.b1 @ plant.b1.T, noise, plant.c1.T / level)
    coupled = y @ x / level**2
    if np.abs(np.linalg.eigvals(coupled)).max() >= 1:
        raise np.linalg.LinAlgError("the two equations do not go together at this level")
    k = np.linalg.solve(cost, plant.b2.T @ x)
    f = np.linalg.solve(np.eye(len(x)) - coupled, np.linalg.solve(noise, plant.c2 @ y).T)
    inside = plant.a + plant.b1 @ plant.b1.T @ x / level**2 - plant.b2 @ k - f @ plant.c2
    return StateSpace(inside, f, -k, np.zeros((plant.b2.shape[1], plant.c2.shape[0])))


_INDEFINITE = 1e-9
"""Least eigenvalue of a solution over its largest, from which it counts as one that is nowhere negative."""


def _stabilising(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray, worst: np.ndarray) -> np.ndarray:
    """The solution x, nowhere negative, of a'x + xa + q - x (b inv(r) b' - worst worst') x = 0 that stabilises."""
    if not worst.any():
        return np.asarray(solve_continuous_are(a, b, q, r))
    both, weights = np.hstack([worst, b]), block_diag(-np.eye(worst.shape[1]), r)
    x = np.asarray(solve_continuous_are(a, both, q, weights))
    values = np.linalg.eigvalsh(x)
    if values[0] < -_INDEFINITE * values[-1]:
        raise np.linalg.LinAlgError("the solution is negative somewhere")
    return x
