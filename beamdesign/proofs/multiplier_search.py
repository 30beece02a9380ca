"""Multipliers found by a linear program; what it finds is a guess, which `beamdesign.proofs.multiplier` proves or not.

Over the coefficients of many kernels and Popov's the least of Re[M (1 + L)] / |1 + L| is made as large as it can be, on
a grid of masses and frequencies at once. Rows are added where what was found is worst, so that the program stays small.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np
from flint import fmpq
from scipy.optimize import linprog

from beamdesign.loop import Loop
from beamdesign.polynomial import exact, nearest, roots
from beamdesign.proofs.multiplier import Kernel, Multiplier, fits, is_proper
from beamdesign.proofs.performance import ratio

_RATES = (10, 25, 50, 100, 150, 250, 400, 600, 1000, 1500, 2500, 4000)
_ORDERS = (1, 2, 4, 8)
NORM = 0.998
"""Of the coefficients together, so that they are below one when they are rounded."""
_MASSES, _FREQUENCIES, _FIRST = 9, 700, 60
ENDS_rad_per_s = (0.05, 2e5)
_ROUNDS, _WORST = 12, 40
_LEAST = (2e-2, 2e-3)
"""Terms of less are left out, if what is left fits."""
_DIGITS = (3, 4, 5)
Solved = tuple[np.ndarray, float, float]
"""Coefficients of kernels, Popov's one, and what else a program gives: here the least real part."""


def search(loops: Sequence[Loop], low: fmpq, high: fmpq) -> tuple[Multiplier, fmpq] | None:
    """A multiplier that is proved to fit every loop at every mass (kg) from `low` to `high`, with a margin of its own.

    Those that need no odd characteristic are sought first. None where none is found.
    """
    if not all(is_proper(loop.loop_numerator, loop.loop_denominator, low, high) for loop in loops):
        return None
    grid, families = _over_masses(loops, low, high), [(loop.characteristic, loop.loop_denominator) for loop in loops]
    for odd in (False, True):
        for multiplier, margin in grid.candidates(kernels(_ORDERS), odd):
            if multiplier.admissible and all(fits(multiplier, *one, low, high, margin) for one in families):
                return multiplier, margin
    return None


def kernels(orders: Sequence[int]) -> list[Kernel]:
    """Kernels of some orders at all rates, causal and not."""
    return [Kernel(a, k, side) for a, k, side in product(_RATES, orders, (True, False))]


def _over_masses(loops: Sequence[Loop], low: fmpq, high: fmpq) -> "Grid":
    """Some loops on a grid of masses and frequencies."""
    ends = nearest(low), nearest(high)
    masses = np.linspace(*ends, _MASSES if low < high else 1)
    places = [
        abs(pole.imag) for loop in loops for mass in masses for pole in roots(loop.characteristic.at(exact(mass)))
    ]
    near = np.unique(np.round([p * f for p in places if p > 0 for f in (0.9, 1.0, 1.1)], 2))
    w = np.unique(np.concatenate([np.geomspace(*ENDS_rad_per_s, _FREQUENCIES), near]))
    return Grid(w, np.concatenate([1 + ratio(loop.loop_numerator, loop.loop_denominator, masses, w) for loop in loops]))


