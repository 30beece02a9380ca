"""An end mass that is not the one stated of a record: found where it alone sets one record apart from all others.

A payload that was changed and not written down moves one record and no other. No cause of the library does that, and
what it leaves looks like an unknown one, in a place that has nothing to do with it.
"""

from dataclasses import replace
from math import inf
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, evidence_of, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, FitCache
from beamdesign.diagnosis.fitting.fitters import Fitters, Task, refit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.structure.lumped import figures

_LEAST_RECORDS = 3  # two that differ do not say which is wrong
_SUSPECTS = 2  # records that are left out in turn, those of which tolerances leave most over noise
_NOISE = 1.5  # times the misfit of noise: what the other records, and the one with its own mass, may leave
_APART = 5.0  # the same, which a record that contradicts all others leaves at least by what explains those
_TRIED, _REACH = 25, 4.0  # masses, up to so many times what moves by what is stated

EndMass = Literal["outer_end_mass", "inner_end_mass"]


def misstated_mass(data: Dataset, kept: FitCache | None = None) -> tuple[int, EndMass, float] | None:
    """The record, and the end mass that explains it by the figures that explain all other records without it.

    Args:
        data: what came back from the rig.
        kept: fits of an earlier run, where those of this one are kept as well.

    Returns:
        position of the record, which mass, and its kg; None where no single record is set apart so.

    Raises:
        TimeUp: where steps are to be broken off, and the time is up.
    """
    if len(data.records) < _LEAST_RECORDS:
        return None
    with Fitters(data, 1, kept) as fitters:
        (null,) = fitters.each(Task(NOTHING, {}))
    pieces = record_evidence(data)
    left = [_left(piece, null) / piece.expected for piece in pieces]
    for k in sorted(range(len(pieces)), key=lambda k: -left[k])[:_SUSPECTS]:
        if left[k] <= _NOISE:
            return None
        rest = replace(data, records=tuple(r for r in data.records if r is not data.records[k]))
        others, _ = refit(rest, null, 1, kept)
        if others.misfit > _NOISE * sum(piece.expected for piece in evidence_of(rest)):
            continue
        outer, inner = _best_mass(pieces[k], others, "outer_end_mass"), _best_mass(pieces[k], others, "inner_end_mass")
        mass: EndMass = "outer_end_mass" if outer[1] <= inner[1] else "inner_end_mass"
        kg, least = min(outer, inner, key=lambda found: found[1])
        if least <= _NOISE * pieces[k].expected and _left(pieces[k], others) >= _APART * pieces[k].expected:
            return k, mass, kg
    return None


def _left(piece: RecordEvidence, found: Fit) -> float:
    residual = piece.residual(found.hypothesis.placement(piece.job.prototype), found.z)
    return inf if residual is None else float(residual @ residual)


def _best_mass(piece: RecordEvidence, found: Fit, mass: EndMass) -> tuple[float, float]:
    """The end mass that leaves least of a record by the figures of a fit, kg, and what it leaves."""
    own = figures(piece.job.prototype)[mass.replace("_end", "")]

    def kg(moving: float) -> float:
        return max(float(np.exp(moving)) - own, 0.0)

    def left(moving: float) -> float:
        record = _with(piece.record, mass, kg(moving))
        return _left(replace(piece, job=Replay(record, piece.job.prototype)), found)

    tried = np.linspace(np.log(own), np.log(_REACH * (own + getattr(piece.record, mass))), _TRIED)
    k = int(np.argmin([left(each) for each in tried]))
    best = minimize_scalar(left, bounds=(tried[max(k - 1, 0)], tried[min(k + 1, _TRIED - 1)]), method="bounded")
    return kg(best.x), float(best.fun)


def _with(record: TimeRecord, mass: EndMass, kg: float) -> TimeRecord:
    return replace(record, outer_end_mass=kg) if mass == "outer_end_mass" else replace(record, inner_end_mass=kg)


def with_own_mass(data: Dataset, kept: FitCache | None = None) -> tuple[Dataset, FitCache | None, tuple[str, ...]]:
    """The data set with the end mass that `misstated_mass` finds in place of the one stated, if it finds any.

    Args:
        data: what came back from the rig.
        kept: fits of an earlier run.

    Returns:
        the data, where fits to them are kept, and what was changed, in words; none where nothing was.
    """
    if (found := misstated_mass(data, kept)) is None:
        return data, kept, ()
    k, mass, kg = found
    stated = data.records[k]
    records = tuple(_with(stated, mass, kg) if r is stated else r for r in data.records)
    words = (
        f"{stated.name}: {mass}_kg is stated as {getattr(stated, mass):.3g}, by which it alone contradicts all other "
        f"records; {kg:.3g} explains it together with them and is taken here. Weigh it, correct dataset.toml, and"
        " diagnose again"
    )
    own = kept and replace(kept, part=(*kept.part, words))
    return replace(data, records=records), own, (words,)
