"""A tone that records have in common however hard they are driven: hum on a line, a pump, a fan.

No law of the rig makes one, and no fit explains it. It shows in what the best model leaves, as a line as narrow as the
record allows, at the same frequency and of about the same amplitude in small records and in large ones. It is taken off
the records, so that what explains the rest is not weighed against it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, log, pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache, Task
from beamdesign.diagnosis.fitting.fitters import Fitters
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT
from beamdesign.diagnosis.fitting.search import search
from beamdesign.diagnosis.judgement import judge
from beamdesign.diagnosis.passing import Look
from beamdesign.progress import Progress, silent
from beamdesign.quantities import decimal, quantity

_MAIN = 2  # lines to either side that Hann's window makes of one
_BESIDE = 20  # lines to either side that tell what there is without it
_CLEAR, _SEEN = 12.0, 4.0  # amplitude over that of the lines beside it: in one record, and in the others
_ALONE = 0.5  # of the power within a sixth of an octave to either side: tones that drive a rig have others there
_RECORDS, _SHARE = 3, 0.6  # that have it
_DRIVEN = 3.0  # largest over smallest rms of records: where it is less, what is driven looks like what is not
_MAINS_HZ, _OFF = (50.0, 60.0), 0.004  # and how far mains are off
_MOST = 4  # tones that are looked for, one after another
_WANDERS = 4  # lines between two tones that are one which wanders


class Left(NamedTuple):
    """What a model leaves of one record.

    Attributes:
        name: of the record.
        times: (N,) s.
        rms: of the displacement, m.
        error: (N,) of the displacement, m.
    """

    name: str
    times: np.ndarray
    rms: float
    error: np.ndarray


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
        having: names of the records that have it.
        of: as many.
    """

    frequency_Hz: float
    amplitude_m: tuple[float, float]
    having: tuple[str, ...]
    of: int

    @property
    def of_the_mains(self) -> bool:
        """Whether its frequency is a multiple of that of the mains."""
        multiples = (self.frequency_Hz / mains for mains in _MAINS_HZ)
        return any(abs(multiple - round(multiple)) < _OFF * round(multiple) for multiple in multiples)

    @property
    def sentence(self) -> str:
        """What was found, and what it may be."""
        sizes = " to ".join(dict.fromkeys(quantity(value, "m", 2) for value in self.amplitude_m))
        what = "hum of the mains, or" if self.of_the_mains else "hum, or"
        return (
            f"What is left of {len(self.having)} of {self.of} records stands out at {decimal(self.frequency_Hz)} Hz, by"
            f" {sizes} however hard they are driven: {what} something that runs at that speed, such as a pump; "
            "record once with nothing moving and with each of them switched off."
        )


def search_without_tones(
    data: Dataset, workers: int = 1, progress: Progress = silent, kept: FitCache | None = None
) -> Look:
    """Search for what explains the records without the tones that they have in common.

    These are looked for in what tolerances alone leave, so that pairs of causes are not tried on hum in vain, and where
    the gap hides them there, in what the best explanation leaves; then all is searched again. A tone that the loop
    hears is taken off only where the best explanation leaves it too.

    Args:
        data: what to explain.
        workers: processes.
        progress: told the share done and what is being fitted.
        kept: fits of an earlier run.

    Returns:
        the search, with no words where there is no tone. Where other channels have one too, the rig moves by it, so
        that what is found without it does not explain all of the gap.

    Raises:
        TimeUp, InputError: as `search`.
    """
    with Fitters(data, 1, kept) as fitters:
        (null,) = fitters.each(Task(NOTHING, {}))
    cleared, words, in_loop = (data, (), False) if null.reason else without_tones(data, null)
    if not words or in_loop:  # what the loop hears may be a resonance that a cause explains
        found = search(data, workers, progress, kept, null=null)
        cleared, words, in_loop = without_tones(data, min((null, *found.fits), key=lambda fit: fit.misfit))
    if words:
        kept = kept and replace(kept, part=(*kept.part, *words))
        found = search(cleared, workers, progress, kept)
    return Look(cleared, found, judge(found), words, kept, doubtful=in_loop)


