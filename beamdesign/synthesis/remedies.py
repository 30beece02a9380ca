"""The four remedies of Zalucky and Hardt (1984) for mass at the tip, each optimised for the same payload and proof.

They are, in the paper's order (section "Effect of a Load Mass"): a stiffer outer beam; a heavier or softer inner beam;
a controller with more phase; parameters that follow the payload. All start from the same sections, re-tune the lag, may
besides change only what their name says, and may add no more than a given moving mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, log
from typing import Any

import numpy as np

from beamdesign.arguments import checked, takes
from beamdesign.controllers import Lag
from beamdesign.controllers.cascade import as_lag
from beamdesign.controllers.protocol import form_of
from beamdesign.problem import DesignProblem
from beamdesign.progress import Progress, silent
from beamdesign.quantities import MassOrNone, Sigmas
from beamdesign.records import InputError
from beamdesign.result import Result, finite, picked
from beamdesign.structure.materials import BEAMS
from beamdesign.structure.section import Tube
from beamdesign.synthesis import REMEDY, SIGMAS
from beamdesign.synthesis.codesign import sized_search
from beamdesign.synthesis.free_search import sizes_of, start_variables, tubes
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.law_search import Found, search
from beamdesign.synthesis.law_starts import from_seeds
from beamdesign.synthesis.loop_samples import Design, form_for
from beamdesign.synthesis.sections import Sections, section_mass
from beamdesign.synthesis.tuning import SMALLEST_BANDWIDTH_HZ
from beamdesign.time_limit import share

PAPER_BREAKS_HZ = (1.75, 26.0)
"""Lag breaks of the paper, kept where no remedy is applied, on a link that is as quick."""

_LARGER = ((1.0, 1.0), (1.1, 1.6))
"""Of how many times the given width and wall the sections that may change are begun with."""

SCHEDULE_PARTS = 4
"""Parts of the payload range with a lag of their own."""

SCHEDULE_OVERLAP = 0.25
"""Share of a part by which its proof reaches into both neighbours: what the estimate of the payload may be wrong by."""


@dataclass(frozen=True, repr=False)
class Remedy(Result):
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
    outer: Tube
    inner: Tube
    inner_end_mass_kg: float
    proved: tuple[Proved, ...]
    parts_kg: tuple[tuple[float, float], ...]
    reason: str = ""

    @property
    def controllers(self) -> tuple[Lag, ...]:
        """The lag of each part."""
        return tuple(as_lag(proved.controller) for proved in self.proved)

    def to_dict(self) -> dict[str, Any]:
        """Its row in a table."""
        laws = (f"{c.gain_A_per_V:.6g} A/V, {c.pole_Hz:.6g}/{c.zero_Hz:.6g} Hz" for c in self.controllers)
        parts = (f"{low:g} to {high:g}" for low, high in self.parts_kg)
        words = {"controllers": "; ".join(laws), "parts_kg": "; ".join(parts), "reason": self.reason}
        return finite({"remedy": self.name, **picked(self, REMEDY), **words})


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


def _remedy(
    freedom: _Freedom,
    problem: DesignProblem,
    masses_kg: tuple[float, float],
    added_mass_kg: float,
    sigmas: float,
    near: Sequence[Proved] = (),
) -> Remedy:
    """The largest guaranteed bandwidth within a remedy's freedom, from seeds and from proved loops of a like one."""
    assert problem.given is not None  # `remedies` has seen that they are given
    given = start_variables(problem, sizes_of(problem.given))  # (8,)
    free, inside_kg = list(freedom.sections), added_mass_kg if freedom.inner_end_mass else 0.0
    pole, zero = PAPER_BREAKS_HZ
    seeds = Lag.seeds() if freedom.breaks else (Lag(gain_A_per_V=3e-3, pole_Hz=pole, zero_Hz=zero),)
    most = section_mass(problem, given) + added_mass_kg
    tasks = []
    for larger in _LARGER if free else _LARGER[:1]:
        sizes = given.copy()
        sizes[free] *= larger[: len(free)]
        sections = Sections(problem, sizes, largest_mass_kg=most, free=free)
        if sections.possible:
            tasks.append(sized_search(problem, sections, masses_kg, sigmas, inside_kg))
    found = Found(None, (), 0, "no tubes within the limits of [sections] go with the one that stays as it is")
    if tasks:
        form = form_for(form_of("lag"), tasks[0].members[0].rig.figures)
        if not freedom.breaks:
            breaks = np.log(PAPER_BREAKS_HZ) + log(tasks[0].pace)
            form = replace(form, lower=np.append(form.lower[0], breaks), upper=np.append(form.upper[0], breaks))
        starts = [np.append(proved.variables[: -len(given)], given) for proved in near]
        starts += [one.variables for task in tasks for one in from_seeds(task, seeds)]
        found = search(tasks[-1], [Design(form, one) for one in starts])
    proved = found.proved
    if proved is None or proved.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
        reason = found.reason or f"guarantees no bandwidth above {SMALLEST_BANDWIDTH_HZ:g} Hz"
        return Remedy(freedom.name, 0.0, 0.0, inf, *tubes(problem, given, rounded=True), 0.0, (), (masses_kg,), reason)
    sizes = proved.variables[-len(given) :]
    added = section_mass(problem, sizes) - section_mass(problem, given) + proved.inner_end_mass_kg
    figures = freedom.name, added, proved.bandwidth_Hz, proved.peak_sensitivity
    pair = tubes(problem, sizes, rounded=True)
    return Remedy(*figures, *pair, proved.inner_end_mass_kg, (proved,), (masses_kg,))


