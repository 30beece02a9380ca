"""Whether a certificate is of a prototype: the figures, or the box of figures, that it states."""

import tomllib
from typing import Any

from beamdesign.members import family
from beamdesign.proof.box_document import expression_table
from beamdesign.proof.document import controller_lines, rig_lines
from beamdesign.proof.family_document import KIND as MEMBERS
from beamdesign.proof.family_document import effect_lines, stated_member
from beamdesign.proof.rational import nearest
from beamdesign.proof.replay_box import KIND, rational
from beamdesign.proof.rig_family import rig_family
from beamdesign.prototype import Prototype

_OF_MEMBERS = ("gain", "performance_gain", "elements")


def states_figures_of(certificate: str, prototype: Prototype) -> bool:
    """Whether a certificate states rig, controller and effects of a prototype, and no others.

    That of a controller with several laws states either all of them or one. That over a box states ranges, which are to
    hold the prototype's figures, and the expression of its loop over them.
    """
    table = tomllib.loads(certificate)
    laws = () if prototype.schedule is None else prototype.schedule.laws
    by_law = [prototype.but(controller=law) for law, _ in laws]
    if table["kind"] == KIND:
        return any(_holds(table, one) for one in by_law or [prototype])
    return any(_states(table, one) for one in (prototype, *by_law))


def _states(table: dict[str, Any], prototype: Prototype) -> bool:
    lines = [*rig_lines(prototype), *controller_lines(prototype), *effect_lines(prototype)]
    stated = {"effects": None} | tomllib.loads("\n".join(lines))
    return all(table.get(key) == value for key, value in stated.items()) and _states_members(table, prototype)


def _states_members(table: dict[str, Any], prototype: Prototype) -> bool:
    """Whether the elements that stand for effects, which the proof is about, are those of the prototype's effects."""
    if table["kind"] != MEMBERS:
        return True
    own = [stated_member(member) for member in family(prototype, nearest(rational(table["high"]))).members]
    stated = [{key: value for key, value in one.items() if key in _OF_MEMBERS} for one in table["member"]]
    return stated == own


def _holds(table: dict[str, Any], prototype: Prototype) -> bool:
    own_family = rig_family(prototype)
    same = all(table.get(key) == value for key, value in expression_table(own_family).items())
    ranges = {name: [rational(end) for end in ends] for name, ends in table["range"].items()}
    # What the prototype leaves to the box, its payload and a delay, has no value of its own.
    own = {name: value for name, value in own_family.values.items() if name not in ("outer_end_mass", "delay")}
    return (
        same
        and set(ranges) == set(own_family.values)
        and all(ranges[n][0] <= v <= ranges[n][1] for n, v in own.items())
    )
