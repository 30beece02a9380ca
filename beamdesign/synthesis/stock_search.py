"""The lightest pair of stock tubes that passes every check: checks take arrays, so that every pair is looked at."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamdesign.problem import DesignProblem
from beamdesign.structure.section import Tube, as_arrays, clearances, stock_tubes
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


Stock = tuple[Sequence[Tube], Sequence[Tube]]
"""What there is to choose the outer and the inner tube from."""


def stock_of(problem: DesignProblem) -> Stock:
    """Stock tubes of the shapes of both beams."""
    outer, inner = (stock_tubes(one.shape, one.depth_over_width) for one in problem.beams)
    return outer, inner


def _all_pairs(stock: Stock) -> tuple[Tube, Tube, np.ndarray]:
    """Outer tubes by row and inner ones by column, and whether the inner enters the outer."""
    outer, inner = as_arrays(stock[0], (-1, 1)), as_arrays(stock[1], (1, -1))
    return outer, inner, np.logical_and.reduce([gap > 0 for gap in clearances(outer, inner)])


def feasible_pairs(problem: DesignProblem, stock: Stock, asked: Requirements | None = None) -> np.ndarray:
    """Which pairs pass every check.

    Args:
        problem: what is asked.
        stock: the tubes, n outer and m inner ones.
        asked: other figures than the problem's.

    Returns:
        Boolean array (n, m): row by outer tube, column by inner tube.
    """
    outer, inner, fits = _all_pairs(stock)
    found = checks(problem, outer, inner, asked)
    return np.logical_and.reduce(np.broadcast_arrays(fits, *(check.satisfied for check in found)))


def lightest(problem: DesignProblem, stock: Stock, feasible: np.ndarray) -> tuple[Tube, Tube]:
    """The lightest of the pairs marked in `feasible`, (n, m), of which there must be one."""
    outer, inner, _ = _all_pairs(stock)
    mass = beam_mass(problem, outer, inner)
    row, column = np.unravel_index(np.argmin(np.where(feasible, mass, np.inf)), mass.shape)
    return stock[0][int(row)], stock[1][int(column)]


def nearest_pair(problem: DesignProblem, stock: Stock) -> CheckedPair:
    """The pair whose worst miss, relative to its limit, is least, of those where the inner tube enters the outer one.

    Args:
        problem: what is asked.
        stock: the tubes.
    """
    outer, inner, fits = _all_pairs(stock)
    misses = [-check.slack / np.maximum(np.abs(check.limit), 1e-3) for check in checks(problem, outer, inner)]
    worst = np.where(fits, np.maximum.reduce(np.broadcast_arrays(*misses)), np.inf)
    row, column = np.unravel_index(np.argmin(worst), worst.shape)
    return check_sections(problem, stock[0][int(row)], stock[1][int(column)])


def stock_optimum(problem: DesignProblem, stock: Stock | None = None) -> StockOptimum | None:
    """Find the lightest pair of stock tubes that passes every check.

    Args:
        problem: what is asked.
        stock: tubes to choose from; by default the built-in lists of their shapes.

    Returns:
        The optimum, or None where no pair passes.
    """
    stock = stock_of(problem) if stock is None else stock
    if not all(stock):
        return None
    feasible = feasible_pairs(problem, stock)
    if not feasible.any():
        return None
    return StockOptimum(
        pair=check_sections(problem, *lightest(problem, stock, feasible)),
        pairs=feasible.size,
        pairs_feasible=int(feasible.sum()),
    )
