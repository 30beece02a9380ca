"""Exact stable zeros of a lag, against a closed form and eigenvalues that share nothing with the polynomials."""

from math import pi
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq, fmpq_poly

from beamdesign import InputError, Prototype, read_prototype
from beamdesign.plant.members import paper_model
from beamdesign.proofs.rectangle import critical_values, stable_zeros

REMEDY = Path(__file__).parents[1] / "studies" / "prototypes" / "paper_remedy.toml"


@pytest.fixture
def remedy() -> Prototype:
    return read_prototype(REMEDY)


def rightmost(prototype, inner, outer, gain, pole_Hz, zero_Hz):
    """Largest real part of the closed loop's eigenvalues, from the rig's matrices and the lag's state."""
    rig = paper_model(prototype)
    a, b, c = rig.matrices(outer, inner)
    column, row = b[:, 1:2], c[1:2, :]
    pole, zero = 2 * pi * pole_Hz, 2 * pi * zero_Hz
    # C(s) = k (pole/zero) (1 + (zero - pole) / (s + pole)), driven by the error -y.
    direct = gain * pole / zero
    closed = np.block([[a - direct * column @ row, column * direct * (zero - pole)], [-row, np.array([[-pole]])]])
    return np.linalg.eigvals(closed).real.max()


def test_critical_values_of_a_cubic_are_those_of_routh():
    """(1 + m) s^3 + 2 s^2 + (3 + u) s + 4 is stable for u > 2 (1 + m) - 3: a m of 0 and 5 gives -1 and 9."""
    p0, p1, p2 = fmpq_poly([4, 3, 2, 1]), fmpq_poly([0, 0, 0, 1]), fmpq_poly([0, 1])
    found = {round(float(value.mid()), 9) for value in critical_values(p0, p1, p2, fmpq(0), fmpq(5))}
    assert found == {-1.0, 9.0}


def test_family_whose_roots_pass_through_infinity_is_refused():
    with pytest.raises(ArithmeticError):
        list(critical_values(fmpq_poly([4, 3, 2, 1]), fmpq_poly([0, 0, 0, -1]), fmpq_poly([0, 1]), fmpq(0), fmpq(5)))


@pytest.mark.parametrize(
    ("inner", "highest", "pole_Hz", "gain"),
    [(4.5, 6.8, 1.75, 0.15), (1.9, 6.8, 1.75, 0.057), (7.23, 4.73, 0.856, 0.0596), (0.0, 2.0, 1.0, 0.02)],
)
def test_edges_are_where_an_eigenvalue_crosses(remedy, inner, highest, pole_Hz, gain):
    rig = remedy.but(payload=remedy.payload.but(inner_end_mass_kg=inner))
    parts = stable_zeros(rig, pole_Hz, gain, (0.0, highest))
    assert parts
    masses = np.linspace(0.0, highest, 201)

    def worst(zero_Hz):
        return max(rightmost(rig, inner, mass, gain, pole_Hz, zero_Hz) for mass in masses)

    edges = [edge for low_Hz, high_Hz in parts for edge in ((low_Hz, 1 + 1e-5), (high_Hz, 1 - 1e-5))]
    for edge, inwards in edges:
        if edge < 9e4:  # beyond, nothing is looked at
            assert worst(edge * inwards) < 0 < worst(edge / inwards**100)


def test_edge_that_only_a_mass_inside_the_range_makes_is_found(remedy):
    """Here both ends of the payload bear a quicker zero than some mass between them."""
    rig = remedy.but(payload=remedy.payload.but(inner_end_mass_kg=7.23))
    ((_, high_Hz),) = stable_zeros(rig, 0.856, 0.0596, (0.0, 4.73))
    beyond = high_Hz * 1.02
    assert rightmost(rig, 7.23, 0.0, 0.0596, 0.856, beyond) < 0
    assert rightmost(rig, 7.23, 4.73, 0.0596, 0.856, beyond) < 0
    assert max(rightmost(rig, 7.23, mass, 0.0596, 0.856, beyond) for mass in np.linspace(0, 4.73, 101)) > 0


def test_papers_remedy_is_outside(remedy):
    """1.75/26 Hz at 150 mA/V is unstable below 1.968 kg with 4.5 kg inside, and stable from 2 to 6.8 kg."""
    whole, loaded = (stable_zeros(remedy, 1.75, 0.15, (low, 6.8)) for low in (0.0, 2.0))
    assert not any(low_Hz <= 26.0 <= high_Hz for low_Hz, high_Hz in whole)
    assert any(low_Hz <= 26.0 <= high_Hz for low_Hz, high_Hz in loaded)


def test_no_zero_helps_a_pole_that_is_too_quick(remedy):
    assert stable_zeros(remedy, 10.0, 0.15, (0.0, 6.8)) == []


def test_effects_are_refused(remedy):
    with pytest.raises(InputError, match="sensor_lag"):
        stable_zeros(remedy.but(effects={"sensor_lag": {}}), 1.0, 0.1, (0.0, 1.0))
