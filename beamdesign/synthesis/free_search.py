"""Least beam mass over continuous widths and walls: a smooth program, IPOPT from several starts, checked without it.

Variables: the four sizes, and the four local buckling factors (flange and web of each tube), which are bounded by 1
and by their curve instead of being computed as the kinked minimum of both. As the resistance grows with each factor,
the two forms have the same solutions, and the program is smooth where the class limit of EN 1999-1-1 has its kink.

Where nothing fits, the pair of tubes that misses least: every check may be missed, and the sum of relative misses is
made small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log10
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.problem import DesignProblem
from beamdesign.progress import interruption_waits
from beamdesign.structure.section import Tube, buckling_curve, clearances
from beamdesign.synthesis.checks import (
    REQUIREMENTS,
    CheckedPair,
    Pair,
    Relaxation,
    beam_mass,
    check_sections,
    checks,
    confirmed,
    eased,
    enough_of,
    relaxable,
    requirements,
)

_SIZE_UNITS = np.array([0.1, 0.001, 0.1, 0.001])
"""Of a link as long as the published one widths count in tenths of a metre and walls in millimetres: all are near 1."""

THICKEST_SHARE = 0.49
"""Largest wall over width: a tube stays a tube."""

LEAST_WIDTH_M, LEAST_WALL_M = 0.005, 0.00005
"""Smallest tube that is looked at, unless more is asked, of a link as long as that."""

_WIDEST_START_M = 2.0
_ACTIVE = 1e-6
_MOST = 1e3
QUIET_IPOPT: dict[str, Any] = {
    "ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.bound_relax_factor": 0.0
}  # fmt: skip
"""That says nothing, and keeps bounds to the letter."""

_TIGHT = dict.fromkeys(("ipopt.tol", "ipopt.constr_viol_tol", "ipopt.compl_inf_tol"), 1e-11)


@dataclass(frozen=True)
class Program:
    """Symbols of the sizing problem; every constraint reads g <= 0 and is relative to what is needed.

    Its methods evaluate optimality and shadow prices anywhere.

    Attributes:
        problem: what is asked.
        variables: sizes in `size_units`, then the four local buckling factors, (8, 1).
        asked: symbols of the requirements in use, (r, 1).
        names: their names in `REQUIREMENTS`.
        figures: their values in the problem, (r,).
        mass: beam mass, kg.
        constraints: g, (c, 1).
        checks: names of the checks, which the first constraints are.
    """

    problem: DesignProblem
    variables: Any
    asked: Any
    names: tuple[str, ...]
    figures: np.ndarray
    mass: Any
    constraints: Any
    checks: tuple[str, ...]

    @cached_property
    def _evaluate(self) -> Any:
        """Mass, its gradient, constraints and their derivatives by variables and requirements; compiled once."""
        outputs = [
            self.mass,
            ca.gradient(self.mass, self.variables),
            self.constraints,
            ca.jacobian(self.constraints, self.variables),
            ca.jacobian(self.constraints, self.asked),
        ]
        return ca.Function("conditions", [self.variables, self.asked], outputs)

    def _at(self, variables: np.ndarray, figures: np.ndarray) -> list[np.ndarray]:
        return [np.asarray(output.full()) for output in self._evaluate(variables, figures)]

    def mass_kg(self, variables: np.ndarray, figures: np.ndarray) -> float:
        """Beam mass, kg."""
        return float(self._at(variables, figures)[0].item())

    def missed(self, variables: np.ndarray, figures: np.ndarray) -> np.ndarray:
        """Every constraint g, relative to its limit, (c,); positive where it is violated."""
        return self._at(variables, figures)[2].ravel()

    def violation(self, variables: np.ndarray, figures: np.ndarray) -> float:
        """Worst violation of a constraint, relative to its limit; 0 where all hold."""
        worst = float(np.max(self.missed(variables, figures)))
        return max(worst, 0.0) if np.isfinite(worst) else float("inf")

    def optimality(self, variables: np.ndarray, figures: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """First-order conditions at a point, evaluated without the solver that found it.

        Returns:
            The residual: largest of the stationarity residual (relative to the gradient of the mass), the worst
            violation of a constraint (relative to its limit), and complementarity (relative to the mass). Multipliers
            of each constraint, kg per unit of relative violation, (c,), from non-negative least squares on the
            gradients of the active constraints. And the derivative of the least mass with respect to each requirement,
            kg per its unit, (r,) (envelope theorem).
        """
        from scipy.optimize import nnls

        mass, gradient, constraints, jacobian, by_figures = self._at(variables, figures)
        values = constraints.ravel()
        active = np.flatnonzero(values > -_ACTIVE)
        multipliers = np.zeros(values.size)
        misfit = scale = float(np.linalg.norm(gradient))
        if active.size:
            multipliers[active], misfit = nnls(jacobian[active].T, -gradient.ravel())
        complementarity = float(np.max(np.abs(multipliers * values))) / float(mass.item())
        return max(misfit / scale, float(values.max()), complementarity), multipliers, multipliers @ by_figures

    @cached_property
    def _elastic(self) -> Any:
        """Minimises the sum of what the checks are missed by, for any requirements."""
        count = len(self.checks)
        excess, others = ca.SX.sym("excess", count), ca.SX.zeros(self.constraints.shape[0] - count)
        return solver(self, ca.sum1(excess), self.constraints - ca.vertcat(excess, others), excess)

    def nearest(self, figures: np.ndarray, points: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
        """Search from several points.

        Args:
            figures: values of the requirements, (r,).
            points: sizes in m, (4,) each; at least one.

        Returns:
            Program variables (8,) with the least sum of violations of any constraint, and that sum, which is evaluated
            at the point and not taken from the solver.
        """
        found, count = list[tuple[float, np.ndarray]](), len(self.checks)
        for sizes in points:
            start = start_variables(self.problem, sizes)
            missed = np.clip(self.missed(start, figures)[:count], 0.0, _MOST) + 0.1
            end = solve(self._elastic, np.concatenate([start, missed]), figures, [(0.0, _MOST)] * count)[:8]
            total = float(np.clip(self.missed(end, figures), 0.0, None).sum())
            found.append((total if np.isfinite(total) else float("inf"), end))
        total, variables = min(found, key=lambda item: item[0])
        return variables, total


def size_units(problem: DesignProblem) -> np.ndarray:
    """What widths and walls (4,) of the outer and the inner tube count in, m."""
    return problem.length_unit_m * _SIZE_UNITS


def pair_of(problem: DesignProblem, sizes: Sequence[Any]) -> tuple[Tube, Tube]:
    """Tubes of the problem's shapes, of widths and walls (4,) in m of the outer and the inner one."""
    return problem.outer_beam.sized(*sizes[:2]), problem.inner_beam.sized(*sizes[2:])


