"""Whether the force of a record is one that acted on its rig, as far as the rig tells: it cannot help bending under it.

What a load cell reads beside the force, as an offset, hum or a spoilt sample, would move the believed rig. Where the
displacement measured has nothing of such a motion, that was no force.
"""

from collections.abc import Iterator

import numpy as np

from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.examination.nominal import nominal_loop
from beamdesign.diagnosis.examination.sound_records import Finding, blips, equal_runs, finest_step, noise_std, rms
from beamdesign.prototype import Prototype

_FELT = 0.3  # of what it would do in the believed rig: what moves less was no force
_SEEN = 4.0  # times the noise of the displacement: what would be seen
_COUNTS = 0.05  # of the rms of the displacement: what is worth a word
_STANDS_OUT = 2.0  # of the rms of what else is not as believed: a force leaves as much in a rig that rings elsewhere
_THERE = 0.1  # of the largest motion that it would make: where that is, it is looked for
_PLATEAU, _MANY = 4, 12  # equal samples in a row, and altogether
_NOISY = 0.5  # of the finest step: noise that carries every sample to another one
_NOISE = 1e-4  # of the rms of the force: less is no noise of a load cell


def force_channel(record: TimeRecord, prototype: Prototype) -> Iterator[Finding]:
    """What is to be said about the force of a usable record."""
    force, command = record.inputs.T
    if not np.ptp(force) > 0:
        return
    if samples := _cut_off(force):
        yield "clipped", f"disturbance_N is cut off, {samples} samples long: widen the recorder's range, or drive less"
        return
    still = record.denoised[0]
    if np.ptp(command) > 0 and (size := _unfelt(record, prototype, still)):
        text = f"disturbance_N of {rms(still):.3g} N rms would move the tip by {size:.2g} m rms, and does not"
        yield "unfelt_force", f"{text}: hum, an offset or a drift of the load cell; set it to zero where nothing pushes"
        return
    at = blips(force)
    spikes = np.zeros_like(force)
    spikes[at] = force[at] - (force[at - 1] + force[at + 1]) / 2
    if len(at) and _unfelt(record, prototype, spikes):
        text = f"{len(at)} single samples that the rig does not feel, first at {record.times[at[0]]:.4g} s"
        yield "unfelt_force", f"disturbance_N has {text}: they are spoilt, put them between their neighbours"


def _unfelt(record: TimeRecord, prototype: Prototype, part: np.ndarray) -> float:
    """Rms (m) of what a part of the force would make of the displacement, where that is not there; 0 else."""
    loop, moved = nominal_loop(prototype, record), record.measured["displacement_m"]
    if not loop.stable:
        return 0.0
    rest = record.inputs - np.column_stack([part, np.zeros_like(part)])
    made = loop.driven(np.column_stack([part, np.zeros_like(part)]), record.step)[:, 1, 0] * record.counted
    left = (moved - loop.driven(rest, record.step)[:, 1].sum(axis=1)) * record.counted
    there = np.abs(made) > _THERE * np.abs(made).max()
    if not there.any():
        return 0.0
    size, around, whole = (rms(signal[there]) for signal in (made, left, moved))
    felt = float(made[there] @ left[there]) / float(made[there] @ made[there])
    return size if size > max(_SEEN * noise_std(moved), _COUNTS * whole, _STANDS_OUT * around) and felt < _FELT else 0.0


def _cut_off(force: np.ndarray) -> int:
    """How many samples of a noisy force are exactly at its extremes, several in a row; 0 where it is not cut off."""
    rough = float(np.sqrt(np.median(np.diff(force, 2) ** 2) / 2.7))  # noise alone makes as much
    noise = min(rough, noise_std(force))
    if noise <= max(_NOISY * finest_step(force), _NOISE * float(np.std(force))):
        return 0
    ends = {float(force.min()), float(force.max())} - {0.0}  # where nothing pushes nothing is cut off
    count = sum(length for first, length in equal_runs(force, _PLATEAU) if force[first] in ends)
    return count if count >= _MANY else 0