def without_tones(data: Dataset, best: Fit) -> tuple[Dataset, tuple[str, ...], bool]:
    """Take tones in common off the records.

    What oscillates by itself keeps its amplitude as well, but not its frequency where masses or controllers differ: a
    tone in records of one loop alone that is not of the mains is left where it is. Of a hum nothing is left once its
    sine is taken off; where another tone stands beside one, both are of a motion whose frequency wanders, and all stay.

    Args:
        data: records.
        best: fit whose model leaves the tones.

    Returns:
        the data set, which is that given where there is no tone; what was taken off, in words; whether the loop hears
        any of it.
    """
    placement, pieces = best.hypothesis.placement(data.prototype), record_evidence(data)
    predicted = [piece.predicted(placement, best.z) for piece in pieces]
    counted = [piece.record.counted[:, None] for piece in pieces]
    pairs = zip(pieces, predicted, counted, strict=True)
    left = [share * (piece.measured - of) for piece, of, share in pairs if of is not None]
    records, any_in_loop = list(data.records), False
    words: list[str] = []
    taken: list[float] = []
    beside = _WANDERS / min((float(np.ptp(piece.record.times)) for piece in pieces), default=np.inf)
    while len(left) == len(pieces) and len(words) < _MOST:
        tone = common_tone([_of_displacement(piece, of) for piece, of in zip(pieces, left, strict=True)])
        if tone is None:
            break
        if not _recorded(pieces, left, tone):
            break
        loops = {(record.masses, record.controller) for record in records if record.name in tone.having}
        if len(loops) < 2 and not tone.of_the_mains:
            break
        if any(abs(tone.frequency_Hz - other) < beside for other in taken):
            return data, (), False
        taken.append(tone.frequency_Hz)
        hearing = 0
        for k, piece in enumerate(pieces):
            if piece.name not in tone.having:  # too small to be seen, and too small to count
                continue
            made = _sines(piece, left[k], tone.frequency_Hz)
            hearing += _in_the_loop(piece, left[k], tone.frequency_Hz)
            left[k] = left[k] - counted[k] * made
            own = dict(zip(piece.weight.channels, made.T, strict=True))
            cleared = {name: values - own.get(name, 0.0) for name, values in records[k].measured.items()}
            records[k] = replace(records[k], measured=cleared)
        in_loop = hearing > len(tone.having) / 2
        heard = "; but the loop hears it, so that the rig moves by it, which no model here does" if in_loop else ""
        words.append(f"{tone.sentence} It is taken off the records before they are weighed{heard}.")
        any_in_loop = any_in_loop or in_loop
    return replace(data, records=tuple(records)) if words else data, tuple(words), any_in_loop


def _recorded(pieces: Sequence[RecordEvidence], left: Sequence[np.ndarray], tone: Tone) -> bool:
    """Whether records that have a tone stand out at its frequency less without it; where a model makes it, more."""
    gained = 0.0
    for piece, of in zip(pieces, left, strict=True):
        if piece.name in tone.having:
            sine = _sines(piece, of, tone.frequency_Hz)
            spectra = [_spectrum(_of_displacement(piece, each)) for each in (piece.measured, piece.measured - sine)]
            there, without = (s.contrast(s.peak(tone.frequency_Hz)) for s in spectra if s is not None)
            gained += log(there / without)
    return gained > 0


def _of_displacement(piece: RecordEvidence, left: np.ndarray) -> Left:
    rms = float(np.std(piece.measured[:, piece.column]))
    return Left(piece.name, piece.record.times, rms, left[:, piece.column])


def _sines(piece: RecordEvidence, left: np.ndarray, near_Hz: float) -> np.ndarray:
    """(N, C) of each channel, the sine at the frequency, within a line of the record, that its displacement has."""
    times, counted = piece.record.times, piece.record.counted[:, None]
    displacement = left[:, [piece.column]]

    def fitted(frequency: float, signals: np.ndarray) -> np.ndarray:
        basis = np.column_stack([np.cos(2 * pi * frequency * times), np.sin(2 * pi * frequency * times)])
        return np.asarray(basis @ np.linalg.lstsq(counted * basis, signals, rcond=None)[0])

    def missed(frequency: float) -> float:
        return float(np.sum((displacement - counted * fitted(frequency, displacement)) ** 2))

    line = 1 / float(np.ptp(times))
    found = minimize_scalar(missed, bounds=(near_Hz - line, near_Hz + line), method="bounded")
    return fitted(float(found.x), left)


def _in_the_loop(piece: RecordEvidence, left: np.ndarray, near_Hz: float) -> bool:
    """Whether a tone stands out in any channel but the displacement."""
    names = zip(piece.weight.channels, left.T, strict=True)
    others = (_spectrum(Left(piece.name, piece.record.times, 1.0, of)) for name, of in names if name != DISPLACEMENT)
    return any(of is not None and of.contrast(of.peak(near_Hz)) > _SEEN for of in others)


def common_tone(left: Sequence[Left]) -> Tone | None:
    """The clearest tone that what is left of most records has in common.

    Args:
        left: of each time record, by one model.

    Returns:
        None without one, with fewer than three records, or where all are driven alike.
    """
    driven = [of.rms for of in left]
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
        named = tuple(s.name for s, _ in having)
        swings = [rms for of, rms in zip(left, driven, strict=True) if of.name in named]
        if max(swings) > _DRIVEN * min(swings) and max(sizes) / min(sizes) < sqrt(max(swings) / min(swings)):
            return Tone(frequency, (min(sizes), max(sizes)), named, len(left))
    return None


def _spectrum(of: Left) -> _Spectrum | None:
    """Of a record that is long enough and that a model predicts."""
    if len(of.times) < 8 * _BESIDE or not np.all(np.isfinite(of.error)):
        return None
    window = np.hanning(len(of.times))
    amplitude = 2 * np.abs(np.fft.rfft(of.error * window)) / window.sum()
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
