"""The closed loop as a family of exact matrices over the outer end mass, x' = A(m) x: of one law, or of each stage.

The stages of a law act on states that all of them share and none resets. Those that they hand over are the current
itself and, where there are second-order sections, their outputs and the rates of those: a law works on the past of its
signals, whichever law made it. So nothing jumps at a change of stage, the current least of all. With e the error volts,
u_0 = e, the sections in series before the lag,

    u_k'' = p^2 (u_(k-1) + 2 d u_(k-1)' / z + u_(k-1)'' / z^2 - u_k) - 2 c p u_k',
    i'    = w_p (K u_n - i) + K (w_p / w_z) u_n'.

Sampled, that is the difference equation i_k = b0 e_k + b1 e_(k-1) - a1 i_(k-1), whose memory is e and i.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.controllers import Cascade, SensedLaw
from beamdesign.plant.linear import SEEN_AS, LinearModel
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, exact
from beamdesign.prototype import Prototype
from beamdesign.records import InputError

Row = list[fmpq]


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


def stage_families(prototype: Prototype) -> Families:
    """The matrices A(m) with every law of a prototype's controller; those of several in the same states.

    Raises:
        InputError: where the prototype carries effects, or where one of several laws has sections and no filter before
            them: they would feel accelerations, which the mass sets.
        ValueError: without a controller.
    """
    if prototype.schedule is None:
        return (closed_loop(prototype),)
    plant, inner = paper_model(prototype), exact(prototype.payload.inner_end_mass_kg)
    try:
        return tuple(stage_family(plant, inner, stage.law) for stage in prototype.schedule.stage)
    except ValueError as error:
        raise InputError(prototype.name, [("sensor.filter_Hz", str(error))]) from error


def stage_family(rig: LinearModel, inner_end_mass: fmpq, law: Cascade) -> MassFamily:
    """The matrices A(m) of one law; states of the rig, outputs and rates of its sections, then its current.

    Raises:
        ValueError: for sections without a filter before them.
    """
    free, driven, sensed, velocity, bare_mass = rig.over_outer_mass(inner_end_mass)
    names, n = rig.states, free.nrows()
    lag, sections = law.lag, law.sections
    assert lag is not None
    order = n + 2 * len(sections) + 1
    rows = [[fmpq(0)] * order for _ in range(order)]
    for i in range(n):
        for j in range(n):
            rows[i][j] = free[i, j]
        rows[i][order - 1] = driven[i, 1]

    error = [-sensed[1, j] for j in range(n)] + [fmpq(0)] * (order - n)
    rate = _derivative(error, rows, velocity)
    signal, slope = error, rate
    curvature = _derivative(rate, rows, velocity) if sections else None
    for k, section in enumerate(sections):
        zero, pole = exact(2 * pi * section.zero_Hz), exact(2 * pi * section.pole_Hz)
        zeta, own = exact(section.zero_damping_ratio), exact(section.pole_damping_ratio)
        assert curvature is not None
        out, moving = _unit(order, n + 2 * k), _unit(order, n + 2 * k + 1)
        bent = [
            pole**2 * (s + 2 * zeta * r / zero + c / zero**2 - o) - 2 * own * pole * v
            for s, r, c, o, v in zip(signal, slope, curvature, out, moving, strict=True)
        ]
        rows[n + 2 * k], rows[n + 2 * k + 1] = moving, bent
        signal, slope, curvature = out, moving, bent
    gain, upper, lower = exact(law.gain_A_per_V), exact(2 * pi * lag.zero_Hz), exact(2 * pi * lag.pole_Hz)
    current = _unit(order, order - 1)
    rows[order - 1] = [
        lower * (gain * s - i) + gain * lower / upper * r for s, r, i in zip(signal, slope, current, strict=True)
    ]

    fixed, inertial = fmpq_mat(rows), fmpq_mat(order, order)
    for j in range(order):
        inertial[velocity, j], fixed[velocity, j] = fixed[velocity, j], fmpq(0)
    more = [f"section_{k + 1}_{name}" for k in range(len(sections)) for name in ("V", "V_per_s")]
    return MassFamily(fixed, inertial, bare_mass, velocity, (*names, *more, "current_A"))


def _derivative(signal: Row, rows: Sequence[Row], velocity: int) -> Row:
    """The rate of a linear function of the states."""
    if signal[velocity] != 0:
        raise ValueError(
            "second-order sections need a filter before them (sensor.filter_Hz): without one they feel the"
            " acceleration of the tip, which jumps with the mass"
        )
    return [
        sum((weight * row[j] for weight, row in zip(signal, rows, strict=True) if weight), fmpq(0))
        for j in range(len(signal))
    ]


def _unit(order: int, place: int) -> Row:
    return [fmpq(int(j == place)) for j in range(order)]


def floats(matrix: fmpq_mat) -> np.ndarray:
    """The nearest floats of a rational matrix."""
    return np.array([[int(entry.p) / int(entry.q) if entry else 0.0 for entry in row] for row in matrix.tolist()])


def rationals(matrix: np.ndarray) -> fmpq_mat:
    """The symmetric part of a float matrix, rounded to floats and taken as their shortest decimals, exactly."""
    symmetric = (matrix + matrix.T) / 2
    n = len(symmetric)
    return fmpq_mat(n, n, [exact(symmetric[min(i, j), max(i, j)]) for i in range(n) for j in range(n)])
