"""What one unit of misfit is: the noise of a channel plus a small share of what the channel does at that frequency.

A model is never exact. Weighing residuals by noise alone would let the third digit of the largest record decide
everything, and call every difference significant. So a residual counts in units of sqrt(noise + (share of the signal
about that frequency)^2), band by band, and a record as a whole counts as `INDEPENDENT` such units per channel, not as
thousands of independent samples: what a model lacks is the same from one sample to the next.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from beamdesign.diagnosis.data.dataset import TimeRecord

SHARE = 0.02
"""Relative error of a model, line by line, that counts as one unit."""
INDEPENDENT = 40.0
LOWEST_HZ, HIGHEST_HZ = 0.2, 400.0
TOP = 0.8  # of the Nyquist frequency: above it there is only noise
_FADE = 0.05  # of the record, at its end
_HALF_BAND = 2 ** (1 / 6)


@dataclass(frozen=True)
class Weighting:
    """Of one record.

    Attributes:
        channels: names, in order.
        scale: (C, F) factor from a channel's spectrum to units of misfit.
        frequencies_Hz: (F,).
        noise_std: (C,) white measurement noise of each channel, in its unit.
        noise: (C, F) power of all that counts as noise.
        fade: (N,) taper.
        kept: (N//2 + 1,) which lines count.
    """

    channels: tuple[str, ...]
    scale: np.ndarray = field(repr=False)
    frequencies_Hz: np.ndarray = field(repr=False)
    noise_std: np.ndarray
    noise: np.ndarray = field(repr=False)
    fade: np.ndarray = field(repr=False)
    kept: np.ndarray = field(repr=False)

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves behind."""
        return float(np.sum(self.scale**2 * self.noise))

    def __call__(self, signals: np.ndarray) -> np.ndarray:
        """Residuals (N, C) or (N, C, K) in units of misfit: (2 C F,) or (2 C F, K)."""
        shaped = signals.reshape(*signals.shape[:2], -1)
        lines = self.lines(shaped) * self.scale.T[:, :, None]
        flat = np.concatenate([lines.real, lines.imag]).reshape(-1, shaped.shape[2])
        return flat[:, 0] if signals.ndim == 2 else flat

    def lines(self, signals: np.ndarray) -> np.ndarray:
        """(F, C, ...) spectrum of channels (N, C, ...) at the lines that count."""
        faded = signals * self.fade.reshape(-1, *(1,) * (signals.ndim - 1))
        return np.asarray(np.fft.rfft(faded, axis=0)[self.kept])


def faded(count: int) -> np.ndarray:
    """(N,) taper that fades a record out at its end; it begins at rest."""
    taper, last = np.ones(count), max(2, round(_FADE * count))
    taper[-last:] = 0.5 * (1 + np.cos(np.pi * np.arange(last) / last))
    return taper


def white(power: np.ndarray) -> float:
    """Mean power of white noise, from lines at which there is nothing else: robust against a few where there is."""
    return float(np.median(power)) / float(np.log(2))  # the median of an exponential distribution


def weighting(record: TimeRecord, channels: tuple[str, ...]) -> Weighting:
    """Weigh a record.

    Noise is taken to be white and read off the top fifth of the spectrum, where a rig of this kind moves no more.

    Args:
        record: measured.
        channels: those of `record.measured` that count.
    """
    count = len(record.times)
    frequencies = np.fft.rfftfreq(count, record.step)
    taper = faded(count)
    kept = (frequencies > LOWEST_HZ) & (frequencies < HIGHEST_HZ)
    top = frequencies > TOP * frequencies[-1]
    signals = np.column_stack([record.measured[name] for name in channels])
    power = np.abs(np.fft.rfft(signals * taper[:, None], axis=0)) ** 2
    noise = np.array([white(column) for column in power[top].T])
    unit = (noise + SHARE**2 * banded(power, frequencies) + 1e-300)[kept].T
    scale, noise_std = np.sqrt(INDEPENDENT / int(kept.sum()) / unit), np.sqrt(noise / count)
    return Weighting(channels, scale, frequencies[kept], noise_std, np.tile(noise, (unit.shape[1], 1)).T, taper, kept)


def blurred(weight: Weighting, power: np.ndarray) -> Weighting:
    """A weighing that counts more as noise.

    Args:
        weight: as it is.
        power: (F, C) of the lines of `Weighting.lines`, that nothing can predict.
    """
    each = INDEPENDENT / len(weight.frequencies_Hz)
    return replace(weight, scale=np.sqrt(each / (each / weight.scale**2 + power.T)), noise=weight.noise + power.T)


def banded(power: np.ndarray, frequencies_Hz: np.ndarray) -> np.ndarray:
    """Mean (F, C) about every line, over a third of an octave."""
    low = np.searchsorted(frequencies_Hz, frequencies_Hz / _HALF_BAND)
    high = np.searchsorted(frequencies_Hz, frequencies_Hz * _HALF_BAND, side="right")
    total = np.concatenate([np.zeros((1, power.shape[1])), np.cumsum(power, axis=0)])
    return np.asarray((total[high] - total[low]) / (high - low)[:, None])
