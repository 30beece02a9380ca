"""How much work a certificate may ask for: whatever takes long is counted before it is done.

One unit is about a microsecond. What a file may ask for grows with its length, since the trees of an honest one do.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from flint import fmpq, fmpq_mat, fmpq_poly

OF_ANY, PER_BYTE = 10_000_000, 1_000
"""Of every file, and for each of its bytes: eight times what the costliest honest ones ask for."""
_LEFT: ContextVar[float | None] = ContextVar("left", default=None)


class Unreadable(ValueError):
    """The text is not a certificate of this format, or asks for more than is done."""


@contextmanager
def allowed(length: int) -> Iterator[None]:
    """Let a file of so many bytes ask for no more than its share."""
    before = _LEFT.set(OF_ANY + PER_BYTE * length)
    try:
        yield
    finally:
        _LEFT.reset(before)


def spend(units: float) -> None:
    """Count work that is about to be done.

    Raises:
        Unreadable: where it is more than is left.
    """
    if (left := _LEFT.get()) is None:
        return
    if units > left:
        raise Unreadable("its figures, polynomials or trees ask for more work than is done for a file of this length")
    _LEFT.set(left - units)


# What single operations cost, of numbers of so many bits: measured, and rounded up.


def bits(polynomial: fmpq_poly) -> int:
    """Of its numerators and their common denominator."""
    return int(max(polynomial.numer().height_bits(), polynomial.denom().bit_length()))


def of_common_divisor(polynomial: fmpq_poly) -> float:
    """Of a polynomial and one of no higher degree."""
    return 10 + (polynomial.degree() + 1) ** 2 * bits(polynomial) / 500


def of_signs(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> float:
    """Of moving an interval onto the positive numbers."""
    degree = polynomial.degree() + 1
    return 15 + degree * (bits(polynomial) + degree * (height(low) + height(high))) / 600


def of_quotients(polynomial: fmpq_poly) -> float:
    """Of Euclid's algorithm on two halves of a polynomial, with every quotient."""
    long = bits(polynomial)
    return 20 + (polynomial.degree() + 1) ** 3 * long * (1 + long / 5_000) / 400


def of_roots(polynomial: fmpq_poly) -> float:
    """Of all complex roots."""
    return (polynomial.degree() + 1) ** 2 * (20 + bits(polynomial) / 100)


def of_determinant(matrix: fmpq_mat) -> float:
    """Of that or of the characteristic polynomial."""
    above, below = matrix.numer_denom()
    longest = max([int(below).bit_length(), *(int(entry).bit_length() for entry in above.entries())])
    return 5 + matrix.nrows() ** 4 * longest * (1 + longest / 4_000) / 8_000


def times(one: Any, other: Any) -> Any:
    """Their product, where it is not too much work."""
    spend(of_products([one], [other]))
    return one * other


def of_products(some: Iterable[Any], others: Iterable[Any]) -> float:
    """Of all products of some polynomials with others, in one variable or in several."""
    (count, terms, long), (more, others_terms, longer) = (_size(list(each)) for each in (some, others))
    return 20 * count * more + terms * others_terms * (1 + max(long, longer) / 500) / 4


def _size(polynomials: Sequence[Any]) -> tuple[int, int, int]:
    """How many they are, terms of all, and bits of the longest of some of their coefficients."""
    samples = (one.coeffs()[:: 1 + len(one) // 8] for one in polynomials)
    longest = max((height(fmpq(c)) for sample in samples for c in sample), default=1)
    return len(polynomials), sum(map(len, polynomials)), longest


def height(value: fmpq) -> int:
    """Bits of numerator or denominator."""
    return int(value.height_bits())
