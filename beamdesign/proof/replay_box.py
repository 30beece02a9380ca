"""Re-prove a certificate over a box of parameters: this file, python-flint and the standard library suffice.

A certificate states a characteristic polynomial p(s, q) as an expression, a range for every parameter in it, one
member, and a tree that cuts (frequency, parameters) into pieces. Stability of the whole box follows from

1. the member is stable: exact Routh test or, with a delay, a count of its unstable roots by the argument principle;
2. on every piece [w1, w2] x Q of the tree some line through the origin keeps p(jw, q) on one side. At w1 and w2 the
   value lies in the convex hull of control points (corners where p is affine in a parameter, the mapping theorem;
   Bernstein coefficients where it is not); in between it strays from the chord by at most max |p''| (w2 - w1)^2 / 8;
3. on every piece [w1, infinity) x Q the leading coefficient outweighs all others, so that no degree is lost either.

Then no root can cross the imaginary axis anywhere in the box (zero exclusion). The tree is in prefix order, each cut
followed by its lower and its upper side, so that the pieces fill the box by construction. A variable is cut in the
middle of its range, or of its reciprocal's where it enters by that. All values are exact rationals or balls.

Run as `python replay_box.py CERTIFICATE`; exit status 0 if it holds, 1 if it does not, 2 if it cannot be read.
"""

import ast
import hashlib
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb
from pathlib import Path
from typing import Any, NamedTuple

from flint import acb, arb, ctx, fmpq, fmpq_poly

KIND = "beamdesign.box"
VERSION = 1
PRECISION_BITS = 96
ARC_PARTS = 6
"""Tangents around the arc of exp(-jwT)."""

Interval = tuple[fmpq, fmpq]
Point = Mapping[str, fmpq]


class Malformed(ValueError):
    """The text is not a certificate that this file can read."""


class Undecided(ArithmeticError):
    """A root lies on the imaginary axis, or too near to it to be told from one."""


def rational(text: str) -> fmpq:
    """A decimal or a quotient p/q, exactly."""
    try:
        if "/" in text:
            above, below = text.split("/")
            return fmpq(int(above), int(below))
        whole, _, decimals = text.partition(".")
        return fmpq(int(whole + decimals), 10 ** len(decimals))
    except (ValueError, ZeroDivisionError) as error:
        raise Malformed(f"not a number: {text!r}") from error


# The statement: expressions, ranges, and the family they make.


class Term(NamedTuple):
    """coefficient * s^degree * product of variable^power."""

    coefficient: fmpq
    degree: int
    powers: Mapping[str, int]


class Node(NamedTuple):
    """Part of p: a "leaf" or "delay" by its name, or the "sum" or "product" of other parts.

    `bound` says whether it depends on a leaf that is enumerated.
    """

    kind: str
    name: str
    parts: tuple["Node", ...]
    bound: bool


def polynomial(text: str) -> tuple[Term, ...]:
    """Expand a polynomial in s and in parameters or their reciprocals: + - * / ** of names and whole numbers."""
    expanded = _expand(_parsed(text))
    return tuple(
        Term(c, dict(powers).get("s", 0), {name: e for name, e in powers if name != "s"})
        for powers, c in sorted(expanded.items())
        if c != 0
    )


def _parsed(text: str) -> ast.expr:
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise Malformed(f"not an expression: {text!r}") from error


_Expanded = dict[tuple[tuple[str, int], ...], fmpq]


def _expand(node: ast.expr) -> _Expanded:
    match node:
        case ast.Constant(value=int(value)):
            return {(): fmpq(value)}
        case ast.Name(id=name):
            return {((name, 1),): fmpq(1)}
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return {powers: -c for powers, c in _expand(inner).items()}
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as operation, right=right):
            total, sign = dict(_expand(left)), 1 if isinstance(operation, ast.Add) else -1
            for powers, c in _expand(right).items():
                total[powers] = total.get(powers, fmpq(0)) + sign * c
            return total
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _times_out(_expand(left), _expand(right))
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return _times_out(_expand(left), _reciprocal(_expand(right)))
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if power <= 99:
            base, total = _expand(left), {(): fmpq(1)}
            for _ in range(power):
                total = _times_out(total, base)
            return total
    raise Malformed(f"not a polynomial: {ast.unparse(node)}")


