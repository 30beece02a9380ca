"""What a rig is made of: components, each with laws at named ports and states of its own."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from beamdesign.plant.electronics import Law

Signals = Mapping[str, Any]
PortLaw = Callable[[Signals, Signals, Signals], Any]
"""From ports worked out so far, figures and states to the signal of one more port."""


def nothing(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    """Rates of a component without states."""
    return {}


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
        words: what a person would call it.
        components: in the order in which their ports are worked out.
        states: names of the states that every rig of this kind has.
        figures: names of its parameters, effects apart.
        outputs: from ports, figures and states to what is recorded, by name.
        output_names: those names in order. The fifth is the displacement whose bound ends a record, the sixth what a
            sampled controller reads.
    """

    words: str
    components: tuple[Component, ...] = field(hash=False)
    states: tuple[str, ...]
    figures: tuple[str, ...]
    outputs: PortLaw
    output_names: tuple[str, ...]

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
