"""A characteristic polynomial over a box of parameters, as a certificate states it: expression, ranges, degrees.

A `PolynomialFamily` is a polynomial as sums and products of leaves; over a box of its parameters it is a `Statement`.
"""

import ast
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, reduce
from math import prod
from operator import add, itemgetter, mul, or_, sub, truediv
from textwrap import wrap
from typing import NamedTuple, TypeVar

from flint import Ordering, fmpq, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly

from beamdesign.polynomial import Quotient, exact, text
from beamdesign.proofs.writer import Tables

T = TypeVar("T")
Interval = tuple[fmpq, fmpq]
Point = Mapping[str, fmpq]


class Term(NamedTuple):
    """coefficient * s^degree * product of variable^power."""

    coefficient: fmpq
    degree: int
    powers: Mapping[str, int]

    def times(self, factor: Callable[[str, int], fmpq]) -> fmpq:
        """The coefficient times what each variable and its power come to."""
        return prod((factor(name, power) for name, power in self.powers.items()), start=self.coefficient)


class Circle(NamedTuple):
    """A circle in the complex plane, its centre on the real axis at zero or above."""

    centre: fmpq
    radius: fmpq


_ZERO = fmpq(0)
UNKNOWN = "unknown"
"""What may be any number of a circle."""


class Node(NamedTuple):
    """Part of p: a "leaf", the "inverse" of one, "delay" or "circle" by its name, or the "sum" or "product" of others.

    `packs` are the places of those packs of leaves that are enumerated and on which it depends.
    """

    kind: str
    name: str
    parts: tuple["Node", ...]
    packs: tuple[int, ...] = ()

    def fold(self, one: Callable[["Node"], T], add: Callable[[T, T], T], multiply: Callable[[T, T], T]) -> T:
        """What it comes to where `one` says what each leaf and delay is."""
        if not self.parts:
            return one(self)
        return reduce(add if self.kind == "sum" else multiply, (part.fold(one, add, multiply) for part in self.parts))


@lru_cache(maxsize=1024)  # a family is looked at over many boxes
def polynomial(written: str) -> tuple[Term, ...]:
    """Expand a polynomial in s and in parameters or their reciprocals: + - * / ** of names and whole numbers."""
    tree = _parsed(written)
    names = sorted({"s"} | {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)})
    context = fmpq_mpoly_ctx.get(names, Ordering.lex)
    whole = _expanded(tree, context)
    ((below, unit),) = whole.denominator.to_dict().items()
    terms = []
    for above, c in whole.numerator.to_dict().items():
        powers = {name: int(a - b) for name, a, b in zip(names, above, below, strict=True) if a != b}
        terms.append((sorted(powers.items()), Term(c / unit, powers.pop("s", 0), powers)))
    return tuple(term for _, term in sorted(terms, key=itemgetter(0)))


def written(polynomial: fmpq_mpoly) -> str:
    """A polynomial as `polynomial` reads it."""
    return str(polynomial).replace("^", "**")


def in_context(written: str, context: fmpq_mpoly_ctx, called: Mapping[str, str]) -> fmpq_mpoly:
    """A polynomial, in which decimals may stand too, in a context that has s.

    Args:
        written: the text.
        context: of the polynomial.
        called: the context's variables by their names in the text.

    Raises:
        ValueError: for what is none, or another name.
    """
    found = _expanded(_parsed(written), context, called)
    if not found.denominator.is_constant():
        raise ValueError(f"{written!r}: only numbers can be divided by")
    return found.numerator / found.denominator.coeffs()[0]


def _parsed(written: str) -> ast.expr:
    try:
        return ast.parse(written.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"not an expression: {written!r}") from error


def _expanded(node: ast.expr, context: fmpq_mpoly_ctx, called: Mapping[str, str] | None = None) -> Quotient:
    """A polynomial over a single term without s; decimals may stand in it where names are called something else."""
    match node:
        case ast.Constant(value=int(value)):
            return Quotient(context.constant(value), context.constant(1))
        case ast.Constant(value=float(value)) if called is not None:
            return Quotient(context.constant(exact(value)), context.constant(1))
        case ast.Name(id=name):
            if called is not None and name not in called:
                raise ValueError(f"nothing is called {name!r} here")
            own = name if called is None else called[name]
            return Quotient(context.gen(context.variable_to_index(own)), context.constant(1))
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_expanded(inner, context, called)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if 0 <= power <= 99:
            base = _expanded(left, context, called)
            return Quotient(base.numerator**power, base.denominator**power)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as operation, right=right):
            a, b = _expanded(left, context, called), _expanded(right, context, called)
            if isinstance(operation, ast.Div) and (len(b.numerator) != 1 or b.numerator.derivative("s") != 0):
                raise ValueError("only a single term without s can be divided by")
            return _OPERATORS[type(operation)](a, b)
    raise ValueError(f"not a polynomial: {ast.unparse(node)}")