def _times_out(a: _Expanded, b: _Expanded) -> _Expanded:
    total: _Expanded = {}
    for (powers, c), (others, d) in product(a.items(), b.items()):
        merged = dict(powers)
        for name, power in others:
            merged[name] = merged.get(name, 0) + power
        key = tuple(sorted((name, power) for name, power in merged.items() if power))
        total[key] = total.get(key, fmpq(0)) + c * d
    return total


def _reciprocal(a: _Expanded) -> _Expanded:
    if len(a) != 1 or any(c == 0 or dict(powers).get("s") for powers, c in a.items()):
        raise Malformed("only a single term without s can be divided by")
    ((powers, c),) = a.items()
    return {tuple((name, -power) for name, power in powers): 1 / c}


def _structure(node: ast.expr, leaves: Iterable[str], delays: Mapping[str, str], bound: Iterable[str]) -> Node:
    match node:
        case ast.Name(id=name) if name in leaves:
            return Node("leaf", name, (), name in bound)
        case ast.Name(id=name) if name in delays:
            return Node("delay", delays[name], (), False)
        case ast.BinOp(left=left, op=ast.Add() | ast.Mult() as operation, right=right):
            kind = "sum" if isinstance(operation, ast.Add) else "product"
            parts = [_structure(side, leaves, delays, bound) for side in (left, right)]
            flat = [p for part in parts for p in (part.parts if part.kind == kind else (part,))]
            return Node(kind, "", tuple(flat), any(part.bound for part in flat))
    raise Malformed(f"not a sum or product of leaves: {ast.unparse(node)}")


