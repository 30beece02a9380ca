"""What a record or a frequency response was not taken at, though it says so: an end mass, or another one's conditions.

A payload that was changed and not written down moves one record and no other, and two files that stand for one another
move both. No cause of the library does that, and what it leaves looks like an unknown one, in a place that has nothing
to do with it.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from beamdesign.diagnosis.data.dataset import Dataset, FrequencyResponse, TimeRecord
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of
from beamdesign.diagnosis.fitting.fit import Fit, FitCache
from beamdesign.diagnosis.fitting.fitters import Fitters, Task, refit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.prototype import Prototype
from beamdesign.structure.lumped import figures

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
        """What explains all others, if they are explained."""
        rest = _but(data, [one for k, one in enumerate(taken) if k not in without])
        found, _ = refit(rest, null, 1, kept)
        return found if found.misfit <= _NOISE * sum(piece.expected for piece in evidence_of(rest)) else None

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
