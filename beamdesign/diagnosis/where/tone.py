"""A tone that records have in common however hard they are driven: hum on a line, a pump, a fan.

No law of the rig makes one, and no fit explains it. It shows in what the chosen model leaves, as a line as narrow as
the record allows, at the same frequency and of about the same amplitude in small records and in large ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from beamdesign.diagnosis.diagnosis import Errors
from beamdesign.quantities import decimal, quantity

_MAIN = 2  # lines to either side that Hann's window makes of one
_BESIDE = 20  # lines to either side that tell what there is without it
_CLEAR, _SEEN = 12.0, 4.0  # amplitude over that of the lines beside it: in one record, and in the others
_ALONE = (
    0.5  # of the power within a sixth of an octave to either side: a set of tones that drives a rig has others there
)
_RECORDS, _SHARE = 3, 0.6  # that have it
_DRIVEN = 3.0  # largest over smallest rms of records: where it is less, what is driven looks like what is not
_MAINS_HZ, _OFF = (50.0, 60.0), 0.004  # and how far mains are off


class _Spectrum(NamedTuple):
    """Of what a model leaves of one record: lines, amplitude in m, and what stands beside each."""

    name: str
    frequencies_Hz: np.ndarray
    amplitude: np.ndarray
    beside: np.ndarray

    def peak(self, near_Hz: float) -> int:
        """The highest line that may be of a tone at a frequency; some line without one where the record has none."""
        line = round(near_Hz / self.frequencies_Hz[1])
        low = max(0, min(line, len(self.amplitude) - 1) - 1)
        return low + int(np.argmax(self.amplitude[low : low + 3]))

    def contrast(self, line: int) -> float:
        """Its amplitude over that of the lines beside it."""
        return float(self.amplitude[line] / self.beside[line])


@dataclass(frozen=True)
class Tone:
    """A tone in common.

    Attributes:
        frequency_Hz: of it.
        amplitude_m: least and largest, of the displacement.
        count: of records that have it.
        of: as many.
    """

    frequency_Hz: float
    amplitude_m: tuple[float, float]
    count: int
    of: int

    @property
    def sentence(self) -> str:
        """What was found, and what it may be."""
        low, high = (quantity(value, "m", 2) for value in self.amplitude_m)
        multiples = (self.frequency_Hz / mains for mains in _MAINS_HZ)
        mains = any(abs(multiple - round(multiple)) < _OFF * round(multiple) for multiple in multiples)
        what = "hum of the mains, or" if mains else "hum, or"
        return (
            f"What is left of {self.count} of {self.of} records stands out at {decimal(self.frequency_Hz)} Hz, by "
            f"{low} to {high} however hard they are driven: {what} something that runs at that speed, such as a pump; "
            "record once with nothing moving and with each of them switched off."
        )


def common_tone(left: Sequence[Errors]) -> Tone | None:
    """The clearest tone that what is left of most records has in common.

    Args:
        left: errors of the models on time records; those of `after` count.

    Returns:
        None without one, with fewer than three records, or where all are driven alike.
    """
    driven = [float(np.std(of.measured)) for of in left]
    if len(left) < _RECORDS or max(driven) < _DRIVEN * min(driven):
        return None
    spectra = [spectrum for of in left if (spectrum := _spectrum(of)) is not None]
    clearest = [(s.contrast(k), s, k) for s in spectra for k in (int(np.argmax(s.amplitude / s.beside)),)]
    for contrast, spectrum, line in sorted(clearest, key=lambda one: -one[0]):
        if contrast < _CLEAR:
            return None
        frequency = _between_lines(spectrum, line)
        having = [(s, k) for s in spectra for k in (s.peak(frequency),) if s.contrast(k) > _SEEN and _alone(s, k)]
        if len(having) < max(_RECORDS, ceil(_SHARE * len(left))):
            continue
        sizes = [float(s.amplitude[k]) for s, k in having]
        named = {s.name for s, _ in having}
        swings = [rms for of, rms in zip(left, driven, strict=True) if of.name in named]
        if max(swings) > _DRIVEN * min(swings) and max(sizes) / min(sizes) < sqrt(max(swings) / min(swings)):
            return Tone(frequency, (min(sizes), max(sizes)), len(having), len(left))
    return None


def _spectrum(of: Errors) -> _Spectrum | None:
    """Of a record that is long enough and that a model predicts."""
    if len(of.times) < 8 * _BESIDE or not np.all(np.isfinite(of.after)):
        return None
    window = np.hanning(len(of.times))
    amplitude = 2 * np.abs(np.fft.rfft(of.after * np.std(of.measured) * window)) / window.sum()
    frequencies = np.fft.rfftfreq(len(of.times), float(of.times[1] - of.times[0]))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(amplitude, _BESIDE, mode="reflect"), 2 * _BESIDE + 1)
    others = np.delete(around, slice(_BESIDE - _MAIN, _BESIDE + _MAIN + 1), axis=1)
    beside = np.sqrt(np.mean(others**2, axis=1))
    amplitude[: 2 * _MAIN] = amplitude[-2 * _MAIN :] = 0.0  # what rests is no tone, nor what is not sampled in full
    return _Spectrum(of.name, frequencies, amplitude, np.maximum(beside, 1e-300))


def _alone(of: _Spectrum, line: int) -> bool:
    """Whether a line holds most of the power about it, as no resonance that noise drives does."""
    power, ratio = of.amplitude**2, of.frequencies_Hz / of.frequencies_Hz[line]
    near = (ratio > 2 ** (-1 / 6)) & (ratio < 2 ** (1 / 6))
    own = power[line - _MAIN : line + _MAIN + 1].sum()
    return bool(own > _ALONE * power[near].sum())


def _between_lines(of: _Spectrum, line: int) -> float:
    """Frequency of a tone whose highest line is given, from the two beside it: exact of one under Hann's window."""
    before, at, after = of.amplitude[line - 1 : line + 2]
    high, sign = (after, 1) if after > before else (before, -1)
    return float(of.frequencies_Hz[line] + sign * of.frequencies_Hz[1] * (2 * high - at) / (high + at))
