"""Sampled, floating-point guesses of the best figures: where the search for the best proved ones begins.

Nothing here is proved, and no proof rests on it; a poor guess only costs further proofs.
"""

import numpy as np
from flint import fmpq

from beamdesign.certify.rational import nearest
from beamdesign.loop import Loop
from beamdesign.polynomial import Affine, exact, roots

_FREQUENCIES = np.geomspace(1e-1, 1e5, 400)  # rad/s
_ZOOMS, _POINTS = 4, 21


def sampled_masses(low: fmpq, high: fmpq) -> list[float]:
    """Five masses of a range, ends included; one where the ends agree."""
    return sorted({float(mass) for mass in np.linspace(nearest(low), nearest(high), 5)})


def peak_sensitivity(loop: Loop, low: fmpq, high: fmpq) -> float:
    """Largest |S| seen over sampled masses, near the poles and on a grid of frequencies, then on finer ones."""
    best = 1.0
    for mass in sampled_masses(low, high):
        top, bottom = (_floats(family, mass) for family in (loop.opened, loop.characteristic))
        frequencies = np.concatenate([_FREQUENCIES, np.abs(np.roots(bottom))])
        spread = 1.05
        for _ in range(_ZOOMS):
            values = np.abs(np.polyval(top, 1j * frequencies) / np.polyval(bottom, 1j * frequencies))
            best = max(best, float(values.max()))
            peak = frequencies[values.argmax()]
            frequencies = np.geomspace(peak / spread, peak * spread, _POINTS)
            spread = spread ** (2 / _POINTS)
    return best


def decay_rate(loop: Loop, low: fmpq, high: fmpq) -> float:
    """Slowest decay of any pole over sampled masses, 1/s."""
    return min(-float(roots(loop.characteristic.at(exact(mass))).real.max()) for mass in sampled_masses(low, high))


def gain_margin(loop: Loop, low: fmpq, high: fmpq) -> float:
    """Least factor above one at which a sampled mass has a root on the axis; infinite where there is none."""
    crossings = [c.value for mass in sampled_masses(low, high) for c in loop.at(mass).gain_crossings()]
    return min((value for value in crossings if value > 1), default=np.inf)


def _floats(family: Affine, mass: float) -> np.ndarray:
    """Coefficients at one mass, highest power first."""
    return np.array([nearest(value) for value in reversed(family.at(exact(mass)).coeffs())])
