"""A tone that records have in common, told from what their drive makes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gap_sets import believed, measured

from beamdesign.diagnosis import tone
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, together
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT
from beamdesign.diagnosis.fitting.search import Search, search
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.tone import Left, common_tone, search_without_tones, without_tones

TIMES = np.arange(4000) / 1000.0
SWINGS = (2e-5, 1e-4, 2e-4, 8e-4, 5e-5)


def left(of: list[np.ndarray]) -> list[Left]:
    """What a model leaves of records of several sizes, m."""
    random = np.random.default_rng(4)
    noise = 5e-7 * random.standard_normal((len(of), len(TIMES)))
    return [Left(f"r{k}", TIMES, SWINGS[k], error + noise[k]) for k, error in enumerate(of)]


def tones(frequency_Hz: float, *sizes_m: float) -> list[np.ndarray]:
    return [size * np.sin(2 * np.pi * frequency_Hz * TIMES + 1.3 * k) for k, size in enumerate(sizes_m)]


def test_hum_is_told_with_its_frequency_and_amplitude():
    """Of a sine under Hann's window: Rife and Vincent, Bell Syst. Tech. J. 49 (1970) 197."""
    found = common_tone(left(tones(50.06, *(2e-6,) * 5)))
    assert found is not None
    assert (len(found.having), found.of) == (5, 5)
    assert found.frequency_Hz == pytest.approx(50.06, abs=0.01)
    assert found.amplitude_m == pytest.approx((2e-6, 2e-6), rel=0.2)
    assert "at 50.06 Hz" in found.sentence
    assert "hum of the mains, or something that runs" in found.sentence
    pump = common_tone(left(tones(37.0, *(2e-6,) * 5)))
    assert pump is not None
    assert "mains" not in pump.sentence


@pytest.mark.parametrize(
    "of",
    [
        [np.zeros(len(TIMES))] * 5,
        tones(50.0, *(0.05 * rms for rms in SWINGS)),  # grows with the drive: of the rig
        [sum(tones(f, *(2e-6,) * 5)[k] for f in np.arange(40.0, 64.0, 3.0)) for k in range(5)],  # what drives it
        tones(50.0, 2e-6, 2e-6, 0.0, 0.0, 0.0),  # in two records of five
    ],
    ids=["noise", "grows", "comb", "few"],
)
def test_what_is_no_tone_in_common_is_not_told(of):
    assert common_tone(left(of)) is None


def test_records_that_are_too_slow_or_too_short_for_a_tone_do_not_have_it():
    """Sampled at 100 Hz, or for a tenth of a second, beside three that show 180 Hz."""
    of = left(tones(180.0, *(2e-6,) * 5))
    slow = Left("slow", TIMES[::10], of[0].rms, of[0].error[::10])
    short = Left("short", TIMES[:100], of[1].rms, of[1].error[:100])
    found = common_tone([slow, short, *of[2:]])
    assert found is not None
    assert (found.having, found.of) == (("r2", "r3", "r4"), 5)
    last = common_tone(left(tones(499.9, *(2e-6,) * 5)))  # at half the rate of sampling no tone can be told
    assert last is None


def test_few_records_or_records_driven_alike_cannot_tell():
    hummed = left(tones(50.0, *(2e-6,) * 5))
    assert common_tone(hummed[:2]) is None
    assert common_tone([hummed[0], hummed[4], hummed[0]]) is None


HUM_Hz, HUM_m = 50.02, 3e-6


@pytest.fixture(scope="module")
def slow() -> Dataset:
    return measured(believed().but(effects={"sensor_lag": {"break_Hz": 120.0}}))


@pytest.fixture(scope="module")
def quiet(slow: Dataset) -> Look:
    """Found of the records without hum, among what is there alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searching, "singles", lambda rig: (Hypothesis(("sensor_lag",)),))
        return search_without_tones(slow)


def hummed(data: Dataset, **sizes: float) -> Dataset:
    """Records with hum of any phase in some of their channels."""
    records = []
    for k, record in enumerate(data.records):
        hum = np.sin(2 * np.pi * HUM_Hz * record.times + 1.3 * k)
        measured = {name: values + sizes.get(name, 0.0) * hum for name, values in record.measured.items()}
        records.append(replace(record, measured=measured))
    return replace(data, records=tuple(records))


@pytest.mark.parametrize(("current_A", "doubtful"), [(0.0, False), (1e-3, True)], ids=["recorder", "loop"])
def test_hum_is_taken_off_and_the_cause_is_that_without_it(
    current_A: float, doubtful: bool, slow: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To a tenth of it, off the displacement and off the current that hears it, which leaves a doubt.

    In the record of large steps it may not show beside what the model lacks, and then stays."""
    monkeypatch.setattr(searching, "singles", lambda rig: (Hypothesis(("sensor_lag",)),))
    data = hummed(slow, displacement_m=HUM_m, current_A=current_A)
    found = search_without_tones(data)
    assert found.doubtful == doubtful
    (words,) = found.words
    assert "at 50.0" in words
    assert ("the loop hears it" in words) == doubtful
    off = [
        {name: np.std(record.measured[name] - quiet.measured[name]) for name in record.measured}
        for record, quiet in zip(found.data.records, slow.records, strict=True)
    ]
    cleared = [each for each in off if each["displacement_m"] < 0.1 * HUM_m and each["current_A"] < 1e-4]
    left = [each for each in off if each["displacement_m"] == pytest.approx(HUM_m / 2**0.5, rel=0.01)]
    assert len(cleared) >= 5
    assert len(cleared) + len(left) == len(off)
    assert found.judged.best.hypothesis.names == ("sensor_lag",)
    assert found.judged.best.values["sensor_lag.break_Hz"] == pytest.approx(120.0, rel=0.03)


