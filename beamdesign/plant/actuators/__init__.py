"""Kinds of actuator: every file of this folder but the protocol holds one, found by being there."""

from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any

from pydantic import Field, SerializerFunctionWrapHandler, create_model, model_serializer

from beamdesign import quantities as q
from beamdesign.plant.actuators.protocol import KINDS, Actuator
from beamdesign.records import Problem, Record

__all__ = ["KINDS", "Actuator", "ActuatorTolerance", "WithActuator"]

for found in sorted((item.name for item in iter_modules(__path__)), key=lambda name: (name != "servo_cylinder", name)):
    if found != "protocol":
        KINDS[found] = import_module(f"{__name__}.{found}").KIND

_OF = {row.tolerance: row.words for kind in KINDS.values() for row in kind.parameters}


class _WithoutZeros(Record):
    """What of an actuator is not stated is not written: it may be another actuator's."""

    @model_serializer(mode="wrap")
    def _stated(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {
            key: value
            for key, value in handler(self).items()
            if value or key in self.model_fields_set or key not in _OF
        }


if TYPE_CHECKING:

    class ActuatorTolerance(_WithoutZeros):
        """One relative standard deviation per figure of any actuator."""
else:
    ActuatorTolerance = create_model(
        "ActuatorTolerance",
        __base__=_WithoutZeros,
        **{
            key: (q.RelativeStd, Field(0.0, description=f"relative standard deviation of {words}"))
            for key, words in _OF.items()
        },
    )


def not_felt(actuator: type[Actuator], sensors: Iterable[str], key: str) -> Iterator[Problem]:
    """That a law is to hear what another actuator feels of its load."""
    kind, own = actuator.model_fields["kind"].default, actuator.feels[0]
    for other in {one.feels[0] for one in KINDS.values()} & {*sensors} - {own}:
        yield Problem(key, f"is to hear {other}, which a rig with a {kind} does not have; it has {own}")


class WithActuator(Record):
    """A record with `actuator`, and beside it the tables of some kinds of actuator."""

    if TYPE_CHECKING:
        actuator: Actuator

    @property
    def rig(self) -> str:
        """Which of `beamdesign.plant.assembly.RIGS` it is."""
        return self.actuator.rig

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The tables are those of its kind of actuator, and all of them; its law hears nothing that it has not."""
        yield from super().relations(table)
        given, usual = table.get("actuator", {}), Actuator.where_none_is_stated
        kind = given.get("kind", usual) if isinstance(given, Mapping) else getattr(given, "kind", "")
        for name in _TABLES if kind in KINDS else ():
            default = cls.model_fields[name].default
            if table.get(name, default) not in (None, default) and name not in KINDS[kind].tables:
                yield Problem(name, f"a {kind} has none")
            if default is None and table.get(name) is None and name in KINDS[kind].tables:
                yield Problem(name, "missing")

        law = table.get("controller")
        sensed = (
            law.get("sensors", law.get("added_sensors", ())) if isinstance(law, Mapping) else getattr(law, "senses", ())
        )
        if kind in KINDS and isinstance(sensed, list | tuple):
            yield from not_felt(KINDS[kind], sensed, "controller")

    @model_serializer(mode="wrap")
    def _without_tables_of_others(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        own = self.actuator.tables
        return {key: value for key, value in handler(self).items() if key not in _TABLES or key in own}


_TABLES = tuple(name for kind in KINDS.values() for name in kind.tables)
