"""Co-design: sections, inner end mass and controller together, at least moving mass for a guaranteed bandwidth.

And the Pareto front of moving mass against guaranteed bandwidth against payload range, every point proved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf
from operator import le
from typing import Any

import numpy as np

from beamdesign.arguments import checked, takes
from beamdesign.controllers import KINDS
from beamdesign.controllers.protocol import form_of
from beamdesign.plant.assembly import most_inside_kg
from beamdesign.plant.members import family
from beamdesign.problem import DesignProblem
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.quantities import Bandwidth, Sigmas
from beamdesign.records import InputError
from beamdesign.result import Result, finite, picked
from beamdesign.structure import lumped
from beamdesign.synthesis import POINT, SIGMAS
from beamdesign.synthesis.changes import in_words
from beamdesign.synthesis.checks import CheckedPair, check_sections
from beamdesign.synthesis.free_search import free_optimum, sizes_of, start_variables, tubes
from beamdesign.synthesis.holding import Holding, working
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.law_search import Found, search
from beamdesign.synthesis.law_starts import from_seeds
from beamdesign.synthesis.law_task import Effort, Search
from beamdesign.synthesis.loop_samples import Design, form_for
from beamdesign.synthesis.rig_spread import rig_spread
from beamdesign.synthesis.sections import Sections
from beamdesign.time_limit import leave_out, over, within

SIZED_EFFORT = Effort(rounds=10, starts=2, candidates=2, proofs=20)
"""Where the sections of the beams are searched as well."""

_LARGER = (1.0, 1.2, 1.5)
"""Of how many times the size of the lightest sections others are begun with."""


@dataclass(frozen=True)
class CodesignPoint(CheckedPair):
    """A design with every guarantee proved and every check satisfied.

    Attributes:
        prototype: sections, controller and inner end mass.
        proved: the guaranteed figures, and the variables to start a neighbouring problem from.
    """

    prototype: Prototype
    proved: Proved

    @property
    def inner_end_mass_kg(self) -> float:
        """Mass added to the inner tip."""
        return self.proved.inner_end_mass_kg

    @property
    def moving_mass_kg(self) -> float:
        """Both beams over their full length and the mass added inside."""
        return self.beam_mass_kg + self.inner_end_mass_kg

    def columns(self) -> dict[str, Any]:
        """Its columns in a table."""
        return picked(self, f"{POINT} governing") | self.proved.columns()


@dataclass(frozen=True, repr=False)
class Codesign(Result):
    """Outcome of `codesign`.

    Attributes:
        bandwidth_Hz: asked for.
        outer_end_mass_kg: range of the guarantee.
        point: lightest proved design, None where there is none.
        attempts: per start the proved moving mass in kg, or in words why it failed.
        reason: why there is no design, empty where there is one.
        holding: whether the actuator of a proved design holds load and weight.
        left_out: what was not tried for want of time, in words.
    """

    bandwidth_Hz: float
    outer_end_mass_kg: tuple[float, float]
    point: CodesignPoint | None
    attempts: tuple[float | str, ...]
    reason: str = ""
    holding: Holding | None = None
    left_out: tuple[str, ...] = ()

    @property
    def change(self) -> tuple[str, ...]:
        """What to change where load and weight are not held, each entry enough by itself."""
        return () if self.holding is None else in_words(self.holding.ways)

    @property
    def caution(self) -> str:
        """What is to be heeded of the design; empty where there is nothing."""
        return "" if self.holding is None else self.holding.caution

    @property
    def prototype(self) -> Prototype | None:
        """The rig of the design."""
        return None if self.point is None else self.point.prototype

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        if self.point is None:
            return finite(picked(self, "reason change attempts"))
        masses = picked(self.point, "moving_mass_kg beam_mass_kg inner_end_mass_kg governing")
        chosen = picked(self.point, "outer=outer.sizes inner=inner.sizes controller=proved.controller")
        checks = [picked(check, "name value limit utilisation") for check in self.point.checks]
        return finite(masses | chosen | {"checks": checks, "attempts": self.attempts, "caution": self.caution})

    def columns(self) -> dict[str, Any]:
        """Its row in a table of many."""
        asked = {
            "bandwidth_asked_Hz": self.bandwidth_Hz,
            "outer_end_mass_low_kg": self.outer_end_mass_kg[0],
            "outer_end_mass_high_kg": self.outer_end_mass_kg[1],
            "proved": self.point is not None,
            "reason": self.reason,
        }
        return asked | ({} if self.point is None else self.point.columns())


def _point(problem: DesignProblem, masses_kg: tuple[float, float], proved: Proved) -> CodesignPoint:
    """The finished design of a proved loop, whose sections have no structural flaw."""
    variables = proved.variables[form_of(proved.controller.kind).size + 1 :]
    pair = check_sections(problem, *tubes(problem, variables, rounded=True))
    bare = problem.prototype(pair.outer, pair.inner)
    prototype = bare.with_law(proved.controller, masses_kg, proved.inner_end_mass_kg)
    return CodesignPoint(**vars(pair), prototype=prototype, proved=proved)


@takes("DesignProblem")
def codesign(
    problem: DesignProblem,
    outer_end_mass_kg: tuple[float, float] | None,
    bandwidth_Hz: float,
    near: Sequence[CodesignPoint] = (),
    progress: Progress | None = None,
    sigmas: float = SIGMAS,
    minutes: float | None = None,
) -> Codesign:
    """Find the lightest sections, end mass and controller that guarantee a bandwidth over a payload range.

    Args:
        problem: load, lengths, materials, hydraulics and limits; its sections are free.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed; None: the problem's.
        bandwidth_Hz: needed; |x / F_d| stays at or below the goal up to there.
        near: solved neighbouring problems to start from as well (for one controller kind).
        progress: told the share done and what is being done.
        sigmas: as of `beamdesign.synthesis.tuning.tune`, as `minutes`.
        minutes: after about which the best that was proved until then is the answer.

    Raises:
        InputError: for a kind of controller that is not tuned from a seed of its own, or for figures that are not
            plausible.
        ValueError: for an empty range.
    """
    masses_kg = problem.asked_kg(outer_end_mass_kg)
    checked(problem.name, "bandwidth_Hz", Bandwidth, bandwidth_Hz)
    checked(problem.name, "sigmas", Sigmas, sigmas)
    kind, report = problem.controller.kind, progress or silent
    if kind not in KINDS or not any(seed.kind == kind for seed in KINDS[kind].seeds()):
        reason = f"{kind!r} is not for sections and controller together, which are sought with few figures; give a lag"
        raise InputError(problem.name, [("controller.kind", reason)])
    with within(minutes) as limit:
        report(0.0, "lightest sections")
        begun = [Sections(problem, start_variables(problem, one), bandwidth_Hz) for one in _start_sizes(problem)]
        tasks = [sized_search(problem, one, masses_kg, sigmas) for one in begun if one.possible]
        nothing = "" if tasks else "no sections pass the structural checks; `beamdesign size` says which to relax"
        forms = [form_for(form_of(kind), task.members[0].rig.figures) for task in tasks[:1]]
        starts = [Design(form, point.proved.variables) for form in forms for point in near] or [
            start for task in tasks for start in from_seeds(task, KINDS[kind].seeds())
        ]
        found = search(tasks[0], starts, report=report) if tasks else Found(None, (), 0, nothing)
        more = "; no time was left for more" * over()
    attempts = tuple(
        one.reason if one.proved is None else _point(problem, masses_kg, one.proved).moving_mass_kg
        for one in found.tried
    )
    if found.proved is None:
        low, high = masses_kg
        why = ("; ".join(dict.fromkeys(one.reason for one in found.tried)) or found.reason) + more
        reason = f"no start led to a proved design for {bandwidth_Hz:g} Hz over {low:g} to {high:g} kg: {why}"
        return Codesign(bandwidth_Hz, masses_kg, None, attempts, reason, left_out=tuple(limit.left_out))
    point = _point(problem, masses_kg, found.proved)
    held = working(problem, point.prototype, masses_kg, point.proved.bandwidth_Hz)
    answer = bandwidth_Hz, masses_kg, None if held.reason else point, attempts, held.reason
    return Codesign(*answer, holding=held, left_out=tuple(limit.left_out))


def _start_sizes(problem: DesignProblem) -> list[np.ndarray]:
    """Sizes (4,) in m of the sections that are begun with: the lightest pair, larger ones like it, the given."""
    known = [] if problem.given is None else [problem.given]
    lightest = free_optimum(problem, known)
    found = [] if lightest is None else [sizes_of((lightest.pair.outer, lightest.pair.inner))]
    return [factor * sizes for sizes in found for factor in _LARGER] + [sizes_of(pair) for pair in known]


def sized_search(
    problem: DesignProblem, sections: Sections, masses_kg: tuple[float, float], sigmas: float, most_inside: float = inf
) -> Search:
    """The search for a law of a problem and for sections, begun with those of tubes that there are.

    There is no more mass inside (kg) than the problem allows or this.
    """
    rig = sections.prototype(sections.start, False)
    spread = rig_spread(rig, masses_kg[1], sigmas) if sigmas else None
    allowed = problem.controller.largest_inner_end_mass_kg
    most = min(most_inside, most_inside_kg(lumped.figures(rig), masses_kg[1]) if allowed is None else allowed)
    given = (family(rig).members, problem.goal, masses_kg, (0.0, most))
    return Search(*given, spread=spread, effort=SIZED_EFFORT, sections=sections)


@dataclass(frozen=True, repr=False)
class Front(Result):
    """Co-designs over a grid of requirements.

    Attributes:
        designs: one per payload range and bandwidth, bandwidths within ranges; those without a point carry the reason.
        left_out: what was not tried for want of time, in words.
    """

    designs: tuple[Codesign, ...]
    left_out: tuple[str, ...] = ()

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
        every: dict[tuple[float, ...], Codesign] = {}
        for design in self.proved:
            every.setdefault(_merits(design), design)
        beaten = {own for own in every for other in every if other != own and all(map(le, other, own))}
        return tuple(design for own, design in every.items() if own not in beaten)

    @property
    def reason(self) -> str:
        """Why there is no proved design at all; empty where there is one."""
        return "" if self.proved else "; ".join(dict.fromkeys(design.reason for design in self.designs))

    def rows(self) -> list[tuple[str, Any]]:
        """The moving mass of every point, kg, or why there is none."""
        found = ((one, *one.outer_end_mass_kg, one.point) for one in self.designs)
        return [
            (f"kg for {one.bandwidth_Hz:g} Hz, {low:g} to {high:g} kg", point.moving_mass_kg if point else one.reason)
            for one, low, high, point in found
        ]

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it: all points, and the efficient ones."""
        points, efficient = ([one.columns() for one in some] for some in (self.designs, self.efficient))
        return finite({"points": points, "efficient": efficient})


