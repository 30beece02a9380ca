"""The diagnosis of a data set: where its gap lies, what causes it, how far it closes.

Some records are kept out of every fit, to measure the gap on; what is found is told in a few sentences.
"""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from math import nan
from pathlib import Path
from typing import TypeVar

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.diagnosis import (
    Cause,
    Diagnosis,
    Gap,
    Verdict,
    Where,
    in_words,
    listed,
    no_surer,
    unfinished,
    updated_prototype,
)
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.experiment import next_experiment
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of, with_output_injection
from beamdesign.diagnosis.fitting.fit import FitCache
from beamdesign.diagnosis.fitting.search import Search, refit, search
from beamdesign.diagnosis.gain_diagnosis import explain_gains
from beamdesign.diagnosis.gap_metrics import errors, gap, sizes
from beamdesign.diagnosis.judgement import THRESHOLDS, Judgement, cause_sets, causes, classes, judge
from beamdesign.diagnosis.learning import described, learn
from beamdesign.diagnosis.passing import what_passed
from beamdesign.diagnosis.second_look import refit_backlash_impacts, second_look
from beamdesign.diagnosis.separability import indistinguishable
from beamdesign.diagnosis.where.locate import locate
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.time_limit import TimeUp, leave_out, left_out, over, share, within

_SHARE = 0.25
_SECOND, _HELD_OUT = 0.5, 0.7  # of the time that is left, for laws and a second look, and for fits without some records
_PASSING = 0.4  # the same, for records without what passes
_PASSES, _LAW = "what passes in a short while", "a law learnt from the records"
_UNREPEATED = "a joint that hammers in its play, a loop that oscillates by itself"
_REPEATED = 0.1  # of the excess misfit: a law that leaves less predicts the motion from rest


def held_out(records: Sequence[TimeRecord]) -> tuple[int, ...]:
    """Positions of a quarter of the records, rounded, at least one of two.

    Each must be a condition of its own whose parts (payload, excitation and, where it can be, controller) are known to
    the fits from other records, and smaller than the largest of its kind: to predict it is to combine, not to guess,
    and what shows only at the largest amplitude (a limit) must be seen by the fits. Among such choices the most
    different records are taken, and of those the most strongly excited.

    Returns:
        none where there is one record only, or where no choice leaves the fits such a view.
    """
    count = max(1, round(_SHARE * len(records)))
    if len(records) < 2:
        return ()
    for demanding in (True, False):
        choices = [c for c in combinations(range(len(records)), count) if _known(records, c, demanding)]
        if choices:
            return max(choices, key=lambda chosen: _value(records, chosen))
    return ()


def _known(records: Sequence[TimeRecord], chosen: Sequence[int], demanding: bool) -> bool:
    rest = [r for k, r in enumerate(records) if k not in chosen]
    if any(r.condition == records[k].condition for k in chosen for r in rest):
        return False  # a replicate in the fits would give it away
    for k in chosen:
        record = records[k]
        alike = [r for r in rest if r.excitation == record.excitation]
        largest = max((_swing(r) for r in alike), default=0.0)
        if not any(_masses(r) == _masses(record) for r in rest) or largest < _swing(record):
            return False
        if demanding and not any(r.controller == record.controller for r in rest):
            return False
    return True


def _value(records: Sequence[TimeRecord], chosen: Sequence[int]) -> tuple[int, float]:
    different = len({_masses(records[k]) for k in chosen}) + len({records[k].excitation for k in chosen})
    largest: dict[str, float] = {}
    for record in records:
        largest[record.excitation] = max(largest.get(record.excitation, 0.0), _size(record))
    strength = sum(_size(records[k]) / max(largest[records[k].excitation], 1e-300) for k in chosen)
    return different, strength


def _size(record: TimeRecord) -> float:
    column = 1 if record.excitation == "command" else 0
    return float(np.sqrt(np.mean(record.inputs[:, column] ** 2)))


def _swing(record: TimeRecord) -> float:
    """Of the current, A: how hard the valve is driven."""
    return float(np.abs(record.measured["current_A"]).max())


