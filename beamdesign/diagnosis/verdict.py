"""The verdict of a diagnosis and its words, whatever the evidence: from probabilities, and from how they compare."""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from math import nan
from pathlib import Path

import numpy as np

from beamdesign.diagnosis.diagnosis import Cause, Gap, Verdict, Where, in_words, listed, named
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, unlike
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.judgement import LEAST_PROBABILITY, Judgement
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.prototype import Prototype

_FURTHEST = 3  # figures that are told
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


def far_fetched(found: Fit, prototype: Prototype) -> str:
    """Why the causes of a fit may well stand for something else, however little they leave, in words; empty where not.

    Args:
        found: any fit.
        prototype: that it was made to, as believed.
    """
    moved = found.moved
    furthest = sorted(found.strained, key=lambda name: -abs(moved[name]))[:_FURTHEST]
    off = (f"{in_words(name)} has to be {moved[name]:+.1f} tolerances off" for name in furthest)
    why = "; ".join((*unlike(found.hypothesis, found.values, prototype), *off))
    stands = f"{named(str(found.hypothesis))} may stand for something else that moves alike"
    return f"{stands}: {why}" if why and found.hypothesis.names else ""


def leaves_much(found: Fit, of: Search) -> str:
    """That effects explain too little of a gap to be sure of them, in words; empty where not."""
    left = of.excess(found) if of.null.misfit > THRESHOLDS.a_gap * of.expected else 0.0
    much = bool(found.hypothesis.effects) and left > 1 - THRESHOLDS.explains
    return f"{named(str(found.hypothesis))} leaves {left:.0%} of what tolerances leave beyond noise" * much


def verdict_of(judged: Judgement, doubtful: bool = False, rare: float = nan, few: bool = False) -> Verdict:
    """What the probabilities come to.

    Data that are not what they should be allow no confident answer, nor do figures strained to make a cause fit (a
    resonance that is missing, fitted as a delay).

    Args:
        judged: the probabilities.
        doubtful: whether data or conditions held out speak against them.
        rare: of rigs without a gap, the share that is judged so, see `chance`; there is no gap above `LEVEL`, and below
            it something is missing even where nothing known explains it. NaN where it is not known.
        few: whether there are figures of the loop alone: too few to tell what is at work beside a cause, so that it
            need only be sure itself, and none has to be more probable than all causes together.
    """
    if judged.unknown > 0.5 and not rare > LEVEL:
        return "unknown"
    named = judged.best.hypothesis.names
    if doubtful or (named and judged.best.strained):
        return "ambiguous" if named else "unknown"
    if not named:
        sure = not few or judged.of[judged.best.hypothesis] > 0.5
        return "unknown" if rare <= LEVEL else "no_gap" if sure else "ambiguous"
    if few:
        causes = {*judged.best.hypothesis.causes}
        sure = sum(p for h, p in judged.of.items() if causes <= {*h.causes}) >= THRESHOLDS.confident_by_gains
    else:
        sure = judged.of_causes[judged.best.hypothesis.causes] >= THRESHOLDS.confident
    return "effect" if sure else "ambiguous"


def confirmed(measured: Gap) -> bool:
    """Whether conditions held out do not speak against what is chosen: re-tuned tolerances predict them no better."""
    return measured.after <= max(THRESHOLDS.worse * measured.tuned, THRESHOLDS.near_noise * measured.noise_floor)


def classes(judged: Judgement) -> tuple[tuple[str, ...], ...]:
    """Sets of names, any of which may be the answer: what differs between hypotheses with 95 % of the probability."""
    ranked = sorted(judged.of.items(), key=lambda item: -item[1])
    sums = np.cumsum([p for _, p in ranked]) / max(1e-12, 1 - judged.unknown)
    kept = [hypothesis for hypothesis, _ in ranked[: int(np.searchsorted(sums, 0.95, side="right")) + 1]]
    common = set.intersection(*(set(h.causes) for h in kept))
    rivals = sorted({str(Hypothesis(tuple(n for n in h.causes if n not in common))) for h in kept})
    return (tuple(rivals),) if len(rivals) > 1 else ()


OUTSIDE = "unknown"
"""Stands in a class for something that the library does not hold."""
_SHOWN = 5


def sentences(
    verdict: Verdict,
    causes: Sequence[Cause],
    chosen: Sequence[str],
    errors: str,
    where: Where,
    rivals: Sequence[str] = (),
    complete: bool = True,
    rare: float = nan,
    unknown: float = nan,
    none: float = nan,
) -> str:
    """The verdict for people: what it is, how probable it is without a gap, and how far the gap closes.

    Args:
        verdict: in a word.
        causes: most probable first.
        chosen: names of those that are held responsible.
        errors: what the gap was and is, in a sentence.
        where: it lies.
        rivals: sets of causes that the data do not tell apart, where those are few enough to be counted up.
        complete: whether everything that is known was compared.
        rare: see `verdict_of`.
        unknown: probability that the cause is none that is known; NaN where that is told otherwise.
        none: probability that there is none beyond tolerances; NaN likewise.
    """
    words = {c.name: f"{named(c.name)} ({c.probability:.0%})" for c in causes}
    culprits = listed([words[name] for name in chosen])
    match verdict:
        case "no_gap":
            first = "There is no gap that the tolerances of the prototype would not explain."
        case "effect":
            first = f"The gap is caused by {culprits}."
        case "ambiguous" if len(rivals) > 1:
            shown = [in_words(f"something {name}" if name == OUTSIDE else name) for name in rivals[:_SHOWN]]
            more = f"; and {len(rivals) - _SHOWN} more" if len(rivals) > _SHOWN else ""
            common = f"All of them hold {culprits}." if chosen else "No single culprit can be named."
            first = f"These data cannot tell apart: {'; '.join(shown)}{more}. {common}"
        case "ambiguous":
            others = [f"tolerances alone ({none:.0%})"] * (none >= LEAST_PROBABILITY)
            others += [words[c.name] for c in causes if c.name not in chosen][:3]
            others += [f"something that is not known here ({unknown:.0%})"] if unknown >= LEAST_PROBABILITY else []
            also = f"; it may as well be {listed(others, 'or')}" if others else ""
            probable = {c.name: c.probability for c in causes}
            first = f"The gap is most probably caused by {culprits}{also}."
            if max(probable.values(), default=0.0) > max((probable[name] for name in chosen), default=1.0):
                predicts = "predicts" if len(chosen) == 1 else "predict"
                first = f"Of what is nearly as probable, {culprits} {predicts} best what was held out{also}."
        case _ if unknown <= 0.5 and not rare <= LEVEL:
            first = "What was compared leaves no gap that the tolerances of the prototype would not explain."
            if complete:
                first = "These data bear no answer (see the warnings); as far as they go, tolerances explain them."
        case _:
            place = f" It lies in the {where.subsystem}." if where.subsystem else ""
            first = f"Nothing that {'is known here' if complete else 'was compared'} explains the gap.{place}"
            learnt = [f"{c.like} at the port {in_words(c.name.partition(':')[2])}" for c in causes if c.like]
            learnt += [words[c.name] for c in causes if c.name in chosen and not c.like] if learnt else []
            first += f" Learnt from the records: {listed(learnt)}." if learnt else ""
    if rare <= LEVEL and verdict != "no_gap":
        first += f" Of rigs without a gap at most {rare:.1%} are judged to be as far from having none."
    hurried = "Not everything was compared in the time given, and probabilities are among what was. "
    return f"{'' if complete else hurried}{first} {errors}"
