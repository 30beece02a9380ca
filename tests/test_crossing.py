"""Crossings against dense eigenvalues, the bialternate (guardian-map) pencil, closed forms and degenerate families."""

from itertools import combinations
from math import inf, pi, sqrt

import numpy as np
import pytest
import scipy.linalg
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign import Prototype
from beamdesign.controllers import Lag
from beamdesign.loop import loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, crossings, degree_drop, elimination, roots, shares_axis_root


def floats(matrix: fmpq_mat) -> np.ndarray:
    return np.array([[int(x.p) / int(x.q) for x in row] for row in matrix.tolist()])


def closed_descriptor(prototype: Prototype, mass: float) -> tuple[np.ndarray, np.ndarray]:
    """E and A of E x' = A x with the lag closed around the plant, its one state last; nothing but matrices."""
    lag = prototype.controller
    assert isinstance(lag, Lag)
    rig = paper_model(prototype)
    e, a, b, c = map(floats, rig.exact_matrices(fmpq(mass), fmpq(9, 2)))
    n = len(a)
    pole, through = 2 * pi * lag.pole_Hz, lag.gain_A_per_V * lag.pole_Hz / lag.zero_Hz
    closed_e, closed_a = np.eye(n + 1), np.zeros((n + 1, n + 1))
    closed_e[:n, :n] = e
    closed_a[:n, :n] = a - through * np.outer(b[:, 1], c[1])
    closed_a[:n, n] = b[:, 1]
    closed_a[n, :n] = -pole * (lag.gain_A_per_V - through) * c[1]
    closed_a[n, n] = -pole
    return closed_e, closed_a


def test_dense_eigenvalues_lie_on_the_axis_at_the_crossings(remedy: Prototype):
    e0, a = closed_descriptor(remedy, 0)
    e1, _ = closed_descriptor(remedy, 1)
    found = [crossing for crossing in crossings(loop(remedy).characteristic) if crossing.value > 0]
    assert len(found) == 2
    for crossing in found:
        poles = scipy.linalg.eigvals(a, e0 + crossing.value * (e1 - e0))
        nearest = poles[np.argmin(np.abs(poles.real))]
        assert abs(nearest.real) < 1e-6 * abs(nearest)
        assert abs(nearest.imag) == pytest.approx(2 * pi * crossing.frequency_Hz, rel=1e-9)


def test_the_remedy_crosses_where_it_should(remedy: Prototype):
    found = [crossing for crossing in crossings(loop(remedy).characteristic) if crossing.value > 0]
    assert [crossing.value for crossing in found] == pytest.approx([1.968442, 17.792115], abs=1e-5)
    assert [crossing.frequency_Hz for crossing in found] == pytest.approx([131.80, 26.02], abs=0.01)
    assert all(crossing.parameter.rad() < 1e-20 for crossing in found)


def test_a_bialternate_pencil_has_the_same_masses(remedy: Prototype):
    """Some pair of poles adds up to zero where X -> A X E' + E X A' is singular on antisymmetric X.

    With E = E0 + m E1 that is a pencil in m, whose real eigenvalues are all masses with a pair on the axis, and those
    with two real poles that are opposite (Fuller 1968; Saydy, Tits and Abed 1990).
    """
    e0, a = closed_descriptor(remedy, 0)
    e1 = closed_descriptor(remedy, 1)[0] - e0
    # Scaling of time, states and equations changes no mass but keeps the numbers within reach of each other.
    balanced, (scale, order) = scipy.linalg.matrix_balance(
        np.linalg.solve(e0 + 5 * e1, a), permute=False, separate=True
    )
    assert np.array_equal(order, np.arange(len(a)))
    left = np.linalg.inv(np.diag(scale)) @ np.linalg.inv(e0 + 5 * e1)
    a, e0, e1 = balanced / 500, left @ e0 @ np.diag(scale), left @ e1 @ np.diag(scale)
    pairs = list(combinations(range(len(a)), 2))

    def map_by(e: np.ndarray) -> np.ndarray:
        columns = []
        for i, j in pairs:
            x = np.zeros_like(a)
            x[i, j], x[j, i] = 1, -1
            y = a @ x @ e.T + e @ x @ a.T
            columns.append([y[k, m] for k, m in pairs])
        return np.array(columns).T

    top, bottom = scipy.linalg.eigvals(-map_by(e0), map_by(e1), homogeneous_eigvals=True)
    finite = np.abs(bottom) > 1e-9 * np.abs(top)
    masses = top[finite] / bottom[finite]
    real = np.sort(masses.real[(np.abs(masses.imag) < 1e-6) & (masses.real > 0)])
    expected = [crossing.value for crossing in crossings(loop(remedy).characteristic) if crossing.value > 0]
    assert all(np.abs(real - mass).min() < 1e-5 for mass in expected)
    for mass in real:  # and what else the pencil finds are opposite real poles
        poles = scipy.linalg.eigvals(a, e0 + mass * e1)
        on_axis = np.abs(np.array(expected) - mass).min() < 1e-5
        opposite = any(abs(p + r) < 1e-6 and abs(p.imag) < 1e-6 for p, r in combinations(poles, 2))
        assert on_axis or opposite