def sizes_of(pair: tuple[Tube, Tube]) -> np.ndarray:
    """Widths and walls (4,) of two tubes, m."""
    return np.array([size for tube in pair for size in (tube.width_m, tube.wall_m)])


def sizing_program(problem: DesignProblem) -> Program:
    """State the least-mass problem with the requirements as parameters."""
    sizes, factors = ca.SX.sym("sizes", 4), ca.SX.sym("factors", 4)
    outer, inner = pair_of(problem, [float(unit) * sizes[i] for i, unit in enumerate(size_units(problem))])
    nominal = requirements(problem)
    asked = ca.SX.sym("asked", len(nominal))
    symbols = {name: asked[i] for i, name in enumerate(nominal)}

    pairs = ((factors[0], factors[1]), (factors[2], factors[3]))
    found = checks(problem, outer, inner, symbols, pairs)
    # What must be at least its limit is taken over that limit, which no size enters (so any pair gives it), but over
    # 1 mm at least of a link of 1.2 m, for gaps may be asked to be zero. The rest is 1 - limit / value: resistances
    # over demands, which are polynomial in the sizes where their inverses are not.
    long = problem.length_unit_m
    limits = [float(check.limit) for check in checks(problem, *pair_of(problem, (0.1, 0.01, 0.05, 0.005)))]
    constraints = [
        (check.limit - check.value) / max(limit, 1e-3 * long) if check.at_least else 1 - check.limit / check.value
        for check, limit in zip(found, limits, strict=True)
    ]
    for tube, of, pair in zip((outer, inner), problem.beams, pairs, strict=True):
        alloy = of.material
        slenderness = tube.relative_slenderness(alloy.proof_strength_Pa)
        for factor, value in zip(pair, slenderness, strict=False):  # of flange and web; a round tube has neither
            constraints += [factor - 1, factor - buckling_curve(value, alloy.buckling_constants)]
        for size in tube.sides.values():
            constraints += [tube.wall_m / size - THICKEST_SHARE, 1 - size / (long * LEAST_WIDTH_M)]
        constraints.append(1 - tube.wall_m / (long * LEAST_WALL_M))
    constraints += [-gap / (0.01 * long) for gap in clearances(outer, inner)]  # the inner tube enters the outer one
    return Program(
        problem=problem,
        variables=ca.vertcat(sizes, factors),
        asked=asked,
        names=tuple(nominal),
        figures=np.array([float(figure) for figure in nominal.values()]),
        mass=beam_mass(problem, outer, inner),
        constraints=ca.vertcat(*constraints),
        checks=tuple(check.name for check in found),
    )


