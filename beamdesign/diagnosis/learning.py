"""A cause that nobody listed: the law at one port that explains most of the gap, learnt from the records.

Every law of `beamdesign.plant.empirical` is a hypothesis like any other, so that fits, their weighing on conditions
held out, and what is written into the prototype are those of a listed effect. What differs is where its scales come
from, and that it counts only where records left out of its fit say that it closes a good part of the gap.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import Cause
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, FitCache, Task
from beamdesign.diagnosis.fitting.hypothesis import given, learnable
from beamdesign.diagnosis.fitting.search import Fitters, Search, best_of_each, refit
from beamdesign.diagnosis.gap_metrics import errors
from beamdesign.diagnosis.judgement import Judgement, judge
from beamdesign.diagnosis.where.residuals import residuals
from beamdesign.plant.effects import library
from beamdesign.progress import Progress, silent

_FULL = 5  # laws fitted in full: the best at a look
_BESIDE = 0.7  # of the excess misfit: what the best listed cause has to stay below for laws to be learnt beside it
_HALF = 0.5  # of the evidence, that which tolerances explain least, tells which laws are worth fitting
_WORTH = 0.6  # of the excess misfit: what a law has to stay below
_CLOSES = 0.7  # of the mean square error of tolerances alone on records held out: what a law has to stay below
_STEP = 1e-3  # of a standard error


@dataclass(frozen=True)
class Learning:
    """What was learnt.

    Attributes:
        data: the data set; its prototype states the scales of the laws.
        search: of all hypotheses, learnt laws among them.
        judged: them; laws share the probability that the cause is not listed.
        refitted: tolerances alone and what was learnt, to the records that are not held out.
    """

    data: Dataset
    search: Search
    judged: Judgement
    refitted: tuple[Fit, Fit]


def learn(
    data: Dataset,
    held_out: Sequence[int],
    before: Search,
    judged: Judgement,
    workers: int = 1,
    progress: Progress = silent,
    kept: FitCache | None = None,
) -> Learning | None:
    """Learn a law for a gap that nothing listed explains.

    Args:
        data: with time records.
        held_out: positions of those that say whether a law counts; without any none does.
        before: the search among listed causes.
        judged: what it came to.
        workers: processes.
        progress: told the share done and what is being fitted.
        kept: fits of an earlier run.

    Returns:
        None where no law explains much, or records held out say that it does not.
    """
    if not held_out:
        return None
    scaled = with_scales(data, before.null)
    kept = None if kept is None else replace(kept, prototype=scaled.prototype, part=(*kept.part, "learnt"))
    alone, pieces = learnable(scaled.prototype), len(before.null.shares)
    worst = sorted(range(pieces), key=lambda k: -before.null.shares[k].c)[: max(1, round(_HALF * pieces))]
    with Fitters(scaled, workers, kept) as fitters:
        tasks = [Task(h, before.null.values, on=tuple(sorted(worst))) for h in alone]
        looks = fitters(tasks, lambda k: progress(0.5 * k / len(tasks), "laws of each port"))
        best = [f.hypothesis for f in sorted(looks, key=lambda f: f.cost) if not f.reason][:_FULL]
        starts = {f.hypothesis: f.values for f in looks if not f.reason}
        full = [Task(h, before.null.values, starts[h]) for h in best]
        if before.fits and before.excess(before.fits[0]) < _BESIDE:
            listed = before.fits[0]
            full += [Task(listed.hypothesis | h, listed.values, starts[h]) for h in best]
        found = fitters(full, lambda k: progress(0.5 + 0.5 * k / len(full), "laws learnt"))
    laws = replace(before, fits=tuple(best_of_each(found)))
    weighed = judge(laws)
    if not weighed.best.hypothesis.names or laws.excess(weighed.best) > _WORTH:
        return None
    seen = replace(scaled, records=tuple(r for k, r in enumerate(scaled.records) if k not in held_out))
    refitted = refit(seen, weighed.best, workers, kept)
    out = [piece for k, piece in enumerate(record_evidence(scaled)) if k in held_out]
    left = [errors(piece, scaled.prototype, *refitted, weighed.best) for piece in out]
    if sum(np.mean(e.after**2) for e in left) > _CLOSES * sum(np.mean(e.tuned**2) for e in left):
        return None
    share = {h: p * judged.unknown / max(1 - weighed.unknown, 1e-9) for h, p in weighed.of.items() if h.names}
    total = Judgement(judged.of | share, judged.unknown, weighed.best)
    everything = replace(before, fits=tuple(sorted((*before.fits, *found), key=lambda f: f.cost)))
    return Learning(scaled, everything, total, refitted)


def with_scales(data: Dataset, null: Fit) -> Dataset:
    """The data set, its prototype stating for every law the sizes that its signals reach in the linear model."""
    signals: dict[str, float] = {"": max(float(record.times[-1]) for record in data.records)}
    for item in residuals(data.prototype, null, record_evidence(data)):
        for name, values in item.nominal().items():
            signals[name] = max(signals.get(name, 0.0), float(np.abs(values).max()))
    laws = (library()[h.names[0]] for h in learnable(data.prototype))
    tables = {law.name: {key: float(f"{signals[of]:.3g}") for key, of in law.scales.items()} for law in laws}
    return replace(data, prototype=data.prototype.but(effects={**data.prototype.effects, **tables}))


def described(causes: Sequence[Cause], best: Fit, data: Dataset) -> tuple[Cause, ...]:
    """Causes, those of them that were learnt with what they are like and their table.

    Args:
        causes: any.
        best: the fit that is held responsible.
        data: whose prototype states the scales.
    """
    return tuple(_described(c, best, data) if c.name in best.hypothesis.causes else c for c in causes)


def _described(cause: Cause, best: Fit, data: Dataset) -> Cause:
    law = library().get(best.hypothesis.realisation(cause.name))
    if law is None or law.nearest is None:
        return cause
    scales, prefix = given(law.name, data.prototype), law.name + "."

    def own(z: np.ndarray) -> Mapping[str, float]:
        pairs = zip(best.unknowns, z, strict=True)
        return {**scales, **{u.name.removeprefix(prefix): u.value(to) for u, to in pairs if u.name.startswith(prefix)}}

    like = law.nearest(own(best.z))
    if law.table is None:
        return replace(cause, like=like)
    columns = law.table(own(best.z))
    *_, added = columns
    roots = _STEP * np.linalg.cholesky(best.covariance)
    moved = [np.subtract(law.table(own(best.z + root))[added], columns[added]) for root in roots.T]
    std = np.linalg.norm(moved, axis=0) / _STEP
    return replace(cause, like=like, table={**columns, "std" + added.removeprefix("added"): tuple(map(float, std))})
