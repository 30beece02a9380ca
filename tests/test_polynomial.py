"""Exact polynomials and rationals against direct evaluation, numpy's roots and the definition of each rounding."""

from fractions import Fraction
from math import nextafter

import numpy as np
import pytest
from flint import arb, ctx, fmpq, fmpq_poly
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from beamdesign.polynomial import (
    Affine,
    bounds,
    even_odd,
    exact,
    is_hurwitz,
    nearest,
    real_roots,
    roots,
    rounded_down,
    rounded_up,
    shortened,
    simple_between,
    squared_magnitude,
    text,
    value_at,
)

quick = settings(max_examples=50)
fractions = st.fractions(min_value=-100, max_value=100, max_denominator=1000)
integers = st.lists(st.integers(-9, 9), min_size=1, max_size=7)


def q(value: Fraction) -> fmpq:
    return fmpq(value.numerator, value.denominator)


def direct(polynomial: fmpq_poly, s: complex) -> complex:
    return sum(int(c.p) / int(c.q) * s**i for i, c in enumerate(polynomial.coeffs()))


def test_a_figure_is_the_decimal_that_is_written():
    assert exact(0.1) == fmpq(1, 10)
    assert exact(5.71e-8) == fmpq(571, 10**10)
    assert exact(1.13e22) == fmpq(113 * 10**20)


@quick
@given(integers, integers, st.integers(-5, 5))
def test_an_affine_family_is_evaluated_and_multiplied_member_by_member(constant, slope, k):
    family = Affine(fmpq_poly(constant), fmpq_poly(slope))
    factor = fmpq_poly([1, 2, 3])
    assert family.at(fmpq(k)) == fmpq_poly(constant) + k * fmpq_poly(slope)
    assert (family * factor).at(fmpq(k)) == family.at(fmpq(k)) * factor


@quick
@given(integers, st.floats(0.1, 3))
def test_parts_and_magnitude_on_the_imaginary_axis(coefficients, w):
    polynomial = fmpq_poly(coefficients)
    expected = direct(polynomial, 1j * w)
    even, odd = even_odd(polynomial)
    assert direct(even, w * w).real == pytest.approx(expected.real, abs=1e-9)
    assert w * direct(odd, w * w).real == pytest.approx(expected.imag, abs=1e-9)
    assert direct(squared_magnitude(polynomial), w * w).real == pytest.approx(abs(expected) ** 2, abs=1e-6, rel=1e-12)


def test_real_roots_come_ascending_with_multiplicities_and_without_complex_ones():
    x = fmpq_poly([0, 1])
    found = real_roots((x - fmpq(1, 3)) ** 2 * (x + 2) * (x * x + 1) * (x * x - 2) * x**3)
    assert [count for _, count in found] == [1, 1, 3, 2, 1]
    for (root, _), expected in zip(found, [fmpq(-2), None, fmpq(0), fmpq(1, 3), None], strict=True):
        low, high = bounds(root)
        assert high - low < fmpq(1, 10**30)
        assert expected is None or low <= expected <= high
    assert found[1][0] < 0
    assert (found[4][0] ** 2).contains(2)


def test_roots_that_nearly_agree_are_told_apart():
    x = fmpq_poly([0, 1])
    close = fmpq(1, 10**25)
    (first, _), (second, _) = real_roots((x - 1) * (x - 1 - close))
    assert first < second
    assert real_roots((x - 1) ** 2 + close) == []


def test_the_zero_polynomial_has_no_isolated_roots():
    with pytest.raises(ValueError, match="zero polynomial"):
        real_roots(fmpq_poly([0]))


@quick
@given(st.lists(st.complex_numbers(max_magnitude=5), min_size=1, max_size=3))
def test_float_roots_are_those_that_went_in(points):
    polynomial = fmpq_poly([1])
    for z in points:
        re, im = exact(round(z.real, 2)), exact(round(z.imag, 2))
        polynomial *= fmpq_poly([re * re + im * im, -2 * re, 1])
    found = roots(polynomial)
    assert len(found) == 2 * len(points)
    for z in points:
        assert np.abs(found - complex(round(z.real, 2), round(z.imag, 2))).min() < 1e-9


