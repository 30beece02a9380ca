"""The closed loop as a family of exact matrices over the outer end mass: x' = A(m) x."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.controllers import SensedLaw
from beamdesign.linear import SEEN_AS, LinearModel
from beamdesign.members import paper_model
from beamdesign.polynomial import Affine, exact
from beamdesign.prototype import Prototype


@dataclass(frozen=True)
class MassFamily:
    """A(m) = fixed + inertial / (bare_mass + m), exact.

    The family is affine in mu = 1 / (bare_mass + m), which runs monotonically with m: a condition that is convex in A
    and free of m otherwise holds on a range of m where it holds at its two ends.

    Attributes:
        fixed: (n, n), free of m.
        inertial: (n, n), what the total mass divides: the forces on the outer tip, in the row of its velocity.
        bare_mass: M_m, kg.
        velocity: index of the state that is the velocity of the mass, which jumps where payload of another velocity
            is taken on.
        states: names of the states.
    """

    fixed: fmpq_mat
    inertial: fmpq_mat
    bare_mass: fmpq
    velocity: int
    states: tuple[str, ...]

    @property
    def order(self) -> int:
        """Number n of states."""
        return self.fixed.nrows()

    def at(self, outer_end_mass: fmpq) -> fmpq_mat:
        """A(m), (n, n)."""
        return self.fixed + self.inertial * (1 / (self.bare_mass + outer_end_mass))

    def characteristic(self) -> Affine:
        """(bare_mass + m) det(sI - A(m)), affine in m since m enters one row of A.

        Raises:
            ValueError: where it is not affine in m.
        """

        def value(mass: int) -> fmpq_poly:
            return self.at(fmpq(mass)).charpoly() * (self.bare_mass + mass)

        constant = value(0)
        slope = value(1) - constant
        if value(2) != constant + 2 * slope:
            raise ValueError("the characteristic polynomial of this family is not affine in the mass")
        return Affine(constant, slope)


Families = Sequence[MassFamily]
"""The closed loop with each of its stages, in the same states; one law that stays is the case of one stage."""


def closed_loop(prototype: Prototype) -> MassFamily:
    """The closed loop of a prototype, equations (7) to (16), over the mass on its outer tip.

    Raises:
        ValueError: where the prototype has no controller, or one whose numerator is of higher degree than its
            denominator.
    """
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    inner = exact(prototype.payload.inner_end_mass_kg)
    return close_with(paper_model(prototype), inner, prototype.controller.sensed_law())


def close_with(rig: LinearModel, inner_end_mass: fmpq, law: SensedLaw) -> MassFamily:
    """Close the loop of a rig with a controller of any order and any number of sensors.

    The controller is realised in observer form, which has as many states as its denominator has roots: with a(s) of
    leading coefficient one, b_j the numerator's remainder for sensor j, d_j its quotient and e_j the error,

        z_i' = z_(i-1) - a_i z_(k-1) + sum_j b_ji e_j,    current = z_(k-1) + sum_j d_j e_j.

    These states follow the rig's.

    Raises:
        ValueError: where the controller's numerator is of higher degree than its denominator.
    """
    a, b, c, velocity, bare_mass = rig.over_outer_mass(inner_end_mass)
    n, k = a.nrows(), law.denominator.degree()
    if any(numerator.degree() > k for numerator in law.numerators):
        raise ValueError("the controller differentiates: its numerator is of higher degree than its denominator")
    fixed, inertial = fmpq_mat(n + k, n + k), fmpq_mat(n + k, n + k)
    for i in range(n):
        for j in range(n):
            fixed[i, j] = a[i, j]
        if k:
            fixed[i, n + k - 1] = b[i, 1]
    for i in range(k):
        fixed[n + i, n + k - 1] = -law.denominator[i] / law.denominator[k]
        if i:
            fixed[n + i, n + i - 1] += 1
    for sensor, numerator in zip(law.sensors, law.numerators, strict=True):
        seen, through = SEEN_AS[sensor], numerator[k] / law.denominator[k]
        rest = (numerator - law.denominator * through) / law.denominator[k]
        for j in range(n):
            for i in range(n):
                fixed[i, j] -= b[i, 1] * through * c[seen, j]
            for i in range(k):
                fixed[n + i, j] -= rest[i] * c[seen, j]

    for j in range(n + k):
        inertial[velocity, j], fixed[velocity, j] = fixed[velocity, j], fmpq(0)
    return MassFamily(fixed, inertial, bare_mass, velocity, rig.states + tuple(f"controller_{i + 1}" for i in range(k)))


def floats(matrix: fmpq_mat) -> np.ndarray:
    """The nearest floats of a rational matrix."""
    return np.array([[int(entry.p) / int(entry.q) if entry else 0.0 for entry in row] for row in matrix.tolist()])


def rationals(matrix: np.ndarray) -> fmpq_mat:
    """The symmetric part of a float matrix, rounded to floats and taken as their shortest decimals, exactly."""
    symmetric = (matrix + matrix.T) / 2
    n = len(symmetric)
    return fmpq_mat(n, n, [exact(symmetric[min(i, j), max(i, j)]) for i in range(n) for j in range(n)])
