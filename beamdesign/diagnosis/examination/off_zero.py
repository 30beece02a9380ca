"""Channels whose zero is off: told by the controller's equation and by how a record begins, and taken off."""

from dataclasses import replace
from math import inf

import numpy as np

from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.examination.nominal import ControllerFit, commanded_current
from beamdesign.diagnosis.examination.sound_records import ENDS, finest_step, noise_std
from beamdesign.diagnosis.fitting.weighting import SHARE

_AS_MUCH = 3.0  # times its noise: how far a channel may begin from what its zero is off


def off_zero(record: TimeRecord, fit: ControllerFit, sensor_gain: float) -> dict[str, float]:
    """Which channel's zero is off, and by how much, where a constant of the current counts that no controller made.

    An offset of the displacement would have been heard as one of the current. A record begins at rest, where each
    channel shows its own.

    Args:
        record: measured.
        fit: to its controller.
        sensor_gain: believed, V/m.

    Returns:
        by the name of the channel, A or m; none where nothing counts, and 0 where neither begins so.
    """
    current, moved = (record.measured[name] for name in ("current_A", "displacement_m"))
    if abs(fit.offset_A) < SHARE * float(np.std(current)):
        return {}
    lower = replace(record, measured={**record.measured, "displacement_m": moved - float(np.std(moved))})
    asked, then = (commanded_current(one, record.controller, sensor_gain) for one in (record, lower))
    assert asked is not None  # as a fit has been made
    heard = 0.0 if then is None else float(np.median(then - asked)) / float(np.std(moved))
    offs = {"current_A": fit.offset_A, "displacement_m": fit.offset_A / heard if heard else inf}
    begins = {name: float(np.mean(record.measured[name][:ENDS])) for name in offs}
    noise = {name: max(noise_std(y), finest_step(y)) for name, y in (("current_A", current), ("displacement_m", moved))}
    missed = {
        name: max(abs(begins[of] - offs[of] * (of == name)) / noise[of] if noise[of] else inf for of in offs)
        for name in offs
        if np.isfinite(offs[name])
    }
    name = min(missed, key=lambda one: missed[one])
    return {name: offs[name] if missed[name] < _AS_MUCH else 0.0}


def on_zero(record: TimeRecord, fit: ControllerFit, sensor_gain: float) -> TimeRecord:
    """The record with what `off_zero` finds taken off."""
    off = off_zero(record, fit, sensor_gain)
    return replace(record, measured={name: y - off.get(name, 0.0) for name, y in record.measured.items()})
