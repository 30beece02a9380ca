"""The alternatives on grids of outer end masses: closed-loop eigenvalues in numpy, and margins in python-control.

Eigenvalues are of all masses in one batch. Margins are taken at one mass after another, and responses on a frequency
grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import control
import numpy as np
from flint import fmpq

from beamdesign.controllers import Lag, Proportional
from beamdesign.plant.linear import LinearModel
from beamdesign.proofs.mass_family import floats
from beamdesign.synthesis.loop_samples import first_miss

FREQUENCIES_HZ = np.geomspace(0.1, 1000.0, 401)
"""A hundred points a decade, as one would plot them."""


@dataclass(frozen=True)
class Matrices:
    """A rig's matrices in E x' = A x + B u, y = C x, E affine in both end masses.

    Attributes:
        bare: (n, n), E without end masses.
        outer: (n, n), what 1 kg on the outer tip adds.
        inner: (n, n), what 1 kg on the inner tip adds.
        a: (n, n).
        b: (n, 2), force and current.
        c: (2, n), displacement and sensor voltage.
    """

    bare: np.ndarray
    outer: np.ndarray
    inner: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def plants(self, masses_kg: np.ndarray, inner_end_mass_kg: float) -> tuple[np.ndarray, np.ndarray]:
        """A (m, n, n) and B (m, n, 2) of x' = A x + B u at every outer end mass."""
        e = self.bare + inner_end_mass_kg * self.inner + masses_kg[:, None, None] * self.outer
        right = np.hstack([self.a, self.b])
        solved = np.linalg.solve(e, np.broadcast_to(right, (len(e), *right.shape)))
        return solved[:, :, :-2], solved[:, :, -2:]


def matrices(rig: LinearModel) -> Matrices:
    """The rig's matrices, derived once for all masses."""
    (e, a, b, c), (outer, *_), (inner, *_) = (
        [floats(matrix) for matrix in rig.exact_matrices(fmpq(m), fmpq(n))] for m, n in ((0, 0), (1, 0), (0, 1))
    )
    return Matrices(e, outer - e, inner - e, a, b, c[:2])


def realised(controller: Proportional | Lag) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """A controller's state matrices (k, k), (k, 1), (1, k) and its direct gain, from volts to amperes."""
    if isinstance(controller, Proportional):
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), controller.gain_A_per_V
    through = controller.gain_A_per_V * controller.pole_Hz / controller.zero_Hz
    pole = 2 * pi * controller.pole_Hz
    return np.array([[-pole]]), np.array([[1.0]]), np.array([[pole * (controller.gain_A_per_V - through)]]), through


def closed_loops(
    rig: Matrices, controller: Proportional | Lag, inner_end_mass_kg: float, masses_kg: np.ndarray
) -> np.ndarray:
    """(m, n, n) closed-loop matrices at every outer end mass, equation (12)."""
    plants, inputs = rig.plants(masses_kg, inner_end_mass_kg)
    a, b, c, through = realised(controller)
    n, k = len(rig.a), len(a)
    current, sensor = inputs[:, :, 1:], rig.c[1:]
    loops = np.empty((len(masses_kg), n + k, n + k))
    loops[:, :n, :n] = plants - through * current @ sensor
    loops[:, :n, n:] = current @ c
    loops[:, n:, :n] = -b @ sensor
    loops[:, n:, n:] = a
    return loops


def growth(loops: np.ndarray) -> np.ndarray:
    """(m,) largest real part of any eigenvalue, 1/s."""
    return np.linalg.eigvals(loops).real.max(axis=1)


def stable_stretches(masses_kg: np.ndarray, stable: np.ndarray) -> list[tuple[float, float]]:
    """Stretches of the grid that read stable; an edge is put half-way to the neighbour that does not."""
    edges = np.nonzero(np.diff(stable.astype(int)))[0]
    cuts = (masses_kg[edges] + masses_kg[edges + 1]) / 2
    ends = [float(masses_kg[0]), *map(float, cuts), float(masses_kg[-1])]
    first = 0 if stable[0] else 1
    return [(ends[i], ends[i + 1]) for i in range(first, len(ends) - 1, 2)]


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
