"""A cause that nobody listed: the law at one port that explains most of the gap, learnt from the records.

Every law of `beamdesign.plant.empirical` is a hypothesis like any other, so that fits, their weighing on conditions
held out, and what is written into the prototype are those of a listed effect. What differs is where its scales come
from, and that it counts only where records left out of its fit say that it closes a good part of the gap.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from hashlib import sha256
from math import inf

import numpy as np
from scipy.special import expit

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import Cause, in_words, named
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache, Task
from beamdesign.diagnosis.fitting.fitters import Fitters, refit
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, given, learnable
from beamdesign.diagnosis.fitting.search import Search, best_of_each, hardest
from beamdesign.diagnosis.gap_metrics import errors
from beamdesign.diagnosis.judgement import Judgement, evidence, held_out_score, judge, odds
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.diagnosis.verdict import far_fetched
from beamdesign.diagnosis.where.residuals import residuals
from beamdesign.plant.effects import library
from beamdesign.plant.empirical import curve, over_reach
from beamdesign.progress import Progress, silent

EXPLAINED = 0.15
"""Of the excess misfit: what leaves less explains the gap."""
_UNLISTED = 0.5  # probability: a listed cause that is more probable than none of them has to be beaten
_DOUBTED = 0.1  # probability that the cause is not listed, from which laws are learnt
_BETTER = 0.35  # of what the listed cause leaves: what a law has to stay below against it
_CHANGING = 0.5  # the same of a drift against a wrong figure, which is the same law but for when
_ALIKE = 0.7  # of what the best listed causes leave, however improbable: what a law has to stay below in any case
_FULL = 5  # laws fitted in full: the best at a look
_BESIDE = 0.7  # of the excess misfit: what the best listed cause has to stay below for laws to be learnt beside it
_WORTH = 0.6  # of the excess misfit: what a law has to stay below where no listed cause is probable
_TOLD = 5.0  # in the logarithm of the predictive density of conditions held out one by one: what a law has to gain
_IDLE = 2.5  # standard errors: terms of a curve below are none
_STEP = 1e-3  # of a standard error


def learn(look: Look, held_out: Sequence[int], workers: int = 1, progress: Progress = silent) -> Look | None:
    """Learn a law for a gap that nothing listed explains, or only in part.

    Args:
        look: the search among listed causes, with time records.
        held_out: positions of those that say whether a law counts; without any none does.
        workers: processes.
        progress: told the share done and what is being fitted.

    Returns:
        laws among the hypotheses, which share the probability that the cause is not listed. None where no law explains
        much more than what is listed does, or conditions held out say that it does not: one by one, by the quadratics
        that stand for fits without them, and those of `held_out` by fits. Where one by itself is more probable than
        the listed effects and leaves too much to take their place, what is listed, as no more than likely.
    """
    data, before, judged, kept = look.data, look.search, look.judged, look.kept
    contested = judged.unknown <= _UNLISTED
    rival, enough = (judged.best, _BETTER) if contested else (before.null, _WORTH)
    explains, far = before.excess(rival) < EXPLAINED, far_fetched(rival, data.prototype)
    # A figure that is believed to be wrong may change while a record lasts, whatever its probability says of the rest.
    figure = contested and bool(rival.hypothesis.names) and not rival.hypothesis.effects
    doubted = judged.unknown >= _DOUBTED or explains
    if not held_out or not (far if explains else doubted or figure):
        return None
    scaled = with_scales(data, before.null)
    alone = [h for h in learnable(scaled.prototype) if doubted or _drifts(h)]
    alone = [h for h in alone if not library()[h.names[0]].scales or h.names[0] in scaled.prototype.effects]
    scaled, found = _fitted(scaled, alone, before, workers, progress, kept)
    laws = replace(before, fits=tuple(best_of_each(found)))
    weighed = judge(laws)
    enough = _CHANGING if figure and _drifts(weighed.best.hypothesis) else enough
    # Never at the price of a listed cause: one that leaves about as little is no worse an explanation.
    most = min([enough * before.excess(rival), *(_ALIKE * before.excess(fit) for fit in before.fits[:1])])
    if explains:  # and so has the law to, by figures that a rig may have
        most = EXPLAINED if not weighed.best.strained else -inf
    if not weighed.best.hypothesis.names or laws.excess(weighed.best) > most:
        return _doubt(look, scaled, found) if contested and rival.hypothesis.effects and not explains else None
    scaled = without_idle_terms(scaled, weighed.best)
    own = {*weighed.best.hypothesis.effects}  # whose terms are fewer now, beside a listed cause as well
    same = [f for f in found if f is not weighed.best and own & {*f.hypothesis.effects} and not f.reason]
    with Fitters(scaled, 1, _of(kept, scaled)) as fitters:
        best, *again = fitters.each(*(Task(f.hypothesis, f.values) for f in (weighed.best, *same)))
    seen = replace(scaled, records=tuple(r for k, r in enumerate(scaled.records) if k not in held_out))
    null, without = refit(seen, best, workers, _of(kept, scaled))
    other = refit(seen, rival, workers, kept)[1] if contested else null
    out = [piece for k, piece in enumerate(record_evidence(scaled)) if k in held_out]
    found_by = [[errors(piece, null, fit, fit) for piece in out] for fit in (without, other)]
    left, left_by_rival = (sum(float(np.mean(e.after**2)) for e in own) for own in found_by)
    spread = max(1.0, best.misfit / before.expected)
    score, of_rival = (held_out_score(fit, before.conditions, spread) for fit in (best, rival))
    if explains:  # conditions held out say nothing of how far figures are off
        score, of_rival = (evidence(fit, spread) + odds(fit.hypothesis) for fit in (best, rival))
    if left > THRESHOLDS.worse**2 * left_by_rival or score < of_rival + _TOLD:
        return None
    # What a law explains of what is left by the best that is listed speaks for something that is not.
    still = max(0.0, laws.excess(best)) / before.excess(rival) if not explains else float(expit(of_rival - score))
    unknown = max(judged.unknown, 1 - still) if contested else judged.unknown
    listed = {h: p * (1 - unknown) / (1 - judged.unknown) for h, p in judged.of.items()} if judged.unknown < 1 else {}
    share = {h: p * unknown / max(1 - weighed.unknown, 1e-9) for h, p in weighed.of.items() if h.names}
    others = (f for f in found if f is not weighed.best and all(f is not old for old in same))
    fits = (*before.fits, *others, *again, best)
    everything = replace(before, fits=tuple(sorted(fits, key=lambda f: f.cost)))
    judgement = Judgement(listed | share, unknown, best)
    return Look(scaled, everything, judgement, (far,) * explains, refitted=(null, without)).after(look)


def _doubt(look: Look, scaled: Dataset, found: Sequence[Fit]) -> Look | None:
    """The listed effects as no surer than likely where a law alone is more probable; None where none is."""
    rival = look.judged.best
    law = min((f for f in found if len(f.hypothesis.names) == 1 and not f.reason), key=lambda f: f.cost, default=None)
    if law is None:
        return None
    spread = max(1.0, law.misfit / look.search.expected)
    score, of_rival = (evidence(fit, spread) + odds(fit.hypothesis) for fit in (law, rival))
    if score < of_rival + _TOLD:
        return None
    (name,) = law.hypothesis.names
    like, port = library()[name].nearest, in_words(law.hypothesis.causes[0].partition(":")[2])
    assert like is not None  # of every law that is learnt
    words = (
        f"The records are explained better by {like(_own(law, name, scaled, law.z))} at the port {port} than by"
        f" {named(str(rival.hypothesis))}, if not so much better as to take its place: look there first."
    )
    return replace(look, words=(*look.words, words), doubtful=True)


def _own(fit: Fit, law: str, data: Dataset, z: np.ndarray) -> dict[str, float]:
    """Figures of a learnt law at some unknowns of its fit, with the scales that the prototype states."""
    pairs, prefix = zip(fit.unknowns, z, strict=True), law + "."
    found = {u.name.removeprefix(prefix): u.value(to) for u, to in pairs if u.name.startswith(prefix)}
    return {**given(law, data.prototype), **found}


def _drifts(hypothesis: Hypothesis) -> bool:
    return any(name.endswith("_drift") for name in hypothesis.names)


def _of(kept: FitCache | None, data: Dataset) -> FitCache | None:
    """Where fits of learnt laws are kept, whose unknowns go by the scales that the prototype states."""
    scales = sha256(repr(data.prototype.effects).encode()).hexdigest()[:12]
    return kept and replace(kept, part=(*kept.part, scales))


def _fitted(
    data: Dataset, alone: Sequence[Hypothesis], before: Search, workers: int, progress: Progress, kept: FitCache | None
) -> tuple[Dataset, list[Fit]]:
    """Laws at a look, the best of them in full; where a listed cause explains a part, beside it as well.

    With the data set that states the scales of these.
    """
    null = before.null.values
    with Fitters(data, workers, _of(kept, data)) as fitters:
        tasks = [Task(h, null, on=hardest(before.null), quick=True) for h in alone]
        looks = fitters(tasks, lambda k: progress(0.5 * k / len(tasks), "laws of each port"))
    ranked = [f for f in sorted(looks, key=lambda f: f.cost) if not f.reason]
    data, found = within_reach(data, {f.hypothesis: f.values for f in ranked[:_FULL]})
    with Fitters(data, workers, _of(kept, data)) as fitters:
        best = list(found)
        full = [Task(h, null, found[h]) for h in best]
        listed = next((f for f in before.fits if len(f.hypothesis.causes) == 1), before.null)
        if EXPLAINED < before.excess(listed) < _BESIDE:
            full += [Task(listed.hypothesis | h, listed.values, found[h]) for h in best]
        return data, fitters(full, lambda k: progress(0.5 + 0.5 * k / len(full), "laws learnt"))


def with_scales(data: Dataset, null: Fit) -> Dataset:
    """The data set, its prototype stating the sizes that signals of laws reach in the linear model, where they do."""
    signals: dict[str, float] = {"": max(float(record.since_start[-1]) for record in data.records)}
    for item in residuals(null, record_evidence(data)):
        for name, values in item.nominal.items():
            signals[name] = max(signals.get(name, 0.0), float(np.abs(values).max()))
    laws = (law for h in learnable(data.prototype) if (law := library()[h.names[0]]).scales)
    moved = (law for law in laws if all(signals.get(of, 0.0) > 0 for of in law.scales.values()))
    tables = {law.name: {key: float(f"{signals[of]:.3g}") for key, of in law.scales.items()} for law in moved}
    return replace(data, prototype=data.prototype.but(effects={**data.prototype.effects, **tables}))


def within_reach(
    data: Dataset, begun: Mapping[Hypothesis, dict[str, float]]
) -> tuple[Dataset, dict[Hypothesis, dict[str, float]]]:
    """The data set and the values that fits begin with, each curve over no more than the rig can have moved.

    The linear model may move much further than a rig that a curve holds back. Where a curve adds as much as all of its
    port's own signal there is nothing more for it to hold: what lies beyond was not in the data, and terms of the
    curve that are counted by it are far from what is expected of them.

    Args:
        data: whose prototype states the scales.
        begun: values by hypothesis, each of one law.
    """
    effects, moved = dict(data.prototype.effects), dict(begun)
    places = np.linspace(-1.0, 1.0, 401)
    for hypothesis, values in begun.items():
        (name,) = hypothesis.names
        own = {key.partition(".")[2]: value for key, value in values.items() if key.startswith(name + ".")}
        if library()[name].table is None:
            continue
        full = np.abs(places[[abs(float(curve(own, u))) >= 1 for u in places]])
        if full.size and (share := float(full.min())) < 1:
            moved[hypothesis] = {**values, **{f"{name}.{q}": term for q, term in over_reach(own, share).items()}}
            effects[name] = {q: v * share if q.startswith("reach") else v for q, v in effects[name].items()}
    return replace(data, prototype=data.prototype.but(effects=effects)), moved


def without_idle_terms(data: Dataset, best: Fit) -> Dataset:
    """The data set, its prototype stating none of the terms of a learnt curve that its fit does not tell from none."""
    effects = {name: dict(table) for name, table in data.prototype.effects.items()}
    curves = [law for law in best.hypothesis.effects if library()[law].table is not None]
    errors_of = best.standard_errors
    for name, value in best.values.items():
        law, _, term = name.rpartition(".")
        if law in curves and abs(value) < _IDLE * errors_of[name]:
            effects[law][term] = 0.0
    return replace(data, prototype=data.prototype.but(effects=effects))


def described(cause: Cause, best: Fit, data: Dataset) -> Cause:
    """A cause, with what it is like and its table where it was learnt.

    Args:
        cause: any.
        best: the fit that is held responsible.
        data: whose prototype states the scales.
    """
    if cause.name not in best.hypothesis.causes:
        return cause
    law = library().get(best.hypothesis.realisation(cause.name))
    if law is None or law.nearest is None:
        return cause
    own = partial(_own, best, law.name, data)
    like = law.nearest(own(best.z))
    if law.table is None:
        return replace(cause, like=like)
    columns = law.table(own(best.z))
    *_, added = columns
    roots = _STEP * np.linalg.cholesky(best.covariance)
    moved = [np.subtract(law.table(own(best.z + root))[added], columns[added]) for root in roots.T]
    std = np.linalg.norm(moved, axis=0) / _STEP
    return replace(cause, like=like, table={**columns, "std" + added.removeprefix("added"): tuple(map(float, std))})
