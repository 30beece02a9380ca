"""What joins the tips of both beams: the record that every kind of actuator derives from, and what is asked of it.

Every file of this folder holds one kind, found by being there.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from operator import attrgetter
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from pydantic import Field, SerializerFunctionWrapHandler, create_model, model_serializer

from beamdesign import quantities as q
from beamdesign.kinded import Kinded
from beamdesign.plant.component import FELT, Component, Parameter, PortLaw, Signals
from beamdesign.records import Problem, Record

if TYPE_CHECKING:
    import numpy as np

MARGIN = 1.25
"""On what the linear loop asks of flow, current and stroke, where it is said what to buy."""


@cache
def turn(steps: int = 360) -> "np.ndarray":
    """(steps,) a turn of a sine."""
    import numpy as np

    return np.asarray(np.exp(2j * np.pi * np.arange(steps) / steps))


Demand = Mapping[str, "np.ndarray"]
"""What a sinusoidal force on the outer tip asks for, per newton; complex, (N,) over frequency, by name.

"displacement" of the outer tip, m/N; "force", N/N, and "stroke", m/N, of the actuator; "current" of the law, A/N; and
what else the actuator has to give.
"""

Held = Mapping[str, float]
"""What a constant force takes of each of these."""


class Limit(NamedTuple):
    """What bounds an actuator.

    Attributes:
        name: what people call it.
        of: which of `Demand` it bounds.
        most: by how much, SI; None where the prototype does not say.
        place: key that does.
        effective: whether it bounds the root of the mean square.
        reached: amplitude (N,) of the force at which it is reached, where that is no matter of one quantity.
    """

    name: str
    of: str
    most: float | None
    place: str
    effective: bool = False
    reached: "Callable[[Demand, Held, float], np.ndarray] | None" = None

    def amplitude(self, asked: Demand, held: Held) -> "np.ndarray":
        """(N,) amplitude of a sinusoidal force on the tip at which it is reached beside what is held."""
        import numpy as np

        assert self.most is not None  # else there is no limit
        if self.reached is not None:
            return self.reached(asked, held, self.most)
        still = held[self.of]
        left = np.sqrt(2 * max(self.most**2 - still**2, 0.0)) if self.effective else self.most - abs(still)
        return np.asarray(max(left, 0.0) / np.abs(asked[self.of]))


class Rating(NamedTuple):
    """A figure to buy by.

    Attributes:
        name: of what.
        need: which of `Actuator.takes` it has to bear.
        place: key of a prototype that states it.
        unit: SI.
        quantity: what of it a prototype may state.
        effect: whose first parameter bounds it too, by whatever law of it; empty where none does.
    """

    name: str
    need: str
    place: str
    unit: str
    quantity: Any
    effect: str = ""


class Row(NamedTuple):
    """A figure of a specification.

    Attributes:
        name: what it is, for people.
        needed: SI.
        stated: what the prototype has of it; None where it does not say, or where that is the same.
        unit: of both.
        key: in a JSON file; empty where it stands there as a figure of the prototype.
    """

    name: str
    needed: float
    stated: float | None
    unit: str
    key: str = ""

    @classmethod
    def to_buy(cls, name: str, needed: float, stated: float | None, unit: str, key: str) -> "Row":
        """One that is said with the margin on what is bought."""
        return cls(f"{name}, × {MARGIN:g}", MARGIN * needed, stated, unit, key)

    @property
    def basis(self) -> str:
        """Whether it is computed or given."""
        return "computed" if self.key else "given"

    @property
    def short(self) -> bool:
        """Whether the prototype states less than is needed."""
        return self.stated is not None and self.stated < self.needed


Change = tuple[str, float, bool]
"""Key of a prototype, its figure, and whether that is the least or else the most."""

KINDS: "dict[str, type[Actuator]]" = {}
"""Every kind of actuator by its name."""


class Actuator(Kinded):
    """An actuator between the tips: a law's current makes it longer, a force on it shorter.

    A kind is a file of this folder, which is found by being there and holds the class as `KIND`.

    Attributes:
        parameters: its figures in the model, one row each.
        tables: other tables of a prototype that are of it.
        components: of a rig, between "current_A" and "actuator_force_N", the force on the outer tip and back on the
            inner one; they give "sliding_m" and "sliding_m_per_s", of what rubs in it, too.
        states: of these.
        felt_by: those of its components that are worked out before its law, which may hear of them.
        feels: what it feels of its load: name in a record, which ends in its unit, and from ports, figures and states;
            a law may hear it.
        linear_states: of the linear plant: first its free length, then what follows the current.
        ratings: what it has to be rated for, beside its stroke.
        title: of their section in a specification.
        usual_strength_N: `strength_N` of a rig for which the library's usual figures of effects hold as they stand.
        unseen: one more of these, which may be neither driven nor seen, and is left out then; empty for none.
        law_alone: what a proof about a limit of the law's current leaves aside, in a sentence with a blank before it.
        fed_back: those of its figures that are zero where its drive feeds nothing back by itself.
    """

    known = KINDS
    where_none_is_stated = "servo_cylinder"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    tables: ClassVar[tuple[str, ...]] = ()
    components: ClassVar[tuple[Component, ...]] = ()
    felt_by: ClassVar[tuple[Component, ...]] = ()
    states: ClassVar[tuple[str, ...]] = ()
    feels: ClassVar[tuple[str, PortLaw]]
    linear_states: ClassVar[tuple[str, ...]] = ()
    unseen: ClassVar[str] = ""
    law_alone: ClassVar[str] = ""
    fed_back: ClassVar[tuple[str, ...]] = ()
    ratings: ClassVar[tuple[Rating, ...]] = ()
    title: ClassVar[str] = ""
    usual_strength_N: ClassVar[float] = 1000.0

    stroke_m: q.Stroke | None = Field(None, description="from one end stop to the other; the rig rests in the middle")

    @classmethod
    def to_linear(cls, state: Signals, figure: Signals, tip: Any) -> dict[str, Any]:
        """States of the linear plant from those of its components and the outer tip's place, linear in both."""
        return {name: state[name] for name in cls.states}

    @classmethod
    def from_linear(cls, linear: Signals, figure: Signals, tip: Any) -> dict[str, Any]:
        """States of its components from those of the linear plant and the outer tip's place."""
        return {name: linear[name] for name in cls.states}

    @classmethod
    @abstractmethod
    def compliance(cls, figure: Signals, s: Any) -> Any:
        """What a force on it shortens it by with no current, m/N, at complex frequencies s (rad/s)."""

    @classmethod
    @abstractmethod
    def held_N_per_A(cls, figure: Signals) -> float:
        """What a current gives at rest while the tips are held, N/A; infinite where nothing balances it."""

    @classmethod
    @abstractmethod
    def travel(cls, figure: Signals, s: Any) -> Any:
        """What a current lengthens it by with no force, m/A, likewise."""

    @abstractmethod
    def signals(self, figure: Signals, s: Any, force: Any, stroke: Any) -> dict[str, Any]:
        """What it has to give beside the law's current for a force and a stroke at complex frequencies s, by name."""

    @abstractmethod
    def limits(self, prototype: "WithActuator") -> tuple[Limit, ...]:
        """All that bounds it but for its stroke."""

    @abstractmethod
    def strength_N(self, prototype: "WithActuator") -> float:
        """About the largest force that it gives; `usual_strength_N` where the prototype does not say."""

    def largest_current_A(self, prototype: "WithActuator") -> float | None:
        """Largest current that it takes of a law, by its first rating and by a saturation; None where nothing says."""
        return self.stated(prototype, self.ratings[0]._replace(effect="current_saturation"))

    def drive_gain(self) -> float | None:
        """Current per volt, A/V, of a drive that has a command as its input; None where a coil is driven."""
        return None

    def stated(self, prototype: "WithActuator", rating: Rating) -> float | None:
        """What there is of a rating, by its key and its effect; None where the prototype does not say."""
        from beamdesign.plant.effects import laws_of

        limits = [attrgetter(rating.place)(prototype)]
        limits += [of_effect(prototype, name) for name in laws_of(rating.effect) if rating.effect]
        return min((limit for limit in limits if limit is not None), default=None)

    def usual_limits_A(self) -> dict[str, float]:
        """Limits of currents by the effect that they are of, where its drive gives them; else those of the library."""
        return {}

    @abstractmethod
    def takes(self, prototype: "WithActuator", asked: Demand, load_N: float, held: Held) -> dict[str, float]:
        """What an alternating force of an amplitude takes beside what is held, as `ratings` name it, SI.

        Args:
            prototype: it is of.
            asked: per newton.
            load_N: amplitude.
            held: what a constant force takes.
        """

    @abstractmethod
    def holding(self, prototype: "WithActuator", force_N: float) -> tuple[str, float, float | None, str, str]:
        """What holding a force still takes: name, figure, what there is, unit, and the key that states that."""

    @abstractmethod
    def stronger(self, prototype: "WithActuator", force_N: float) -> tuple[Change, ...]:
        """Changes, each enough by itself to hold a force, unrounded."""

    @abstractmethod
    def rows(self, prototype: "WithActuator", need: Mapping[str, float], load_N: float) -> tuple[Row, ...]:
        """Figures of a specification: what `takes` says, margins included, and what holds a load still."""

    @abstractmethod
    def power_W(self, prototype: "WithActuator", asked: Demand, load_N: "np.ndarray") -> "np.ndarray":
        """(N,) mean power that its supply gives for a force of an amplitude (N,), where what comes back is lost."""


