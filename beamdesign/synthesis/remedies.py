"""The four remedies of Zalucky and Hardt (1984) for mass at the tip, each optimised for the same payload and proof.

They are, in the paper's order (section "Effect of a Load Mass"): a stiffer outer beam; a heavier or softer inner beam;
a controller with more phase; parameters that follow the payload. All start from the same sections, re-tune the lag, may
besides change only what their name says, and may add no more than a given moving mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.stats import qmc

from beamdesign.controllers import Lag
from beamdesign.controllers.form import form_of
from beamdesign.controllers.structured import as_lag
from beamdesign.problem import DesignProblem
from beamdesign.progress import Progress, silent
from beamdesign.structure.section import SquareTube
from beamdesign.synthesis.codesign import (
    ROUNDED_SLACK,
    codesign_program,
    rounded_tubes,
    section_mass,
    sizing_parts,
    structural_flaw,
)
from beamdesign.synthesis.free_search import start_variables
from beamdesign.synthesis.refinement import LoopProgram, Proved, refine
from beamdesign.synthesis.starts import best_starts
from beamdesign.synthesis.tuning import SMALLEST_BANDWIDTH_HZ

PAPER_BREAKS_HZ = (1.75, 26.0)
"""Lag breaks of the paper, kept where no remedy is applied."""

SAMPLES, STARTS = 128, 2
_ROUNDED_MASS_KG = 5e-4
"""By how much rounding the sizes may add to the mass."""

SCHEDULE_PARTS = 4
"""Parts of the payload range with a lag of their own."""

SCHEDULE_OVERLAP = 0.25
"""Share of a part by which its proof reaches into both neighbours: what the estimate of the payload may be wrong by."""


@dataclass(frozen=True)
class Remedy:
    """One remedy, optimised and proved.

    Attributes:
        name: in the paper's words, shortened.
        added_mass_kg: moving mass beyond the bare sections.
        bandwidth_Hz: guaranteed for every payload of the range, 0 where nothing was proved.
        peak_sensitivity: proved bound; infinite where nothing was proved.
        outer: outer tube.
        inner: inner tube.
        inner_end_mass_kg: mass added inside.
        proved: one loop per part of the payload range.
        parts_kg: the ranges of outer end mass over which each of them is proved.
        reason: why nothing was proved, empty where something was.
    """

    name: str
    added_mass_kg: float
    bandwidth_Hz: float
    peak_sensitivity: float
    outer: SquareTube
    inner: SquareTube
    inner_end_mass_kg: float
    proved: tuple[Proved, ...]
    parts_kg: tuple[tuple[float, float], ...]
    reason: str = ""

    @property
    def controllers(self) -> tuple[Lag, ...]:
        """The lag of each part."""
        return tuple(as_lag(proved.controller) for proved in self.proved)


@dataclass(frozen=True)
class _Freedom:
    """What a remedy may change: section variables by index, inner end mass, lag breaks."""

    name: str
    sections: tuple[int, ...] = ()
    inner_end_mass: bool = False
    breaks: bool = True


UNTOUCHED = _Freedom("none: the paper's breaks, gain alone", breaks=False)
FREEDOMS = (
    UNTOUCHED,
    _Freedom("stiffer outer beam", sections=(0, 1)),
    _Freedom("heavier or softer inner beam", sections=(2, 3), inner_end_mass=True),
    _Freedom("more phase from the controller"),
)
SCHEDULED = _Freedom("lag scheduled on the payload")


def _program(
    problem: DesignProblem, freedom: _Freedom, masses_kg: tuple[float, float], added_mass_kg: float
) -> LoopProgram:
    """Largest guaranteed bandwidth within a remedy's freedom."""
    form = form_of("lag")
    count = form.size
    base = _given(problem)
    bare_mass = section_mass(problem, base)
    lightest = codesign_program(problem, form, masses_kg, bandwidth_Hz=500.0)
    parts = sizing_parts(problem)
    lower, upper = lightest.lower.copy(), lightest.upper.copy()
    if not freedom.breaks:
        lower[1:count] = upper[1:count] = np.log(PAPER_BREAKS_HZ)
    upper[count] = min(problem.controller.largest_inner_end_mass_kg, added_mass_kg) if freedom.inner_end_mass else 0.0
    for index in set(range(4)) - set(freedom.sections):
        lower[count + 2 + index] = upper[count + 2 + index] = base[index]
    if not freedom.sections:
        lower[count + 2 :] = upper[count + 2 :] = base

    def structure(variables: ca.MX) -> ca.MX:
        constraints, mass = parts(variables[count + 2 :])
        budget = bare_mass + added_mass_kg - mass - variables[count]
        return ca.vertcat(-constraints - ROUNDED_SLACK, budget - _ROUNDED_MASS_KG) if freedom.sections else ca.MX(0, 1)

    def flaw(variables: np.ndarray) -> str:
        """Sections that were not chosen here need not pass: the given ones are what a remedy is compared with."""
        if not freedom.sections:
            return ""
        added = section_mass(problem, variables[count + 2 :]) + float(variables[count]) - bare_mass
        if added > added_mass_kg:
            return f"adds {added:.6g} kg, more than {added_mass_kg:g} kg"
        return structural_flaw(problem, variables[count + 2 :])

    return replace(
        lightest,
        structure=structure,
        objective=lambda variables: -variables[count + 1],
        lower=lower,
        upper=upper,
        flaw=flaw,
        cost=lambda proved: -proved.bandwidth_Hz,
    )


