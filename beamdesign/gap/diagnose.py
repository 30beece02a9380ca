"""The diagnosis of a data set: where its gap lies, what causes it, how far it closes."""

from dataclasses import replace

from beamdesign.gap.amended import amended
from beamdesign.gap.causes import causes, classes
from beamdesign.gap.dataset import Dataset
from beamdesign.gap.diagnosis import Diagnosis, Verdict, Where
from beamdesign.gap.evidence import record_evidence
from beamdesign.gap.holdout import held_out
from beamdesign.gap.judgement import Judgement, judge
from beamdesign.gap.kept_fits import KeptFits
from beamdesign.gap.search import Progress, search
from beamdesign.gap.shrink import errors, gap
from beamdesign.gap.wording import sentences

CONFIDENT = 0.7
"""Probability of the best hypothesis from which the verdict is not called ambiguous."""


def diagnose(
    data: Dataset,
    workers: int = 2,
    progress: Progress = lambda share, words: None,
    kept: KeptFits | None = None,
) -> Diagnosis:
    """Diagnose the gap between a prototype and its rig.

    Args:
        data: what came back from the rig.
        workers: processes.
        progress: told the share done and what is being done.
        kept: fits of an earlier run, where those of this one are kept as well.
    """
    kept_out = held_out(data.records)
    seen = replace(data, records=tuple(r for k, r in enumerate(data.records) if k not in kept_out))
    found = search(seen, workers, progress, kept)
    judged = judge(found)
    verdict = verdict_of(judged)
    best = judged.best
    alone = record_evidence(data)
    measured = gap([errors(piece, data.prototype, found.null, best) for piece in alone], kept_out)
    ranked = causes(found, judged)
    chosen = tuple(c.name for c in ranked if c.name in best.hypothesis.names) if verdict != "unknown" else ()
    where = Where(ranked[0].subsystem if chosen else "", (0.2, 400.0), "")
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
        None,
        amended(data.prototype, best if verdict != "unknown" else found.null),
        data.warnings,
        found,
    )


def verdict_of(judged: Judgement) -> Verdict:
    """What the probabilities come to."""
    if judged.unknown > 0.5:
        return "unknown"
    if not judged.best.hypothesis.names:
        return "no_gap"
    return "effect" if judged.of[judged.best.hypothesis] >= CONFIDENT * (1 - judged.unknown) else "ambiguous"
