"""Stability of a family over a box of parameters: proved, refuted by a member, or undecided, with volumes."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING
from functools import cached_property, partial
from math import inf, pi
from typing import TYPE_CHECKING, NamedTuple

from flint import ctx, fmpq

from beamdesign.polynomial import exact, nearest, roots, text
from beamdesign.proofs.box_member import member, parameters_at, stable_at, unstable_member
from beamdesign.proofs.branch import Search
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.statement import Interval, PolynomialFamily, Statement
from beamdesign.proofs.writer import certificate, plain, stated, texts
from beamdesign.proofs.zero_exclusion import PRECISION_BITS, Piece, held, pieces
from beamdesign.prototype import Prototype
from beamdesign.quantities import decimal, stated_range

if TYPE_CHECKING:
    from beamdesign.proofs.box_claims import BoxClaim

# Volumes.


Cube = tuple[Interval, ...]
"""A sub-box as the shares of the varying variables' ranges."""

_VISITS = 20_000
"""Most sub-boxes to sort out; the rest counts as undecided."""


class Volumes(NamedTuple):
    """Shares of the volume of a box, exact, with sum one.

    They are measured in the variables as they enter: a sum or a product of parameters counts as one variable, and one
    that enters by its reciprocal is measured there.
    """

    stable: fmpq
    unstable: fmpq
    undecided: fmpq


def volumes_of(statement: Statement, unsettled: Sequence[Piece]) -> tuple[Volumes, dict[str, fmpq] | None]:
    """Volumes that are stable, not stable and undecided, and a member that is not stable.

    Outside of the unsettled cubes no root ever lies on the axis, so in every box that keeps clear of them the number
    of unstable roots is constant, and one exact test settles it.
    """
    found: dict[bool | None, fmpq] = {True: fmpq(0), False: fmpq(0), None: fmpq(0)}
    witness: dict[str, fmpq] | None = None
    for cube, volume, clear in parts_beside(cubes_of(unsettled, statement.varying), len(statement.varying), _VISITS):
        point = parameters_at(statement, [(a + b) / 2 for a, b in cube]) if clear else None
        verdict = None if point is None else stable_at(statement, point)
        found[verdict] += volume
        witness = point if verdict is False else witness
    return Volumes(found[True], found[False], found[None]), witness


def cubes_of(unsettled: Sequence[Piece], names: Sequence[str]) -> set[Cube]:
    """Shares of the ranges of some variables that pieces have, each once."""
    return {tuple(piece.cell.shares[name] for name in names) for piece in unsettled}


def parts_beside(cubes: Collection[Cube], axes: int, most: int) -> Iterator[tuple[Cube, fmpq, bool]]:
    """Cubes that fill the box, their volumes, and whether they keep clear of some; after so many visits none does."""
    whole: Cube = ((fmpq(0), fmpq(1)),) * axes
    stack, visits = [(whole, fmpq(1), sorted(cubes))], 0
    while stack:
        cube, volume, near = stack.pop()
        visits += 1
        within = (all(o[0] <= c[0] and c[1] <= o[1] for o, c in zip(other, cube, strict=True)) for other in near)
        if visits > most or not near or any(within):
            yield cube, volume, not near and visits <= most
        else:
            # Along the axis on which most of what is unsettled is narrower than this cube.
            widths = [end - start for start, end in cube]
            axis = max(range(len(cube)), key=lambda i: sum(other[i][1] - other[i][0] < widths[i] for other in near))
            start, end = cube[axis]
            middle = (start + end) / 2
            for half in ((start, middle), (middle, end)):
                part = (*cube[:axis], half, *cube[axis + 1 :])
                beside = [other for other in near if other[axis][0] < half[1] and half[0] < other[axis][1]]
                stack.append((part, volume / 2, beside))


# The certificate, as tables of texts: expression, ranges, member, tree.


