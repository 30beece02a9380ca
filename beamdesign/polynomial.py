"""Exact rational polynomials in s: conversion of figures, values on the imaginary axis, real roots, Routh test."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from flint import acb, arb, arb_poly, ctx, fmpq, fmpq_mpoly, fmpq_poly, fmpz

from beamdesign.rational import nearest


@lru_cache(1 << 14)
def exact(value: float) -> fmpq:
    """The rational of a float's shortest decimal form: 0.1 gives 1/10, not the nearest binary fraction.

    Raises:
        ValueError: for infinity and for what is not a number.
    """
    digits, _, exponent = repr(float(value)).partition("e")
    whole, _, decimals = digits.partition(".")
    power = int(exponent or 0) - len(decimals)
    integer = int(whole + decimals)
    return fmpq(integer * 10**power) if power >= 0 else fmpq(integer, 10**-power)


@dataclass(frozen=True)
class Affine:
    """A polynomial in s that is affine in one parameter k: constant + k slope."""

    constant: fmpq_poly
    slope: fmpq_poly

    def at(self, value: fmpq) -> fmpq_poly:
        """The polynomial at one value of the parameter."""
        return self.constant + self.slope * value

    def __mul__(self, factor: fmpq_poly | fmpq) -> "Affine":
        return Affine(self.constant * factor, self.slope * factor)

    def __add__(self, other: "Affine") -> "Affine":
        return Affine(self.constant + other.constant, self.slope + other.slope)


@dataclass(frozen=True)
class Quotient:
    """A quotient of polynomials in several variables, in lowest terms, which reckons with rationals too."""

    numerator: fmpq_mpoly
    denominator: fmpq_mpoly

    def _over(self, numerator: fmpq_mpoly, denominator: fmpq_mpoly) -> "Quotient":
        common = numerator.gcd(denominator)
        return Quotient(divmod(numerator, common)[0], divmod(denominator, common)[0])

    def _lifted(self, other: "Quotient | fmpq") -> "Quotient":
        nothing = 0 * self.numerator
        return other if isinstance(other, Quotient) else Quotient(nothing + other, nothing + 1)

    def __add__(self, other: "Quotient | fmpq") -> "Quotient":
        (a, b), (c, d) = ((one.numerator, one.denominator) for one in (self, self._lifted(other)))
        return self._over(a + c, b) if b == d else self._over(a * d + c * b, b * d)

    def __mul__(self, other: "Quotient | fmpq") -> "Quotient":
        other = self._lifted(other)
        return self._over(self.numerator * other.numerator, self.denominator * other.denominator)

    def __neg__(self) -> "Quotient":
        return Quotient(-self.numerator, self.denominator)

    def __sub__(self, other: "Quotient | fmpq") -> "Quotient":
        return self + -other

    def __rsub__(self, other: "Quotient | fmpq") -> "Quotient":
        return -self + other

    def __truediv__(self, other: "Quotient | fmpq") -> "Quotient":
        other = self._lifted(other)
        return self._over(self.numerator * other.denominator, self.denominator * other.numerator)

    def __rtruediv__(self, other: fmpq) -> "Quotient":
        return self._lifted(other) / self

    __radd__, __rmul__ = __add__, __mul__


def even_odd(polynomial: fmpq_poly) -> tuple[fmpq_poly, fmpq_poly]:
    """Parts on the imaginary axis: p(jw) = even(x) + j w odd(x), both polynomials in x = w^2."""
    coefficients = polynomial.coeffs()
    even = [-c if i % 2 else c for i, c in enumerate(coefficients[0::2])]
    odd = [-c if i % 2 else c for i, c in enumerate(coefficients[1::2])]
    return fmpq_poly(even), fmpq_poly(odd)


def squared_magnitude(polynomial: fmpq_poly) -> fmpq_poly:
    """|p(jw)|^2 as a polynomial in x = w^2."""
    even, odd = even_odd(polynomial)
    return even * even + fmpq_poly([0, 1]) * odd * odd


def real_roots(polynomial: fmpq_poly, precision_bits: int = 128) -> list[tuple[arb, int]]:
    """Disjoint enclosures of all real roots, ascending, with multiplicities.

    Arb isolates all complex roots of the square-free factors; a root's enclosure has an imaginary part of exactly
    zero only where the root is proved to be real.

    Args:
        polynomial: not the zero polynomial.
        precision_bits: relative accuracy of the enclosures.

    Raises:
        ValueError: for the zero polynomial, of which every number is a root.
    """
    if polynomial.is_zero():
        raise ValueError("the zero polynomial has no isolated roots")
    with ctx.workprec(precision_bits):
        found = [(root.real, count) for root, count in _complex_roots(polynomial) if root.imag == 0]
    return sorted(found, key=lambda pair: float(pair[0].mid()))


def roots(polynomial: fmpq_poly) -> np.ndarray:
    """All complex roots as floats, each as often as its multiplicity, by real then imaginary part."""
    found = [
        complex(float(root.real.mid()), float(root.imag.mid()))
        for root, count in _complex_roots(polynomial)
        for _ in range(count)
    ]
    return np.array(sorted(found, key=lambda z: (z.real, z.imag)))


def _complex_roots(polynomial: fmpq_poly) -> list[tuple[acb, int]]:
    return polynomial.numer().complex_roots()  # type: ignore[return-value]  # python-flint's stub has a plain list


def at_points(polynomial: fmpq_poly, points: np.ndarray | complex) -> np.ndarray:
    """Values at complex points, in floats."""
    return np.asarray(np.polyval([nearest(c) for c in reversed(polynomial.coeffs())] or [0.0], points))


def value_at(polynomial: fmpq_poly, point: arb) -> arb:
    """Enclosure of the value at a real ball, at the working precision."""
    return arb_poly(polynomial)(point)


def is_hurwitz(polynomial: fmpq_poly) -> bool:
    """Whether all roots lie in the open left half plane, by an exact Routh test.

    Fraction-free rows on even and odd parts; a zero or a sign change in the first column answers no, which is right
    for stability: a Hurwitz polynomial has a first column of one sign without zeros.
    """
    coefficients = polynomial.numer().coeffs()
    if not coefficients:
        return False
    upper: list[fmpz] = coefficients[-1::-2]
    lower: list[fmpz] = coefficients[-2::-2]
    sign = 1 if upper[0] > 0 else -1
    while lower:
        if sign * lower[0] <= 0:
            return False
        lead, next_lead = upper[0], lower[0]
        padded = [*lower, *([fmpz(0)] * (len(upper) - len(lower)))]
        # next_lead * upper - lead * lower keeps the sign of the Routh row times sign, since next_lead has that sign.
        row = [sign * (next_lead * u - lead * w) for u, w in zip(upper[1:], padded[1:], strict=True)]
        upper, lower = lower, row
        if not lower:
            break
        divisor = abs(_content(lower))
        if divisor > 1:
            lower = [value // divisor for value in lower]
    return True


def _content(values: Sequence[fmpz]) -> fmpz:
    divisor = fmpz(0)
    for value in values:
        divisor = value.gcd(divisor)
    return divisor
