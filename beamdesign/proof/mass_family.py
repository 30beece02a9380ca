"""The closed loop as a family of exact matrices over the outer end mass: x' = A(m) x."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.controllers import TransferFunction
from beamdesign.linear import LinearModel
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
    return close_with(paper_model(prototype), inner, prototype.controller.transfer_function())


def close_with(rig: LinearModel, inner_end_mass: fmpq, law: TransferFunction) -> MassFamily:
    """Close the loop of a rig with a controller of any order.

    The controller is realised in companion form, driven by the error voltage; its states follow the rig's.

    Raises:
        ValueError: where the controller's numerator is of higher degree than its denominator.
    """
    a, b, c, velocity, bare_mass = rig.over_outer_mass(inner_end_mass)
    law_a, law_c, feedthrough = _companion(law)
    n, k = a.nrows(), len(law_c)
    fixed, inertial = fmpq_mat(n + k, n + k), fmpq_mat(n + k, n + k)
    for i in range(n):
        for j in range(n):
            fixed[i, j] = a[i, j] - b[i, 1] * feedthrough * c[1, j]
        for j in range(k):
            fixed[i, n + j] = b[i, 1] * law_c[j]
    for i in range(k):
        for j in range(k):
            fixed[n + i, n + j] = law_a[i][j]
    for j in range(n if k else 0):
        fixed[n + k - 1, j] = -c[1, j]

    for j in range(n + k):
        inertial[velocity, j], fixed[velocity, j] = fixed[velocity, j], fmpq(0)
    return MassFamily(fixed, inertial, bare_mass, velocity, rig.states + tuple(f"controller_{i + 1}" for i in range(k)))


def _companion(law: TransferFunction) -> tuple[list[list[fmpq]], list[fmpq], fmpq]:
    """A (k, k), C (k) and D of the controller in companion form, input at the last state."""
    k = law.denominator.degree()
    if law.numerator.degree() > k:
        raise ValueError("the controller differentiates: its numerator is of higher degree than its denominator")
    lead = law.denominator[k]
    feedthrough = law.numerator[k] / lead
    rest = law.numerator - law.denominator * feedthrough
    a = [[fmpq(int(j == i + 1)) for j in range(k)] for i in range(k - 1)]
    a += [[-law.denominator[j] / lead for j in range(k)]] if k else []
    return a, [rest[j] / lead for j in range(k)], feedthrough


def floats(matrix: fmpq_mat) -> np.ndarray:
    """The nearest floats of a rational matrix."""
    return np.array([[int(entry.p) / int(entry.q) if entry else 0.0 for entry in row] for row in matrix.tolist()])


def rationals(matrix: np.ndarray) -> fmpq_mat:
    """The symmetric part of a float matrix, rounded to floats and taken as their shortest decimals, exactly."""
    symmetric = (matrix + matrix.T) / 2
    n = len(symmetric)
    return fmpq_mat(n, n, [exact(symmetric[min(i, j), max(i, j)]) for i in range(n) for j in range(n)])