_OPERATORS: dict[type[ast.operator], Callable[[Quotient, Quotient], Quotient]] = {
    ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.Div: truediv,
}  # fmt: skip


def _structure(node: ast.expr, named: Mapping[str, Node]) -> Node:
    match node:
        case ast.Name(id=name) if name in named:
            return named[name]
        case ast.BinOp(op=ast.Add() | ast.Mult() as operation):
            kind, sides = "sum" if isinstance(operation, ast.Add) else "product", list[ast.expr]()
            while isinstance(node, ast.BinOp) and isinstance(node.op, type(operation)):  # thousands may be added up
                sides.append(node.right)
                node = node.left
            parts = [_structure(side, named) for side in (node, *reversed(sides))]
            flat = [p for part in parts for p in (part.parts if part.kind == kind else (part,))]
            return Node(kind, "", tuple(flat), tuple(sorted({pack for part in flat for pack in part.packs})))
    raise ValueError(f"not a sum or product of leaves: {ast.unparse(node)}")


def _divided(body: Node, divisors: Collection[str]) -> tuple[Node, ...]:
    """The summands of p over some leaves, each of which is a factor of one of them.

    Raises:
        ValueError: for a leaf that is not, or is bound.
    """
    summands = body.parts if body.kind == "sum" else (body,)
    standing = body.fold(lambda one: Counter([one.name]), add, add)
    for name in divisors:
        factor, inverse = Node("leaf", name, ()), Node("inverse", name, ())
        having = [one for one in summands if one.kind == "product" and factor in one.parts and len(one.parts) > 1]
        if standing[name] != 1 or not having:
            raise ValueError(f"p cannot be divided by {name}, which is not a factor of one of its summands alone")
        summands = tuple(
            one._replace(parts=tuple(part for part in one.parts if part != factor))
            if one.kind == "product" and factor in one.parts
            else Node("product", "", (*(one.parts if one.kind == "product" else (one,)), inverse), one.packs)
            for one in summands
        )
    return summands


@dataclass(frozen=True)
class PolynomialFamily:
    """A characteristic polynomial over parameters; the texts are as a certificate states them.

    Attributes:
        name: what it is of.
        p: the polynomial over leaves, or at once in s and the parameters where there are no leaves.
        values: each parameter's value where no box says otherwise.
        leaves: polynomials in s and in parameters or their reciprocals, by name.
        bound: leaves that stand in several places, in packs that are enumerated together.
        delays: names that stand for exp(-s T), with the parameter T of each.
        groups: (name, "sum" or "product", members) of parameters that enter by one variable only.
        positive: parameters that cannot be negative.
        circles: unknowns that are anywhere on a circle.
        since: frequency from which on it is looked at, rad/s.
        until: up to which, rad/s; None for all.
        pace: how many times as quick as the published rig what moves so is: where searches look; it proves nothing.
        divisors: leaves that p is divided by on every piece, see `Statement`.
    """

    name: str
    p: str
    values: Mapping[str, fmpq]
    leaves: Mapping[str, str] = field(default_factory=dict)
    bound: tuple[tuple[str, ...], ...] = ()
    delays: Mapping[str, str] = field(default_factory=dict)
    groups: tuple[tuple[str, str, tuple[str, ...]], ...] = ()
    positive: Collection[str] = ()
    circles: Mapping[str, Circle] = field(default_factory=dict)
    since: fmpq = _ZERO
    until: fmpq | None = None
    pace: float = 1.0
    divisors: tuple[str, ...] = ()

    def over(self, ranges: Mapping[str, Interval]) -> "Statement":
        """The family over a box; parameters that are not named keep their values.

        Raises:
            ValueError: for an unknown parameter, or a range that the expression does not allow.
        """
        if unknown := sorted(set(ranges) - set(self.values)):
            raise ValueError(f"no parameter {', '.join(unknown)}; there are {', '.join(self.values)}")
        for name, (low, high) in ranges.items():
            if low > high or (name in self.positive and low < 0):
                raise ValueError(f"{name}: not a range: {text(low)} to {text(high)}")
        return Statement(self, {name: ranges.get(name, (value, value)) for name, value in self.values.items()})

    def table(self, tree: Sequence[str] | None) -> Tables:
        """As a certificate states it: p, its leaves and groups, and the marks of its pieces, where there are any."""
        groups = [{"name": name, "kind": kind, "members": [*members]} for name, kind, members in self.groups]
        more = {"leaf": self.leaves, "delay": self.delays, "group": groups}
        body: Tables = {"p": self.p} | ({"bound": [[*pack] for pack in self.bound]} if self.bound else {})
        if tree is not None:
            body |= {"divisors": [*self.divisors]} if self.divisors else {}
            body |= {"tree": wrapped(tree)}
        return body | {key: value for key, value in more.items() if value}


