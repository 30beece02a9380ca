"""Largest values of a discrete linear system: sums of absolute impulse responses, with what is left out bounded."""

import numpy as np

_BLOCK = 128
_RELATIVE = 1e-6
_MOST_STEPS = 4_000_000


def l1_norms(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Largest |y_i| per largest |u_j| of x+ = A x + B u, y = C x + D u from rest.

    Args:
        a: (n, n) with all eigenvalues within the unit circle.
        b: (n, m).
        c: (p, n).
        d: (p, m).

    Returns:
        (p, m); what the sums leave out is bounded by the modes' geometric series and added, so that they are upper
        bounds up to rounding in double precision.

    Raises:
        ValueError: for a system that does not decay within `_MOST_STEPS` steps.
    """
    total = np.abs(d)
    if not len(a):
        return total
    rows = [c]
    for _ in range(_BLOCK - 1):
        rows.append(rows[-1] @ a)
    stacked, jump = np.vstack(rows), np.linalg.matrix_power(a, _BLOCK)
    values, vectors = np.linalg.eig(a)
    radii = np.abs(values)
    if radii.max() >= 1:
        raise ValueError(f"a characteristic value of modulus {radii.max():.6g}")
    ahead = np.abs(c @ vectors) / (1 - radii)
    state, inverse = b.astype(float), np.linalg.inv(vectors)
    for _ in range(_MOST_STEPS // _BLOCK):
        total = total + np.abs(stacked @ state).reshape(_BLOCK, *d.shape).sum(axis=0)
        state = jump @ state
        rest = ahead @ np.abs(inverse @ state)
        if np.all(rest <= _RELATIVE * total + 1e-300):
            return np.asarray(total + rest)
    raise ValueError(f"no decay within {_MOST_STEPS} steps")


def l2_norms(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(p, m) root of the sum of squares of every impulse response; arguments as of `l1_norms`.

    It is the spread of y under white u of unit spread, and the largest |y| under u of unit energy.
    """
    from scipy.linalg import solve_discrete_lyapunov

    found = np.zeros(d.shape)
    for j in range(b.shape[1]):
        gramian = solve_discrete_lyapunov(a, np.outer(b[:, j], b[:, j]))
        found[:, j] = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", c, gramian, c), 0) + d[:, j] ** 2)
    return found
