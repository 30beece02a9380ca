"""Frequencies at which a search samples loops, of a rig as quick as the published one, and about its sharp poles."""

from collections.abc import Sequence
from itertools import product
from math import ceil, pi

import numpy as np

from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import exact, roots
from beamdesign.synthesis.loop_samples import ends

COARSE_HZ = np.concatenate(
    [np.geomspace(0.05, 5, 25), np.geomspace(5.3, 150, 130), np.geomspace(155, 1e3, 25), [3e3, 1e4, 1e5]]
)
_FINE = ((0.01, 0.98, 20), (1, 4.9, 80), (5, 60, 250), (61, 150, 60), (153, 1200, 60), (1300, 1e5, 10))
FINE_HZ = np.concatenate([np.geomspace(*part) for part in _FINE])
"""Fine where peaks may be sharp; far above everything, the law's effort still grows."""

MODES_HZ = np.geomspace(155.0, 700.0, 100)
"""Further samples of rigs with effects, among which may be a second mode."""

_SHARP = (1e-6, 0.1)
"""Least and largest damping ratio of a pole about which more samples tell more."""

_MASSES = 7
"""For how many masses inside poles are worked out, between which they move."""

_BEYOND, _MOST = 4.0, 300
"""By how many damping ratios (logarithm of frequency) samples go beyond a pole, and how many there are at most."""


def about_poles_Hz(
    members: Sequence[VertexModel], frequency_Hz: np.ndarray, outer_kg: Sequence[float], inner_kg: tuple[float, float]
) -> np.ndarray:
    """Frequencies wherever such poles may be whose resonances would pass between others.

    Args:
        members: linear members of the rig.
        frequency_Hz: (f,) the others, ascending.
        outer_kg: outer end masses.
        inner_kg: least and most mass inside.
    """
    masses, found = np.unique(np.linspace(*inner_kg, _MASSES)), [np.zeros(0)]
    for (rig, *_), outer in product(ends(members), outer_kg):
        each = [roots(rig.polynomials().at(inner).denominator.at(exact(outer))) for inner in masses]
        pairs = [sorted(poles[poles.imag > 0], key=abs) for poles in each]
        for moving in map(np.array, zip(*pairs, strict=False)):
            at, damping = np.abs(moving) / (2 * pi), float((-moving.real / np.abs(moving)).min())
            k = np.searchsorted(frequency_Hz, at).clip(1, len(frequency_Hz) - 1)
            apart = float(np.log(frequency_Hz[k] / frequency_Hz[k - 1]).max())
            if _SHARP[0] < damping < min(apart, _SHARP[1]):
                low, high = np.log([at.min(), at.max()]) + _BEYOND * damping * np.array([-1.0, 1.0])
                count = min(_MOST, 1 + ceil((high - low) / damping))
                found.append(np.exp(np.linspace(low, high, count)))
    return np.concatenate(found)
