"""The pair of tubes that misses least: every check may be missed, and the sum of relative misses is made small."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from beamdesign.design.program import Conditions, Program, solve, solver, start_variables
from beamdesign.problem import DesignProblem

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
