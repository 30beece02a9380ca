"""No root on the imaginary axis for any member of a box, piece by piece: the prover's method, own code.

On a piece, frequencies from w1 to w2 and a box Q of parameters, p(jw, q) keeps to one side of a line through zero
where it does so at w1 and w2 by more than it can stray from the chord between them, max |p''| (w2 - w1)^2 / 8. At one
frequency the values lie in the convex hull of control points: every part of p that stands alone contributes its own,
what stands in several places is enumerated (mapping theorem, Zadeh and Desoer, 1963), and powers of a parameter have
Bernstein's coefficients, which are values of the polar form (Ramshaw, 1989). Lags that are factors of one summand of p
may divide it, where each keeps clear of zero: p vanishes where the quotient does. Above the last frequency the leading
coefficient outweighs all others, so that none is lost either (Fujiwara, 1916).

The tree of pieces is in prefix order: each cut is followed by its lower and its upper side, so that pieces fill the box
by construction. A variable is cut in the middle of its range, or of its reciprocal's where it enters by that.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from itertools import product, zip_longest
from math import prod
from operator import add, mul
from typing import TypeVar

from flint import acb, arb, arb_poly, ctx, fmpq, fmpq_poly

from beamdesign.checker.expressions import Expression, Node, Term, degrees
from beamdesign.checker.points import TANGENTS, apart, arc, inverses, polar
from beamdesign.checker.reading import Unreadable, rational, short
from beamdesign.checker.roots import NONE, ONE, ZERO, Pair, parts
from beamdesign.checker.work import height, spend

PRECISION_BITS = 96
MOST_POINTS, MOST_OPEN = 200_000, 1_000
"""Control points of p on one piece, and pieces that wait for their turn: some 20 at once in honest trees."""

T = TypeVar("T")
Control = tuple[arb_poly, arb_poly]
"""A control point of a leaf: even and odd part of a polynomial in s on the axis, over w^2."""
Values = Mapping[str, Pair]
"""Of each variable the range, as it enters."""


Choice = tuple[int, ...]
"""A place in each of some packs of what is enumerated."""


class Frame:
    """Control points of p at one frequency, over one cell."""

    def __init__(self, cell: "Cell", w: fmpq) -> None:
        self.cell, self.w = cell, arb(w)
        self._square = arb(w * w)
        self._known: dict[int, dict[Choice, list[acb]]] = {}
        self._sizes: dict[int, arb] = {}
        self._packs = [self._pack(pack) for pack in cell.expression.packs]

    def _value(self, control: Control) -> acb:
        even, odd = control
        return acb(even(self._square), self.w * odd(self._square))

    def leaf(self, name: str) -> list[acb]:
        """What lies along either axis makes two ends of a side; the rest adds its own points."""
        points, sides = [acb(0)], [(arb(0), arb(0)), (arb(0), arb(0))]
        for axis, controls in self.cell.controls(name):
            values = [self._value(control) for control in controls]
            if axis is None:
                points = [a + b for a in points for b in values]
            else:
                along = [value.imag if axis else value.real for value in values]
                sides[axis] = sides[axis][0] + reduce(arb.min, along), sides[axis][1] + reduce(arb.max, along)
        corners = [acb(x, y) for x in _ends(sides[0]) for y in _ends(sides[1])]
        return [point + corner for point in points for corner in corners]

    def _pack(self, pack: Sequence[str]) -> list[dict[str, acb]]:
        if len(pack) == 1:
            return [{pack[0]: point} for point in self.leaf(pack[0])]
        columns = [[self._value(control) for control in column] for column in self.cell.common(tuple(pack))]
        return [dict(zip(pack, values, strict=True)) for values in zip(*columns, strict=True)]

    def points(self, node: Node) -> dict[Choice, list[acb]]:
        """Control points of a part of p, for every choice of what is enumerated in it."""
        if id(node) not in self._known:
            self._known[id(node)] = self._points(node)
            spend(20 + sum(map(len, self._known[id(node)].values())))
        return self._known[id(node)]

    def _points(self, node: Node) -> dict[Choice, list[acb]]:
        if node.kind == "delay":
            least, most_late = self.cell.values[node.name]
            return {(): arc(self.w * least, self.w * (most_late - least))}
        if node.kind == "unknown":
            low, high = self.cell.values[node.name]
            centre, radius = map(arb, self.cell.circle)
            turn = 2 * arb.pi()
            return {(): [centre + radius * point for point in arc(turn * low, turn * (high - low))]}
        if node.kind == "inverse":
            return {(): inverses(self.leaf(node.name))}
        if node.kind == "leaf" and node.packs:
            return {(k,): [choice[node.name]] for k, choice in enumerate(self._packs[node.packs[0]])}
        if node.kind == "leaf":
            return {(): self.leaf(node.name)}
        found, packs = self.points(node.parts[0]), node.parts[0].packs
        for part in node.parts[1:]:
            both = tuple(sorted({*packs, *part.packs}))
            pairs = self._side_by_side(both, [(packs, found), (part.packs, self.points(part))])
            together = add if node.kind == "sum" else mul
            found, packs = {choice: [together(x, y) for x in a for y in b] for choice, (a, b) in pairs}, both
        return found

    def _side_by_side(
        self, packs: Choice, tables: Sequence[tuple[Choice, Mapping[Choice, T]]]
    ) -> Iterator[tuple[Choice, list[T]]]:
        """For every choice in some packs, what each table has for its part of that choice."""
        places = [([packs.index(k) for k in own], table) for own, table in tables]
        for choice in product(*(range(len(self._packs[k])) for k in packs)):
            yield choice, [table[tuple([choice[k] for k in own])] for own, table in places]

    def size(self, node: Node) -> arb:
        """Upper bound of the size of a part of p at this frequency."""
        if id(node) not in self._sizes:
            points = (point for found in self.points(node).values() for point in found)
            self._sizes[id(node)] = reduce(arb.max, map(abs, points))
        return self._sizes[id(node)]

    def least(self, x: arb, y: arb) -> arb:
        """Lower bound of the real part of p times x - jy."""
        conjugate = acb(x, -y)

        def along(point: acb) -> arb:
            return (conjugate * point).real

        tables = [
            (node.packs, {choice: reduce(arb.min, map(along, found)) for choice, found in self.points(node).items()})
            for node in self.cell.summands
        ]
        totals = (sum(found, arb(0)) for _, found in self._side_by_side(self.cell.expression.body.packs, tables))
        return reduce(arb.min, totals)


class Cell:
    """A box of the variables, as they enter."""

    def __init__(self, expression: Expression, values: Values) -> None:
        self.expression, self.values = expression, dict(values)
        self.circle = expression.circle or (fmpq(0), fmpq(0))
        self.summands = expression.quotient.parts
        self._controls: dict[str, list[tuple[int | None, list[Control]]]] = {}
        self._common: dict[tuple[str, ...], list[list[Control]]] = {}
        self._rates: dict[str, Control] = {}
        self._frames: dict[fmpq, Frame] = {}

    def half(self, name: str, upper: bool) -> "Cell":
        """The lower or the upper half in one variable."""
        low, high = self.values[name]
        middle = (low + high) / 2
        return Cell(self.expression, self.values | {name: (middle, high) if upper else (low, middle)})

    def frame(self, w: fmpq) -> Frame:
        """At one frequency; the last few are kept, since pieces share their ends."""
        if w not in self._frames:
            if len(self._frames) > 3:
                del self._frames[next(iter(self._frames))]
            self._frames[w] = Frame(self, w)
        return self._frames[w]

    def controls(self, name: str) -> list[tuple[int | None, list[Control]]]:
        """Of each part of a leaf that shares no variable with the rest, the axis along which it lies and its points."""
        if name not in self._controls:
            components = self.expression.components[name]
            self._controls[name] = [(axis, self._grid(terms, powers)) for axis, powers, terms in components]
        return self._controls[name]

    def common(self, pack: tuple[str, ...]) -> list[list[Control]]:
        """Of leaves that are enumerated together, the points of each on a grid of all their variables."""
        if pack not in self._common:
            leaves = self.expression.leaves
            powers = common_degrees(self.expression, pack)
            self._common[pack] = [self._grid(leaves[name], powers) for name in pack]
        return self._common[pack]

    def _grid(self, terms: Sequence[Term], powers: Mapping[str, int]) -> list[Control]:
        """Even and odd part, on the axis, of the polynomial in s at each control point."""
        found = []
        long = max((height(end) * powers[name] ** 2 for name in powers for end in self.values[name]), default=0)
        each = sum(5 + (5 + long / 2_000) * len(own) for _, _, own in terms)
        spend(each * prod(1 + degree for degree in powers.values()))
        for index in product(*(range(degree + 1) for degree in powers.values())):
            at = dict(zip(powers, index, strict=True))
            coefficients = [fmpq(0)] * (1 + max((term.degree for term in terms), default=0))
            for c, degree, own in terms:
                # A variable of the grid that a term lacks counts as its power of zero, which is one everywhere.
                factors = (
                    polar(*self.values[name], powers[name], at[name], power)
                    if name in at
                    else self.values[name][0] ** power
                    for name, power in own.items()
                )
                coefficients[degree] += prod(factors, start=c)
            even, odd = parts(fmpq_poly(coefficients))
            found.append((arb_poly(even), arb_poly(odd)))
        return found

    def coefficients(self, node: Node) -> tuple[list[Pair], fmpq_poly]:
        """Ranges of the coefficients without delay and unknown, and the largest sizes of those that these multiply."""
        if node.kind in ("delay", "unknown"):
            return [], ONE * (sum(self.circle, fmpq(0)) if node.kind == "unknown" else 1)
        if node.kind == "leaf":
            terms = self.expression.leaves[node.name]
            found = [(fmpq(0), fmpq(0))] * (1 + max((term.degree for term in terms), default=-1))
            for c, degree, powers in terms:
                low, high = c, c
                for name, power in powers.items():
                    for _ in range(power):
                        low, high = _times((low, high), self.values[name])
                found[degree] = found[degree][0] + low, found[degree][1] + high
            return found, ZERO
        plain, late = self.coefficients(node.parts[0])
        for part in node.parts[1:]:
            more, later = self.coefficients(part)
            if node.kind == "sum":
                both = zip_longest(plain, more, fillvalue=(fmpq(0), fmpq(0)))
                plain, late = [(a[0] + b[0], a[1] + b[1]) for a, b in both], late + later
                continue
            spend(10 * len(plain) * len(more))
            total = [(fmpq(0), fmpq(0))] * (len(plain) + len(more) - 1 if plain and more else 0)
            for (i, a), (j, b) in product(enumerate(plain), enumerate(more)):
                low, high = _times(a, b)
                total[i + j] = total[i + j][0] + low, total[i + j][1] + high
            plain, late = total, _sizes(plain) * later + late * _sizes(more) + late * later
        return plain, late

    def leads(self, w: fmpq) -> bool:
        """Whether the leading term outweighs all others from a frequency up, so that p vanishes nowhere there."""
        plain, late = self.coefficients(self.expression.body)
        low, high = plain.pop()
        rest = _sizes(plain) + late
        return w > 0 and late.degree() <= len(plain) and rest(w) < max(low, -high) * w ** len(plain)

    def clear(self, w1: fmpq, w2: fmpq, x: arb, y: arb) -> bool:
        """Whether p keeps to the side of the line across (x, y) towards which that points, from w1 to w2."""
        frames = self.frame(w1), self.frame(w2)
        chord = arb((w2 - w1) ** 2 / 8)
        stray = sum((self._growth(frames, node, chord)[2] for node in self.summands), arb(0)) * chord
        stray *= (x * x + y * y).sqrt()
        return all(bool(frame.least(x, y) > stray) for frame in frames)

    def _growth(self, frames: tuple[Frame, Frame], node: Node, chord: arb) -> tuple[arb, arb, arb]:
        """Bounds of the size of a part of p between two frequencies, and of its first and second derivative in w."""
        if node.kind == "delay":
            most_late = arb(self.values[node.name][1])
            return arb(1), most_late, most_late**2
        if node.kind == "unknown":
            return arb(sum(self.circle, fmpq(0))), arb(0), arb(0)
        if node.kind == "product":
            size, slope, bend = self._growth(frames, node.parts[0], chord)
            for part in node.parts[1:]:
                f, df, ddf = self._growth(frames, part, chord)
                size, slope, bend = size * f, size * df + slope * f, size * ddf + 2 * slope * df + bend * f
            return size, slope, bend
        if node.kind == "inverse":
            slope, bend = self._steepness(node.name, frames[1].w)
            most = 1 / (apart([*frames[0].leaf(node.name), *frames[1].leaf(node.name)]) - bend * chord)
            if not most > 0:  # the leaf may vanish between these frequencies, or nothing is known of it
                most = arb("inf")
            return most, slope * most**2, bend * most**2 + 2 * slope**2 * most**3
        if node.kind == "leaf":
            slope, bend = self._steepness(node.name, frames[1].w)
        else:
            inner = [self._growth(frames, part, chord) for part in node.parts]
            slope, bend = sum((df for _, df, _ in inner), arb(0)), sum((ddf for _, _, ddf in inner), arb(0))
        return frames[0].size(node).max(frames[1].size(node)) + bend * chord, slope, bend

    def _steepness(self, name: str, w: arb) -> tuple[arb, arb]:
        """Bounds of the derivatives of a leaf up to a frequency: sums of those of its terms."""
        if name not in self._rates:
            sizes = fmpq_poly([])
            for c, degree, powers in self.expression.leaves[name]:
                largest = prod((most(self.values[n]) ** power for n, power in powers.items()), start=abs(c))
                sizes += fmpq_poly([0] * degree + [largest])
            slope = sizes.derivative()
            self._rates[name] = arb_poly(slope), arb_poly(slope.derivative())
        first, second = self._rates[name]
        return first(w), second(w)


def common_degrees(expression: Expression, pack: Sequence[str]) -> dict[str, int]:
    """The grid of leaves that are enumerated together: the degree in each varying variable of theirs."""
    terms = [term for name in pack for term in expression.leaves[name]]
    return degrees(terms, sorted({name for term in terms for name in term.powers} & {*expression.varying}))


def control_points(expression: Expression) -> int:
    """How many control points p has on one piece."""

    def of_leaf(name: str) -> int:
        """What lies along either axis has two ends, as in `Frame`."""
        parts = expression.components[name]
        along = {axis for axis, _, _ in parts} - {None}
        return prod(1 + e for axis, powers, _ in parts if axis is None for e in powers.values()) * 2 ** len(along)

    def of(node: Node) -> int:
        if node.kind == "sum":
            return (sum if node is expression.quotient else prod)(map(of, node.parts))
        if node.kind in ("delay", "unknown"):
            return TANGENTS + 2 if node.name in expression.varying else 1
        if node.kind == "inverse":
            return of_leaf(node.name) * (of_leaf(node.name) + 1) // 2
        return prod(map(of, node.parts), start=1 if node.packs or node.parts else of_leaf(node.name))

    return of(expression.quotient) * prod(
        of_leaf(pack[0]) if len(pack) == 1 else prod(1 + e for e in common_degrees(expression, pack).values())
        for pack in expression.packs
    )


def walked(
    expression: Expression, marks: Sequence[str], since: fmpq = NONE, until: fmpq | None = None
) -> tuple[int, str]:
    """How many pieces a tree has on which p vanishes nowhere, and in words the first on which that is not seen, if any.

    The marks are NAME (a cut in a variable), w=VALUE (in frequency, rad/s), X,Y (what is across a line) and "inf" (the
    leading term outweighs the others).

    Args:
        expression: of p.
        marks: in prefix order.
        since: frequency from which on p is looked at, rad/s.
        until: up to which, rad/s; None for all.

    Raises:
        Unreadable: where the tree ends too soon or too late, cuts outside of its pieces or is too much work.
    """
    if (points := control_points(expression)) > MOST_POINTS:
        raise Unreadable(f"p has {points} control points on a piece, more than {MOST_POINTS}")
    whole = Cell(expression, expression.enters)
    plain, late = whole.coefficients(expression.body)
    waits = expression.delay is not None and expression.variables[expression.delay][1] > 0
    if late.degree() >= len(plain) - (waits or expression.circle is None):
        raise Unreadable("the highest power of s is delayed: loops of neutral type are not covered")
    open_pieces: list[tuple[Cell, fmpq, fmpq | None]] = [(whole, since, until)]
    count = 0
    for mark in marks:
        if not 0 < len(open_pieces) <= MOST_OPEN:
            raise Unreadable(f"the tree goes on after all pieces are settled, or leaves more than {MOST_OPEN} open")
        cell, w1, w2 = open_pieces.pop()
        if mark in expression.varying:
            open_pieces += [(cell.half(mark, True), w1, w2), (cell.half(mark, False), w1, w2)]
        elif mark.startswith("w="):
            w = rational(mark[2:], "a cut of the tree")
            if not w > w1 or (w2 is not None and not w < w2):
                raise Unreadable(f"{mark[:60]} does not cut its piece")
            open_pieces += [(cell, w, w2), (cell, w1, w)]
        elif _settled(cell, w1, w2, mark):
            count += 1
        else:
            return count, f"{short(w1)} to {'infinity' if w2 is None else short(w2)} rad/s"
    if open_pieces:
        raise Unreadable("the tree ends before all pieces are settled")
    return count, ""


def _settled(cell: Cell, w1: fmpq, w2: fmpq | None, mark: str) -> bool:
    if mark == "inf":
        return w2 is None and cell.leads(w1)
    x, comma, y = mark.partition(",")
    if not comma:
        raise Unreadable(f"not a mark of the tree: {mark[:60]!r}")
    across = [arb(rational(number, "a line of the tree")) for number in (x, y)]
    with ctx.workprec(PRECISION_BITS):
        return w2 is not None and cell.clear(w1, w2, *across)


def _ends(side: tuple[arb, arb]) -> tuple[arb, ...]:
    return side[:1] if side[0] == side[1] else side


def most(interval: Pair) -> fmpq:
    """The largest size."""
    return max(abs(interval[0]), abs(interval[1]))


def _times(a: Pair, b: Pair) -> Pair:
    ends = [x * y for x in a for y in b]
    return min(ends), max(ends)


def _sizes(ranges: Sequence[Pair]) -> fmpq_poly:
    """The largest sizes of coefficients."""
    return fmpq_poly([most(interval) for interval in ranges])
