"""What critical gains and frequency responses alone can say about a gap: mostly a class of causes, with shares.

How far the gap closes is told in relative errors of each figure as predicted from all the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, log, tau
from typing import Any

import numpy as np
from scipy.special import expit, logsumexp

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import (
    Diagnosis,
    Gap,
    RecordGap,
    Verdict,
    Where,
    in_words,
    no_surer,
    unfinished,
    updated_prototype,
)
from beamdesign.diagnosis.fitting.evidence import Figure, figures_of
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import FREE, NOTHING, Hypothesis, pairs, singles, subsystem
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.fitting.starts import fit_from_starts
from beamdesign.diagnosis.gain_findings import (
    CommonFactor,
    GainShares,
    another_size,
    factor_of,
    gain_shares,
    next_experiment,
    notes_of,
    notes_on_predictions,
)
from beamdesign.diagnosis.gap_metrics import gap_of_pieces
from beamdesign.diagnosis.judgement import LEAST_PROBABILITY, THRESHOLDS, Judgement, cause_sets, causes, judge, odds
from beamdesign.diagnosis.judgement import evidence as marginal_likelihood
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.result import picked
from beamdesign.time_limit import left_out, share, while_time

OUTSIDE = "unknown"
"""Stands in a class for something that the library does not hold."""
_CERTAIN = 50.0  # in the logarithm of odds: more is no more


@dataclass(frozen=True)
class GainDiagnosis(Diagnosis[Prototype]):
    """A diagnosis from figures of the loop instead of time records; errors of its gap are relative ones.

    Attributes:
        silent: effects that leave no trace in such data, whatever their size.
        shares: what the sensor's filter and the piston's smaller side of the published rig would carry of the mean
            distance, and what is left to one common factor; None without critical gains.
        factor: one common factor on the model's gains.
        on_predictions: the same from another starting point, where the data set holds what the designers predicted: the
            gap between measurement and these predictions, of which the model tells the changes only.
    """

    MEASURE = "Relative errors of each figure as predicted from all the others."

    silent: tuple[str, ...] = ()
    shares: GainShares | None = None
    factor: CommonFactor | None = None
    on_predictions: "GainDiagnosis | None" = None

    @property
    def ranked(self) -> tuple[tuple[str, float], ...]:
        """Hypotheses with 1 % of the probability or more, best first, with that probability; the null among them."""
        return tuple((str(h), h.probability) for h in self.hypotheses if h.probability >= LEAST_PROBABILITY)

    @property
    def own_fields(self) -> dict[str, Any]:
        """Beside those of any diagnosis."""
        found = picked(self, "notes silent shares factor ranked")
        if self.on_predictions is not None:
            found["on_predictions"] = self.on_predictions.to_dict()
        return found


def explain_gains(data: Dataset, progress: Progress = silent) -> GainDiagnosis:
    """Diagnose from critical gains and frequency responses.

    Nulls first (tolerances alone, one common factor), then every cause, then pairs, weighed by Laplace's marginal
    likelihood under the same odds as elsewhere. Explanations whose probabilities differ by less than 20 to 1 make a
    class. Where none is sure, `chosen` holds only what all members of the class share.

    Args:
        data: with critical gains or frequency responses; its time records are left aside.
        progress: told the share done and what is being done.

    Raises:
        InputError: where it has neither, or where the believed model oscillates at no gain, or where a response was
            taken, whatever its figures within their tolerances.
    """
    evidence = figures_of(replace(data, records=()))
    if not evidence:
        raise InputError(data.folder, [("critical_gain", "missing; the set holds no frequency_response either")])
    if not any(taken.predicted_gain for taken in data.gains):
        return _explained(data, evidence, progress)
    moved = tuple(
        replace(piece, offset=log(foreseen / at.gain))
        if isinstance(piece, GainEvidence)
        and (foreseen := piece.measured.predicted_gain) is not None
        and (at := piece.nominal()) is not None
        else piece
        for piece in evidence
    )
    with share(0.5):
        own = _explained(data, evidence, lambda part, words: progress(part / 2, words))
    other = _explained(data, moved, lambda part, words: progress(0.5 + part / 2, words))
    gains = [piece for piece in evidence if isinstance(piece, GainEvidence)]
    more = notes_on_predictions(gains, other.factor, other.sentences)
    return replace(own, on_predictions=other, notes=(*own.notes, *more))


def _explained(data: Dataset, evidence: Sequence[Figure], progress: Progress) -> GainDiagnosis:
    found, silent = search_few(evidence, data.prototype, progress)
    if found.null.reason:
        key = "frequency_response" if data.responses else "critical_gain"
        words = "the believed model oscillates at no gain, or where a response was taken"
        raise InputError(data.folder, [(key, words)])
    fits = [f for f in (found.null, *found.fits) if not f.reason]
    spread = max(1.0, min(f.misfit for f in fits) / found.expected)
    fits.sort(key=lambda f: -log_posterior(f, spread))
    logs = np.array([log_posterior(f, spread) for f in fits])
    known = float(logsumexp(logs))
    # What the best explanation leaves of a gap speaks for something else as well, as with time records.
    margin = np.clip(log_outside(evidence, found.null, spread) - known, -_CERTAIN, _CERTAIN)
    unknown = max(float(expit(margin)), judge(found).unknown)
    weights = np.exp(logs - known) * (1 - unknown)
    judged = Judgement({f.hypothesis: float(w) for f, w in zip(fits, weights, strict=True)}, unknown, fits[0])
    rivals = rivals_of(fits, logs, silent)
    verdict = no_surer(verdict_of(judged, rivals, silent), left := left_out())
    named = verdict in ("effect", "ambiguous")
    alike = rivals if verdict == "ambiguous" else rivals[: int(named)]
    common = set.intersection(*(set(f.hypothesis.names) for f in alike)) if alike else set()
    chosen = tuple(name for name in rivals[0].hypothesis.names if name in common)  # sure, or what all rivals share
    holder = next((f for f in fits if f.hypothesis == Hypothesis(tuple(sorted(chosen)))), found.null)
    after = rivals[0] if named else found.null
    listed = tuple(c for c in causes(found, judged) if c.name not in silent)
    names = [str(f.hypothesis) for f in rivals]
    if unknown > judged.of[judged.best.hypothesis] * exp(-THRESHOLDS.separate):
        names.append(OUTSIDE)
    classes = (tuple(names),) if named and len(names) > 1 else ()
    gains = [piece for piece in evidence if isinstance(piece, GainEvidence)]
    factor, shares = factor_of(gains), gain_shares(gains)
    gap = figures_of_gap(evidence, found.null, after)
    asked = another_size(data) if verdict in ("ambiguous", "unknown") and not left else None
    if verdict == "ambiguous" and not left:
        asked = next_experiment(data, rivals, [judged.of[f.hypothesis] for f in rivals]) or asked
    progress(1.0, "done")
    return GainDiagnosis(
        data.name,
        verdict,
        unfinished(left) + sentences(verdict, names, chosen, gap, complete=not left),
        listed,
        chosen,
        unknown,
        where_of(alike, evidence, found.null),
        gap,
        classes,
        asked,
        updated_prototype(data.prototype, holder),
        data.warnings,
        found,
        hypotheses=cause_sets(found, judged),
        silent=silent,
        shares=shares,
        factor=factor,
        notes=notes_of(silent, shares, factor),
        left_out=left,
    )


def log_outside(evidence: Sequence[Figure], null: Fit, spread: float) -> float:
    """Logarithm of the probability, on the scale of `log_posterior`, that something outside the library is at work.

    It is taken to change every figure by a factor of its own, of the same spread as that of a plainly wrong figure.
    """
    nominal = np.zeros(len(null.z))
    placement = NOTHING.placement(evidence[0].prototype)
    found = [(*row, piece.units) for piece in evidence if (row := piece.linearised(placement, nominal)) is not None]
    r, j, units = (np.concatenate(parts) for parts in zip(*found, strict=True))
    r, j, units = r / np.sqrt(spread), j / np.sqrt(spread), units * np.sqrt(spread)
    covariance = np.eye(len(r)) + j @ j.T + np.diag((FREE / units) ** 2)
    _, volume = np.linalg.slogdet(covariance)
    return -0.5 * (float(r @ np.linalg.solve(covariance, r)) + float(volume)) + THRESHOLDS.effect_odds


def rivals_of(ranked: Sequence[Fit], logs: np.ndarray, silent: Sequence[str]) -> list[Fit]:
    """Hypotheses that the data cannot tell from the best, without those that hold one of the others and are no better.

    An effect that leaves no trace is no rival. The null is one where it comes near enough; a cause is a rival beside it
    where the data speak for it at all, whatever the odds were before.
    """
    near = [
        (f, value)
        for f, value in zip(ranked, logs, strict=True)
        if value > logs[0] - THRESHOLDS.separate and not set(silent) & set(f.hypothesis.names)
    ]

    def spared(simple: Fit, simple_log: float, f: Fit, value: float) -> bool:
        if simple.hypothesis == NOTHING:
            return simple_log < value - odds(f.hypothesis)
        return not set(simple.hypothesis.names) < set(f.hypothesis.names) or simple_log < value

    return [f for f, value in near if all(g is f or spared(g, better, f, value) for g, better in near)]


def verdict_of(judged: Judgement, rivals: Sequence[Fit], silent: Sequence[str]) -> Verdict:
    """What the probabilities come to; an effect that leaves no trace counts as none."""
    if judged.unknown > 0.5:
        return "unknown"
    if sum(p for h, p in judged.of.items() if set(h.names) <= set(silent)) > 0.5:
        return "no_gap"
    named = set(rivals[0].hypothesis.names)
    sure = sum(p for h, p in judged.of.items() if named <= set(h.names)) >= THRESHOLDS.confident_by_gains
    return "effect" if named and sure else "ambiguous"


def where_of(rivals: Sequence[Fit], evidence: Sequence[Figure], null: Fit) -> Where:
    """The subsystem that all rivals share, and the band of the oscillations or the lines."""
    at = []
    for piece in evidence:
        if isinstance(piece, GainEvidence):
            onset = piece.predicted(NOTHING.placement(piece.prototype), null.z)
            at += [onset.frequency / tau] if onset else []
        else:
            at += list(piece.measured.frequencies_Hz[[0, -1]])
    band = (float(f"{min(at):.3g}"), float(f"{max(at):.3g}")) if at else (0.0, 0.0)
    if not rivals:
        return Where("", band, "", "linear")
    places = {subsystem(name) for f in rivals for name in f.hypothesis.names}
    worst = max(evidence, key=lambda piece: misfit_of(piece, NOTHING, np.zeros(len(null.z))))
    return Where(places.pop() if len(places) == 1 else "", band, f"most in: {worst.name}", "linear")


_DRAWS = 2000
_LOST = 1.0  # relative error of a model that cannot predict at all
_FURTHEST = 2.0


def misfit_of(piece: Figure, hypothesis: Hypothesis, z: np.ndarray) -> float:
    """Rms of ln(measured/predicted) of one piece of evidence."""
    placement = hypothesis.placement(piece.prototype)
    residual = piece.residual(placement, z)
    if residual is None:
        return _LOST
    return float(np.sqrt(np.mean((residual * piece.units) ** 2)))


def without(found: Fit, position: int) -> np.ndarray:
    """Unknowns of a fit as all the evidence but one piece would have them, by one Newton step."""
    share = found.shares[position]
    rest = np.eye(len(found.z)) + sum(s.a for k, s in enumerate(found.shares) if k != position)
    move = np.clip(np.linalg.solve(rest, share.g), -_FURTHEST, _FURTHEST)
    low, high = (np.array(side) for side in zip(*(u.bounds for u in found.unknowns), strict=True))
    return np.asarray(np.clip(found.z + move, low, high))


def figures_of_gap(evidence: Sequence[Figure], null: Fit, after: Fit) -> Gap:
    """Relative errors before, with tolerances fitted and with the best explanation, one piece left out at a time.

    Args:
        evidence: in the order of the fits' shares.
        null: tolerances alone.
        after: the explanation.

    Returns:
        with a 90 % interval of `closed` by the bootstrap over pieces.
    """
    nominal = np.zeros(len(null.z))
    rows = [
        (
            misfit_of(piece, NOTHING, nominal),
            misfit_of(piece, NOTHING, without(null, k)),
            misfit_of(piece, after.hypothesis, without(after, k)),
            float(np.sqrt(np.mean(piece.units**2) * piece.expected / len(piece.units))),
        )
        for k, piece in enumerate(evidence)
    ]
    records = tuple(RecordGap(piece.name, True, *row) for piece, row in zip(evidence, rows, strict=True))
    return gap_of_pieces(np.array(rows), records, 0, _DRAWS, most=1.0)


_SHOWN = 5


def sentences(verdict: Verdict, rivals: Sequence[str], chosen: Sequence[str], gap: Gap, complete: bool = True) -> str:
    """The verdict in two sentences."""
    errors = (
        f"Each figure as predicted from the others is off by {gap.before:.0%} for the believed model, by"
        f" {gap.tuned:.0%} with tolerances fitted and by {gap.after:.0%} with the best explanation; their own errors"
        f" are {gap.noise_floor:.0%}."
    )
    named = [_said(name) for name in rivals]
    match verdict:
        case "no_gap":
            first = "There is no gap that the tolerances of the prototype would not explain."
        case "effect":
            first = f"The gap is caused by {_said(' + '.join(chosen))}."
        case "ambiguous":
            more = f"; and {len(named) - _SHOWN} more" if len(named) > _SHOWN else ""
            common = f"All of them hold {_said(' + '.join(chosen))}." if chosen else "No single culprit can be named."
            first = f"These figures cannot tell apart: {'; '.join(named[:_SHOWN])}{more}. {common}"
        case _:
            first = f"Nothing that {'is known here' if complete else 'was compared'} explains these figures."
    return f"{first} {errors}"


def _said(name: str) -> str:
    return "something unknown" if name == OUTSIDE else in_words(name)


_SINGLES = 0.3  # of the work
_QUICK = 3  # iterations, which show whether a pair is worth settling
_BEST = 5  # single causes that pairs are made with
_EXPLAINED = 1.5  # times the misfit of noise: what a single cause leaves at most where it explains the figures
_HOPEFUL = 4.0  # in the logarithm of the probability


def search_few(
    evidence: Sequence[Figure], prototype: Prototype, progress: Progress = silent
) -> tuple[Search, tuple[str, ...]]:
    """Fit tolerances alone, every cause, and pairs of which one is an effect.

    Pairs are tried though a single cause may suffice: with few figures they decide how sure it can be. They are those
    with one of the most probable single causes, or all where none of these explains the figures. Pairs far from the
    most probable are left where a few iterations have brought them. Two plainly wrong figures at once are not tried.

    Args:
        evidence: what is to be explained.
        prototype: that was believed.
        progress: told the share done and what is being done.

    Returns:
        the fits, and the effects that do not show in such data at all; these are in no pair.
    """
    progress(0.0, "tolerances")
    null = fit_from_starts(NOTHING, prototype, evidence, {}, most=1)
    expected = sum(piece.expected for piece in evidence)
    if null.reason:
        return Search(null, (), expected), ()
    listed = [h for h in singles(prototype) if h.names == h.causes]  # gains tell no two laws of one effect apart
    alone = {}
    for k, hypothesis in enumerate(while_time(listed)):
        alone[hypothesis] = fit_from_starts(hypothesis, prototype, evidence, null.values)
        progress(_SINGLES * (k + 1) / len(listed), "single causes")
    silent = tuple(h.names[0] for h, found in alone.items() if h.effects and not found.reason and not _shows(found))
    visible = tuple(h for h in alone if h.names[0] not in silent)
    best = sorted((h for h in visible if not alone[h].reason), key=lambda h: -log_posterior(alone[h]))[:_BEST]
    every = bool(best) and alone[best[0]].misfit > _EXPLAINED * expected
    tried = [p for p in pairs(visible) if p.effects and (every or any({*h.names} < {*p.names} for h in best))]
    found = list(alone.values())
    for k, hypothesis in enumerate(while_time(tried)):
        parts = (alone[Hypothesis((name,))] for name in hypothesis.names)
        known = null.values | {name: value for part in parts if not part.reason for name, value in part.values.items()}
        found.append(fit_from_starts(hypothesis, prototype, evidence, known, most=1, iterations=_QUICK))
        progress(_SINGLES + (1 - _SINGLES) * (k + 1) / len(tried), "pairs")
    least = max(log_posterior(f) for f in (null, *found)) - _HOPEFUL
    for k, hopeful in enumerate(found):
        if len(hopeful.hypothesis.names) == 2 and log_posterior(hopeful) > least:
            found[k] = fit_from_starts(hopeful.hypothesis, prototype, evidence, hopeful.values, most=1)
    return Search(null, tuple(sorted(found, key=lambda f: f.cost)), expected), silent


def log_posterior(found: Fit, spread: float = 1.0) -> float:
    """Logarithm of a fit's probability, up to a constant: Laplace's marginal likelihood and the odds of its causes.

    Args:
        found: the fit.
        spread: how much larger the best misfit is than the measurements' errors explain; 1 where these are right.
    """
    return marginal_likelihood(found, spread) + odds(found.hypothesis)


def _shows(found: Fit) -> bool:
    """Whether some parameter of the effect has a part in what was measured."""
    own = [k for k, u in enumerate(found.unknowns) if u.kind == "effect"]
    return bool(np.any(np.abs(np.array([share.a for share in found.shares])[:, own]) > 0))
