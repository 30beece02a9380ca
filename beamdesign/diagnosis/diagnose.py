"""The diagnosis of a data set: where its gap lies, what causes it, how far it closes.

Some records are kept out of every fit, to measure the gap on; what is found is told in a few sentences.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import combinations
from math import inf, nan
from multiprocessing import active_children
from typing import Any, TypeVar

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.diagnosis import Diagnosis, no_surer, unfinished, updated_prototype
from beamdesign.diagnosis.examination.plausibility import GAIN_FAR, examine
from beamdesign.diagnosis.experiment import next_experiment
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of, with_output_injection
from beamdesign.diagnosis.fitting.fit import Evidence, Fit, FitCache
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import notes_on_known
from beamdesign.diagnosis.fitting.replay import PLAY, law_of_play
from beamdesign.diagnosis.fitting.search import refit
from beamdesign.diagnosis.gain_diagnosis import explain_gains
from beamdesign.diagnosis.gap_metrics import errors, gap, sizes
from beamdesign.diagnosis.judgement import cause_sets, causes, classes
from beamdesign.diagnosis.learning import EXPLAINED, described, learn
from beamdesign.diagnosis.passing import what_passed
from beamdesign.diagnosis.second_look import refit_backlash_impacts, second_look, without_impacts
from beamdesign.diagnosis.separability import indistinguishable
from beamdesign.diagnosis.tone import search_without_tones
from beamdesign.diagnosis.verdict import chance, confirmed, decided, sentences, verdict_of
from beamdesign.diagnosis.where.locate import locate
from beamdesign.progress import Progress, end_at_once, help_another, silent
from beamdesign.prototype import Prototype
from beamdesign.time_limit import TimeUp, leave_out, left, left_out, over, share, within

_SHARE = 0.25
_SECOND, _HELD_OUT = 0.5, 0.7  # of the time that is left, for laws and a second look, and for fits without some records
_PASSING = 0.4  # the same, for records without what passes
_PASSES, _LAW = "what passes in a short while", "a law learnt from the records"
_UNREPEATED = "a joint that hammers in its play, a loop that oscillates by itself"


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
        figures_only = explain_gains(replace(data, warnings=examined.words), workers, progress)
        return replace(figures_only, prototype=figures_only.prototype.but(tolerance=stated))
    kept_out = held_out(data.records)
    believed = data.prototype.effects
    data, anew = without_impacts(data)
    cleared = search_without_tones(data, workers, _between(0.0, 0.7, progress), kept)
    again = None
    words, doubtful = (*examined.words, *anew, *cleared.words), examined.limits_confidence or cleared.doubtful
    data, found, judged, kept = cleared.data, cleared.search, cleared.judged, cleared.kept
    if judged.unknown > 0.5:
        update = _between(0.7, 0.72, progress)
        passed = _in_time(_PASSING, _PASSES, lambda: what_passed(data, found, workers, update, kept))
        if passed is not None:
            data, found, judged, kept = passed.data, passed.search, passed.judged, passed.kept
            words, doubtful = (*words, *passed.words), True
    seen = replace(data, records=tuple(r for k, r in enumerate(data.records) if k not in kept_out))
    plain, update = found.null, _between(0.72, 0.82, progress)
    learnt = _in_time(_SECOND, _LAW, lambda: learn(data, kept_out, found, judged, workers, update, kept))
    # What no model repeats from rest, a law that is learnt does not either: where one does, it is nothing of that kind.
    if judged.unknown > 0.5 and (learnt is None or learnt.search.excess(learnt.judged.best) > EXPLAINED):
        update = _between(0.82, 0.96, progress)
        again = _in_time(_SECOND, _UNREPEATED, lambda: second_look(data, found, workers, update, kept))
    if again is not None:
        found, judged, words, learnt = again.search, again.judged, (*words, again.warning), None
    elif learnt is not None:
        data, found, judged = learnt.data, learnt.search, learnt.judged
    rare = nan if left_out() else chance(judged.of_causes.get((), 0.0))
    judged = decided(judged, found, rare)
    evidence = evidence_of(data)
    doubtful = doubtful or (again is None and any(_far(piece, judged.best) for piece in evidence))
    if not judged.best.hypothesis.names:
        learnt, again = None, None
    confident = verdict_of(judged, doubtful, rare) != "unknown"
    best = judged.best if confident or learnt is not None else found.null
    ranked = tuple(described(cause, best, data) for cause in causes(found, judged))
    records = [piece for piece in evidence if isinstance(piece, RecordEvidence)]
    if len(best.hypothesis.causes) > 1:  # the dominant one first
        size = sizes(best, records)
        ranked = tuple(sorted(ranked, key=lambda c: -size.get(c.name, -1.0)))
    chosen = tuple(c.name for c in ranked if c.name in best.hypothesis.causes)
    gaps = 1 - judged.of_causes.get((), 0.0)  # where it lies is asked of a gap
    blamed = [replace(c, probability=c.probability / gaps) for c in ranked if c.name in chosen]
    progress(0.96, "records held out")
    tuned, outside = plain, best
    with _beside(workers) as begun:
        placed = begun(locate, found, best, evidence, blamed, judged.unknown)
        told = begun(indistinguishable, data, evidence)
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
        lacking, separable = left_out(), None  # a verdict is as sure though no time is left to tell the rest
        progress(0.98, "where the gap lies")
        with suppress(TimeUp):
            separable = told()
        try:
            where = placed()
        except TimeUp:
            where = locate(found, best, evidence, blamed, judged.unknown)
    from_rest = tuple(errors(piece, tuned, outside, best) for piece in records)
    measured = synchronised = gap(from_rest, kept_out)
    written, worse = best, not best.hypothesis.names and again is None and measured.after > measured.before
    if worse:  # figures that predict worse what they have not seen are no better known than those believed
        written = replace(best, z=np.zeros_like(best.z))
        from_rest = tuple(errors(piece, tuned, written, written) for piece in records)
        measured = synchronised = gap(from_rest, kept_out)
    if again is not None:
        # What cannot be predicted from rest neither confirms nor refutes what is chosen: models that follow it do.
        synchronised = gap([errors(with_output_injection(piece), tuned, outside, best) for piece in records], kept_out)
        measured = synchronised if again.oscillates else measured
    doubtful = doubtful or not confirmed(synchronised)
    verdict = no_surer(verdict_of(judged, doubtful, rare), lacking)
    asked = None
    if verdict in ("ambiguous", "unknown") and not lacking:
        fits = [f for f in (found.null, *found.fits) if f.hypothesis in judged.of]
        fits.sort(key=lambda f: -judged.of[f.hypothesis])
        asked = next_experiment(data, fits, [judged.of[f.hypothesis] for f in fits])
    renewed = updated_prototype(data.prototype, written)
    if (play := law_of_play(believed)) and anew and PLAY not in best.hypothesis.causes:  # not found, and so not lost
        renewed = renewed.but(effects={**renewed.effects, play: believed[play]})
    following = again is not None and again.oscillates
    said = (
        "On records left out of the fits that measure it, the "
        f"{'error in step' if following else 'prediction error'} "
        f"{'stays at' if worse else 'falls from'} {measured.before:.1%} of the signal "
        f"({measured.tuned:.1%} with tolerances re-tuned"
        f"{', so that the prototype keeps those believed)' if worse else f') to {measured.after:.1%}'}; "
        f"the sensor's noise alone is {measured.noise_floor:.1%}."
    )
    return Diagnosis(
        data.name,
        verdict,
        unfinished(lacking) + sentences(verdict, ranked, chosen, said, where, complete=not lacking, rare=rare),
        ranked,
        chosen,
        judged.unknown,
        where,
        measured,
        classes(judged),
        asked,
        renewed.but(tolerance=stated),
        words,
        found,
        separable,
        cause_sets(found, judged),
        from_rest,
        notes=notes_on_known(data.prototype),
        left_out=left_out(),
        chance=rare,
    )


def _far(piece: Evidence, best: Fit) -> bool:
    """Whether it is a critical gain that is far from what the chosen model makes of it."""
    if not isinstance(piece, GainEvidence):
        return False
    at = piece.predicted(best.hypothesis.placement(piece.prototype), best.z)
    return at is not None and not 1 / GAIN_FAR < piece.measured.gain / at.gain < GAIN_FAR


@contextmanager
def _beside(workers: int) -> Iterator[Callable[..., Callable[[], Any]]]:
    """Begin what does not hang on the fits that are made meanwhile, in a process of its own where there are several.

    Yields:
        what begins a function with what it is given, and gives what waits for its result, or with one worker calls it;
        `TimeUp` is raised where no time is left for that.
    """
    others = active_children()
    pool = ProcessPoolExecutor(2, initializer=help_another) if workers > 1 else None

    def begun(function: Callable[..., Any], *given: Any) -> Callable[[], Any]:
        future = None if pool is None else pool.submit(function, *given)

        def result() -> Any:
            if over():
                raise TimeUp
            if future is None:
                return function(*given)
            try:
                return future.result(left() if left() < inf else None)
            except TimeoutError:
                raise TimeUp from None

        return result

    try:
        yield begun
    finally:
        if pool is not None:
            end_at_once(pool, others)


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
