"""What one unit of misfit is: the noise of a channel plus a small share of what the channel does at that frequency.

A model is never exact. Weighing residuals by noise alone would let the third digit of the largest record decide
everything, and call every difference significant. So a residual counts in units of sqrt(noise + (share of the signal
about that frequency)^2), band by band, and a record as a whole counts as `INDEPENDENT` such units per channel, not as
thousands of independent samples: what a model lacks is the same from one sample to the next.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import next_fast_len
from scipy.optimize import nnls

from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.data.input_noise import BANDS, noise_lines

SHARE = 0.02
"""Relative error of a model, line by line, that counts as one unit."""
INDEPENDENT = 40.0
LOWEST_HZ, HIGHEST_HZ = 0.2, 400.0
"""Of the lines that count, of a rig as quick as the published one."""
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
        kept: which lines count, of a record that zeros fill up to `padded`.
    """

    channels: tuple[str, ...]
    scale: np.ndarray = field(repr=False)
    frequencies_Hz: np.ndarray = field(repr=False)
    noise_std: np.ndarray
    noise: np.ndarray = field(repr=False)
    fade: np.ndarray = field(repr=False)
    kept: np.ndarray = field(repr=False)

    @property
    def measured(self) -> np.ndarray:
        """(C, F) mean power of what was measured about every line."""
        unit = INDEPENDENT / len(self.frequencies_Hz) / self.scale**2
        return np.asarray((unit - self.noise) / SHARE**2)

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
        return np.asarray(np.fft.rfft(faded, padded(len(faded)), axis=0)[self.kept])


def padded(count: int) -> int:
    """A length from `count` up whose transform is quick; that of a prime number of samples takes four times as long."""
    return int(next_fast_len(count, real=True))


def faded(count: int) -> np.ndarray:
    """(N,) taper that fades a record out at its end; it begins at rest."""
    taper, last = np.ones(count), max(2, round(_FADE * count))
    taper[-last:] = 0.5 * (1 + np.cos(np.pi * np.arange(last) / last))
    return taper


def white(power: np.ndarray) -> float:
    """Mean power of white noise, from lines at which there is nothing else: robust against a few where there is."""
    return float(np.median(power)) / float(np.log(2))  # the median of an exponential distribution


def spectra(record: TimeRecord, signals: np.ndarray) -> np.ndarray:
    """(C, F) power per sample of signals (N, C) as long as a record, faded out as it is weighed."""
    taper = faded(len(record.times)) * record.counted
    lines = np.fft.rfft(signals * taper[:, None], padded(len(taper)), axis=0)
    return np.asarray(np.abs(lines.T) ** 2 / np.sum(taper**2))


def _read_off(power: np.ndarray, quiet: np.ndarray) -> float:
    """White noise of a spectrum: of a low-passed one no more than twice that of the quietest, for it may be driven."""
    lines = noise_lines(power, quiet)
    own = white(power[lines])
    return own if lines.stop == len(power) else min(own, 2 * white(quiet[1, round(lines.start / len(power) * BANDS)]))


def weighting(
    record: TimeRecord,
    channels: tuple[str, ...],
    band_Hz: tuple[float, float] = (LOWEST_HZ, HIGHEST_HZ),
    quiet: np.ndarray | None = None,
) -> Weighting:
    """Weigh a record.

    Noise is taken to be white and read off the top of the spectrum, see `noise_lines`.

    Args:
        record: measured.
        channels: those of `record.measured` that count.
        band_Hz: in which lines count.
        quiet: (C, 2, 20) least levels of all records that one recorder has written, see `band_levels`; where there are
            none, nothing tells what it has low-passed.
    """
    count = len(record.times)
    frequencies = np.fft.rfftfreq(padded(count), record.step)
    taper = faded(count) * record.counted
    kept = (frequencies > band_Hz[0]) & (frequencies < band_Hz[1])
    per_sample = spectra(record, np.column_stack([record.measured[name] for name in channels]))
    levels = np.full((len(channels), 2, BANDS), np.inf) if quiet is None else quiet
    power = per_sample.T * np.sum(taper**2)
    noise = np.array([_read_off(*of) for of in zip(per_sample, levels, strict=True)]) * np.sum(taper**2)
    unit = (noise + SHARE**2 * banded(power, frequencies) + 1e-300)[kept].T
    scale, noise_std = np.sqrt(INDEPENDENT / int(kept.sum()) / unit), np.sqrt(noise / np.sum(record.counted**2))
    return Weighting(channels, scale, frequencies[kept], noise_std, np.tile(noise, (unit.shape[1], 1)).T, taper, kept)


