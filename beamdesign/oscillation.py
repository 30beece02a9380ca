"""Oscillations at the ends of time records."""

from dataclasses import dataclass
from itertools import pairwise
from math import log

import numpy as np


@dataclass(frozen=True)
class Oscillation:
    """An oscillation about whatever slower motion carries it.

    Attributes:
        frequency_Hz: mean over the turning points looked at.
        amplitude: half the last swing, in the signal's unit.
        growth_per_s: exponential rate; negative where it dies out.
    """

    frequency_Hz: float
    amplitude: float
    growth_per_s: float


def oscillation(times: np.ndarray, signal: np.ndarray, turns: int | None = None) -> Oscillation | None:
    """The oscillation at the end of a record, from its turning points; None where there are fewer than six.

    Args:
        times: (N,) equally spaced, s.
        signal: (N,).
        turns: how many of the last turning points to look at; all of them by default.
    """
    slope = np.diff(signal)
    at = np.nonzero(slope[:-1] * slope[1:] < 0)[0]
    at = at if turns is None else at[-turns:]
    if len(at) < 6:
        return None
    # The turning point between samples, by a parabola through three.
    bend = slope[at + 1] - slope[at]
    share = -(slope[at] + slope[at + 1]) / (2 * bend)
    when = times[at + 1] + share * (times[1] - times[0])
    height = signal[at + 1] - bend * share**2 / 2
    swings = np.abs(np.diff(height)) / 2
    middle = (when[1:] + when[:-1]) / 2
    frequency = (len(when) - 1) / (2 * (when[-1] - when[0]))
    growth = float(np.polyfit(middle - middle.mean(), np.log(np.maximum(swings, 1e-300)), 1)[0])
    return Oscillation(float(frequency), float(swings[-1]), growth)


def sustained(times: np.ndarray, signal: np.ndarray, least_amplitude: float, forced: bool) -> Oscillation | None:
    """The oscillation of a record whose inputs are constant, unless it dies out.

    Args:
        times: (N,) s.
        signal: (N,) under constant inputs.
        least_amplitude: below this it counts as died out.
        forced: whether something in the rig keeps shaking it, so that only growth counts.
    """
    half = len(times) // 2
    late = oscillation(times[half:], signal[half:])
    if late is None or late.amplitude < least_amplitude:
        return None
    span = times[-1] - times[half]
    least = log(1.05) / span if forced else log(0.95) / span
    return late if late.growth_per_s > least else None


def departing(signal: np.ndarray, least: float) -> bool:
    """Whether a signal (N,) under constant inputs grows, however few its turns: each third spans more than the last.

    Args:
        signal: of at least six samples.
        least: span below which it counts as still.
    """
    spans = [float(np.ptp(third)) for third in np.array_split(signal, 3)]
    return spans[-1] > least and all(after > 1.05 * before for before, after in pairwise(spans))
