"""Zames-Falb multipliers with a Popov term, and the exact proof that one fits a loop at every mass and frequency.

Cut at the current, a loop is u = -L(s, m) i + r and i = phi(u), phi a static characteristic whose slope lies between 0
and 1: a saturation, a dead band, a soft limit. With kernels h_i, whose L1 norm is one, and

    M(s) = 1 - sum_i c_i h_i(s) + q s,    sum_i |c_i| < 1,    q >= 0,

the loop comes to rest from every state if L is stable and Re[M(jw) (1 + L(jw))] is above a positive number at every w
(G. Zames and P. L. Falb, SIAM J. Control 6 (1968) 89; q is V. M. Popov's, Autom. Remote Control 22 (1962) 857; both
in one multiplier: U. Joensson, Systems & Control Letters 31 (1997) 93; kernels that are not causal: J. C. Willems, The
Analysis of Feedback Systems, 1971). Where every c_i is positive phi need not be odd, so that it may be seen from any
equilibrium; else it has to be odd, and the equilibrium is that without current.

The kernels are h(s) = (a / (a + s))^k and, not causal, (a / (a - s))^k: positive in time, with an integral of one. So
M(jw) = (A(x) + j w B(x)) / Q(x) over x = w^2 with Q the product of powers of a^2 + x, and with 1 + L = p / D, both
affine in the mass, Re[M p conj(D)] is a quadratic in the mass with polynomials in x as coefficients.

Over a box of parameters Re[M (1 + L)] > 0 is zero exclusion with one more unknown. With L = N / D, A and Q positive,

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
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.polynomial import Affine, inner, is_hurwitz, nearest, text
from beamdesign.proofs.quadratic import Coefficients, first_negative, less, over_mass
from beamdesign.proofs.read_once import Expression
from beamdesign.proofs.statement import UNKNOWN, Statement
from beamdesign.proofs.value_set import with_unknown

_S = fmpq_poly([0, 1])
_ONE = fmpq_poly([1])
_NONE, _UNIT = fmpq(0), fmpq(1)


@dataclass(frozen=True, order=True)
class Kernel:
    """(a / (a + s))^k, or with -s in the place of s where it is not causal; its L1 norm is one.

    Attributes:
        rate: a, 1/s.
        order: k.
        causal: whether it stands at times after zero.
    """

    rate: int
    order: int
    causal: bool = True

    def response(self, w: np.ndarray) -> np.ndarray:
        """Its values at angular frequencies (rad/s), complex, of their shape."""
        sign = 1 if self.causal else -1
        return np.asarray((self.rate / (self.rate + sign * 1j * w)) ** self.order)

    @property
    def factor(self) -> fmpq_poly:
        """A + s, or a - s."""
        return fmpq_poly([self.rate, 1 if self.causal else -1])


@dataclass(frozen=True)
class Multiplier:
    """1 - sum of coefficients times kernels + popov_s s.

    Attributes:
        terms: coefficient and kernel of each.
        popov_s: q, s.
    """

    terms: tuple[tuple[fmpq, Kernel], ...]
    popov_s: fmpq

    @property
    def admissible(self) -> bool:
        """Whether the theorem knows it: its absolute coefficients sum to less than one, and q is not negative."""
        return sum((abs(coefficient) for coefficient, _ in self.terms), _NONE) < 1 and self.popov_s >= 0

    @property
    def for_odd_only(self) -> bool:
        """Whether the characteristic has to be odd."""
        return any(coefficient < 0 for coefficient, _ in self.terms)

    @cached_property
    def below(self) -> fmpq_poly:
        """Q in x = w^2, which is positive."""
        orders: dict[int, int] = {}
        for _, kernel in self.terms:
            orders[kernel.rate] = max(orders.get(kernel.rate, 0), kernel.order)
        return prod((fmpq_poly([rate**2, 1]) ** order for rate, order in orders.items()), start=_ONE)

    @cached_property
    def above(self) -> fmpq_poly:
        """A + s B in s, where M(jw) = (A + j w B) / Q with A and B in x = w^2."""
        whole = self.below(-_S * _S)
        kernels = (c * k.rate**k.order * (whole / k.factor**k.order) for c, k in self.terms)
        return whole * (1 + self.popov_s * _S) - sum(kernels, 0 * whole)

    def response(self, w: np.ndarray) -> np.ndarray:
        """Its values at angular frequencies (rad/s), complex, of their shape."""
        total = 1 + 1j * w * nearest(self.popov_s)
        for coefficient, kernel in self.terms:
            total = total - nearest(coefficient) * kernel.response(w)
        return np.asarray(total)

    def table(self) -> dict[str, Any]:
        """As a certificate states it."""
        terms = [
            {"coefficient": text(c), "rate_per_s": text(fmpq(k.rate)), "order": k.order, "causal": k.causal}
            for c, k in self.terms
        ]
        return {"popov_s": text(self.popov_s), "term": terms}

    def __str__(self) -> str:
        parts = [
            f"{'-' if c > 0 else '+'} {text(abs(c))} ({k.rate}/({k.rate} {'+' if k.causal else '-'} s))^{k.order}"
            for c, k in self.terms
        ]
        popov = [f"+ {text(self.popov_s)} s"] if self.popov_s else []
        return " ".join(["1", *parts, *popov])


def is_proper(above: Affine, below: Affine, low: fmpq, high: fmpq) -> bool:
    """Whether L = above / below falls off at least as 1/s at every mass of a range, so that s L is bounded."""
    degree = below.constant.degree()
    lead = [below.at(mass)[degree] for mass in (low, high)]
    same = below.slope.degree() <= degree and lead[0] * lead[1] > 0
    return same and max(above.constant.degree(), above.slope.degree()) < degree


def slack(multiplier: Multiplier, closed: Affine, denominator: Affine, margin: fmpq) -> Coefficients:
    """(Re[M p / D] - margin) |D|^2 Q at jw as a quadratic a m^2 + b m + c in the mass, with D the denominator."""

    def size(left: fmpq_poly, right: fmpq_poly) -> fmpq_poly:
        return margin * multiplier.below * inner(left, right)

    turned = closed * multiplier.above
    return less(_UNIT, over_mass(inner, turned, denominator), over_mass(size, denominator, denominator))


def fits(multiplier: Multiplier, closed: Affine, denominator: Affine, low: fmpq, high: fmpq, margin: fmpq) -> bool:
    """Whether Re[M p / D] is at least a margin at every mass (kg) and frequency."""
    return first_negative(slack(multiplier, closed, denominator, margin), low, high) is None


# Over a box, as zero exclusion.


_LEAVES = "multiplier_even", "multiplier_plain", "multiplier_turned"


def weights(multiplier: Multiplier) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly]:
    """2 A, A + s B and A - s B in s."""
    whole, mirrored = multiplier.above, multiplier.above(-_S)
    return whole + mirrored, whole, mirrored


def weighed(form: Expression, multiplier: Multiplier) -> Expression:
    """The expression of D + u N, u being the unknown, as that of a slope, where it is another."""
    of_denominator, plain, turned = _LEAVES

    def written(node: ast.expr) -> tuple[str, bool]:
        """A part, and whether the unknown stands in it; what it is added to is of the opened loop."""
        match node:
            case ast.Name(id=name):
                return (f"({plain} + {turned}*{UNKNOWN})", True) if name == UNKNOWN else (name, False)
            case ast.BinOp(left=left, op=ast.Add() | ast.Mult() as operation, right=right):
                (a, in_a), (b, in_b) = written(left), written(right)
                if isinstance(operation, ast.Mult):
                    return f"{a}*{b}", in_a or in_b
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
