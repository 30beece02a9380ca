"""The lightest pair of stock tubes that passes every check: checks take arrays, so that every pair is looked at."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamdesign.problem import DesignProblem
from beamdesign.structure.section import SquareTube
from beamdesign.structure.stock import stock_tubes
from beamdesign.synthesis.checks import CheckedPair, Requirements, beam_mass, check_sections, checks


@dataclass(frozen=True)
class StockOptimum:
    """The lightest pair of stock tubes; no pair was left out, so this is the global optimum over the list.

    Attributes:
        pair: the tubes, their mass and its checks.
        pairs: how many pairs there are.
        pairs_feasible: how many of them pass every check.
    """

    pair: CheckedPair
    pairs: int
    pairs_feasible: int


_Sizes = tuple[np.ndarray, np.ndarray]


def _all_pairs(stock: Sequence[SquareTube]) -> tuple[_Sizes, _Sizes, np.ndarray]:
    """Width and wall of outer tubes by row and of inner ones by column, and whether the inner enters the outer."""
    width, wall = np.array(stock).T
    outer, inner = (width[:, None], wall[:, None]), (width[None, :], wall[None, :])
    return outer, inner, inner[0] < outer[0] - 2 * outer[1]


def feasible_pairs(
    problem: DesignProblem, stock: Sequence[SquareTube], asked: Requirements | None = None
) -> np.ndarray:
    """Which pairs pass every check.

    Args:
        problem: what is asked.
        stock: the tubes, n of them.
        asked: other figures than the problem's.

    Returns:
        Boolean array (n, n): row by outer tube, column by inner tube.
    """
    outer, inner, fits = _all_pairs(stock)
    found = checks(problem, *outer, *inner, asked=asked)
    return np.logical_and.reduce(np.broadcast_arrays(fits, *(check.satisfied for check in found)))


def lightest(
    problem: DesignProblem, stock: Sequence[SquareTube], feasible: np.ndarray
) -> tuple[SquareTube, SquareTube]:
    """The lightest of the pairs marked in `feasible`, (n, n), of which there must be one."""
    outer, inner, _ = _all_pairs(stock)
    mass = beam_mass(problem, *outer, *inner)
    row, column = np.unravel_index(np.argmin(np.where(feasible, mass, np.inf)), mass.shape)
    return stock[int(row)], stock[int(column)]


def nearest_pair(problem: DesignProblem, stock: Sequence[SquareTube]) -> CheckedPair:
    """The pair whose worst miss, relative to its limit, is least, of those where the inner tube enters the outer one.

    Args:
        problem: what is asked.
        stock: the tubes.
    """
    outer, inner, fits = _all_pairs(stock)
    misses = [-check.slack / np.maximum(np.abs(check.limit), 1e-3) for check in checks(problem, *outer, *inner)]
    worst = np.where(fits, np.maximum.reduce(np.broadcast_arrays(*misses)), np.inf)
    row, column = np.unravel_index(np.argmin(worst), worst.shape)
    return check_sections(problem, stock[int(row)], stock[int(column)])


def stock_optimum(problem: DesignProblem, stock: Sequence[SquareTube] | None = None) -> StockOptimum | None:
    """Find the lightest pair of stock tubes that passes every check.

    Args:
        problem: what is asked.
        stock: tubes to choose from; by default the built-in list.

    Returns:
        The optimum, or None where no pair passes.
    """
    stock = stock_tubes() if stock is None else stock
    feasible = feasible_pairs(problem, stock)
    if not feasible.any():
        return None
    return StockOptimum(
        pair=check_sections(problem, *lightest(problem, stock, feasible)),
        pairs=feasible.size,
        pairs_feasible=int(feasible.sum()),
    )
