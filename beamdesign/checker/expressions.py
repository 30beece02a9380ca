"""Expressions that a certificate states: a polynomial p(s, q) as sums and products of leaves, and ranges for its q.

A leaf is a polynomial in s and in variables or their reciprocals, written with + - * / ** of names and whole numbers. A
variable is a parameter, or a group of parameters that enter by their sum or their product alone.
"""

import ast
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial, reduce
from math import comb, prod
from operator import add, or_, sub
from typing import Any, NamedTuple

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly

from beamdesign.checker.reading import HIGHEST_DEGREE, LONGEST_LIST, Table, Unreadable
from beamdesign.checker.roots import NONE, ZERO, Pair, S
from beamdesign.checker.work import spend, times

LONGEST_EXPRESSION = 100_000
"""Characters."""
MOST_TERMS, MOST_PRODUCTS = 2_000, 100_000
"""Terms of a leaf, power of a name, and terms of p over its parameters, all before anything is multiplied out."""
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {ast.Add: add, ast.Sub: sub}
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,500}", re.ASCII)


UNKNOWN = "unknown"
"""In the p of a claim, what may be any number of a circle; as a variable, the share of a turn at which it is."""


class Circle(NamedTuple):
    """In the complex plane, its centre on the real axis and not negative."""

    centre: fmpq
    radius: fmpq


class Term(NamedTuple):
    """coefficient * s^degree * product of variable^power, or of its reciprocal's power."""

    coefficient: fmpq
    degree: int
    powers: dict[str, int]


class Node(NamedTuple):
    """Part of p: a "leaf" or the "inverse" of one by its name, the "delay", the "unknown", a "sum" or a "product".

    `packs` are the places of the packs of enumerated leaves on which it depends, ascending.
    """

    kind: str
    name: str
    parts: tuple["Node", ...]
    packs: tuple[int, ...]

    def folded(self, leaf: Callable[["Node"], Any], of_sum: Callable[..., Any], of_product: Callable[..., Any]) -> Any:
        """What comes of it, from what each part without parts comes to and how sums and products go together."""
        if not self.parts:
            return leaf(self)
        return (of_sum if self.kind == "sum" else of_product)([p.folded(leaf, of_sum, of_product) for p in self.parts])


