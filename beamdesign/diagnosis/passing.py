"""What a rig does in a short while or in one record and nowhere else: found, and left out of the records.

A chamber runs empty as a load is taken off, and its oil closes again with a knock; somebody touches the rig; a file is
of another rig. A tenth of a second of it may outweigh all that the records say besides, and no law that explains the
rest explains it too. What is left of the records then decides, never a confident verdict: what passed may be of another
cause.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.examination.sound_records import equal_runs
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache, Task
from beamdesign.diagnosis.fitting.fitters import Fitters
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.search import Search, best_of_each, search
from beamdesign.diagnosis.fitting.weighting import padded
from beamdesign.diagnosis.judgement import Judgement, judge
from beamdesign.plant.assembly import pace
from beamdesign.progress import Progress, part_of, silent
from beamdesign.structure.lumped import figures

_SMOOTHED_S = 0.01  # this and the next of a rig as quick as the published one
_LOUD = 5.0  # times the misfit per sample that is small
_BEFORE_S, _AFTER_S = 0.02, 0.04  # a motion that was set off has to die away
_REST, _SHARE = 1.5, 0.05  # times the misfit of noise, or of what is left in all: what may be left elsewhere
_OF_RECORD, _OF_ALL = 0.3, 0.06  # of the time, that may pass
_ROUNDS = 2
_LEAST_RECORDS = 3  # that are left where one contradicts them
_MOST_UNKNOWN = 0.5


@dataclass(frozen=True)
class Look:
    """What a look at the records comes to.

    Attributes:
        data: the data set without what no model is of; its prototype states the scales of laws that were learnt.
        search: of all hypotheses.
        judged: its fits, weighed.
        words: what was left out of the records, or why models had to follow them.
        kept: fits to these data, of an earlier run or of this one.
        doubtful: whether what was left out may be of another cause, so that no verdict is sure.
        refitted: where a law was learnt, tolerances alone and what was learnt, to the records that are not held out.
        follows: why models follow the records, a joint that `hammers` or a loop that `oscillates` by itself, where
            errors from rest grow without bound; empty where they do not.
    """

    data: Dataset
    search: Search
    judged: Judgement
    words: tuple[str, ...] = ()
    kept: FitCache | None = None
    doubtful: bool = False
    refitted: tuple[Fit, Fit] | None = None
    follows: Literal["", "hammers", "oscillates"] = ""

    def after(self, other: "Look") -> "Look":
        """As it goes on from another: its words before those, its fits where it has any, no less doubtful."""
        words, doubtful = (*self.words, *other.words), self.doubtful or other.doubtful
        return replace(self, words=words, kept=self.kept or other.kept, doubtful=doubtful)


def what_passed(look: Look, workers: int = 1, progress: Progress = silent) -> Look | None:
    """Search again without what passes in a short while and is all that stands against an explanation.

    Args:
        look: the first search.
        workers: processes.
        progress: told the share done and what is being fitted.

    Returns:
        None where there is nothing so short, or a cause explains the records no better without it.
    """
    data, found, stated = look.data, look.search, look.data.records
    for turn in range(_ROUNDS):
        shorter = (without_what_passes(data, best, stated) for best in _candidates(found))
        if (left := next((one for one in shorter if one is not None), None)) is None:
            return None
        data = left
        without = (f"{r.name} without {r.left_out}" for r in data.records)
        own = look.kept and replace(look.kept, part=(*look.kept.part, *without))
        found = search(data, workers, part_of(progress, turn / _ROUNDS, (turn + 1) / _ROUNDS), own)
        judged = judge(found)
        if judged.unknown <= _MOST_UNKNOWN:
            known = Look(data, found, judged, _warnings(data.records, stated), own, doubtful=True)
            return known.after(look) if judged.best.hypothesis.names else None
    return None


def without_one(look: Look, workers: int = 1, progress: Progress = silent) -> Look | None:
    """Search again without the record that is least explained beside all others, whatever it is that it shows.

    What explains the others may explain it as well, where no fit to all of them has found the way there.

    Args:
        look: the first search.
        workers: processes.
        progress: told the share done and what is being fitted.

    Returns:
        None where too few records are left, or nothing explains these, neither a cause nor tolerances; with all
        records, and no word, where what explains these explains that one too.
    """
    records = look.data.records
    *_, best = _candidates(look.search)
    if len(records) <= _LEAST_RECORDS or best.reason:
        return None
    name = records[max(range(len(records)), key=lambda k: best.shares[k].c)].name
    data = replace(look.data, records=tuple(record for record in records if record.name != name))
    own = look.kept and replace(look.kept, part=(*look.kept.part, f"without {name}"))
    found = search(data, workers, progress, own)
    judged = judge(found)
    words = (
        f"{name}: nothing explains it together with the other records (was the rig touched, is the file of another rig,"
        " or is it driven as no other?), so that it is left out. Take it once more: if that comes"
        " out alike, the rig does so by itself"
    )
    if judged.unknown > _MOST_UNKNOWN:
        return None
    return _with(look, judged.best) or Look(data, found, judged, (words,), own, doubtful=True).after(look)


def _with(look: Look, explains: Fit) -> Look | None:
    """The look with a fit that begins at what explains a part of its records; None where the whole stays unknown."""
    found = look.search
    with Fitters(look.data, 1, look.kept) as fitters:
        each = best_of_each([found.null, *found.fits, *fitters.each(Task(explains.hypothesis, explains.values))])
    null = next(fit for fit in each if fit.hypothesis == NOTHING)
    found = replace(found, null=null, fits=tuple(fit for fit in each if fit is not null))
    judged = judge(found)
    return replace(look, search=found, judged=judged) if judged.unknown <= _MOST_UNKNOWN else None


def _candidates(found: Search) -> Iterator[Fit]:
    """The fit that explains most, and the one that explains most beside its own worst piece of evidence.

    What does not belong to the cause may well be imitated best by a wrong one, which spreads it over all records.
    """
    fits = (found.null, *found.fits)
    yield min(fits, key=lambda fit: fit.misfit)
    yield min(fits, key=lambda fit: fit.misfit - max((share.c for share in fit.shares), default=0.0))


def without_what_passes(data: Dataset, best: Fit, stated: Sequence[TimeRecord]) -> Dataset | None:
    """The data set without the spans that hold most of what a fit leaves; None where there are none, or too long.

    Args:
        data: to be cut.
        best: the fit.
        stated: its records as they were given; what these say is not to count has not been found here.
    """
    pieces = record_evidence(data)
    records = []
    for piece, record in zip(pieces, data.records, strict=True):
        if (spans := passing(piece, best, _SHARE * best.misfit)) is None:
            return None
        records.append(replace(record, left_out=joined((*record.left_out, *spans))))
    gone, whole = sum(map(_gone, records)), sum(float(np.ptp(record.times)) for record in records)
    if gone == sum(map(_gone, data.records)) or gone - sum(map(_gone, stated)) > _OF_ALL * whole:
        return None
    return replace(data, records=tuple(records))


def passing(piece: RecordEvidence, best: Fit, small: float = 0.0) -> tuple[tuple[float, float], ...] | None:
    """Spans of a record, in s, that hold what a fit leaves of it beyond noise; None where it is all over the record.

    Args:
        piece: the record.
        best: the fit.
        small: misfit that is none, as the fit may have been led astray by what passed.
    """
    small = max(small, _REST * piece.expected)
    if (residual := piece.residual(best.hypothesis.placement(piece.job.prototype), best.z)) is None:
        return None
    if float(residual @ residual) < small:
        return ()
    weight, times, step = piece.weight, piece.record.times, piece.record.step
    real, imaginary = residual.reshape(2, -1, len(weight.channels))
    lines = np.zeros((len(weight.kept), len(weight.channels)), dtype=complex)
    lines[weight.kept] = real + 1j * imaginary
    power = np.sum(np.fft.irfft(lines, padded(len(times)), axis=0)[: len(times)] ** 2, axis=1)
    power *= float(residual @ residual) / power.sum()
    quick = pace(figures(piece.job.prototype))
    before, after, width = _BEFORE_S / quick, _AFTER_S / quick, max(1, round(_SMOOTHED_S / quick / step))
    loud = np.convolve(power, np.ones(width) / width, "same") > _LOUD * small / len(times)
    edges = [(first, first + count) for first, count in equal_runs(loud, 1) if loud[first]]
    spans = joined([(max(times[a] - before, times[0]), min(times[b - 1] + after, times[-1])) for a, b in edges])
    inside = np.any([(times >= begin) & (times <= end) for begin, end in spans], axis=0) if spans else loud
    if float(power[~inside].sum()) > small or np.mean(inside) > _OF_RECORD:
        return None
    return spans


def joined(spans: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Spans in order, those that overlap made one."""
    found: list[tuple[float, float]] = []
    for begin, end in sorted(spans):
        if found and begin <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], end)
        else:
            found.append((float(begin), float(end)))
    return tuple(found)


def _gone(record: TimeRecord) -> float:
    return sum(end - begin for begin, end in record.left_out)


def _warnings(records: Sequence[TimeRecord], stated: Sequence[TimeRecord]) -> tuple[str, ...]:
    return tuple(
        f"{record.name}: what the rig does from {begin:.3f} to {end:.3f} s fits no cause that explains the rest (did a "
        "chamber run empty, or something knock against the rig?), so that these seconds are left out"
        for record, given in zip(records, stated, strict=True)
        for begin, end in record.left_out
        if (begin, end) not in given.left_out
    )
