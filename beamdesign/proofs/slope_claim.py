"""Re[M (1 + L)] > 0 for every member of a box, as zero exclusion with one more unknown.

With L = N / D and M = (A + j w B) / Q on the axis, A and Q positive there (see `beamdesign.proofs.multiplier`),

    |2 A D + (A + j w B) N|^2 - |(A - j w B) N|^2 = 4 A Q |D|^2 Re[M (1 + L)],

which is positive where p = 2 A D + ((A + s B) + u (A - s B)) N vanishes for no u of a size of at most one. Divided by
2 A it is D + g N with a gain g that goes around the circle through zero and one on whose tangents the multiplier turns
L. Where p vanishes for no u of the size one, at no member and frequency, both sides vanish nowhere; as without Popov's
term they are positive at high frequencies, where L vanishes, they are positive everywhere. At the u for which g is zero
that says that D has no root on the axis either: it is stable at every member where it is at one. So nothing is needed
beside for the theorem.

What a gain does that is less than the largest, a characteristic of a lower slope does: gains enter at their largest.
"""

import ast
from collections.abc import Mapping

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.polynomial import is_hurwitz
from beamdesign.proofs.multiplier import Multiplier
from beamdesign.proofs.read_once import Expression
from beamdesign.proofs.statement import Statement
from beamdesign.proofs.value_set import with_unknown

UNKNOWN = "unknown"
"""What may be any number of a circle."""

_LEAVES = "multiplier_even", "multiplier_plain", "multiplier_turned"


def weights(multiplier: Multiplier) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly]:
    """2 A, A + s B and A - s B in s."""
    even, odd = multiplier.in_s
    return 2 * even, even + odd, even - odd


def weighed(form: Expression, multiplier: Multiplier) -> Expression:
    """The expression of D + u N, u being the unknown, as that of a slope, where it is another."""
    of_denominator, plain, turned = _LEAVES

    def written(node: ast.expr) -> tuple[str, bool]:
        """A part, and whether the unknown stands in it; what it is added to is of the opened loop."""
        match node:
            case ast.Name(id=name):
                return (f"({plain} + {turned}*{UNKNOWN})", True) if name == UNKNOWN else (name, False)
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                (a, in_a), (b, in_b) = written(left), written(right)
                return f"{a}*{b}", in_a or in_b
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                (a, in_a), (b, in_b) = written(left), written(right)
                if in_a != in_b:
                    a, b = (a, f"{of_denominator}*{b}") if in_a else (f"{of_denominator}*{a}", b)
                return f"({a} + {b})", in_a or in_b
        raise ValueError(f"not a sum or product of leaves: {ast.unparse(node)}")

    leaves = {**form.leaves, **dict(zip(_LEAVES, map(_text, weights(multiplier)), strict=True))}
    return Expression(written(ast.parse(form.p, mode="eval").body)[0], leaves, form.bound, form.groups)


def _text(polynomial: fmpq_poly) -> str:
    powers = ("", "*s", *(f"*s**{k}" for k in range(2, polynomial.degree() + 1)))
    return " + ".join(f"({c.p}/{c.q}){power}" for c, power in zip(polynomial.coeffs(), powers, strict=False) if c)


def presupposed(at_none: fmpq_poly, at_one: fmpq_poly, multiplier: Multiplier) -> bool:
    """Whether one member without delay is stable when opened, its L falls off, and the theorem knows the multiplier.

    Args:
        at_none: p of the member where the unknown is zero.
        at_one: where it is one.
        multiplier: M.
    """
    even, _, turned = weights(multiplier)
    numerator = (at_one - at_none) / turned
    cut = at_one / even - numerator
    known = multiplier.admissible and multiplier.popov_s == 0
    return known and numerator.degree() < cut.degree() and is_hurwitz(cut)


def closed_over_denominator(stated: Multiplier, statement: Statement, shares: np.ndarray, w: np.ndarray) -> np.ndarray:
    """1 + L (B, N) in floats of members, as of `value_set.with_unknown`, of a statement with a multiplier."""
    at_none, at_one = with_unknown(statement, shares, w)
    m = stated.response(w)
    closed = at_one / (2 * m.real)
    return np.asarray(closed / (closed - (at_one - at_none) / m.conj()))


def angle_ratios(
    multiplier: Multiplier, stated: Multiplier, statement: Statement, shares: np.ndarray, w: np.ndarray
) -> np.ndarray:
    """1 - Re z / |z| (B, N) of z = M (1 + L), above one where the first multiplier does not fit; members as above."""
    z = multiplier.response(w) * closed_over_denominator(stated, statement, shares, w)
    return np.asarray(1 - z.real / np.abs(z))


def largest_gains(ranges: Mapping[str, tuple[fmpq, fmpq]]) -> dict[str, tuple[fmpq, fmpq]]:
    """Of the gains that a box may have a range of, their largest values alone."""
    return {name: (ranges[name][1],) * 2 for name in ("effect_gain", "controller_gain") if name in ranges}
