"""Stability of a family over a box of parameters: proved, refuted by a member, or undecided, with the volumes of each."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, pi
from typing import NamedTuple

from flint import ctx, fmpq

from beamdesign.certify.box_document import box_document
from beamdesign.certify.branch import Search
from beamdesign.certify.rational import nearest, shortened, text
from beamdesign.certify.refute import parameters_at, refutes, unstable_member
from beamdesign.certify.replay_box import (
    PRECISION_BITS,
    Interval,
    Piece,
    Statement,
    Undecided,
    holds,
    is_stable,
    member,
    pieces,
)
from beamdesign.certify.rig_family import Family, rig_family
from beamdesign.polynomial import exact
from beamdesign.prototype import Prototype

Cube = tuple[Interval, ...]
"""A sub-box as the shares of the varying variables' ranges."""

_VISITS = 20_000
"""Most sub-boxes to sort out when volumes are added up; the rest counts as undecided."""

_TRIES = 10
"""Most factors to try to prove."""


@dataclass(frozen=True)
class Box:
    """Closed ranges of some parameters.

    Attributes:
        names: the parameters; those of a rig are the values of `rig_family`, SI, frequencies in rad/s.
        low, high: ends of the ranges, exact.
        nominal: where scaling starts from, inside each range but not always in its middle.
        rigid: names whose ranges are asked for as they are, so that scaling leaves them alone.
    """

    names: tuple[str, ...]
    low: tuple[fmpq, ...]
    high: tuple[fmpq, ...]
    nominal: tuple[fmpq, ...]
    rigid: frozenset[str] = frozenset()

    @property
    def ranges(self) -> dict[str, Interval]:
        """The ends of each range."""
        return {name: (a, b) for name, a, b in zip(self.names, self.low, self.high, strict=True)}

    def scaled(self, factor: fmpq) -> "Box":
        """Every range that is not rigid, drawn in or out from its nominal value."""
        low, high = [], []
        for name, a, b, middle in zip(self.names, self.low, self.high, self.nominal, strict=True):
            part = fmpq(1) if name in self.rigid else factor
            low.append(middle + part * (a - middle))
            high.append(middle + part * (b - middle))
        return Box(self.names, tuple(low), tuple(high), self.nominal, self.rigid)


def box_of(
    ranges: Mapping[str, tuple[float | fmpq, float | fmpq]],
    nominal: Mapping[str, float | fmpq] | None = None,
    rigid: Iterable[str] = (),
) -> Box:
    """A box from ranges by name; floats count as their shortest decimals, nominal values default to the middles.

    Raises:
        ValueError: for an empty range, or a nominal value outside of its range.
    """
    ends = {name: (_exactly(low), _exactly(high)) for name, (low, high) in ranges.items()}
    given = {name: _exactly(value) for name, value in (nominal or {}).items()}
    middles = {name: given.get(name, (low + high) / 2) for name, (low, high) in ends.items()}
    for name, (low, high) in ends.items():
        if low > high:
            raise ValueError(f"{name}: empty range, {text(low)} is above {text(high)}")
        if not low <= middles[name] <= high:
            raise ValueError(f"{name}: the nominal value {text(middles[name])} lies outside of its range")
    lows, highs = zip(*ends.values(), strict=True) if ends else ((), ())
    return Box(tuple(ends), lows, highs, tuple(middles.values()), frozenset(rigid))


def _exactly(value: float | fmpq) -> fmpq:
    return value if isinstance(value, fmpq) else exact(value)


@dataclass(frozen=True)
class BoxVerdict:
    """What is known of a family over a box.

    The three fractions are volumes over that of the box, measured in the variables as they enter: a sum or a product
    of parameters counts as one variable, and one that enters by its reciprocal is measured there. They are exact, and
    what is proved in them is proved like the whole.

    Attributes:
        stable: True if proved for every member, False if a member is proved not to be stable, None otherwise.
        reason: in words, why it is not True; empty where it is.
        proved_fraction, unstable_fraction, undecided_fraction: stable, not stable, and not decided; None where a
            member refutes the box and no volumes were asked for.
        unstable_point: value of every parameter of a member that is proved not to be stable.
        box: the box.
        pieces: number of pieces of (frequency, parameters) whose exclusion was proved.
        looked_at: number of pieces the search looked at.
        certificate: text that `replay_box` proves again; empty where the verdict is None.
    """

    stable: bool | None
    reason: str
    proved_fraction: float | None
    unstable_fraction: float | None
    undecided_fraction: float | None
    unstable_point: Mapping[str, fmpq] | None
    box: Box
    pieces: int
    looked_at: int
    certificate: str = field(repr=False)


class _Volumes(NamedTuple):
    stable: fmpq
    unstable: fmpq
    undecided: fmpq


