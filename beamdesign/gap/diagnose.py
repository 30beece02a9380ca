"""The diagnosis of a data set: where its gap lies, what causes it, how far it closes."""

from dataclasses import replace

from beamdesign.gap.amended import amended
from beamdesign.gap.causes import causes, classes
from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.diagnosis import Diagnosis, Gap, Verdict
from beamdesign.gap.examination.plausibility import examine
from beamdesign.gap.experiment import next_experiment
from beamdesign.gap.fitting.evidence import evidence_of, record_evidence
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.followed import PLAY, followed
from beamdesign.gap.fitting.hammering import hammering, refit_hammering
from beamdesign.gap.fitting.holdout import held_out
from beamdesign.gap.fitting.kept_fits import KeptFits
from beamdesign.gap.fitting.search import Progress, Search, refit, search
from beamdesign.gap.gains.classes import explain_gains
from beamdesign.gap.judgement import Judgement, judge
from beamdesign.gap.separability import indistinguishable
from beamdesign.gap.shrink import errors, gap
from beamdesign.gap.where.locate import locate
from beamdesign.gap.wording import sentences

HAMMERS = (
    "a joint hammers in its play, so that the motion of small records cannot be repeated: fits follow the records, and "
    "prediction errors from rest stay larger than the model is wrong"
)
CONFIDENT = 0.7
"""Probability of the best hypothesis from which the verdict is not called ambiguous."""
_WORSE = 1.1  # times the error of re-tuned tolerances: what held-out conditions speak against
_NEAR = 2.0  # times the noise: what they never do


def diagnose(
    data: Dataset,
    workers: int = 2,
    progress: Progress = lambda share, words: None,
    kept: KeptFits | None = None,
) -> Diagnosis:
    """Diagnose the gap between a prototype and its rig.

    Time records, with or without other figures, are explained by fits; figures alone by `explain_gains`, also where no
    record turns out to be sound.

    Args:
        data: what came back from the rig.
        workers: processes.
        progress: told the share done and what is being done.
        kept: fits of an earlier run, where those of this one are kept as well.

    Raises:
        InputError: where the data cannot be what they say they are; see `beamdesign.gap.examination.plausibility`.
    """
    stated = data.prototype.tolerance
    examined = examine(data)
    data = examined.data
    if not data.records:
        figures_only = explain_gains(replace(data, warnings=examined.words), progress)
        return replace(figures_only, prototype=figures_only.prototype.but(tolerance=stated))
    kept_out = held_out(data.records)
    seen = replace(data, records=tuple(r for k, r in enumerate(data.records) if k not in kept_out))
    found = search(data, workers, progress, kept)
    judged, words, plain = judge(found), examined.words, found.null
    again = _with_play(data, found, progress) if judged.unknown > 0.5 else None
    hammers = again is not None
    if again is not None:
        found, judged = again
        words = (*words, HAMMERS)
    best = judged.best if verdict_of(judged, examined.limits_confidence) != "unknown" else found.null
    progress(0.96, "what the data can tell")
    told = indistinguishable(data, evidence_of(data))
    progress(0.97, "records held out")
    tuned, outside = refit(seen, plain if hammers else best, workers, kept) if kept_out else (plain, best)
    if hammers:
        outside = refit_hammering(seen, best)
    ranked = causes(found, judged)
    chosen = tuple(c.name for c in ranked if c.name in best.hypothesis.causes)
    alone = record_evidence(data)
    measured = gap([errors(piece, data.prototype, tuned, outside, best) for piece in alone], kept_out)
    # What cannot be predicted from rest neither confirms nor refutes.
    seen_again = (
        gap([errors(followed(p), data.prototype, tuned, outside, best) for p in alone], kept_out)
        if hammers
        else measured
    )
    verdict = verdict_of(judged, examined.limits_confidence or not confirmed(seen_again))
    progress(1.0, "where the gap lies")
    where = locate(data, found, best, evidence_of(data), [c for c in ranked if c.name in chosen], judged.unknown)
    return Diagnosis(
        data.name,
        verdict,
        sentences(verdict, ranked, chosen, measured, where),
        ranked,
        chosen,
        judged.unknown,
        where,
        measured,
        classes(judged),
        next_experiment(data, rivals(found, judged)) if verdict in ("ambiguous", "unknown") else None,
        amended(data.prototype, best).but(tolerance=stated),
        words,
        found,
        (tuned, outside),
        told,
    )


def _with_play(data: Dataset, found: Search, progress: Progress) -> tuple[Search, Judgement] | None:
    """The second search where it explains what the first has not, by play; by anything else it is not believed."""
    again = hammering(data, found, lambda share, doing: progress(0.9 + 0.06 * share, doing))
    if again is None:
        return None
    judged = judge(again)
    return (again, judged) if judged.unknown <= 0.5 and PLAY in judged.best.hypothesis.causes else None


def verdict_of(judged: Judgement, doubtful: bool = False) -> Verdict:
    """What the probabilities come to.

    Data that are not what they should be allow no confident answer, nor do figures strained to make a cause fit (a
    resonance that is missing, fitted as a delay).
    """
    if judged.unknown > 0.5:
        return "unknown"
    named = bool(judged.best.hypothesis.names)
    if doubtful or (named and judged.strained):
        return "ambiguous" if named else "unknown"
    if not named:
        return "no_gap"
    return "effect" if judged.sure >= CONFIDENT * (1 - judged.unknown) else "ambiguous"


def confirmed(measured: Gap) -> bool:
    """Whether conditions held out do not speak against what is chosen: re-tuned tolerances predict them no better."""
    return measured.after <= max(_WORSE * measured.tuned, _NEAR * measured.noise_floor)


def rivals(found: Search, judged: Judgement) -> list[Fit]:
    """The most probable fits, best first; the next experiment has to tell them apart."""
    fits = (found.null, *found.fits)
    return sorted((f for f in fits if f.hypothesis in judged.of), key=lambda f: -judged.of[f.hypothesis])
