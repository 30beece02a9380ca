"""What records say that is not so: an end mass, another one's conditions, channels of one instant that are of several.

A payload that was changed and not written down moves one record and no other, and two files that stand for one another
move both. No cause of the library does that, and what it leaves looks like an unknown one, in a place that has nothing
to do with it.

Channels may stand beside their time: that is found beside what explains the records, and they are put where they
belong. A converter that reads its channels one after another, a filter or a recorder of its own for one of them, put a
force or a displacement a fraction of a sample, or some samples, before or after the command and the current of the same
instant. No law of the rig does that, but by the force alone a sensor that lags looks alike. Records driven by the
command tell the two apart: they know nothing of the force. A displacement that is late contradicts the controller's
equation, and is told by that once it makes a twentieth of the current; here it is told of less. One that is early is
not told here: an amplifier that lags looks alike in all channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, sqrt
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from beamdesign.diagnosis.data.dataset import INPUTS, Dataset, FrequencyResponse, TimeRecord
from beamdesign.diagnosis.examination.sound_records import where_it_counts
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of
from beamdesign.diagnosis.fitting.fit import ITERATIONS, Evidence, Fit, Fitted, fit, misfit_at
from beamdesign.diagnosis.fitting.fit_cache import FitCache, Task
from beamdesign.diagnosis.fitting.fitters import Fitters, refit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Placement, Unknown
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT, Replay
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.tone import search_without_tones
from beamdesign.plant.compiled import beyond_line
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.structure.lumped import figures
from beamdesign.time_limit import TimeUp, left_out

_LEAST_RECORDS = 3  # two that differ do not say which is wrong
_SUSPECTS = 2  # records that are left out in turn, those of which tolerances leave most beyond noise
_NOISE = 1.5  # times the misfit of noise: what the other records, and the one with its own mass, may leave
_APART = 5.0  # the same, which a record that contradicts all others leaves at least by what explains those
_TRIED, _REACH = 25, 4.0  # masses, up to so many times what moves by what is stated
_MASSES = ("outer_end_mass", "inner_end_mass")
_CONDITIONS = (*_MASSES, "controller")

Piece = RecordEvidence | ResponseEvidence
Misstated = Mapping[int, Mapping[str, Any]]
"""By position among the records, and after them the frequency responses, what one is to state instead."""


def misstated_mass(data: Dataset, kept: FitCache | None = None) -> Misstated | None:
    """The record, and the end mass that explains it by the figures that explain all other records without it.

    Frequency responses count like records. Where no single one is set apart so, two may be, each of which the other's
    conditions explain.

    Args:
        data: what came back from the rig.
        kept: fits of an earlier run, where those of this one are kept as well.

    Returns:
        what they are to state; None where they contradict no others.

    Raises:
        TimeUp: where steps are to be broken off, and the time is up.
    """
    taken: list[TimeRecord | FrequencyResponse] = [*data.records, *data.responses]
    if len(taken) < _LEAST_RECORDS:
        return None
    with Fitters(data, 1, kept) as fitters:
        (null,) = fitters.each(Task(NOTHING, {}))
        pieces = [piece for piece in fitters.evidence if isinstance(piece, RecordEvidence | ResponseEvidence)]
    if null.reason:
        return None
    left = [_left(piece, null) for piece in pieces]
    suspects = sorted(range(len(pieces)), key=lambda k: pieces[k].expected - left[k])[:_SUSPECTS]
    suspects = [k for k in suspects if left[k] > _NOISE * pieces[k].expected]

    def others(*without: int) -> Fit | None:
        """What explains all others, if they are explained and no figure is strained for it: that would be a cause."""
        rest = _but(data, [one for k, one in enumerate(taken) if k not in without])
        found, _ = refit(rest, null, 1, kept)
        noise = sum(piece.expected for piece in evidence_of(rest))
        return found if found.misfit <= _NOISE * noise and not found.strained else None

    def explained(k: int, found: Fit, least: float) -> bool:
        noise = pieces[k].expected
        return least <= _NOISE * noise and _left(pieces[k], found) >= _APART * noise

    for k in suspects:
        if (found := others(k)) is not None:
            mass, kg, least = min((_best_mass(pieces[k], found, mass) for mass in _MASSES), key=lambda one: one[2])
            if explained(k, found, least):
                return {k: {mass: kg}}
    if len(suspects) == _SUSPECTS:
        each = {k: {key: getattr(taken[j], key) for key in _CONDITIONS} for k, j in (suspects, suspects[::-1])}
        swapped = {k: _under(pieces[k], own) for k, own in each.items()}
        found = others(*suspects) if all(_left(piece, null) < left[k] for k, piece in swapped.items()) else None
        if found is not None and all(explained(k, found, _left(piece, found)) for k, piece in swapped.items()):
            return each
    return None


def _but(data: Dataset, taken: list[TimeRecord | FrequencyResponse]) -> Dataset:
    """The data with these records and frequency responses."""
    records = tuple(one for one in taken if isinstance(one, TimeRecord))
    return replace(data, records=records, responses=tuple(one for one in taken if isinstance(one, FrequencyResponse)))


def _left(piece: Piece, found: Fit) -> float:
    residual = piece.residual(found.hypothesis.placement(_prototype(piece)), found.z)
    return inf if residual is None else float(residual @ residual)


def _prototype(piece: Piece) -> Prototype:
    return piece.job.prototype if isinstance(piece, RecordEvidence) else piece.prototype


def _under(piece: Piece, stated: Mapping[str, Any]) -> Piece:
    """The same measured under other conditions."""
    if isinstance(piece, RecordEvidence):
        return replace(piece, job=Replay(replace(piece.record, **stated), piece.job.prototype))
    return replace(piece, measured=replace(piece.measured, **stated), _models={})


def _best_mass(piece: Piece, found: Fit, mass: str) -> tuple[str, float, float]:
    """The end mass that leaves least of a record by the figures of a fit, kg, and what it leaves."""
    own = figures(_prototype(piece))[mass.replace("_end", "")]
    stated = getattr(piece.record if isinstance(piece, RecordEvidence) else piece.measured, mass)

    def kg(moving: float) -> float:
        return max(float(np.exp(moving)) - own, 0.0)

    def left(moving: float) -> float:
        return _left(_under(piece, {mass: kg(moving)}), found)

    tried = np.linspace(np.log(own), np.log(_REACH * (own + stated)), _TRIED)
    k = int(np.argmin([left(each) for each in tried]))
    best = minimize_scalar(left, bounds=(tried[max(k - 1, 0)], tried[min(k + 1, _TRIED - 1)]), method="bounded")
    return mass, kg(best.x), float(best.fun)


def with_own_mass(data: Dataset, kept: FitCache | None = None) -> tuple[Dataset, FitCache | None, tuple[str, ...]]:
    """The data set with what `misstated_mass` finds in place of what is stated, if it finds anything.

    Args:
        data: what came back from the rig.
        kept: fits of an earlier run.

    Returns:
        the data, where fits to them are kept, and what was changed, in words; none where nothing was.
    """
    if (found := misstated_mass(data, kept)) is None:
        return data, kept, ()
    taken: list[TimeRecord | FrequencyResponse] = [*data.records, *data.responses]
    names = [taken[k].name for k in found]
    if len(names) == 1:
        ((k, stated),) = found.items()
        ((mass, kg),) = stated.items()
        words = (
            f"{names[0]}: {mass}_kg is stated as {getattr(taken[k], mass):.3g}, by which it alone contradicts all other"
            f" records; {kg:.3g} explains it together with them and is taken here. Weigh it, correct dataset.toml, and"
            " diagnose again"
        )
    else:
        words = (
            f"{' and '.join(names)}: contradict all other records, and are explained together with them by the end"
            " masses and the controller of one another, which are taken here. Look which file is which, correct"
            " dataset.toml, and diagnose again"
        )
    own = kept and replace(kept, part=(*kept.part, words))
    changed = [replace(one, **found.get(k, {})) if k in found else one for k, one in enumerate(taken)]
    return _but(data, changed), own, (words,)


_FORCE = INPUTS[0]
_LONGEST_S = 0.02  # what a fit would bring beyond is nothing of a recorder
_STARTS_S = 2e-3 * np.arange(-9, 10)  # of a force: a fit from zero comes no further than half a period
_ITERATIONS = 3 * ITERATIONS  # figures that were strained to stand for what is late have a long way back
_USUAL_S = 1e-3  # or a sample where that is longer: the prior's spread
_STEP_S = 1e-5  # to either side, for derivatives
_SMALL = 1.3  # times the misfit of noise alone: what tolerances leave below it is no gap
_CLEAR = 10.0  # in cost, over the spread of what it leaves: by how much it has to explain more than any cause listed
_LEAVES = 0.8  # of the excess misfit of that cause
_EXPLAINS = 0.5  # of the excess misfit of tolerances alone: what leaves more explains no gap
_SURE = 4.0  # standard errors by which a channel is late, to be taken for it


@dataclass(frozen=True)
class _Late(Fitted):
    """A piece of evidence whose channels may be late; what is no time record does not depend on it.

    How late force and displacement stand, s, are the last unknowns.

    Attributes:
        taken: as measured.
        within: the other unknowns, in the equations.
    """

    taken: Evidence
    within: Placement

    def _acting(self, force_late_s: float) -> Evidence:
        if not isinstance(self.taken, RecordEvidence):
            return self.taken
        job = self.taken.job
        return replace(self.taken, job=replace(job, record=in_time(job.record, {_FORCE: force_late_s}), _inputs={}))

    def predicted(self, placement: Placement, z: np.ndarray) -> Any:
        """What the model makes of it."""
        force_late_s, late_s = (unknown.value(of) for unknown, of in zip(placement.unknowns[-2:], z[-2:], strict=True))
        found = self._acting(force_late_s).predicted(self.within, z[:-2])
        if found is None or not isinstance(self.taken, RecordEvidence):
            return found
        column, found = self.taken.column, found.copy()
        found[:, column] = _moved(found[:, column], -late_s / self.taken.record.step)
        return found

    def misfit(self, predicted: Any) -> np.ndarray:
        """(M,) measured less predicted, weighed."""
        return self.taken.misfit(predicted)

    def error(self, residual: np.ndarray) -> float:
        """Of the displacement."""
        return self.taken.error(residual)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z; the rig's part of it is that of a displacement in time."""
        slopes = self._acting(placement.unknowns[-2].value(z[-2])).linearised(self.within, z[:-2])
        if slopes is not None and not isinstance(self.taken, RecordEvidence):
            return slopes[0], np.pad(slopes[1], ((0, 0), (0, 2)))
        here = self.residual(placement, z)
        if here is None or slopes is None:
            return None
        columns = [slopes[1]]
        for k, unknown in enumerate(placement.unknowns[-2:], start=len(z) - 2):
            step = _STEP_S / unknown.spread
            ends = [self.residual(placement, np.where(np.arange(len(z)) == k, z + by, z)) for by in (step, -step)]
            if ends[0] is None or ends[1] is None:
                return None
            columns.append((ends[0] - ends[1])[:, None] / (2 * step))
        return here, np.column_stack(columns)


