"""Whether a loop, as a record was taken, oscillates by itself: no model can repeat such a record from rest."""

from dataclasses import replace

import numpy as np

from beamdesign.gap.fitting.evidence import DISPLACEMENT, RecordEvidence
from beamdesign.gap.fitting.unknowns import Placement

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