class Statement:
    """What a certificate is about: p, and the ranges of its variables.

    Attributes:
        leaves: expanded polynomials by name; "s" is one of them.
        bound: names of leaves that are enumerated over their control points, those in one pack on a common grid.
        body: p over leaves and delays.
        parameters: range of each parameter.
        ranges: range of each variable; a group of parameters is one variable.
        inner: ranges as they enter, reciprocals where the powers are negative.
        delay: the variable that is the delay in s; None where there is none.
        varying: names of variables that are not fixed.
        degree: highest power of s without the delay, and with it (-1 for none).
    """

    def __init__(
        self,
        p: str,
        parameters: Mapping[str, Interval],
        leaves: Mapping[str, str] | None = None,
        bound: Sequence[Sequence[str]] = (),
        delays: Mapping[str, str] | None = None,
        groups: Sequence[tuple[str, str, Sequence[str]]] = (),
    ):
        if not leaves:
            leaves, p = {"p": p}, "p"
        self.leaves = {"s": polynomial("s")} | {name: polynomial(text) for name, text in leaves.items()}
        self.bound, self.groups = [tuple(pack) for pack in bound], list(groups)
        enumerated = {name for pack in self.bound for name in pack}
        self.body = _structure(_parsed(p), self.leaves, delays or {}, enumerated)
        if len(delays or {}) > 1:
            raise Malformed("there may be one delay")
        self.delay = next(iter((delays or {}).values()), None)
        self.parameters = dict(parameters)
        self.ranges = self.merged(self.parameters)
        terms = [term for leaf in self.leaves.values() for term in leaf]
        signs = {(name, power > 0) for term in terms for name, power in term.powers.items()}
        signs |= {(self.delay, True)} if self.delay is not None else set()
        if unknown := sorted({name for name, _ in signs} - set(self.ranges)):
            raise Malformed(f"no range for {', '.join(unknown)}")
        self.reciprocal = {name for name, positive in signs if not positive}
        for name in self.reciprocal:
            if (name, True) in signs or not self.ranges[name][0] > 0:
                raise Malformed(f"{name} enters by its reciprocal: it must be positive and enter in no other way")
        if self.delay is not None and self.ranges[self.delay][0] < 0:
            raise Malformed("a delay is negative")
        self.inner = {n: (1 / b, 1 / a) if n in self.reciprocal else (a, b) for n, (a, b) in self.ranges.items()}
        self.varying = tuple(name for name, (low, high) in self.ranges.items() if low < high)
        self.components = {name: self._components(leaf) for name, leaf in self.leaves.items()}
        self.degree = self._degree(self.body)
        if self.degree[1] >= self.degree[0]:
            raise Malformed("the highest power of s is delayed: loops of neutral type are not covered")
        self._affine(self.body)

    def merged(self, parameters: Mapping[str, Interval]) -> dict[str, Interval]:
        """Ranges of the variables from those of the parameters: exact for sums, and for products of nonnegatives."""
        ranges = dict(parameters)
        if empty := [name for name, (low, high) in ranges.items() if low > high]:
            raise Malformed(f"empty range of {', '.join(empty)}")
        for name, kind, members in self.groups:
            if kind not in ("sum", "product") or name in ranges or set(members) - set(ranges):
                raise Malformed(f"not a group: {name}")
            low, high = ranges.pop(members[0])
            for member in members[1:]:
                a, b = ranges.pop(member)
                if kind == "product" and min(a, low) < 0:
                    raise Malformed(f"{name}: a factor may be negative")
                low, high = (low + a, high + b) if kind == "sum" else (low * a, high * b)
            ranges[name] = (low, high)
        return ranges

    def _components(self, leaf: Sequence[Term]) -> list[tuple[int, dict[str, int], list[Term]]]:
        """Terms gathered by common varying variables: (axis, degree of each, terms); axis 2 is neither 0 nor 1."""
        gathered: list[tuple[set[str], list[Term]]] = []
        for term in leaf:
            names = set(term.powers) & set(self.varying)
            joined = [item for item in gathered if item[0] & names]
            gathered = [item for item in gathered if not item[0] & names]
            gathered.append((names.union(*(n for n, _ in joined)), [t for _, ts in joined for t in ts] + [term]))
        found = []
        for names, terms in gathered:
            parities = {term.degree % 2 for term in terms}
            degrees = {name: max(abs(t.powers.get(name, 0)) for t in terms) for name in sorted(names)}
            found.append((parities.pop() if len(parities) == 1 else 2, degrees, terms))
        return found

    def pack_degrees(self, pack: Sequence[str]) -> dict[str, int]:
        """The common grid of leaves that are bound together: degree in each varying variable."""
        degrees: dict[str, int] = {}
        for name in pack:
            for _, own, _ in self.components[name]:
                degrees = {n: max(own.get(n, 0), degrees.get(n, 0)) for n in sorted(own | degrees)}
        return degrees

    def _affine(self, node: Node) -> dict[Any, int]:
        """Degree in each pack of bound leaves, and in the delays under None; none may exceed one."""
        if node.kind == "delay":
            return {None: 1}
        if node.kind == "leaf":
            return {i: 1 for i, pack in enumerate(self.bound) if node.name in pack}
        parts = [self._affine(part) for part in node.parts]
        merge = max if node.kind == "sum" else sum
        degrees = {key: merge(part.get(key, 0) for part in parts) for key in {k for part in parts for k in part}}
        if any(degree > 1 for degree in degrees.values()):
            raise Malformed("p is not affine in what is bound, or delays multiply each other")
        return degrees

    def _degree(self, node: Node) -> tuple[int, int]:
        if node.kind == "delay":
            return -1, 0
        if node.kind == "leaf":
            return max((term.degree for term in self.leaves[node.name]), default=-1), -1
        parts = [self._degree(part) for part in node.parts]
        if node.kind == "sum":
            return max(a for a, _ in parts), max(b for _, b in parts)
        plain, late = parts[0]
        for a, b in parts[1:]:
            late = max(late + a if min(late, a) >= 0 else -1, plain + b if min(plain, b) >= 0 else -1)
            plain = plain + a if min(plain, a) >= 0 else -1
        return plain, late


# One member: exact polynomials, Routh, and the argument principle.


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


def is_hurwitz(whole: fmpq_poly) -> bool:
    """Exact Routh test: whether all roots lie in the open left half plane."""
    coefficients = whole.coeffs()
    upper, lower = coefficients[-1::-2], coefficients[-2::-2]
    while lower:
        if lower[0] * upper[0] <= 0:
            return False
        ratio = upper[0] / lower[0]
        padded = [*lower, *([fmpq(0)] * (len(upper) - len(lower)))]
        upper, lower = lower, [u - ratio * v for u, v in zip(upper[1:], padded[1:], strict=True)]
    return bool(upper)


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
        return _on_axis(plain, w) + _on_axis(late, w) * _unit(arb(w * delay))

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


def _unit(angle: arb) -> acb:
    return acb(angle.cos(), -angle.sin())


# Pieces: hulls of control points at one frequency, and what happens between two.


