"""What a certificate over a box of parameters states: ranges, one member, and a tree that leaves no room for a root.

All members of the box are stable where one is, and no root can cross the axis (zero exclusion). Of a rig, the
polynomial that is looked at is that of its loop; of an expression alone nothing is said of any rig.
"""

from collections.abc import Iterator

from flint import fmpq

from beamdesign.checker.box_rig import of_rig
from beamdesign.checker.delayed import unstable_roots
from beamdesign.checker.expressions import Expression
from beamdesign.checker.reading import Table, short
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import ZERO
from beamdesign.checker.stability import is_hurwitz
from beamdesign.checker.zero_exclusion import walked


def statements(table: Table, rig: Rig | None) -> Iterator[tuple[bool, str]]:
    """Every statement of a certificate over a box: whether it was proved, and it in words.

    Args:
        table: the certificate.
        rig: that it states; None for one of an expression alone.
    """
    expression = Expression(table)
    given = table.table("member")
    member = {name: given.number(name) for name in given.keys}
    stable = table.flag("stable")
    marks = [mark for line in table.words("tree") for mark in line.split()] if stable else []
    if rig is None:
        for name, (low, high) in expression.ranges.items():
            yield True, f"{name} from {short(low)} to {short(high)}"
    else:
        yield from of_rig(table, expression, rig)
    inside = member.keys() == expression.ranges.keys() and all(
        low <= member[name] <= high for name, (low, high) in expression.ranges.items()
    )
    words = "the member lies in the box"
    yield inside, words if inside else f"not proved: {words}"
    if not inside:
        return
    at = ", ".join(f"{name} {short(member[name])}" for name, (low, high) in expression.ranges.items() if low < high)
    found = _is_stable(expression, member)
    words = f"the member is {'' if stable else 'not '}stable: at {at or 'the only one'}"
    yield found is stable, words if found is stable else f"not proved: {words}"
    if found is not True or not stable:
        return
    count = 0
    for where, settled in walked(expression, marks):
        count += 1
        if not settled:
            yield False, f"piece {count}, {where}, is not seen to be free of roots"
            return
    yield True, f"stable for every member of the box: {count} pieces free of roots on the axis"


def _is_stable(expression: Expression, member: dict[str, fmpq]) -> bool | None:
    """Whether a member has all roots that the others have, in the open left half plane; None where that is not seen."""
    plain, late, delay = expression.member(member)
    if delay == 0:
        plain, late = plain + late, ZERO
    if plain.degree() < expression.degree:
        return False  # a root passes through infinity
    if late == 0:
        return is_hurwitz(plain)
    if late.degree() >= plain.degree():
        return None
    count = unstable_roots(plain, late, delay)
    return None if count is None else count == 0
