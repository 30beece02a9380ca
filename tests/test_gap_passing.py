"""A short while in which a rig does what it does nowhere else, and records that leave it out."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_sets import believed, measured, scenario
from recorded_rig import recorded

from beamdesign import InputError, Prototype, diagnose, read_dataset
from beamdesign.diagnosis import learning
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, learnable
from beamdesign.diagnosis.fitting.search import Search, search
from beamdesign.diagnosis.judgement import judge
from beamdesign.diagnosis.passing import Look, joined, passing, what_passed, without_one
from beamdesign.scenario import Step

SLOWED, WIDER = Hypothesis(("sensor_lag",)), Hypothesis(("parameter:flow_gain",))
SLOW_RIG = believed().but(effects={"sensor_lag": {"break_Hz": 120.0}})
DRIFT = ("empirical_sensor_drift",)
KNOCK_s, LASTS_s = 0.5, 0.01


THREE = ("command_large", "disturbance_small", "disturbance_large")


def knocked(
    rig: Prototype, newtons: float = 1200.0, lasts_s: float = LASTS_s, names: Sequence[str] = THREE, long_s: float = 1.0
) -> Dataset:
    """Records of a rig; half way through one somebody pushes the tip for 10 ms, which no force sensor records."""
    plan = scenario(long_s)
    rows = [row for row in plan.record if row.name in names]
    blow = Step(amplitude_N=newtons, at_s=KNOCK_s * long_s, length_s=lasts_s)
    hit = [row.but(input=(*row.input, blow)) if row.name == "disturbance_small" else row for row in rows]
    data = measured(rig, plan.but(record=tuple(hit)))
    quiet = measured(rig, plan.but(record=tuple(rows)))
    pairs = zip(data.records, quiet.records, strict=True)
    return replace(data, records=tuple(replace(record, inputs=told.inputs) for record, told in pairs))


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch, single_causes: None) -> None:
    """Two causes in place of the whole library, and no look at what is none here at its full cost."""
    monkeypatch.setattr(searching, "singles", lambda rig: (SLOWED, WIDER))
    for finds_nothing in ("channels_in_time", "second_look", "next_experiment"):
        monkeypatch.setattr(sys.modules[diagnose.__module__], finds_nothing, lambda *given: None)


@pytest.fixture(scope="module")
def slow_and_knocked() -> Dataset:
    return knocked(SLOW_RIG)


def test_a_knock_that_nobody_recorded_does_not_hide_the_cause(few: None, slow_and_knocked: Dataset) -> None:
    """The lag is found as if there had been no knock; the verdict is no confident one and says what was left out."""
    found = diagnose(slow_and_knocked, workers=1)
    assert (found.verdict, found.chosen) == ("ambiguous", ("sensor_lag",))
    (lag,) = (cause for cause in found.causes if cause.name == "sensor_lag")
    assert lag.parameters["break_Hz"].value == pytest.approx(120.0, rel=0.03)
    assert found.gap.closed > 0.95
    (said,) = (words for words in found.warnings if "left out" in words)
    begin, end = (float(word) for word in said.split(" s fits")[0].split("from ")[1].split(" to "))
    assert begin < KNOCK_s < KNOCK_s + LASTS_s < end < KNOCK_s + 0.25


def looked_at(data: Dataset, found: Search) -> Look:
    return Look(data, found, judge(found))


def test_a_wrong_cause_that_spreads_the_knock_over_all_records_does_not_hide_it(
    few: None, slow_and_knocked: Dataset
) -> None:
    """It may leave less in all than the right one, whose knock alone is not explained."""
    found = search(slow_and_knocked, 1)
    right, wrong = (next(fit for fit in found.fits if fit.hypothesis == each) for each in (SLOWED, WIDER))
    spread = replace(wrong, shares=tuple(replace(share, c=0.3 * right.misfit) for share in wrong.shares))
    again = what_passed(looked_at(slow_and_knocked, replace(found, fits=(spread, right))))
    assert spread.misfit < right.misfit
    assert again is not None
    assert again.judged.best.hypothesis == SLOWED


def test_a_span_that_was_stated_is_not_told_as_found(few: None, slow_and_knocked: Dataset) -> None:
    """Nor counted against what may pass: half a record may be said not to count."""
    records = [
        record if record.name == "disturbance_small" else replace(record, left_out=((0.5, 0.9),))
        for record in slow_and_knocked.records
    ]
    data = replace(slow_and_knocked, records=tuple(records))
    found = what_passed(looked_at(data, search(data, 1)))
    assert found is not None
    assert [words.partition(":")[0] for words in found.words] == ["disturbance_small"]


def test_what_is_all_over_a_record_is_not_left_out(few: None) -> None:
    """A dead band departs wherever the current is small: nothing that passes."""
    data = measured(believed().but(effects={"valve_deadband": {"half_width_A": 1e-3}}), scenario(0.7))
    data = replace(data, records=data.records[:3])
    found = search(data, 1)
    assert judge(found).unknown > 0.5
    assert what_passed(looked_at(data, found)) is None


def test_without_a_cause_for_the_rest_nothing_is_left_out(few: None) -> None:
    """Of a sound rig that was knocked a search without the knock names no cause, and the knock stays in."""
    data = knocked(believed())
    found = search(data, 1)
    best = min((found.null, *found.fits), key=lambda fit: fit.misfit)
    spans = [passing(piece, best, 0.05 * best.misfit) for piece in record_evidence(data)]
    assert [bool(own) for own in spans] == [False, True, False]
    assert what_passed(looked_at(data, found)) is None


def leant_on(rig: Prototype) -> Dataset:
    """Four records of a rig; in one somebody leans on the tip for 0.28 s, which no force sensor records."""
    return knocked(rig, 250.0, 0.28, (*THREE, "command_small"), 0.7)


def test_a_record_that_contradicts_all_others_is_left_out(few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lag is found in the others as if there had been no such record."""
    monkeypatch.setattr(learning, "learnable", lambda rig: [h for h in learnable(rig) if h.names == DRIFT])
    found = diagnose(leant_on(SLOW_RIG), workers=1)
    assert (found.verdict, found.chosen) == ("ambiguous", ("sensor_lag",))
    assert found.gap.after < 1.2 * found.gap.noise_floor
    assert found.warnings[0].startswith("disturbance_small: nothing explains it")  # before what is harmless
    assert {record.record for record in found.gap.records} == {"command_small", "command_large", "disturbance_large"}


