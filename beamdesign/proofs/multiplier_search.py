"""Multipliers found by linear programs; what they find is a guess, which is then proved or not.

Where Re[M (1 + L)] is to be positive alone, the least of it over |1 + L| is made as large as it can be, over the
coefficients of many kernels and Popov's, on a grid of masses and frequencies at once. Where a gain changes as well, it
is the least eigenvalue of the matrix in `beamdesign.proofs.changing_gain`, which is linear in these coefficients and in
the weight: that it is positive along a vector (1, z) is one row, and without such a gain z is zero. Rows are added
where what was found is worst, and along the vectors for which it is, so that the program stays small.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, product
from typing import NamedTuple

import numpy as np
from flint import fmpq
from scipy.optimize import linprog

from beamdesign.polynomial import exact, nearest
from beamdesign.proofs.multiplier import Kernel, Multiplier

_RATES = (10, 25, 50, 100, 150, 250, 400, 600, 1000, 1500, 2500, 4000)
_ORDERS = (1, 2, 4, 8)
_NORM = 0.998
"""Of the coefficients together, so that they are below one when they are rounded."""
ENDS_rad_per_s = (0.05, 2e5)
_FIRST, _ALONG = (3, 60), (0, 1, -1, 1j, -1j, 3, -3)
"""Masses and frequencies that a program begins with, and z there."""
_ROUNDS, _WORST = 20, 6
_NONE, _ENOUGH = 1e-7, 0.9
"""What is no more than nothing, and what part of what a program promises is enough."""
_SLOW = 1e-3
"""s, in which Popov's coefficient is sought."""
_LEAST = (2e-2, 2e-3)
"""Terms of less are left out, if what is left fits."""
_DIGITS = (3, 4, 5)
_WEIGHT = 2.0
"""Where no gain changes: more than what is made large, so that it does not count."""


class Solved(NamedTuple):
    """What a program gives: coefficients of kernels, Popov's one (s), the weight, and the least that they make."""

    coefficients: np.ndarray
    popov_s: float
    weight: float
    least: float


def kernels(orders: Sequence[int] = _ORDERS) -> list[Kernel]:
    """Kernels of some orders at all rates, causal and not."""
    return [Kernel(a, k, side) for a, k, side in product(_RATES, orders, (True, False))]


@dataclass(frozen=True)
class Grid:
    """1 + L of some loops on a grid of frequencies, what changes beside it, and the linear programs over it.

    Attributes:
        w: (F,) frequencies, rad/s.
        closed: (N, F) 1 + L of loops.
        popov: whether there may be Popov's term.
        changing: (N, F) each, what a gain that changes acts through, (1 - a) F and H; None where none does.
    """

    w: np.ndarray
    closed: np.ndarray
    popov: bool = True
    changing: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def _through(self) -> tuple[np.ndarray, np.ndarray]:
        return self.changing or (0 * self.closed, 0 * self.closed)

    def least(self, multiplier: np.ndarray, weight: float = _WEIGHT) -> tuple[np.ndarray, np.ndarray]:
        """(N, F) least eigenvalues of the matrix with a multiplier (F,) and a weight, and z of their vectors."""
        (onto, by), size = self._through, abs(self.closed)
        first, cross = (multiplier * self.closed).real / size, (multiplier * onto - weight * np.conj(by)) / 2
        cross /= np.sqrt(size)
        least = (first + weight) / 2 - np.sqrt((first - weight) ** 2 / 4 + abs(cross) ** 2)
        along = np.divide(least - first, cross, out=np.zeros_like(cross), where=cross != 0)
        return least, along * np.sqrt(size)

    def solved(self, allowed: Sequence[Kernel], odd: bool = False) -> Solved | None:
        """What a program says of some kernels; None where nothing that it finds fits the whole grid."""
        responses = np.array([kernel.response(self.w) for kernel in allowed]).reshape(len(allowed), len(self.w))
        signs, slow = (-1, 1)[: 1 + odd], 1j * self.w * _SLOW
        basis = np.vstack([np.ones(len(self.w)), *(sign * responses for sign in signs), slow])
        n, shape, (onto, by) = len(signs) * len(allowed), self.closed.shape, self._through

        def rows(row: np.ndarray, col: np.ndarray, z: np.ndarray) -> np.ndarray:
            first = basis[:, col] * (self.closed[row, col] + z * onto[row, col])
            second = abs(z) ** 2 - (z * np.conj(by[row, col])).real
            norm = abs(self.closed[row, col]) + abs(z) ** 2
            return np.vstack([-first.real / norm, -second / norm, np.ones(len(norm))]).T

        begun = (np.unique(np.linspace(0, most - 1, few).astype(int)) for most, few in zip(shape, _FIRST, strict=True))
        table = [rows(*(part.ravel() for part in np.meshgrid(*begun, _ALONG if self.changing else _ALONG[:1])))]
        norm, cost = np.array([0.0, *[1.0] * n, 0.0, 0.0, 0.0]), np.array([*[0.0] * (n + 3), -1.0])
        limits = [
            (1.0, 1.0), *[(0.0, None)] * n, (0.0, None if self.popov else 0.0),
            (0.0, 1e6) if self.changing else (_WEIGHT, _WEIGHT), (None, _WEIGHT),
        ]  # fmt: skip
        best: Solved | None = None
        for _ in range(_ROUNDS):
            a = np.vstack([*table, norm])
            x = linprog(cost, A_ub=a, b_ub=[*[0.0] * (len(a) - 1), _NORM], bounds=limits, method="highs").x
            if x is None or x[-1] <= _NONE:
                break
            least, along = self.least(x[: n + 2] @ basis, x[n + 2])
            if best is None or least.min() > best.least:
                coefficients = -np.array(signs) @ x[1 : n + 1].reshape(len(signs), -1)
                best = Solved(coefficients, x[n + 1] * _SLOW, x[n + 2], float(least.min()))
            if least.min() > _ENOUGH * x[-1]:
                break
            col = np.argpartition(least, _WORST)[:, :_WORST].ravel()
            row = np.arange(shape[0]).repeat(_WORST)
            table.append(rows(row, col, along[row, col]))
        return best if best is not None and best.least > 0 else None

    def candidates(self, allowed: Sequence[Kernel], odd: bool = False) -> Iterator[tuple[Multiplier, fmpq, float]]:
        """Multipliers of few terms and digits, weights, and the least that they make of the grid, the plainest first.

        First those of the few kernels that count most in what is found with all.
        """
        if (whole := self.solved(allowed, odd)) is None:
            return
        sizes = list(zip(allowed, abs(whole.coefficients), strict=True))
        few = ([kernel for kernel, size in sizes if size > least] for least in _LEAST)
        for kept, found in chain(((some, self.solved(some, odd)) for some in few), [(allowed, whole)]):
            if found is None or found.least < whole.least / 3:
                continue
            for digits in _DIGITS:
                multiplier, weight = written(kept, found, digits)
                least = float(self.least(multiplier.response(self.w), nearest(weight))[0].min())
                if least > found.least / 3:
                    yield multiplier, weight, least


def written(kept: Sequence[Kernel], found: Solved, digits: int) -> tuple[Multiplier, fmpq]:
    """Multiplier and weight of so many digits, coefficients rounded towards zero, so that the norm does not grow."""
    step = 10**digits
    terms = ((fmpq(int(size * step), step), kernel) for size, kernel in zip(found.coefficients, kept, strict=True))
    popov_s, weight = (exact(float(f"{size:.{digits}g}")) for size in (found.popov_s, found.weight))
    return Multiplier(tuple(term for term in terms if term[0] != 0), popov_s), weight