def test_of_a_sound_rig_whose_recorder_hums_there_is_no_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tone shows in what tolerances alone leave, so that one search, without it, is all."""
    monkeypatch.setattr(searching, "singles", lambda rig: tuple(map(together, ("sensor_lag", "seal_friction"))))
    searched: list[Dataset] = []
    monkeypatch.setattr(tone, "search", lambda data, *given, **more: searched.append(data) or search(data))
    found = search_without_tones(hummed(measured(believed()), displacement_m=HUM_m))
    assert searched == [found.data]
    assert found.judged.best.hypothesis == NOTHING
    assert found.judged.of_causes[()] > 0.9
    assert found.search.null.misfit < 1.3 * found.search.expected


@pytest.mark.parametrize("explained", [True, False])
def test_a_tone_that_the_loop_hears_is_taken_off_where_no_cause_explains_it(
    explained: bool, slow: Dataset, quiet: Look, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A resonance next to unstable is as narrow: of a dead band it was called hum, and the set unknown."""
    without = replace(slow, records=slow.records[:-1])
    searched: list[Dataset] = []

    def cleared(data: Dataset, best: Fit) -> tuple[Dataset, tuple[str, ...], bool]:
        tone_left = best.hypothesis == NOTHING or not explained
        return (without, ("hum",), True) if tone_left else (data, (), False)

    def search_kept(data: Dataset, *given: object, **more: object) -> Search:
        searched.append(data)
        return quiet.search

    monkeypatch.setattr(tone, "without_tones", cleared)
    monkeypatch.setattr(tone, "search", search_kept)
    found = search_without_tones(slow)
    assert searched == ([slow] if explained else [slow, without])
    assert (found.words, found.doubtful) == (((), False) if explained else (("hum",), True))
    assert found.judged.best.hypothesis.names == ("sensor_lag",)


def test_records_without_a_tone_are_left_as_they_are(slow: Dataset, quiet: Look) -> None:
    assert quiet.data is slow
    assert (quiet.words, quiet.doubtful) == ((), False)


def test_a_motion_whose_frequency_wanders_is_no_hum(slow: Dataset, quiet: Look) -> None:
    """As that of a loop that oscillates in its play: beside the sine that fits it best there is another."""
    best = quiet.search.fits[0]
    swinging = []
    for k, record in enumerate(slow.records):
        phase = 2 * np.pi * HUM_Hz * record.times + 1.2 * np.sin(2 * np.pi * record.times / np.ptp(record.times) + k)
        moved = record.measured["displacement_m"] + HUM_m * np.sin(phase)
        swinging.append(replace(record, measured=record.measured | {"displacement_m": moved}))
    wandering = replace(slow, records=tuple(swinging))
    pieces = record_evidence(wandering)
    placement = best.hypothesis.placement(slow.prototype)
    left = [
        Left(piece.name, piece.record.times, float(np.std(seen)), seen - piece.predicted(placement, best.z)[:, at])
        for piece in pieces
        for at in (piece.weight.channels.index(DISPLACEMENT),)
        for seen in (piece.measured[:, at],)
    ]
    assert common_tone(left)
    assert without_tones(wandering, best) == (wandering, (), False)
    assert without_tones(hummed(slow, displacement_m=HUM_m), best)[1]


def test_a_tone_that_a_model_makes_is_none_of_the_records(
    slow: Dataset, quiet: Look, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stands out of what is left as one of the records does, and would be written into them."""
    best, predicted = quiet.search.fits[0], RecordEvidence.predicted

    def humming(piece: RecordEvidence, *given: Any) -> np.ndarray:
        found = predicted(piece, *given).copy()
        found[:, piece.column] += HUM_m * np.sin(2 * np.pi * HUM_Hz * piece.record.times)
        return found

    monkeypatch.setattr(RecordEvidence, "predicted", humming)
    assert without_tones(slow, best) == (slow, (), False)


def test_a_tone_of_one_loop_may_be_its_own(slow: Dataset, quiet: Look, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that oscillates by itself changes its frequency with the payload; of one payload that cannot be told."""
    monkeypatch.setattr("beamdesign.diagnosis.tone._MAINS_HZ", (1e3,))
    first = slow.records[0]
    data = hummed(slow, displacement_m=HUM_m)
    best = quiet.search.fits[0]
    assert len(without_tones(data, best)[1]) == 1
    loop = {"outer_end_mass": first.outer_end_mass, "inner_end_mass": first.inner_end_mass}
    alike = [replace(record, **loop, controller=first.controller) for record in data.records]
    same = replace(data, records=tuple(alike))
    assert without_tones(same, best) == (same, (), False)
