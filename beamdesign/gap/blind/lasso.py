"""The lasso by coordinate descent on a Gram matrix."""

from collections.abc import Iterator

import numpy as np

_SHRINK = 0.8  # from one penalty to the next
_LEAST = 1e-3  # of the largest that leaves anything
_SWEEPS = 500
_SETTLED = 1e-9


def lasso(gram: np.ndarray, slope: np.ndarray, penalty: float, start: np.ndarray | None = None) -> np.ndarray:
    """Minimise w'Gw/2 - b'w + penalty |w|_1.

    Coordinate descent with soft thresholds (J. Friedman, T. Hastie, R. Tibshirani, Regularization paths for generalized
    linear models via coordinate descent, J. Stat. Software 33, 2010).

    Args:
        gram: (K, K) G, positive semidefinite with a positive diagonal.
        slope: (K,) b.
        penalty: not negative.
        start: (K,) where to begin.
    """
    w = np.zeros(len(slope)) if start is None else start.copy()
    left = slope - gram @ w
    for _ in range(_SWEEPS):
        most = 0.0
        for k in range(len(w)):
            raw = left[k] + gram[k, k] * w[k]
            new = np.sign(raw) * max(abs(raw) - penalty, 0.0) / gram[k, k]
            move = new - w[k]
            if move:
                left -= gram[:, k] * move
                w[k] = new
                most = max(most, abs(move))
        if most <= _SETTLED * max(1.0, float(np.abs(w).max(initial=0.0))):
            break
    return w


def lasso_path(gram: np.ndarray, slope: np.ndarray) -> Iterator[list[int]]:
    """Sets of terms that come in as the penalty falls, each once."""
    if not len(slope) or not (largest := float(np.abs(slope).max())):
        return
    w = np.zeros(len(slope))
    penalty = largest
    before: list[int] = []
    while penalty > _LEAST * largest:
        penalty *= _SHRINK
        w = lasso(gram, slope, penalty, w)
        active = [int(k) for k in np.nonzero(w)[0]]
        if active and active != before:
            before = active
            yield active
