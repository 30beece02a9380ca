"""What a rig is made of: components, each with laws at named ports and states of its own, and its figures.

The sensor, the controller and the amplifier, which all rigs have, are here too, with what laws a controller may have.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import pi
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import numpy as np

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

    @classmethod
    def of(cls, rates: PortLaw = nothing, /, **laws: PortLaw) -> "Component":
        """The component with these laws, each by the name of its port."""
        return cls(laws, rates)

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
        actuator: of a rig with two beams, its class.
    """

    components: tuple[Component, ...] = field(hash=False)
    states: tuple[str, ...]
    figures: tuple[str, ...]
    outputs: Mapping[str, PortLaw] = field(hash=False)
    actuator: type[Any] | None = None

    @property
    def ports(self) -> dict[str, PortLaw]:
        """Law of every port, in order."""
        return {name: law for component in self.components for name, law in component.laws.items()}

    def with_law(self, law: "Law | None") -> "Rig":
        """The same rig with another law of its controller; with None as it is."""
        if law is None:
            return self
        current, rates = (lambda *signals, k=k: law.current_and_rates(*signals)[k] for k in range(2))
        parts = (
            Component(dict(part.laws) | {"demanded_A": current}, rates) if "demanded_A" in part.laws else part
            for part in self.components
        )
        own = tuple(name for name in law.parameters if name not in _SHARED)
        return replace(self, components=tuple(parts), figures=self.figures + own)

    def rates(self, port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        """Time derivatives of all states but those of effects."""
        each = (component.rates(port, figure, state) for component in self.components)
        return {name: rate for rates in each for name, rate in rates.items()}


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

    @classmethod
    def of(
        cls, table: str, name: str, symbol: str, unit: str, typical: float, words: str, subsystem: str = ""
    ) -> "Parameter":
        """One of one name in a table and in `[tolerance]`; its subsystem is that table, unless another is said."""
        key = with_unit(name, {"rad/s": "Hz", "m/rad": "m"}.get(unit, unit))
        return cls(name, symbol, unit, f"{table}.{key}", name, subsystem or table, typical, words)

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

    def stated(self, prototype: object) -> Any:
        """What stands at its place in a prototype; None where nothing does."""
        table, key = self.place.split(".")
        return getattr(getattr(prototype, table, None), key, None)


def with_unit(name: str, unit: str) -> str:
    """A name with its unit as a suffix: N s/m becomes _N_s_per_m; a plain number has none."""
    return name if unit == "1" else f"{name}_{unit.replace(' ', '_').replace('/', '_per_')}"


def low_pass_rate(frequency: Any, signal: Any, filtered: Any) -> Any:
    """Rate of a first-order low-pass filter with the given break (rad/s)."""
    return frequency * (signal - filtered)


class Law(Protocol):
    """The equations of a controller, figures apart: what it adds to a rig."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its figures, none of them one of the rig's but for "gain", "pole" and "zero"."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its states, none of them one of the rig's."""

    def current_and_rates(self, port: Signals, figure: Signals, state: Signals) -> tuple[Any, dict[str, Any]]:
        """What it asks of the valve, A, and the time derivatives of its states."""


@dataclass(frozen=True)
class Sampled:
    """A controller outside the equations, whose current is one of the rig's inputs."""

    parameters: tuple[str, ...] = ()
    states: tuple[str, ...] = ()

    def current_and_rates(self, port: Signals, figure: Signals, state: Signals) -> tuple[Any, dict[str, Any]]:
        """See `Law`."""
        return port["sampled_current_A"], {}


FIRST_ORDER = ("pole", "zero")
SECOND_ORDER = ("zero", "zero_damping_ratio", "pole", "pole_damping_ratio")
"""Figures of each factor; frequencies in rad/s."""
_SHARED = ("gain", *FIRST_ORDER)
"""Figures of a law that every rig has, see `beamdesign.plant.rigs.MORE_FIGURES`."""


@dataclass(frozen=True)
class Series:
    """A gain and factors of first and second order behind each other, between error voltage and current.

    States are the input of each factor through its denominator, V, and of a second-order one the rate of that.

    Attributes:
        orders: of the factors.
    """

    orders: tuple[int, ...] = ()

    @property
    def _factors(self) -> list[tuple[str, int]]:
        """What stands before the names of each factor, and its order: the first lag is the rig's own pole and zero."""
        counts = [self.orders[: k + 1].count(order) for k, order in enumerate(self.orders)]
        return [
            (f"section_{n}_" if order == 2 else "" if n == 1 else f"lag_{n}_", order)
            for order, n in zip(self.orders, counts, strict=True)
        ]

    @property
    def parameters(self) -> tuple[str, ...]:
        """See `Law`."""
        names = {1: FIRST_ORDER, 2: SECOND_ORDER}
        return ("gain", *(prefix + name for prefix, order in self._factors for name in names[order]))

    @property
    def states(self) -> tuple[str, ...]:
        """See `Law`."""
        names = {1: ("slow_error_V",), 2: ("V", "V_per_s")}
        return tuple(prefix + name for prefix, order in self._factors for name in names[order])

    def current_and_rates(self, port: Signals, figure: Signals, state: Signals) -> tuple[Any, dict[str, Any]]:
        """See `Law`; the current is the gain times the error behind all factors, V."""
        signal, rates = port["error_V"], {}
        for prefix, order in self._factors:
            if order == 1:
                pole, zero = (figure[prefix + name] for name in FIRST_ORDER)
                slow = state[f"{prefix}slow_error_V"]
                rates[f"{prefix}slow_error_V"] = low_pass_rate(pole, signal, slow)
                signal = slow + (signal - slow) * pole / zero
            else:
                zero, zero_damping, pole, pole_damping = (figure[prefix + name] for name in SECOND_ORDER)
                slow, rate = state[f"{prefix}V"], state[f"{prefix}V_per_s"]
                bent = pole**2 * (signal - slow) - 2 * pole_damping * pole * rate
                rates |= {f"{prefix}V": rate, f"{prefix}V_per_s": bent}
                signal = slow + 2 * zero_damping * rate / zero + bent / zero**2
        return figure["gain"] * signal, rates


FELT: list[str] = []
"""Ports of what actuators feel of their load, named as in a record; every kind of actuator adds its own."""


def _given(port: Signals, state: Signals) -> dict[str, Any]:
    """What a controller of several sensors is given of each: what it should be less what it is; and its command."""
    felt = {name: -port[name] for name in FELT if name in port}
    outer, inner = port["error_V"], -state["inner_m"]
    return {"displacement_m": outer, "inner_displacement_m": inner, **felt, "command_V": port["command_V"]}


@dataclass(frozen=True)
class Matrices:
    """z' = a z + b e, current = gain (c z + d e), e what is given of each of its inputs.

    Attributes:
        order: number of states.
        sensed: of what is given; see `law_inputs`.
    """

    order: int
    sensed: tuple[str, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """The gain, a and b row by row, then c and d."""
        rows = range(1, self.order + 1)
        names = [f"observer_a_{i}_{j}" for i in rows for j in rows]
        names += [f"observer_b_{i}_{sensor}" for i in rows for sensor in self.sensed]
        return ("gain", *names, *(f"observer_c_{i}" for i in rows), *(f"observer_d_{sensor}" for sensor in self.sensed))

    @property
    def states(self) -> tuple[str, ...]:
        """See `Law`."""
        return tuple(f"observer_{i}" for i in range(1, self.order + 1))

    def current_and_rates(self, port: Signals, figure: Signals, state: Signals) -> tuple[Any, dict[str, Any]]:
        """See `Law`."""
        given = {name: signal for name, signal in _given(port, state).items() if name in self.sensed}
        current = sum(figure[f"observer_d_{sensor}"] * signal for sensor, signal in given.items())
        for i, name in enumerate(self.states, start=1):
            current += figure[f"observer_c_{i}"] * state[name]
        return figure["gain"] * current, {
            row: sum(figure[f"observer_a_{i}_{j}"] * state[column] for j, column in enumerate(self.states, start=1))
            + sum(figure[f"observer_b_{i}_{sensor}"] * signal for sensor, signal in given.items())
            for i, row in enumerate(self.states, start=1)
        }


def law_inputs() -> tuple[str, ...]:
    """All that a law may go by, as it is recorded."""
    return ("error_V", "command_V", "inner_displacement_m", *FELT)


def state_space(law: Law, figure: Signals) -> "tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]":
    """A (n, n), B (n, h), C (n,) and D (h,) of a law from its `law_inputs` to its current (A), read off its equations.

    Args:
        law: linear, as every law of a controller is.
        figure: its figures by name.
    """
    import numpy as np

    rows, names = [], (*law.states, *law_inputs())
    for unit in np.eye(len(names)):
        own = dict(zip(names, unit.tolist(), strict=True))
        current, rates = law.current_and_rates(own, figure, own | {"inner_m": own["inner_displacement_m"]})
        rows.append([*(rates[name] for name in law.states), current])
    whole, n = np.array(rows).T, len(law.states)
    return whole[:n, :n], whole[:n, n:], whole[n, :n], whole[n, n:]


SAMPLED, PROPORTIONAL, LAG = Sampled(), Series(), Series((1,))


def _filtered(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    if "filtered_V" not in state:
        return {}
    return {"filtered_V": low_pass_rate(figure["filter_frequency"], port["sensor_V"], state["filtered_V"])}


SENSOR = Component.of(
    _filtered,
    sensor_V=lambda port, figure, state: figure["sensor_gain"] * port["sensed_m"],
    measured_V=lambda port, figure, state: state.get("filtered_V", port["sensor_V"]),
)
"""From the sensed displacement to volts."""

CONTROLLER = Component.of(
    error_V=lambda port, figure, state: port["command_V"] - port["measured_V"],
    demanded_A=lambda port, figure, state: figure["gain"] * port["error_V"],
    current_A=lambda port, figure, state: port["demanded_A"],
)
"""From command and measurement to current; `Rig.with_law` puts another law into it."""