def in_time(record: TimeRecord, late_s: dict[str, float]) -> TimeRecord:
    """A record with channels put where they belong.

    Args:
        record: as read.
        late_s: how late the values of each stand, by its name: the force or what was measured; negative where early.

    Returns:
        the record; what was measured late goes straight across the spans that do not count, so that what is spoilt
        there reaches no sample that counts.
    """
    force, measured, across = record.inputs[:, 0], dict(record.measured), where_it_counts(record).measured
    for name, by_s in late_s.items():
        if name == _FORCE:
            force = _moved(force, by_s / record.step)
        else:
            measured[name] = _moved(across[name], by_s / record.step)
    return replace(record, inputs=np.column_stack([force, record.inputs[:, 1]]), measured=measured)


def _moved(signal: np.ndarray, by: float) -> np.ndarray:
    """A signal as it is some samples later, as band-limited between them: so its noise stays as large as it is.

    Beyond its ends it goes on as its point reflection about them.
    """
    count = len(signal) - 1
    turned = beyond_line(signal[:, None])[:, 0] * np.exp(2j * np.pi * np.fft.rfftfreq(2 * count) * by)
    line = signal[0] + (signal[-1] - signal[0]) / count * (np.arange(count + 1) + by)
    return np.asarray(line + np.fft.irfft(turned, 2 * count)[: count + 1])