def _masses(record: TimeRecord) -> tuple[float, float]:
    return record.outer_end_mass, record.inner_end_mass


def diagnose(
    data: Dataset,
    workers: int = 2,
    progress: Progress = silent,
    kept: FitCache | None = None,
    minutes: float | None = None,
) -> Diagnosis[Prototype]:
    """Diagnose the gap between a prototype and its rig.

    Time records, with or without other figures, are explained by fits; figures alone by `explain_gains`, also where no
    record turns out to be sound.

    Args:
        data: what came back from the rig.
        workers: processes.
        progress: told the share done and what is being done.
        kept: fits of an earlier run, where those of this one are kept as well.
        minutes: after about which to tell what was compared so far; None: as long as it takes.

    Raises:
        InputError: where the data cannot be what they say they are; see
            `beamdesign.diagnosis.examination.plausibility`.
    """
    with within(minutes):
        return _diagnosed(data, workers, progress, kept)


def _diagnosed(data: Dataset, workers: int, progress: Progress, kept: FitCache | None) -> Diagnosis[Prototype]:
    stated = data.prototype.tolerance
    examined = examine(data)
    data = examined.data
    if not data.records:
        figures_only = explain_gains(replace(data, warnings=examined.words), progress)
        return replace(figures_only, prototype=figures_only.prototype.but(tolerance=stated))
    kept_out = held_out(data.records)
    seen = replace(data, records=tuple(r for k, r in enumerate(data.records) if k not in kept_out))
    found = search(data, workers, _between(0.0, 0.7, progress), kept)
    judged, words, doubtful = judge(found), examined.words, examined.limits_confidence
    passed, again = None, None
    if judged.unknown > 0.5:
        update = _between(0.7, 0.72, progress)
        passed = _in_time(_PASSING, _PASSES, lambda: what_passed(data, found, workers, update, kept))
    if passed is not None:
        data, found, judged, kept = passed.data, passed.search, passed.judged, passed.kept
        words = (*words, *passed.words)
        seen, doubtful = replace(data, records=tuple(r for k, r in enumerate(data.records) if k not in kept_out)), True
    plain, update = found.null, _between(0.72, 0.82, progress)
    learnt = _in_time(_SECOND, _LAW, lambda: learn(data, kept_out, found, judged, workers, update, kept))
    # What no model repeats from rest, a law that is learnt does not either: where one does, it is nothing of that kind.
    if judged.unknown > 0.5 and (learnt is None or learnt.search.excess(learnt.judged.best) > _REPEATED):
        update = _between(0.82, 0.96, progress)
        again = _in_time(_SECOND, _UNREPEATED, lambda: second_look(data, found, workers, update, kept))
    if again is not None:
        found, judged, words, learnt = again.search, again.judged, (*words, again.warning), None
    elif learnt is not None:
        data, found, judged = learnt.data, learnt.search, learnt.judged
    rare = nan if left_out() else chance(judged.of_causes.get((), 0.0))
    judged = decided(judged, found, rare)
    if not judged.best.hypothesis.names:
        learnt, again = None, None
    confident = verdict_of(judged, doubtful, rare) != "unknown"
    best = judged.best if confident or learnt is not None else found.null
    progress(0.96, "what the data can tell")
    evidence = evidence_of(data)
    separable = None if over() else indistinguishable(data, evidence)
    progress(0.97, "records held out")
    tuned, outside = plain, best
    try:
        with share(_HELD_OUT, within_steps=True):
            if learnt is not None:
                tuned, outside = learnt.refitted
            elif kept_out and again and not again.oscillates:
                tuned, outside = refit(seen, plain, workers, kept)[0], refit_backlash_impacts(seen, best)
            elif kept_out:
                tuned, outside = refit(seen, best, workers, kept, synchronised=again is not None)
    except TimeUp:
        kept_out = ()
        leave_out("records held out")
    ranked = tuple(described(cause, best, data) for cause in causes(found, judged))
    records = [piece for piece in evidence if isinstance(piece, RecordEvidence)]
    if len(best.hypothesis.causes) > 1:  # the dominant one first
        size = sizes(best, records)
        ranked = tuple(sorted(ranked, key=lambda c: -size.get(c.name, -1.0)))
    chosen = tuple(c.name for c in ranked if c.name in best.hypothesis.causes)
    from_rest = tuple(errors(piece, tuned, outside, best) for piece in records)
    measured = synchronised = gap(from_rest, kept_out)
    if again is not None:
        # What cannot be predicted from rest neither confirms nor refutes what is chosen: models that follow it do.
        synchronised = gap([errors(with_output_injection(piece), tuned, outside, best) for piece in records], kept_out)
        measured = synchronised if again.oscillates else measured
    doubtful, left = doubtful or not confirmed(synchronised), left_out()
    verdict = no_surer(verdict_of(judged, doubtful, rare), left)
    progress(1.0, "where the gap lies")
    gaps = 1 - judged.of_causes.get((), 0.0)  # where it lies is asked of a gap
    blamed = [replace(c, probability=c.probability / gaps) for c in ranked if c.name in chosen]
    where = locate(found, best, evidence, blamed, judged.unknown)
    asked = None
    if verdict in ("ambiguous", "unknown") and not left:
        fits = [f for f in (found.null, *found.fits) if f.hypothesis in judged.of]
        fits.sort(key=lambda f: -judged.of[f.hypothesis])
        asked = next_experiment(data, fits, [judged.of[f.hypothesis] for f in fits])
    return Diagnosis(
        data.name,
        verdict,
        unfinished(left)
        + sentences(verdict, ranked, chosen, measured, where, again is not None and again.oscillates, not left, rare),
        ranked,
        chosen,
        judged.unknown,
        where,
        measured,
        classes(judged),
        asked,
        updated_prototype(data.prototype, best).but(tolerance=stated),
        words,
        found,
        separable,
        cause_sets(found, judged),
        from_rest,
        left_out=left_out(),
        chance=rare,
    )