class Cell:
    """A sub-box: of each varying variable the share [start, end] of its range."""

    def __init__(self, statement: Statement, shares: Mapping[str, Interval]):
        self.statement, self.shares = statement, dict(shares)
        self.values = dict(statement.inner)
        for name, (start, end) in self.shares.items():
            low, high = statement.inner[name]
            self.values[name] = (low + (high - low) * start, low + (high - low) * end)
        self._grids: dict[tuple[str, int], list[dict[int, arb]]] = {}
        self._frames: dict[fmpq, Frame] = {}

    def half(self, name: str, upper: bool) -> "Cell":
        """The lower or the upper half in one variable."""
        start, end = self.shares[name]
        middle = (start + end) / 2
        return Cell(self.statement, self.shares | {name: (middle, end) if upper else (start, middle)})

    def grid(self, key: tuple[str, int], terms: Sequence[Term], degrees: Mapping[str, int]) -> list[dict[int, arb]]:
        """Control points of some terms: for each the coefficients by power of s."""
        if key not in self._grids:
            self._grids[key] = []
            for index in product(*(range(degree + 1) for degree in degrees.values())):
                corner = dict(zip(degrees, index, strict=True))
                total: dict[int, fmpq] = {}
                for c, degree, powers in terms:
                    for name, power in powers.items():
                        c = c * _control_value(
                            *self.values[name], abs(power), degrees.get(name, 0), corner.get(name, 0)
                        )
                    total[degree] = total.get(degree, fmpq(0)) + c
                self._grids[key].append({degree: arb(c) for degree, c in total.items()})
        return self._grids[key]

    def frame(self, w: fmpq) -> "Frame":
        """The hulls at one frequency; the last few are kept, since pieces share their ends."""
        if w not in self._frames:
            if len(self._frames) > 3:
                self._frames.pop(next(iter(self._frames)))
            self._frames[w] = Frame(self, w)
        return self._frames[w]


def _control_value(low: fmpq, high: fmpq, power: int, degree: int, i: int) -> fmpq:
    """Bernstein coefficient i of x^power on [low, high], raised to a degree; x^power itself where that is 0."""
    if degree == 0:
        return low**power
    terms = (comb(i, j) * comb(degree - i, power - j) * high**j * low ** (power - j) for j in range(power + 1))
    return sum(terms, fmpq(0)) / comb(degree, power)


class Frame:
    """Points whose convex hull holds each part of p at one exact frequency, over one cell."""

    def __init__(self, cell: Cell, w: fmpq):
        self.cell, self.w = cell, w
        self._powers = [arb(w**i) for i in range(max(*cell.statement.degree, 2) + 1)]
        self._known: dict[tuple[int, int], list[acb]] = {}
        packs = [self._pack(pack) for pack in cell.statement.bound]
        self.controls = [{name: v for part in chosen for name, v in part.items()} for chosen in product(*packs)]

    def _value(self, coefficients: Mapping[int, arb]) -> acb:
        parts = [arb(0), arb(0)]
        for degree, c in coefficients.items():
            term = c * self._powers[degree]
            parts[degree % 2] += -term if degree % 4 >= 2 else term
        return acb(*parts)

    def _leaf(self, name: str) -> list[acb]:
        """An interval along either axis, and control points of what lies along neither."""
        points, ends = [acb(0)], ([arb(0), arb(0)], [arb(0), arb(0)])
        for i, (axis, degrees, terms) in enumerate(self.cell.statement.components[name]):
            values = [self._value(c) for c in self.cell.grid((name, i), terms, degrees)]
            if axis == 2 or len(values) == 1:
                points = [a + b for a in points for b in values]
                continue
            numbers = [v.imag if axis else v.real for v in values]
            low = high = numbers[0]
            for number in numbers[1:]:
                low, high = low.min(number), high.max(number)
            ends[axis][0] += low
            ends[axis][1] += high
        for (low, high), turn in zip(ends, (acb(1), acb(0, 1)), strict=True):
            steps = [turn * low] if low == 0 and high == 0 else [turn * low, turn * high]
            points = [point + step for point in points for step in steps]
        return points

    def _pack(self, pack: Sequence[str]) -> list[dict[str, acb]]:
        if len(pack) == 1:
            return [{pack[0]: point} for point in self._leaf(pack[0])]
        statement = self.cell.statement
        degrees = statement.pack_degrees(pack)
        columns = [
            [self._value(c) for c in self.cell.grid((name, -1), statement.leaves[name], degrees)] for name in pack
        ]
        return [dict(zip(pack, values, strict=True)) for values in zip(*columns, strict=True)]

    def points(self, node: Node, control: Mapping[str, acb]) -> list[acb]:
        """Points whose hull holds a part of p, with what is bound at one of its control points."""
        if node.kind == "leaf" and node.bound:
            return [control[node.name]]
        key = (id(node), id(control) if node.bound else 0)
        if key in self._known:
            return self._known[key]
        if node.kind == "leaf":
            found = self._leaf(node.name)
        elif node.kind == "delay":
            found = self._arc(*self.cell.values[node.name])
        else:
            found = self.points(node.parts[0], control)
            for part in node.parts[1:]:
                other = self.points(part, control)
                found = [a + b if node.kind == "sum" else a * b for a in found for b in other]
        self._known[key] = found
        return found

    def _arc(self, least: fmpq, most: fmpq) -> list[acb]:
        """The ends of the arc exp(-jwT) and the corners of tangents around it."""
        start, sweep, turn = arb(self.w * least), arb(self.w * (most - least)), 2 * arb.pi()
        if least == most:
            return [_unit(start)]
        sweep = sweep if sweep < turn else turn
        shrink = (sweep / (2 * ARC_PARTS)).cos()
        corners = [_unit(start + sweep * (2 * i + 1) / (2 * ARC_PARTS)) / shrink for i in range(ARC_PARTS)]
        return [_unit(start), *corners, _unit(start + sweep)]

    def least(self, direction: tuple[int, int]) -> arb:
        """Lower bound of the real part of p times the conjugate of a direction, over the cell."""
        u, nodes = acb(direction[0], -direction[1]), _summands(self.cell.statement)
        common = sum((_least(u, self.points(node, {})) for node in nodes if not node.bound), arb(0))
        least = arb.pos_inf()
        for control in self.controls:
            own = (_least(u, self.points(node, control)) for node in nodes if node.bound)
            least = least.min(sum(own, common))
        return least