def fitted_skewed(found: Fit, evidence: Sequence[Evidence], data: Dataset) -> Fit:
    """The hypothesis of a fit, fitted again with how late force and displacement stand as its last unknowns, s.

    Args:
        found: where it begins.
        evidence: of the data.
        data: that it was fitted to.
    """
    spread = max(_USUAL_S, *(record.step for record in data.records))
    force = Unknown(_FORCE, 0.0, spread, True, -_LONGEST_S, _LONGEST_S, "effect")
    within = found.hypothesis.placement(data.prototype)
    unknowns = (*within.unknowns, force, replace(force, name=DISPLACEMENT, low=0.0))
    skewed = replace(within, unknowns=unknowns, rows=np.pad(within.rows, ((0, 0), (0, 2))))  # which moves no figure
    pieces = [_Late(piece, within) for piece in evidence]
    starts = (np.append(found.z, [force.z(late_s), 0.0]) for late_s in _STARTS_S)
    start = min(starts, key=partial(misfit_at, pieces, skewed))
    return fit(found.hypothesis, skewed, pieces, start, _ITERATIONS)


def late_channels(look: Look) -> dict[str, float]:
    """How late (s) values of channels stand, where that explains much more than any cause that is listed; else none.

    That is looked for beside tolerances alone, the best single cause, and each cause of what explains most.

    Args:
        look: the search of all hypotheses.
    """
    found, data = look.search, look.data
    if found.null.misfit <= _SMALL * found.expected or found.explained:
        return {}
    evidence, rival = evidence_of(data), min((found.null, *found.fits), key=lambda f: f.cost)
    alone = [f for f in found.fits if len(f.hypothesis.causes) == 1 and not f.reason]
    beside = (found.null, *alone[:1], *(f for f in alone[1:] if {*f.hypothesis.names} & {*rival.hypothesis.names}))
    best = min((fitted_skewed(one, evidence, data) for one in beside), key=lambda f: f.cost)
    spread = max(1.0, best.misfit / found.expected)
    if best.reason or best.cost > rival.cost - _CLEAR * spread:
        return {}
    if found.excess(best) > min(_EXPLAINS, _LEAVES * found.excess(rival)):
        return {}
    late_s = {name: best.values[name] for name in (_FORCE, DISPLACEMENT)}
    if max(map(abs, late_s.values())) >= _LONGEST_S:
        return {}
    errors = best.standard_errors
    return {name: by for name, by in late_s.items() if abs(by) > _SURE * sqrt(spread) * errors[name]}