_T = TypeVar("_T")


def _in_time(part: float, named: str, look: Callable[[], _T]) -> _T | None:
    """What a further look finds in a part of the time that is left; None where the time is up, with a word."""
    try:
        with share(part, within_steps=True):
            return look()
    except TimeUp:
        leave_out(named)
        return None


def _between(low: float, high: float, progress: Progress) -> Progress:
    """Progress of a part of the work, from one share of the whole to another."""
    return lambda share, doing: progress(low + (high - low) * share, doing)


LEVEL = 0.02
"""Share of rigs without a gap that may be said to have one."""


@cache
def null_scores() -> tuple[float, ...]:
    """Probability of no gap that each of the rigs without one was given, least first."""
    path = Path(__file__).with_name("nulls.toml")
    return tuple(sorted(tomllib.loads(path.read_text(encoding="utf-8"))["no_gap"]))


def chance(no_gap: float, among: Sequence[float] | None = None) -> float:
    """How often a rig without a gap looks as much as if it had one: a test whose level holds in finite samples.

    The probability that a diagnosis gives to no gap is ranked among those of rigs without one, drawn and diagnosed by
    the same program (`studies/benchmarks/null_scores.py`, their scores in `nulls.toml`). If a rig without a gap is
    drawn like these, every rank is as probable as any other, so that what is returned is at most a level with at most
    that probability: split conformal prediction (V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random
    World, Springer 2005, section 2.2). As the score is the last that a diagnosis says, nothing has to be corrected for
    how many causes and places were looked at. Nothing is promised of rigs that are unlike those.

    Args:
        no_gap: probability that a diagnosis gives to it.
        among: the same of rigs without a gap; those of `null_scores` if None.

    Returns:
        probability that a rig without a gap is given so little probability of having none (a conformal p-value).
    """
    scores = null_scores() if among is None else among
    return (1 + sum(score <= no_gap for score in scores)) / (1 + len(scores))


