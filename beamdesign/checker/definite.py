"""Definiteness of symmetric rational matrices, and of matrix polynomials in the mass on an interval.

By another method than the prover's, which takes minors and Bernstein coefficients of matrices: the pivots of L D L' at
one end, and no root of the determinant up to the other, on the way to which an eigenvalue would have to pass zero.
"""

from collections.abc import Callable

from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.checker.roots import ONE, ZERO, S, pieces


def positive(matrix: fmpq_mat) -> bool:
    """Whether a symmetric matrix is positive definite: all pivots of its elimination are positive."""
    rows = matrix.tolist()
    n = len(rows)
    for k in range(n):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            share = rows[i][k] / rows[k][k]
            for j in range(k + 1, i + 1):  # the lower triangle is enough
                rows[i][j] -= share * rows[j][k]
    return True


def positive_between(value: Callable[[fmpq], fmpq_mat], degree: int, low: fmpq, high: fmpq) -> bool:
    """Whether a symmetric matrix polynomial of at most some degree in the mass is positive definite on [low, high]."""
    if not positive(value(low)):
        return False
    count = degree * value(low).nrows() + 1
    determinant, basis = ZERO, ONE
    for point in (low + (high - low) * fmpq(k, count) for k in range(count)):
        determinant += basis * ((value(point).det() - determinant(point)) / basis(point))
        basis *= S - point
    return bool(determinant(high) != 0) and _without_root(determinant, low, high)


def _without_root(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> bool:
    return pieces([polynomial], low, high)[1] == 0
