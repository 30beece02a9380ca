"""The closed loop of the twin-beam rig as an expression in all its figures, and any such expression over a box.

A `PolynomialFamily` is a characteristic polynomial as sums and products of leaves; over a box of its parameters it is a
`Statement`, as a certificate states it: expression, ranges, degrees.
"""

import ast
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from math import pi
from operator import add, itemgetter, mul, or_, sub, truediv
from typing import Any, NamedTuple, TypeVar

from flint import Ordering, fmpq, fmpq_mpoly_ctx, fmpq_poly

from beamdesign.plant.members import LinearFamily, family
from beamdesign.polynomial import Quotient, exact, in_variable
from beamdesign.proofs.read_once import read_once
from beamdesign.prototype import Prototype
from beamdesign.rational import text
from beamdesign.structure.lumped import figures

# A polynomial over a box.


T = TypeVar("T")
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

    def fold(self, one: Callable[["Node"], T], add: Callable[[T, T], T], multiply: Callable[[T, T], T]) -> T:
        """What it comes to where `one` says what each leaf and delay is."""
        if not self.parts:
            return one(self)
        return reduce(add if self.kind == "sum" else multiply, (part.fold(one, add, multiply) for part in self.parts))


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


def _parsed(written: str) -> ast.expr:
    try:
        return ast.parse(written.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"not an expression: {written!r}") from error


def _expanded(node: ast.expr, context: fmpq_mpoly_ctx) -> Quotient:
    """A polynomial over a single term without s."""
    match node:
        case ast.Constant(value=int(value)):
            return Quotient(context.constant(value), context.constant(1))
        case ast.Name(id=name):
            return Quotient(context.gen(context.variable_to_index(name)), context.constant(1))
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_expanded(inner, context)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if 0 <= power <= 99:
            base = _expanded(left, context)
            return Quotient(base.numerator**power, base.denominator**power)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as operation, right=right):
            a, b = _expanded(left, context), _expanded(right, context)
            if isinstance(operation, ast.Div) and (len(b.numerator) != 1 or b.numerator.derivative("s") != 0):
                raise ValueError("only a single term without s can be divided by")
            return _OPERATORS[type(operation)](a, b)
    raise ValueError(f"not a polynomial: {ast.unparse(node)}")


