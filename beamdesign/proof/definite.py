"""Definiteness of symmetric rational matrices, and of matrix polynomials on an interval, decided exactly."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

from flint import fmpq, fmpq_mat, fmpz

DEEPEST = 10
"""Halvings of an interval after which `positive_on` gives up."""


@dataclass(frozen=True)
class Definite:
    """Whether a definiteness holds, exactly, and the reason where it does not.

    Attributes:
        holds: proved in rationals.
        reason: empty where it holds.
        pieces: number of sub-intervals the proof needed, 1 for a single matrix.
    """

    holds: bool
    reason: str = ""
    pieces: int = 1


def positive_definite(matrix: fmpq_mat) -> Definite:
    """Sylvester's criterion by fraction-free elimination (Bareiss): all leading principal minors are positive.

    A semidefinite matrix is not positive definite: its first vanishing minor is named.

    Args:
        matrix: square, rational.
    """
    if matrix != matrix.transpose():
        return Definite(False, "the matrix is not symmetric")
    rows: list[list[Any]] = matrix.numer_denom()[0].tolist()  # over one positive denominator: signs stay
    before = fmpz(1)
    for k, pivot_row in enumerate(rows):
        pivot = pivot_row[k]  # the leading principal minor of order k + 1
        if pivot <= 0:
            return Definite(False, f"leading minor {k + 1} of {len(rows)} is {'zero' if pivot == 0 else 'negative'}")
        for row in rows[k + 1 :]:
            head = row[k]
            for j in range(k + 1, len(rows)):
                row[j] = (pivot * row[j] - head * pivot_row[j]) // before  # exact division
        before = pivot
    return Definite(True)


def bernstein(coefficients: Sequence[Any], low: Any, high: Any) -> list[Any]:
    """Bernstein coefficients on [low, high] of sum over k of coefficients[k] m^k.

    On the interval the polynomial is a convex combination of them; the first and the last are its values at the ends.
    Works alike on numbers, arrays and rational matrices; `low` and `high` are rationals or floats to match.
    """
    degree, length = len(coefficients) - 1, high - low
    one = length / length
    shifted = []
    for j in range(degree + 1):
        total = coefficients[j] * length**j
        for k in range(j + 1, degree + 1):
            total = total + coefficients[k] * (comb(k, j) * low ** (k - j) * length**j)
        shifted.append(total)
    result = []
    for i in range(degree + 1):
        total = shifted[0]
        for j in range(1, i + 1):
            total = total + shifted[j] * (one * comb(i, j) / comb(degree, j))
        result.append(total)
    return result


def positive_on(coefficients: Sequence[fmpq_mat], low: fmpq, high: fmpq, deepest: int = DEEPEST) -> Definite:
    """Whether sum over k of coefficients[k] m^k is positive definite for every m in [low, high].

    Positive definite Bernstein coefficients prove it; where they are not, the interval is halved. An end of a piece
    at which the matrix itself is not positive definite refutes it.

    Args:
        coefficients: symmetric matrices, ascending in m.
        low: least m.
        high: most m, above `low`.
        deepest: number of halvings after which the answer is no, for lack of a proof.
    """
    values = bernstein(coefficients, low, high)
    for value, place in ((values[0], low), (values[-1], high)):
        end = positive_definite(value)
        if not end.holds:
            return Definite(False, f"at {float(place):.6g}: {end.reason}")
    if all(positive_definite(value).holds for value in values[1:-1]):
        return Definite(True)
    if deepest == 0:
        return Definite(False, f"no proof between {float(low):.6g} and {float(high):.6g} after all halvings")
    middle = (low + high) / 2
    left = positive_on(coefficients, low, middle, deepest - 1)
    if not left.holds:
        return left
    right = positive_on(coefficients, middle, high, deepest - 1)
    return Definite(True, pieces=left.pieces + right.pieces) if right.holds else right
