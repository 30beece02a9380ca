"""Stability of a family over a box of parameters: proved, refuted by a member, or undecided, with volumes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, pi

from flint import ctx, fmpq

from beamdesign.polynomial import exact, roots
from beamdesign.proof.box_member import member
from beamdesign.proof.box_statement import Interval, Statement
from beamdesign.proof.box_tables import box_certificate
from beamdesign.proof.box_volumes import Volumes, verdict_at, volumes_of
from beamdesign.proof.branch import Search
from beamdesign.proof.rational import nearest, text
from beamdesign.proof.refute import refutes, unstable_member
from beamdesign.proof.rig_family import Family, rig_family
from beamdesign.proof.zero_exclusion import PRECISION_BITS, Piece, holds, pieces
from beamdesign.prototype import Prototype

_ENOUGH = 1e-4
"""Once a member refutes a box, its volumes are worked out until this share of it is open."""


@dataclass(frozen=True)
class Box:
    """Closed ranges of some parameters.

    Attributes:
        names: the parameters; those of a rig are the `rig_values`, SI, frequencies in rad/s.
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

    Attributes:
        stable: True if proved for every member, False if a member is proved not to be stable, None otherwise.
        reason: in words, why it is not True; empty where it is.
        volumes: how much of the box is stable, not stable and undecided; None where a member refutes the box and no
            volumes were asked for.
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
    write: Callable[[], str] = field(repr=False, compare=False)

    @cached_property
    def certificate(self) -> str:
        """Text that `beamdesign.checker` proves again; empty where the verdict is None.

        Raises:
            InputError: for effects whose elements no certificate states.
        """
        return self.write()


def certify_box(
    subject: Prototype | Family,
    box: Box,
    budget: int = 4000,
    seconds: float = inf,
    volumes: bool = True,
) -> BoxVerdict:
    """Prove or refute stability for every member of a box: zero exclusion by branch and bound.

    Branch and bound in floats finds pieces and separating lines, ball arithmetic proves each of them, and an exact
    test settles one member; a member found to be unstable is confirmed exactly as well.

    Args:
        subject: a prototype with a controller, or any family.
        box: ranges of some of its parameters; the others keep their values.
        budget: most pieces to look at; a quarter of it for the volumes of a box that a member refutes.
        seconds: most time to spend on the search; what was found until then is proved all the same.
        volumes: whether to work out the volumes of a box that a member refutes.

    Raises:
        ValueError: for a parameter that the family does not have, or a range that it does not allow.
    """
    family = rig_family(subject) if isinstance(subject, Prototype) else subject
    statement = family.over(box.ranges)
    nominal = {**family.values, **dict(zip(box.names, box.nominal, strict=True))}

    def writer(point: Mapping[str, fmpq], tree: Sequence[str] | None) -> Callable[[], str]:
        return lambda: box_certificate(subject, family, statement, point, tree)

    with ctx.workprec(PRECISION_BITS):
        point = nominal if refutes(statement, nominal) else unstable_member(statement)
        if point is not None and not volumes:
            return BoxVerdict(False, _of(statement, point, box), None, point, box, 0, 0, writer(point, None))
        try:
            search = Search(statement)
        except ValueError as error:
            if not isinstance(subject, Prototype):
                raise
            return BoxVerdict(None, f"not covered: {error}", None, None, box, 0, 0, str)
        if point is None:
            search.run(budget, seconds)
        else:
            search.run(budget // 4, seconds, _ENOUGH)
        tree = search.tree
        proved, unsettled = _proved(statement, tree)
        shares, witness = volumes_of(statement, unsettled)
        if point is None and witness is None and unsettled:
            witness = unstable_member(statement, [_middle(statement, piece) for piece in unsettled])
        point = point or witness
        if point is not None:
            stable, reason, write = False, _of(statement, point, box), writer(point, None)
        elif not unsettled and verdict_at(statement, nominal):
            stable, reason, write = True, "", writer(nominal, tree)
        else:
            stable, reason, write = None, _where(unsettled, shares, search.looked_at), str
    return BoxVerdict(stable, reason, shares, point, box, proved, search.looked_at, write)


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


def _middle(statement: Statement, piece: Piece) -> list[float]:
    """The middle of a piece's box, as shares."""
    return [nearest(sum(piece.cell.shares[name], fmpq(0)) / 2) for name in statement.varying]


def _where(unsettled: Sequence[Piece], shares: Volumes, looked_at: int) -> str:
    """Where nothing was decided, in words."""
    if not unsettled:
        return "no member could be told to be stable"
    low = min(nearest(piece.w1) for piece in unsettled) / (2 * pi)
    ends = [piece.w2 for piece in unsettled if piece.w2 is not None]
    share = f"undecided on {nearest(shares.undecided):.3g} of the box after {looked_at} pieces"
    if not ends:
        return f"{share}: the leading coefficient may vanish, so that a root passes through infinity"
    return f"{share}: a root may lie on the axis between {low:.4g} and {nearest(max(ends)) / (2 * pi):.4g} Hz"


def _proved(statement: Statement, tree: Sequence[str]) -> tuple[int, list[Piece]]:
    """How many pieces of a tree hold, and those that do not."""
    count, unsettled = 0, []
    for piece in pieces(statement, tree):
        if holds(piece):
            count += 1
        else:
            unsettled.append(piece)
    return count, unsettled
