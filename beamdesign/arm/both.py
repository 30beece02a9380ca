"""Both planes at once: a payload off to both sides couples them through torsion, and its mass enters squared.

The tip moves by u_y and u_z and turns by phi; the payload's velocity has the components w . (u_y', u_z', phi') with
w = (kappa, 0, -a_z) in y, (0, kappa, a_y) in z and -(lambda_y, lambda_z, 0) along the beam, in the terms of
`beamdesign.arm.plane`. With the impedances p / q of the two loops and t of torsion, the characteristic polynomial is

    q_y q_z det(diag(p_y / q_y, p_z / q_z, t) + m s^2 A),    A the sum of the three w w^T,

whose coefficient of m^k is the sum over the principal minors of A of order k. A is of rank two: the three w lie in a
plane, since there is a motion of the end that leaves the payload's centre where it is. Stability over the mass is
proved by zero exclusion in ball arithmetic, as for boxes of tolerances; all else is worked out at single masses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.arm.figures import arm_of
from beamdesign.arm.plane import PLANES, PlaneFigures, plane_figures, single_loop
from beamdesign.loop import Loop
from beamdesign.polynomial import exact, roots
from beamdesign.proof.box import BoxVerdict, box_of, certify_box
from beamdesign.proof.rational import text
from beamdesign.proof.rig_family import Family
from beamdesign.prototype import Prototype

MASS = "outer_end_mass"
BUDGET = 20_000


@dataclass(frozen=True)
class BothPlanes:
    """The arm with both loops closed.

    Attributes:
        name: of the prototype.
        y: figures of the payload in the plane y.
        z: likewise.
        loops: of the two planes without offset.
    """

    name: str
    y: PlaneFigures
    z: PlaneFigures
    loops: tuple[Loop, Loop]

    @property
    def torsion(self) -> fmpq_poly:
        """Torsion of the outer beam's end, k + b s + I s^2."""
        return fmpq_poly([self.y.torsional_stiffness, self.y.torsional_damping, self.y.polar_inertia])

    @property
    def motions(self) -> fmpq_mat:
        """Motion of the payload's centre in x, y, z per u_y, u_z and phi, (3, 3)."""
        zero = fmpq(0)
        rows = [
            [-self.y.along, -self.z.along, zero],
            [self.y.travel, zero, self.y.lever],
            [zero, self.z.travel, self.z.lever],
        ]
        return fmpq_mat(3, 3, [entry for row in rows for entry in row])

    @cached_property
    def powers(self) -> tuple[fmpq_poly, ...]:
        """The characteristic polynomial: coefficients of m^0, m^1, m^2, polynomials in s."""
        motions = self.motions
        inertia = motions.transpose() * motions
        free = [loop.characteristic.constant for loop in self.loops] + [self.torsion]
        loaded = [fmpq_poly([0, 0, 1]) * loop.disturbance for loop in self.loops] + [fmpq_poly([0, 0, 1])]
        found = []
        for order in range(3):
            total = fmpq_poly([0])
            for chosen in combinations(range(3), order):
                term = fmpq_poly([minor(inertia, chosen)])
                for i in range(3):
                    term = term * (loaded[i] if i in chosen else free[i])
                total = total + term
            found.append(total)
        return tuple(found)

    def at(self, payload: float) -> fmpq_poly:
        """The characteristic polynomial at one payload, kg."""
        mass = exact(payload)
        return sum((mass**k * power for k, power in enumerate(self.powers)), fmpq_poly([0]))

    def poles(self, payload: float) -> np.ndarray:
        """Closed-loop poles at one payload, rad/s."""
        return roots(self.at(payload))

    def response(self, payload: float, frequency_Hz: np.ndarray, servo: bool = True) -> np.ndarray:
        """Motion (x, y, z and roll) of the payload's centre per force on it in x, y, z, by the modes of this model.

        Args:
            payload: kg.
            frequency_Hz: (N,).
            servo: with the loops closed, or with no current in the valves.

        Returns:
            (N, 4, 3), m/N and rad/N, complex.
        """
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        motions = np.array([[float(entry.p) / float(entry.q) for entry in row] for row in self.motions.tolist()])
        stiffness = np.zeros((len(s), 3, 3), dtype=complex)
        for i, loop in enumerate(self.loops):
            family = loop.characteristic if servo else loop.opened
            stiffness[:, i, i] = _values(family.constant, s) / _values(loop.disturbance, s)
        stiffness[:, 2, 2] = _values(self.torsion, s)
        stiffness += payload * (s**2)[:, None, None] * (motions.T @ motions)
        there = np.vstack([motions, [0.0, 0.0, 1.0]])
        return there @ np.linalg.solve(stiffness, np.broadcast_to(motions.T, stiffness.shape))

    def prove(self, low_kg: float, high_kg: float, budget: int = BUDGET) -> BoxVerdict:
        """Prove or refute stability for every payload of a range, in ball arithmetic; may stay undecided."""
        terms = [
            f"({text(c) if c.q == 1 else f'{c.p}/{c.q}'})*s**{i}*{MASS}**{k}"
            for k, power in enumerate(self.powers)
            for i, c in enumerate(power.coeffs())
            if c != 0
        ]
        family = Family(f"{self.name}, both planes", " + ".join(terms), {MASS: exact(low_kg)}, positive=True)
        return certify_box(family, box_of({MASS: (low_kg, high_kg)}), budget, volumes=False)


def minor(matrix: fmpq_mat, chosen: Sequence[int]) -> fmpq:
    """The principal minor of some rows and columns; one of none."""
    if not chosen:
        return fmpq(1)
    n = len(chosen)
    return fmpq(fmpq_mat(n, n, [matrix[i, j] for i in chosen for j in chosen]).det())


def both_planes(prototype: Prototype) -> BothPlanes:
    """Both loops of a prototype with its payload where it is.

    Raises:
        InputError: as `beamdesign.arm.plane.single_loop` and `beamdesign.arm.figures.arm_figures`.
    """
    y, z = (plane_figures(prototype, name) for name in PLANES)
    return BothPlanes(prototype.name, y, z, (single_loop(prototype, "y"), single_loop(prototype, "z")))


def couples_both(prototype: Prototype) -> bool:
    """Whether the payload stands off to both sides."""
    _, y, z = arm_of(prototype).offset_m
    return y != 0 and z != 0


def _values(polynomial: fmpq_poly, s: np.ndarray) -> np.ndarray:
    return np.asarray(np.polyval([float(c.p) / float(c.q) for c in reversed(polynomial.coeffs())], s))
