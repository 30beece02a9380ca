"""Tuning of a lag with second-order sections: grown section by section on samples, then proved and backed off.

A lag comes first. Each further section begins as one that does nothing, at several frequencies, and the whole is
optimised anew; the best few go on. What is returned is proved by the same oracle as every other loop: where it refutes
a limit between the samples, all limits are tightened by what was missing, and the last polish is done again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, log

import numpy as np

from beamdesign.controllers import Controller, Proportional
from beamdesign.design.bandwidth_climb import climb
from beamdesign.design.bandwidth_polish import STIFFER, WORTH, Polish
from beamdesign.design.controller_forms import FORMS, STRUCTURED, ControllerForm, form_named, lag_and_sections
from beamdesign.design.loop_set import LoopSet, loop_set
from beamdesign.design.refinement import LARGEST_BANDWIDTH_HZ, Proved
from beamdesign.design.rig_samples import plants_of, rig_samples, sampled_masses
from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.sampled_loops import Samples, slacks
from beamdesign.design.worst_samples import WorstSamples, worst_rigs
from beamdesign.linear import BilinearPlant
from beamdesign.members import Member
from beamdesign.prototype import Goal

SECTION_HZ = (8.0, 25.0, 70.0, 200.0)
"""Where a new section begins."""

KEPT = 2
"""How many designs of one number of sections the next is grown from."""

PROOFS = 10
"""Most rounds of proof and back-off for one design."""

_NEUTRAL, _APART = 0.7, 1.02
"""Damping ratio of a section that does next to nothing, and how far apart its zeros and poles begin."""

CANDIDATES = 3
"""How many designs are proved, at most."""

_ENOUGH = 0.985
"""Share of the sampled bandwidth which, if proved, ends the search for more."""

_SPARE = 2e-6
"""What limits are tightened by beyond what was missing, for the rounding of figures."""


_PROPORTIONAL = ControllerForm(
    "lag",
    FORMS["lag"].names,
    (FORMS["lag"].bounds[0], (30.0, 30.0), (30.0, 30.0)),
    FORMS["lag"].polynomials,
    lambda values: Proportional(gain_A_per_V=values[0]),
)
"""A lag whose pole and zero are held together."""


@dataclass(frozen=True)
class Grown:
    """Outcome of `grow`.

    Attributes:
        proved: the best loop that was proved; None where there is none.
        sampled: bandwidths (Hz) of all designs with the full number of sections, as sampled.
        certificates: how many exact proofs of a loop were run.
        reason: why nothing was proved, empty where something was.
        worst: of a robust design, (d,) standard deviations of each rig that was proved beside the nominal one.
    """

    proved: Proved | None
    sampled: tuple[float, ...]
    certificates: int
    reason: str = ""
    worst: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class _Task:
    members: Sequence[Member]
    goal: Goal
    masses_kg: tuple[float, float]
    largest_inner: float
    points: Samples
    plants: Sequence[tuple[BilinearPlant, float, int]]
    proportional: bool = False
    least_inner: float = 0.0

    def form(self, sections: int) -> ControllerForm:
        if self.proportional:
            return _PROPORTIONAL
        return form_named(f"{STRUCTURED}{sections}" if sections else "lag")

    def bounds(self, sections: int) -> tuple[np.ndarray, np.ndarray]:
        bounds = np.array([*self.form(sections).log_bounds, (self.least_inner, self.largest_inner)])
        return bounds[:, 0], bounds[:, 1]

    def polish(self, sections: int) -> Polish:
        masses = sampled_masses(self.masses_kg)
        return Polish(self.points, self.goal, self.form(sections).kind, self.plants, masses, *self.bounds(sections))

    def loops(self, variables: np.ndarray, sections: int) -> tuple[LoopSet, Proved, tuple[np.ndarray, ...]]:
        """The exact loops of rounded variables, what stands for them, nothing of it proved yet, and rigs that are off.

        The last are the standard deviations of those that are worst for each limit, whose loops are among the first.
        """
        controller = self.form(sections).rounded([float(value) for value in variables[:-1]])
        inner = round(float(variables[-1]), 6)
        members = list(self.members)
        worst: tuple[np.ndarray, ...] = ()
        if isinstance(self.points, WorstSamples):
            worst = worst_rigs(self.points, self.goal, variables)
            for z in worst:
                members += self.points.spread.members(z)
        found = loop_set(members, controller, inner, self.masses_kg)
        return found, Proved(controller, inner, 0.0, inf, variables), worst


def grow(
    members: Sequence[Member],
    goal: Goal,
    masses_kg: tuple[float, float],
    largest_inner: float,
    sections: int,
    told: Callable[[float, str], None] = lambda share, text: None,
    spread: RigSpread | None = None,
    proportional: bool = False,
) -> Grown:
    """Find the largest guaranteed bandwidth of a lag with so many second-order sections.

    Args:
        members: linear members of the rig.
        goal: limits of compliance, sensitivity, loop gain and effort.
        masses_kg: range of outer end mass.
        largest_inner: most mass that may be added inside, kg.
        sections: how many; none for the lag alone.
        told: the share done and what is being done.
        spread: rigs that are off, among which the worst are to keep all limits as well; none: the nominal rig alone.
        proportional: whether the lag is to do nothing; without sections.
    """
    task = _task(members, goal, masses_kg, largest_inner, spread)
    if proportional:
        task = replace(task, proportional=True)
    told(0.0, "lag")
    pool = _lags(task)
    polishes = 1 + sections * KEPT * len(SECTION_HZ)
    done = 1
    for count in range(1, sections + 1):
        polish = task.polish(count)
        found = []
        for variables, _ in pool[:KEPT]:
            for frequency in SECTION_HZ:
                told(0.9 * done / polishes, f"section {count} of {sections}, from {frequency:g} Hz")
                found.append(polish(_with_section(variables, frequency)))
                done += 1
        pool = _best(found)
    reached = tuple(bandwidth for _, bandwidth in pool)
    certificates, reason = 0, "no start led to a stable loop within the limits on the samples"
    best: Proved | None = None
    worst: tuple[np.ndarray, ...] = ()
    for variables, bandwidth in pool[:CANDIDATES]:
        if bandwidth <= 0 or (best is not None and best.bandwidth_Hz > _ENOUGH * bandwidth):
            continue
        told(0.9, "proving")
        proved, proofs, reason, rigs = _proved(task, variables, sections, bandwidth)
        certificates += proofs
        if proved is not None and (best is None or proved.bandwidth_Hz > best.bandwidth_Hz):
            best, worst = proved, rigs
    return Grown(best, reached, certificates, "" if best else reason, worst)


def grow_on(
    members: Sequence[Member],
    goal: Goal,
    masses_kg: tuple[float, float],
    controller: Controller,
    inner_end_mass: float,
) -> Grown:
    """The largest guaranteed bandwidth near a controller that is given, with the mass inside as it is.

    Args:
        members: linear members that have to be served.
        goal: limits of compliance, sensitivity, loop gain and effort.
        masses_kg: range of outer end mass.
        controller: to begin with; its number of sections stays.
        inner_end_mass: kg, which stays too.
    """
    task = replace(_task(members, goal, masses_kg, inner_end_mass), least_inner=inner_end_mass)
    sections, figures = len(controller.sections), lag_and_sections(controller)
    variables, aimed = task.polish(sections)(np.append(np.log(figures), inner_end_mass))
    proved, certificates, reason, _ = _proved(task, variables, sections, aimed)
    return Grown(proved, (aimed,), certificates, "" if proved else reason)


def _task(
    members: Sequence[Member],
    goal: Goal,
    masses_kg: tuple[float, float],
    largest_inner: float,
    spread: RigSpread | None = None,
) -> _Task:
    """Samples of all loops, and the plants that are to perform with the number of their first row."""
    points = rig_samples(members, goal, masses_kg, spread)
    rows = len(sampled_masses(masses_kg))
    listed = enumerate(plants_of(members))
    plants = [(plant, factor, k * rows) for k, (plant, factor, performs) in listed if performs]
    return _Task(members, goal, masses_kg, largest_inner, points, plants)


def _lags(task: _Task) -> list[tuple[np.ndarray, float]]:
    """Lags to grow from: climbed from small gains, with little and with much mass inside."""
    polish, (lower, upper) = task.polish(0), task.bounds(0)
    found = []
    for inner in sorted({0.0, 0.3 * task.largest_inner}):
        start = np.array([log(3e-3), log(1.0), log(30.0), inner])
        while not slacks(task.points, task.goal, start, slopes=False).settled and start[0] > lower[0]:
            start[0] -= 0.5
        found.append(polish(climb(task.points, task.goal, start, lower, upper, most=100).variables))
    return _best(found)


def _with_section(variables: np.ndarray, frequency_Hz: float) -> np.ndarray:
    """The variables with one more section, which does next to nothing."""
    more = [log(frequency_Hz * _APART), log(_NEUTRAL), log(frequency_Hz / _APART), log(_NEUTRAL)]
    return np.concatenate([variables[:-1], more, variables[-1:]])


def _best(found: Sequence[tuple[np.ndarray, float]]) -> list[tuple[np.ndarray, float]]:
    """Variables and bandwidths, the largest first, each bandwidth once."""
    chosen: list[tuple[np.ndarray, float]] = []
    for variables, bandwidth in sorted(found, key=lambda pair: -pair[1]):
        if not chosen or bandwidth < chosen[-1][1] * (1 - 1e-3):
            chosen.append((variables, bandwidth))
    return chosen


def _proved(
    task: _Task, variables: np.ndarray, sections: int, aimed: float
) -> tuple[Proved | None, int, str, tuple[np.ndarray, ...]]:
    """The best loop proved at the variables or a little inside the limits; how many proofs that took; or why none.

    Of a robust design also the rigs it was proved of beside the nominal one.

    A compliance that touches its limit far below the bandwidth costs most of it: then more of it is kept to spare.
    """
    polish, inside, stiffer, reason = task.polish(sections), 0.0, STIFFER, ""
    best: Proved | None = None
    rigs: tuple[np.ndarray, ...] = ()
    for proofs in range(1, PROOFS + 1):
        loops, found, worst = task.loops(variables, sections)
        if loops.unstable():
            return best, proofs, "the loop is not stable over the whole range", rigs
        refuted = loops.refuted(task.goal)
        if refuted:
            reason = f"{refuted[0][0].kind.replace('_', ' ')} refuted: {refuted[0][0].reason}"
            inside += loops.excess(task.goal) + _SPARE
        else:
            bandwidth = min(*loops.bandwidths(task.goal.compliance_m_per_N).values(), LARGEST_BANDWIDTH_HZ)
            if best is None or bandwidth > best.bandwidth_Hz:
                peak = min(loops.peak_sensitivity(), task.goal.peak_sensitivity)
                kept = np.append(variables, log(max(bandwidth, 1e-9)))
                best = Proved(found.controller, found.inner_end_mass_kg, bandwidth, peak, kept)
                rigs = worst
            if bandwidth > _ENOUGH * aimed:
                break
            stiffer *= 3
        if not inside < inf:
            break
        for worth in (WORTH, inf):
            before, reach = variables, max(0.1, 10 * inside)
            variables, _ = polish(before, inside, stiffer, rounds=6, reach=reach, worth=worth)
            if not refuted or not np.array_equal(before, variables):
                break
        else:
            break
    return best, proofs, "" if best else reason, rigs
