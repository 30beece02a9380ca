"""Fewer states for a stable controller: balanced residualisation, exact at zero frequency.

The error is at most twice the sum of the Hankel singular values left out (K. Glover, International Journal of Control
39, 1984; Y. Liu and B. D. O. Anderson, International Journal of Control 50, 1989, for the residualised model).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_continuous_lyapunov, svd

from beamdesign.design.state_space import StateSpace


@dataclass(frozen=True)
class Reduced:
    """A model of fewer states.

    Attributes:
        model: it.
        hankel: (n,) Hankel singular values of the whole, the largest first.
        bound: most that the largest singular value of the difference is at any frequency.
    """

    model: StateSpace
    hankel: np.ndarray
    bound: float


def residualised(whole: StateSpace, order: int) -> Reduced:
    """The balanced residualisation of a stable model.

    Args:
        whole: stable and minimal.
        order: states to keep; the whole comes back balanced where it has no more.

    Raises:
        ValueError: for a model that is not stable.
        numpy.linalg.LinAlgError: where it is too far from minimal for the figures of a float.
    """
    if not whole.stable:
        raise ValueError("only a stable controller is reduced")
    controllable = _root(solve_continuous_lyapunov(whole.a, -whole.b @ whole.b.T))
    observable = _root(solve_continuous_lyapunov(whole.a.T, -whole.c.T @ whole.c))
    left, hankel, right = svd(observable.T @ controllable)
    if hankel[0] <= 0:
        raise np.linalg.LinAlgError("the controller does nothing")
    kept = hankel > 1e-13 * hankel[0]
    root = np.sqrt(hankel[kept])
    into = controllable @ right.T[:, kept] / root
    back = (observable @ left[:, kept] / root).T
    a, b, c = back @ whole.a @ into, back @ whole.b, whole.c @ into
    n = min(order, len(a))
    fast = np.linalg.solve(a[n:, n:], np.hstack([a[n:, :n], b[n:]])) if n < len(a) else np.zeros((0, n + b.shape[1]))
    model = StateSpace(
        a[:n, :n] - a[:n, n:] @ fast[:, :n],
        b[:n] - a[:n, n:] @ fast[:, n:],
        c[:, :n] - c[:, n:] @ fast[:, :n],
        whole.d - c[:, n:] @ fast[:, n:],
    )
    return Reduced(model, hankel, 2 * float(hankel[n:].sum()))


def _root(gramian: np.ndarray) -> np.ndarray:
    """Root r with r r' the Gramian, lifted by the rounding errors of a float where it is not definite."""
    symmetric = (gramian + gramian.T) / 2
    try:
        return np.asarray(cholesky(symmetric, lower=True))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(symmetric)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