class Grid:
    """1 + L of some loops on a grid of frequencies, and the linear programs over it."""

    def __init__(self, w: np.ndarray, closed: np.ndarray, popov: bool = True) -> None:
        """Take 1 + L (loops, frequencies) at frequencies (rad/s); `popov` says whether there may be Popov's term."""
        self.w, self.popov = w, popov
        self.turned = closed / abs(closed)
        """(1 + L) / |1 + L|, (loops, frequencies)."""

    def _solve(
        self, columns: np.ndarray, popov: np.ndarray, rows: np.ndarray, cols: np.ndarray, odd: bool
    ) -> Solved | None:
        """Coefficients, Popov's one and the least real part on some points of the grid."""
        one = self.turned[rows, cols]
        table = -(columns[:, cols] * one).real.T  # (points, kernels)
        slow = (popov[cols] * one).real
        n = len(columns)
        scale = max(1.0, abs(slow).max())
        whole = [-table, *([table] if odd else []), -slow[:, None] / scale, np.ones((len(one), 1))]
        a = np.vstack([np.hstack(whole), [*([1.0] * (n * (1 + odd))), 0.0, 0.0]])
        b = np.append(one.real, NORM)
        cost = np.zeros(a.shape[1])
        cost[-1] = -1.0
        bounds = [(0.0, None)] * (a.shape[1] - 1) + [(None, 2.0)]
        found = linprog(cost, A_ub=a, b_ub=b, bounds=bounds, method="highs")
        if found.x is None:
            return None
        x = found.x
        weights = x[:n] - (x[n : 2 * n] if odd else 0.0)
        return weights, x[-2] / scale, x[-1]

    def _best(self, allowed: Sequence[Kernel], odd: bool) -> Solved | None:
        """Coefficients, Popov's one and the least real part on the whole grid."""
        columns = np.array([kernel.response(self.w) for kernel in allowed])
        popov = 1j * self.w * self.popov
        shape = self.turned.shape
        first = np.linspace(0, shape[1] - 1, _FIRST).astype(int)
        chosen = {(r, c) for r in {0, shape[0] // 2, shape[0] - 1} for c in first}
        best: Solved | None = None
        for _ in range(_ROUNDS):
            rows, cols = (np.array(values) for values in zip(*sorted(chosen), strict=True))
            found = self._solve(columns, popov, rows, cols, odd)
            if found is None or found[2] <= 0:
                return best
            weights, slow, promised = found
            multiplied = 1 - weights @ columns + slow * popov
            value = (multiplied * self.turned).real
            least = float(value.min())
            if best is None or least > best[2]:
                best = weights, slow, least
            if least > 0.9 * promised:
                break
            worst = [np.unravel_index(k, shape) for k in np.argpartition(value.ravel(), _WORST)[:_WORST]]
            lows = [(r, int(value[r].argmin())) for r in range(shape[0])]
            chosen |= {(int(r), int(c)) for r, c in worst} | set(lows)
        return best

    def candidates(self, allowed: Sequence[Kernel], odd: bool) -> Iterator[tuple[Multiplier, fmpq]]:
        """Multipliers of few terms and digits with the margins that they seem to have, the plainest first."""

        def solved(kept: Sequence[Kernel]) -> Solved | None:
            found = self._best(kept, odd)
            return found if found is not None and found[2] > 0 else None

        ways = list(with_fewer(allowed, solved))
        for (kept, (weights, slow, least)), digits in product(ways, _DIGITS):
            multiplier, (_, (_, _, of_all)) = written(kept, weights, slow, digits), ways[-1]
            value = (multiplier.response(self.w) * self.turned).real.min()
            if least > of_all / 3 and value > least / 3:
                yield multiplier, exact(float(f"{0.1 * value:.1g}"))


def with_fewer(
    allowed: Sequence[Kernel], solved: Callable[[Sequence[Kernel]], Solved | None]
) -> Iterator[tuple[Sequence[Kernel], Solved]]:
    """What a program says of the few kernels that count most in its answer for all, and at last that; none for none."""
    if (found := solved(allowed)) is not None:
        for threshold in _LEAST:
            few = [kernel for kernel, weight in zip(allowed, found[0], strict=True) if abs(weight) > threshold]
            if (again := solved(few)) is not None:
                yield few, again
        yield allowed, found


def written(kept: Sequence[Kernel], weights: np.ndarray, slow: float, digits: int) -> Multiplier:
    """A multiplier of so many digits, its coefficients rounded towards zero, so that the norm does not grow."""
    step = 10**digits
    terms = ((fmpq(int(weight * step), step), kernel) for weight, kernel in zip(weights, kept, strict=True))
    return Multiplier(tuple(term for term in terms if term[0] != 0), exact(float(f"{slow:.{digits}g}")))
