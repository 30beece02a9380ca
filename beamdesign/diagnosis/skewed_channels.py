"""Channels whose values stand beside their time: found beside what explains the records, and put where they belong.

A converter that reads its channels one after another, a filter or a recorder of its own for one of them, put a force or
a displacement a fraction of a sample, or some samples, before or after the command and the current of the same instant.
No law of the rig does that, but by the force alone a sensor that lags looks alike. Records driven by the command tell
the two apart: they know nothing of the force. A displacement that is late contradicts the controller's equation, and is
told by that once it makes a twentieth of the current; here it is told of less. One that is early is not told here: an
amplifier that lags looks alike in all channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt
from typing import Any

import numpy as np

from beamdesign.diagnosis.data.dataset import INPUTS, Dataset, TimeRecord
from beamdesign.diagnosis.examination.sound_records import where_it_counts
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of
from beamdesign.diagnosis.fitting.fit import ITERATIONS, Evidence, Fit, Fitted, fit, misfit_at
from beamdesign.diagnosis.fitting.hypothesis import Placement, Unknown
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.tone import search_without_tones
from beamdesign.plant.compiled import beyond_line
from beamdesign.progress import Progress, silent
from beamdesign.time_limit import TimeUp, left_out

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
class _Piece(Fitted):
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
    pieces = [_Piece(piece, within) for piece in evidence]
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
