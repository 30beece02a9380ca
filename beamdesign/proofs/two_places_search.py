"""Multipliers for a characteristic in the current and a gain that changes elsewhere, found by linear programs.

The matrix of `beamdesign.proofs.two_places` is linear in the coefficients of the multiplier and in the weight. That it
is positive along a vector (1, z) is one row; rows are added for the vectors along which what was found is worst.
"""

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from flint import fmpq
from scipy.optimize import linprog

from beamdesign.polynomial import exact
from beamdesign.proofs.multiplier import Kernel, Multiplier
from beamdesign.rational import nearest

if TYPE_CHECKING:
    from beamdesign.proofs.two_places import Pair

_KERNELS = [
    Kernel(a, k, side)
    for a, k, side in product(
        (10, 25, 50, 100, 150, 250, 400, 600, 1000, 1500, 2500, 4000), (1, 2, 4, 8), (True, False)
    )
]
_NORM = 0.998
_W = np.geomspace(0.05, 2e5, 500)
_MASSES, _ROUNDS, _WORST = 7, 30, 6
_FIRST = (0, 1, -1, 1j, -1j, 3, -3)
_LEAST = (2e-2, 2e-3)
"""Terms of less are left out, if what is left fits."""
_SLOW = 1e-3
"""s, in which Popov's coefficient is sought."""
_MARGINS = (fmpq(1, 100), fmpq(1, 1000), fmpq(1, 10000), fmpq(1, 100000))


def search(pairs: "Sequence[Pair]", low: fmpq, high: fmpq) -> tuple[Multiplier, fmpq, fmpq] | None:
    """A multiplier, a weight and a margin proved to fit every loop at every mass (kg); None where none is found."""
    masses = np.linspace(nearest(low), nearest(high), _MASSES if low < high else 1)
    parts = [np.concatenate(arrays) for arrays in zip(*(one.responses(masses, _W) for one in pairs), strict=True)]
    scale = float(abs(parts[1]).max())
    if not scale > 0:
        return None
    closed, onto, by = parts[0], parts[1] / scale, parts[2] * scale
    popov = all(pair.falls for pair in pairs)
    found = _solved(_KERNELS, closed, onto, by, popov)
    if found is None:
        return None
    ways = [(_KERNELS, found)]
    for threshold in _LEAST:
        few = [kernel for kernel, value in zip(_KERNELS, found[0], strict=True) if value > threshold]
        if (again := _solved(few, closed, onto, by, popov)) is not None:
            ways.insert(len(ways) - 1, (few, again))
    for (kernels, (weights, slow, weight)), digits in product(ways, (3, 5)):
        terms = tuple(
            (fmpq(int(value * 10**digits), 10**digits), kernel)
            for kernel, value in zip(kernels, weights, strict=True)
            if int(value * 10**digits)
        )
        multiplier = Multiplier(terms, exact(float(f"{slow:.{digits}g}")))
        rounded = exact(float(f"{weight * scale**2:.{digits}g}"))
        for margin in _MARGINS:
            if all(pair.fits(multiplier, rounded, low, high, margin) for pair in pairs):
                return multiplier, rounded, margin
    return None


def _solved(
    kernels: Sequence[Kernel], closed: np.ndarray, onto: np.ndarray, by: np.ndarray, popov: bool
) -> tuple[np.ndarray, float, float] | None:
    """Coefficients of the kernels, Popov's and the weight; None where there are none on the grid."""
    n = len(kernels)
    basis = np.array([np.ones(len(_W)), *(-kernel.response(_W) for kernel in kernels), 1j * _W * _SLOW])
    size = abs(closed)
    table: list[np.ndarray] = []

    def add(row: int, col: int, z: complex) -> None:
        one = basis[:, col]
        first = (one * (closed[row, col] + z * onto[row, col])).real
        second = abs(z) ** 2 - (z * np.conj(by[row, col])).real
        norm = size[row, col] + abs(z) ** 2
        table.append(np.array([*(-first), -second, norm]) / norm)

    for row, col, z in product(range(len(closed)), range(0, len(_W), 12), _FIRST):
        add(row, col, z)
    bounds: list[tuple[float, float | None]] = [(1.0, 1.0), *[(0.0, None)] * n, (0.0, None if popov else 0.0)]
    limits = [*bounds, (0.0, 1e6), (-1.0, 1.0)]
    norm = np.array([0.0, *[1.0] * n, 0.0, 0.0, 0.0])
    cost = np.array([*[0.0] * (n + 3), -1.0])
    for _ in range(_ROUNDS):
        right = [*[0.0] * len(table), _NORM]
        found = linprog(cost, A_ub=np.vstack([*table, norm]), b_ub=right, bounds=limits, method="highs")
        if found.x is None or found.x[-1] <= 1e-7:
            return None
        values, weight, promised = found.x[: n + 2], found.x[n + 2], found.x[-1]
        multiplier = values @ basis
        first = (multiplier * closed).real / size
        cross = (multiplier * onto - weight * np.conj(by)) / 2 / np.sqrt(size)
        least = (first + weight) / 2 - np.sqrt((first - weight) ** 2 / 4 + abs(cross) ** 2)
        if least.min() > promised / 3:
            return values[1 : n + 1], float(values[n + 1]) * _SLOW, float(weight)
        for row in range(len(closed)):
            for col in np.argsort(least[row])[:_WORST]:
                # the eigenvector of the least eigenvalue
                z = (least[row, col] - first[row, col]) / cross[row, col] if cross[row, col] else 0.0
                add(row, int(col), complex(z) * np.sqrt(size[row, col]))
    return None
