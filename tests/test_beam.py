"""The cantilever against unit-load integrals, finite elements and the transcendental frequency equation."""

from itertools import pairwise
from math import pi, sqrt

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import eigh

from beamdesign.structure.lumped import (
    MODE_MASS_FRACTION,
    STATIC_MASS_FRACTION,
    clearance_under_load,
    effective_mass,
    first_frequency,
    natural_frequencies,
    static_shape,
    tip_stiffness,
)

positive = st.floats(0.1, 10.0)


def finite_element_frequencies(rigidity: float, per_length: float, length: float, end_mass: float) -> np.ndarray:
    """Natural frequencies in Hz of a cantilever of cubic (Hermite) beam elements with a mass at its tip."""
    elements = 60
    h = length / elements
    stiffness = (
        rigidity
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    )
    mass = (
        per_length
        * h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
    )
    size = 2 * (elements + 1)
    whole_stiffness, whole_mass = np.zeros((size, size)), np.zeros((size, size))
    for element in range(elements):
        place = slice(2 * element, 2 * element + 4)
        whole_stiffness[place, place] += stiffness
        whole_mass[place, place] += mass
    whole_mass[-2, -2] += end_mass
    squares = eigh(whole_stiffness[2:, 2:], whole_mass[2:, 2:], eigvals_only=True)
    return np.sqrt(squares) / (2 * pi)


@given(positive, positive)
def test_tip_stiffness_is_the_inverse_of_the_unit_load_integral(rigidity, length):
    compliance, _ = quad(lambda x: (length - x) ** 2 / rigidity, 0.0, length)
    assert tip_stiffness(rigidity, length) == pytest.approx(1 / compliance, rel=1e-9)


def test_equation_1_with_the_static_shape_gives_equation_6():
    assert quad(static_shape, 0.0, 1.0)[0] == pytest.approx(3 / 8, rel=1e-12)
    assert effective_mass(2.0, 3.0, 0.5, "static") == pytest.approx(0.5 + 0.375 * 6.0)
    assert STATIC_MASS_FRACTION == 3 / 8


def test_static_shape_is_the_deflection_under_a_tip_force():
    # Unit load at x and at the tip, EI = L = 1: the integral of the product of their moments.
    for position in (0.2, 0.5, 0.9, 1.0):
        deflection, _ = quad(lambda x, at=position: (1 - x) * (at - x), 0.0, position)
        assert static_shape(position) == pytest.approx(3 * deflection, rel=1e-9)


def test_mode_fraction_is_the_kinetic_energy_of_the_static_shape():
    energy, _ = quad(lambda x: static_shape(x) ** 2, 0.0, 1.0)
    assert energy == pytest.approx(33 / 140, rel=1e-12)
    assert round(energy, 3) == MODE_MASS_FRACTION


@given(positive, positive, positive, st.floats(0.0, 100.0))
def test_effective_mass_lumped_at_the_tip_has_the_first_frequency(rigidity, per_length, length, end_mass):
    stiffness = tip_stiffness(rigidity, length)
    expected = sqrt(stiffness / effective_mass(per_length, length, end_mass)) / (2 * pi)
    assert first_frequency(rigidity, per_length, length, end_mass) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("end_mass", [0.0, 0.3, 2.0, 50.0])
def test_natural_frequencies_agree_with_finite_elements(end_mass):
    figures = (3.0e5, 3.4, 1.2, end_mass)
    expected = finite_element_frequencies(*figures)[:4]
    # Cubic elements of length h are too stiff by (k h)^4 / 1440: at most 8e-7 for k L = 11 over 60 elements.
    assert natural_frequencies(*figures, count=4) == pytest.approx(expected.tolist(), rel=1e-6)


@pytest.mark.parametrize(("end_mass", "error"), [(0.0, 0.0141), (0.4, 0.005), (4.0, 0.0005), (400.0, 1e-5)])
def test_equation_2_is_a_little_high_and_the_better_the_heavier_the_end(end_mass, error):
    exact = natural_frequencies(1.0, 1.0, 1.0, end_mass, count=1)[0]
    # 0.236 is 33/140 rounded up by 0.1 %, which can take 0.0003 off what Rayleigh's bound guarantees.
    assert -3e-4 < first_frequency(1.0, 1.0, 1.0, end_mass) / exact - 1 < error


def test_a_very_heavy_tip_leaves_the_modes_of_a_propped_cantilever():
    # tan kL = tanh kL: kL = 3.926602, 7.068583 (clamped and pinned).
    expected = [root**2 / (2 * pi) for root in (3.926602, 7.068583)]
    assert natural_frequencies(1.0, 1.0, 1.0, 1e9)[1:] == pytest.approx(expected, rel=1e-6)


def test_high_modes_do_not_overflow():
    frequencies = natural_frequencies(1.0, 1.0, 1.0, 0.0, count=250)
    # Far up, kL approaches odd quarter turns.
    assert frequencies[-1] == pytest.approx((499 * pi / 2) ** 2 / (2 * pi), rel=1e-9)
    assert all(low < high for low, high in pairwise(frequencies))


def test_clearance_shrinks_by_the_deflection():
    assert clearance_under_load(0.0177, 2000.0, 157_500.0) == pytest.approx(0.0177 - 2000 / 157_500)
    assert clearance_under_load(0.001, 2000.0, 157_500.0) < 0


def test_numbers_arrays_and_symbols_give_the_same():
    rigidity, per_length, length, end_mass = 2.7e5, 3.4, np.array([1.0, 1.2]), 2.9
    symbol = ca.SX.sym("length")
    for function in (
        lambda free: tip_stiffness(rigidity, free),
        lambda free: effective_mass(per_length, free, end_mass),
        lambda free: first_frequency(rigidity, per_length, free, end_mass),
        lambda free: clearance_under_load(0.02, 2000.0, tip_stiffness(rigidity, free)),
    ):
        one_by_one = [function(1.0), function(1.2)]
        compiled = ca.Function("beam", [symbol], [function(symbol)])
        assert function(length).tolist() == pytest.approx(one_by_one, rel=1e-14)
        assert [float(compiled(1.0)), float(compiled(1.2))] == pytest.approx(one_by_one, rel=1e-14)