def start_points(problem: DesignProblem, pairs: Sequence[tuple[Tube, Tube]] = ()) -> list[np.ndarray]:
    """Sizes in m to start from, each (4,): a coarse grid over the allowed widths, and the pairs given."""
    widest, least = min(problem.sections.largest_width_m, _WIDEST_START_M), problem.sections.least_wall_m
    widest /= max(problem.outer_beam.sized(1.0, 0.1).sides.values())
    grid = [
        np.array([share * widest, wall(share * widest), ratio * share * widest, wall(ratio * share * widest)])
        for share in (0.9, 0.6, 0.35, 0.12)
        for ratio in (0.5, 0.75)
        for wall in (lambda width: min(1.2 * least, width / 5), lambda width: max(width / 25, least))
    ]
    return [sizes_of(pair) for pair in pairs] + grid


def start_variables(problem: DesignProblem, sizes: np.ndarray) -> np.ndarray:
    """Program variables for sizes in m, (4,), with the local buckling factors that belong to them, (8,)."""
    factors = []
    for tube, of in zip(pair_of(problem, sizes.tolist()), problem.beams, strict=True):
        alloy = of.material
        slenderness = tube.relative_slenderness(alloy.proof_strength_Pa)
        own = [min(1.0, float(buckling_curve(value, alloy.buckling_constants))) for value in slenderness]
        factors += own or [1.0, 1.0]
    return np.concatenate([sizes / size_units(problem), factors])


def solver(program: Program, objective: Any, constraints: Any, extra: Any = None) -> Any:
    """An IPOPT solver with exact first and second derivatives, for the program's variables and some more."""
    variables = program.variables if extra is None else ca.vertcat(program.variables, extra)
    statement: dict[str, Any] = {"x": variables, "p": program.asked, "f": objective, "g": constraints}
    options = QUIET_IPOPT | _TIGHT | {"show_eval_warnings": False, "ipopt.max_iter": 250}
    return ca.nlpsol("sizing", "ipopt", statement, options)


def solve(
    ready: Any, start: np.ndarray, figures: np.ndarray, extra_bounds: Sequence[tuple[float, float]] = ()
) -> np.ndarray:
    """Run a `solver` and give back where it ended, whatever it says of that point."""
    # These only keep the iterates where the formulas have a meaning; the constraints lie inside them.
    least = np.array([LEAST_WIDTH_M, LEAST_WALL_M, LEAST_WIDTH_M, LEAST_WALL_M]) / _SIZE_UNITS / 2
    lower = [*least, *[1e-4] * 4, *(low for low, _ in extra_bounds)]
    upper = [*[np.inf] * 4, *[2.0] * 4, *(high for _, high in extra_bounds)]
    with interruption_waits():
        found = ready(x0=start, p=figures, lbx=lower, ubx=upper, lbg=-np.inf, ubg=0.0)
    return np.asarray(found["x"].full()).ravel()


FEASIBLE = 1e-9
"""Largest relative violation of a constraint in a point that counts as feasible."""

_SAME_MASS = 1e-6