def _least(u: acb, points: Sequence[acb]) -> arb:
    least = (u * points[0]).real
    for point in points[1:]:
        least = least.min((u * point).real)
    return least


def _summands(statement: Statement) -> tuple[Node, ...]:
    return statement.body.parts if statement.body.kind == "sum" else (statement.body,)


def growth(frames: tuple[Frame, Frame], node: Node) -> tuple[arb, arb, arb]:
    """Bounds of |f|, |df/dw| and |d2f/dw2| of a part of p between two frequencies, over their cell."""
    cell = frames[0].cell
    statement = cell.statement
    if node.kind == "delay":
        most = arb(cell.values[node.name][1])
        return arb(1), most, most * most
    if node.kind == "product":
        size, slope, bend = arb(1), arb(0), arb(0)
        for part in node.parts:
            f, df, ddf = growth(frames, part)
            bend, slope, size = bend * f + 2 * slope * df + size * ddf, slope * f + size * df, size * f
        return size, slope, bend
    if node.kind == "leaf":
        slope, bend = _steepness(cell, statement.leaves[node.name], frames[1].w)
    else:
        parts = [growth(frames, part) for part in node.parts]
        slope, bend = sum((df for _, df, _ in parts), arb(0)), sum((ddf for _, _, ddf in parts), arb(0))
    size = arb(0)
    for frame in frames:
        for control in frame.controls if node.bound else [{}]:
            for point in frame.points(node, control):
                size = size.max(abs(point))
    return size + _stray(frames, bend), slope, bend


def _stray(frames: tuple[Frame, Frame], bend: arb) -> arb:
    """How far a curve strays from its chord at most."""
    return bend * ((frames[1].w - frames[0].w) ** 2 / 8)


def _steepness(cell: Cell, leaf: Sequence[Term], w: fmpq) -> tuple[arb, arb]:
    slope = bend = fmpq(0)
    for c, degree, powers in leaf:
        most = abs(c)
        for name, power in powers.items():
            most *= _most(cell.values[name]) ** abs(power)
        slope += most * degree * w ** max(degree - 1, 0)
        bend += most * degree * (degree - 1) * w ** max(degree - 2, 0)
    return arb(slope), arb(bend)


