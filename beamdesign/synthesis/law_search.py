"""The one engine of tuning: from laws that are given or grown to the largest bandwidth that is proved.

Laws are searched for coarsely and refined on samples of all loops; what grows is grown and refined anew, the best few
go on. What is returned is proved by the same oracle as every other loop: where it refutes a limit between the samples,
the peak that stood there joins them, all limits are tightened by what was missing, and the refinement is done again.

Of a robust search the worst rigs within the tolerances are sought again and again and join the samples. What comes of
it is proved over the whole box of tolerances and payloads at once (`beamdesign.synthesis.rig_spread`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from beamdesign.controllers.protocol import Form
from beamdesign.polynomial import nearest
from beamdesign.progress import Progress, part_of, silent
from beamdesign.synthesis.law_design import ENOUGH, ROOM, Proved, in_box, loop_set, rests, unknown, value_of, whole
from beamdesign.synthesis.law_starts import calmed, with_more_inside
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_samples import LARGEST_AT_LOWER_GAINS, Design, calmer
from beamdesign.synthesis.refinement import TOUCH, WORTH
from beamdesign.time_limit import is_limited, leave_out, over, share, while_time

_FIRST_ROUNDS = 5
"""Of a refinement of many, before the best of them are refined for good."""

_FURTHER = 0.2
"""How far a variable may move in a step of the last refinement."""

_CALMER = (4.0, 2.0, 1.4)
"""Peak sensitivities at lower gains that are tried where a loop is not proved to come to rest; at one |1 + L| >= 1."""

_SPARE = 2e-6
"""What limits are tightened by beyond what was missing, for the rounding of figures."""

_CUT_ROUNDS = 12
"""How often the worst rigs of a design are sought, at most."""

_UNDECIDED = 2
"""How many designs of which a proof over the box comes to no end are tried, at most."""

_VIOLATION = 0.02
"""By how much (logarithm) a design may miss limits where a refinement begins."""

_NEARER = (1.0, 0.5, 0.25, 0.1)
"""By what shares of how far they are off rigs join the samples: the first with which all loops are stable."""

_MISSED = 2e-3
"""By how much (logarithm) a rig misses a limit that is to join the samples."""

_STIFFEST = 0.1
"""Most of the compliance (logarithm) that is kept to spare where it is enforced."""

_PEAKS = ("peak_sensitivity", "peak_compliance", "loop_gain", "controller_effort")
"""Kinds of claims whose witness is near a peak."""

_SEEKING = 0.6
"""Share of the time that is left which goes into the search of designs; the rest is for proofs."""

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
        tried: outcome of each design of which a proof was sought.
        form: of what was proved.
    """

    proved: Proved | None
    sampled: tuple[float, ...]
    certificates: int
    reason: str = ""
    tried: "tuple[Found, ...]" = ()
    form: Form | None = None

    def worth(self, task: Search) -> float:
        """What is proved is worth this; nothing 0."""
        if self.proved is None or self.form is None:
            return 0.0
        return task.value(Design(self.form, self.proved.variables), self.proved.bandwidth_Hz)


def search(task: Search, starts: Sequence[Design], growths: int = 0, report: Progress = silent) -> Found:
    """Find the largest guaranteed bandwidth.

    Where the goal asks for a loop that comes to rest while its law's current saturates, and that is not proved of what
    comes out, the search is done again with loops that keep farther from the critical point at every lower gain.

    Args:
        task: what is asked.
        starts: laws to begin with; those with unstable loops lead nowhere.
        growths: how often they are grown.
        report: told the share done and what is being done.
    """
    reason = ""
    for peak in (LARGEST_AT_LOWER_GAINS, *(_CALMER if task.goal.comes_to_rest else ())):
        found = _search(replace(task, goal=calmer(task.goal, peak)), starts, growths, report)
        if found.proved is None or found.form is None:
            return replace(found, reason="; ".join(filter(None, (reason, found.reason))))
        if over() and not task.goal.comes_to_rest:
            leave_out("whether it comes to rest while its law's current saturates")
            return found
        report(0.97, "where the current saturates")
        rested, why = rests(task, Design(found.form, found.proved.variables), found.proved)
        if rested is not None or not task.goal.comes_to_rest:
            return replace(found, proved=rested or found.proved)
        reason = f"that it comes to rest while the law's current saturates is not proved: {why}"
    return replace(found, proved=None, reason=reason)


