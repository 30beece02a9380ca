"""What is done for a set that no fit from rest explains: models are made to follow its records.

Two kinds of motion cannot be predicted from rest by any model, however right: that of a joint which hammers in its
play, and that of a loop which oscillates by itself. A hair's difference in a figure or at the beginning makes another
motion of them. Fits that follow the records (see `fitting.followed`) are not led astray by that, and are believed only
where what they find is one of these two.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.fitting.evidence import record_evidence
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.followed import PLAY
from beamdesign.gap.fitting.growth import grows, rings
from beamdesign.gap.fitting.hammering import hammering, refit_hammering
from beamdesign.gap.fitting.kept_fits import KeptFits
from beamdesign.gap.fitting.search import Progress, Search, refit, search
from beamdesign.gap.judgement import Judgement, judge
from beamdesign.records import InputError

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