def separated(cell: Cell, w1: fmpq, w2: fmpq, direction: tuple[int, int]) -> bool:
    """Whether p(jw, q) stays on one side of the line across a direction, w1 <= w <= w2 and q in the cell."""
    frames = cell.frame(w1), cell.frame(w2)
    bend = sum((growth(frames, node)[2] for node in _summands(cell.statement)), arb(0))
    stray = arb(direction[0] ** 2 + direction[1] ** 2).sqrt() * _stray(frames, bend)
    return all(bool(frame.least(direction) > stray) for frame in frames)


def dominated(cell: Cell, w: fmpq) -> bool:
    """Whether the leading term outweighs all others from a frequency up, so that p vanishes nowhere there."""
    n, _ = cell.statement.degree
    if not w > 0:
        return False
    plain, late = coefficients(cell, cell.statement.body)
    low, high = plain[n]
    others = _at([_most(c) for c in plain[:n]], w) + _at([_most(c) for c in late], w)
    return bool(others < max(low, -high) * w**n)


def coefficients(cell: Cell, node: Node) -> tuple[list[Interval], list[Interval]]:
    """Ranges of the coefficients without delay, and of the sizes of those that the delay multiplies."""
    if node.kind == "delay":
        return [], [(fmpq(0), fmpq(1))]
    if node.kind == "leaf":
        leaf = cell.statement.leaves[node.name]
        found = [(fmpq(0), fmpq(0))] * (max((term.degree for term in leaf), default=0) + 1)
        for c, degree, powers in leaf:
            value = (c, c)
            for name, power in powers.items():
                for _ in range(abs(power)):
                    value = _times(value, cell.values[name])
            found[degree] = (found[degree][0] + value[0], found[degree][1] + value[1])
        return found, []
    parts = [coefficients(cell, part) for part in node.parts]
    plain, late = parts[0]
    for more, later in parts[1:]:
        if node.kind == "sum":
            plain, late = _add(plain, more), _add(late, later)
        else:
            sizes = [[(fmpq(0), _most(c)) for c in side] for side in (plain, more)]
            late = _add(_convolve(sizes[0], later), _convolve(late, sizes[1]))
            plain = _convolve(plain, more)
    return plain, late


def _most(interval: Interval) -> fmpq:
    return max(abs(interval[0]), abs(interval[1]))


def _times(a: Interval, b: Interval) -> Interval:
    ends = [x * y for x in a for y in b]
    return min(ends), max(ends)


def _add(a: list[Interval], b: list[Interval]) -> list[Interval]:
    longer, shorter = (a, b) if len(a) >= len(b) else (b, a)
    zero = (fmpq(0), fmpq(0))
    padded = shorter + [zero] * (len(longer) - len(shorter))
    return [(x[0] + y[0], x[1] + y[1]) for x, y in zip(longer, padded, strict=True)]


def _convolve(a: list[Interval], b: list[Interval]) -> list[Interval]:
    total = [(fmpq(0), fmpq(0))] * (len(a) + len(b) - 1 if a and b else 0)
    for (i, x), (j, y) in product(enumerate(a), enumerate(b)):
        low, high = _times(x, y)
        total[i + j] = (total[i + j][0] + low, total[i + j][1] + high)
    return total


# The tree.


class Piece(NamedTuple):
    """One leaf of the tree: a cell and the frequencies from w1 to w2 (None: all above w1).

    `direction` is that of the separating line, None where the leading term is to outweigh the others, or "?" where
    nothing is claimed.
    """

    cell: Cell
    w1: fmpq
    w2: fmpq | None
    direction: tuple[int, int] | str | None


def pieces(statement: Statement, tree: Sequence[str]) -> Iterator[Piece]:
    """Walk a tree of the marks NAME (cut in a variable), w=VALUE, X,Y (a line), "inf" and "?".

    Raises:
        Malformed: where the tree ends too soon or too late, or cuts outside of its pieces.
    """
    whole = {name: (fmpq(0), fmpq(1)) for name in statement.varying}
    open_pieces: list[tuple[Cell, fmpq, fmpq | None]] = [(Cell(statement, whole), fmpq(0), None)]
    for mark in tree:
        if not open_pieces:
            raise Malformed("the tree goes on after all pieces are settled")
        cell, w1, w2 = open_pieces.pop()
        if mark in cell.shares:
            open_pieces += [(cell.half(mark, True), w1, w2), (cell.half(mark, False), w1, w2)]
        elif mark.startswith("w="):
            w = rational(mark[2:])
            if not w > w1 or (w2 is not None and not w < w2):
                raise Malformed(f"{mark} does not cut its piece")
            open_pieces += [(cell, w, w2), (cell, w1, w)]
        elif mark == "?":
            yield Piece(cell, w1, w2, "?")
        elif mark == "inf":
            yield Piece(cell, w1, w2, None)
        else:
            try:
                x, y = mark.split(",")
                yield Piece(cell, w1, w2, (int(x), int(y)))
            except ValueError as error:
                raise Malformed(f"not a mark of the tree: {mark!r}") from error
    if open_pieces:
        raise Malformed("the tree ends before all pieces are settled")