def test_a_second_order_family_in_closed_form():
    """s^2 + (k - 2) s + 9 + k: on the axis at k = 2 with w^2 = 11, and through the origin at k = -9."""
    family = Affine(fmpq_poly([9, -2, 1]), fmpq_poly([1, 1]))
    origin, axis = crossings(family)
    assert (origin.rational, origin.frequency_Hz) == (fmpq(-9), 0.0)
    assert axis.parameter.contains(2)
    assert axis.squared_frequency.contains(11)
    assert axis.frequency_Hz == pytest.approx(sqrt(11) / (2 * pi))
    assert degree_drop(family) is None


def test_each_crossing_solves_its_member():
    family = Affine(fmpq_poly([3, 7, 9, 4, 2, 1]), fmpq_poly([-2, 1, -4, 3]))
    found = crossings(family)
    assert found
    for crossing in found:
        member = [
            int(c.p) / int(c.q) + crossing.value * int(d.p) / int(d.q)
            for c, d in zip(family.constant.coeffs(), [*family.slope.coeffs(), fmpq(0), fmpq(0)], strict=True)
        ]
        w = 2 * pi * crossing.frequency_Hz
        assert abs(np.polyval(member[::-1], 1j * w)) < 1e-9


def test_axis_roots_of_the_slope_alone_have_no_finite_parameter():
    """p1 = s^2 + 4 vanishes at 2j, where p0 does not."""
    family = Affine(fmpq_poly([1, 1]) * fmpq_poly([5, 1, 1]), fmpq_poly([4, 0, 1]))
    assert elimination(family)(fmpq(4)) == 0
    assert all(abs(crossing.squared_frequency.mid() - 4) > 1e-3 for crossing in crossings(family))


def test_a_shared_axis_root_is_there_for_every_parameter():
    shared = fmpq_poly([1, 0, 1])
    family = Affine(shared * fmpq_poly([1, 1]), shared)
    assert shares_axis_root(family)
    with pytest.raises(ArithmeticError, match="every parameter"):
        crossings(family)
    assert shares_axis_root(Affine(fmpq_poly([0, 1, 1]), fmpq_poly([0, 1])))
    assert not shares_axis_root(Affine(fmpq_poly([1, 1]) ** 2, fmpq_poly([1, 1])))


def test_even_families_have_no_isolated_crossing():
    assert crossings(Affine(fmpq_poly([12, 0, 3]), fmpq_poly([-3, 0, -1]))) == [
        crossing for crossing in crossings(Affine(fmpq_poly([12]), fmpq_poly([-3]))) if crossing.rational == 4
    ]


def test_the_degree_drops_where_the_leading_coefficient_vanishes():
    assert degree_drop(Affine(fmpq_poly([1, 1, -3]), fmpq_poly([0, 0, 2]))) == fmpq(3, 2)
    assert degree_drop(Affine(fmpq_poly([1, 1]), fmpq_poly([0, 0, 2]))) == 0
    for k in (fmpq(149, 100), fmpq(151, 100)):  # on either side one root has gone through infinity
        member = Affine(fmpq_poly([1, 1, -3]), fmpq_poly([0, 0, 2])).at(k)
        assert np.abs(roots(member)).max() > 40
    assert inf not in [crossing.frequency_Hz for crossing in crossings(Affine(fmpq_poly([1, 1]), fmpq_poly([0, 0, 2])))]