def certify_box(
    subject: Prototype | Family,
    box: Box,
    budget: int = 20_000,
    seconds: float = inf,
    volumes: bool = True,
) -> BoxVerdict:
    """Prove or refute stability for every member of a box: zero exclusion by branch and bound.

    Branch and bound in floats finds pieces and separating lines, ball arithmetic proves each of them, and an exact
    test settles one member; a member found to be unstable is confirmed exactly as well.

    Args:
        subject: a prototype with a controller, or any family.
        box: ranges of some of its parameters; the others keep their values.
        budget: most pieces to look at.
        seconds: most time to spend on the search; what was found until then is proved all the same.
        volumes: whether to work out the volumes of a box that a member refutes.

    Raises:
        ValueError: for a parameter that the family does not have, or a range that it does not allow.
    """
    family = rig_family(subject) if isinstance(subject, Prototype) else subject
    statement = family.over(box.ranges)
    nominal = {**family.values, **dict(zip(box.names, box.nominal, strict=True))}
    with ctx.workprec(PRECISION_BITS):
        point = nominal if refutes(statement, nominal) else unstable_member(statement)
        if point is not None and not volumes:
            return BoxVerdict(False, _of(point, box), None, None, None, point, box, 0, 0, "")
        search = Search(statement)
        search.run(budget, seconds)
        tree = search.tree
        proved, unsettled = _proved(statement, tree)
        shares, witness = _volumes(statement, [_cube(statement, piece) for piece in unsettled])
        point = point or witness
        if point is not None:
            stable, reason = False, _of(point, box)
            certificate = box_document(family, statement, point, None)
        elif not unsettled and is_stable(statement, member(statement, nominal)):
            stable, reason = True, ""
            certificate = box_document(family, statement, nominal, tree)
        else:
            stable, reason = None, _where(unsettled, shares, search.looked_at)
            certificate = ""
    return BoxVerdict(stable, reason, *map(nearest, shares), point, box, proved, search.looked_at, certificate)


def _of(point: Mapping[str, fmpq], box: Box) -> str:
    """The member that is not stable, in words."""
    values = ", ".join(f"{name} {nearest(point[name]):.6g}" for name in box.names)
    return f"not stable at {values}" if values else "not stable"


def _where(unsettled: Sequence[Piece], shares: _Volumes, looked_at: int) -> str:
    """Where nothing was decided, in words."""
    if not unsettled:
        return "no member could be told to be stable"
    low = min(nearest(piece.w1) for piece in unsettled) / (2 * pi)
    ends = [piece.w2 for piece in unsettled if piece.w2 is not None]
    text = f"undecided on {nearest(shares.undecided):.3g} of the box after {looked_at} pieces"
    if not ends:
        return f"{text}: the leading coefficient may vanish, so that a root passes through infinity"
    return f"{text}: a root may lie on the axis between {low:.4g} and {nearest(max(ends)) / (2 * pi):.4g} Hz"


def _proved(statement: Statement, tree: Sequence[str]) -> tuple[int, list[Piece]]:
    """How many pieces of a tree hold, and those that do not."""
    count, unsettled = 0, []
    for piece in pieces(statement, tree):
        if holds(piece):
            count += 1
        else:
            unsettled.append(piece)
    return count, unsettled


def _cube(statement: Statement, piece: Piece) -> Cube:
    return tuple(piece.cell.shares[name] for name in statement.varying)


def _volumes(statement: Statement, unsettled: Sequence[Cube]) -> tuple[_Volumes, dict[str, fmpq] | None]:
    """Volumes that are stable, not stable and undecided, and a member that is not stable.

    Outside of the unsettled cubes no root ever lies on the axis, so in every box that keeps clear of them the number
    of unstable roots is constant, and one exact test settles it.
    """
    found = {True: fmpq(0), False: fmpq(0), None: fmpq(0)}
    witness: dict[str, fmpq] | None = None
    whole: Cube = tuple((fmpq(0), fmpq(1)) for _ in statement.varying)
    stack = [(whole, fmpq(1), list(dict.fromkeys(unsettled)))]
    visits = 0
    while stack:
        cube, volume, near = stack.pop()
        visits += 1
        narrower = [axis for axis in range(len(cube)) if any(_narrower(other[axis], cube[axis]) for other in near)]
        if not near and visits <= _VISITS:
            point = parameters_at(statement, [(a + b) / 2 for a, b in cube])
            verdict = _verdict(statement, point)
            found[verdict] += volume
            witness = point if verdict is False else witness
        elif visits > _VISITS or any(all(_covers(o, c) for o, c in zip(other, cube, strict=True)) for other in near):
            found[None] += volume
        else:
            axis = narrower[0]
            start, end = cube[axis]
            middle = (start + end) / 2
            for half in ((start, middle), (middle, end)):
                part = (*cube[:axis], half, *cube[axis + 1 :])
                stack.append((part, volume / 2, [other for other in near if _overlap(other[axis], half)]))
    return _Volumes(found[True], found[False], found[None]), witness


