"""Where a loop comes nearest to its limits, by sampling: check points for an optimiser, and no proof of anything."""

import numpy as np

from beamdesign.loop import Loop, LoopAtMass
from beamdesign.proof.performance import Kind

SHARES = np.linspace(0.0, 1.0, 5)
"""Masses, as shares of the range, that are looked at."""

LIMITED: tuple[Kind, ...] = ("peak_sensitivity", "loop_gain", "controller_effort")
"""Magnitudes of which an optimiser enforces a limit at check points."""


def magnitude(loop: LoopAtMass, kind: Kind, frequency_Hz: np.ndarray) -> np.ndarray:
    """|S|, |L| or |C S| at the given frequencies."""
    match kind:
        case "peak_sensitivity":
            return np.abs(loop.sensitivity_response(frequency_Hz))
        case "loop_gain":
            return np.abs(loop.loop_response(frequency_Hz))
        case "controller_effort":
            return np.abs(loop.effort_response(frequency_Hz))
    raise ValueError(f"no limit of {kind} is enforced at check points")


def peak_near(
    loop: Loop, kind: Kind, frequency_Hz: float, mass: float, low: float, high: float, from_Hz: float = 0.0
) -> tuple[float, float]:
    """Frequency and mass of the peak that a point lies on, by small grids that climb and zoom in."""
    for spread in (0.03, 0.03, 0.03, 0.01, 0.003):
        frequencies = np.maximum(frequency_Hz * np.geomspace(1 / (1 + spread), 1 + spread, 21), from_Hz)
        masses = np.unique(np.clip(mass + spread * (high - low) * np.linspace(-3, 3, 7), low, high))
        peaks = np.array([magnitude(loop.at(float(value)), kind, frequencies) for value in masses])
        i, j = np.unravel_index(int(peaks.argmax()), peaks.shape)
        frequency_Hz, mass = float(frequencies[j]), float(masses[i])
    return frequency_Hz, mass


def largest_sampled(
    loop: Loop, kind: Kind, low: float, high: float, from_Hz: float = 0.0
) -> tuple[float, float, float]:
    """Largest magnitude on a coarse grid, its frequency and mass; a proof's witness need not be near the worst peak."""
    start, end = (1.0, 400.0) if kind == "peak_sensitivity" else (max(from_Hz, 1.0), max(4 * from_Hz, 2000.0))
    frequencies, masses = np.geomspace(start, end, 400), low + SHARES * (high - low)
    peaks = np.array([magnitude(loop.at(float(mass)), kind, frequencies) for mass in masses])
    i, j = np.unravel_index(int(peaks.argmax()), peaks.shape)
    return float(peaks[i, j]), float(frequencies[j]), float(masses[i])


def high_peaks(loop: Loop, low: float, high: float, least: float) -> list[tuple[float, float]]:
    """Frequencies and masses of all sampled peaks of the sensitivity above a value."""
    found = []
    frequencies = np.geomspace(1.0, 400.0, 1200)
    for mass in np.unique(low + SHARES * (high - low)):
        size = magnitude(loop.at(float(mass)), "peak_sensitivity", frequencies)
        inner = size[1:-1]
        peaks = (inner > size[:-2]) & (inner >= size[2:]) & (inner > least)
        found += [(float(frequency), float(mass)) for frequency in frequencies[1:-1][peaks]]
    return found