def decided(judged: Judgement, found: Search, rare: float) -> Judgement:
    """Whether there is a gap by how rare it would be without one: if not, tolerances are best, else a cause.

    Args:
        judged: the probabilities.
        found: the fits.
        rare: see `chance`; NaN where it is not known, which decides nothing.
    """
    if rare > LEVEL:
        return replace(judged, best=found.null)
    if rare <= LEVEL and not judged.best.hypothesis.names:
        return replace(judged, best=max(found.fits, key=lambda f: judged.of.get(f.hypothesis, 0.0), default=found.null))
    return judged


def verdict_of(judged: Judgement, doubtful: bool = False, rare: float = nan) -> Verdict:
    """What the probabilities come to.

    Data that are not what they should be allow no confident answer, nor do figures strained to make a cause fit (a
    resonance that is missing, fitted as a delay).

    Args:
        judged: the probabilities.
        doubtful: whether data or conditions held out speak against them.
        rare: of rigs without a gap, the share that is judged so, see `chance`; there is no gap above `LEVEL`, and below
            it something is missing even where nothing known explains it. NaN where it is not known.
    """
    if judged.unknown > 0.5 and not rare > LEVEL:
        return "unknown"
    named = bool(judged.best.hypothesis.names)
    if doubtful or (named and judged.strained):
        return "ambiguous" if named else "unknown"
    if not named:
        return "unknown" if rare <= LEVEL else "no_gap"
    sure = judged.of_causes[judged.best.hypothesis.causes]
    return "effect" if sure >= THRESHOLDS.confident * (1 - judged.unknown) else "ambiguous"


def confirmed(measured: Gap) -> bool:
    """Whether conditions held out do not speak against what is chosen: re-tuned tolerances predict them no better."""
    return measured.after <= max(THRESHOLDS.worse * measured.tuned, THRESHOLDS.near_noise * measured.noise_floor)


def sentences(
    verdict: Verdict,
    causes: Sequence[Cause],
    chosen: Sequence[str],
    gap: Gap,
    where: Where,
    synchronised: bool = False,
    complete: bool = True,
    rare: float = nan,
) -> str:
    """The verdict for people: what it is, how probable it is without a gap, and how far the gap closes.

    Args:
        verdict: in a word.
        causes: most probable first.
        chosen: names of those that are held responsible.
        gap: as measured.
        where: it lies.
        synchronised: whether errors are those of models that follow the records.
        complete: whether everything that is known was compared.
        rare: see `verdict_of`.
    """
    errors = (
        "On records left out of the fits that measure it, the "
        f"{'error in step' if synchronised else 'prediction error'} falls from "
        f"{gap.before:.1%} of the signal "
        f"({gap.tuned:.1%} with tolerances re-tuned) to {gap.after:.1%}; "
        f"the sensor's noise alone is {gap.noise_floor:.1%}."
    )
    words = {c.name: f"{c.name.replace('parameter:', 'a wrong ')} ({c.probability:.0%})" for c in causes}
    named = listed([words[name] for name in chosen])
    match verdict:
        case "no_gap":
            first = "There is no gap that the tolerances of the prototype would not explain."
        case "effect":
            first = f"The gap is caused by {named}."
        case "ambiguous":
            others = [words[c.name] for c in causes if c.name not in chosen][:3]
            rivals = f"; it may as well be {listed(others, 'or')}" if others else ""
            first = f"The gap is most probably caused by {named}{rivals}."
        case _:
            place = f" It lies in the {where.subsystem}." if where.subsystem else ""
            first = f"Nothing that {'is known here' if complete else 'was compared'} explains the gap.{place}"
            learnt = [f"{c.like} at the port {in_words(c.name.partition(':')[2])}" for c in causes if c.like]
            learnt += [words[c.name] for c in causes if c.name in chosen and not c.like] if learnt else []
            first += f" Learnt from the records: {listed(learnt)}." if learnt else ""
    if rare <= LEVEL and verdict != "no_gap":
        first += f" Of rigs without a gap at most {rare:.1%} are judged to be as far from having none."
    return f"{first} {errors}"