class Expression:
    """What a certificate states of p: its text, its leaves and groups, and the ranges.

    Attributes:
        ranges: of each parameter.
        variables: range of each variable.
        reciprocal: variables that enter by their reciprocals.
        enters: ranges of what enters, reciprocals where that is what does.
        varying: variables that are not fixed.
        leaves: by name.
        packs: names of leaves that are enumerated over their control points, those in one pack on a common grid.
        body: p over the leaves.
        quotient: p over its divisors, leaves that are factors of one summand of it and stand nowhere else.
        delay: the variable that is the delay in s, None where there is none.
        groups: kind and members of a variable that stands for several parameters.
        circle: of the unknown, None where p has none.
    """

    def __init__(self, table: Table, whole: Table | None = None, circle: Circle | None = None) -> None:
        stated, self.circle = (whole or table).table("range"), circle
        self.ranges = {_name(name, stated): stated.range(name) for name in stated.keys}
        self.own = Table({}, "range") if whole is None else table.optional("range")
        if unknown := sorted(self.own.keys - self.ranges.keys()):
            raise Unreadable(f"a claim has ranges of its own that the box does not have: {', '.join(unknown)[:200]}")
        self.ranges |= {name: self.own.range(name) for name in self.own.keys}
        self.groups: dict[str, tuple[str, list[str]]] = {}
        for group in table.tables("group"):
            if (name := _name(group.word("name"), group)) in self.groups:
                raise Unreadable(f"there are two groups {name}")
            self.groups[name] = group.word("kind", "sum", "product"), group.words("members")
        self.variables = self.merged(self.ranges) | ({UNKNOWN: (fmpq(0), fmpq(1))} if circle else {})
        texts, body = table.optional("leaf"), table.word("p", longest=LONGEST_EXPRESSION)
        leaves = {_name(one, texts): texts.word(one, longest=LONGEST_EXPRESSION) for one in texts.keys} or {"p": body}
        delays = table.optional("delay")
        late = {_name(name, delays): delays.word(name) for name in delays.keys}
        self.delay = next(iter(late.values()), None)
        if len(late) > 1 or (self.delay is not None and not self.variables.get(self.delay, (-1,))[0] >= 0):
            raise Unreadable("there may be one delay, which is not negative")
        own = {UNKNOWN} if circle else set()
        if clash := sorted(
            {*late} & {*leaves}
            | {"s"} & {*late, *leaves, *self.variables, *self.ranges}
            | {*late} & {*self.variables, *self.ranges, *self.groups}
            | own & {*late, *leaves, *self.ranges, *self.groups}
        ):
            raise Unreadable(f"these names stand for more than one thing: {', '.join(clash)[:200]}")
        bound = table.entries("bound") if "bound" in table else []
        self.packs = [Table({"pack": pack}, "bound").words("pack") for pack in bound]
        enumerated = [name for pack in self.packs for name in pack]
        if not all(self.packs) or len(set(enumerated)) < len(enumerated) or not {*enumerated} <= leaves.keys():
            raise Unreadable("bound must hold lists of leaves, each leaf once")
        trees = {name: _parsed(text, f"leaf.{name}") for name, text in leaves.items()}
        self.reciprocal = {name for tree in trees.values() for name in _below(tree)}
        self.transport = next(iter(late), "")
        self._names = ["s", *late, *self.variables]
        self.context = fmpq_mpoly_ctx.get(self._names, "lex")
        variable = dict(zip(self._names, self.context.gens(), strict=True))
        allowed = {name: value for name, value in variable.items() if name not in {*late, *own}}
        self.polynomials = {"s": variable["s"]} | {
            name: self._multiplied_out(tree, allowed) for name, tree in trees.items()
        }
        self.leaves = {name: self._terms(value) for name, value in self.polynomials.items()}
        for name in self.reciprocal:
            if not self.variables[name][0] > 0 or name == self.delay:
                raise Unreadable(f"{name} enters by its reciprocal and must be positive, and no delay")
        self.enters = {n: (1 / b, 1 / a) if n in self.reciprocal else (a, b) for n, (a, b) in self.variables.items()}
        self.varying = tuple(name for name, (low, high) in self.variables.items() if low < high)
        tree = _parsed(body, "p") if texts.keys else ast.Name("p")
        self.body = self._structure(tree)
        if any(power > 1 for power in _powers(self.body).values()):
            raise Unreadable("p must be affine in what is bound and in the delay")
        self.quotient = _divided(self.body, table.words("divisors") if "divisors" in table else [])
        degree = {name: max((term.degree for term in terms), default=0) for name, terms in self.leaves.items()}
        if self.body.folded(lambda node: degree[node.name] if node.kind == "leaf" else 0, max, sum) > HIGHEST_DEGREE:
            raise Unreadable(f"p has a higher degree in s than {HIGHEST_DEGREE}")
        self.components = {name: list(self._apart(terms)) for name, terms in self.leaves.items()}

    def merged(self, parameters: Mapping[str, Pair]) -> dict[str, Pair]:
        """Ranges of the variables from those of the parameters: exact for sums, and for products of nonnegatives."""
        ranges = dict(parameters)
        for name, (kind, members) in self.groups.items():
            left = ranges.keys() & parameters.keys()
            if name in parameters or not members or len({*members}) < len(members) or not {*members} <= left:
                raise Unreadable(f"group {name} must be of parameters that are in no other")
            ends = [ranges.pop(member) for member in members]
            if kind == "product" and any(low < 0 for low, _ in ends):
                raise Unreadable(f"group {name}: a factor may be negative")
            together: Callable[..., fmpq] = prod if kind == "product" else sum
            low, high = (together(side, start=fmpq(int(kind == "product"))) for side in zip(*ends, strict=True))
            ranges[name] = low, high
        return ranges

    def _multiplied_out(self, tree: ast.expr, variable: Mapping[str, fmpq_mpoly]) -> fmpq_mpoly:
        """A leaf, its reciprocals as variables."""
        one = self.context.constant(1)
        names = variable.keys() - self.reciprocal, variable.keys() - {"s"}

        def value(node: ast.expr, under: bool = False) -> fmpq_mpoly:
            """Of a part; or of the reciprocal of one that is divided by, which is a product."""
            match node:
                case ast.Constant(value=int(number)) if not isinstance(number, bool) and (number or not under):
                    return one / number if under else one * number
                case ast.Name(id=name) if name in names[under]:
                    return variable[name]
                case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if power >= under:
                    return value(left, under) ** power
                case ast.BinOp(left=left, op=ast.Mult(), right=right):
                    return value(left, under) * value(right, under)
                case ast.UnaryOp(op=ast.USub(), operand=inner) if not under:
                    return -value(inner)
                case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as operation, right=right) if not under:
                    return _OPERATORS[type(operation)](value(left), value(right))
                case ast.BinOp(left=left, op=ast.Div(), right=right) if not under:
                    return value(left) * value(right, under=True)
            refused = "cannot be divided by" if under else "not a polynomial in s and what has a range"
            raise Unreadable(f"{refused}: {ast.unparse(node)[:100]}")

        terms, powers = _size(tree)
        spend(20 * terms * (1 + max(powers.values(), default=0)))
        return value(tree)

    def _structure(self, node: ast.expr) -> Node:
        """What of p a tree is."""
        match node:
            case ast.Name(id=name) if name == UNKNOWN and self.circle:
                return Node("unknown", name, (), ())
            case ast.Name(id=name) if name == self.transport:
                return Node("delay", self.delay or "", (), ())
            case ast.Name(id=name) if name in self.leaves:
                return Node("leaf", name, (), tuple(k for k, pack in enumerate(self.packs) if name in pack))
            case ast.BinOp(left=left, op=ast.Add() | ast.Mult() as operation, right=right):
                kind = "sum" if isinstance(operation, ast.Add) else "product"
                parts = [self._structure(side) for side in (left, right)]
                flat = tuple(p for part in parts for p in (part.parts if part.kind == kind else (part,)))
                return Node(kind, "", flat, tuple(sorted({k for part in flat for k in part.packs})))
        raise Unreadable(f"p is not a sum or product of leaves: {ast.unparse(node)[:100]}")

    def _terms(self, polynomial: fmpq_mpoly) -> list[Term]:
        found = []
        for powers, c in polynomial.terms():
            named = dict(zip(self._names, map(int, powers), strict=True))
            found.append(Term(c, named.pop("s"), {name: power for name, power in named.items() if power}))
        return found

    def _apart(self, terms: Sequence[Term]) -> Iterator[tuple[int | None, dict[str, int], list[Term]]]:
        """Terms that share no varying variable with the rest, and the degree in each of their variables.

        Before them the axis along which they vary where s = jw, 0 for the real one; None where along none, or both.
        """
        groups: list[tuple[set[str], list[Term]]] = []
        for term in terms:
            names, own = {*term.powers} & {*self.varying}, [term]
            for other in [group for group in groups if group[0] & names]:
                groups.remove(other)
                names, own = names | other[0], other[1] + own
            groups.append((names, own))
        for names, own in groups:
            parities = {term.degree % 2 for term in own}
            yield parities.pop() if names and len(parities) == 1 else None, degrees(own, sorted(names)), own

    def over_all(self) -> fmpq_mpoly:
        """P multiplied out over what varies, where the delay's exponential and reciprocals are variables."""
        fixed: dict[str | int, Any] = {n: self.enters[n][0] for n in self.variables if n not in self.varying}
        if self.body.folded(lambda node: len(self.leaves.get(node.name, ())) or 1, sum, prod) > MOST_PRODUCTS:
            raise Unreadable(f"p has more than {MOST_PRODUCTS} terms over its parameters")
        leaves = {name: value.subs(fixed) for name, value in self.polynomials.items()}

        def at(node: Node) -> fmpq_mpoly:
            if node.kind == "leaf":
                return leaves[node.name]
            return self.context.gen(self._names.index(self.transport if node.kind == "delay" else UNKNOWN))

        return self.body.folded(at, sum, partial(reduce, times))

    @cached_property
    def degree(self) -> int:
        """The highest power of s whose coefficient, without the delay, does not vanish for all of the box."""
        whole = self.over_all()
        left = whole.subs({self.transport: fmpq(0)}) if self.transport else whole
        return max((int(powers[0]) for powers in left.monoms()), default=-1)

    def member(self, parameters: Mapping[str, fmpq]) -> tuple[fmpq_poly, fmpq_poly, fmpq]:
        """Plain part, late part that exp(-s delay) multiplies, and delay, at one value of every parameter."""
        plain, whole = (ZERO + self.value(parameters, NONE, S, late) for late in (0, 1))  # affine in the exponential
        delay = NONE if self.delay is None else self.merged({n: (v, v) for n, v in parameters.items()})[self.delay][0]
        return plain, whole - plain, delay

    def value(self, parameters: Mapping[str, fmpq], unknown: fmpq, s: Any = 0, late: int = 1) -> Any:
        """P at one value of every parameter, of the unknown, of s, a number or a ball, and of exp(-s delay)."""
        ranges = self.merged({name: (value, value) for name, value in parameters.items()})
        value = {n: 1 / a if n in self.reciprocal else a for n, (a, _) in ranges.items()}

        def at(node: Node) -> Any:
            if node.kind != "leaf":
                return unknown if node.kind == "unknown" else late
            terms = self.leaves[node.name]
            return sum((prod((value[n] ** e for n, e in own.items()), start=c) * s**k for c, k, own in terms), NONE)

        return self.body.folded(at, sum, prod)