def test_a_record_is_not_left_out_that_what_explains_the_others_explains(few: None) -> None:
    """Fits to all records may end in another valley: of a valve that was a wrong figure's cause they did."""
    data = measured(SLOW_RIG, scenario(0.7))
    data = replace(data, records=data.records[:4])
    null = search(data, 1).null
    astray = Fit(SLOWED, null.unknowns, null.z, 2 * null.cost, tuple(replace(s, c=2 * s.c) for s in null.shares))
    look = looked_at(data, Search(null, (astray,), sum(e.expected for e in record_evidence(data))))
    assert look.judged.unknown > 0.5
    found = without_one(look)
    assert found is not None
    assert [record.name for record in found.data.records] == [record.name for record in data.records]
    assert (found.words, found.doubtful) == ((), False)
    assert found.judged.best.hypothesis == SLOWED
    assert found.judged.best.values["sensor_lag.break_Hz"] == pytest.approx(120.0, rel=0.05)


def test_of_a_sound_rig_the_others_are_said_to_need_no_cause(few: None) -> None:
    data = leant_on(believed())
    found = without_one(looked_at(data, search(data, 1)))
    assert found is not None
    assert found.judged.best.hypothesis == NOTHING
    assert found.doubtful
    assert without_one(looked_at(replace(data, records=data.records[:3]), found.search)) is None