def of_effect(prototype: "WithActuator", name: str) -> float | None:
    """The first parameter of an effect; None where the prototype has no such effect."""
    from beamdesign.plant.assembly import of_drive
    from beamdesign.plant.effects import library

    parameter, given = library()[name].parameters[0], prototype.effects.get(name)
    usual = of_drive(prototype).get(f"{name}.{parameter.name}", parameter.default)
    return None if given is None else given.get(parameter.name, usual)


for found in sorted((item.name for item in iter_modules(__path__)), key=lambda name: (name != "servo_cylinder", name)):
    KINDS[found] = import_module(f"{__name__}.{found}").KIND
FELT += dict.fromkeys(kind.feels[0] for kind in KINDS.values())

_OF = {row.tolerance: row.words for kind in KINDS.values() for row in kind.parameters}


def deviation(of: str) -> Any:
    """A field of `[tolerance]`."""
    return Field(0.0, description=f"relative standard deviation of {of}")


class _WithoutZeros(Record):
    """What of an actuator is not stated is not written: it may be another actuator's."""

    @model_serializer(mode="wrap")
    def _stated(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        given = self.model_fields_set
        return {key: value for key, value in handler(self).items() if value or key in given or key not in _OF}


if TYPE_CHECKING:

    class ActuatorTolerance(_WithoutZeros):
        """One relative standard deviation per figure of any actuator."""
else:
    _FIELDS = {key: (q.RelativeStd, deviation(words)) for key, words in _OF.items()}
    ActuatorTolerance = create_model("ActuatorTolerance", __base__=_WithoutZeros, **_FIELDS)


def not_felt(actuator: type[Actuator], sensors: Iterable[str], key: str) -> Iterator[Problem]:
    """That a law is to hear what another actuator feels of its load."""
    kind, own = actuator.model_fields["kind"].default, actuator.feels[0]
    for other in {one.feels[0] for one in KINDS.values()} & {*sensors} - {own}:
        yield Problem(key, f"is to hear {other}, which a rig with a {kind} does not have; it has {own}")


class WithActuator(Record):
    """A record with `actuator`, and beside it the tables of some kinds of actuator."""

    if TYPE_CHECKING:
        actuator: Actuator
        servovalve: Any
        supply: Any

        @property
        def effects(self) -> Mapping[str, Mapping[str, float]]:
            """Those of a prototype."""

    @property
    def rig(self) -> str:
        """Which of `beamdesign.plant.assembly.RIGS` it is."""
        return "twin_beam" if self.actuator.kind == Actuator.where_none_is_stated else self.actuator.kind

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The tables are those of its kind of actuator, and all of them; its law hears nothing that it has not."""
        yield from super().relations(table)
        given, usual = table.get("actuator", {}), Actuator.where_none_is_stated
        said = given.get("kind", usual) if isinstance(given, Mapping) else getattr(given, "kind", "")
        kind = said if isinstance(said, str) else ""  # of which it is told where it stands
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
