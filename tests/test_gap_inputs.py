"""Recorded inputs without the noise of their instruments."""

from dataclasses import replace

import gap_sets
import numpy as np
import pytest
from scipy.signal import firwin, lfilter

from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.data.input_noise import band_levels, denoised, is_answered, noise_lines
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.scenario import FromCsv, Measurement

NOISE = 0.5
LEVELS = (0.0, 400.0, 900.0, 30.0, 0.0, -400.0, 2.0, 0.0)


def noisy(signal: np.ndarray) -> np.ndarray:
    return signal + NOISE * np.random.default_rng(5).standard_normal(len(signal))


def without_noise(signal: np.ndarray) -> np.ndarray:
    return denoised(signal)[0]


def test_noise_of_a_force_sensor_is_no_force():
    random = np.random.default_rng(5)
    assert not without_noise(random.standard_normal(8000)).any()
    times = np.arange(8000) * 5e-4
    force = 50 * np.sin(2 * np.pi * 20 * times) * np.sin(np.pi * times / times[-1]) ** 2
    found = without_noise(force + 0.5 * random.standard_normal(8000))
    assert np.std(found - force) < 0.25 * 0.5  # what is left of the noise is about the line
    np.testing.assert_array_equal(without_noise(np.zeros(100)), 0.0)


@pytest.mark.parametrize("rise", [1, 12])
def test_between_steps_a_held_force_is_still(rise):
    """Averaging n samples leaves 1/n of the noise's power; stretches of a thousand leave far less than a tenth."""
    steps = np.convolve(np.repeat(LEVELS, 1000), np.full(rise, 1 / rise))[: 1000 * len(LEVELS)]
    found = without_noise(noisy(steps))
    held = (np.arange(len(steps)) % 1000 > 60) & (np.arange(len(steps)) % 1000 < 940)
    assert np.std((found - steps)[held]) < 0.15 * NOISE
    assert np.std(np.diff(found)[held[1:]]) < 0.05 * NOISE  # still, and not only near
    # Steps of many times the noise stay as sharp as they are: raw samples at worst, where they change.
    assert np.abs(found - steps).max() < 5 * NOISE


def test_steps_without_noise_stay_nearly_as_they_are():
    """Rounded within 12 samples, so that no sharp edge looks like noise at the top of the spectrum."""
    steps = np.convolve(np.repeat(LEVELS, 1000), np.hanning(14) / 6.5)[:8000]
    np.testing.assert_allclose(without_noise(steps), steps, atol=0.05)


def test_many_lines_are_not_taken_for_held_stretches():
    """A drive of many lines fills its band, so that what a spectrum can tell apart is all there is to gain."""
    times, random = np.arange(8000) * 5e-4, np.random.default_rng(3)
    lines = np.arange(3.0, 200.0, 1.7)
    wave = np.sum(np.sin(2 * np.pi * np.outer(times, lines) + random.uniform(0, 2 * np.pi, len(lines))), axis=1)
    for size in (1.0, 30.0):  # twice the noise, and far beyond it
        drive = size * wave / np.std(wave)
        assert np.std(without_noise(noisy(drive)) - drive) < 0.75 * NOISE


def pulse(length: int) -> np.ndarray:
    """A hammer's half sine."""
    signal = np.zeros(4000)
    signal[400 : 400 + length] = 500 * np.sin(np.pi * np.arange(1, length + 1) / (length + 1))
    return signal