KIND, OF_NO_RIG = "beamdesign.box", "beamdesign.expression_box"
_NOTES = {
    "p": "The characteristic polynomial: a sum of products of the leaves below, which are polynomials in s.",
    "bound": "Leaves that stand in several places; p is affine in each pack.",
    "divisors": "Leaves that p is divided by on every piece with a line: they are proved to be clear of zero there.",
    "tree": "Cuts and leaves in prefix order: NAME halves a variable, w= cuts the frequency (rad/s), X,Y is the\n"
    "# direction across a separating line, inf means that the leading term dominates.",
    "delay": "exp(-s T) by its name in p, and the parameter T.",
    "range": "SI, frequencies in rad/s.",
    "member": "The member that is settled by itself.",
    "tolerance": "Relative standard deviations, as the prototype has them.",
}


def box_certificate(
    subject: Prototype | PolynomialFamily,
    family: PolynomialFamily,
    statement: Statement,
    member: Mapping[str, fmpq],
    tree: Sequence[str] | None,
    claims: "Sequence[BoxClaim]" = (),
) -> str:
    """Write the certificate.

    Args:
        subject: what it is about, a rig or an expression alone.
        family: the expression.
        statement: the same over the box.
        member: every parameter of the member that is settled exactly.
        tree: the marks of `zero_exclusion.pieces` that prove the whole box; None where the member refutes it.
        claims: what is proved beside stability.

    Raises:
        InputError: as `rig_tables`.
    """
    body = {"stable": tree is not None, **family.table(tree)}
    body |= {"claim": [claim.table() for claim in claims]} if claims else {}
    body["range"] = {name: texts(ends) for name, ends in statement.parameters.items()}
    body["member"] = {name: text(member[name]) for name in statement.parameters}
    varying = {name: ends for name, ends in statement.parameters.items() if ends[0] < ends[1]}
    summary = [
        f"Certificate: the closed loop {family.name!r}"
        f" {'is stable for every member of' if tree is not None else 'is NOT stable throughout'} a box of",
        *(f"  {name} from {stated_range((nearest(a), nearest(b)))}" for name, (a, b) in varying.items()),
    ]
    if isinstance(subject, PolynomialFamily):
        return certificate(OF_NO_RIG, subject.name, body, "\n".join(summary), notes=_NOTES)
    if deviations := {key: value for key, value in plain(subject.tolerance).items() if value}:
        body["tolerance"] = stated(deviations)
    heaviest = nearest(statement.parameters["outer_end_mass"][1])
    return certificate(KIND, subject, body, "\n".join(summary), heaviest, _NOTES, varying)


# The box and its verdict.


_ENOUGH = 1e-4
"""Once a member refutes a box, its volumes are worked out until this share of it is open."""


Dashpot = Callable[[Mapping[str, fmpq]], Interval]
Spans = Callable[[Mapping[str, Interval]], Mapping[str, Interval]]


def _no_text(claims: "Sequence[BoxClaim]") -> str:
    """The certificate where nothing is decided."""
    return ""


@dataclass(frozen=True)
class Box:
    """Closed ranges of some parameters.

    Attributes:
        ranges: ends by parameter, exact; those of a rig are the `rig_values`, SI, frequencies in rad/s.
        nominal: where scaling starts from, inside each range but not always in its middle.
        rigid: names whose ranges are asked for as they are, so that scaling leaves them alone.
        dashpots: what gives the range of each, from the factors on the deviations of the figures behind it, by name.
        spans: what gives the ranges of what effects freeze, from those of all else; None without effects.
        performing: ranges over which more than stability is asked, in the place of these: payloads of a law of several.
    """

    ranges: Mapping[str, Interval]
    nominal: Mapping[str, fmpq]
    rigid: frozenset[str] = frozenset()
    dashpots: Mapping[str, Dashpot] = field(default_factory=dict)
    spans: Spans | None = field(default=None, repr=False, compare=False)
    performing: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return tuple(self.ranges)

    def scaled(self, factor: fmpq) -> "Box":
        """Every range that is not rigid, drawn in or out from its nominal value, and what effects span then.

        Raises:
            InputError: where rigs of such ranges leave nothing that could stand for an effect.
        """
        drawn = {
            name: (middle + factor * (low - middle), middle + factor * (high - middle))
            for name, (low, high) in self.ranges.items()
            if name not in self.rigid
            for middle in [self.nominal[name]]
        }
        own = {name: fmpq(1) if name in self.rigid else factor for name in self.ranges}
        drawn |= {name: of(own) for name, of in self.dashpots.items()}  # which are not linear in these
        ranges = {**self.ranges, **drawn}
        spans = {} if self.spans is None else self.spans(ranges)
        return replace(self, ranges=ranges | {name: ends for name, ends in spans.items() if name in ranges})


