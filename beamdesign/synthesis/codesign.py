"""Co-design: sections, inner end mass and controller together, at least moving mass for a guaranteed bandwidth.

And the Pareto front of moving mass against guaranteed bandwidth against payload range, every point proved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import log

import casadi as ca
import numpy as np
from pydantic import ValidationError
from scipy.stats import qmc

from beamdesign.controllers import KINDS
from beamdesign.controllers.form import Form, form_of
from beamdesign.plant.members import VertexModel, family
from beamdesign.problem import DesignProblem
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Payload, Prototype
from beamdesign.records import InputError
from beamdesign.structure.lumped import beam_figures, fixed_dashpot, hydraulic_figures
from beamdesign.structure.section import SquareTube
from beamdesign.synthesis.checks import Check, beam_mass, check_sections, checks, materials
from beamdesign.synthesis.free_search import SIZE_UNITS, THICKEST_SHARE, sizing_program, start_variables
from beamdesign.synthesis.refinement import LoopProgram, Proved, refine
from beamdesign.synthesis.starts import best_starts

SAMPLES = 2048
"""Of the coarse search over sections, inner end mass and controller shape."""

STARTS = 3
"""How many of the samples are refined."""

_MASS_PER_MISSING_BANDWIDTH = 100.0
"""Exact penalty, kg per unit of log(bandwidth): far above what bandwidth costs, so that it is met where it can be."""

_NEARLY_CHECKED = 0.2
"""Share of its limit by which a sampled section may miss a check; refinement mends that."""

ROUNDED_SLACK = 1e-4
"""Relative slack of every structural check, so that rounded sizes stay on its right side."""

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


def rounded_tubes(section_variables: np.ndarray) -> tuple[SquareTube, SquareTube]:
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


def _members(problem: DesignProblem, tubes: tuple[SquareTube, SquareTube]) -> tuple[VertexModel, ...] | None:
    """The members of the rig with these tubes; None where the record of it refuses them."""
    try:
        return family(problem.prototype(*tubes)).members
    except ValidationError:
        return None


def sizing_parts(problem: DesignProblem) -> Callable[[ca.MX], tuple[ca.MX, ca.MX]]:
    """Section variables to the constraints of sizing, none of which may be positive, and the beams' mass (kg)."""
    sizing = sizing_program(problem)
    parts = ca.Function("sizing", [sizing.variables, sizing.asked], [sizing.constraints, sizing.mass])

    def at(sections: ca.MX) -> tuple[ca.MX, ca.MX]:
        constraints, mass = parts(sections, sizing.figures)
        return constraints, mass

    return at


def codesign_program(
    problem: DesignProblem, form: Form, masses_kg: tuple[float, float], bandwidth_Hz: float
) -> LoopProgram:
    """Least moving mass at a given bandwidth."""
    parts, count = sizing_parts(problem), form.size
    largest_inner = problem.controller.largest_inner_end_mass_kg
    aimed = log(bandwidth_Hz * (1 + 1e-5))
    widest, thinnest = problem.sections.largest_width_m, problem.sections.least_wall_m
    sizes = [(5 * thinnest, widest), (thinnest, THICKEST_SHARE * widest)] * 2
    bounds = np.array(
        [
            *zip(form.lower, form.upper, strict=True),
            (0.0, largest_inner),
            (log(1e-3), aimed),
            *((low / unit, high / unit) for (low, high), unit in zip(sizes, SIZE_UNITS, strict=True)),
            *[(0.0, 1.0)] * 4,
        ]
    )
    return LoopProgram(
        form=form,
        goal=problem.goal,
        outer_end_mass_kg=masses_kg,
        figures=_symbolic_figures(problem),
        filtered=problem.sensor.filter_Hz is not None,
        structure=lambda variables: -parts(variables[count + 2 :])[0] - ROUNDED_SLACK,
        objective=lambda variables: (
            parts(variables[count + 2 :])[1]
            + variables[count]
            + _MASS_PER_MISSING_BANDWIDTH * (aimed - variables[count + 1])
        ),
        lower=bounds[:, 0],
        upper=bounds[:, 1],
        reach=0.5,
        tighten_below=1e-3,
        members=lambda sections: _members(problem, rounded_tubes(sections)),
        flaw=lambda variables: structural_flaw(problem, variables[count + 2 :]),
        cost=lambda proved: section_mass(problem, proved.variables[count + 2 :]) + proved.inner_end_mass_kg,
    )