def blurred(weight: Weighting, power: np.ndarray) -> Weighting:
    """A weighing that counts more as noise.

    Args:
        weight: as it is.
        power: (F, C) of the lines of `Weighting.lines`, that nothing can predict.
    """
    each = INDEPENDENT / len(weight.frequencies_Hz)
    return replace(weight, scale=np.sqrt(each / (each / weight.scale**2 + power.T)), noise=weight.noise + power.T)


Rise = Callable[[np.ndarray], np.ndarray]
"""Of noise: power per sample beyond white noise, by frequency in Hz."""


def rising(spectra: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Rise | None:
    """How far a sensor's noise rises towards low frequency above what it has at the top: as 1/f^2 where that is seen.

    Noise is the same whatever drives a record, so that in every third of an octave it is no more than the least of
    them. From the highest band down for as long as w + g/f^2 describes these least powers within their scatter, they
    are noise: what a rig does falls faster.

    Args:
        spectra: frequencies in Hz, powers per sample, and those of them that the believed model predicts, of every
            record; bands of which it predicts a part do not count.

    Returns:
        Power per sample beyond w, by frequency; None where g is within its scatter. Below the bands that were described
        it goes on for two octaves, then is level, and nowhere is more than the least of the powers.
    """
    edges = LOWEST_HZ * 2 ** (np.arange(60) / 3)
    sums = [
        [np.bincount(np.digitize(f, edges), v, len(edges) + 1) for v in (None, f, *powers)] for f, *powers in spectra
    ]
    if not sums:
        return None
    count, total, power, predicted = np.moveaxis(np.array(sums), 1, 0)
    noise = (count >= _LEAST_LINES) & (predicted < _PREDICTED * power)
    there = noise.any(axis=0)
    mean = np.divide(power, count, out=np.full(power.shape, np.inf), where=noise)
    quietest = (np.argmin(mean, axis=0), np.arange(len(there)))
    number, middle, least = (part[quietest][there] for part in (count, total / np.maximum(count, 1), mean))
    found = None
    for first in range(len(least) - _LEAST_BANDS, -1, -1):
        own, scatter = least[first:], 1 / np.sqrt(number[first:])
        terms = np.column_stack([np.ones(len(own)), middle[first:] ** -2.0]) / (own * scatter)[:, None]
        (w, g), _ = nnls(terms, 1 / scatter)
        off = own / (w + g * middle[first:] ** -2.0) - 1
        if np.all(np.abs(off) < _SCATTERS * scatter + _ROUGHLY):
            found = w, g, float(np.sqrt(np.linalg.pinv(terms.T @ terms)[1, 1])), middle[first]
        elif found is not None:
            break
    if found is None or found[1] < _SEEN * found[2]:
        return None
    w, g, _, lowest = found

    def beyond_white(f: np.ndarray) -> np.ndarray:
        most = np.maximum(np.interp(f, middle, least, left=np.inf) - w, 0.0)
        return np.asarray(np.minimum(g / np.maximum(f, lowest / 4) ** 2, most))

    return beyond_white


_LEAST_LINES, _LEAST_BANDS = 4, 3
_PREDICTED = 0.2  # of the power in a band
_SCATTERS, _ROUGHLY, _SEEN = 3.0, 0.1, 4.0  # standard errors, beside a share; and of g


def banded(power: np.ndarray, frequencies_Hz: np.ndarray) -> np.ndarray:
    """Mean (F, C) about every line, over a third of an octave."""
    low = np.searchsorted(frequencies_Hz, frequencies_Hz / _HALF_BAND)
    high = np.searchsorted(frequencies_Hz, frequencies_Hz * _HALF_BAND, side="right")
    total = np.concatenate([np.zeros((1, power.shape[1])), np.cumsum(power, axis=0)])
    return np.asarray((total[high] - total[low]) / (high - low)[:, None])
