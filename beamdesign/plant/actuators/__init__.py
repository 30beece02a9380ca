"""Kinds of actuator: every file of this folder but the protocol holds one, found by being there."""

from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from pydantic import Field, create_model

from beamdesign import quantities as q
from beamdesign.plant.actuators.protocol import KINDS, Actuator
from beamdesign.records import Record

__all__ = ["KINDS", "Actuator", "ActuatorTolerance"]

for found in sorted((item.name for item in iter_modules(__path__)), key=lambda name: (name != "servo_cylinder", name)):
    if found != "protocol":
        KINDS[found] = import_module(f"{__name__}.{found}").KIND

if TYPE_CHECKING:

    class ActuatorTolerance(Record):
        """One relative standard deviation per figure of any actuator."""
else:
    _OF = {row.tolerance: row.words for kind in KINDS.values() for row in kind.parameters}
    ActuatorTolerance = create_model(
        "ActuatorTolerance",
        __base__=Record,
        **{
            key: (q.RelativeStd, Field(0.0, description=f"relative standard deviation of {words}"))
            for key, words in _OF.items()
        },
    )