def box_of(
    ranges: Mapping[str, tuple[float | fmpq, float | fmpq]], nominal: Mapping[str, float | fmpq] | None = None
) -> Box:
    """A box from ranges by name; floats count as their shortest decimals, nominal values default to the middles.

    Raises:
        ValueError: for an empty range, or a nominal value outside of its range.
    """

    def exactly(value: float | fmpq) -> fmpq:
        return value if isinstance(value, fmpq) else exact(value)

    ends = {name: (exactly(low), exactly(high)) for name, (low, high) in ranges.items()}
    given = {name: exactly(value) for name, value in (nominal or {}).items()}
    middles = {name: given.get(name, (low + high) / 2) for name, (low, high) in ends.items()}
    for name, (low, high) in ends.items():
        if low > high:
            raise ValueError(f"{name}: empty range, {text(low)} is above {text(high)}")
        if not low <= middles[name] <= high:
            raise ValueError(f"{name}: the nominal value {text(middles[name])} lies outside of its range")
    return Box(ends, middles)


@dataclass(frozen=True)
class BoxVerdict:
    """What is known of a family over a box.

    Attributes:
        stable: True if proved for every member, False if a member is proved not to be stable, None otherwise.
        reason: in words, why it is not True; empty where it is.
        volumes: how much of the box is stable, not stable and undecided; None where no volumes were asked for and it
            is not all proved.
        unstable_point: value of every parameter of a member that is proved not to be stable.
        box: the box.
        pieces: number of pieces of (frequency, parameters) that were proved to be free of roots on the axis.
        looked_at: number of pieces the search looked at.
    """

    stable: bool | None
    reason: str
    volumes: Volumes | None
    unstable_point: Mapping[str, fmpq] | None
    box: Box
    pieces: int
    looked_at: int
    write: "Callable[[Sequence[BoxClaim]], str]" = field(default=_no_text, repr=False, compare=False)

    @cached_property
    def certificate(self) -> str:
        """Text that `beamdesign.checker` proves again; empty where the verdict is None.

        Raises:
            InputError: for effects whose elements no certificate states.
        """
        return self.write(())

    @property
    def of_frozen(self) -> str:
        """The answer in words, of the box between the ends of what the effects of a prototype freeze."""
        if self.stable:
            return "stable at every value between the ends of the frozen figures and of the masses too, all at once"
        undecided = "stability is undecided: " if self.stable is None else ""
        return f"between the ends of the frozen figures {undecided}{self.reason}"


