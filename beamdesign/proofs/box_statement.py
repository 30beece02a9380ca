"""A characteristic polynomial over a box of parameters, as a certificate states it: expression, ranges, degrees."""

import ast
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

from flint import fmpq

Interval = tuple[fmpq, fmpq]
Point = Mapping[str, fmpq]


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
        raise ValueError(f"not an expression: {text!r}") from error


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
    raise ValueError(f"not a polynomial: {ast.unparse(node)}")


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
        raise ValueError("only a single term without s can be divided by")
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
    raise ValueError(f"not a sum or product of leaves: {ast.unparse(node)}")


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
            raise ValueError("there may be one delay")
        self.delay = next(iter((delays or {}).values()), None)
        self.parameters = dict(parameters)
        self.ranges = self.merged(self.parameters)
        terms = [term for leaf in self.leaves.values() for term in leaf]
        signs = {(name, power > 0) for term in terms for name, power in term.powers.items()}
        signs |= {(self.delay, True)} if self.delay is not None else set()
        if unknown := sorted({name for name, _ in signs} - set(self.ranges)):
            raise ValueError(f"no range for {', '.join(unknown)}")
        self.reciprocal = {name for name, positive in signs if not positive}
        for name in self.reciprocal:
            if (name, True) in signs or not self.ranges[name][0] > 0:
                raise ValueError(f"{name} enters by its reciprocal: it must be positive and enter in no other way")
        if self.delay is not None and self.ranges[self.delay][0] < 0:
            raise ValueError("a delay is negative")
        self.inner = {n: (1 / b, 1 / a) if n in self.reciprocal else (a, b) for n, (a, b) in self.ranges.items()}
        self.varying = tuple(name for name, (low, high) in self.ranges.items() if low < high)
        self.components = {name: self._components(leaf) for name, leaf in self.leaves.items()}
        self.degree = self._degree(self.body)
        if self.degree[1] >= self.degree[0]:
            raise ValueError("the highest power of s is delayed: loops of neutral type are not covered")
        self._affine(self.body)

    def merged(self, parameters: Mapping[str, Interval]) -> dict[str, Interval]:
        """Ranges of the variables from those of the parameters: exact for sums, and for products of nonnegatives."""
        ranges = dict(parameters)
        if empty := [name for name, (low, high) in ranges.items() if low > high]:
            raise ValueError(f"empty range of {', '.join(empty)}")
        for name, kind, members in self.groups:
            if kind not in ("sum", "product") or name in ranges or set(members) - set(ranges):
                raise ValueError(f"not a group: {name}")
            low, high = ranges.pop(members[0])
            for member in members[1:]:
                a, b = ranges.pop(member)
                if kind == "product" and min(a, low) < 0:
                    raise ValueError(f"{name}: a factor may be negative")
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
            raise ValueError("p is not affine in what is bound, or delays multiply each other")
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
