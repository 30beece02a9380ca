"""Replicates of a bench that differ grossly in one condition: their scatter is not that of all the others."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import inf, sqrt

from scipy.stats import f as f_ratio

from beamdesign.diagnosis.data.bench_set import BenchSet
from beamdesign.diagnosis.fitting.steady_motion import CHANNELS, NO_REPLICATE, Observations, steady_motions

_GROSS = 4.0  # times the standard deviation of replicates of the other conditions
_KNOWN = 1_000_000  # degrees of freedom of a deviation that is taken
_RARE = 1e-3  # chance of so much where all scatter alike
_LEAST_CONDITIONS = 2  # what is held out of a fit must be another one


def without_scattered(data: BenchSet) -> tuple[BenchSet, Observations]:
    """The runs without those that differ grossly from their replicates, and their steady motions; see `steady_motions`.

    The noise of a bench is pooled over its conditions, so that a run which slipped would hide gaps in all of them. One
    that its replicates single out is left out; where they do not tell which is right, the condition is, as long as
    enough of them are left. Warnings tell it.
    """
    seen = steady_motions(data)
    while found := _grossest(seen):
        condition, channel, own, others = found
        names = dict.fromkeys(run.name for run in data.runs if run.condition == condition)
        without = {name: _of(seen, [run.name != name for run in data.runs]) for name in names}
        left = {name: _deviation(fewer, condition, channel) for name, fewer in without.items()}
        agree = {name: each for name, each in left.items() if each is not None and each <= _most(others)}
        words = f"{condition}: its runs differ in {channel} by {own:.1%}, those of other conditions by {others:.1%}"
        if agree:
            name = min(agree, key=lambda one: agree[one])
            words, kept = f"{words}; {name} lies apart and is left out", [run.name != name for run in data.runs]
        else:
            enough = len(seen.conditions) > _LEAST_CONDITIONS
            words += "; which is right they do not tell" + (", and all are left out" if enough else "")
            kept = [run.condition != condition or not enough for run in data.runs]
        runs, seen = tuple(run for run, stays in zip(data.runs, kept, strict=True) if stays), _of(seen, kept)
        data = replace(data, runs=runs, warnings=(*data.warnings, f"{words}: measure it again"), doubtful=True)
        if all(kept):
            break
    return data, seen


def _of(seen: Observations, kept: Sequence[bool]) -> Observations:
    """Those of some runs, each of which has moved both ways."""
    return replace(seen, motions=tuple(m for k, m in enumerate(seen.motions) if kept[k // 2]))


def _deviation(seen: Observations, condition: str, channel: str) -> float | None:
    """Of the replicates of a condition; None where there are none, or not of both chambers."""
    squares, freedom = seen.spread(condition, channel)
    sides = {motion.side for motion in seen.motions if motion.condition == condition}
    return sqrt(squares / freedom) if freedom and len(sides) == 2 else None


def _grossest(seen: Observations) -> tuple[str, str, float, float] | None:
    """Condition and channel of the replicates that differ most, with their deviation and that of the others.

    Variances are compared by their ratio (G. W. Snedecor and W. G. Cochran, Statistical Methods, 8th ed. 1989, 6.12).
    """
    found = []
    for condition, channel in product(seen.conditions, CHANNELS):
        squares, freedom = seen.spread(condition, channel)
        rest = [seen.spread(each, channel) for each in seen.conditions if each != condition]
        pooled, many = (sum(column) for column in zip(*rest, strict=True))
        others, own = sqrt(pooled / many) if many else NO_REPLICATE, sqrt(squares / freedom) if freedom else 0.0
        ratio = (own / others) ** 2 if others else inf
        if own > _most(others) and f_ratio.sf(ratio, freedom, many or _KNOWN) < _RARE:
            found.append((condition, channel, own, others))
    return max(found, key=lambda one: one[2], default=None)


def _most(others: float) -> float:
    return _GROSS * max(others, NO_REPLICATE)
