"""What is done for a set that no fit from rest explains: models are made to follow its records.

Two kinds of motion cannot be predicted from rest by any model, however right: that of a joint which hammers in its
play, and that of a loop which oscillates by itself. A hair's difference in a figure or at the beginning makes another
motion of them. Fits that follow the records (see `fitting.followed`) are not led astray by that, and are believed only
where what they find is one of these two.

No model can repeat from rest a record of a loop that, as it was taken, oscillates by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.evidence import DISPLACEMENT, RecordEvidence, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, KeptFits
from beamdesign.diagnosis.fitting.followed import PLAY
from beamdesign.diagnosis.fitting.hammering import hammering, refit_hammering
from beamdesign.diagnosis.fitting.hypothesis import Placement
from beamdesign.diagnosis.fitting.search import Progress, Search, refit, search
from beamdesign.diagnosis.judgement import Judgement, judge
from beamdesign.records import InputError

_AT, _LASTS_S = 0.05, 5e-3  # of the record; long enough for whatever a loop of this kind may oscillate at
_ENDS = 3
_NARROW, _MOST = 0.06, 0.6  # of the frequency, of the power


def grows(piece: RecordEvidence, placement: Placement, z: np.ndarray) -> bool:
    """Whether a motion that a small pulse has set off is larger in the last third of the record than in the first.

    The pulse, as large as the sensor's noise, is added to the command. The motion it makes is the difference of two
    simulations with all that the record drives its rig with, so that laws count as they are where the rig works. A loop
    that diverges grows.

    Args:
        piece: the record.
        placement: the unknowns of a hypothesis.
        z: (K,) their values.
    """
    record, rig = piece.record, piece.job.prototype
    column = piece.weight.channels.index(DISPLACEMENT)
    count, first = len(record.times), round(_AT * len(record.times))
    inputs = record.inputs.copy()
    inputs[first : first + max(2, round(_LASTS_S / record.step)), 1] += (
        rig.sensor.gain_V_per_m * piece.weight.noise_std[column]
    )
    plain = piece.predicted(placement, z)
    nudged = replace(piece, job=replace(piece.job, record=replace(record, inputs=inputs), _inputs={}))
    moved = nudged.predicted(placement, z)
    if plain is None or moved is None:
        return True
    motion = moved[:, column] - plain[:, column]
    return bool(np.std(motion[-count // _ENDS :]) > np.std(motion[: count // _ENDS]))


def rings(piece: RecordEvidence, placement: Placement, z: np.ndarray) -> bool:
    """Whether most of what a model leaves of the displacement is of one frequency.

    So it is where the rig oscillates and the model does not; mains hum looks alike.

    Args:
        piece: the record.
        placement: the unknowns of a hypothesis.
        z: (K,) their values.
    """
    residual = piece.residual(placement, z)
    if residual is None:
        return True
    power = np.abs(piece.displacement(residual)) ** 2
    frequency = piece.weight.frequencies_Hz
    near = np.abs(frequency / frequency[np.argmax(power)] - 1) < _NARROW
    return bool(power[near].sum() > _MOST * power.sum())


_HAMMERS = (
    "a joint hammers in its play, so that the motion of small records cannot be repeated: fits follow the records, and "
    "prediction errors from rest stay larger than the model is wrong"
)
_OSCILLATES = (
    "the rig's loop oscillates by itself, so that its motion cannot be predicted from rest: fits follow the records, "
    "and errors are those of models that do"
)
_WORTH = 0.7  # of the excess misfit: what the best single cause has to stay below for pairs to be tried
_HELPS = 0.9  # the same: what another effect has to stay below for play to be looked for beside it
_MOST_UNKNOWN = 0.5


@dataclass(frozen=True)
class SecondLook:
    """A search in which models follow the records, and what it comes to.

    Attributes:
        search: of all hypotheses.
        judged: its fits, weighed.
        warning: why the records had to be followed, in words.
        oscillates: whether because the loop oscillates by itself: errors from rest then grow without bound.
    """

    search: Search
    judged: Judgement
    warning: str
    oscillates: bool

    def refit(
        self, seen: Dataset, plain: Fit, best: Fit, workers: int = 1, kept: KeptFits | None = None
    ) -> tuple[Fit, Fit]:
        """Tolerances alone, and what is chosen, again to fewer data.

        Args:
            seen: what is left of them.
            plain: tolerances alone, of the search from rest.
            best: one of the fits here.
            workers: processes.
            kept: fits of an earlier run.
        """
        if self.oscillates:
            return refit(seen, best, workers, kept, in_step=True)
        return refit(seen, plain, workers, kept)[0], refit_hammering(seen, best)


def second_look(
    data: Dataset,
    before: Search,
    workers: int = 1,
    progress: Progress = lambda share, words: None,
    kept: KeptFits | None = None,
) -> SecondLook | None:
    """Look for play in which a joint hammers, then for causes that make the loop oscillate by itself.

    Args:
        data: what to explain.
        before: the first search.
        workers: processes.
        progress: told the share done and what is being fitted.
        kept: fits of an earlier run.

    Returns:
        None where neither is found.
    """
    found = _hammering(data, before, lambda share, words: progress(share / 3, words))
    if found is not None or not _rings(data, before):
        return found
    return _oscillating(data, workers, lambda share, words: progress((1 + 2 * share) / 3, f"{words}, in step"), kept)


def _hammering(data: Dataset, before: Search, progress: Progress) -> SecondLook | None:
    """Play alone or with what it needs, then beside the single effect that explains most without it."""
    effects = [f for f in before.fits if not f.reason and f.hypothesis.effects and len(f.hypothesis.causes) == 1]
    others = [f for f in effects if PLAY not in f.hypothesis.causes]
    for beside in (None, *others[:1]):
        if beside is not None and before.excess(beside) > _HELPS:
            break
        found = hammering(data, before, progress, beside)
        if found is None:
            continue
        judged = judge(found)
        if judged.unknown <= _MOST_UNKNOWN and PLAY in judged.best.hypothesis.causes:
            return SecondLook(found, judged, _HAMMERS, oscillates=False)
    return None


def _rings(data: Dataset, before: Search) -> bool:
    """Whether the best fit of all leaves one frequency of a record, and hardly anything else of it."""
    best = min((before.null, *before.fits), key=lambda fit: fit.misfit)
    placement = best.hypothesis.placement(data.prototype)
    return any(rings(piece, placement, best.z) for piece in record_evidence(data))


def _oscillating(data: Dataset, workers: int, progress: Progress, kept: KeptFits | None) -> SecondLook | None:
    try:
        found = search(data, workers, progress, kept, in_step=True, worth=_WORTH)
    except InputError:  # not even in step is the believed loop stable
        return None
    judged = judge(found)
    if judged.unknown > _MOST_UNKNOWN or not judged.best.hypothesis.causes:
        return None
    growing = oscillating(data, judged.best)
    if not growing:
        return None
    return SecondLook(found, judged, f"{', '.join(growing)}: {_OSCILLATES}", oscillates=True)


def oscillating(data: Dataset, found: Fit) -> Sequence[str]:
    """Names of the time records that were taken with a loop which oscillates by itself, as a fit has it."""
    placement = found.hypothesis.placement(data.prototype)
    return [piece.name for piece in record_evidence(data) if grows(piece, placement, found.z)]