def _verdict(statement: Statement, point: Mapping[str, fmpq]) -> bool | None:
    try:
        return is_stable(statement, member(statement, point))
    except Undecided:
        return None


def _narrower(one: Interval, other: Interval) -> bool:
    return one[1] - one[0] < other[1] - other[0]


def _covers(one: Interval, other: Interval) -> bool:
    return one[0] <= other[0] and other[1] <= one[1]


def _overlap(one: Interval, other: Interval) -> bool:
    return one[0] < other[1] and other[0] < one[1]


@dataclass(frozen=True)
class Scaling:
    """How far the ranges of a box can be drawn out around its nominal values.

    Attributes:
        proved: largest factor at which the whole box was proved stable; 0 if none was.
        refuted: least factor at which a member of the box was proved not to be stable; None where none was found.
        limit: factor beyond which a figure would reach zero; nothing above it was asked.
        verdict: that of the box scaled by `proved`, with its certificate; None if `proved` is 0.
        unstable_point: the member that refutes at `refuted`.
        reason: in words, what is known between the two factors.
    """

    proved: float
    refuted: float | None
    limit: float
    verdict: BoxVerdict | None
    unstable_point: Mapping[str, fmpq] | None
    reason: str


def largest_scaling(
    subject: Prototype | Family, box: Box, within: float = 0.02, budget: int = 20_000, most: float = 10.0
) -> Scaling:
    """Draw the ranges of a box out until a member refutes it, and prove as much of that as can be.

    First the least factor is bracketed at which a member is found that is not stable. Then boxes a little smaller are
    tried, ever farther from it, until one is proved. Rigid ranges keep their size.

    Args:
        subject: a prototype with a controller, or any family.
        box: the tolerances at factor 1.
        within: how near to each other, relatively, the two factors should come.
        budget: most pieces to look at for each factor.
        most: largest factor to try.

    Raises:
        ValueError: as `certify_box`.
    """
    family = rig_family(subject) if isinstance(subject, Prototype) else subject
    limit = _limit(family, box, most)
    refuted, point = _least_refuted(family, box, limit, within / 4)
    proved, verdict, above = fmpq(0), None, limit if refuted is None else refuted
    factor = limit if refuted is None else _short(refuted * (1 - exact(within)))
    for _ in range(_TRIES):
        if not above * (1 - exact(1.001 * within)) > proved or factor <= 0:
            break
        found = certify_box(family, box.scaled(factor), budget, volumes=False)
        if found.stable:
            proved, verdict = factor, found
        else:
            above = factor
            if found.stable is False:
                refuted, point = factor, found.unstable_point
        if proved == limit:
            break
        factor = _short((proved + above) / 2)
    known = None if refuted is None else nearest(refuted)
    reason = _bracket(proved, above, refuted, limit)
    return Scaling(nearest(proved), known, nearest(limit), verdict, point, reason)


def _limit(family: Family, box: Box, most: float) -> fmpq:
    """The largest factor to try: beyond it a figure that is positive would reach zero."""
    limit = exact(most)
    if family.positive:
        for name, low, middle in zip(box.names, box.low, box.nominal, strict=True):
            if name not in box.rigid and low < middle and middle > 0:
                limit = min(limit, middle / (middle - low) * fmpq(999, 1000))
    return _short(limit)


def _least_refuted(
    family: Family, box: Box, limit: fmpq, within: float
) -> tuple[fmpq | None, Mapping[str, fmpq] | None]:
    """The least factor, about, at which a member is found that is not stable, and that member."""

    def found(factor: fmpq) -> Mapping[str, fmpq] | None:
        return unstable_member(family.over(box.scaled(factor).ranges))

    low, high, point = fmpq(0), limit, found(limit)
    if point is None:
        return None, None
    while high - low > exact(within) * high and high > limit / 1000:
        middle = _short((low + high) / 2)
        if (nearer := found(middle)) is not None:
            high, point = middle, nearer
        else:
            low = middle
    return high, point


def _short(factor: fmpq) -> fmpq:
    """A factor rounded down to four digits."""
    return shortened(factor, 4) if factor > 0 else factor


def _bracket(proved: fmpq, above: fmpq, refuted: fmpq | None, limit: fmpq) -> str:
    low, high = f"{nearest(proved):.4g}", f"{nearest(above):.4g}"
    if proved == limit:
        return f"proved up to {low}, the largest factor that was tried"
    start = f"proved up to {low}" if proved > 0 else "no factor was proved"
    if refuted is None:
        return f"{start}, undecided at {high}; no member was found that is not stable"
    if above < refuted:
        return f"{start}, undecided at {high}, refuted at {nearest(refuted):.4g}"
    return f"{start}, refuted at {high}"
