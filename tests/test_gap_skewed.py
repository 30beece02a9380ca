"""Channels whose values stand beside their time: told from a sensor that lags, and put back.

What is right is known by construction: rigs are simulated five times as finely as they are recorded, so that a channel
may be taken a fifth of a sample beside the others without any interpolation.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_sets import believed, measured, scenario

from beamdesign import Prototype, diagnose
from beamdesign.diagnosis import diagnose as diagnosing
from beamdesign.diagnosis import misstated
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.judgement import Judgement
from beamdesign.diagnosis.misstated import channels_in_time, in_time, late_channels
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.tone import search_without_tones
from beamdesign.time_limit import TimeUp, leave_out, within

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
    at = TAKEN * np.arange(8, count)
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
    monkeypatch.setattr(diagnosing, "next_experiment", lambda *given: None)  # which has tests of its own
    found = diagnose(recorded(believed().but(effects=FRICTION), -2), workers=1)
    assert (found.verdict, found.chosen) == ("ambiguous", ("seal_friction",))
    assert any("values of disturbance_N stand 0.2 ms before those of command" in said for said in found.warnings)
    (cause,) = (cause for cause in found.causes if cause.name == "seal_friction")
    assert cause.parameters["coulomb_N"].value == pytest.approx(60.0, rel=0.1)


TIMES = 5e-4 * np.arange(400)


def wave(late_s: float) -> np.ndarray:
    return np.sin(2 * np.pi * 40 * (TIMES - late_s)) ** 2


def taken_late(late_s: float) -> TimeRecord:
    inputs = np.column_stack([wave(late_s), wave(0.0)])
    return TimeRecord("r", TIMES, inputs, {"displacement_m": wave(late_s)}, 0.0, 0.0, believed().controller)


def test_a_channel_is_put_back_where_it_belongs():
    """A sine taken 0.3 ms late, in closed form."""
    record = taken_late(3e-4)
    back = in_time(record, {"disturbance_N": 3e-4, "displacement_m": 3e-4})
    inside = slice(5, -5)
    for found in (back.inputs[inside, 0], back.inputs[inside, 1], back.measured["displacement_m"][inside]):
        np.testing.assert_allclose(found, wave(0.0)[inside], atol=1e-3)


def test_what_is_spoilt_where_a_record_does_not_count_reaches_no_sample_that_counts():
    record = replace(taken_late(3e-4), left_out=((0.08, 0.12),))
    record.measured["displacement_m"][200] = 1e4
    back = in_time(record, {"displacement_m": 3e-4}).measured["displacement_m"]
    beside = (np.abs(TIMES - 0.1) > 0.03) & (np.abs(TIMES - 0.1) < 0.095)
    np.testing.assert_allclose(back[beside], wave(0.0)[beside], atol=0.01)


def test_a_force_that_is_late_by_several_samples_is_told_with_by_how_much(slowed_only: None):
    """Figures strained to stand for it are further away than a usual fit goes."""
    found = late_channels(search_without_tones(recorded(believed(), 30)))
    assert found == {"disturbance_N": pytest.approx(30 * FINE, abs=0.1 * FINE)}


@pytest.fixture
def looked(tmp_path: Path) -> Look:
    null = Fit(NOTHING, cost=1.0)
    data = Dataset("d", tmp_path, believed(), (taken_late(0.0),))
    return Look(
        data, Search(null, (), 1.0), Judgement({NOTHING: 1.0}, 0.0, null), kept=FitCache(tmp_path, believed(), "key")
    )


def test_fits_are_kept_by_exactly_how_late_channels_were(looked: Look, monkeypatch: pytest.MonkeyPatch):
    """Both are 0.2 ms in words."""
    parts = set()

    def searched(data: Dataset, workers: int, progress: object, kept: FitCache) -> Look:
        parts.add(kept.part)
        return looked

    monkeypatch.setattr(misstated, "search_without_tones", searched)
    for late_s in (2.01e-4, 2.04e-4):
        monkeypatch.setattr(misstated, "late_channels", lambda look, by=late_s: {"disturbance_N": by})
        channels_in_time(looked)
    assert len(parts) == 2


def test_channels_are_not_moved_by_what_little_there_was_time_to_compare(looked: Look, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(misstated, "late_channels", lambda look: {"disturbance_N": 2e-4})
    with within(1.0):
        leave_out("sensor_lag")
        with pytest.raises(TimeUp):
            channels_in_time(looked)