@quick
@given(integers, fractions)
def test_values_at_balls_enclose_the_exact_value(coefficients, point):
    polynomial = fmpq_poly(coefficients)
    low, high = bounds(value_at(polynomial, arb(q(point))))
    assert low <= polynomial(q(point)) <= high


@quick
@given(integers, st.booleans())
def test_the_routh_test_agrees_with_numerical_roots(coefficients, factored):
    polynomial = fmpq_poly(coefficients)
    if factored:  # so that stable ones turn up often
        polynomial = fmpq_poly([1])
        for a in coefficients:
            polynomial *= fmpq_poly([a * a, a, 1]) if a % 2 else fmpq_poly([a, 1])
    assume(polynomial.degree() > 0)
    largest = roots(polynomial).real.max()
    assume(abs(largest) > 1e-9)
    assert is_hurwitz(polynomial) == (largest < 0)
    assert is_hurwitz(-polynomial * fmpq(2, 3)) == (largest < 0)


@pytest.mark.parametrize(
    ("coefficients", "stable"),
    [
        ([1], True),  # no roots at all
        ([0], False),
        ([0, 1], False),  # at the origin
        ([1, 0, 1], False),  # on the axis
        ([1, 1, 1, 1], False),  # (s + 1)(s^2 + 1): a row of zeros
        ([1, 2, 1], True),
        ([4, 4, 5, 1, 1], False),  # (s^2 + 4)(s^2 + s + 1): two rows on
        ([-1, -2, -1], True),
        ([1, 2, -1], False),
    ],
)
def test_the_routh_test_on_special_polynomials(coefficients, stable):
    assert is_hurwitz(fmpq_poly(coefficients)) is stable


@quick
@given(fractions, st.integers(20, 300))
def test_bounds_of_a_ball_are_exact(value, precision):
    with ctx.workprec(precision):
        low, high = bounds(arb(q(value)))
    assert low <= q(value) <= high
    assert high - low <= abs(q(value)) * fmpq(1, 2 ** (precision - 4))


@quick
@given(fractions, fractions)
def test_a_simple_number_lies_between(one, two):
    assume(one != two)
    low, high = sorted((q(one), q(two)))
    found = simple_between(low, high)
    assert low < found < high
    assert "/" not in text(found)
    assert len(text(found)) <= len(str(1000)) + 8


def test_nothing_lies_between_equals():
    with pytest.raises(ValueError, match="nothing lies between"):
        simple_between(fmpq(1), fmpq(1))


@quick
@given(fractions)
def test_text_reads_back(value):
    assert Fraction(text(q(value))) == value


def test_text_is_decimal_where_it_is_short():
    assert text(fmpq(-1, 8)) == "-0.125"
    assert text(fmpq(571, 10**10)) == "0.0000000571"
    assert text(fmpq(1, 3)) == "1/3"
    assert text(fmpq(-20)) == "-20"


@quick
@given(st.fractions(min_value="1e-6", max_value=10**6), st.integers(1, 8))
def test_shortening_keeps_so_many_digits_on_the_asked_side(value, digits):
    below, above = shortened(q(value), digits), shortened(q(value), digits, up=True)
    assert below <= q(value) <= above
    assert above - below <= q(value) * fmpq(10) ** (1 - digits)
    assert len(text(below).replace(".", "").strip("0")) <= digits


@quick
@given(fractions)
def test_rounding_to_floats(value):
    down, up = rounded_down(q(value)), rounded_up(q(value))
    assert Fraction(down) <= value <= Fraction(up)
    assert up <= nextafter(down, 1e9)
    assert nearest(q(value)) in (down, up)
    assert nearest(exact(float(value))) == float(value)