def certify_box(
    subject: Prototype | PolynomialFamily,
    box: Box,
    budget: int = 4000,
    seconds: float = inf,
    volumes: bool = True,
    searched: bool = False,
    family: PolynomialFamily | None = None,
) -> BoxVerdict:
    """Prove or refute stability for every member of a box: zero exclusion by branch and bound.

    Branch and bound in floats finds pieces and separating lines, ball arithmetic proves each of them, and an exact
    test settles one member; a member found to be unstable is confirmed exactly as well.

    Args:
        subject: a prototype with a controller, or any family.
        box: ranges of some of its parameters; the others keep their values.
        budget: most pieces to look at; a quarter of it for the volumes of a box that a member refutes.
        seconds: most time to spend on the search; what was found until then is proved all the same.
        volumes: whether to work out the volumes of a box that is not proved.
        searched: whether members that are not stable were looked for already, in vain, in the box or a larger one.
        family: that of a prototype over these ranges, where it is known.

    Raises:
        ValueError: for a parameter that the family does not have, or a range that it does not allow.
    """
    if family is None:
        family = rig_family(subject, varying=box.ranges) if isinstance(subject, Prototype) else subject
    statement = family.over(box.ranges)
    nominal = {**family.values, **box.nominal}
    writer = partial(box_certificate, subject, family, statement)
    with ctx.workprec(PRECISION_BITS):
        point = nominal if stable_at(statement, nominal) is False else None
        if point is None and not searched:
            point = unstable_member(statement)
        if point is not None and not volumes:
            return BoxVerdict(False, _of(statement, point, box), None, point, box, 0, 0, partial(writer, point, None))
        try:
            search = Search(statement)
        except ValueError as error:
            if not isinstance(subject, Prototype):
                raise
            return BoxVerdict(None, f"not covered: {error}", None, None, box, 0, 0)
        if point is None:
            search.run(budget, seconds)
        else:
            search.run(budget // 4, seconds, _ENOUGH)
        tree = search.tree
        given_up = not volumes and "?" in tree  # undecided as it is: what else there is need not be proved
        every = list(pieces(statement, tree))
        settled = [piece.direction != "?" for piece in every] if given_up else held(every)
        proved = 0 if given_up else sum(settled)
        unsettled = [piece for piece, sure in zip(every, settled, strict=True) if not sure]
        shares, witness = (None, None) if given_up else volumes_of(statement, unsettled)
        if point is None and witness is None and unsettled:
            middles = [[nearest(sum(p.cell.shares[n], fmpq(0)) / 2) for n in statement.varying] for p in unsettled]
            witness = unstable_member(statement, middles)
        point, known = point or witness, (box, proved, search.looked_at)
        if point is not None:
            return BoxVerdict(False, _of(statement, point, box), shares, point, *known, partial(writer, point, None))
        if not unsettled and stable_at(statement, nominal):
            return BoxVerdict(True, "", shares, None, *known, partial(writer, nominal, tree))
    return BoxVerdict(None, _where(unsettled, shares, search.looked_at), shares, None, *known)


def _of(statement: Statement, point: Mapping[str, fmpq], box: Box) -> str:
    """The member that is not stable, and what becomes of it, in words."""
    values = ", ".join(f"{name} {nearest(point[name]):.6g}" for name in box.names)
    where = f" at {values}" if values else ""
    one = member(statement, point)
    if one.plain.degree() < statement.degree[0]:
        return f"the leading coefficient vanishes{where}, so that a root passes through infinity"
    if one.delay != 0:
        return f"not stable{where}"
    worst = max(roots(one.plain + one.late), key=lambda root: root.real)
    return f"not stable{where}: a root at {worst.real:.4g} 1/s, {abs(worst.imag) / (2 * pi):.4g} Hz"


def _where(unsettled: Sequence[Piece], shares: Volumes | None, looked_at: int) -> str:
    """Where nothing was decided, in words."""
    if not unsettled:
        return "no member could be told to be stable"
    if not looked_at:
        return "no time was left for the box"
    low = min(nearest(piece.w1) for piece in unsettled) / (2 * pi)
    ends = [piece.w2 for piece in unsettled if piece.w2 is not None]
    on = "" if shares is None else f" on {decimal(nearest(shares.undecided), 3, ROUND_CEILING)} of the box"
    share = f"undecided{on} after {looked_at} pieces"
    if not ends:
        return f"{share}: the leading coefficient may vanish, so that a root passes through infinity"
    return f"{share}: a root may lie on the axis between {low:.4g} and {nearest(max(ends)) / (2 * pi):.4g} Hz"
