"""A polynomial in s and parameters as sums and products of leaves that share no parameter, as far as it goes.

The hull of a value set is cheap where each parameter stands in one place. What is done here is algebra of the given
polynomial alone, whatever it is of:

- parameters that enter by their sum alone, or by their product alone, become one variable;
- a leaf L takes all variables X with p = L(s, X) U + V, U and V free of X, such as a beam's stiffness and its damping;
- p, affine in each leaf then, is split into factors, into summands that share no leaf, and into f g + c with c free of
  leaves, which is p - p_x p_y / p_xy for any x of f and y of g;
- where that ends, leaves are bound: enumerated, and constants to the rest. As few as will do are sought.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain, combinations
from typing import Any

from flint import fmpq, fmpq_mpoly, fmpz

from beamdesign.polynomial import text

S = "s"
_MOST_BOUND = 5

Node = Any
"""A polynomial, or ("+" or "*", nodes)."""
Terms = dict[tuple[int, ...], fmpq]
"""Coefficients of a polynomial by the powers of all variables."""


@dataclass(frozen=True)
class Expression:
    """A polynomial in the terms of `statement.PolynomialFamily`.

    Attributes:
        p: sums and products of leaves.
        leaves: polynomials in s and in variables or their reciprocals, by name.
        bound: leaves that stand in several places, in packs.
        groups: (name, "sum" or "product", members) of parameters that enter by one variable only.
    """

    p: str
    leaves: Mapping[str, str]
    bound: tuple[tuple[str, ...], ...]
    groups: tuple[tuple[str, str, tuple[str, ...]], ...]


def read_once(p: fmpq_mpoly, parameters: Sequence[str], apart: Sequence[str]) -> Expression:
    """Write a polynomial with every parameter in as few places as are found.

    Its roots in s are what counts: it may come out times a number and a monomial in the parameters.

    Args:
        p: in "s", the first variable of its context, the parameters and what is kept apart.
        parameters: names; those that are found to enter by their reciprocals must not be zero.
        apart: names that no leaf takes and in which p is affine, such as that of exp(-s T).

    Raises:
        NotCovered: with more than one kept apart, where they multiply each other in several places.
    """
    asked = (p.context().names(), tuple(parameters), tuple(apart))
    known = next((form for key, of, form in _found if key == asked and of == p), None)
    if known is None:  # a specification asks for the same form some forty times
        known = _read_once(p, parameters, apart)
        _found.append((asked, p, known))
    return known


_found: deque[tuple[tuple[object, ...], fmpq_mpoly, Expression]] = deque(maxlen=64)


def _read_once(p: fmpq_mpoly, parameters: Sequence[str], apart: Sequence[str]) -> Expression:
    form = _Form(p, parameters, [name for name in apart if p.derivative(name) != 0])
    packs = [name for name in form.names if form.degree(form.p, name) > 1]
    for chosen in form.to_bind(packs):
        with suppress(Tangled):
            return form.expression(form.split(form.p, form.free([*chosen, *packs])), [*chosen, *packs])
    raise NotCovered("the delay and the unknown of a claim go together in a way for which no form is known")


class Tangled(ArithmeticError):
    """With what is bound, the rest is not read once."""


class NotCovered(ValueError):
    """What is kept apart multiplies each other in a way for which no form is known."""


def _numbers(names: Sequence[str]) -> dict[str | int, int | fmpz | fmpq]:
    return {name: 1009 + 2 * k for k, name in enumerate(names)}


def _together(names: Iterable[str], by: Callable[[str], object]) -> list[list[str]]:
    """Names in groups that are alike by what is made of each, without those that stand alone."""
    alike: list[tuple[object, list[str]]] = []
    for name in names:
        key = by(name)
        found = next((those for known, those in alike if known == key), None)
        alike.append((key, [name])) if found is None else found.append(name)
    return [those for _, those in alike if len(those) > 1]


class _Form:
    """A polynomial p in variables, of which each stands for a group of parameters, for a leaf, or for itself.

    Attributes:
        p: the polynomial.
        names: variables left in it, without s and what is kept apart.
        reciprocal: those parameters that enter by their reciprocals.
        groups: kind and members of sums and products, by the variable that stands for them.
        taken: leaves, in s and the variables that they have taken, by the variable that stands for them in p.
    """

    def __init__(self, p: fmpq_mpoly, parameters: Sequence[str], apart: Sequence[str]):
        self.p, self.apart = p / p.coeffs()[-1], apart
        self.place = {name: k for k, name in enumerate(p.context().names())}
        self.names = [name for name in parameters if self.degree(p, name)]
        self.reciprocal: set[str] = set()
        self.groups: dict[str, tuple[str, tuple[str, ...]]] = {}
        self.taken: dict[str, fmpq_mpoly] = {}
        self._group("sum", lambda name: self.p.derivative(name))
        self._turn()
        columns = dict(zip(self.place, zip(*self.p.monoms(), strict=True), strict=True))
        self._group("product", lambda name: (name in self.reciprocal, columns[name]))
        self._gather()

    def degree(self, p: fmpq_mpoly, name: str) -> int:
        """Degree in one variable."""
        return int(p.degrees()[self.place[name]])

    def variable(self, name: str) -> fmpq_mpoly:
        """A variable as a polynomial."""
        return self.p.context().gen(self.place[name])

    def _group(self, kind: str, by: Callable[[str], object]) -> None:
        """Let one parameter stand for all that are alike."""
        for first, *others in _together([name for name in self.names if name not in self.groups], by):
            self.groups[first] = (kind, (first, *others))
            self.names = [name for name in self.names if name not in others]
            self.p = self.p.subs({name: int(kind == "product") for name in others})

    def _turn(self) -> None:
        """Take the reciprocal of a parameter where fewer terms then have it, and away a monomial that all have."""
        terms = self.p.to_dict()
        for name in self.names:
            k = self.place[name]
            powers = [key[k] for key in terms]
            least, most = min(powers), max(powers)
            turned = sum(e < most for e in powers) < sum(e > least for e in powers) and name not in self.groups
            self.reciprocal |= {name} if turned else set()
            start, sign = (most, -1) if turned else (-least, 1)
            terms = {(*key[:k], start + sign * key[k], *key[k + 1 :]): c for key, c in terms.items()}
        self.p = self.p.context().from_dict(terms)

    def _gather(self) -> None:
        """Let leaves take variables: those that enter alike but for powers of s, and those that only go with one."""
        for names in _together([name for name in self.names if self.degree(self.p, name) == 1], self._slope):
            slope = self._slope(names[0])
            leaf = sum((self.variable(name) * divmod(self.p.derivative(name), slope)[0] for name in names), 0 * slope)
            self._take(names, leaf, slope, self.p.subs(dict.fromkeys(names, 0)))
        for name in [name for name in self.names if self.degree(self.p, name) > 1]:
            monomials = self.p.monoms()
            for other in self.names:
                a, b = self.place[name], self.place[other]
                if other not in (name, *self.taken) and all(powers[a] for powers in monomials if powers[b]):
                    self._take_both(name, other)

    def _slope(self, name: str) -> fmpq_mpoly:
        """By what a variable is multiplied, but for a power of s and a number."""
        slope = self.p.derivative(name)
        slope, _ = divmod(slope, self.variable(S) ** min(powers[0] for powers in slope.monoms()))
        return slope / slope.leading_coefficient()

    def _take(self, names: Sequence[str], leaf: fmpq_mpoly, slope: fmpq_mpoly, rest: fmpq_mpoly) -> None:
        """Let a leaf take these in p = leaf slope + rest, which the first of them then stands for."""
        unit = leaf.leading_coefficient()
        self.taken[names[0]] = leaf / unit
        self.names = [name for name in self.names if name not in names[1:]]
        self.p = self.variable(names[0]) * slope * unit + rest

    def _take_both(self, one: str, other: str) -> None:
        """Let a leaf take two where it need not be affine in them."""
        parts, leaf = self._by_powers(self.p, (one, other)), 0 * self.p
        rest, slope = parts.pop((0, 0), leaf), leaf
        for part in parts.values():
            slope = part.gcd(slope)
        for (a, b), part in parts.items():
            factor, _ = divmod(part, slope)
            if any(any(key[1:]) for key in factor.monoms()):
                return
            leaf += factor * self.variable(one) ** a * self.variable(other) ** b
        self._take((one, other), leaf, slope, rest)

    def _by_powers(self, p: fmpq_mpoly, names: Sequence[str]) -> dict[tuple[int, ...], fmpq_mpoly]:
        """Coefficients of the powers of some variables."""
        return {powers: p.context().from_dict(part) for powers, part in self._grouped(p.to_dict(), names).items()}

    def _grouped(self, terms: Terms, names: Sequence[str]) -> dict[tuple[int, ...], Terms]:
        """The same of the terms of a polynomial."""
        places, found = [self.place[name] for name in names], dict[tuple[int, ...], Terms]()
        for key, c in terms.items():
            rest = list(key)
            for k in places:
                rest[k] = 0
            found.setdefault(tuple(key[k] for k in places), {})[tuple(rest)] = c
        return found

    def free(self, bound: Collection[str]) -> list[str]:
        """What is not bound."""
        return [*(name for name in self.names if name not in bound), *self.apart]

    def to_bind(self, packs: Sequence[str]) -> Iterator[Collection[str]]:
        """Variables to bind beside the packs, those with the fewest control points first, and at last all of them.

        Found at numbers for s and what is bound, which is quick; whether it holds of all numbers is to be seen. A
        variable that stands for others is bound by itself, or with all of them.
        """
        p, core = self._core(self.p.subs(_numbers([S, *packs])), self.free(packs))
        single = [name for name in core if name not in self.apart]
        subsets = [*chain.from_iterable(combinations(single, n) for n in range(min(len(core), _MOST_BOUND) + 1))]
        together = [tuple(n for name in some for n in core[name] if n not in self.apart) for some in subsets]
        ways = dict.fromkeys([*zip(subsets, subsets, strict=True), *zip(together, subsets, strict=True)])
        for bound, chosen in sorted(ways, key=lambda way: self.points(way[0])):
            rest = [name for name in core if name not in chosen]
            if len(self._core(p.subs(_numbers(chosen)), rest)[1]) <= 1:
                yield bound
        yield [name for name in self.names if name not in packs]

    def _core(self, p: fmpq_mpoly, names: Sequence[str]) -> tuple[fmpq_mpoly, dict[str, list[str]]]:
        """P with one variable for any two that enter by h(x, y) = a x + b y + c x y alone, as long as there are such.

        One that stands for others keeps its name, and comes with all of theirs. One variable is left of what is read
        once.
        """
        left = {name: [name] for name in names if self.degree(p, name)}
        while pair := next(filter(partial(self._alike, p.to_dict()), combinations(left, 2)), None):
            parts = self._by_powers(p, pair)
            slope = next(part for powers, part in parts.items() if any(powers))
            p = self.variable(pair[0]) * slope + parts.get((0, 0), 0 * p)
            left[pair[0]] += left.pop(pair[1])
        return p, left

    def _alike(self, terms: Terms, pair: tuple[str, str]) -> bool:
        """Whether the coefficients of all powers of two variables are multiples of each other."""
        parts = [part for powers, part in self._grouped(terms, pair).items() if any(powers)]
        if not parts or any(part.keys() != parts[0].keys() for part in parts):
            return False
        some, unit = next(iter(parts[0].items()))
        return all(c * part[some] == part[key] * unit for part in parts[1:] for key, c in parts[0].items())

    def points(self, chosen: Collection[str]) -> int:
        """How many control points these leaves have together: corners, or a grid where a leaf is not affine."""
        total = 1
        for name in chosen:
            keys = self.taken.get(name, self.variable(name)).monoms()
            if all(sum(key[1:]) == 1 for key in keys):
                total *= 2 ** len({key[0] % 2 for key in keys})
            else:
                for powers in zip(*(key[1:] for key in keys), strict=True):
                    total *= 1 + max(powers)
        return total

    def split(self, p: fmpq_mpoly, free: Collection[str]) -> Node:
        """Write p with each free variable in one place.

        Raises:
            Tangled: where that is not found.
        """
        inside = [name for name in free if self.degree(p, name)]
        bound = self._bound(p, free)
        if not inside:
            return self._constant(p, sorted(bound))
        if (len(inside) == 1 and inside[0] not in self.apart and not bound) or p == self.variable(inside[0]):
            return p
        parts, common = self._factors(p, inside)
        factors = parts if common.is_one() else [*parts, common]
        if len(factors) > 1:
            if len(bound) < sum(len(self._bound(factor, free)) for factor in factors):
                raise Tangled
            return "*", [self.split(factor, free) for factor in factors]
        summands, rest = self._summands(p, inside)
        for k, part in enumerate(summands):
            own = [name for name in inside if self.degree(part, name)]
            if len(own) > 1 and len(self._factors(part, own)[0]) == 1:
                summands[k] = self._product(part, own)
                rest += part - summands[k]
        return "+", [self.split(part, free) for part in [*summands, rest] if not part.is_zero()]

    def _bound(self, p: fmpq_mpoly, free: Collection[str]) -> list[str]:
        return [name for name in self.names if name not in free and self.degree(p, name)]

    def _factors(self, p: fmpq_mpoly, inside: Collection[str]) -> tuple[list[fmpq_mpoly], fmpq_mpoly]:
        """Those that have variables inside, and the product of the others; a number goes with one of them."""
        # Lowest coefficients of 1 keep the numbers of a large exact polynomial within those of floats.
        unit, found = p.coeffs()[-1], [(factor / factor.coeffs()[-1], power) for factor, power in p.factor()[1]]
        common, parts = 0 * p + 1, []
        for factor, power in found:
            if any(self.degree(factor, name) for name in inside):
                parts.append(factor)
            else:
                common *= factor**power
        if common.is_one() and parts[0] not in [self.variable(name) for name in self.apart]:
            return [parts[0] * unit, *parts[1:]], common
        return parts, common * unit

    def _summands(self, p: fmpq_mpoly, inside: Sequence[str]) -> tuple[list[fmpq_mpoly], fmpq_mpoly]:
        """Those that share no variable inside, and what has none."""
        joined: list[tuple[set[str], dict[tuple[int, ...], fmpq]]] = [(set(), {})]
        for key, c in p.to_dict().items():
            names, terms = {name for name in inside if key[self.place[name]]}, {key: c}
            met = [one for one in joined if one[0] & names or one[0] == names]
            joined = [one for one in joined if one not in met]
            for own, more in met:
                names, terms = names | own, terms | more
            joined.append((names, terms))
        made = p.context().from_dict
        (rest,) = (made(terms) for names, terms in joined if not names)
        return [made(terms) for names, terms in joined if names], rest

    def _product(self, p: fmpq_mpoly, inside: Sequence[str]) -> fmpq_mpoly:
        """F g of p = f g + c."""
        for x, y in combinations(inside, 2):
            slope = p.derivative(x)
            both = slope.derivative(y)
            if not both.is_zero():
                found, over = divmod(slope * p.derivative(y), both)
                alone = p - found
                constant = not any(self.degree(alone, name) for name in inside)
                if over.is_zero() and constant and len(self._factors(found, inside)[0]) > 1:
                    return found
        raise Tangled

    def _constant(self, p: fmpq_mpoly, bound: Sequence[str]) -> Node:
        """What has no free variable: a sum over the powers of those that are bound."""
        summands: list[Node] = []
        for powers, part in self._by_powers(p, bound).items():
            factors = [self.variable(name) ** power for name, power in zip(bound, powers, strict=True) if power]
            summands.append(("*", factors if factors and part.is_one() else [*factors, part]))
        return "+", summands

    def expression(self, body: Node, bound: Sequence[str]) -> Expression:
        """What was split, with its leaves named."""
        known: dict[str, str] = {name: name for name in (S, *self.apart)}

        def named(p: fmpq_mpoly) -> str:
            return known.setdefault(self._text(p), f"leaf_{len(known) - len(self.apart)}")

        def written(node: Node) -> str:
            if isinstance(node, fmpq_mpoly):
                return named(node)
            sign, parts = node
            texts = [written(part) for part in parts]
            return f"({' + '.join(texts)})" if sign == "+" and len(texts) > 1 else "*".join(texts)

        p = written(body)
        packs = [range(1, self.degree(self.p, name) + 1) for name in bound]
        texts = [[self._text(self.variable(name) ** e) for e in pack] for name, pack in zip(bound, packs, strict=True)]
        return Expression(
            p,
            {name: leaf for leaf, name in known.items() if leaf != name},
            tuple(tuple(known[leaf] for leaf in pack if leaf in known) for pack in texts),
            tuple((self._shown(name), kind, members) for name, (kind, members) in self.groups.items()),
        )

    def _text(self, p: fmpq_mpoly) -> str:
        """Written in s and parameters, with what leaves have taken."""
        for name, leaf in self.taken.items():
            if self.degree(p, name):
                parts = self._by_powers(p, [name])
                p = sum((part * leaf**power for (power,), part in parts.items()), 0 * p)
        return " + ".join(self._term(key, c) for key, c in p.terms())

    def _term(self, key: Sequence[int], c: fmpq) -> str:
        above, below = ([] if c == 1 else [text(c) if c > 0 and c.q == 1 else f"({c.p}/{c.q})"]), ""
        for name, power in zip(self.place, key, strict=True):
            shown = self._shown(name) + (f"**{power}" if power > 1 else "")
            if power and name in self.reciprocal:
                below += f"/{shown}"
            elif power:
                above.append(shown)
        return ("*".join(above) or "1") + below

    def _shown(self, name: str) -> str:
        """The name of the group that a parameter stands for, or its own."""
        kind, members = self.groups.get(name, ("", (name,)))
        return {"sum": "_plus_", "product": "_times_", "": ""}[kind].join(members)