def test_spans_weigh_nothing_and_noise_leaves_what_is_expected() -> None:
    """Whatever is added within a span changes no misfit; outside of it noise leaves its own, span or not."""
    data = measured(believed())
    record = data.records[1]
    times, spans = record.times, ((0.2, 0.3), (0.6, 0.65))
    cut = replace(record, left_out=spans)
    assert np.array_equal(cut.counted == 0, np.any([(times >= a) & (times <= b) for a, b in spans], axis=0))
    assert 1 - np.mean(cut.counted**2) == pytest.approx(0.15 + 4 * 5e-3 * 5 / 8, abs=5e-3)  # mean of cos^4 is 3/8
    spoilt = {name: np.where(cut.counted == 0, 1.0, signal) for name, signal in record.measured.items()}
    placement = NOTHING.placement(data.prototype)
    z = np.zeros(len(placement.unknowns))
    whole, without, other = (
        record_evidence(replace(data, records=(one,)))[0] for one in (record, cut, replace(cut, measured=spoilt))
    )
    left = without.residual(placement, z)
    assert np.array_equal(left, other.residual(placement, z))
    assert without.weight.noise_std == pytest.approx(whole.weight.noise_std, rel=0.1)
    assert left @ left == pytest.approx(without.expected, rel=0.25)


def test_spans_are_joined_where_they_meet() -> None:
    assert joined([(0.5, 0.6), (0.1, 0.2), (0.15, 0.3), (0.6, 0.7)]) == ((0.1, 0.3), (0.5, 0.7))


def test_a_data_set_states_spans_that_are_not_to_count(paper: Prototype, tmp_path: Path) -> None:
    sound = recorded(paper)
    sound.entry("steps")["left_out_s"] = [[0.1, 0.2]]
    (steps,) = (record for record in read_dataset(sound.write(tmp_path)).records if record.name == "steps")
    assert steps.left_out == ((0.1, 0.2),)
    for wrong in ([0.2, 0.1], [0.1, 1e3], [-1.0, 0.1]):
        sound.entry("steps")["left_out_s"] = [wrong]
        with pytest.raises(InputError, match=r"left_out_s: of .*steps.csv: .* is no span within its 0 to"):
            read_dataset(sound.write(tmp_path))


def test_what_is_spoilt_within_a_span_that_is_not_to_count_spoils_nothing(paper: Prototype, tmp_path: Path) -> None:
    """For a sample of 2 m the record is left out, unless that is said not to count."""
    sound = recorded(paper)
    moved, at = sound.columns["steps"]["displacement_m"].copy(), float(sound.columns["steps"]["t_s"][300])
    moved[300] += 2.0
    sound.columns["steps"]["displacement_m"] = moved
    lost = examine(read_dataset(sound.write(tmp_path)))
    assert "steps" not in {record.name for record in lost.data.records}
    sound.entry("steps")["left_out_s"] = [[at - 0.01, at + 0.01]]
    kept = examine(read_dataset(sound.write(tmp_path)))
    assert "steps" in {record.name for record in kept.data.records}
    assert not kept.limits_confidence, kept.words


def test_many_spoilt_samples_within_a_span_that_is_not_to_count_limit_no_verdict(
    paper: Prototype, tmp_path: Path
) -> None:
    """They are bridged wherever they are; of more than a hundredth of the samples that count it is told."""
    sound = recorded(paper)
    moved, times = sound.columns["force"]["displacement_m"].copy(), sound.columns["force"]["t_s"]
    sound_motion = moved.copy()
    moved[300:420:8] += 1e-3
    sound.columns["force"]["displacement_m"] = moved
    assert examine(read_dataset(sound.write(tmp_path))).limits_confidence
    sound.entry("force")["left_out_s"] = [[float(times[295]), float(times[425])]]
    kept = examine(read_dataset(sound.write(tmp_path)))
    assert not kept.limits_confidence, kept.words
    (force,) = (record for record in kept.data.records if record.name == "force")
    assert force.measured["displacement_m"] == pytest.approx(sound_motion, abs=1e-4)
