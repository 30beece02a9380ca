"""What critical gains and frequency responses alone can say about a gap: mostly a class of causes, with shares.

How far the gap closes is told in relative errors of each figure as predicted from all the others.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import exp, log, tau

import numpy as np
from scipy.special import expit

from beamdesign.diagnosis import gain_findings
from beamdesign.diagnosis.data.dataset import Dataset, MeasuredGain
from beamdesign.diagnosis.diagnosis import Diagnosis, Gap, RecordGap, Where, no_surer, updated_prototype
from beamdesign.diagnosis.fitting.evidence import Figure, figures_of
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import FREE, NOTHING, Hypothesis, notes_on_known, subsystem
from beamdesign.diagnosis.fitting.replay import depends_on_size
from beamdesign.diagnosis.fitting.search import Search, search
from beamdesign.diagnosis.gap_metrics import gap_of_pieces
from beamdesign.diagnosis.judgement import LEAST_PROBABILITY, Judgement, cause_sets, causes, judge, odds
from beamdesign.diagnosis.judgement import evidence as marginal_likelihood
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.diagnosis.verdict import OUTSIDE, far_fetched, sentences, verdict_of
from beamdesign.progress import Progress, part_of, silent
from beamdesign.prototype import Prototype
from beamdesign.quantities import LawGain, range_of
from beamdesign.records import InputError
from beamdesign.time_limit import left_out, share

_CERTAIN = 30.0  # in the logarithm of odds: more is no more


def explain_gains(
    data: Dataset, workers: int = 1, progress: Progress = silent, kept: FitCache | None = None, doubtful: bool = False
) -> Diagnosis[Prototype]:
    """Diagnose from critical gains and frequency responses.

    Explanations whose probabilities differ by less than 20 to 1 make a class. Where none is sure, `chosen` holds only
    what all members of the class share. Its `findings` are `silent`, the effects that leave no trace in such data,
    whatever their size; `factor`, one common factor on the model's gains; `shares`, what known causes would carry of
    the mean distance; `ranked`, hypotheses with 1 % of the probability or more; and where the data set holds what the
    designers predicted, `on_predictions`, the diagnosis from there: of the gap between measurement and these
    predictions, of which the model tells the changes only.

    Args:
        data: with critical gains or frequency responses; its time records are left aside.
        workers: processes.
        progress: told the share done and what is being done.
        kept: fits of an earlier run, where those of this one are kept as well.
        doubtful: whether the data allow no sure answer.

    Raises:
        InputError: where it has neither, or where the believed model oscillates at no gain, or where a response was
            taken, whatever its figures within their tolerances.
    """
    data = replace(data, records=())
    gains = [piece for piece in figures_of(data) if isinstance(piece, GainEvidence)]
    if not (gains or data.responses):
        raise InputError(data.folder, [("critical_gain", "missing; the set holds no frequency_response either")])
    if not any(taken.predicted_gain for taken in data.gains):
        return _explained(data, workers, progress, kept, doubtful)
    with share(0.5):
        own = _explained(data, workers, part_of(progress, 0.0, 0.5), kept, doubtful)
    moved = replace(data, gains=tuple(_from_prediction(piece) for piece in gains))
    there = kept and replace(kept, part=("from what was predicted",))
    other = _explained(moved, workers, part_of(progress, 0.5, 1.0), there, doubtful)
    more = gain_findings.notes_on_predictions(gains, other.findings["factor"], other.sentences)
    return replace(own, notes=(*own.notes, *more), findings={**own.findings, "on_predictions": other})


def _from_prediction(piece: GainEvidence) -> MeasuredGain:
    """A gain that is as far from the model's as the measured one is from what was predicted."""
    taken, at = piece.measured, piece.nominal()
    if taken.predicted_gain is None or at is None:
        return taken
    gain = taken.gain * at.gain / taken.predicted_gain
    if gain not in range_of(LawGain):  # whatever was predicted, it was not that
        return taken
    return replace(taken, controller=taken.controller.but(gain_A_per_V=gain))


