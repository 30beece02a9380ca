"""What an effect is: a law at one or more ports of a rig, with its parameters, states and source."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

SUBSYSTEMS = ("structure", "oil", "actuator", "servovalve", "amplifier", "sensor", "controller")


@dataclass(frozen=True)
class Parameter:
    """One figure of an effect.

    Attributes:
        name: with its SI unit as a suffix where it has one.
        default: nominal magnitude, which a prototype that names the effect alone gets.
        low: least value that makes sense.
        high: largest value that makes sense.
        spread: prior standard deviation of the natural logarithm (of the value itself where `low` is not positive).
        meaning: in words, with where the magnitude comes from.
    """

    name: str
    default: float
    low: float
    high: float
    spread: float
    meaning: str


@dataclass
class Site:
    """What a law sees of the rig while it is assembled.

    Attributes:
        port: signals computed so far, by port name.
        figure: figures of the rig by name.
        parameter: the effect's own parameters.
        state: the effect's own states.
        rate: to be filled with the time derivative of each of them.
        time: s.
    """

    port: Mapping[str, Any]
    figure: Mapping[str, Any]
    parameter: Mapping[str, Any]
    state: Mapping[str, Any]
    rate: dict[str, Any]
    time: Any


Law = Callable[[Any, Site], Any]
"""From a port's signal without the effect, and the site, to its signal with it; in CasADi."""


@dataclass(frozen=True)
class Effect:
    """One departure from the linear rig.

    Attributes:
        name: as prototypes and diagnoses spell it.
        subsystem: one of `SUBSYSTEMS`.
        laws: by port, what replaces the signal there; see `beamdesign.rig.assembly.PORTS`.
        parameters: its figures.
        states: names of the states it adds, with units.
        source: of the law.
        memory: those of its states that stay where they are while nothing moves (friction); they start at 0.
    """

    name: str
    subsystem: str
    laws: Mapping[str, Law] = field(hash=False)
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    source: str
    memory: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.subsystem not in SUBSYSTEMS:
            raise ValueError(f"{self.name}: no subsystem {self.subsystem}")