def holds(piece: Piece) -> bool:
    """Whether p vanishes nowhere on a piece, by what the piece claims."""
    if piece.direction is None:
        return piece.w2 is None and dominated(piece.cell, piece.w1)
    if isinstance(piece.direction, str) or piece.w2 is None:
        return False
    return separated(piece.cell, piece.w1, piece.w2, piece.direction)


# The certificate.


@dataclass(frozen=True)
class Replay:
    """Outcome of a replay.

    Attributes:
        valid: whether the certificate's claim was proved again.
        reasons: in words, what was not proved.
        claims: in words, what was checked or proved.
    """

    valid: bool
    reasons: tuple[str, ...]
    claims: tuple[str, ...]


def replay(source: str | Path) -> Replay:
    """Prove a certificate again, from its path or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    try:
        text = source if isinstance(source, str) and "\n" in source else Path(source).read_text(encoding="utf-8")
        table = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise Malformed(f"cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise Malformed(f"not valid TOML: {error}") from error
    if table.get("kind") != KIND or table.get("version") != VERSION:
        raise Malformed(f"kind and version must be {KIND!r} and {VERSION}")
    try:
        with ctx.workprec(PRECISION_BITS):
            results = list(_statements(table, text))
    except (KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise Malformed(f"an entry is missing or of the wrong kind: {error}") from error
    reasons = tuple(words for proved, words in results if not proved)
    return Replay(not reasons, reasons, tuple(words for proved, words in results if proved))


def _statements(table: dict[str, Any], text: str) -> Iterator[tuple[bool, str]]:
    checksum = f'sha256 = "{table["sha256"]}"\n'
    intact = hashlib.sha256(text.replace(checksum, "", 1).encode()).hexdigest() == table["sha256"]
    yield intact, "the text is as it was written" if intact else "the text was altered after it was written (sha256)"
    statement = Statement(
        table["p"],
        {name: (rational(low), rational(high)) for name, (low, high) in table["range"].items()},
        table.get("leaf"),
        table.get("bound", []),
        table.get("delay"),
        [(group["name"], group["kind"], group["members"]) for group in table.get("group", [])],
    )
    point = {name: rational(value) for name, value in table["member"].items()}
    inside = set(point) == set(statement.parameters) and all(
        low <= point[name] <= high for name, (low, high) in statement.parameters.items()
    )
    yield inside, "the member lies in the box" if inside else "the member does not lie in the box"
    if not inside:
        return
    try:
        stable = is_stable(statement, member(statement, point))
    except Undecided as error:
        yield False, f"the member: {error}"
        return
    yield stable == table["stable"], f"the member is {'stable' if stable else 'not stable'}"
    if not table["stable"]:
        return
    count = 0
    for piece in pieces(statement, [mark for line in table["tree"] for mark in line.split()]):
        count += 1
        if not holds(piece):
            upper = "infinity" if piece.w2 is None else f"{float(arb(piece.w2)):.6g}"
            yield False, f"piece {count}, {float(arb(piece.w1)):.6g} to {upper} rad/s, is not free of roots"
            return
    yield True, f"no root on the imaginary axis at any frequency for any member: {count} pieces"


def main(arguments: Sequence[str]) -> int:
    """Replay one certificate, and say what was proved and what was not."""
    if len(arguments) != 1:
        print("usage: python replay_box.py CERTIFICATE", file=sys.stderr)
        return 2
    try:
        outcome = replay(Path(arguments[0]))
    except Malformed as error:
        print(f"{arguments[0]}: {error}", file=sys.stderr)
        return 2
    for words in outcome.claims:
        print(f"checked: {words}")
    for words in outcome.reasons:
        print(f"FAILED: {words}")
    print("valid" if outcome.valid else "not valid")
    return 0 if outcome.valid else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
