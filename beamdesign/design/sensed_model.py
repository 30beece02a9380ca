"""State space of a rig whose controller reads several sensors, in floats: what laws are synthesised on.

The inner tip's displacement and the load pressure are states of the rig, or sums of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from beamdesign.controllers import SENSED, Sensed
from beamdesign.linear import LinearModel
from beamdesign.rig.linearised import SEEN


@dataclass(frozen=True)
class SensedModel:
    """x' = a x + b u, y = c x at one pair of end masses, SI.

    Attributes:
        a: (n, n).
        b: (n, 2) of tip force (N) and current (A).
        c: (1 + p, n): the tip's displacement (m), then what the p sensors give (V, m, Pa).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def responses(self, frequency_Hz: np.ndarray) -> np.ndarray:
        """(f, 1 + p, 2) from inputs to outputs, complex."""
        s = 2j * pi * np.asarray(frequency_Hz, dtype=float)
        inside = np.linalg.solve(s[:, None, None] * np.eye(len(self.a)) - self.a, self.b[None].astype(complex))
        return np.asarray(self.c @ inside)


def sensed_model(
    rig: LinearModel, outer_end_mass: float, inner_end_mass: float, sensors: Sequence[Sensed] = SENSED[:1]
) -> SensedModel:
    """State space of a rig with its sensors.

    Args:
        rig: of a prototype, or of one of its linear members.
        outer_end_mass: kg.
        inner_end_mass: kg.
        sensors: of `beamdesign.controllers.SENSED`, the displacement first.

    Raises:
        ValueError: without the displacement in the first place.
    """
    a, b, c = rig.matrices(outer_end_mass, inner_end_mass)
    if not sensors or sensors[0] != SENSED[0]:
        raise ValueError("the first sensor is that of the outer tip's displacement")
    return SensedModel(a, b, c[[0, 1, *(SEEN.index(name) for name in sensors[1:])]])
