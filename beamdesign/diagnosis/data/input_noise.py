"""A recorded input without the noise of the instrument that recorded it, and how much of that noise is left."""

import numpy as np
from scipy.fft import dct, idct

TOP = 0.8  # of the Nyquist frequency: above it there is only noise
BANDS, _FEWEST_LINES = 20, 8  # of the spectrum, that are held against each other; lines in each
_WIDTH, _EDGE = 3, 2  # bands: that are level, and in which they fall
_LEVEL, _FALLS = 2.0, 4.0  # greatest over least, and over what is left beyond: no power of the frequency does both
_DRIVEN = 0.2  # of the power: what a model makes of it is no noise
_HALF_BAND = 2 ** (1 / 6)
_LEAST_LINES = 32  # to smooth over
_MEDIAN_OF_SQUARE = 0.4549  # of a standard normal number
_MARGIN = 2.5  # a smoothed spectrum of nothing but noise goes no higher
_APART = 3.0  # standard deviations by which means over a shorter and a longer stretch may differ
_LONGER = 1.3  # times, from one stretch to the next that is tried
_ALL = 1.15  # times the noise's power: what may be taken away as noise
_REPEATED = 0.6  # of the samples: of pairs half are exactly as the one before, of noise in sound digits fewer
_DIGITS, _MOSTLY = 4, 0.9  # of the finest step: what coarse digits reach beyond; how many changes are of one step
_ANSWERED = 6.0  # standard deviations of what chance makes of a correlation with white noise


def band_levels(power: np.ndarray, driven: np.ndarray | float = 0.0) -> np.ndarray:
    """(2, 20) medians of a spectrum (F,) in bands up to the frequency of Nyquist; first inf where a model makes of it.

    Args:
        power: of its lines.
        driven: (F,) part of it that a model makes, where one is at hand.
    """
    lines = [np.array_split(of, BANDS) for of in (power, driven + 0 * power)]
    levels, made = (np.array([np.median(band) for band in of]) for of in lines)
    return np.array([np.where(made < _DRIVEN * levels, levels, np.inf), levels])