_OPERATORS: dict[type[ast.operator], Callable[[Quotient, Quotient], Quotient]] = {
    ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.Div: truediv,
}  # fmt: skip


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
        self.leaves = {"s": polynomial("s")} | {name: polynomial(leaf) for name, leaf in leaves.items()}
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
        self.degree = self._degree()
        if self.degree[1] >= self.degree[0]:
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

    @property
    def summands(self) -> tuple[Node, ...]:
        """P as a sum, of one part at least."""
        return self.body.parts if self.body.kind == "sum" else (self.body,)

    def split(self, leaf: Callable[[str], T], none: T, unit: T) -> tuple[T, T]:
        """P without the delay, and what the delay multiplies, from what each leaf is."""

        def add(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
            return a[0] + b[0], a[1] + b[1]

        def multiply(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
            return a[0] * b[0], a[0] * b[1] + a[1] * b[0]

        return self.body.fold(
            lambda one: (none, unit) if one.kind == "delay" else (leaf(one.name), none), add, multiply
        )

    def _check_affine(self) -> None:
        """Neither a pack of bound leaves nor the delay may have a degree above one."""

        def own(node: Node) -> Counter[int]:
            return Counter([-1] if node.kind == "delay" else [i for i, p in enumerate(self.bound) if node.name in p])

        if any(degree > 1 for degree in self.body.fold(own, or_, add).values()):
            raise ValueError("p is not affine in what is bound, or delays multiply each other")

    def _degree(self) -> tuple[int, int]:
        """With every coefficient one, so that none cancels another."""

        def leaf(name: str) -> fmpq_poly:
            return sum((fmpq_poly([0] * term.degree + [1]) for term in self.leaves[name]), fmpq_poly([]))

        plain, late = self.split(leaf, fmpq_poly([]), fmpq_poly([1]))
        return plain.degree(), late.degree()


TRANSPORT = "transport"
_FACTOR = "effect_gain"


@dataclass(frozen=True)
class PolynomialFamily:
    """A characteristic polynomial over parameters; the texts are those of `Statement`.

    Attributes:
        name: what it is of.
        p: the polynomial over leaves, or at once in s and the parameters where there are no leaves.
        values: each parameter's value where no box says otherwise.
        leaves: polynomials in s and in parameters or their reciprocals, by name.
        bound: leaves that stand in several places, in packs that are enumerated together.
        delays: names that stand for exp(-s T), with the parameter T of each.
        groups: (name, "sum" or "product", members) of parameters that enter by one variable only.
        positive: parameters that cannot be negative.
    """

    name: str
    p: str
    values: Mapping[str, fmpq]
    leaves: Mapping[str, str] | None = None
    bound: tuple[tuple[str, ...], ...] = ()
    delays: Mapping[str, str] | None = None
    groups: tuple[tuple[str, str, tuple[str, ...]], ...] = ()
    positive: Collection[str] = ()

    def over(self, ranges: Mapping[str, Interval]) -> Statement:
        """The family over a box; parameters that are not named keep their values.

        Raises:
            ValueError: for an unknown parameter, or a range that the expression does not allow.
        """
        if unknown := sorted(set(ranges) - set(self.values)):
            raise ValueError(f"no parameter {', '.join(unknown)}; there are {', '.join(self.values)}")
        for name, (low, high) in ranges.items():
            if low > high or (name in self.positive and low < 0):
                raise ValueError(f"{name}: not a range: {text(low)} to {text(high)}")
        full = {name: ranges.get(name, (value, value)) for name, value in self.values.items()}
        return Statement(self.p, full, self.leaves, self.bound, self.delays, self.groups)


def effect_spans(found: LinearFamily) -> dict[str, Interval]:
    """Spans of those parameters that are frozen figures of effects, and of the factor that they put on the gain."""
    frozen = {name: found.spans[key] for name, key in _frozen(found).items()}
    gain = found.members[0].gain
    spans = {name: (exact(span.low), exact(span.high)) for name, span in frozen.items()}
    return spans if (gain.low, gain.high) == (1.0, 1.0) else spans | {_FACTOR: (exact(gain.low), exact(gain.high))}


def _frozen(found: LinearFamily) -> dict[str, str]:
    return {key.replace(".", "_"): key for key, span in found.spans.items() if span.low < span.high}


def rig_values(prototype: Prototype) -> dict[str, fmpq]:
    """The parameters of a prototype's characteristic polynomial, SI, frequencies in rad/s.

    These are its figures, unless they are zero, both end masses, gain and a lag's breaks, a pure delay, the frozen
    figures of its effects, and the factor that they put on the gain.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    controller = prototype.controller
    if controller is None:
        raise ValueError("the prototype has no [controller]")
    found = family(prototype)
    values = {name: exact(value) for name, value in figures(prototype).items() if value != 0}
    values |= {"outer_end_mass": fmpq(0), "inner_end_mass": exact(prototype.payload.inner_end_mass_kg)}
    values |= {"controller_gain": exact(controller.gain_A_per_V), "delay": fmpq(0)}
    at_rest = {name: exact(found.spans[key].rest) for name, key in _frozen(found).items()}
    at_rest |= {_FACTOR: exact(found.rest.gain.high)}
    values |= {name: min(max(at_rest[name], low), high) for name, (low, high) in effect_spans(found).items()}
    if (lag := controller.lag) and not controller.lacks("lag"):
        values |= {"controller_zero": exact(2 * pi * lag.zero_Hz), "controller_pole": exact(2 * pi * lag.pole_Hz)}
    return values


def rig_family(
    prototype: Prototype, stages: Sequence[Mapping[str, fmpq]] = (), varied: Sequence[str] = ()
) -> PolynomialFamily:
    """The characteristic polynomial of a prototype's loop over all parameters in `rig_values`.

    Its plant is that of every other proof, the assembly's linear plant as the controller's sensors see it, with its
    parameters as variables; what the expression takes from its shape is found by `read_once`. The delay is between
    controller and valve. Effects that let the gain vary put one factor more on it.

    Args:
        prototype: with its controller.
        stages: that its law of one sensor is the product of, each (1 + n1 s + n2 s^2) / (1 + d1 s + d2 s^2) by those of
            these names that it has, s and s^2; stage_1_n1 and the like become parameters in the place of what the law
            has beside its gain.
        varied: figures of its effects that become parameters, such as sensor_lag.break_Hz, as sensor_lag_break_Hz.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    values, found, controller = rig_values(prototype), family(prototype), prototype.controller
    assert controller is not None  # it has values
    further = {key: key.replace(".", "_") for key in varied}
    values |= {
        name: exact(found.rest.rig.effects[(at := key.partition("."))[0]][at[2]]) for key, name in further.items()
    }
    if stages:
        values = {name: value for name, value in values.items() if name not in ("controller_zero", "controller_pole")}
        values |= {f"stage_{k}_{name}": value for k, one in enumerate(stages, 1) for name, value in one.items()}
    context = fmpq_mpoly_ctx.get(["s", TRANSPORT, *values], "lex")
    variable = dict(zip(context.names(), context.gens(), strict=True))
    s, zero = variable["s"], context.constant(0)
    model, law = found.rest.rig, controller.sensed_law()
    named = {name: name for name in model.figures if name in values}
    named |= {key: name for name, key in _frozen(found).items()} | further
    loop_denominator, seen = model.over_parameters(law.sensors, context, named)
    if stages:
        sides = {"n": context.constant(1), "d": context.constant(1)}
        for k, one in enumerate(stages, 1):
            for side in sides:
                terms = (variable[f"stage_{k}_{name}"] * s ** int(name[1]) for name in one if name[0] == side)
                sides[side] *= 1 + sum(terms, zero)
        numerators, denominator = [sides["n"]], sides["d"]
    elif "controller_pole" in values:
        start, end = variable["controller_zero"], variable["controller_pole"]
        numerators, denominator = [end * (start + s)], start * (end + s)
    else:
        numerators = [in_variable(one / values["controller_gain"], s) for one in law.numerators]
        denominator = in_variable(law.denominator, s)
    gain = variable["controller_gain"] * variable.get(_FACTOR, 1) * variable[TRANSPORT]
    loop_numerator = sum((one * by for one, by in zip(numerators, seen, strict=True)), zero)
    form = read_once(
        loop_denominator * denominator + gain * loop_numerator, [name for name in values if name != "delay"], TRANSPORT
    )
    positive = [name for name in values if name not in _frozen(found)]
    return PolynomialFamily(
        prototype.name, form.p, values, form.leaves, form.bound, {TRANSPORT: "delay"}, form.groups, positive
    )
