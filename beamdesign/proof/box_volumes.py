"""Volumes of a box that are proved stable, proved not stable, and undecided."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from flint import fmpq

from beamdesign.proof.box_member import Undecided, is_stable, member
from beamdesign.proof.box_statement import Interval, Statement
from beamdesign.proof.refute import parameters_at
from beamdesign.proof.zero_exclusion import Piece

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
    whole: Cube = tuple((fmpq(0), fmpq(1)) for _ in statement.varying)
    cubes = {tuple(piece.cell.shares[name] for name in statement.varying) for piece in unsettled}
    stack = [(whole, fmpq(1), sorted(cubes))]
    visits = 0
    while stack:
        cube, volume, near = stack.pop()
        visits += 1
        if not near and visits <= _VISITS:
            point = parameters_at(statement, [(a + b) / 2 for a, b in cube])
            verdict = verdict_at(statement, point)
            found[verdict] += volume
            witness = point if verdict is False else witness
        elif visits > _VISITS or any(all(_covers(o, c) for o, c in zip(other, cube, strict=True)) for other in near):
            found[None] += volume
        else:
            # Along the axis on which most of what is unsettled is narrower than this cube.
            axis = max(range(len(cube)), key=lambda i: sum(_narrower(other[i], cube[i]) for other in near))
            start, end = cube[axis]
            middle = (start + end) / 2
            for half in ((start, middle), (middle, end)):
                part = (*cube[:axis], half, *cube[axis + 1 :])
                stack.append((part, volume / 2, [other for other in near if _overlap(other[axis], half)]))
    return Volumes(found[True], found[False], found[None]), witness


def verdict_at(statement: Statement, point: Mapping[str, fmpq]) -> bool | None:
    """Whether a member is stable, exactly; None where a root is too near to the axis to tell."""
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