def noise_lines(power: np.ndarray, levels: np.ndarray) -> slice:
    """Lines of a spectrum off which its white noise is read: its top fifth, where a rig of this kind moves no more.

    What a converter decimates, or a program resamples, it has low-passed not far below the frequency of Nyquist: the
    spectrum is level and then falls within a tenth, and what is left above, rounding perhaps, says nothing of the noise
    below. There it is the highest stretch that is level before. What a rig moves falls all the way to its noise.

    Args:
        power: (F,) from 0 to the frequency of Nyquist.
        levels: (2, 20) see `band_levels`, of the same or the least of several, whose noise is alike.
    """
    count, found = len(power), list[tuple[float, int]]()
    for first in range(BANDS - _WIDTH - 1, BANDS // 2 - 1, -1) if count >= _FEWEST_LINES * BANDS else ():
        window, beyond = levels[0, first : first + _WIDTH], levels[1, min(first + _WIDTH + _EDGE, BANDS - 1) :]
        if window.max() < _LEVEL * window.min() and _FALLS * beyond.max() < window.min():
            found.append((float(window.min()), first))
    if not found:
        return slice(round(TOP * count), count)
    _, first = max(found[:2])  # the highest one may reach over the edge
    return slice(first * count // BANDS, (first + _WIDTH) * count // BANDS)


def denoised(signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A recorded input as far as it stands out of white noise, and how far it is off for all that.

    The noise is that of the instrument which recorded it. A force sensor's noise is no force: fed into a model it
    shakes the simulated rig where the real one was still. An input of many lines is told from noise by its spectrum,
    one of steps by the stretches over which it is held; whichever leaves less noise is taken. One that is held exactly,
    as a generator holds it, has none.

    What noise leaves where the input drives is what taking it out leaves of as much noise that is added anew, about
    every line of the spectrum: a parametric bootstrap (B. Efron and R. J. Tibshirani, An Introduction to the Bootstrap,
    1993, section 6.5).

    Args:
        signal: (N,) uniform samples.

    Returns:
        (N,) the input; and (N,) mean square of its error per sample, by frequency from 0 to that of Nyquist.
    """
    found, noise = _without_noise(signal)
    if not noise > 0 or not found.any():
        return found, np.zeros(len(signal))
    again, _ = _without_noise(found + np.sqrt(noise) * np.random.default_rng(0).standard_normal(len(signal)))
    return found, _about(dct(again - found, norm="ortho") ** 2)


def _without_noise(signal: np.ndarray) -> tuple[np.ndarray, float]:
    """The input, and the power of the noise that was taken out."""
    lines = dct(signal, norm="ortho")  # of the record and its mirror image, which has no step where it ends
    # The power of white noise by the top of the spectrum, and by second differences, of which steps have few; of noise
    # that was low-passed these are too small.
    read_off = noise_lines(lines, band_levels(lines**2))
    top = float(np.median(lines[read_off] ** 2)) / _MEDIAN_OF_SQUARE
    rough = float(np.median(np.diff(signal, 2) ** 2)) / _MEDIAN_OF_SQUARE / 6
    noise = min(top, rough) if rough > 0 and read_off.stop == len(lines) else top
    if noise <= 0:
        return signal, 0.0
    gains = _wiener(lines**2, noise)
    if _repeated(signal) > _REPEATED and gains.any() and not _coarse(signal):
        return signal, 0.0
    if rough > 0:  # else its digits are too coarse to tell, or it has none and is held exactly
        held, left = _held(signal, noise)
        if left < np.mean(gains**2) and np.var(signal - held) < _ALL * noise:
            return held, noise
    return np.asarray(idct(lines * gains, norm="ortho")), noise


def is_answered(signal: np.ndarray, motion: np.ndarray) -> bool:
    """Whether a motion follows from an input that looks like white noise, so that it drove a rig and is no noise.

    Of N samples the correlation of white noise with what it has nothing to do with has a standard deviation of
    1/sqrt(N), whatever that is and however much later it comes.

    Args:
        signal: (N,) input.
        motion: (N,) measured at the same time.
    """
    count = 2 * len(signal)
    given, seen = (np.fft.rfft(each - each.mean(), count) for each in (signal, motion))
    later = np.fft.irfft(np.conj(given) * seen, count)[: len(signal) // 2]
    size = len(signal) * float(np.std(signal)) * float(np.std(motion))
    return bool(size > 0 and np.abs(later).max() > _ANSWERED / np.sqrt(len(signal)) * size)


def _repeated(signal: np.ndarray) -> float:
    """Share of the samples that are exactly as the one before, the longest run of them left out: nothing acts there."""
    changes = np.flatnonzero(np.diff(signal, prepend=np.inf, append=np.inf) != 0)
    runs = np.diff(changes)
    return 1 - (len(runs) - 1) / max(len(signal) - int(runs.max()), 1)


def _coarse(signal: np.ndarray) -> bool:
    """Whether samples change by one digit of the recorder and little else."""
    changes = np.abs(np.diff(signal))
    changes = changes[changes > 0]
    finest = float(changes.min(initial=np.inf))
    return bool(np.ptp(signal) > _DIGITS * finest and np.mean(changes < 1.5 * finest) > _MOSTLY)


def _wiener(power: np.ndarray, noise: float) -> np.ndarray:
    """(N,) gains of a signal's own filter over white noise.

    The signal's power is what a third of an octave about a line has beyond `_MARGIN` times that of the noise
    (N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949).
    """
    driven = np.maximum(_about(power) - _MARGIN * noise, 0.0)
    return np.asarray(driven / (driven + noise))


def _about(power: np.ndarray) -> np.ndarray:
    """(N,) mean over a third of an octave about every line, and over no fewer than `_LEAST_LINES` to either side."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    at = np.arange(len(power))
    low = np.maximum(np.minimum((at / _HALF_BAND).astype(int), at - _LEAST_LINES), 0)
    high = np.minimum(np.maximum((at * _HALF_BAND).astype(int), at + _LEAST_LINES) + 1, len(power))
    return np.asarray((total[high] - total[low]) / (high - low))


def _held(signal: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
    """A signal with every sample the mean of as long a stretch to either side as it is held; and what noise is left.

    Stretches grow until the confidence intervals of their means have nothing in common any more (A. Goldenshluger and
    A. Nemirovski, Math. Methods of Statistics 6 (1997) 135; V. Katkovnik, IEEE Trans. Signal Process. 47 (1999) 2567).

    Returns:
        (N,) the signal, and the power of the noise in it over that before, on average.
    """
    mean, length = _one_sided(signal, noise)
    mirrored, other = (found[::-1] for found in _one_sided(signal[::-1], noise))
    both = length + other - 1  # the sample itself is in either
    return (length * mean + other * mirrored - signal) / both, float(np.mean(1 / both))


def _one_sided(signal: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """(N,) means from each sample onwards, and how many samples are in them."""
    count = len(signal)
    total = np.concatenate([[0.0], np.cumsum(signal)])
    at = np.arange(count)
    mean, length = signal.astype(float), np.ones(count)
    low, high = mean - _APART * np.sqrt(noise), mean + _APART * np.sqrt(noise)
    growing, stretch = np.ones(count, dtype=bool), 1
    while growing.any() and stretch < count:
        stretch = int(np.ceil(_LONGER * stretch))
        ends = np.minimum(at + stretch, count)
        number = ends - at
        longer = (total[ends] - total[at]) / number
        half = _APART * np.sqrt(noise / number)
        low, high = np.maximum(low, longer - half), np.minimum(high, longer + half)
        growing &= low <= high
        mean[growing], length[growing] = longer[growing], number[growing]
    return mean, length
