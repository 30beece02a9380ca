"""Whether a certificate is of a prototype: the figures, or the box of figures, that it states."""

import tomllib
from typing import Any

from beamdesign.proof.box_document import expression_table
from beamdesign.proof.document import controller_lines, rig_lines
from beamdesign.proof.family_document import effect_lines
from beamdesign.proof.replay_box import KIND, rational
from beamdesign.proof.rig_family import rig_family
from beamdesign.prototype import Prototype


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
    return all(table.get(key) == value for key, value in stated.items())


def _holds(table: dict[str, Any], prototype: Prototype) -> bool:
    family = rig_family(prototype)
    same = all(table.get(key) == value for key, value in expression_table(family).items())
    ranges = {name: [rational(end) for end in ends] for name, ends in table["range"].items()}
    # What the prototype leaves to the box, its payload and a delay, has no value of its own.
    own = {name: value for name, value in family.values.items() if name not in ("outer_end_mass", "delay")}
    return same and set(ranges) == set(family.values) and all(ranges[n][0] <= v <= ranges[n][1] for n, v in own.items())
