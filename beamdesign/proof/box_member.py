"""One member of a box: its polynomials, exact, and how many of its roots are unstable."""

from collections.abc import Sequence
from dataclasses import dataclass

from flint import acb, arb, fmpq, fmpq_poly

from beamdesign.polynomial import is_hurwitz
from beamdesign.proof.box_statement import Node, Point, Statement


class Undecided(ArithmeticError):
    """A root lies on the imaginary axis, or too near to it to be told from one."""


@dataclass(frozen=True)
class Member:
    """plain(s) + late(s) exp(-s delay), the delay in s."""

    plain: fmpq_poly
    late: fmpq_poly
    delay: fmpq


def member(statement: Statement, parameters: Point) -> Member:
    """The member at one value of every parameter, which may lie outside the box."""
    point = {n: a for n, (a, _) in statement.merged({n: (v, v) for n, v in parameters.items()}).items()}
    return member_at(statement, point)


def member_at(statement: Statement, point: Point) -> Member:
    """The member at one value of every variable."""

    def at(node: Node) -> Member:
        zero = fmpq_poly([0])
        if node.kind == "delay":
            return Member(zero, fmpq_poly([1]), point[node.name])
        if node.kind == "leaf":
            total = zero
            for c, degree, powers in statement.leaves[node.name]:
                for name, power in powers.items():
                    c = c * point[name] ** power
                total += fmpq_poly([0] * degree + [c])
            return Member(total, zero, fmpq(0))
        parts = [at(part) for part in node.parts]
        plain, late, delay = parts[0].plain, parts[0].late, max(part.delay for part in parts)
        for part in parts[1:]:
            if node.kind == "sum":
                plain, late = plain + part.plain, late + part.late
            else:
                plain, late = plain * part.plain, plain * part.late + late * part.plain
        return Member(plain, late, delay)

    return at(statement.body)


def is_stable(statement: Statement, one: Member) -> bool:
    """Whether all roots of a member lie in the open left half plane, as many as the family's degree says.

    Raises:
        Undecided: with a delay, where a root is on the axis or too near to it.
    """
    n, _ = statement.degree
    if one.delay == 0 or not any(one.late.coeffs()):
        whole = one.plain + one.late
        return whole.degree() == n and is_hurwitz(whole)
    return one.plain.degree() == n and unstable_roots(one) == 0


def unstable_roots(one: Member) -> int:
    """Number of roots with positive real part of a member whose leading term is not delayed.

    With n the degree, N the number and R a frequency from which the leading term outweighs the rest, the argument of
    p(jw) grows from 0 to R by pi n / 2 - pi N + e, where e is the argument of p(jR) over its leading term (Mikhailov's
    criterion with its remainder). Between two frequencies it grows as along the chord, if that is clear of zero.

    Raises:
        Undecided: where a root is on the axis or too near to it.
    """
    plain, late, delay, n = one.plain, one.late, one.delay, one.plain.degree()
    sizes = [abs(plain[i]) + abs(late[i]) for i in range(n)]
    reach = fmpq(1)
    while not _at(sizes, reach) < abs(plain[n]) * reach**n:
        reach *= 2
    bends = [_second_derivative([abs(c) for c in part.coeffs()], d) for part, d in ((plain, fmpq(0)), (late, delay))]

    def value(w: fmpq) -> acb:
        return _on_axis(plain, w) + _on_axis(late, w) * unit(arb(w * delay))

    turned = arb(0)
    stack = [(fmpq(0), reach, value(fmpq(0)), value(reach))]
    while stack:
        w1, w2, p1, p2 = stack.pop()
        stray = arb(sum(_at(bend, w2) for bend in bends) * (w2 - w1) ** 2 / 8)
        dot = p1.conjugate() * p2
        # The chord's distance from zero is at least the nearer end's times the cosine of half the angle between them.
        if dot.real > 0 and abs(p1).min(abs(p2)) ** 2 * (1 + dot.real / abs(dot)) > 2 * stray * stray:
            turned += (dot.imag / dot.real).atan()
        elif w2 - w1 < reach / 2**60:
            raise Undecided("a root lies on the imaginary axis, or too near to it to be told")
        else:
            middle = (w1 + w2) / 2
            there = value(middle)
            stack += [(middle, w2, there, p2), (w1, middle, p1, there)]
    ahead = value(reach) / (plain[n] * acb(0, reach) ** n)
    count = arb(fmpq(n, 2)) - (turned - (ahead.imag / ahead.real).atan()) / arb.pi()
    whole = count.unique_fmpz()
    if whole is None:
        raise Undecided("the number of unstable roots is not certain")
    return int(whole)


def _at(coefficients: Sequence[fmpq], w: fmpq) -> fmpq:
    return sum((c * w**i for i, c in enumerate(coefficients)), fmpq(0))


def _on_axis(polynomial: fmpq_poly, w: fmpq) -> acb:
    """A real polynomial at s = jw; exact until the very end."""
    coefficients, square = polynomial.coeffs(), -w * w
    parts = [sum((c * square**i for i, c in enumerate(coefficients[side::2])), fmpq(0)) for side in (0, 1)]
    return acb(parts[0], w * parts[1])


def _second_derivative(sizes: Sequence[fmpq], delay: fmpq) -> list[fmpq]:
    """Coefficients in w of a bound of the second derivative of sum c_i (jw)^i exp(-jw delay), |c_i| given."""
    found = [delay * delay * c for c in sizes]
    for i, c in enumerate(sizes):
        if i >= 1:
            found[i - 1] += 2 * delay * i * c
        if i >= 2:
            found[i - 2] += i * (i - 1) * c
    return found


def unit(angle: arb) -> acb:
    """exp(-j angle)."""
    return acb(angle.cos(), -angle.sin())
