"""Where no pair of tubes fits, which requirement to relax: each alone, as little as possible."""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.problem import DesignProblem
from beamdesign.structure.section import Tube
from beamdesign.synthesis.checks import REQUIREMENTS, CheckedPair, Requirements, check_sections, requirements
from beamdesign.synthesis.free_search import (
    FEASIBLE,
    SIZE_UNITS,
    Conditions,
    Elastic,
    sizing_program,
    solve,
    solver,
    start_points,
    start_variables,
    tubes,
)
from beamdesign.synthesis.stock_search import Stock, feasible_pairs, lightest, nearest_pair

_DIGITS, _MEANT = 4, 12


@dataclass(frozen=True)
class Relaxation:
    """A change of one requirement that is enough, all others staying as they are.

    Attributes:
        key: where the requirement stands in a study file.
        asked: its figure there.
        enough: a figure with which tubes were found, rounded to the easier side.
        outer: outer tube that does then.
        inner: inner tube that does then.
    """

    key: str
    asked: float
    enough: float
    outer: Tube
    inner: Tube

    def __str__(self) -> str:
        """In words, as in "load.tip_force_N from 2000 to 1500"."""
        return f"{self.key} from {self.asked:g} to {self.enough:g}"

    @property
    def share(self) -> float:
        """Size of the change relative to what was asked."""
        return abs(self.enough - self.asked) / self.asked


def _eased(asked: Requirements, name: str, share: Any) -> Any:
    """The figure of a requirement at a share, 0 to 1, of the way to its easiest; of a symbol in symbols."""
    figure = float(getattr(asked, name))
    return figure + share * (REQUIREMENTS[name].easiest - figure)


def _rounded(figure: float, easiest: float) -> float:
    """Round to a few digits in the direction of the easiest figure, and not beyond it."""
    exact = Context(_MEANT).create_decimal(repr(figure))  # so that 1500.0000000000002 is 1500 and stays that
    value = float(Context(_DIGITS, ROUND_CEILING if easiest > figure else ROUND_FLOOR).create_decimal(exact))
    return min(value, easiest) if easiest > figure else max(value, easiest)


def _relaxable(asked: Requirements) -> list[str]:
    """Names of those that can be eased."""
    figures = zip(REQUIREMENTS.items(), asked, strict=True)
    return [name for (name, one), figure in figures if figure is not None and float(figure) != one.easiest]


def _confirmed(problem: DesignProblem, name: str, enough: float, pair: tuple[Tube, Tube]) -> Relaxation | None:
    """The relaxation, if the pair really passes with the rounded figure."""
    asked = requirements(problem)
    if not check_sections(problem, *pair, asked=asked._replace(**{name: enough})).feasible:
        return None
    return Relaxation(REQUIREMENTS[name].key, float(getattr(asked, name)), enough, *pair)


def _in_order(found: Sequence[Relaxation | None]) -> tuple[Relaxation, ...]:
    return tuple(sorted((item for item in found if item is not None), key=lambda item: item.share))


def relax_free(problem: DesignProblem) -> tuple[tuple[Relaxation, ...], CheckedPair]:
    """For tubes of free sizes: the requirements that could be eased alone, and the pair that misses least.

    Each is found by IPOPT from several starts with the requirement as a further variable; the reported figure is
    confirmed by the checks themselves. A requirement that is not listed was not found to help alone.

    Returns:
        The relaxations, the relatively smallest first; and the pair with the least sum of relative violations.
    """
    program = sizing_program(problem)
    elastic = Elastic(problem, program, Conditions(program))
    points = start_points(problem)[::3]
    nearest, _ = elastic.nearest(program.figures, points)
    points.insert(0, nearest[:4] * SIZE_UNITS)
    found = [_ease_one(elastic, name, points) for name in _relaxable(requirements(problem))]
    return _in_order(found), check_sections(problem, *tubes(problem, nearest))


def _ease_one(elastic: Elastic, name: str, points: Sequence[np.ndarray]) -> Relaxation | None:
    """The smallest change of one requirement that makes room, or None if none was found."""
    problem, program, conditions = elastic.problem, elastic.program, elastic.conditions
    place, asked = program.names.index(name), requirements(problem)

    def figures(share: float) -> np.ndarray:
        eased = program.figures.copy()
        eased[place] = _eased(asked, name, share)
        return eased

    with_room, missed = elastic.nearest(figures(1.0), points)
    if missed > FEASIBLE:
        return None
    share = ca.SX.sym("share")
    eased = ca.SX(program.asked)
    eased[place] = _eased(asked, name, share)
    constraints = ca.substitute(program.constraints, program.asked, eased)
    ready = solver(program, share, constraints, share)
    least, best = 1.0, with_room
    for sizes in (with_room[:4] * SIZE_UNITS, points[0]):
        end = solve(ready, np.append(start_variables(problem, sizes), 0.5), program.figures, [(0.0, 1.0)])
        if end[8] < least and conditions.violation(end[:8], figures(float(end[8]))) <= FEASIBLE:
            least, best = float(end[8]), end[:8]
    enough = _rounded(_eased(asked, name, least), REQUIREMENTS[name].easiest)
    return _confirmed(problem, name, enough, tubes(problem, best))


def relax_stock(problem: DesignProblem, stock: Stock) -> tuple[tuple[Relaxation, ...], CheckedPair]:
    """For stock tubes: the requirements that could be eased alone, each by bisection over all pairs.

    More pairs pass as a requirement is eased, so that the bisection finds the least change over the whole list.

    Returns:
        The relaxations, the relatively smallest first; and the pair that misses least.
    """
    asked = requirements(problem)

    def pairs(name: str, figure: float) -> np.ndarray:
        return feasible_pairs(problem, stock, asked._replace(**{name: figure}))

    found = []
    for name in _relaxable(asked):
        if not pairs(name, REQUIREMENTS[name].easiest).any():
            continue
        hard, easy = 0.0, 1.0
        for _ in range(40):
            middle = (hard + easy) / 2
            hard, easy = (hard, middle) if pairs(name, _eased(asked, name, middle)).any() else (middle, easy)
        enough = _rounded(_eased(asked, name, easy), REQUIREMENTS[name].easiest)
        found.append(_confirmed(problem, name, enough, lightest(problem, stock, pairs(name, enough))))
    return _in_order(found), nearest_pair(problem, stock)
