"""What a rig is made of: components, each with laws at named ports and states of its own, and its figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from beamdesign.plant.actuators.protocol import Actuator
    from beamdesign.plant.electronics import Law
    from beamdesign.prototype import Prototype

Signals = Mapping[str, Any]
PortLaw = Callable[[Signals, Signals, Signals], Any]
"""From ports worked out so far, figures and states to the signal of one more port."""


def nothing(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    """Rates of a component without states."""
    return {}


def either(port: str, law: Callable[..., Any]) -> dict[str, Callable[..., Any]]:
    """A port on either side of the cylinder, a and b, by a law that is told the side first."""
    return {port.format(side): partial(law, side) for side in "ab"}


SIGN = {"a": 1, "b": -1}
"""Of what differs from side to side by its sense alone."""


@dataclass(frozen=True)
class Component:
    """One part of a rig.

    Attributes:
        laws: law of each of its ports with all effects off, in the order in which they are worked out.
        rates: from ports, figures and states to the time derivatives of its own states.
    """

    laws: Mapping[str, PortLaw] = field(hash=False)
    rates: PortLaw = nothing

    def but(self, **laws: PortLaw) -> "Component":
        """The same component with other laws at some of its ports."""
        if unknown := set(laws) - set(self.laws):
            raise KeyError(f"no port {', '.join(sorted(unknown))}")
        return Component(dict(self.laws) | laws, self.rates)


@dataclass(frozen=True)
class Rig:
    """A kind of rig: components joined at their ports.

    Attributes:
        components: in the order in which their ports are worked out.
        states: names of the states that every rig of this kind has.
        figures: names of its parameters, effects apart.
        outputs: law of what is recorded, by name in order. The fifth is the displacement whose bound ends a record, the
            sixth what a sampled controller reads.
        actuator: of a rig with two beams.
    """

    components: tuple[Component, ...] = field(hash=False)
    states: tuple[str, ...]
    figures: tuple[str, ...]
    outputs: Mapping[str, PortLaw] = field(hash=False)
    actuator: "type[Actuator] | None" = None

    @property
    def ports(self) -> dict[str, PortLaw]:
        """Law of every port, in order."""
        return {name: law for component in self.components for name, law in component.laws.items()}

    def with_law(self, law: "Law | None") -> "Rig":
        """The same rig with another law of its controller; with None as it is."""
        if law is None:
            return self
        parts = [
            Component(dict(part.laws) | {"demanded_A": law.current}, law.rates) if "demanded_A" in part.laws else part
            for part in self.components
        ]
        own = tuple(name for name in law.parameters if name not in self.figures)
        return replace(self, components=tuple(parts), figures=self.figures + own)

    def rates(self, port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        """Time derivatives of all states but those of effects."""
        found: dict[str, Any] = {}
        for component in self.components:
            found |= component.rates(port, figure, state)
        return found


@dataclass(frozen=True)
class Parameter:
    """One parameter of the linear model.

    Attributes:
        name: in the model.
        symbol: in the paper.
        unit: of its value in the model, SI.
        place: where it stands in a prototype, as TABLE.KEY; a dashpot by its damping ratio, a beam's lumped figures
            where they are not left to its geometry.
        tolerance: key of its relative standard deviation in `[tolerance]`.
        subsystem: of the rig.
        typical: relative standard deviation where it is taken from drawings and data sheets: what an engineer would
            grant before a look; 0 where that is for whoever mounts it to say.
        words: what it is, for people.
    """

    name: str
    symbol: str
    unit: str
    place: str
    tolerance: str
    subsystem: str
    typical: float = 0.0
    words: str = ""

    @property
    def _per_turn(self) -> tuple[str, float]:
        """Unit and factor where the prototype counts in turns, and the model in radians."""
        if self.unit == "rad/s" and self.place.endswith("_Hz"):
            return "Hz", 2 * pi
        return ("m", 1 / (2 * pi)) if self.unit == "m/rad" else (self.unit, 1.0)

    @property
    def factor(self) -> float:
        """Of the model's value over the prototype's."""
        return self._per_turn[1]

    @property
    def shown_unit(self) -> str:
        """Unit in which people are shown it."""
        return self._per_turn[0]

    @property
    def key(self) -> str:
        """Its name with the unit of the model."""
        return with_unit(self.name, self.unit)

    @property
    def shown_key(self) -> str:
        """Its name with the unit in which people are shown it."""
        return with_unit(self.name, self.shown_unit)

    def stated(self, prototype: "Prototype") -> Any:
        """What stands at its place in a prototype; None where nothing does."""
        table, key = self.place.split(".")
        return getattr(getattr(prototype, table, None), key, None)


def with_unit(name: str, unit: str) -> str:
    """A name with its unit as a suffix: N s/m becomes _N_s_per_m; a plain number has none."""
    return name if unit == "1" else f"{name}_{unit.replace(' ', '_').replace('/', '_per_')}"
