"""The exact check of definiteness against closed forms, and against what floats make of the same matrices."""

import numpy as np
import pytest
from flint import fmpq, fmpq_mat
from hypothesis import given, settings
from hypothesis import strategies as st

from beamdesign.proofs.decrease import bernstein, not_positive, not_positive_on


def _floats(matrix: fmpq_mat) -> np.ndarray:
    return np.array([[float(int(entry.p)) / float(int(entry.q)) for entry in row] for row in matrix.tolist()])


def test_two_by_two_against_its_determinant():
    # [[1, c], [c, 1]] is positive definite exactly for |c| < 1.
    for c, holds in (
        (fmpq(999_999, 1_000_000), True),
        (fmpq(1), False),
        (fmpq(-1), False),
        (fmpq(1_000_001, 10**6), False),
    ):
        assert (not_positive(fmpq_mat([[1, c], [c, 1]])) == "") is holds


def test_hilbert_matrices_are_definite_though_floats_doubt_it():
    # det H_n = c_n^4 / c_2n with c_n = prod i! > 0 (Hilbert, 1894), so all leading minors are positive.
    n = 16
    matrix = fmpq_mat(n, n, [fmpq(1, i + j + 1) for i in range(n) for j in range(n)])
    assert np.linalg.eigvalsh(_floats(matrix)).min() < 0
    assert not_positive(matrix) == ""


def test_singular_matrix_that_floats_call_positive_definite():
    # v v' with v = (1, 0.7): 0.7 * 0.7 rounds below 0.49, so Cholesky's last pivot is a positive 5.6e-17.
    matrix = fmpq_mat([[1, fmpq(7, 10)], [fmpq(7, 10), fmpq(49, 100)]])
    assert np.linalg.cholesky(_floats(matrix))[1, 1] > 0
    assert not_positive(matrix) == "leading minor 2 of 2 is zero"


def test_indefinite_below_float_resolution():
    # det = -1e-40: in floats this is [[1, 1], [1, 1]].
    assert not_positive(fmpq_mat([[1, 1], [1, 1 - fmpq(1, 10**40)]]))
    assert not_positive(fmpq_mat([[1, 1], [1, 1 + fmpq(1, 10**40)]])) == ""


def test_asymmetric_matrix_is_refused():
    assert not_positive(fmpq_mat([[1, 1], [0, 1]]))


@settings(max_examples=60)
@given(st.data())
def test_agrees_with_the_signs_of_a_congruence(data):
    # L D L' has the inertia of D (Sylvester's law).
    n = data.draw(st.integers(1, 5))
    entry = st.integers(-9, 9)
    lower = fmpq_mat(n, n, [1 if i == j else data.draw(entry) if j < i else 0 for i in range(n) for j in range(n)])
    signs = [data.draw(st.integers(-1, 3)) for _ in range(n)]
    diagonal = fmpq_mat(n, n, [signs[i] if i == j else 0 for i in range(n) for j in range(n)])
    matrix = lower * diagonal * lower.transpose()
    assert (not_positive(matrix) == "") == all(sign > 0 for sign in signs)


def test_bernstein_coefficients_of_a_cubic():
    # m^3 on [0, 1] has 0, 0, 0, 1; on [1, 2] its blossom gives 1, 2, 4, 8.
    assert bernstein([fmpq(0), fmpq(0), fmpq(0), fmpq(1)], fmpq(0), fmpq(1)) == [0, 0, 0, 1]
    assert bernstein([fmpq(0), fmpq(0), fmpq(0), fmpq(1)], fmpq(1), fmpq(2)) == [1, 2, 4, 8]
    assert bernstein([0.0, 0.0, 0.0, 1.0], 1.0, 2.0) == pytest.approx([1, 2, 4, 8])


def test_interval_with_a_near_touch_needs_pieces_and_a_touch_is_refused():
    def square(lift: fmpq) -> list[fmpq_mat]:
        """(m - 1/3)^2 + lift."""
        return [fmpq_mat([[fmpq(1, 9) + lift]]), fmpq_mat([[fmpq(-2, 3)]]), fmpq_mat([[1]])]

    near = square(fmpq(1, 10**5))
    assert not_positive_on(near, fmpq(0), fmpq(1)) == ""
    assert not_positive_on(near, fmpq(0), fmpq(1), deepest=0)
    assert not_positive_on(square(fmpq(0)), fmpq(0), fmpq(1))
    assert not_positive_on(square(-fmpq(1, 10**12)), fmpq(0), fmpq(1))


def test_matrix_polynomial_on_an_interval_against_its_determinant():
    # [[1, m], [m, 1]] is positive definite exactly for |m| < 1.
    pencil = [fmpq_mat([[1, 0], [0, 1]]), fmpq_mat([[0, 1], [1, 0]])]
    assert not_positive_on(pencil, fmpq(-99, 100), fmpq(99, 100)) == ""
    assert not_positive_on(pencil, fmpq(-1, 2), fmpq(1))
    assert not_positive_on(pencil, fmpq(-1, 2), fmpq(3, 2)).startswith("at 1.5:")
