"""Syntheses of a controller for a weighted plant: linear-quadratic-Gaussian, and H-infinity by matrix inequalities.

The first is state feedback with a Kalman filter. The change of variables of the second is that of C. Scherer, P.
Gahinet and M. Chilali, Multiobjective output-feedback control via LMI optimization, IEEE Transactions on Automatic
Control 42, 1997. What a solver says of its own answer counts for nothing: the norm of the loop that is closed with the
controller is computed anew, by a Hamiltonian's eigenvalues (S. Boyd, V. Balakrishnan and P. Kabamba, A bisection
method for computing the H-infinity norm of a transfer matrix, Mathematics of Control, Signals and Systems 2, 1989).
"""

import warnings
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any

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


SLACK = 1.05
"""Factor on the least norm within which the best conditioned controller is looked for: the optimum is singular."""


@dataclass(frozen=True)
class HinfDesign:
    """Outcome of `synthesise`.

    Attributes:
        law: from y to u; None where none was found.
        bound: what the matrix inequalities say that the norm can be brought down to.
        norm: of the loop with this law, computed anew.
        reason: why there is none, empty where there is.
    """

    law: StateSpace | None
    bound: float
    norm: float
    reason: str = ""


def hinf_norm(system: StateSpace, tolerance: float = 1e-6) -> float:
    """Largest singular value over all frequencies; infinite where the system is not stable.

    A level is above the norm where the Hamiltonian of that level has no eigenvalue on the imaginary axis; the bisection
    ends at the relative tolerance, on the upper side.
    """
    if not system.stable:
        return inf
    b, c, d = system.b, system.c, system.d
    low = max(float(np.linalg.norm(d, 2)), float(np.linalg.norm(system.responses(np.zeros(1))[0], 2)), 1e-12)
    poles = np.linalg.eigvals(system.a)
    gains = np.linalg.norm(system.responses(1j * np.abs(poles)), 2, axis=(1, 2))
    low = max(low, float(gains.max()))
    high = 2 * low
    while _reached(system.a, b, c, d, high):
        low, high = high, 2 * high
    while high / low > 1 + tolerance:
        middle = sqrt(low * high)
        if _reached(system.a, b, c, d, middle):
            low = middle
        else:
            high = middle
    return high


def _reached(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, level: float) -> bool:
    """Whether some singular value takes this level, which is above that of d, at some frequency."""
    r = level**2 * np.eye(d.shape[1]) - d.T @ d
    inside = a + b @ np.linalg.solve(r, d.T @ c)
    outer = c.T @ (np.eye(d.shape[0]) + d @ np.linalg.solve(r, d.T)) @ c
    hamiltonian = np.block([[inside, b @ np.linalg.solve(r, b.T)], [-outer, -inside.T]])
    values = np.linalg.eigvals(hamiltonian)
    return bool((np.abs(values.real) < 1e-9 * max(1.0, np.abs(values).max())).any())


def synthesise(plant: GeneralisedPlant, slack: float = SLACK) -> HinfDesign:
    """The controller of least H-infinity norm, or rather the best conditioned one a little above it.

    Args:
        plant: scaled to figures of order one.
        slack: factor on the least norm, above one.
    """
    import cvxpy as cp

    program = _Program(plant)
    level = cp.Variable(nonneg=True)
    bound = program.solved(cp.Minimize(level), level, 1.0)
    if bound is None:
        return HinfDesign(None, inf, inf, "the solvers found no controller")
    fixed, apart = slack * float(bound), cp.Variable()
    if program.solved(cp.Maximize(apart), cp.Constant(fixed), apart) is None:
        return HinfDesign(None, float(bound), inf, "the solvers found no controller near the least norm")
    law = program.law()
    norm = inf if law is None else hinf_norm(plant.closed(law))
    if law is None or norm > 1.02 * fixed:
        return HinfDesign(None, float(bound), norm, "the controller does not do what the solver promised")
    return HinfDesign(law, float(bound), norm)


class _Program:
    """The matrix inequalities of one plant and their variables."""

    def __init__(self, plant: GeneralisedPlant) -> None:
        import cvxpy as cp

        n, inputs, outputs = len(plant.a), plant.b2.shape[1], plant.c2.shape[0]
        self.plant = plant
        self.x, self.y = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
        self.a, self.b = cp.Variable((n, n)), cp.Variable((n, outputs))
        self.c, self.d = cp.Variable((inputs, n)), cp.Variable((inputs, outputs))

    def solved(self, objective: Any, level: Any, apart: Any) -> float | None:
        """Solve; None where no solver does."""
        import cvxpy as cp

        problem = cp.Problem(objective, self._constraints(level, apart))
        for solver, options in (("CLARABEL", {}), ("SCS", {"max_iters": 20000, "eps": 1e-6})):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of inaccurate answers: the norm is computed anew
                    problem.solve(solver=solver, **options)
            except cp.error.SolverError:
                continue
            if problem.status in ("optimal", "optimal_inaccurate") and np.isfinite(problem.value):
                return float(problem.value)
        return None

    def _constraints(self, level: Any, apart: Any) -> list[Any]:
        import cvxpy as cp

        g, x, y = self.plant, self.x, self.y
        n = len(g.a)
        first = g.a @ x + x @ g.a.T + g.b2 @ self.c + (g.b2 @ self.c).T
        second = self.a + (g.a + g.b2 @ self.d @ g.c2).T
        third = g.a.T @ y + y @ g.a + self.b @ g.c2 + (self.b @ g.c2).T
        w1, w2 = g.b1 + g.b2 @ self.d @ g.d21, y @ g.b1 + self.b @ g.d21
        z1, z2 = g.c1 @ x + g.d12 @ self.c, g.c1 + g.d12 @ self.d @ g.c2
        through = g.d11 + g.d12 @ self.d @ g.d21
        matrix = cp.bmat(
            [
                [first, second.T, w1, z1.T],
                [second, third, w2, z2.T],
                [w1.T, w2.T, -level * np.eye(w1.shape[1]), through.T],
                [z1, z2, through, -level * np.eye(z1.shape[0])],
            ]
        )
        coupled = cp.bmat([[x, apart * np.eye(n)], [apart * np.eye(n), y]])
        return [(matrix + matrix.T) / 2 << 0, (coupled + coupled.T) / 2 >> 0]

    def law(self) -> StateSpace | None:
        """The controller of the present values; None where they are singular."""
        g = self.plant
        x, y, d, b_hat, c_hat, a_hat = (
            np.asarray(one.value) for one in (self.x, self.y, self.d, self.b, self.c, self.a)
        )
        left, values, right = np.linalg.svd(np.eye(len(g.a)) - x @ y)
        if values[-1] <= 1e-12 * values[0]:
            return None
        m, n = left * np.sqrt(values), right.T * np.sqrt(values)
        c = np.linalg.solve(m, (c_hat - d @ g.c2 @ x).T).T
        b = np.linalg.solve(n, b_hat - y @ g.b2 @ d)
        inside = a_hat - n @ b @ g.c2 @ x - y @ g.b2 @ c @ m.T - y @ (g.a + g.b2 @ d @ g.c2) @ x
        a = np.linalg.solve(n, np.linalg.solve(m, inside.T).T)
        return StateSpace(a, b, c, d)
