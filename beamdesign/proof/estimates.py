"""Sampled, floating-point guesses of the best figures: where the search for the best proved ones begins.

Nothing here is proved, and no proof rests on it; a poor guess only costs further proofs.
"""

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.polynomial import Affine
from beamdesign.proof.rational import nearest

_FREQUENCIES = np.geomspace(1e-1, 1e5, 400)  # rad/s
_ZOOMS, _POINTS = 4, 21
_CLIMBS, _SHRINK = 14, 0.4
_CLIMBED = 1e-5
"""Relative gain below which climbing along the masses ends."""


def sampled_masses(low: fmpq, high: fmpq) -> list[float]:
    """Five masses of a range, ends included; one where the ends agree."""
    return sorted({float(mass) for mass in np.linspace(nearest(low), nearest(high), 5)})


def peak_sensitivity(opened: Affine, returned: Affine, low: fmpq, high: fmpq) -> float:
    """Largest |S| seen over sampled masses, near the poles and on a grid of frequencies, then on finer ones of both."""
    parts = (opened.constant, opened.slope, returned.constant, returned.slope)
    degree = max(polynomial.degree() for polynomial in parts)
    constant, slope, fed_back, fed_back_slope = (_floats(part, degree) for part in parts)

    def seen(masses: np.ndarray, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest |S| of each mass over its row of frequencies, and where."""
        s = 1j * frequencies
        below = np.polyval(constant, s) + masses[:, None] * np.polyval(slope, s)
        above = np.polyval(fed_back, s) + masses[:, None] * np.polyval(fed_back_slope, s)
        values = np.abs(below / (below + above))
        rows, columns = np.arange(len(masses)), values.argmax(axis=1)
        return values[rows, columns], frequencies[rows, columns]

    def with_poles(masses: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
        """The frequencies, and for each mass those of its poles."""
        closed = constant + fed_back + masses[:, None] * (slope + fed_back_slope)
        companions = np.zeros((len(masses), degree, degree))
        companions[:, :1] = -closed[:, None, 1:] / closed[:, None, :1]
        companions[:, 1:, :-1] = np.eye(max(degree - 1, 0))
        poles = np.abs(np.linalg.eigvals(companions))
        return np.hstack([np.broadcast_to(frequencies, (len(masses), len(frequencies))), poles])

    masses = np.array(sampled_masses(low, high))
    ends = masses[0], masses[-1]
    peaks, at = seen(masses, with_poles(masses, _FREQUENCIES))
    spread = 1.05
    for _ in range(_ZOOMS - 1):
        finer, at = seen(masses, at[:, None] * np.geomspace(1 / spread, spread, _POINTS))
        peaks, spread = np.maximum(peaks, finer), spread ** (2 / _POINTS)
    # From the best mass on, climb along the masses: a sharp peak may lie between the sampled ones.
    best, mass, frequency = (float(values[peaks.argmax()]) for values in (peaks, masses, at))
    reach, spread = float(ends[1] - ends[0]) / 8, 1.02
    stalled = 0
    for _ in range(_CLIMBS if reach > 0 else 0):
        masses = np.unique(np.clip(mass + reach * np.linspace(-1, 1, 5), *ends))
        peaks, at = seen(masses, with_poles(masses, frequency * np.geomspace(1 / spread, spread, _POINTS)))
        stalled = 0 if peaks.max() > best * (1 + _CLIMBED) else stalled + 1
        if peaks.max() > best:
            best, mass, frequency = (float(values[peaks.argmax()]) for values in (peaks, masses, at))
        if stalled and (stalled > 1 or mass in ends):
            break
        reach, spread = reach * _SHRINK, spread**_SHRINK
    return max(best, 1.0)


def largest_ratio(above: Affine, below: Affine, from_Hz: float, low: fmpq, high: fmpq) -> float:
    """Largest |above / below| seen from a frequency up, over sampled masses and frequencies."""
    start, count = (2 * np.pi * from_Hz, 2000) if from_Hz else (1e-2, 3000)
    s = 1j * np.geomspace(start, 1e6, count)
    degree = max(p.degree() for family in (above, below) for p in (family.constant, family.slope))
    values = [np.polyval(_floats(p, degree), s) for p in (above.constant, above.slope, below.constant, below.slope)]
    return max(
        float(np.abs((values[0] + mass * values[1]) / (values[2] + mass * values[3])).max())
        for mass in sampled_masses(low, high)
    )


def _floats(polynomial: fmpq_poly, degree: int) -> np.ndarray:
    """Coefficients from that of the given degree down."""
    return np.array([nearest(polynomial[power]) for power in range(degree, -1, -1)])
