"""The one engine of tuning: from laws that are given or grown to the largest bandwidth that is proved.

Laws are searched for coarsely and refined on samples of all loops; what grows is grown and refined anew, the best few
go on. What is returned is proved by the same oracle as every other loop: where it refutes a limit between the samples,
the peak that stood there joins them, all limits are tightened by what was missing, and the refinement is done again.

Of a robust search limits are held on samples at the worst rig of every point; of the best design the worst rigs are
collected, and each is proved over the whole payload range as the nominal one is. The rigs between are not proved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.controllers.form import Form
from beamdesign.progress import Progress, silent
from beamdesign.rational import nearest
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_limits import LARGEST_BANDWIDTH_HZ, Proved, loop_set
from beamdesign.synthesis.loop_slacks import worst_rigs
from beamdesign.synthesis.refinement import TOUCH, WORTH

_FIRST_ROUNDS = 5
"""Of a refinement of many, before the best of them are refined for good."""

_FURTHER = 0.2
"""How far a variable may move in a step of the last refinement."""

_ENOUGH = 0.985
"""Share of the sampled bandwidth which, if proved, ends the search for more."""

_SPARE = 2e-6
"""What limits are tightened by beyond what was missing, for the rounding of figures."""

_SMALL = 1e-3
"""Excess by which limits are tightened of sections that may move further; of a larger one the peak tells enough."""


@dataclass(frozen=True)
class Found:
    """Outcome of a search.

    Attributes:
        proved: the best loop that was proved; None where there is none.
        sampled: bandwidths (Hz) that designs reached on samples, the largest first; of sections, what they are worth.
        certificates: how many exact proofs of a loop were run.
        reason: why nothing was proved, empty where something was.
        worst: of a robust design, (d,) standard deviations of each rig that was proved beside the nominal one.
        tried: outcome of each design of which a proof was sought.
    """

    proved: Proved | None
    sampled: tuple[float, ...]
    certificates: int
    reason: str = ""
    worst: tuple[np.ndarray, ...] = ()
    tried: "tuple[Found, ...]" = ()


@dataclass(frozen=True)
class _Design:
    """A form, variables with the mass inside and what sections there are, and their value on samples."""

    form: Form
    variables: np.ndarray
    value: float

    @property
    def law(self) -> Controller:
        return self.form.record(self.variables[: self.form.size])

    @property
    def inner_end_mass(self) -> float:
        return round(float(self.variables[self.form.size]), 6)


Start = tuple[Form, np.ndarray]
"""A form and variables (v,) of it, then the mass inside (kg) and the sections where these are chosen as well."""


def search(task: Search, starts: Sequence[Start], growths: int = 0, report: Progress = silent) -> Found:
    """Find the largest guaranteed bandwidth.

    Args:
        task: what is asked.
        starts: laws to begin with; those with unstable loops lead nowhere.
        growths: how often they are grown.
        report: told the share done and what is being done.
    """
    effort, pool = task.effort, []
    for k, (form, variables) in enumerate(starts):
        report(0.2 * k / len(starts), f"start {k + 1} of {len(starts)}")
        pool.append(_Design(form, *task.coarsely_searched(form, variables)))
    pool = _refined(task, _best(pool)[: effort.starts], _part(report, 0.2, 0.65 / (1 + growths)))
    for growth in range(growths):
        more = [
            _Design(form, np.append(variables, design.variables[design.form.size :]), 0.0)
            for design in pool[: effort.starts]
            for law in design.law.grown()
            if (sought_from := law.form()) is not None
            for form, variables in [sought_from]
        ]
        pool = _refined(task, more, _part(report, 0.2 + 0.65 * (growth + 1) / (1 + growths), 0.65 / (1 + growths)))
    reached = tuple(design.value for design in pool)
    tried: list[Found] = []
    best, worth = Found(None, reached, 0, "no start led to a stable loop within the limits on the samples"), 0.0
    for rough in pool[: effort.candidates]:
        if rough.value <= 0 or worth > _ENOUGH * rough.value:
            continue
        chosen = rough.variables[rough.form.size + 1 :]
        if why := task.sections.hopeless(rough.inner_end_mass, chosen, rough.value) if task.sections else "":
            tried.append(Found(None, reached, 0, why))
            continue
        words = f"{1 / rough.value:.3g} kg" if task.needed_Hz else f"{rough.value:.3g} Hz"
        report(0.85, f"refining {words} for good")
        further = task.refinement(rough.form)(rough.variables, rounds=3 * effort.rounds, reach=_FURTHER)
        design = _Design(rough.form, *further)
        report(0.9, f"proving what came of {words}")
        found = _proved(task, design, reached)
        tried.append(found)
        proved = found.proved
        value = task.value(rough.form, proved.variables, proved.bandwidth_Hz) if proved else 0.0
        if best.proved is None or value > worth:
            best, worth = found, value
    return replace(best, certificates=sum(one.certificates for one in tried), tried=tuple(tried))


def from_seeds(task: Search, seeds: Sequence[Controller]) -> list[Start]:
    """Seeds of a kind with little and with much mass inside, their gains lowered until the loops are stable."""
    (least, most), found = task.inner_kg, []
    sections = np.zeros(0) if task.sections is None else task.sections.start
    for seed in seeds:
        for inner in sorted({least, least + 0.3 * (most - least)}):
            if (sought_from := seed.form()) is None:
                continue
            form, variables = sought_from[0], np.concatenate([sought_from[1], [inner], sections])
            while not task.settled(form, variables):
                if variables[0] <= form.lower[0]:
                    break
                variables[0] -= 0.5
            found.append((form, variables))
    return found


def _refined(task: Search, designs: Sequence[_Design], report: Progress) -> list[_Design]:
    """The best designs, refined: all of them a little, then those that came out best for good."""
    going, most = list(designs), task.effort.rounds
    passes = (min(_FIRST_ROUNDS, most), most) if len(designs) > task.effort.refined else (most,)
    done, count = 0, len(designs) + (len(passes) - 1) * task.effort.refined
    for rounds in passes:
        found = []
        for design in going:
            report(done / count, f"refining {done + 1} of {count}")
            found.append(_Design(design.form, *task.refinement(design.form)(design.variables, rounds=rounds)))
            done += 1
        going = _best(found)[: task.effort.refined]
    return going


def _best(found: Sequence[_Design]) -> list[_Design]:
    """The designs with the largest value first, each value once."""
    chosen: list[_Design] = []
    for design in sorted(found, key=lambda one: -one.value):
        if not chosen or design.value < chosen[-1].value * (1 - 1e-3):
            chosen.append(design)
    return chosen


def _part(report: Progress, start: float, length: float) -> Progress:
    """Progress of a part of the whole."""
    return lambda share, text: report(start + length * share, text)


def _proved(task: Search, design: _Design, sampled: tuple[float, ...]) -> Found:
    """The best loop proved at a design or a little inside the limits.

    A compliance that touches its limit far below the bandwidth costs most of it: then more of it is kept to spare.
    """
    refinement, inside, stiffer, reason = task.refinement(design.form), 0.0, TOUCH, ""
    best: Proved | None = None
    highest = 0.0
    rigs: tuple[np.ndarray, ...] = ()
    proofs = 0
    while proofs < task.effort.proofs:
        proofs += 1
        law, inner, chosen = design.law, design.inner_end_mass, design.variables[design.form.size + 1 :]
        if (nominal := task.members_with(chosen, rounded=True)) is None:
            reason = "the refined sizes are no pair of tubes"
            break
        members = list(nominal)
        worst: tuple[np.ndarray, ...] = ()
        if task.spread is not None:
            worst = worst_rigs(task.points, task.goal, design.form, design.variables)
            for z in worst:
                members += task.spread.members(z)
        loops = loop_set(members, law, inner, task.masses_kg)
        if loops.unstable():
            reason = "the loop is not stable over the whole range"
            break
        refuted = loops.refuted(task.goal)
        if refuted:
            (claim, member), excess = refuted[0], loops.excess(task.goal) + _SPARE
            reason = f"{claim.kind.replace('_', ' ')} refuted: {claim.reason}"
            exact = member < len(nominal)  # of a rig that is off the samples are not
            if exact and claim.kind == "peak_sensitivity" and excess < inf and claim.witness is not None:
                # The next refinement sees the peak that stood between the samples, and a third of the excess beside.
                refinement = task.with_peak(refinement, claim.witness.frequency_Hz, nearest(claim.witness.mass))
                if task.sections is not None:  # of which the witness need not be near the worst peak
                    refinement = task.with_peak(refinement, *task.worst_peak(design.form, design.variables))
                excess *= 1 / 3 if task.sections is None else excess < _SMALL
            inside += excess
        else:
            bandwidth = min(*loops.bandwidths(task.goal.compliance_m_per_N).values(), LARGEST_BANDWIDTH_HZ)
            value = task.value(design.form, design.variables, bandwidth)
            if flaw := task.sections.refused(inner, chosen, bandwidth) if task.sections else "":
                reason = flaw
            elif best is None or value > highest:
                peak = min(loops.peak_sensitivity(), task.goal.peak_sensitivity)
                best, rigs, highest = Proved(law, inner, bandwidth, peak, design.variables), worst, value
            if value > _ENOUGH * design.value and (best is not None or bandwidth < _ENOUGH * task.needed_Hz):
                break
            stiffer *= 3
        if not inside < inf:
            break
        for worth in (WORTH, inf):
            variables, left = refinement(design.variables, inside, stiffer, 6, max(0.05, 10 * inside), worth)
            moved = not np.array_equal(variables, design.variables)
            # Sections go far enough that what a design reached before its peaks were known is no measure.
            design = replace(design, variables=variables, value=left if task.sections else design.value)
            if moved or not refuted:
                break
        else:
            break
    return Found(best, sampled, proofs, "" if best else reason, rigs)