def section_mass(problem: DesignProblem, sections: np.ndarray) -> float:
    """Mass of both beams, kg."""
    outer, inner = rounded_tubes(sections)
    return float(beam_mass(problem, *outer, *inner))


def _samples(problem: DesignProblem, program: LoopProgram) -> np.ndarray:
    """Sampled variables whose sections miss no structural check by much, (k, n)."""
    sections = problem.sections
    names = program.form.size
    unit = qmc.Sobol(4 + names, scramble=True, rng=0).random(SAMPLES)
    widths = sections.largest_width_m * (0.3 + 0.7 * unit[:, 0])
    # Walls near the least one are the likelier ones.
    outer_walls, inner_walls = (sections.least_wall_m * 9 ** (unit[:, k] ** 2) for k in (1, 2))
    inner_widths = (widths - 2 * outer_walls) * (0.4 + 0.5 * unit[:, 3])
    found = checks(problem, widths, outer_walls, inner_widths, inner_walls)
    slack = np.min([check.slack / abs(check.limit) for check in found], axis=0)
    loops = program.lower[: names + 2] + (program.upper - program.lower)[: names + 2] * np.column_stack(
        [np.zeros(SAMPLES), unit[:, 4:], np.zeros(SAMPLES)]
    )
    return np.array(
        [
            [*loops[i], *start_variables(problem, np.array(sizes))]
            for i, sizes in enumerate(zip(widths, outer_walls, inner_widths, inner_walls, strict=True))
            if slack[i] > -_NEARLY_CHECKED
        ]
    )


def structural_flaw(problem: DesignProblem, sections: np.ndarray) -> str:
    """Which structural checks the rounded sections miss, in words; empty where they pass."""
    failing = check_sections(problem, *rounded_tubes(sections)).failing
    return "the refined sections miss: " + ", ".join(check.name for check in failing) if failing else ""


def _point(problem: DesignProblem, masses_kg: tuple[float, float], proved: Proved, head: int) -> CodesignPoint:
    """The finished design of a proved loop, whose sections have no structural flaw."""
    outer, inner = rounded_tubes(proved.variables[head:])
    checked = check_sections(problem, outer, inner)
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

    Raises:
        InputError: for a kind of controller that is not tuned from a seed of its own.
    """
    report = progress or silent
    kind = problem.controller.kind
    if kind not in KINDS or not any(seed.kind == kind for seed in KINDS[kind].seeds()):
        reason = f"{kind!r} is not for sections and controller together, which are sought with few figures; give a lag"
        raise InputError(problem.name, [("controller.kind", reason)])
    form = form_of(kind)
    head = form.size + 2
    report(0.0, "coarse search")
    program = codesign_program(problem, form, outer_end_mass_kg, bandwidth_Hz)
    starts, nothing = [point.proved.variables for point in near], ""
    if not near:

        def score(variables: np.ndarray) -> float:
            """Moving mass, counted up by the share of bandwidth that is still missing."""
            missing = max(1.0, bandwidth_Hz / float(np.exp(variables[head - 1])))
            return missing * (section_mass(problem, variables[head:]) + float(variables[head - 2]))

        samples = _samples(problem, program)
        starts, _ = best_starts(program, samples, score, STARTS)
        if not starts:
            nothing = (
                "no sampled gain keeps the peak sensitivity over the whole range"
                if len(samples)
                else "no sampled sections come near the structural checks; `beamdesign size` says which to relax"
            )
    points: list[CodesignPoint] = []
    attempts: list[float | str] = []
    for k, start in enumerate(starts):
        report((k + 1) / (len(starts) + 1), f"refining and proving start {k + 1} of {len(starts)}")
        refined = refine(program, start, bandwidth_Hz)
        if refined.proved is None:
            attempts.append(refined.reason)
            continue
        point = _point(problem, outer_end_mass_kg, refined.proved, head)
        points.append(point)
        attempts.append(point.moving_mass_kg)
    if not points:
        low, high = outer_end_mass_kg
        reason = f"no start led to a proved design for {bandwidth_Hz:g} Hz over {low:g} to {high:g} kg: " + (
            "; ".join(str(attempt) for attempt in dict.fromkeys(attempts)) or nothing
        )
        return Codesign(bandwidth_Hz, outer_end_mass_kg, None, tuple(attempts), reason)
    best = min(points, key=lambda point: point.moving_mass_kg)
    return Codesign(bandwidth_Hz, outer_end_mass_kg, best, tuple(attempts))


@dataclass(frozen=True)
class Front:
    """Co-designs over a grid of requirements.

    Attributes:
        designs: one per payload range and bandwidth, bandwidths within ranges; those without a point carry the reason.
        colder: how many points fresh samples solved where the solved neighbours had led to no proof.
    """

    designs: tuple[Codesign, ...]
    colder: int

    @property
    def proved(self) -> tuple[Codesign, ...]:
        """Those with a proved design."""
        return tuple(design for design in self.designs if design.point is not None)

    @property
    def failed(self) -> tuple[Codesign, ...]:
        """Those without, each with its reason."""
        return tuple(design for design in self.designs if design.point is None)

    @property
    def efficient(self) -> tuple[Codesign, ...]:
        """The proved designs that no other one beats in mass, bandwidth and payload; one of each that are equal."""
        kept: list[Codesign] = []
        for design in self.proved:
            others = [other for other in self.proved if _merits(other) != _merits(design)]
            beaten = any(_no_worse(other, design) for other in others)
            if not beaten and _merits(design) not in map(_merits, kept):
                kept.append(design)
        return tuple(kept)


def _merits(design: Codesign) -> tuple[float, ...]:
    """Moving mass, guaranteed bandwidth turned round, and the range's ends so that less is better in each."""
    assert design.point is not None
    low, high = design.outer_end_mass_kg
    return design.point.moving_mass_kg, -design.point.proved.bandwidth_Hz, low, -high


