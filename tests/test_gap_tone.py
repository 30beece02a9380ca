"""A tone that records have in common, told from what their drive makes."""

import numpy as np
import pytest

from beamdesign.diagnosis.diagnosis import Errors
from beamdesign.diagnosis.where.tone import common_tone

TIMES = np.arange(4000) / 1000.0
SWINGS = (2e-5, 1e-4, 2e-4, 8e-4, 5e-5)


def left(of: list[np.ndarray]) -> list[Errors]:
    """Records of several sizes, and what a model leaves of them, m."""
    found, random = [], np.random.default_rng(4)
    for k, (rms, error) in enumerate(zip(SWINGS, of, strict=True)):
        measured = rms * random.standard_normal(len(TIMES))
        share = (error + 5e-7 * random.standard_normal(len(TIMES))) / np.std(measured)
        found.append(Errors(f"r{k}", TIMES, measured, share, share, share, share, 5e-7 / rms))
    return found


def tones(frequency_Hz: float, *sizes_m: float) -> list[np.ndarray]:
    return [size * np.sin(2 * np.pi * frequency_Hz * TIMES + 1.3 * k) for k, size in enumerate(sizes_m)]


def test_hum_is_told_with_its_frequency_and_amplitude():
    """Of a sine under Hann's window: Rife and Vincent, Bell Syst. Tech. J. 49 (1970) 197."""
    found = common_tone(left(tones(50.06, *(2e-6,) * 5)))
    assert found is not None
    assert (found.count, found.of) == (5, 5)
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
    slow = Errors("slow", TIMES[::10], *(part[::10] for part in (of[0].measured, *(of[0].after,) * 4)), 0.02)
    short = Errors("short", TIMES[:100], *(part[:100] for part in (of[1].measured, *(of[1].after,) * 4)), 0.02)
    found = common_tone([slow, short, *of[2:]])
    assert found is not None
    assert (found.count, found.of) == (3, 5)
    last = common_tone(left(tones(499.9, *(2e-6,) * 5)))  # at half the rate of sampling no tone can be told
    assert last is None


def test_few_records_or_records_driven_alike_cannot_tell():
    hummed = left(tones(50.0, *(2e-6,) * 5))
    assert common_tone(hummed[:2]) is None
    assert common_tone([hummed[0], hummed[4], hummed[0]]) is None