def _given(problem: DesignProblem) -> np.ndarray:
    """Section variables of the problem's given sections, (8,)."""
    if problem.given is None:
        raise ValueError("the remedies start from given sections: width_m and wall_m of both beams")
    return start_variables(problem, np.ravel(problem.given))


def _best(program: LoopProgram, problem: DesignProblem, near: Sequence[Proved]) -> Proved | str:
    """The best proved loop of a program, from samples and from proved loops of a like one, or why there is none."""
    head = program.form.size + 2
    unit = qmc.Sobol(len(program.lower), scramble=True, rng=0).random(SAMPLES)
    samples = program.lower + unit * (program.upper - program.lower)
    free = (program.upper - program.lower)[head:] > 0
    # Sections are sampled near the given ones: what is asked is how far to move from them.
    given = _given(problem)
    samples[:, head:] = np.where(free, given * (1 + 0.25 * (unit[:, head:] - 0.5)), given)
    samples = np.vstack([samples, np.concatenate([program.lower[:head], given])])
    starts, _ = best_starts(program, samples, lambda variables: -float(variables[head - 1]), STARTS)
    refined = [
        refine(program, start, SMALLEST_BANDWIDTH_HZ) for start in (*starts, *(proved.variables for proved in near))
    ]
    proved = [refinement.proved for refinement in refined if refinement.proved is not None]
    if proved:
        return max(proved, key=lambda found: found.bandwidth_Hz)
    reasons = dict.fromkeys(refinement.reason for refinement in refined)
    return "; ".join(reasons) or "no gain meets the peak sensitivity over the whole range"


def _remedy(
    problem: DesignProblem,
    freedom: _Freedom,
    masses_kg: tuple[float, float],
    added_mass_kg: float,
    near: Sequence[Proved] = (),
) -> Remedy:
    program = _program(problem, freedom, masses_kg, added_mass_kg)
    head = program.form.size + 2
    found = _best(program, problem, near)
    if isinstance(found, str):
        outer, inner = rounded_tubes(_given(problem))
        return Remedy(freedom.name, 0.0, 0.0, float("inf"), outer, inner, 0.0, (), (masses_kg,), found)
    outer, inner = rounded_tubes(found.variables[head:])
    added = section_mass(problem, found.variables[head:]) - section_mass(problem, _given(problem))
    return Remedy(
        freedom.name,
        added + found.inner_end_mass_kg,
        found.bandwidth_Hz,
        found.peak_sensitivity,
        outer,
        inner,
        found.inner_end_mass_kg,
        (found,),
        (masses_kg,),
    )


def _scheduled(problem: DesignProblem, masses_kg: tuple[float, float], near: Sequence[Proved]) -> Remedy:
    """One lag per part of the range, each proved on its part and some way into its neighbours.

    What is proved for the whole range is proved for each part, and so is a start for each.
    """
    edges = np.linspace(*masses_kg, SCHEDULE_PARTS + 1)
    reach = SCHEDULE_OVERLAP * (edges[1] - edges[0])
    parts = [
        (float(max(masses_kg[0], low - reach)), float(min(masses_kg[1], high + reach))) for low, high in pairwise(edges)
    ]
    found = [_remedy(problem, SCHEDULED, part, 0.0, near) for part in parts]
    failed = [
        f"{low:g} to {high:g} kg: {one.reason}" for (low, high), one in zip(parts, found, strict=True) if one.reason
    ]
    return replace(
        found[0],
        bandwidth_Hz=min(one.bandwidth_Hz for one in found),
        peak_sensitivity=max(one.peak_sensitivity for one in found),
        proved=tuple(proved for one in found for proved in one.proved),
        parts_kg=tuple(parts),
        reason="; ".join(failed),
    )


def remedies(
    problem: DesignProblem,
    outer_end_mass_kg: tuple[float, float],
    added_mass_kg: float,
    progress: Progress | None = None,
) -> tuple[Remedy, ...]:
    """Optimise each remedy from the problem's given sections, for the same payload range, limits and proof.

    The scheduled lag is proved for every constant payload of each part; what happens while the payload changes is not
    part of this proof.

    Args:
        problem: its given sections, limits and hydraulics.
        outer_end_mass_kg: range of the payload.
        added_mass_kg: most moving mass that a remedy may add.
        progress: told the share done and what is being done.

    Returns:
        The untouched loop first, then the four remedies in the paper's order.
    """
    report = progress or silent
    found = []
    for k, freedom in enumerate(FREEDOMS):
        report(k / (len(FREEDOMS) + 1), freedom.name)
        found.append(_remedy(problem, freedom, outer_end_mass_kg, added_mass_kg))
    report(len(FREEDOMS) / (len(FREEDOMS) + 1), SCHEDULED.name)
    return (*found, _scheduled(problem, outer_end_mass_kg, found[-1].proved))


def one_remedy(
    problem: DesignProblem, number: int, outer_end_mass_kg: tuple[float, float], added_mass_kg: float
) -> Remedy:
    """One entry of `remedies`, by its place there; the scheduled lag starts from the one with more phase.

    Raises:
        IndexError: where there is no such remedy.
    """
    if number == len(FREEDOMS):
        near = _remedy(problem, FREEDOMS[-1], outer_end_mass_kg, added_mass_kg)
        return _scheduled(problem, outer_end_mass_kg, near.proved)
    return _remedy(problem, FREEDOMS[number], outer_end_mass_kg, added_mass_kg)