def _search(task: Search, starts: Sequence[Design], growths: int, report: Progress) -> Found:
    """The largest bandwidth within the limits."""
    effort, pool, part = task.effort, [], 0.65 / (1 + growths)
    with share(_SEEKING):
        for k, start in enumerate(while_time(starts, lambda _: "some starts", least=1)):
            report(0.2 * k / len(starts), f"start {k + 1} of {len(starts)}")
            pool.append(task.coarsely_searched(start))
        if not any(one.value for one in pool):  # a heavy payload may need more mass inside
            heavier = while_time(with_more_inside(task, starts), lambda _: "some starts")
            pool += [task.coarsely_searched(start) for start in heavier]
        pool = _refined(task, _best(pool)[: effort.starts], part_of(report, 0.2, 0.2 + part))
        task, pool = _hardened(task, pool)
    smaller = Found(None, (), 0, "no start led to a stable loop within the limits on the samples")
    for growth in range(growths):
        if is_limited():  # each size of a law is proved before a larger one is sought
            smaller = _best_proved(task, pool[:1], report, smaller)
        if over():
            leave_out(f"laws of {growth + 1} sections and more")
            break
        with share(_SEEKING):
            more = [
                Design(form, np.append(variables, design.variables[design.form.size :]))
                for design in pool[: effort.starts]
                for law in design.law.grown()
                if (sought_from := task.sought_form(law, design.form.size)) is not None
                for form, variables in [sought_from]
            ]
            grown = _refined(task, more, part_of(report, 0.2 + (growth + 1) * part, 0.2 + (growth + 2) * part))
            before, (task, pool) = pool, _hardened(task, grown)
        if task.spread is not None:  # what the worst rigs cost what has grown may be more than it has gained
            kept = [*pool, *(one for one in before if task.settled(one))]
            pool = _best([replace(one, value=value_of(task, one)) for one in kept])
    return _best_proved(task, pool[: effort.candidates], report, smaller, int(smaller.proved is None))


def _best_proved(task: Search, designs: Sequence[Design], report: Progress, best: Found, least: int = 0) -> Found:
    """Refine designs for good and prove them, as long as there is time; at least so many are begun with.

    What is no better on samples than the best that was proved before is left out.
    """
    reached, tried, worth = tuple(design.value for design in designs), [*best.tried], best.worth(task)
    worthy = [one for one in designs if one.value > 0]
    for rough in while_time(worthy, lambda one: f"a design of {_in_words(task, one)}", least):
        if worth > ENOUGH * rough.value:
            continue
        if why := task.sections.hopeless(rough.inner_end_mass, rough.chosen, rough.value) if task.sections else "":
            tried.append(Found(None, reached, 0, why))
            continue
        words = _in_words(task, rough)
        report(0.85, f"refining {words} for good")
        with share(_SEEKING):
            design = task.refined(rough, *_spare(task), rounds=3 * task.effort.rounds, reach=_FURTHER)
        report(0.9, f"proving what came of {words}")
        found = _proved(task, design, reached)
        tried.append(found)
        if best.proved is None or found.worth(task) > worth:
            best, worth = found, found.worth(task)
    return replace(best, sampled=reached, certificates=sum(one.certificates for one in tried), tried=tuple(tried))


def _in_words(task: Search, design: Design) -> str:
    """What a design is worth on samples."""
    return f"{1 / design.value:.3g} kg" if task.needed_Hz else f"{design.value:.3g} Hz"


def _refined(task: Search, designs: Sequence[Design], report: Progress) -> list[Design]:
    """The best designs, refined: all of them a little, then those that came out best for good."""
    going, most = list(designs), task.effort.rounds
    passes = (min(_FIRST_ROUNDS, most), most) if len(designs) > task.effort.refined else (most,)
    done, count = 0, len(designs) + (len(passes) - 1) * task.effort.refined
    for rounds in passes:
        found = []
        for design in going:
            report(done / count, f"refining {done + 1} of {count}")
            found.append(task.refined(design, rounds=rounds))
            done += 1
        going = _best(found)[: task.effort.refined]
    return going


def _hardened(task: Search, designs: Sequence[Design]) -> tuple[Search, list[Design]]:
    """The search with the worst rigs of its best designs among the samples, and these designs refined for them."""
    pool = list(designs[: task.effort.starts])
    for _ in range(_CUT_ROUNDS if task.spread is not None else 0):
        if over():  # whoever proves them seeks further worst rigs
            break
        cuts = [cut for one in pool for _, _, cut in in_box(task, one, _MISSED)]
        cuts += [cut for one in pool[:1] for cut in unknown(task, one)]
        for nearer in _NEARER:  # a law whose gain cannot be lowered meets rigs that are less far off first
            harder = task.with_cuts(cut._replace(z=tuple(nearer * one for one in cut.z)) for cut in cuts)
            if all(harder.settled(calmed(harder, one)) for one in pool):
                break
        if len(harder.cuts) == len(task.cuts):
            break
        task = harder
        pool = [task.refined(_mended(task, one), *_spare(task), rounds=2 * _FIRST_ROUNDS) for one in pool]
    return task, _best(pool)


def _spare(task: Search) -> tuple[float, float]:
    """By how much (logarithm) the limits are kept to spare, the last of them that of the compliance."""
    return (0.0, TOUCH) if task.spread is None else (ROOM, ROOM + 2 * TOUCH)


def _mended(task: Search, design: Design) -> Design:
    """From where a refinement finds its way: from far outside of the limits no small step keeps them all."""
    design = calmed(task, design)
    return task.coarsely_searched(design) if task.violation(design) > _VIOLATION else design


