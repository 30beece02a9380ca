"""What critical gains and frequency responses alone can say about a gap: mostly a class of causes, with shares.

How far the gap closes is told in relative errors of each figure as predicted from all the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, log, tau
from typing import Any

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import Diagnosis, Gap, RecordGap, Verdict, Where, diagnosis_fields, in_words
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import FREE, NOTHING, Hypothesis, subsystem
from beamdesign.diagnosis.gains.next_gain import another_size, next_experiment
from beamdesign.diagnosis.gains.search import Figure, figures_of, log_posterior, search_few
from beamdesign.diagnosis.gains.shares import CommonFactor, GainShares, common_factor, gain_shares
from beamdesign.diagnosis.gap_metrics import gap_of_pieces
from beamdesign.diagnosis.judgement import LEAST_PROBABILITY, THRESHOLDS, Judgement, cause_sets, causes, judge, odds
from beamdesign.diagnosis.updated_prototype import updated_prototype
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.records import InputError

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
        return tuple(
            (str(Hypothesis(one.names)), one.probability)
            for one in self.hypotheses
            if one.probability >= LEAST_PROBABILITY
        )

    @property
    def own_fields(self) -> dict[str, Any]:
        """Beside those of any diagnosis."""
        found = {name: getattr(self, name) for name in ("notes", "silent", "shares", "factor", "ranked")}
        if self.on_predictions is not None:
            found["on_predictions"] = diagnosis_fields(self.on_predictions)
        return found


def explain_gains(data: Dataset, progress: Progress = silent, among: Sequence[str] = ()) -> GainDiagnosis:
    """Diagnose from critical gains and frequency responses.

    Nulls first (tolerances alone, one common factor), then every cause, then pairs, weighed by Laplace's marginal
    likelihood under the same odds as elsewhere. Explanations whose probabilities differ by less than 20 to 1 make a
    class. Where none is sure, `chosen` holds only what all members of the class share.

    Args:
        data: with critical gains or frequency responses; its time records are left aside.
        progress: told the share done and what is being done.
        among: names of the causes that come into question; all where empty.

    Raises:
        InputError: where it has neither, or where the believed model oscillates at no gain, or where a response was
            taken, whatever its figures within their tolerances.
    """
    evidence = figures_of(data)
    if not evidence:
        raise InputError(data.folder, [("critical_gain", "missing; the set holds no frequency_response either")])
    if not any(taken.predicted_gain for taken in data.gains):
        return _explained(data, evidence, progress, among)
    placement = NOTHING.placement(data.prototype)
    nominal = np.zeros(len(placement.unknowns))
    moved = tuple(
        replace(piece, offset=log(foreseen / at.gain))
        if isinstance(piece, GainEvidence)
        and (foreseen := piece.measured.predicted_gain) is not None
        and (at := piece.predicted(placement, nominal)) is not None
        else piece
        for piece in evidence
    )
    own = _explained(data, evidence, lambda share, words: progress(share / 2, words), among)
    other = _explained(data, moved, lambda share, words: progress(0.5 + share / 2, words), among)
    more = notes_on_predictions(evidence, other.factor, other.sentences)
    return replace(own, on_predictions=other, notes=(*own.notes, *more))


def _explained(data: Dataset, evidence: Sequence[Figure], progress: Progress, among: Sequence[str]) -> GainDiagnosis:
    found, silent = search_few(evidence, data.prototype, progress, among)
    if found.null.reason:
        key = "frequency_response" if data.responses else "critical_gain"
        words = "the believed model oscillates at no gain, or where a response was taken"
        raise InputError(data.folder, [(key, words)])
    fits = [f for f in (found.null, *found.fits) if not f.reason]
    spread = max(1.0, min(f.misfit for f in fits) / found.expected)
    logs = [log_posterior(f, spread) for f in fits]
    outside = log_outside(evidence, found.null, spread)
    leading = max(logs)
    weights = [exp(value - leading) for value in logs]
    order = sorted(range(len(fits)), key=lambda k: -logs[k])
    # What the best explanation leaves of a gap speaks for something else as well, as with time records.
    margin = float(np.clip(outside - leading - log(sum(weights)), -_CERTAIN, _CERTAIN))
    unknown = max(1 / (1 + exp(-margin)), judge(found).unknown)
    of = {fits[k].hypothesis: weights[k] / sum(weights) * (1 - unknown) for k in order}
    judged = Judgement(of, unknown, fits[order[0]])
    rivals = rivals_of([fits[k] for k in order], [logs[k] for k in order], silent)
    verdict = verdict_of(judged, rivals, silent)
    chosen = chosen_of(verdict, rivals)
    holder = next((f for f in fits if f.hypothesis == Hypothesis(tuple(sorted(chosen)))), found.null)
    after = rivals[0] if verdict in ("effect", "ambiguous") else found.null
    listed = tuple(c for c in causes(found, judged) if c.name not in silent)
    names = [str(f.hypothesis) for f in rivals]
    if unknown > of[judged.best.hypothesis] * exp(-THRESHOLDS.separate):
        names.append(OUTSIDE)
    classes = (tuple(names),) if verdict in ("effect", "ambiguous") and len(names) > 1 else ()
    gains = [piece for piece in evidence if isinstance(piece, GainEvidence)]
    factor = factor_of(gains)
    shares = gain_shares(gains)
    gap = figures_of_gap(evidence, found.null, after)
    asked = None
    if verdict == "ambiguous":
        asked = next_experiment(data, rivals, [of[f.hypothesis] for f in rivals])
    asked = another_size(data) if verdict == "unknown" or (asked is None and verdict == "ambiguous") else asked
    progress(1.0, "done")
    return GainDiagnosis(
        data.name,
        verdict,
        sentences(verdict, names, chosen, gap),
        listed,
        chosen,
        unknown,
        where_of(verdict, rivals, evidence, found.null),
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
    )


def log_outside(evidence: Sequence[Figure], null: Fit, spread: float = 1.0) -> float:
    """Logarithm of the probability, on the scale of `log_posterior`, that something outside the library is at work.

    It is taken to change every figure by a factor of its own, of the same spread as that of a plainly wrong figure.
    """
    nominal = np.zeros(len(null.z))
    placement = NOTHING.placement(evidence[0].prototype)
    rows = [(piece, piece.linearised(placement, nominal)) for piece in evidence]
    r = np.concatenate([row[0] for _, row in rows if row is not None])
    j = np.vstack([row[1] for _, row in rows if row is not None])
    units = np.concatenate([piece.units for piece, row in rows if row is not None])
    r, j, units = r / np.sqrt(spread), j / np.sqrt(spread), units * np.sqrt(spread)
    covariance = np.eye(len(r)) + j @ j.T + np.diag((FREE / units) ** 2)
    _, volume = np.linalg.slogdet(covariance)
    return -0.5 * (float(r @ np.linalg.solve(covariance, r)) + float(volume)) + THRESHOLDS.effect_odds


def rivals_of(ranked: Sequence[Fit], logs: Sequence[float], silent: Sequence[str]) -> list[Fit]:
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


def chosen_of(verdict: Verdict, rivals: Sequence[Fit]) -> tuple[str, ...]:
    """The causes that are sure, or what all rivals share."""
    if verdict in ("no_gap", "unknown"):
        return ()
    if verdict == "effect":
        return rivals[0].hypothesis.names
    common = set.intersection(*(set(f.hypothesis.names) for f in rivals))
    return tuple(name for name in rivals[0].hypothesis.names if name in common)


def where_of(verdict: Verdict, rivals: Sequence[Fit], evidence: Sequence[Figure], null: Fit) -> Where:
    """The subsystem that all rivals share, and the band of the oscillations or the lines."""
    at = []
    for piece in evidence:
        if isinstance(piece, GainEvidence):
            onset = piece.predicted(NOTHING.placement(piece.prototype), null.z)
            at += [onset.frequency / tau] if onset else []
        else:
            at += list(piece.measured.frequencies_Hz[[0, -1]])
    band = (float(f"{min(at):.3g}"), float(f"{max(at):.3g}")) if at else (0.0, 0.0)
    if verdict not in ("effect", "ambiguous"):
        return Where("", band, "", "linear")
    places = {
        subsystem(name) for f in (rivals if verdict == "ambiguous" else rivals[:1]) for name in f.hypothesis.names
    }
    worst = max(evidence, key=lambda piece: left_out(piece, NOTHING, np.zeros(len(null.z))))
    return Where(places.pop() if len(places) == 1 else "", band, f"most in: {worst.name}", "linear")


def factor_of(gains: Sequence[GainEvidence]) -> CommonFactor | None:
    """One common factor on the believed gains; None without gains, or where the model oscillates at none."""
    if not gains:
        return None
    placement = NOTHING.placement(gains[0].prototype)
    model = [piece.predicted(placement, np.zeros(len(placement.unknowns))) for piece in gains]
    if any(at is None for at in model):
        return None
    nominal = [at.gain * exp(piece.offset) for at, piece in zip(model, gains, strict=True) if at is not None]
    return common_factor(
        [piece.measured.gain for piece in gains], nominal, [piece.measured.relative_std for piece in gains]
    )


_DRAWS = 2000
_LOST = 1.0  # relative error of a model that cannot predict at all
_FURTHEST = 2.0


def left_out(piece: Figure, hypothesis: Hypothesis, z: np.ndarray) -> float:
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
            left_out(piece, NOTHING, nominal),
            left_out(piece, NOTHING, without(null, k)),
            left_out(piece, after.hypothesis, without(after, k)),
            float(np.sqrt(np.mean(piece.units**2) * piece.expected / len(piece.units))),
        )
        for k, piece in enumerate(evidence)
    ]
    records = tuple(RecordGap(piece.name, True, *row) for piece, row in zip(evidence, rows, strict=True))
    return gap_of_pieces(np.array(rows), records, 0, _DRAWS, most=1.0)


_DIFFERS = 0.1  # of a gain, from which the model is said to be another than the designers'
_SHOWN = 5


def sentences(verdict: Verdict, rivals: Sequence[str], chosen: Sequence[str], gap: Gap) -> str:
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
            return f"{first} {errors}"
        case "effect":
            first = f"The gap is caused by {_said(' + '.join(chosen))}."
        case "ambiguous":
            more = f"; and {len(named) - _SHOWN} more" if len(named) > _SHOWN else ""
            common = f"All of them hold {_said(' + '.join(chosen))}." if chosen else "No single culprit can be named."
            first = f"These figures cannot tell apart: {'; '.join(named[:_SHOWN])}{more}. {common}"
        case _:
            first = "Nothing that is known here explains these figures."
    return f"{first} {errors}"


def notes_of(silent: Sequence[str], shares: GainShares | None, factor: CommonFactor | None) -> tuple[str, ...]:
    """What else has to be said."""
    said = [
        "Critical gains and responses are those of the linear loop at small motion beyond deadband, hysteresis, play"
        " and dry friction; of unequal sides the smaller one governs the gain."
    ]
    if silent:
        said.append(f"Of no consequence here whatever their size, so neither found nor excluded: {', '.join(silent)}.")
    if factor is not None:
        said.append(
            f"One common factor of {factor.factor:.2f} +- {factor.std:.2f} on the model's gains takes away"
            f" {factor.explained:.0%} of the mean square distance ({factor.before:.0%} to {factor.left:.0%})."
            " Flow gain, sensor gain and piston area all act as such a factor."
        )
    if shares is not None:
        parts = ", ".join(
            f"{s.name} {s.share:+.2f} (alone {s.alone:+.2f})" for s in shares.shares if s.name != "common_factor"
        )
        said.append(
            f"Of the mean ln(measured/model) of {shares.total:+.2f}, the published rig's filter and smaller piston side"
            f" would carry {shares.together:+.2f} together: {parts}, means over the orders of adding them;"
            f" {shares.total - shares.together:+.2f} would be left to a common factor."
        )
    return tuple(said)


def notes_on_predictions(evidence: Sequence[Figure], factor: CommonFactor | None, explained: str) -> tuple[str, ...]:
    """What measurement and the designers' own predictions say, and where the believed model is another than theirs."""
    said = []
    if factor is not None:
        said.append(
            f"Against the designers' own predictions one common factor of {factor.factor:.2f} +- {factor.std:.2f} takes"
            f" away {factor.explained:.0%} of the mean square distance ({factor.before:.0%} to {factor.left:.0%})."
        )
    said.append(f"From these predictions, with the model telling the changes only: {explained}")
    for piece in evidence:
        if not isinstance(piece, GainEvidence) or piece.measured.predicted_gain is None:
            continue
        placement = NOTHING.placement(piece.prototype)
        foreseen, at = piece.measured.predicted_gain, piece.predicted(placement, np.zeros(len(placement.unknowns)))
        if at is not None and abs(at.gain / foreseen - 1) > _DIFFERS:
            said.append(
                f"{piece.name}: the believed model gives {1e3 * at.gain:.3g} mA/V where the designers predicted"
                f" {1e3 * foreseen:.3g}, so that its gap holds what their models differ in."
            )
    return tuple(said)


def _said(name: str) -> str:
    return "something unknown" if name == OUTSIDE else in_words(name)
