"""Recorded inputs without the noise of their instruments."""

import numpy as np
import pytest

from beamdesign.diagnosis.data.input_noise import without_noise

NOISE = 0.5
LEVELS = (0.0, 400.0, 900.0, 30.0, 0.0, -400.0, 2.0, 0.0)


def noisy(signal: np.ndarray) -> np.ndarray:
    return signal + NOISE * np.random.default_rng(5).standard_normal(len(signal))


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