def wrapped(tree: Sequence[str]) -> list[str]:
    """Marks as lines."""
    return wrap(" ".join(tree), 110, break_long_words=False, break_on_hyphens=False)


class Statement:
    """What a certificate is about: p, and the ranges of its variables.

    Attributes:
        leaves: expanded polynomials by name; "s" is one of them.
        bound: names of leaves that are enumerated over their control points, those in one pack on a common grid.
        body: p over leaves and delays.
        divisors: leaves, each a factor of one summand of p and nowhere else, that p is divided by where it is to be
            clear of zero: what turns that whole summand turns the others alone then.
        summands: of p over its divisors, as a sum of one part at least.
        parameters: range of each parameter.
        ranges: range of each variable; a group of parameters is one variable.
        inner: ranges as they enter, reciprocals where the powers are negative.
        delay: the variable that is the delay in s; None where there is none.
        circles: unknowns that are anywhere on a circle, by name; each is a variable as a share of a turn.
        since: frequency from which on p is looked at, rad/s.
        until: up to which, rad/s; None for all.
        pace: of the family.
        varying: names of variables that are not fixed.
        degree: highest power of s without delay and unknowns, and with them (-1 for none).
    """

    def __init__(self, family: PolynomialFamily, parameters: Mapping[str, Interval]):
        p, leaves = (family.p, family.leaves) if family.leaves else ("p", {"p": family.p})
        delays = family.delays
        self.leaves = {"s": polynomial("s")} | {name: polynomial(leaf) for name, leaf in leaves.items()}
        self.bound, self.groups = [tuple(pack) for pack in family.bound], list(family.groups)
        places = {name: (k,) for k, pack in enumerate(self.bound) for name in pack}
        self.circles, self.since, self.until, self.pace = family.circles, family.since, family.until, family.pace
        named = {name: Node("delay", delay, ()) for name, delay in delays.items()}
        named |= {name: Node("leaf", name, (), places.get(name, ())) for name in self.leaves}
        named |= {name: Node("circle", name, ()) for name in self.circles}
        self.body = _structure(_parsed(p), named)
        self.divisors = family.divisors
        self.summands = _divided(self.body, self.divisors)
        if len(delays) > 1:
            raise ValueError("there may be one delay")
        self.delay = next(iter(delays.values()), None)
        self.parameters = dict(parameters)
        self.ranges = self.merged(self.parameters) | dict.fromkeys(self.circles, (fmpq(0), fmpq(1)))
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
        self.degree = self._degree()
        if self.degree[1] >= self.degree[0] + bool(
            self.circles and (self.delay is None or self.ranges[self.delay] == _NONE)
        ):
            raise ValueError("the highest power of s is delayed: loops of neutral type are not covered")
        self._check_affine()

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

    def leaf_at(self, name: str, point: Point) -> fmpq_poly:
        """A leaf at one value of every variable."""
        terms = ((term.degree, term.times(lambda one, power: point[one] ** power)) for term in self.leaves[name])
        return sum((fmpq_poly([0] * degree + [c]) for degree, c in terms), fmpq_poly([0]))

    def value(self, leaf: Callable[[str], T], late: T, unknown: T) -> T:
        """P from what each leaf is, exp(-s T) and the unknown."""
        of_kind = {"delay": late, "circle": unknown}
        return self.body.fold(lambda one: leaf(one.name) if one.kind == "leaf" else of_kind[one.kind], add, mul)

    def _check_affine(self) -> None:
        """Neither a pack of bound leaves nor the delay nor an unknown may have a degree above one."""

        def own(node: Node) -> Counter[tuple[str, ...]]:
            alone = [(node.name,)] if node.kind != "leaf" else []
            return Counter([*alone, *(pack for pack in self.bound if node.kind == "leaf" and node.name in pack)])

        if any(degree > 1 for degree in self.body.fold(own, or_, add).values()):
            raise ValueError("p is not affine in what is bound, or delays multiply each other")

    def _degree(self) -> tuple[int, int]:
        """With every coefficient one, so that none cancels another."""

        def leaf(name: str) -> fmpq_poly:
            return sum((fmpq_poly([0] * term.degree + [1]) for term in self.leaves[name]), fmpq_poly([]))

        plain, whole = (self.value(leaf, *(fmpq_poly([late]),) * 2) for late in (0, 1))
        return plain.degree(), (whole - plain).degree()


_NONE = (_ZERO, _ZERO)