def degrees(terms: Sequence[Term], names: Sequence[str]) -> dict[str, int]:
    """The highest power of each variable."""
    return {name: max(term.powers.get(name, 0) for term in terms) for name in names}


def _name(name: str, table: Table) -> str:
    if not _NAME.fullmatch(name) or len(table.keys) > LONGEST_LIST:
        raise Unreadable(f"{table.place}: not a name, or too many: {name[:60]!r}")
    return name


def _parsed(text: str, place: str) -> ast.expr:
    """The tree of an expression within the limits."""
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise Unreadable(f"{place} is not an expression: {str(error)[:100]}") from error
    terms, powers = _size(tree)
    if terms > MOST_TERMS or max(powers.values(), default=0) > HIGHEST_DEGREE:
        raise Unreadable(f"{place} comes to too many terms, or to too high powers")
    return tree


def _size(node: ast.AST) -> tuple[int, Counter[str]]:
    """Terms of an expression when it is multiplied out, and the degree in every name and in numbers, all at most."""
    match node:
        case ast.Name(id=name):
            return 1, Counter({name: 1})
        case ast.Constant():
            return 1, Counter({"": 1})
        case ast.UnaryOp(operand=inner):
            return _size(inner)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if power > 0:
            terms, powers = _size(left)
            # The largest power first: a binomial coefficient of thousands is itself long work.
            power = min(power, HIGHEST_DEGREE + 1)
            return comb(terms + power - 1, power), Counter({name: power * e for name, e in powers.items()})
        case ast.BinOp(left=left, op=operation, right=right):
            (one, first), (other, second) = _size(left), _size(right)
            if isinstance(operation, ast.Add | ast.Sub):
                return one + other, first | second
            return one * other, first + second
    return 1, Counter()