@dataclass(frozen=True)
class FreeOptimum:
    """The lightest pair of tubes of any size.

    Attributes:
        pair: the tubes, their mass and its checks.
        governing: the active check whose relaxation by one per cent would save most mass.
        active: names of all active checks.
        kkt_residual: see `Program.optimality`; from the gradients, not from the solver.
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


_ROUND = 7  # decimals of a size in m, of a link as long as the published one


def tubes(problem: DesignProblem, variables: np.ndarray, rounded: bool = False) -> tuple[Tube, Tube]:
    """Outer and inner tube of program variables, as they are or rounded as they will be written down."""
    sizes, decimals = (variables[:4] * size_units(problem)).tolist(), _ROUND - round(log10(problem.length_unit_m))
    return pair_of(problem, [round(size, decimals) for size in sizes] if rounded else sizes)


def free_optimum(problem: DesignProblem, known: Sequence[tuple[Tube, Tube]] = ()) -> FreeOptimum | None:
    """Search the lightest pair of tubes of free sizes.

    IPOPT with exact derivatives from a grid of starts and from pairs already known. It is a local method: that no
    lighter pair exists is borne out by the starts agreeing, not proved; nor is it proved that none exists where none is
    found. Unless a known pair passes, the pair that misses least is sought first, and the answer is no if it misses.

    Args:
        problem: what is asked.
        known: pairs to start from as well, such as the best stock pair.

    Returns:
        The optimum, or None where no feasible pair was found.
    """
    program = sizing_program(problem)
    points = start_points(problem, known)
    if not any(check_sections(problem, *pair).feasible for pair in known):
        nearest, missed = program.nearest(program.figures, points[::3])
        if missed > FEASIBLE:
            return None
        points.append(nearest[:4] * size_units(problem))
    ready = solver(program, program.mass / problem.mass_unit_kg, program.constraints)
    ends = [solve(ready, start_variables(problem, sizes), program.figures) for sizes in points]
    feasible = [end for end in ends if program.violation(end, program.figures) <= FEASIBLE]
    if not feasible:
        return None
    masses = [program.mass_kg(end, program.figures) for end in feasible]
    best = feasible[int(np.argmin(masses))]
    agreeing = sum(mass <= min(masses) * (1 + _SAME_MASS) for mass in masses)

    residual, multipliers, per_figure = program.optimality(best, program.figures)
    order = np.argsort(-multipliers[: len(program.checks)])
    active = tuple(program.checks[i] for i in order if multipliers[i] > 0)
    found = check_sections(problem, *tubes(problem, best))
    each = zip([REQUIREMENTS[name] for name in program.names], program.figures, per_figure, strict=True)
    prices = {one.price: float(price) * one.unit(float(figure)) + 0.0 for one, figure, price in each}
    governing = active[0] if active else found.governing
    return FreeOptimum(found, governing, active, residual, prices, len(ends), agreeing)


def relax_free(problem: DesignProblem) -> tuple[tuple[Relaxation, ...], CheckedPair]:
    """For tubes of free sizes: the requirements that could be eased alone, and the pair that misses least.

    Each is found by IPOPT from several starts with the requirement as a further variable; the reported figure is
    confirmed by the checks themselves. A requirement that is not listed was not found to help alone.

    Returns:
        The relaxations, the relatively smallest first; and the pair with the least sum of relative violations.
    """
    program, points = sizing_program(problem), start_points(problem)[::3]
    nearest, _ = program.nearest(program.figures, points)
    points.insert(0, nearest[:4] * size_units(problem))
    found = [one for name in relaxable(requirements(problem)) for one in _ease_one(program, name, points)]
    return confirmed(problem, found), check_sections(problem, *tubes(problem, nearest))


def _ease_one(program: Program, name: str, points: Sequence[np.ndarray]) -> list[tuple[str, float, Pair]]:
    """The smallest change of one requirement that makes room, and for which pair; empty where none was found."""
    problem, place, asked = program.problem, program.names.index(name), requirements(program.problem)

    def figures(share: float) -> np.ndarray:
        given = program.figures.copy()
        given[place] = eased(asked, name, share)
        return given

    with_room, missed = program.nearest(figures(1.0), points)
    if missed > FEASIBLE:
        return []
    share = ca.SX.sym("share")
    given = ca.SX(program.asked)
    given[place] = eased(asked, name, share)
    constraints = ca.substitute(program.constraints, program.asked, given)
    ready = solver(program, share, constraints, share)
    least, best = 1.0, with_room
    for sizes in (with_room[:4] * size_units(problem), points[0]):
        end = solve(ready, np.append(start_variables(problem, sizes), 0.5), program.figures, [(0.0, 1.0)])
        if end[8] < least and program.violation(end[:8], figures(float(end[8]))) <= FEASIBLE:
            least, best = float(end[8]), end[:8]
    return [(name, enough_of(asked, name, least), tubes(problem, best))]
