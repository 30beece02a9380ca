"""The alternative in python-control: margins at one outer end mass after another, and responses on a frequency grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import control
import numpy as np
from eigenvalue_grid import Matrices, realised

from beamdesign.controllers import Lag, Proportional
from beamdesign.synthesis.loop_samples import first_miss

FREQUENCIES_HZ = np.geomspace(0.1, 1000.0, 401)
"""A hundred points a decade, as one would plot them."""


@dataclass(frozen=True)
class Margins:
    """What `control.stability_margins` says at each outer end mass.

    Attributes:
        gain: (m,) factor on the gain at which the locus passes -1; of several the nearest to 1, which may be one that
            makes an unstable loop stable.
        phase_deg: (m,) phase margin.
        modulus: (m,) least distance of the locus from -1, the inverse of the peak sensitivity of a stable loop.
    """

    gain: np.ndarray
    phase_deg: np.ndarray
    modulus: np.ndarray

    @property
    def read_stable(self) -> np.ndarray:
        """(m,) whether gain margin and phase margin are both on the right side, which is how margins are read."""
        return (self.gain > 1) & (self.phase_deg > 0)


def models(
    rig: Matrices, controller: Proportional | Lag, inner_end_mass_kg: float, masses_kg: np.ndarray
) -> list[control.StateSpace]:
    """The open loop at every mass, from (force, command) to (displacement, sensor voltage)."""
    plants, inputs = rig.plants(masses_kg, inner_end_mass_kg)
    a, b, c, through = realised(controller)
    n, k = len(rig.a), len(a)
    outputs = np.hstack([rig.c, np.zeros((2, k))])
    found = []
    for plant, entered in zip(plants, inputs, strict=True):
        force, current = entered[:, :1], entered[:, 1:]
        dynamics = np.block([[plant, current @ c], [np.zeros((k, n)), a]])
        driven = np.block([[force, current * through], [np.zeros((k, 1)), b]])
        found.append(control.ss(dynamics, driven, outputs, np.zeros((2, 2))))
    return found


def margins(open_loops: Sequence[control.StateSpace]) -> Margins:
    """Classical margins of every open loop."""
    rows = [control.stability_margins(model[1, 1])[:3] for model in open_loops]
    gain, phase, modulus = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    return Margins(gain, phase, modulus)


def responses(open_loops: Sequence[control.StateSpace]) -> tuple[np.ndarray, np.ndarray]:
    """|1 / (1 + L)| and |x / F_d| (m/N) of the closed loop on `FREQUENCIES_HZ`, each (m, f)."""
    sensitivity, compliance = [], []
    for model in open_loops:
        grid = control.frequency_response(model, 2 * pi * FREQUENCIES_HZ).complex
        returned = 1 / (1 + grid[1, 1])
        sensitivity.append(np.abs(returned))
        compliance.append(np.abs(grid[0, 0] - grid[0, 1] * returned * grid[1, 0]))
    return np.array(sensitivity), np.array(compliance)


def last_within(worst: np.ndarray, limit: float) -> float:
    """Bandwidth as it is read off the grid: interpolated where the worst curve first passes the limit, Hz."""
    return min(first_miss(FREQUENCIES_HZ, np.log(limit / worst)), float(FREQUENCIES_HZ[-1]))