def _below(tree: ast.AST) -> set[str]:
    """Names in denominators."""
    quotients = (node for node in ast.walk(tree) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div))
    return {name.id for node in quotients for name in ast.walk(node.right) if isinstance(name, ast.Name)}


def _divided(body: Node, divisors: Sequence[str]) -> Node:
    """P over some leaves: they are left out of the summand that they multiply, and divide the others."""
    summands = list(body.parts if body.kind == "sum" else (body,))
    count = body.folded(lambda node: Counter([node.name]), partial(reduce, add), partial(reduce, add))
    for name in divisors:
        factor, inverse = Node("leaf", name, (), ()), Node("inverse", name, (), ())
        of = [k for k, one in enumerate(summands) if one.kind == "product" and factor in one.parts]
        if len(of) != 1 or count[name] != 1 or len(summands[of[0]].parts) < 2:
            raise Unreadable(f"p cannot be divided by {name[:60]!r}, which is no factor of one of its summands alone")
        for k, one in enumerate(summands):
            parts = one.parts if one.kind == "product" else (one,)
            left = tuple(part for part in parts if part != factor)
            summands[k] = one._replace(kind="product", name="", parts=left if k == of[0] else (*left, inverse))
    return Node("sum", "", tuple(summands), body.packs)


def _powers(node: Node) -> Counter[str]:
    """Degree in each pack of bound leaves and, under "delay" and "unknown", in these."""

    def own(part: Node) -> Counter[str]:
        return Counter(map(str, part.packs) if part.kind == "leaf" else {part.kind: 1})

    return node.folded(own, partial(reduce, or_), partial(reduce, add))
