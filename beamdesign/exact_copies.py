"""Exact numbers and polynomials in copies of records, and from one process to another.

python-flint says of its types neither how `copy` nor how `pickle` takes them, and what is proved holds such numbers.
"""

from collections.abc import Sequence
from copyreg import pickle
from typing import Any

from flint import Ordering, arb, fmpq, fmpq_mat, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly, fmpz, fmpz_poly


def _ball(number: arb) -> tuple[Any, ...]:
    """Middle and radius: mantissa and exponent of two, or a float where it is not finite.

    The library may round a radius up when it makes a ball of these, by 2^-29 of it at the most: a copy contains the
    ball, and has its middle.
    """
    parts = number.mid(), number.rad()
    return arb, tuple(tuple(map(int, one.man_exp())) if one.is_finite() else float(one) for one in parts)


def _context(names: Sequence[str], ordering: int) -> fmpq_mpoly_ctx:
    return fmpq_mpoly_ctx.get(list(names), Ordering(ordering))


def let_be_copied() -> None:
    """Let `copy` and `pickle` take exact numbers, polynomials, matrices and balls."""
    pickle(fmpz, lambda number: (fmpz, (int(number),)))
    pickle(fmpq, lambda number: (fmpq, (int(number.p), int(number.q))))
    pickle(fmpz_poly, lambda polynomial: (fmpz_poly, (polynomial.coeffs(),)))
    pickle(fmpq_poly, lambda polynomial: (fmpq_poly, (polynomial.coeffs(),)))
    pickle(fmpq_mat, lambda matrix: (fmpq_mat, (matrix.nrows(), matrix.ncols(), matrix.entries())))
    pickle(fmpq_mpoly_ctx, lambda context: (_context, (context.names(), context.ordering().value)))
    pickle(fmpq_mpoly, lambda polynomial: (fmpq_mpoly_ctx.from_dict, (polynomial.context(), polynomial.to_dict())))
    pickle(arb, _ball)
