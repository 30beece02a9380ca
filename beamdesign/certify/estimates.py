"""Sampled, floating-point guesses of the best figures: where the search for the best proved ones begins.

Nothing here is proved, and no proof rests on it; a poor guess only costs further proofs.
"""

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.certify.rational import nearest
from beamdesign.loop import Loop
from beamdesign.polynomial import exact, roots

_FREQUENCIES = np.geomspace(1e-1, 1e5, 400)  # rad/s
_ZOOMS, _POINTS = 4, 21


def sampled_masses(low: fmpq, high: fmpq) -> list[float]:
    """Five masses of a range, ends included; one where the ends agree."""
    return sorted({float(mass) for mass in np.linspace(nearest(low), nearest(high), 5)})


def peak_sensitivity(loop: Loop, low: fmpq, high: fmpq) -> float:
    """Largest |S| seen over sampled masses, near the poles and on a grid of frequencies, then on finer ones."""
    masses = np.array(sampled_masses(low, high))[:, None]
    constant, slope, returned = (_floats(p) for p in (loop.opened.constant, loop.opened.slope, loop.returned))
    families = np.polyadd(constant, returned), slope
    poles = [np.abs(np.roots(np.polyadd(families[0], mass * families[1]))) for mass in masses[:, 0]]
    most = max(len(found) for found in poles)
    near = [np.pad(found, (0, most - len(found)), constant_values=1.0) for found in poles]
    frequencies = np.hstack([np.broadcast_to(_FREQUENCIES, (len(masses), len(_FREQUENCIES))), np.array(near)])
    best, spread = 1.0, 1.05
    for _ in range(_ZOOMS):
        s = 1j * frequencies
        opened = np.polyval(constant, s) + masses * np.polyval(slope, s)
        values = np.abs(opened / (opened + np.polyval(returned, s)))
        best = max(best, float(values.max()))
        peaks = np.take_along_axis(frequencies, values.argmax(axis=1)[:, None], axis=1)
        frequencies = peaks * np.geomspace(1 / spread, spread, _POINTS)
        spread = spread ** (2 / _POINTS)
    return best


def decay_rate(loop: Loop, low: fmpq, high: fmpq) -> float:
    """Slowest decay of any pole over sampled masses, 1/s."""
    return min(-float(roots(loop.characteristic.at(exact(mass))).real.max()) for mass in sampled_masses(low, high))


def gain_margin(loop: Loop, low: fmpq, high: fmpq) -> float:
    """Least factor above one at which a sampled mass has a root on the axis; infinite where there is none."""
    crossings = [c.value for mass in sampled_masses(low, high) for c in loop.at(mass).gain_crossings()]
    return min((value for value in crossings if value > 1), default=np.inf)


def _floats(polynomial: fmpq_poly) -> np.ndarray:
    """Coefficients, highest power first."""
    return np.array([nearest(value) for value in reversed(polynomial.coeffs())])
