"""Records that a model is made to follow, for motion that cannot be repeated.

In a joint with play, rod and beam hammer on each other. Two motions that begin a nanometre apart soon have nothing in
common, so that a model with the right law and the right figures does no better from rest than one without. It keeps in
step when its controller hears mostly the volts that were measured, and only a share `HEARD` of its own: what the
hammering has done so far is then in the record, and need not be predicted. That is an observer with a fixed gain, and
synchronisation by coupling to data (H. D. I. Abarbanel, Predicting the Future, Springer 2013, section 3). The plant,
which every hypothesis about such a joint is about, still has to make all of the displacement.

What remains unpredictable even so is measured, and counts as noise for every hypothesis alike: see `spread`.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, Replay, evidence_of
from beamdesign.diagnosis.fitting.fit import Evidence
from beamdesign.diagnosis.fitting.hypothesis import Placement, Unknown
from beamdesign.diagnosis.fitting.weighting import banded, blurred
from beamdesign.plant.assembly import Assembly, Structure, assemble

HEARD = 0.3
"""Share of its own volts that the model's controller hears. With none of them the loop is open, and the least error
in flow adds up to a drift that no fit can heed."""
PLAY = "joint_backlash"
_SHARE = 0.15
_MEMBERS = 4


@dataclass(frozen=True)
class FollowedRecord(RecordEvidence):
    """A time record that the model follows: what was measured stands in its command.

    Attributes:
        taken: the record as it was taken.
        secant: half length of those that stand for derivatives, in prior standard deviations.
    """

    taken: RecordEvidence
    secant: float = 0.5

    @property
    def condition(self) -> object:
        """Under which it was taken."""
        return self.taken.condition

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N, C) channels of the model."""
        return super().predicted(_following(placement), z)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z.

        Where there is play the derivative of the motion grows without bound along the record (to 1e20 within two
        seconds) and says nothing about figures that are off by more than a hair; secants do. They are taken to both
        sides, so that what is unpredictable here is not in all of them.
        """
        if PLAY not in placement.assembly.kinds.effects:
            return super().linearised(_following(placement), z)
        here = self.residual(placement, z)
        if here is None:
            return None
        slopes = np.zeros((len(here), len(z)))
        for k, unknown in enumerate(placement.unknowns):
            ends = []
            for step in _secant(unknown, float(z[k]), self.secant):
                moved = z.copy()
                moved[k] = np.clip(z[k] + step, *unknown.bounds)
                there = self.residual(placement, moved) if moved[k] != z[k] else None
                ends.append((z[k], here) if there is None else (moved[k], there))
            if ends[0][0] != ends[1][0]:
                slopes[:, k] = (ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0])
        return here, slopes

    def blurred(self, placement: Placement, z: np.ndarray) -> "FollowedRecord | None":
        """The record with what a model cannot predict of it counted as noise; None where the model's loop diverges."""
        power = spread(self, placement, z)
        return None if power is None else replace(self, weight=blurred(self.taken.weight, power))


def _secant(unknown: Unknown, z: float, step: float) -> tuple[float, float]:
    """Steps to either side, in prior standard deviations; of a play that is small against its prior, by a share."""
    if unknown.name == PLAY + ".play_m":
        step = step * min(1.0, 2 * _SHARE * unknown.value(z) / unknown.spread)
    return step, -step


def followed(taken: RecordEvidence) -> FollowedRecord:
    """A record as one that a model follows."""
    record, rig = taken.record, taken.job.prototype
    inputs = record.inputs.copy()
    inputs[:, 1] -= (1 - HEARD) * rig.sensor.gain_V_per_m * record.measured["displacement_m"]
    return FollowedRecord(_driven(taken, inputs), taken.weight, taken.measured, taken)


def followed_evidence(data: Dataset) -> tuple[Evidence, ...]:
    """Everything in a data set, its time records as ones that a model follows."""
    return tuple(followed(piece) if isinstance(piece, RecordEvidence) else piece for piece in evidence_of(data))


def spread(piece: FollowedRecord, placement: Placement, z: np.ndarray) -> np.ndarray | None:
    """(F, C) mean power, about every line, of the difference of motions that differ by the sensor's noise alone.

    It is that of one motion from their mean; None where the model's loop diverges.
    """
    weight, rig = piece.taken.weight, piece.job.prototype
    noise_V = rig.sensor.gain_V_per_m * weight.noise_std[weight.channels.index("displacement_m")]
    random = np.random.default_rng(0)
    motions = []
    for _ in range(_MEMBERS):
        inputs = piece.record.inputs.copy()
        inputs[:, 1] += noise_V * random.standard_normal(len(inputs))
        found = replace(piece, job=_driven(piece, inputs), _steps={}).predicted(placement, z)
        if found is None:
            return None
        motions.append(weight.lines(found))
    return banded(np.var(motions, axis=0, ddof=1), weight.frequencies_Hz)


def _driven(piece: RecordEvidence, inputs: np.ndarray) -> Replay:
    """A record with other inputs, ready to be simulated."""
    return Replay(replace(piece.record, inputs=inputs), piece.job.prototype)


def _following(placement: Placement) -> Placement:
    return replace(placement, assembly=_hearing(placement.assembly.kinds))


@cache
def _hearing(kinds: Structure) -> Assembly:
    return assemble(replace(kinds, heard=HEARD))