def _explained(
    data: Dataset, workers: int, progress: Progress, kept: FitCache | None, doubtful: bool
) -> Diagnosis[Prototype]:
    evidence = figures_of(data)
    found = search(data, workers, progress, kept)
    silent = found.silent  # neither found nor excluded
    found = replace(found, fits=tuple(f for f in found.fits if not {*silent} & {*f.hypothesis.causes}))
    judged = with_outside(judge(found, few=True), evidence, found)
    rivals = rivals_of(found, judged)
    judged = replace(judged, best=rivals[0])
    left = left_out()
    # A cause beside another is not sure where that alone is not told apart from both.
    partly = any(f.hypothesis.names and {*f.hypothesis.causes} < {*rivals[0].hypothesis.causes} for f in rivals)
    far = far_fetched(judged.best, data.prototype)
    verdict = no_surer(verdict_of(judged, partly or doubtful or bool(far), few=True), left)
    named = verdict in ("effect", "ambiguous")
    alike = rivals if verdict == "ambiguous" else rivals[: int(named)]
    common = set.intersection(*(set(f.hypothesis.causes) for f in alike)) if alike else set()
    chosen = tuple(name for name in rivals[0].hypothesis.causes if name in common)  # sure, or what all rivals share
    holder = next((f for f in found.fits if f.hypothesis.causes == chosen), found.null)
    names = [str(f.hypothesis) for f in rivals]
    of = judged.of_causes
    if judged.unknown > of[rivals[0].hypothesis.causes] * exp(-THRESHOLDS.separate):
        names.append(OUTSIDE)
    asked = gain_findings.another_size(data) if verdict in ("ambiguous", "unknown") and not left else None
    if verdict == "ambiguous" and not left:
        asked = gain_findings.next_experiment(data, rivals, [of[f.hypothesis.causes] for f in rivals]) or asked
    gains = [piece for piece in evidence if isinstance(piece, GainEvidence)]
    factor, shares = gain_findings.factor_of(gains), gain_findings.gain_shares(gains)
    gap = figures_of_gap(evidence, found.null, rivals[0] if named else found.null)
    where = where_of(chosen, alike, evidence, found)
    errors = (
        f"Each figure as predicted from the others is off by {gap.before:.0%} for the believed model, by"
        f" {gap.tuned:.0%} with tolerances fitted and by {gap.after:.0%} with the best explanation; their own errors"
        f" are {gap.noise_floor:.0%}."
    )
    listed, sets = causes(found, judged), cause_sets(found, judged)
    progress(1.0, "done")
    return Diagnosis(
        data.name,
        verdict,
        sentences(verdict, listed, chosen, errors, where, names, not left),
        listed,
        chosen,
        judged.unknown,
        where,
        gap,
        (tuple(names),) if named and len(names) > 1 else (),
        asked,
        updated_prototype(data.prototype, holder),
        (*filter(None, (far,)), *data.warnings),
        found,
        hypotheses=sets,
        notes=(*notes_on_known(data.prototype), *gain_findings.notes_of(silent, shares, factor, data.prototype.rig)),
        left_out=left,
        written=holder,
        measure="Relative errors of each figure as predicted from all the others.",
        findings={
            "silent": silent,
            "shares": shares,
            "factor": factor,
            "ranked": [(str(one), one.probability) for one in sets if one.probability >= LEAST_PROBABILITY],
        },
    )


def with_outside(judged: Judgement, evidence: Sequence[Figure], found: Search) -> Judgement:
    """Probabilities with something outside the library as one more explanation, where that is the more probable.

    What the best explanation leaves of a gap speaks for it as well, as with time records.
    """
    spread, first = found.spread, max((found.null, *found.fits), key=lambda f: judged.of.get(f.hypothesis, 0.0))
    known = marginal_likelihood(first, spread) + odds(first.hypothesis)
    known -= log(judged.of[first.hypothesis] / (1 - judged.unknown))  # of all that are known together
    margin = np.clip(log_outside(evidence, found.null, spread) - known, -_CERTAIN, _CERTAIN)
    unknown = max(float(expit(margin)), judged.unknown)
    of = {h: p * (1 - unknown) / (1 - judged.unknown) for h, p in judged.of.items()}
    return replace(judged, of=of, unknown=unknown)