def switched(held: int) -> np.ndarray:
    """A random binary sequence, each value held for some samples."""
    return 500.0 * np.sign(np.repeat(np.random.default_rng(1).standard_normal(4000 // held), held))


HELD = {"hammer": pulse(5), "soft hammer": pulse(20), "binary": switched(2), "slow binary": switched(8)}
WHITE = {"sample": pulse(1), "binary": switched(1), "noise": 300 * np.random.default_rng(2).standard_normal(4000)}


@pytest.mark.parametrize("force", HELD.values(), ids=HELD)
def test_what_a_generator_holds_exactly_has_no_noise(force):
    np.testing.assert_array_equal(without_noise(force), force)


@pytest.mark.parametrize("force", WHITE.values(), ids=WHITE)
def test_white_noise_that_moves_a_rig_is_a_force(force):
    """A single sample and a binary sequence have a white spectrum as well."""
    random = np.random.default_rng(3)
    resonance, noise = lambda given: lfilter([1e-7], [1, -1.9, 0.95], given), 1e-7 * random.standard_normal(4000)
    assert is_answered(force, resonance(force) + noise)
    assert is_answered(force, np.roll(resonance(force), 9) + noise)
    for other in (noise, resonance(noise * 1e9), resonance(100 * random.standard_normal(4000))):
        assert not is_answered(force, other)
    taken = TimeRecord(
        "", np.arange(4000.0), np.stack([force, 0 * force], 1), {"displacement_m": resonance(force)}, 0, 0, None
    )
    np.testing.assert_array_equal(taken.cleaned.inputs[:, 0], force)
    np.testing.assert_array_equal(replace(taken, measured={}).cleaned.inputs[:, 0], force)
    driven = replace(taken, measured={}, inputs=np.stack([force, noise], 1))
    assert driven.excitation == "command"
    assert taken.excitation == "disturbance"


@pytest.mark.parametrize("beside", [40.0 * np.ones(4000), 20 * np.sin(0.3 * np.arange(4000))], ids=["offset", "hum"])
def test_a_white_force_stays_one_beside_what_stands_out(beside):
    """Also where a spoilt sample would drown the correlation, in a span that does not count."""
    force = WHITE["noise"] + beside
    moved = lfilter([1e-7], [1, -1.9, 0.95], WHITE["noise"])
    taken = TimeRecord("", np.arange(4000.0), np.stack([force, 0 * force], 1), {"displacement_m": moved}, 0, 0, None)
    np.testing.assert_array_equal(taken.cleaned.inputs[:, 0], force)
    spoilt = np.where(np.abs(np.arange(4000) - 700) < 20, 1.0, moved)
    left_out = replace(taken, measured={"displacement_m": spoilt}, left_out=((675.0, 725.0),))
    np.testing.assert_array_equal(left_out.cleaned.inputs[:, 0], force)


def test_a_noisy_force_after_zeros_or_in_pairs_is_not_held_exactly():
    random, drive = np.random.default_rng(1), 20 * np.sin(0.05 * np.arange(4000))
    still, noise = np.arange(4000) < 1600, 2 * random.standard_normal(4000)
    padded, off = np.where(still, 0.0, drive + noise), np.where(still, 0.0, noise)
    assert np.std(without_noise(padded) - padded + off) < 0.85 * np.std(off)
    pairs = np.repeat((drive + 3 * random.standard_normal(4000))[::2], 2)
    assert not np.array_equal(without_noise(pairs), pairs)


def test_steps_in_coarse_digits_are_rid_of_their_flicker():
    drive = 100 * np.sin(0.01 * np.arange(4000))
    digits = 5 * np.round((drive + 1.5 * np.random.default_rng(1).standard_normal(4000)) / 5)
    assert np.std(without_noise(digits) - drive) < 0.4 * np.std(digits - drive)


@pytest.mark.parametrize("size", [1.0, 10.0])
@pytest.mark.parametrize("name", ["disturbance_small", "load_steps"])
def test_what_noise_leaves_in_a_force_is_known(name, size):
    (row,) = gap_sets.only(gap_sets.measured(gap_sets.believed()), [name]).records
    force, random = row.cleaned.inputs[:, 0], np.random.default_rng(7)
    off, told = [], []
    for _ in range(10):
        found, left = denoised(force + size * random.standard_normal(len(force)))
        off.append(np.mean((found - force) ** 2))
        told.append(np.mean(left))
    assert 0.4 < np.mean(told) / np.mean(off) < 1.3  # steps are a little flatter where noise was taken out before


@pytest.mark.parametrize("noise_N", [0.0, 10.0])
def test_noise_of_a_load_cell_is_noise_of_the_evidence(noise_N):
    """At the figures of the rig the misfit is that of noise, whatever the load cell adds."""
    plan = gap_sets.scenario().but(
        measurement=Measurement(seed=3, disturbance_std_N=noise_N, current_std_A=2e-5, displacement_std_m=5e-7)
    )
    data = gap_sets.measured(gap_sets.believed(), plan)
    for piece in record_evidence(data):
        placement = NOTHING.placement(data.prototype)
        at_truth = piece.residual(placement, np.zeros(len(placement.unknowns)))
        assert 0.6 < at_truth @ at_truth / piece.expected < 1.6


@pytest.mark.parametrize("edge", [0.75, 0.8, 0.9])
def test_noise_that_a_recorder_has_low_passed_is_read_below_its_edge(edge):
    """A converter that decimates leaves nothing at the top of the spectrum, and as much noise as ever below."""

    def low_passed(signal: np.ndarray) -> np.ndarray:
        return np.convolve(np.pad(signal, 50, mode="edge"), firwin(101, edge), "valid")

    def recorded(record: TimeRecord) -> TimeRecord:
        inputs = np.column_stack([low_passed(record.inputs[:, 0]), record.inputs[:, 1]])
        return replace(record, inputs=inputs, measured={name: low_passed(y) for name, y in record.measured.items()})

    data = gap_sets.measured(gap_sets.believed())
    data = replace(data, records=tuple(recorded(record) for record in data.records))
    assert not examine(data).words
    for piece in record_evidence(data):
        stds = dict(zip(piece.weight.channels, piece.weight.noise_std, strict=True))
        assert stds == {"current_A": pytest.approx(2e-5, rel=0.2), "displacement_m": pytest.approx(5e-7, rel=0.2)}
        placement = NOTHING.placement(data.prototype)
        at_truth = piece.residual(placement, np.zeros(len(placement.unknowns)))
        assert 0.6 < at_truth @ at_truth / piece.expected < 1.6


def test_what_is_driven_up_to_an_edge_is_no_noise():
    """A drive that is as level as noise, up to where it ends, is told from it by the model that makes it."""
    power = np.where(np.arange(1000) < 800, 1.0, 1e-4)
    assert noise_lines(power, band_levels(power)) == slice(650, 800)
    assert noise_lines(power, band_levels(power, 0.9 * power)) == slice(800, 1000)
    for steep in range(1, 13):  # a motion without any noise
        falling = np.arange(1.0, 1001.0) ** -steep
        assert noise_lines(falling, band_levels(falling)) == slice(800, 1000)


@pytest.mark.parametrize("force", WHITE.values(), ids=WHITE)
def test_a_rig_that_a_hammer_or_white_noise_drives_is_followed(force, tmp_path):
    plan = gap_sets.scenario()
    np.savetxt(
        tmp_path / "force.csv",
        np.stack([5e-4 * np.arange(2001), force[:2001]], 1),
        "%.9g",
        ",",
        header="t_s,disturbance_N",
        comments="",
    )
    row = plan.record[2].but(input=(FromCsv(file=str(tmp_path / "force.csv")),))
    data = gap_sets.measured(gap_sets.believed(), plan.but(record=(row,)))
    (piece,) = record_evidence(data)
    placement = NOTHING.placement(data.prototype)
    at_truth = piece.residual(placement, np.zeros(len(placement.unknowns)))
    assert at_truth @ at_truth < 1.6 * piece.expected
    assert np.sqrt(piece.error(at_truth)) < 0.05
