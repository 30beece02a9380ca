"""Inputs without the noise of the instruments that recorded them.

A force sensor's noise is no force: fed into a model it shakes the simulated rig where the real one was still. Where a
record's spectrum, smoothed, does not stand out of that noise, the input is taken to be none; where it does, it stays.
"""

import numpy as np
from scipy.fft import dct, idct

_TOP = 0.8  # of the Nyquist frequency: nothing is driven above
_HALF_BAND = 2 ** (1 / 6)
_LEAST_LINES = 32  # to smooth over
_MEDIAN_OF_SQUARE = 0.4549  # of a standard normal number
_MARGIN = 2.5  # a smoothed spectrum of nothing but noise goes no higher


def without_noise(signal: np.ndarray) -> np.ndarray:
    """A recorded input through the Wiener filter of its own spectrum over white noise.

    The noise's power is the median of the top fifth of the spectrum; the signal's, what a third of an octave about a
    line has beyond twice that (N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949).

    Args:
        signal: (N,) uniform samples.
    """
    lines = dct(signal, norm="ortho")  # of the record and its mirror image, which has no step where it ends
    power = lines**2
    noise = float(np.median(power[int(_TOP * len(power)) :])) / _MEDIAN_OF_SQUARE
    if noise <= 0:
        return signal
    total = np.concatenate([[0.0], np.cumsum(power)])
    at = np.arange(len(power))
    low = np.maximum(np.minimum((at / _HALF_BAND).astype(int), at - _LEAST_LINES), 0)
    high = np.minimum(np.maximum((at * _HALF_BAND).astype(int), at + _LEAST_LINES) + 1, len(power))
    driven = np.maximum((total[high] - total[low]) / (high - low) - _MARGIN * noise, 0.0)
    return np.asarray(idct(lines * driven / (driven + noise), norm="ortho"))
