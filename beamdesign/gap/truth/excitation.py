"""What drives the rig: band-limited many-line signals and load steps, and the noise of its sensors."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beamdesign.gap.truth.rig import SAMPLE_S, STEP_S

FADE_S = 0.1


@dataclass(frozen=True)
class Drive:
    """One input signal.

    Attributes:
        channel: what it drives.
        shape: many lines of random phase, or steps of load.
        size: RMS of the lines, or the largest step; N or V.
        highest_Hz: of the lines.
        seed: of phases, or of times and heights.
    """

    channel: Literal["disturbance_N", "command_V"]
    shape: Literal["lines", "steps"]
    size: float
    highest_Hz: float
    seed: int


def signal(drive: Drive, times: np.ndarray) -> np.ndarray:
    """(N,) the drive at the given times, s; it starts from nothing."""
    rng = np.random.default_rng(drive.seed)
    return _lines(drive, times, rng) if drive.shape == "lines" else _steps(drive, times, rng)


def _lines(drive: Drive, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lines of equal height at logarithmic spacing from 1 Hz, on a grid of a quarter hertz."""
    frequencies = np.unique(np.round(np.geomspace(1.0, drive.highest_Hz, 60) * 4)) / 4
    phases = rng.uniform(0, 2 * np.pi, len(frequencies))
    # A line at k/4 Hz repeats after 4 s: one inverse transform of that period holds them all.
    dt = times[1] - times[0]
    period = round(4.0 / dt)
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[np.round(frequencies * 4).astype(int)] = np.exp(1j * phases)
    wave = np.fft.irfft(spectrum, period)
    wave *= drive.size / np.sqrt(np.mean(wave**2))
    rise = np.clip(times / FADE_S, 0, 1)
    return wave[np.arange(len(times)) % period] * (0.5 - 0.5 * np.cos(np.pi * rise))


def _steps(drive: Drive, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rounded steps of load, up and down, the last one taking it off."""
    whole = times[-1]
    count = max(3, round(whole / 0.6))
    at = (np.arange(count) + rng.uniform(0.25, 0.75, count)) * whole / count
    levels = drive.size * rng.uniform(-1, 1, count)
    levels[rng.integers(0, count - 1)] = drive.size * rng.choice([-1, 1])
    levels[-1] = 0.0
    wave, before = np.zeros_like(times), 0.0
    for moment, level in zip(at, levels, strict=True):
        wave += (level - before) * (0.5 - 0.5 * np.cos(np.pi * np.clip((times - moment) / 0.03, 0, 1)))
        before = level
    return wave


def fine_times(duration_s: float, step_s: float = STEP_S) -> np.ndarray:
    """Every half step of a record whose last sample lies one interval before its end."""
    steps = round((duration_s - SAMPLE_S) / step_s)
    return np.arange(2 * steps + 1) * (step_s / 2)


def held_noise(rng: np.random.Generator, std: float, samples: int, per_sample: int) -> np.ndarray:
    """White noise at the samples, joined by straight lines: ((samples - 1) per_sample + 1,)."""
    coarse = rng.normal(0, std, samples)
    fine = np.arange((samples - 1) * per_sample + 1) / per_sample
    return np.interp(fine, np.arange(samples), coarse)