def channels_in_time(look: Look, workers: int = 1, progress: Progress = silent) -> Look | None:
    """Search again with the channels that `late_channels` finds put where they belong.

    What is found then is never sure: a soft link between load cell and rig delays a force as well.

    Args:
        look: the first search.
        workers: processes.
        progress: told the share done and what is being fitted.

    Returns:
        None where there are no such channels.

    Raises:
        TimeUp: where there are, by what there was time to compare them with.
    """
    if not (late_s := late_channels(look)):
        return None
    if left_out():  # what was not compared may explain as much
        raise TimeUp
    data = replace(look.data, records=tuple(in_time(record, late_s) for record in look.data.records))
    words = tuple(_words(name, by) for name, by in late_s.items())
    kept = look.kept and replace(look.kept, part=(*look.kept.part, repr(late_s)))
    again = search_without_tones(data, workers, progress, kept)
    return replace(again, words=(*words, *again.words), doubtful=True).after(look)


def _words(name: str, late_s: float) -> str:
    by, side = f"{1e3 * abs(late_s):.2g} ms", "after" if late_s > 0 else "before"
    return (
        f"values of {name} stand {by} {side} those of command and current of the same instant, by what is left of "
        "the records otherwise (does a converter read one channel after another, or has it a filter or a recorder of "
        "its own?): they are put back by that here. Record all channels at one instant, or shift this one, and "
        "diagnose again"
    )
