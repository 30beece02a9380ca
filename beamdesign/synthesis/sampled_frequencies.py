"""Frequencies at which a search samples loops, of a rig as quick as the published one, and about its sharp poles."""

from collections.abc import Sequence
from itertools import product
from math import pi

import numpy as np

from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import exact, roots
from beamdesign.synthesis.loop_samples import ends

COARSE_HZ = np.concatenate(
    [np.geomspace(0.05, 5, 25), np.geomspace(5.3, 150, 130), np.geomspace(155, 1e3, 25), [3e3, 1e4, 1e5]]
)
FINE_HZ = np.concatenate(
    [
        np.geomspace(0.01, 0.98, 20),
        np.geomspace(1, 4.9, 80),
        np.geomspace(5, 60, 250),
        np.geomspace(61, 150, 60),
        np.geomspace(153, 1200, 60),
        np.geomspace(1300, 1e5, 10),
    ]
)
"""Fine where peaks may be sharp; far above everything, the law's effort still grows."""

MODES_HZ = np.geomspace(155.0, 700.0, 100)
"""Further samples of rigs with effects, among which may be a second mode."""

_ABOUT = np.geomspace(0.25, 8, 6)
"""At how many damping ratios from a pole, as logarithms of frequency."""

_SHARP = (1e-6, 0.1)
"""Damping ratios of poles about which samples tell more."""


def about_poles_Hz(
    members: Sequence[VertexModel], frequency_Hz: np.ndarray, outer_kg: Sequence[float], inner_kg: Sequence[float]
) -> np.ndarray:
    """Frequencies about those poles of a rig whose resonance would pass between others.

    Args:
        members: linear members of the rig.
        frequency_Hz: (f,) the others, ascending.
        outer_kg: outer end masses.
        inner_kg: masses inside.
    """
    found = [np.zeros(0)]
    for (rig, *_), inner, outer in product(ends(members), inner_kg, outer_kg):
        for pole in roots(rig.polynomials().at(inner).denominator.at(exact(outer))):
            at, damping = abs(pole) / (2 * pi), -pole.real / abs(pole)
            k = int(np.searchsorted(frequency_Hz, at).clip(1, len(frequency_Hz) - 1))
            apart = np.log(frequency_Hz[k] / frequency_Hz[k - 1])
            if pole.imag > 0 and _SHARP[0] < damping < min(apart, _SHARP[1]):
                found += [at * np.exp(damping * _ABOUT), at * np.exp(-damping * _ABOUT)]
    return np.concatenate(found)