def _merits(design: Codesign) -> tuple[float, ...]:
    """Moving mass, guaranteed bandwidth turned round, and the range's ends so that less is better in each."""
    assert design.point is not None
    low, high = design.outer_end_mass_kg
    return design.point.moving_mass_kg, -design.point.proved.bandwidth_Hz, low, -high


def _lightest_answer(asked: Codesign, designs: Sequence[Codesign]) -> Codesign:
    """What was asked with the lightest of all designs that meet it; with its own reason where none does."""
    low, high = asked.outer_end_mass_kg
    wide = [one.point for one in designs if one.outer_end_mass_kg[0] <= low and one.outer_end_mass_kg[1] >= high]
    points = [one for one in wide if one is not None and one.proved.bandwidth_Hz >= asked.bandwidth_Hz]
    if not points:
        return asked
    return replace(asked, point=min(points, key=lambda point: point.moving_mass_kg), reason="")


@takes("DesignProblem")
def front(
    problem: DesignProblem,
    bandwidths_Hz: Sequence[float],
    ranges_kg: Sequence[tuple[float, float]] = (),
    progress: Progress | None = None,
    sigmas: float = SIGMAS,
    minutes: float | None = None,
) -> Front:
    """Co-design along a front, each point starting from its solved neighbours in bandwidth and in payload.

    Where the neighbours lead to no proof, fresh samples are tried; both failures together are the point's reason. Where
    a design found for more bandwidth or payload is lighter, or the only one, it answers what asks for less as well.

    Args:
        problem: as for `codesign`.
        bandwidths_Hz: needed bandwidths.
        ranges_kg: ranges of outer end mass; else the problem's alone.
        progress: told the share done and what is being done.
        sigmas: as of `beamdesign.synthesis.tuning.tune`.
        minutes: as of `codesign`; points that are not come to are told with that reason.

    Raises:
        InputError: as `codesign`, and without a bandwidth.
        ValueError: for an empty range.
    """
    if len(bandwidths_Hz) == 0:
        raise InputError(problem.name, [("bandwidths_Hz", "holds no bandwidth, so that there is no front")])
    report = progress or silent
    bandwidths = sorted(set(bandwidths_Hz))
    solved: dict[tuple[int, int], Codesign] = {}
    asked = [problem.asked_kg(one) for one in ranges_kg] or [problem.asked_kg()]
    ranges = list(dict.fromkeys(asked))
    total = len(ranges) * len(bandwidths)
    with within(minutes) as limit:
        for (i, masses), (k, bandwidth) in product(enumerate(ranges), enumerate(bandwidths)):
            words = f"{bandwidth:g} Hz over {masses[0]:g} to {masses[1]:g} kg"
            if solved and over():
                leave_out(words)
                solved[i, k] = Codesign(bandwidth, masses, None, (), "no time was left for it")
                continue
            report(len(solved) / total, words)
            before = [solved[key] for key in ((i, k - 1), (i - 1, k)) if key in solved]
            near = [design.point for design in before if design.point is not None]
            design = codesign(problem, masses, bandwidth, near, sigmas=sigmas)
            if near and design.point is None and not over():
                fresh = codesign(problem, masses, bandwidth, sigmas=sigmas)
                reason = fresh.reason and f"{design.reason}; and from fresh samples: {fresh.reason}"
                design = replace(fresh, reason=reason)
            solved[i, k] = design
    designs = tuple(solved.values())
    return Front(tuple(_lightest_answer(design, designs) for design in designs), tuple(limit.left_out))
