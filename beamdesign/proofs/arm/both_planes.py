"""Both planes at once: a payload off to both sides couples them through torsion, and its mass enters squared.

The tip moves by u_y and u_z and turns by phi; the payload's velocity has the components w . (u_y', u_z', phi') with
w = (kappa, 0, -a_z) in y, (0, kappa, a_y) in z and -(lambda_y, lambda_z, 0) along the beam, in the terms of
`beamdesign.proofs.arm`. With the impedances p / q of the two loops and t of torsion, the characteristic
polynomial is

    q_y q_z det(diag(p_y / q_y, p_z / q_z, t) + m s^2 A),    A the sum of the three w w^T,

where the servos measure at the tip; elsewhere the rows of u_y and u_z have what they see of the other motions. A is of
rank two: the three w lie in a plane, since there is a motion of the end that leaves the payload's centre where it is.
Stability over the mass is proved by zero exclusion in ball arithmetic, as for boxes of tolerances; all else is worked
out at single masses.

With the payload's place as parameters it is the same determinant, with kappa = 1 + 3 a_x / 2L and lambda = 3 a / 2L. It
depends on the offset a_x along the beam and, by symmetry, on the squares a_y^2 and a_z^2 of those to the sides. Where
a_z is zero throughout, the planes part and each is proved by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly, fmpz

from beamdesign.loop import Loop
from beamdesign.polynomial import at_points, exact, in_variable, nearest, roots, text
from beamdesign.proofs.arm import single_loop
from beamdesign.proofs.arm.remaining import Vector
from beamdesign.proofs.box import BoxVerdict, box_of, certify_box
from beamdesign.proofs.mass_family import floats
from beamdesign.proofs.statement import PolynomialFamily, written
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.structure.arm import PLANES, PlaneFigures, arm_figures, arm_of, plane_figures, sensor_of

MASS = "outer_end_mass"
BUDGET = 20_000
"""Most pieces to look at."""


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
    def motions(self) -> fmpq_mat:
        """Motion of the payload's centre in x, y, z per u_y, u_z and phi, (3, 3)."""
        zero = fmpq(0)
        return fmpq_mat([
            [-self.y.along, -self.z.along, zero],
            [self.y.travel, zero, self.y.lever],
            [zero, self.z.travel, self.z.lever],
        ])  # fmt: skip

    @property
    def sensed(self) -> fmpq_mat:
        """What the servos in y and z measure per u_y, u_z and phi, (2, 3)."""
        y, z, zero = self.y, self.z, fmpq(0)
        return fmpq_mat(2, 3, [y.sensed_travel, zero, y.sensed_lever, zero, z.sensed_travel, z.sensed_lever])

    def equilibrium(self, mass: Any, s: Any, motions: Sequence[Sequence[Any]] = ()) -> list[list[Any]]:
        """Of u_y, u_z and phi with a payload (kg); the first two rows times the denominators of their loops, (3, 3).

        Args:
            mass: the payload, a number or a polynomial in parameters.
            s: the variable, of polynomials in it alone or in parameters too.
            motions: of the payload's centre in the place of its own, likewise.
        """
        motions = motions or self.motions.tolist()
        sensed, scales = self.sensed, [*(in_variable(loop.disturbance, s) for loop in self.loops), 1]
        rows = [[mass * sum(w[i] * w[j] for w in motions) * s**2 * scales[i] for j in range(3)] for i in range(3)]
        for i, loop in enumerate(self.loops):
            rows[i][i] += in_variable(loop.cut.constant, s)
            for j in range(3):
                rows[i][j] += sensed[i, j] * in_variable((loop.loop_numerator - loop.added).constant, s)
        rows[2][2] += in_variable(self.y.twist, s)
        return rows

    def at(self, payload: float) -> fmpq_poly:
        """The characteristic polynomial at one payload, kg."""
        return _determinant(self.equilibrium(exact(payload), fmpq_poly([0, 1])))

    def poles(self, payload: float) -> np.ndarray:
        """Closed-loop poles at one payload, rad/s."""
        return roots(self.at(payload))

    def response(self, payload: float, frequency_Hz: np.ndarray, servo: bool = True) -> np.ndarray:
        """Motion (x, y, z and roll) of the payload's centre per force on it in x, y, z.

        Args:
            payload: kg.
            frequency_Hz: (N,).
            servo: with the loops closed, or with no current in the valves.

        Returns:
            (N, 4, 3), m/N and rad/N, complex.
        """
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        y, z = self.loops if servo else (loop.scaled(fmpq(0)) for loop in self.loops)
        rows = replace(self, loops=(y, z)).equilibrium(exact(payload), fmpq_poly([0, 1]))
        stiffness = np.array([[at_points(entry, s) for entry in row] for row in rows])
        motions = floats(self.motions)
        force = np.multiply.outer(motions.T, np.ones_like(s))
        for i, (loop, plane) in enumerate(((y, self.y), (z, self.z))):
            force[i] *= at_points(loop.disturbance, s)  # as its row of the stiffness is
            fed = at_points((loop.loop_numerator - loop.added).constant, s)
            force[i, 1 + i] -= fed * nearest(plane.sensed_residual)
        there = np.vstack([motions, [0.0, 0.0, 1.0]])
        moved = there @ np.linalg.solve(np.moveaxis(stiffness, 2, 0), np.moveaxis(force, 2, 0))
        moved[:, (1, 2), (1, 2)] += nearest(self.z.residual)
        return moved

    def prove(self, low_kg: float, high_kg: float) -> BoxVerdict:
        """Prove or refute stability for every payload of a range, in ball arithmetic; may stay undecided."""
        s, mass = fmpq_mpoly_ctx.get(["s", MASS], "lex").gens()
        whole = written(_determinant(self.equilibrium(mass, s)))
        family = PolynomialFamily(f"{self.name}, both planes", whole, {MASS: exact(low_kg)}, positive=(MASS,))
        return certify_box(family, box_of({MASS: (low_kg, high_kg)}), BUDGET, volumes=False)