def _no_worse(found: Remedy, known: Remedy) -> Remedy:
    """What a remedy came to, or else what is known of a loop that it may leave as it is."""
    if found.bandwidth_Hz >= known.bandwidth_Hz:
        return found
    return replace(known, name=found.name, parts_kg=found.parts_kg)


def _scheduled(problem: DesignProblem, masses_kg: tuple[float, float], whole: Remedy, sigmas: float) -> Remedy:
    """One lag per part of the range, each proved on its part and some way into its neighbours.

    What is proved for the whole range is proved for each part, and so is a start for each.
    """
    edges = np.linspace(*masses_kg, SCHEDULE_PARTS + 1)
    reach = SCHEDULE_OVERLAP * (edges[1] - edges[0])
    reached = (
        (float(max(masses_kg[0], low - reach)), float(min(masses_kg[1], high + reach))) for low, high in pairwise(edges)
    )
    parts = list(dict.fromkeys(reached))  # of one payload a single one
    found = []
    for k, part in enumerate(parts):
        with share(1 / (len(parts) - k)):
            found.append(_no_worse(_remedy(SCHEDULED, problem, part, 0.0, sigmas, whole.proved), whole))
    why = [f"{low:g} to {high:g} kg: {one.reason}" for (low, high), one in zip(parts, found, strict=True) if one.reason]
    return replace(
        found[0],
        bandwidth_Hz=min(one.bandwidth_Hz for one in found),
        peak_sensitivity=max(one.peak_sensitivity for one in found),
        proved=tuple(proved for one in found for proved in one.proved),
        parts_kg=tuple(parts),
        reason="; ".join(why),
    )


@takes("DesignProblem")
def remedies(
    problem: DesignProblem,
    outer_end_mass_kg: tuple[float, float] | None,
    added_mass_kg: float,
    progress: Progress | None = None,
    sigmas: float = SIGMAS,
    numbers: Sequence[int] | None = None,
) -> tuple[Remedy, ...]:
    """Optimise each remedy from the problem's given sections, for the same payload range, limits and proof.

    The scheduled lag, which starts from the one with more phase, is proved for every constant payload of each part;
    what happens while the payload changes is not part of this proof.

    Args:
        problem: its given sections, limits and hydraulics.
        outer_end_mass_kg: range of the payload; None: the problem's.
        added_mass_kg: most moving mass that a remedy may add.
        progress: told the share done and what is being done.
        sigmas: as of `beamdesign.synthesis.tuning.tune`.
        numbers: which of them, ascending: 0 the untouched loop, 1 to 4 the remedies in the paper's order; else all.

    Raises:
        InputError: for figures that are not plausible, and beams whose sections are not given.
        ValueError: for an empty range.
    """
    masses_kg = problem.asked_kg(outer_end_mass_kg)
    checked(problem.name, "added_mass_kg", MassOrNone, added_mass_kg)
    checked(problem.name, "sigmas", Sigmas, sigmas)
    if missing := [name for name in BEAMS if getattr(problem, name).width_m is None]:
        reason = "the remedies start from given sections: width_m and wall_m are needed"
        raise InputError(problem.name, [(name, reason) for name in missing])
    report, asked = progress or silent, (problem, masses_kg, added_mass_kg, sigmas)
    every = (*FREEDOMS, SCHEDULED)
    chosen = every if numbers is None else [every[number] for number in numbers]
    found: list[Remedy] = []
    for k, freedom in enumerate(chosen):
        report(k / len(chosen), freedom.name)
        with share(1 / (len(chosen) - k)):
            if freedom is SCHEDULED:
                begun = [one for one in found if one.name == FREEDOMS[-1].name] or [_remedy(FREEDOMS[-1], *asked)]
                found.append(_scheduled(problem, masses_kg, begun[0], sigmas))
            elif found and found[0].name == UNTOUCHED.name:
                found.append(_no_worse(_remedy(freedom, *asked, found[0].proved), found[0]))
            else:
                found.append(_remedy(freedom, *asked))
    return tuple(found)