def _best(found: Sequence[Design]) -> list[Design]:
    """The designs with the largest value first, each value once."""
    chosen: list[Design] = []
    for design in sorted(found, key=lambda one: -one.value):
        if not chosen or design.value < chosen[-1].value * (1 - 1e-3):
            chosen.append(design)
    return chosen


def _proved(task: Search, design: Design, sampled: tuple[float, ...]) -> Found:
    """The best loop proved at a design or a little inside the limits.

    A compliance that touches its limit far below the bandwidth costs most of it: then more of it is kept to spare. Of a
    robust search the rigs of the box that miss a limit join the samples until none is found, and then all are proved.
    """
    refinement, reason = task.refinement(design.form), ""
    least, stiffer = _spare(task)
    inside = least
    best: Proved | None = None
    highest = 0.0
    proofs = undecided = 0
    while proofs < task.effort.proofs * (1 if task.spread is None else 2):
        if over():
            leave_out("proofs of further designs")
            reason = reason or "no time was left for its proof"
            break
        proofs += 1
        law, inner, chosen = design.law, design.inner_end_mass, design.chosen
        try:
            members = task.members_with(chosen, rounded=True)
        except ValueError as error:
            reason = str(error)
            break
        loops, refuted, joined = loop_set(members, law, inner, task.masses_kg), True, False
        if unstable := loops.unstable(task.goal):
            reason = "the loop is not stable over the whole range"
        if unstable and task.spread is None:
            break
        # Of a box the largest compliance is compared over all of it.
        alone = task.goal if task.spread is None else task.goal.but(peak_over_passive=inf)
        if not unstable and (claims := loops.refuted(alone)):
            claim, excess = claims[0], loops.excess(alone) + _SPARE
            reason = f"{claim.kind.replace('_', ' ')} refuted: {claim.reason}"
            peaks = [(one, one.witness) for one in claims if one.kind in _PEAKS and one.witness is not None]
            if peaks and excess < inf:
                # The next refinement sees the peaks that stood between the samples, and a third of the excess beside.
                for asked, witness in peaks:
                    refinement = task.with_peak(refinement, witness.frequency_Hz, nearest(witness.mass), asked.kind)
                # Of sections the witness need not be near the worst peak.
                if task.sections is not None and claim.kind == "peak_sensitivity":
                    refinement = task.with_peak(refinement, *task.worst_peak(design))
                excess *= 1 / 3 if task.sections is None else excess < _SMALL
            inside += excess
        elif task.spread is not None and (missed := in_box(task, design)):
            kind, excess, _ = missed[0]
            reason = f"{kind.replace('_', ' ')} is missed by rigs within the tolerances"
            harder = task.with_cuts(cut for _, _, cut in missed)
            joined = len(harder.cuts) > len(task.cuts)
            inside += 0.0 if joined else min(excess + ROOM / 2, _MISSED)  # what a proof needs is wanting
            task = harder
            refinement = task.refinement(design.form)
            design = calmed(task, design)
        elif task.spread and stiffer < _STIFFEST and task.reached(design, ROOM) < ENOUGH * task.reached(design):
            stiffer *= 3  # compliance between the points where it is enforced: little to spare there costs most of it
        else:
            found, why, cuts = whole(task, design, loops)
            if found is None:
                reason, undecided = why, undecided + (not cuts)
                inside += 0.0 if cuts else _MISSED
                if undecided == _UNDECIDED:
                    break
                if cuts:
                    task, joined = task.with_cuts(cuts), True
                    refinement = task.refinement(design.form)
            else:
                refuted, value = False, task.value(design, found.bandwidth_Hz)
                if flaw := task.sections.refused(inner, chosen, found.bandwidth_Hz) if task.sections else "":
                    reason = flaw
                elif best is None or value > highest:
                    best, highest = found, value
                enough = value > ENOUGH * value_of(task, design)
                if enough and (best is not None or found.bandwidth_Hz < ENOUGH * task.needed_Hz):
                    break
                if inside > least and found.bandwidth_Hz > ENOUGH * task.reached(design):
                    inside = least + (inside - least) / 3  # peaks that are seen by now need less to spare
                else:
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
            # From far outside of what is known by now no small step leads back.
            if joined:
                refinement, mended = task.refinement(design.form), _mended(task, design)
            elif task.sections is None and refinement is not task.refinement(design.form):
                # What was kept to spare of peaks that are seen by now is no longer wanted.
                mended, inside = task.coarsely_searched(design, refinement.points), _SPARE
            else:
                break
            variables, left = refinement(mended.variables, 0.0 if joined else inside, rounds=_FIRST_ROUNDS)
            if not joined and np.array_equal(variables, design.variables):
                break
            design = replace(design, variables=variables, value=left)
        if not moved and not refuted:
            break
    return Found(best, sampled, proofs, "" if best else reason, form=design.form)