def _determinant(rows: Sequence[Sequence[Any]]) -> Any:
    (a, b, c), (d, e, f), (g, h, k) = rows
    return a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)


def both_planes(prototype: Prototype) -> BothPlanes:
    """Both loops of a prototype with its payload where it is.

    Raises:
        InputError: as `beamdesign.proofs.arm.single_loop` and `beamdesign.proofs.arm.arm_figures`.
    """
    y, z = (plane_figures(prototype, name) for name in PLANES)
    return BothPlanes(prototype.name, y, z, (single_loop(prototype, "y"), single_loop(prototype, "z")))


# Both planes with the payload anywhere within bounds.


NAMES = (MASS, "along_m", "sideways_squared_m2", "upwards_squared_m2")
"""Parameters: payload (kg), a_x, a_y^2 and a_z^2."""


def prove_anywhere(prototype: Prototype, masses: tuple[float, float], within: Vector) -> dict[str, BoxVerdict]:
    """Prove or refute stability for every payload of a range and every place of its centre.

    Args:
        prototype: with the nominal place in its [arm].
        masses: range of payloads, kg.
        within: how far the centre may be from there along x, y and z, either way, m.

    Returns:
        One verdict for both planes ("both"), or one each ("y", "z") where the centre stays at z = 0. It may be None.

    Raises:
        InputError: as `both_planes`, and for servos that measure elsewhere than at the tip.
        ValueError: for a negative bound.
    """
    if any(sensor_of(prototype)):
        reason = "a payload anywhere is proved for servos that measure at the tip; remove it"
        raise InputError(prototype.name, [("arm.sensor_m", reason)])
    if min(within) < 0:
        raise ValueError(f"a distance must not be negative, is {min(within):g}")
    centre = [exact(value) for value in arm_of(prototype).offset_m]
    reach = [exact(value) for value in within]
    x, y, z = ((middle - far, middle + far) for middle, far in zip(centre, reach, strict=True))
    ranges = {MASS: (exact(masses[0]), exact(masses[1])), NAMES[1]: x, NAMES[2]: _squared(*y), NAMES[3]: _squared(*z)}
    known: dict[str | int, int | fmpz | fmpq] = {name: low for name, (low, high) in ranges.items() if low == high}
    stands = "".join(f", {name} {text(low)}" for name, (low, _) in ranges.items() if name in known)
    found = {}
    for name, whole in _characteristic(prototype, z == (0, 0)).items():
        polynomial = whole.subs(known)
        own = {key: ranges[key] for key, degree in zip(NAMES, polynomial.degrees()[1:], strict=True) if degree}
        planes = "both planes" if name == "both" else f"plane {name}"
        family = PolynomialFamily(
            f"{prototype.name}, payload anywhere, {planes}{stands}",
            written(polynomial),
            {key: (low + high) / 2 for key, (low, high) in own.items()},
        )
        found[name] = certify_box(family, box_of(own), BUDGET, volumes=False)
    return found


def _squared(low: fmpq, high: fmpq) -> tuple[fmpq, fmpq]:
    """Range of the square of what lies in a range."""
    ends = low * low, high * high
    return (fmpq(0) if low <= 0 <= high else min(ends)), max(ends)


def _characteristic(prototype: Prototype, level: bool) -> dict[str, fmpq_mpoly]:
    """In s and the parameters, of both planes or, for a payload at z = 0, of each."""
    model, turning = both_planes(prototype), fmpq(3, 2) / exact(arm_figures(prototype).length)
    context = fmpq_mpoly_ctx.get(["s", *NAMES], "lex")
    s, mass, x, y, z = context.gens()  # the last two stand for a_y and a_z at first
    travel, none = 1 + turning * x, 0 * x
    z = none if level else z
    rows = model.equilibrium(mass, s, [[-turning * y, -turning * z, none], [travel, none, -z], [none, travel, y]])
    of_z = rows[1][1] * rows[2][2] - rows[1][2] * rows[2][1]
    found = {"y": rows[0][0], "z": of_z} if level else {"both": _determinant(rows)}
    return {
        name: context.from_dict({(*powers[:3], *(k // 2 for k in powers[3:])): c for powers, c in whole.terms()})
        for name, whole in found.items()
    }
