"""Steady motion in the runs of a bench: where it is, how fast, under which pressures."""

from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist

import numpy as np
from scipy.stats import theilslopes

from beamdesign.gap.bench.data import BenchRun, BenchSet, held, stretches
from beamdesign.records import InputError

_MARGIN = 0.1  # of the travel next to either stop is left out
_BINS = 10  # the rest is looked at in as many parts
_LEAST_BINS = 4
_WITHIN = 4.0  # robust standard deviations by which a part may differ from the later half and still be steady
_STRAIGHT = 0.03  # a part whose speed differs by less counts as equal whatever the noise
_MAD = 1 / NormalDist().inv_cdf(0.75)
_MOST_POINTS = 400


@dataclass(frozen=True)
class SteadyMotion:
    """Steady motion in one direction of one run, and where it ended.

    Attributes:
        condition: of the run.
        replicate: of the run.
        side: chamber whose pressure was recorded.
        direction: 1 extending, -1 retracting.
        command_V: while it moved.
        begins_s: of the part that counts as steady.
        ends_s: of it.
        speed: m/s, positive extending, by Theil and Sen's median of slopes.
        pressure: Pa, median over that part.
        stall: Pa, median against the end stop.
        rest_m: reading of the displacement there.
    """

    condition: str
    replicate: int
    side: str
    direction: int
    command_V: float
    begins_s: float
    ends_s: float
    speed: float
    pressure: float
    stall: float
    rest_m: float


def steady_motions(data: BenchSet) -> tuple[SteadyMotion, ...]:
    """Steady motion of every run in both directions.

    Raises:
        InputError: where a run does not move steadily for long enough to tell its speed.
    """
    return tuple(steady_motion(run, direction) for run in data.runs for direction in (1, -1))


def steady_motion(run: BenchRun, direction: int) -> SteadyMotion:
    """Find the steady part of a run's stroke in one direction.

    The stroke is what lies between the readings at both stops, less a margin. Parts of it count as steady which move
    and press as its later half does; the median of that half is little disturbed by how long the start takes.

    Raises:
        InputError: where too little of the stroke is steady.
    """
    i, j, volts = [each for each in stretches(run.command_V) if each[2] * direction > 0][-1]
    rests = [float(np.median(run.displacement_m[held(run, sign)])) for sign in (-1, 1)]
    position = (run.displacement_m[i:j] - rests[0]) / (rests[1] - rests[0])
    progress = position if direction > 0 else 1 - position
    smooth = _running_median(progress)
    begins = int(np.argmax(smooth > _MARGIN))
    ends = int(np.argmax(smooth > 1 - _MARGIN))
    if not smooth[0] < 0.5 or ends - begins < 2 * _BINS:
        raise InputError(run.name, [("displacement_m", f"no whole stroke {_words(direction)} at {volts:g} V")])
    edges = np.linspace(begins + i, ends + i, _BINS + 1).astype(int)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    speeds = np.array([_slope(run, part) for part in parts])
    pressures = np.array([float(np.median(run.pressure_Pa[part])) for part in parts])
    alike = _like_later_half(speeds) & _like_later_half(pressures)
    first, last = _longest(alike)
    if last - first < _LEAST_BINS:
        raise InputError(run.name, [("displacement_m", f"no steady speed {_words(direction)} at {volts:g} V")])
    part = slice(edges[first], edges[last])
    stop = held(run, direction)
    return SteadyMotion(
        run.condition,
        run.replicate,
        run.side,
        direction,
        volts,
        float(run.times[part.start]),
        float(run.times[part.stop]),
        _slope(run, part),
        float(np.median(run.pressure_Pa[part])),
        float(np.median(run.pressure_Pa[stop])),
        float(np.median(run.displacement_m[stop])),
    )


def _words(direction: int) -> str:
    return "extending" if direction > 0 else "retracting"


def _running_median(values: np.ndarray) -> np.ndarray:
    """Median over a short window, which takes out the sensor's spikes."""
    width = max(5, len(values) // 200) | 1
    padded = np.pad(values, width // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1))


def _slope(run: BenchRun, part: slice) -> float:
    every = max(1, (part.stop - part.start) // _MOST_POINTS)
    return float(theilslopes(run.displacement_m[part][::every], run.times[part][::every])[0])


def _like_later_half(values: np.ndarray) -> np.ndarray:
    later = values[_BINS // 2 :]
    middle = float(np.median(later))
    spread = max(_MAD * float(np.median(np.abs(later - middle))), _STRAIGHT / _WITHIN * abs(middle))
    return np.asarray(np.abs(values - middle) <= _WITHIN * spread)


def _longest(flags: np.ndarray) -> tuple[int, int]:
    """First and one past the last of the longest row of flags."""
    best = (0, 0)
    begin = 0
    for k, flag in enumerate([*flags.tolist(), False]):
        if not flag:
            best = max(best, (begin, k), key=lambda pair: pair[1] - pair[0])
            begin = k + 1
    return best
