"""Channels whose values stand beside their time: told from a sensor that lags, and put back.

What is right is known by construction: rigs are simulated five times as finely as they are recorded, so that a channel
may be taken a fifth of a sample beside the others without any interpolation.
"""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, scenario

from beamdesign import Prototype, diagnose
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis
from beamdesign.diagnosis.skewed_channels import in_time, late_channels
from beamdesign.diagnosis.tone import search_without_tones

FINE, TAKEN = 1e-4, 5
SLOWED, RUBBING = Hypothesis(("sensor_lag",)), Hypothesis(("seal_friction",))
FRICTION = {"seal_friction": {"coulomb_N": 60.0}}


@pytest.fixture
def slowed_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cause that looks alike in place of the whole library."""
    monkeypatch.setattr(searching, "singles", lambda rig: (SLOWED,))


def recorded(rig: Prototype, force_late: int = 0, displacement_late: int = 0) -> Dataset:
    """Two records of a rig, with channels late by fifths of a sample."""
    plan = scenario(0.6)
    rows = [row for row in plan.record if row.name in ("command_large", "disturbance_large")]
    fine = measured(rig, plan.but(sample_s=FINE, record=tuple(rows)))
    return replace(fine, records=tuple(taken(record, force_late, displacement_late) for record in fine.records))


def taken(record: TimeRecord, force_late: int, displacement_late: int) -> TimeRecord:
    count = (len(record.times) - 1) // TAKEN
    at = TAKEN * np.arange(1, count)
    channels = {"current_A": 0, "displacement_m": displacement_late}
    kept = {name: record.measured[name][at - late] for name, late in channels.items()}
    inputs = np.column_stack([record.inputs[at - force_late, 0], record.inputs[at, 1]])
    return replace(record, times=record.times[at] - record.times[at[0]], inputs=inputs, measured=kept)


@pytest.mark.parametrize("late", [-1, 2])
def test_a_force_beside_its_time_is_told_with_by_how_much(slowed_only: None, late: int):
    found = late_channels(search_without_tones(recorded(believed(), late)))
    assert found == {"disturbance_N": pytest.approx(late * FINE, abs=0.1 * FINE)}


def test_a_displacement_that_is_late_in_the_recorder_alone_is_told(slowed_only: None):
    found = late_channels(search_without_tones(recorded(believed(), displacement_late=2)))
    assert found == {"displacement_m": pytest.approx(2 * FINE, rel=0.15)}


@pytest.mark.parametrize("effects", [{"sensor_lag": {"break_Hz": 500.0}}, FRICTION])
def test_what_a_rig_does_is_no_channel_beside_its_time(slowed_only: None, effects: dict[str, dict[str, float]]):
    assert late_channels(search_without_tones(recorded(believed().but(effects=effects)))) == {}


def test_a_cause_beside_a_skewed_force_is_found_and_said_not_to_be_sure(monkeypatch: pytest.MonkeyPatch):
    """Neither is a lag of the sensor added to the friction, nor is the verdict a confident one."""
    monkeypatch.setattr(searching, "singles", lambda rig: (SLOWED, RUBBING))
    found = diagnose(recorded(believed().but(effects=FRICTION), -2), workers=1)
    assert (found.verdict, found.chosen) == ("ambiguous", ("seal_friction",))
    assert any("values of disturbance_N stand 0.2 ms before those of command_V" in said for said in found.warnings)
    (cause,) = (cause for cause in found.causes if cause.name == "seal_friction")
    assert cause.parameters["coulomb_N"].value == pytest.approx(60.0, rel=0.1)


def test_a_channel_is_put_back_where_it_belongs():
    """A sine taken 0.3 ms late, in closed form."""
    times = 5e-4 * np.arange(400)

    def wave(late_s: float) -> np.ndarray:
        return np.sin(2 * np.pi * 40 * (times - late_s)) ** 2

    record = TimeRecord(
        "r",
        times,
        np.column_stack([wave(3e-4), wave(0.0)]),
        {"displacement_m": wave(3e-4)},
        0.0,
        0.0,
        believed().controller,
    )
    back = in_time(record, {"disturbance_N": 3e-4, "displacement_m": 3e-4})
    inside = slice(5, -5)
    for found in (back.inputs[inside, 0], back.inputs[inside, 1], back.measured["displacement_m"][inside]):
        np.testing.assert_allclose(found, wave(0.0)[inside], atol=1e-3)
