"""The diagnosis of a data set: where its gap lies, what causes it, how far it closes.

Some records are kept out of every fit, to measure the gap on; what is found is told in a few sentences.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import inf, nan
from multiprocessing import active_children
from typing import Any, TypeVar, overload

import numpy as np

from beamdesign.arguments import takes
from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.bench_diagnosis import diagnose_bench
from beamdesign.diagnosis.data.bench_set import BenchSet
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import Cause, Diagnosis, Gap, NextExperiment, no_surer, updated_prototype
from beamdesign.diagnosis.examination.plausibility import GAIN_FAR, Examination, examine
from beamdesign.diagnosis.experiment import next_experiment
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of, with_output_injection
from beamdesign.diagnosis.fitting.fit import Evidence, Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache
from beamdesign.diagnosis.fitting.fitters import refit
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import notes_on_known
from beamdesign.diagnosis.fitting.replay import PLAY, law_of_play
from beamdesign.diagnosis.gain_diagnosis import explain_gains
from beamdesign.diagnosis.gap_metrics import Errors, errors, gap, held_out, sizes
from beamdesign.diagnosis.judgement import cause_sets, causes
from beamdesign.diagnosis.learning import EXPLAINED, described, learn
from beamdesign.diagnosis.misstated import channels_in_time, with_own_mass
from beamdesign.diagnosis.passing import Look, what_passed, without_one
from beamdesign.diagnosis.second_look import refit_backlash_impacts, second_look, without_impacts
from beamdesign.diagnosis.separability import indistinguishable
from beamdesign.diagnosis.tone import search_without_tones
from beamdesign.diagnosis.verdict import (
    chance,
    classes,
    confirmed,
    decided,
    far_fetched,
    leaves_much,
    sentences,
    verdict_of,
)
from beamdesign.diagnosis.where.locate import locate
from beamdesign.progress import Progress, end_at_once, help_another, part_of, silent
from beamdesign.prototype import Prototype
from beamdesign.time_limit import TimeUp, leave_out, left, left_out, over, share, within

_SECOND, _HELD_OUT = 0.5, 0.7  # of the time that is left, for laws and a second look, and for fits without some records
_PASSING, _WEIGHING = 0.4, 0.3  # the same, for records without what passes, and for those without one of them
_PASSES, _LAW = "what passes in a short while", "a law learnt from the records"
_RECORD = "a record that contradicts all others"
_MASS = "an end mass other than the one stated of a record"
_SKEWED = "channels that do not belong to one instant"
_UNREPEATED = "a joint that hammers in its play, a loop that oscillates by itself"


@overload
def diagnose(
    data: BenchSet, *, progress: Progress = silent, minutes: float | None = None
) -> Diagnosis[BenchPrototype]: ...


@overload
def diagnose(
    data: Dataset,
    workers: int = 2,
    progress: Progress = silent,
    kept: FitCache | None = None,
    minutes: float | None = None,
) -> Diagnosis[Prototype]: ...


@takes("Dataset BenchSet")
def diagnose(
    data: Dataset | BenchSet,
    workers: int = 2,
    progress: Progress = silent,
    kept: FitCache | None = None,
    minutes: float | None = None,
) -> Diagnosis[Any]:
    """Diagnose the gap between a prototype and its rig.

    Time records, with or without other figures, are explained by fits; figures alone by `explain_gains`, also where no
    record turns out to be sound. A bench is diagnosed from its steady motions, in this process alone and without fits
    that are kept.

    Args:
        data: what came back from the rig, or from a bench.
        workers: processes.
        progress: told the share done and what is being done.
        kept: fits of an earlier run, where those of this one are kept as well.
        minutes: after about which to tell what was compared so far; None: as long as it takes.

    Raises:
        InputError: where the data cannot be what they say they are; see
            `beamdesign.diagnosis.examination.plausibility`.
    """
    with within(minutes):
        if isinstance(data, BenchSet):
            return diagnose_bench(data, progress=progress)
        return _diagnosed(data, workers, progress, kept)


def _diagnosed(data: Dataset, workers: int, progress: Progress, kept: FitCache | None) -> Diagnosis[Prototype]:
    examined, read = examine(data), data
    if not examined.data.records:
        data, kept, weighed = _weighed(examined.data, kept)
        data = replace(data, warnings=(*weighed, *examined.words))
        figures_only = explain_gains(data, workers, progress, kept, examined.limits_confidence or bool(weighed))
        return replace(figures_only, prototype=read.as_stated(figures_only.prototype))
    found = _explained(examined, held_out(examined.data.records), workers, progress, kept)
    best, data = found.best, found.data
    progress(0.96, "records held out")
    with _beside(workers) as begun:
        asked = found.search, best, found.evidence, found.blamed, found.judged.unknown
        placed, compared = begun(locate, *asked), begun(indistinguishable, data, found.evidence)
        kept_out, tuned, outside = _without_held_out(found, workers)
        lacking, separable = left_out(), None  # a verdict is as sure though no time is left to tell the rest
        progress(0.98, "where the gap lies")
        with suppress(TimeUp):
            separable = compared()
        try:
            where = placed()
        except TimeUp:
            where = locate(*asked)
    measured, from_rest, written, sure, words = _shown(found, kept_out, tuned, outside)
    ranked, judged = found.ranked, found.judged
    verdict = no_surer(verdict_of(judged, found.doubtful or not sure, found.chance), lacking)
    renewed = updated_prototype(data.prototype, written)
    known = examined.data.prototype.effects
    if (play := law_of_play(known)) and found.anew and PLAY not in best.hypothesis.causes:  # not found, not lost
        renewed = renewed.but(effects={**renewed.effects, play: known[play]})
    chosen = tuple(c.name for c in ranked if c.name in best.hypothesis.causes)
    none = judged.of_causes.get((), 0.0)
    answer = sentences(verdict, ranked, chosen, words, where, (), not lacking, found.chance, judged.unknown, none)
    return Diagnosis(
        data.name,
        verdict,
        answer,
        ranked,
        chosen,
        judged.unknown,
        where,
        measured,
        classes(judged),
        _asked(found) if verdict in ("ambiguous", "unknown") and not lacking else None,
        read.as_stated(renewed),
        found.words,
        found.search,
        separable,
        cause_sets(found.search, judged),
        from_rest,
        notes=notes_on_known(data.prototype),
        left_out=left_out(),
        chance=found.chance,
        written=written,
    )


@dataclass(frozen=True, kw_only=True)
class _Explained(Look):
    """What all the records come to, with all warnings.

    Attributes:
        held_out: positions of records that are to be predicted.
        seen: the others, before any law was learnt.
        evidence: of these data.
        plain: tolerances alone, before any law was learnt.
        chance: see `beamdesign.diagnosis.verdict.chance`.
        anew: whether play that is known of is looked for anew.
    """

    held_out: tuple[int, ...]
    seen: Dataset
    evidence: tuple[Evidence, ...]
    plain: Fit
    chance: float
    anew: bool

    @cached_property
    def best(self) -> Fit:
        """The chosen one; tolerances alone where that would say more than is known."""
        confident = verdict_of(self.judged, self.doubtful, self.chance) != "unknown"
        return self.judged.best if confident or self.refitted is not None else self.search.null

    @cached_property
    def records(self) -> tuple[RecordEvidence, ...]:
        """The time records among the evidence."""
        return tuple(piece for piece in self.evidence if isinstance(piece, RecordEvidence))

    @cached_property
    def ranked(self) -> tuple[Cause, ...]:
        """All causes that are not out of the question; of several that are chosen the dominant one first."""
        found = tuple(described(cause, self.best, self.data) for cause in causes(self.search, self.judged))
        if len(self.best.hypothesis.causes) < 2:
            return found
        size = sizes(self.best, self.records)
        return tuple(sorted(found, key=lambda c: -size.get(c.name, -1.0)))

    @property
    def blamed(self) -> list[Cause]:
        """Those chosen, as probable as they are of a gap: where it lies is asked of one."""
        gaps, chosen = 1 - self.judged.of_causes.get((), 0.0), self.best.hypothesis.causes
        return [replace(c, probability=c.probability / gaps) for c in self.ranked if c.name in chosen]


def _explained(
    examined: Examination, kept_out: tuple[int, ...], workers: int, progress: Progress, kept: FitCache | None
) -> _Explained:
    """Search, and where that explains nothing look further: for what passes, a law to learn, what none can repeat."""
    data, anew = without_impacts(examined.data)
    data, kept, weighed = _weighed(data, kept)
    look = search_without_tones(data, workers, part_of(progress, 0.0, 0.7), kept)
    doubtful = examined.limits_confidence or look.doubtful or bool(weighed)  # which nobody has done
    look = replace(look, words=(*look.words, *weighed, *anew, *examined.words), doubtful=doubtful)
    look = _in_time(_PASSING, _SKEWED, partial(channels_in_time, look, workers, part_of(progress, 0.7, 0.71))) or look
    if look.judged.unknown > 0.5:
        look = _in_time(_PASSING, _PASSES, partial(what_passed, look, workers, part_of(progress, 0.71, 0.72))) or look
    listed = look
    learning = partial(learn, look, kept_out, workers, part_of(progress, 0.72, 0.82))
    learnt, again = _in_time(_SECOND, _LAW, learning), None
    # What no model repeats from rest, a law that is learnt does not either: where one does, it is nothing of that kind.
    if look.judged.unknown > 0.5 and (learnt is None or learnt.search.excess(learnt.judged.best) > EXPLAINED):
        again = _in_time(_SECOND, _UNREPEATED, partial(second_look, look, workers, part_of(progress, 0.82, 0.96)))
    look = again or learnt or look
    if look is listed and look.judged.unknown > 0.5:
        fewer = _in_time(_SECOND, _RECORD, partial(without_one, look, workers, part_of(progress, 0.82, 0.96)))
        if fewer is not None:
            look = listed = fewer
            kept_out = held_out(look.data.records)
    plain, records = listed.search.null, listed.data.records
    seen = replace(listed.data, records=tuple(r for k, r in enumerate(records) if k not in kept_out))
    rare = nan if left_out() else chance(look.judged.of_causes.get((), 0.0))
    judged, evidence = decided(look.judged, look.search, rare), evidence_of(look.data)
    doubtful = look.doubtful or (not look.follows and any(_far(piece, judged.best) for piece in evidence))
    said = far_fetched(judged.best, look.data.prototype), leaves_much(judged.best, look.search)
    why = [words for words in said if words and judged.unknown <= 0.5]
    words = tuple(dict.fromkeys((*why, *look.words)))
    look = replace(look, judged=judged, words=words, doubtful=doubtful or bool(why))
    if not judged.best.hypothesis.names:
        look = replace(look, refitted=None, follows="")
    return _Explained(
        **vars(look), held_out=kept_out, seen=seen, evidence=evidence, plain=plain, chance=rare, anew=bool(anew)
    )


def _weighed(data: Dataset, kept: FitCache | None) -> tuple[Dataset, FitCache | None, tuple[str, ...]]:
    """See `with_own_mass`; the data as they are where the time is up."""
    return _in_time(_WEIGHING, _MASS, partial(with_own_mass, data, kept)) or (data, kept, ())


def _without_held_out(found: _Explained, workers: int) -> tuple[tuple[int, ...], Fit, Fit]:
    """Tolerances alone and the best fit, without the records held out; the fits to all, and none, where time is up."""
    best, seen, tuned, outside = found.best, found.seen, found.plain, found.best
    try:
        with share(_HELD_OUT, within_steps=True):
            if found.refitted is not None:
                tuned, outside = found.refitted
            elif found.held_out and found.follows == "hammers":
                tuned = refit(seen, found.plain, workers, found.kept)[0]
                outside = refit_backlash_impacts(seen, best)
            elif found.held_out:
                tuned, outside = refit(seen, best, workers, found.kept, synchronised=bool(found.follows))
    except TimeUp:
        leave_out("records held out")
        return (), found.plain, best
    return found.held_out, tuned, outside


def _shown(
    found: _Explained, kept_out: tuple[int, ...], tuned: Fit, outside: Fit
) -> tuple[Gap, tuple[Errors, ...], Fit, bool, str]:
    """What predictions of the records come to.

    Returns:
        how far the gap closes; errors of each record, from rest; the fit that the updated prototype is written from;
        whether records held out do not speak against what is chosen; and how far it closes, in a sentence.
    """
    best, records, oscillates = found.best, found.records, found.follows == "oscillates"
    from_rest = tuple(errors(piece, tuned, outside, best) for piece in records)
    measured = synchronised = gap(from_rest, kept_out)
    written, worse = best, not best.hypothesis.names and not found.follows and measured.after > measured.before
    if worse:  # figures that predict worse what they have not seen are no better known than those believed
        written = replace(best, z=np.zeros_like(best.z))
        from_rest = tuple(errors(piece, tuned, written, written) for piece in records)
        measured = synchronised = gap(from_rest, kept_out)
    if found.follows:
        # What cannot be predicted from rest neither confirms nor refutes what is chosen: models that follow it do.
        synchronised = gap([errors(with_output_injection(piece), tuned, outside, best) for piece in records], kept_out)
        measured = synchronised if oscillates else measured
    words = (
        f"On {'records left out of the fits that measure it' if kept_out else 'the records fitted, all of them'}, the "
        f"{'error in step' if oscillates else 'prediction error'} "
        f"{'stays at' if worse else 'falls from'} {measured.before:.1%} of the signal "
        f"({measured.tuned:.1%} with tolerances re-tuned"
        f"{', so that the prototype keeps those believed)' if worse else f') to {measured.after:.1%}'}; "
        f"the sensor's noise alone is {measured.noise_floor:.1%}."
    )
    return measured, from_rest, written, confirmed(synchronised), words


def _asked(found: _Explained) -> NextExperiment | None:
    """What to measure next, to tell the most probable fits apart."""
    of = found.judged.of
    fits = [f for f in (found.search.null, *found.search.fits) if f.hypothesis in of]
    fits.sort(key=lambda f: -of[f.hypothesis])
    return next_experiment(found.data, fits, [of[f.hypothesis] for f in fits])


def _far(piece: Evidence, best: Fit) -> bool:
    """Whether it is a critical gain that is far from what the chosen model makes of it, and has to be near."""
    if not isinstance(piece, GainEvidence):
        return False
    at = piece.predicted(best.hypothesis.placement(piece.prototype), best.z)
    near = at is None or piece.swung(at) or 1 / GAIN_FAR < piece.measured.gain / at.gain < GAIN_FAR
    return not near


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
                with share(1.0, within_steps=True):
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


def _in_time(part: float, named: str, look: Callable[[], _T | None]) -> _T | None:
    """What a further look finds in a part of the time that is left; None where the time is up, with a word."""
    try:
        with share(part, within_steps=True):
            return look()
    except TimeUp:
        leave_out(named)
        return None