def log_outside(evidence: Sequence[Figure], null: Fit, spread: float) -> float:
    """Logarithm of the marginal likelihood, and the odds, of something outside the library that is at work.

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


def rivals_of(found: Search, judged: Judgement) -> list[Fit]:
    """Hypotheses that the data cannot tell from the best, without those that hold one of the others and are no better.

    The null is one where it comes near enough; a cause is a rival beside it where the data speak for it at all,
    whatever the odds were before.

    Returns:
        their fits, most probable first.
    """
    of, fits = judged.of_causes, (f for f in (found.null, *found.fits) if judged.of.get(f.hypothesis))
    by_best_law = {f.hypothesis.causes: f for f in sorted(fits, key=lambda f: judged.of[f.hypothesis])}
    least = max(of.values()) * exp(-THRESHOLDS.separate)
    near = [by_best_law[causes] for causes, p in of.items() if p > least]

    def spared(simple: Fit, f: Fit) -> bool:
        p, own = of[simple.hypothesis.causes], of[f.hypothesis.causes]
        if simple.hypothesis == NOTHING:
            return p < own * exp(-odds(f.hypothesis))
        return not {*simple.hypothesis.causes} < {*f.hypothesis.causes} or p < own

    return [f for f in near if all(g is f or spared(g, f) for g in near)]


def where_of(chosen: Sequence[str], rivals: Sequence[Fit], evidence: Sequence[Figure], found: Search) -> Where:
    """The subsystem of what all rivals hold, or that all of theirs share, and the band of oscillations or lines.

    It is linear where every rival is; what one that depends on the size of motion is like, figures do not show.
    """
    at, null = [], found.null
    for piece in evidence:
        if isinstance(piece, GainEvidence):
            onset = piece.predicted(NOTHING.placement(piece.prototype), null.z)
            at += [onset.frequency / tau] if onset else []
        else:
            at += list(piece.measured.frequencies_Hz[[0, -1]])
    band = (float(f"{min(at):.3g}"), float(f"{max(at):.3g}")) if at else (0.0, 0.0)
    if not rivals:
        return Where("", band, "", "linear")
    places = {subsystem(name) for name in chosen or (name for f in rivals for name in f.hypothesis.names)}
    worst = max(evidence, key=lambda piece: misfit_of(piece, NOTHING, np.zeros(len(null.z))))
    sized = any(depends_on_size(f.hypothesis.placement(worst.prototype).assembly.kinds) for f in rivals)
    kind = "" if sized else "linear"
    return Where(places.pop() if len(places) == 1 else "", band, f"most in: {worst.name}", kind)


_DRAWS = 2000
_LOST = 1.0  # relative error of a model that cannot predict at all
_FURTHEST = 2.0


def misfit_of(piece: Figure, hypothesis: Hypothesis, z: np.ndarray) -> float:
    """Rms of ln(measured/predicted) of one piece of evidence."""
    placement = hypothesis.placement(piece.prototype)
    if (residual := piece.residual(placement, z)) is None:
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
    nominal, rows = np.zeros(len(null.z)), []
    for k, piece in enumerate(evidence):
        models = (NOTHING, nominal), (NOTHING, without(null, k)), (after.hypothesis, without(after, k))
        noise = float(np.sqrt(np.mean(piece.units**2) * piece.expected / len(piece.units)))
        rows.append((*(misfit_of(piece, *model) for model in models), noise))
    records = tuple(RecordGap(piece.name, True, *row) for piece, row in zip(evidence, rows, strict=True))
    return gap_of_pieces(np.array(rows), records, 0, _DRAWS, most=1.0)
