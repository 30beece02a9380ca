"""Least beam mass over continuous widths and walls: IPOPT from several starts, its answer checked without it.

Where nothing fits, the pair of tubes that misses least: every check may be missed, and the sum of relative misses is
made small.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from beamdesign.design.pair import CheckedPair, check_sections
from beamdesign.design.program import (
    SIZE_UNITS,
    Conditions,
    Program,
    sizing_program,
    solve,
    solver,
    start_points,
    start_variables,
)
from beamdesign.problem import DesignProblem
from beamdesign.section import SquareTube

_MOST = 1e3


class Elastic:
    """Minimises the sum of what the checks are missed by; compiled once, solved for any requirements."""

    def __init__(self, problem: DesignProblem, program: Program, conditions: Conditions):
        self._problem, self._count, self._conditions = problem, program.check_count, conditions
        excess = ca.SX.sym("excess", self._count)
        others = ca.SX.zeros(len(program.labels) - self._count)
        self._ready = solver(program, ca.sum1(excess), program.constraints - ca.vertcat(excess, others), excess)

    def nearest(self, figures: np.ndarray, points: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
        """Search from several points.

        Args:
            figures: values of the requirements, (r,).
            points: sizes in m, (4,) each; at least one.

        Returns:
            Program variables (8,) with the least sum of violations of any constraint, and that sum, which is evaluated
            at the point and not taken from the solver.
        """
        found: list[tuple[float, np.ndarray]] = []
        for sizes in points:
            start = start_variables(self._problem, sizes)
            missed = np.clip(self._conditions.constraints(start, figures)[: self._count], 0.0, _MOST) + 0.1
            end = solve(self._ready, np.concatenate([start, missed]), figures, [(0.0, _MOST)] * self._count)[:8]
            total = float(np.clip(self._conditions.constraints(end, figures), 0.0, None).sum())
            found.append((total if np.isfinite(total) else float("inf"), end))
        total, variables = min(found, key=lambda item: item[0])
        return variables, total


FEASIBLE = 1e-9
"""Largest relative violation of a constraint in a point that counts as feasible."""

_SAME_MASS = 1e-6

PRICE_UNITS = {
    "tip_force_N": ("tip_force_kg_per_percent", 0.01),
    "strength": ("safety_strength_kg_per_percent", 0.01),
    "local_buckling": ("safety_local_buckling_kg_per_percent", 0.01),
    "assembly_m": ("clearance_assembly_kg_per_mm", None),
    "under_load_m": ("clearance_under_load_kg_per_mm", None),
    "least_wall_m": ("least_wall_kg_per_mm", None),
    "largest_width_m": ("largest_width_kg_per_mm", None),
    "width_to_wall_at_most": ("width_to_wall_at_most_kg_per_percent", 0.01),
}
"""Name of each requirement's shadow price; the share of the requirement that makes its unit, or None for 1 mm."""


@dataclass(frozen=True)
class FreeOptimum:
    """The lightest pair of tubes of any size.

    Attributes:
        pair: the tubes, their mass and its checks.
        governing: the active check whose relaxation by one per cent would save most mass.
        active: names of all active checks.
        kkt_residual: see `Optimality.residual`; from the gradients, not from the solver.
        shadow_prices: change of the least mass per unit of each requirement, kg per the unit in the name; negative for
            requirements that ease as they grow (largest width, width to wall).
        starts: how many starts there were.
        starts_agreeing: how many of them ended feasible at the same mass.
    """

    pair: CheckedPair
    governing: str
    active: tuple[str, ...]
    kkt_residual: float
    shadow_prices: dict[str, float]
    starts: int
    starts_agreeing: int


def tubes(variables: np.ndarray) -> tuple[SquareTube, SquareTube]:
    """Outer and inner tube of program variables."""
    outer_width, outer_wall, inner_width, inner_wall = (float(size) for size in variables[:4] * SIZE_UNITS)
    return SquareTube(outer_width, outer_wall), SquareTube(inner_width, inner_wall)


def free_optimum(
    problem: DesignProblem, known: Sequence[tuple[SquareTube, SquareTube]] = (), grid: bool = True
) -> FreeOptimum | None:
    """Search the lightest pair of tubes of free sizes.

    IPOPT with exact derivatives from a grid of starts and from pairs already known. It is a local method: that no
    lighter pair exists is borne out by the starts agreeing, not proved; nor is it proved that none exists where none is
    found. Unless a known pair passes, the pair that misses least is sought first, and the answer is no if it misses.

    Args:
        problem: what is asked.
        known: pairs to start from as well, such as the best stock pair.
        grid: whether to start from the grid at all; without it, the optimum is one beside the known pairs.

    Returns:
        The optimum, or None where no feasible pair was found.
    """
    program = sizing_program(problem)
    conditions, points = Conditions(program), start_points(problem, known)[: None if grid else len(known)]
    if not any(check_sections(problem, *pair).feasible for pair in known):
        nearest, missed = Elastic(problem, program, conditions).nearest(program.figures, points[::3])
        if missed > FEASIBLE:
            return None
        points.append(nearest[:4] * SIZE_UNITS)
    ready = solver(program, program.mass, program.constraints)
    ends = [solve(ready, start_variables(problem, sizes), program.figures) for sizes in points]
    feasible = [end for end in ends if conditions.violation(end, program.figures) <= FEASIBLE]
    if not feasible:
        return None
    masses = [conditions.mass(end, program.figures) for end in feasible]
    best = feasible[int(np.argmin(masses))]
    agreeing = sum(mass <= min(masses) * (1 + _SAME_MASS) for mass in masses)

    optimality = conditions.optimality(best, program.figures)
    multipliers = optimality.multipliers[: program.check_count]
    active = [i for i in np.argsort(-multipliers) if multipliers[i] > 0]
    found = check_sections(problem, *tubes(best))
    return FreeOptimum(
        pair=found,
        governing=program.labels[active[0]] if active else found.governing,
        active=tuple(program.labels[i] for i in active),
        kkt_residual=optimality.residual,
        shadow_prices=_prices(program, conditions, best, optimality.multipliers),
        starts=len(ends),
        starts_agreeing=agreeing,
    )


def _prices(
    program: Program, conditions: Conditions, variables: np.ndarray, multipliers: np.ndarray
) -> dict[str, float]:
    per_figure = conditions.mass_per_figure(variables, program.figures, multipliers)
    prices = {}
    for name, figure, price in zip(program.names, program.figures, per_figure, strict=True):
        label, share = PRICE_UNITS[name]
        prices[label] = float(price) * (0.001 if share is None else share * float(figure)) + 0.0
    return prices