def _no_worse(one: Codesign, other: Codesign) -> bool:
    return all(mine <= yours for mine, yours in zip(_merits(one), _merits(other), strict=True))


def _answers(design: Codesign, asked: Codesign) -> bool:
    """Whether a proved design meets what was asked of another one as well."""
    return (
        design.point is not None
        and design.point.proved.bandwidth_Hz >= asked.bandwidth_Hz
        and design.outer_end_mass_kg[0] <= asked.outer_end_mass_kg[0]
        and design.outer_end_mass_kg[1] >= asked.outer_end_mass_kg[1]
    )


def _lightest_answer(asked: Codesign, designs: Sequence[Codesign]) -> Codesign:
    """What was asked with the lightest of all designs that meet it; with its own reason where none does."""
    points = [design.point for design in designs if design.point is not None and _answers(design, asked)]
    if not points:
        return asked
    return replace(asked, point=min(points, key=lambda point: point.moving_mass_kg), reason="")


def pareto_front(
    problem: DesignProblem,
    bandwidths_Hz: Sequence[float],
    ranges_kg: Sequence[tuple[float, float]],
    progress: Progress | None = None,
) -> Front:
    """Co-design along a front, each point starting from its solved neighbours in bandwidth and in payload.

    Where the neighbours lead to no proof, fresh samples are tried; both failures together are the point's reason. Where
    a design found for more bandwidth or payload is lighter, or the only one, it answers what asks for less as well.

    Args:
        problem: as for `codesign`.
        bandwidths_Hz: needed bandwidths.
        ranges_kg: ranges of outer end mass.
        progress: told the share done and what is being done.
    """
    report = progress or silent
    bandwidths = sorted(set(bandwidths_Hz))
    solved: dict[tuple[int, int], Codesign] = {}
    ranges = list(dict.fromkeys(ranges_kg))
    colder, total = 0, len(ranges) * len(bandwidths)
    for i, masses in enumerate(ranges):
        for k, bandwidth in enumerate(bandwidths):
            report(len(solved) / total, f"{bandwidth:g} Hz over {masses[0]:g} to {masses[1]:g} kg")
            before = [solved.get(key) for key in ((i, k - 1), (i - 1, k))]
            near = [design.point for design in before if design is not None and design.point is not None]
            design = codesign(problem, masses, bandwidth, near)
            if near and design.point is None:
                fresh = codesign(problem, masses, bandwidth)
                colder += fresh.point is not None
                reason = fresh.reason and f"{design.reason}; and from fresh samples: {fresh.reason}"
                design = replace(fresh, reason=reason)
            solved[i, k] = design
    designs = tuple(solved.values())
    return Front(tuple(_lightest_answer(design, designs) for design in designs), colder)
