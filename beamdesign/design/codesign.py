"""Co-design: sections, inner end mass and controller together, at least moving mass for a guaranteed bandwidth."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log

import casadi as ca
import numpy as np
from scipy.stats import qmc

from beamdesign.certify.stability import is_stable_over
from beamdesign.design.checks import Check, beam_mass, checks, materials
from beamdesign.design.controller_forms import FORMS, ControllerForm
from beamdesign.design.loop_search import best_gain, grid_plant
from beamdesign.design.pair import check_sections
from beamdesign.design.program import SIZE_UNITS, THICKEST_SHARE, sizing_program, start_variables
from beamdesign.design.refinement import LoopProgram, Proved, refine
from beamdesign.linear import LinearRig, linear_rig
from beamdesign.loop import close_loop
from beamdesign.lumped import beam_figures, fixed_dashpot, hydraulic_figures
from beamdesign.polynomial import exact
from beamdesign.problem import DesignProblem
from beamdesign.prototype import Payload, Prototype
from beamdesign.section import SquareTube

Progress = Callable[[float, str], None]

SAMPLES = 2048
"""Of the coarse search over sections, inner end mass and controller shape."""

STARTS = 5
"""How many of the samples are refined."""

_MASS_PER_MISSING_BANDWIDTH = 100.0
"""Exact penalty, kg per unit of log(bandwidth): far above what bandwidth costs, so that it is met where it can be."""

_GRID_HZ = np.geomspace(0.1, 500.0, 160)
_SLACK = 1e-4  # relative; keeps rounded sizes on the right side of every structural check
_ROUND = 7  # decimals of a size in m


@dataclass(frozen=True)
class CodesignPoint:
    """A design with every guarantee proved.

    Attributes:
        prototype: sections, controller and inner end mass.
        outer: outer tube.
        inner: inner tube.
        beam_mass_kg: both tubes over their full lengths.
        inner_end_mass_kg: mass added to the inner tip.
        proved: the guaranteed figures, and the variables to start a neighbouring problem from.
        checks: structural checks, all satisfied.
        governing: the structural check that is used most.
    """

    prototype: Prototype
    outer: SquareTube
    inner: SquareTube
    beam_mass_kg: float
    inner_end_mass_kg: float
    proved: Proved
    checks: tuple[Check, ...]
    governing: str

    @property
    def moving_mass_kg(self) -> float:
        """Both beams over their full length and the mass added inside."""
        return self.beam_mass_kg + self.inner_end_mass_kg


@dataclass(frozen=True)
class Codesign:
    """Outcome of `codesign`.

    Attributes:
        bandwidth_Hz: asked for.
        outer_end_mass_kg: range of the guarantee.
        point: lightest proved design, None where there is none.
        attempts: per start the proved moving mass in kg, or in words why it failed.
        reason: why there is no design, empty where there is one.
    """

    bandwidth_Hz: float
    outer_end_mass_kg: tuple[float, float]
    point: CodesignPoint | None
    attempts: tuple[float | str, ...]
    reason: str = ""


def _tubes(section_variables: np.ndarray) -> tuple[SquareTube, SquareTube]:
    """Rounded tubes, as they will be written down."""
    sizes = [round(float(size), _ROUND) for size in section_variables[:4] * SIZE_UNITS]
    return SquareTube(sizes[0], sizes[1]), SquareTube(sizes[2], sizes[3])


def _symbolic_figures(problem: DesignProblem) -> Callable[[ca.MX], ca.MX]:
    """Section variables to the lumped figures of the linear model."""
    hydraulics = hydraulic_figures(problem.actuator, problem.servovalve, problem.sensor)

    def figures(sections: ca.MX) -> ca.MX:
        sizes = [float(unit) * sections[i] for i, unit in enumerate(SIZE_UNITS)]
        lumped: list[ca.MX] = []
        for alloy, asked, (width, wall) in zip(
            materials(problem), (problem.outer_beam, problem.inner_beam), (sizes[:2], sizes[2:]), strict=True
        ):
            stiffness, mass = beam_figures(alloy, width, wall, 0.0, asked.free_length_m, asked.end_mass_kg)
            lumped += [stiffness, mass, fixed_dashpot(asked.damping_ratio, stiffness, mass)]
        return ca.vertcat(*lumped, *hydraulics.values())

    return figures


def _rig(problem: DesignProblem, tubes: tuple[SquareTube, SquareTube]) -> LinearRig:
    return linear_rig(problem.prototype(*tubes))


def _program(
    problem: DesignProblem, form: ControllerForm, masses_kg: tuple[float, float], bandwidth_Hz: float
) -> LoopProgram:
    """Least moving mass at a given bandwidth."""
    sizing = sizing_program(problem)
    parts = ca.Function("sizing", [sizing.variables, sizing.asked], [sizing.constraints, sizing.mass])
    count = len(form.names)
    largest_inner = problem.controller.largest_inner_end_mass_kg
    aimed = log(bandwidth_Hz * (1 + 1e-5))
    widest, thinnest = problem.sections.largest_width_m, problem.sections.least_wall_m
    sizes = [(5 * thinnest, widest), (thinnest, THICKEST_SHARE * widest)] * 2
    bounds = np.array(
        [
            *form.log_bounds,
            (0.0, largest_inner),
            (log(1e-3), aimed),
            *((low / unit, high / unit) for (low, high), unit in zip(sizes, SIZE_UNITS, strict=True)),
            *[(0.0, 1.0)] * 4,
        ]
    )
    return LoopProgram(
        form=form,
        filtered=problem.sensor.filter_Hz is not None,
        goal=problem.goal,
        outer_end_mass_kg=masses_kg,
        figures=_symbolic_figures(problem),
        structure=lambda sections: -parts(sections, sizing.figures)[0] - _SLACK,
        objective=lambda variables: (
            parts(variables[count + 2 :], sizing.figures)[1]
            + variables[count]
            + _MASS_PER_MISSING_BANDWIDTH * (aimed - variables[count + 1])
        ),
        lower=bounds[:, 0],
        upper=bounds[:, 1],
        reach=0.5,
        rig=lambda sections: _rig(problem, _tubes(sections)),
        cost=lambda proved: _moving_mass(problem, proved, count + 2),
    )


def _moving_mass(problem: DesignProblem, proved: Proved, head: int) -> float:
    outer, inner = _tubes(proved.variables[head:])
    return float(beam_mass(problem, *outer, *inner)) + proved.inner_end_mass_kg


def _sampled_starts(
    problem: DesignProblem, form: ControllerForm, masses_kg: tuple[float, float], bandwidth_Hz: float
) -> list[np.ndarray]:
    """Light sampled designs that come near the bandwidth, as variables; the sections may miss a check by a little."""
    sections, goal = problem.sections, problem.goal
    largest_inner = problem.controller.largest_inner_end_mass_kg
    unit = qmc.Sobol(5 + len(form.names) - 1, scramble=True, rng=0).random(SAMPLES)
    widths = sections.largest_width_m * (0.3 + 0.7 * unit[:, 0])
    outer_walls, inner_walls = (sections.least_wall_m * 3 ** (2 * unit[:, k] ** 2) for k in (1, 2))
    inner_widths = (widths - 2 * outer_walls) * (0.4 + 0.5 * unit[:, 3])
    slack = np.min(
        [check.slack / abs(check.limit) for check in checks(problem, widths, outer_walls, inner_widths, inner_walls)],
        axis=0,
    )
    mass = beam_mass(problem, widths, outer_walls, inner_widths, inner_walls) + largest_inner * unit[:, 4]
    shape_bounds = np.array(form.log_bounds[1:]).reshape(-1, 2)
    outer_end_masses = np.unique(np.linspace(*masses_kg, 5))
    starts: list[tuple[float, np.ndarray]] = []
    for i in np.nonzero(slack > -0.2)[0]:
        sizes = np.array([widths[i], outer_walls[i], inner_widths[i], inner_walls[i]])
        rig = _rig(problem, _tubes(sizes / SIZE_UNITS))
        shape = np.exp(shape_bounds[:, 0] + unit[i, 5:] * (shape_bounds[:, 1] - shape_bounds[:, 0]))
        inner = largest_inner * unit[i, 4]
        found = best_gain(
            grid_plant(rig, _GRID_HZ),
            form,
            shape,
            inner,
            outer_end_masses,
            goal.peak_sensitivity,
            goal.compliance_m_per_N,
        )
        if found.gain == 0.0:
            continue
        # Mass counted up by what is still missing, about in proportion to bandwidth.
        score = mass[i] * max(1.0, bandwidth_Hz / found.bandwidth_Hz)
        head = [log(found.gain), *np.log(shape), inner, log(min(found.bandwidth_Hz, bandwidth_Hz))]
        starts.append((score, np.array([*head, *start_variables(problem, sizes)])))
    chosen: list[np.ndarray] = []
    low, high = (exact(mass) for mass in masses_kg)
    for _, variables in sorted(starts, key=lambda pair: pair[0]):
        rig = _rig(problem, _tubes(variables[len(form.names) + 2 :]))
        loop = close_loop(
            rig.plant(float(variables[len(form.names)])), form.rounded(variables[: len(form.names)].tolist())
        )
        if is_stable_over(loop.characteristic, low, high):
            chosen.append(variables)
        if len(chosen) == STARTS:
            break
    return chosen


def _point(problem: DesignProblem, masses_kg: tuple[float, float], proved: Proved, head: int) -> CodesignPoint | str:
    """The finished design of a proved loop, or which structural check its rounded sections miss."""
    outer, inner = _tubes(proved.variables[head:])
    checked = check_sections(problem, outer, inner)
    if not checked.feasible:
        return "rounded sections miss: " + ", ".join(check.name for check in checked.failing)
    payload = Payload(outer_end_mass_kg=masses_kg, inner_end_mass_kg=proved.inner_end_mass_kg)
    return CodesignPoint(
        prototype=problem.prototype(outer, inner).but(controller=proved.controller, payload=payload),
        outer=outer,
        inner=inner,
        beam_mass_kg=float(beam_mass(problem, *outer, *inner)),
        inner_end_mass_kg=proved.inner_end_mass_kg,
        proved=proved,
        checks=checked.checks,
        governing=checked.governing,
    )


def codesign(
    problem: DesignProblem,
    outer_end_mass_kg: tuple[float, float],
    bandwidth_Hz: float,
    near: Sequence[CodesignPoint] = (),
    progress: Progress | None = None,
) -> Codesign:
    """Find the lightest sections, end mass and controller that guarantee a bandwidth over a payload range.

    Args:
        problem: load, lengths, materials, hydraulics and limits; its sections are free.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed.
        bandwidth_Hz: needed; |x / F_d| stays at or below the goal up to there.
        near: solved neighbouring problems to start from as well (for one controller kind).
        progress: told the share done and what is being done.
    """
    told = progress or (lambda fraction, text: None)
    form = FORMS[problem.controller.kind]
    head = len(form.names) + 2
    told(0.0, "coarse search")
    starts = [point.proved.variables for point in near]
    if not near:
        starts += _sampled_starts(problem, form, outer_end_mass_kg, bandwidth_Hz)
    program = _program(problem, form, outer_end_mass_kg, bandwidth_Hz)
    points: list[CodesignPoint] = []
    attempts: list[float | str] = []
    for k, start in enumerate(starts):
        told((k + 1) / (len(starts) + 1), f"refining and proving start {k + 1} of {len(starts)}")
        refined = refine(program, start, bandwidth_Hz)
        if refined.proved is None:
            attempts.append(refined.reason)
            continue
        point = _point(problem, outer_end_mass_kg, refined.proved, head)
        if isinstance(point, str):
            attempts.append(point)
        else:
            points.append(point)
            attempts.append(point.moving_mass_kg)
    if not points:
        low, high = outer_end_mass_kg
        reason = f"no start led to a proved design for {bandwidth_Hz:g} Hz over {low:g} to {high:g} kg: " + (
            "; ".join(str(attempt) for attempt in dict.fromkeys(attempts)) or "no sampled design has a feasible gain"
        )
        return Codesign(bandwidth_Hz, outer_end_mass_kg, None, tuple(attempts), reason)
    best = min(points, key=lambda point: point.moving_mass_kg)
    return Codesign(bandwidth_Hz, outer_end_mass_kg, best, tuple(attempts))
