"""Sensor, controller and amplifier as components, and their laws."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from beamdesign.plant.component import Component, Signals

if TYPE_CHECKING:
    import numpy as np


def low_pass_rate(frequency: Any, signal: Any, filtered: Any) -> Any:
    """Rate of a first-order low-pass filter with the given break (rad/s)."""
    return frequency * (signal - filtered)


class Law(Protocol):
    """The equations of a controller, figures apart: what it adds to a rig."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its figures; some may be among those that every rig has."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its states."""

    def current(self, port: Signals, figure: Signals, state: Signals) -> Any:
        """What it asks of the valve, A."""

    def rates(self, port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        """Time derivatives of its states."""


@dataclass(frozen=True)
class Sampled:
    """A controller outside the equations, whose current is one of the rig's inputs."""

    parameters: tuple[str, ...] = ()
    states: tuple[str, ...] = ()

    def current(self, port: Signals, figure: Signals, state: Signals) -> Any:
        """See `Law`."""
        return port["sampled_current_A"]

    def rates(self, port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        """See `Law`."""
        return {}


FIRST_ORDER = ("pole", "zero")
SECOND_ORDER = ("zero", "zero_damping_ratio", "pole", "pole_damping_ratio")
"""Figures of each factor; frequencies in rad/s."""


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

    def current(self, port: Signals, figure: Signals, state: Signals) -> Any:
        """See `Law`."""
        return figure["gain"] * self._through(port, figure, state)[0]

    def rates(self, port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        """See `Law`."""
        return self._through(port, figure, state)[1]

    def _through(self, port: Signals, figure: Signals, state: Signals) -> tuple[Any, dict[str, Any]]:
        """The error behind all factors, V, and the rates of their states."""
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
        return signal, rates


SENSED: dict[str, Callable[[Signals, Signals], Any]] = {
    "displacement_m": lambda port, state: port["error_V"],
    "inner_displacement_m": lambda port, state: -state["inner_m"],
    "load_pressure_Pa": lambda port, state: state["pressure_b_Pa"] - state["pressure_a_Pa"],
    "screw_force_N": lambda port, state: -port["actuator_force_N"],
    "command_V": lambda port, state: port["command_V"],
}
"""What a controller of several sensors is given of each: what it should be less what it is; and its command."""


@dataclass(frozen=True)
class Matrices:
    """z' = a z + b e, current = gain (c z + d e), e what is given of each thing heard.

    Attributes:
        order: number of states.
        sensed: of `SENSED`.
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

    def current(self, port: Signals, figure: Signals, state: Signals) -> Any:
        """See `Law`."""
        given = self._given(port, state)
        current = sum(figure[f"observer_d_{sensor}"] * signal for sensor, signal in given.items())
        for i, name in enumerate(self.states, start=1):
            current += figure[f"observer_c_{i}"] * state[name]
        return figure["gain"] * current

    def rates(self, port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
        """See `Law`."""
        given = self._given(port, state)
        return {
            row: sum(figure[f"observer_a_{i}_{j}"] * state[column] for j, column in enumerate(self.states, start=1))
            + sum(figure[f"observer_b_{i}_{sensor}"] * signal for sensor, signal in given.items())
            for i, row in enumerate(self.states, start=1)
        }

    def _given(self, port: Signals, state: Signals) -> dict[str, Any]:
        return {sensor: given(port, state) for sensor, given in SENSED.items() if sensor in self.sensed}


HEARD = ("error_V", "command_V", "inner_displacement_m", "load_pressure_Pa", "screw_force_N")
"""All that a law may go by, as it is recorded."""


def state_space(law: Law, figure: Signals) -> "tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]":
    """A (n, n), B (n, 5), C (n,) and D (5,) of a law from `HEARD` to its current (A), read off its own equations.

    Args:
        law: linear, as every law of a controller is.
        figure: its figures by name.
    """
    import numpy as np

    rows = []
    for unit in np.eye(len(law.states) + len(HEARD)):
        own = dict(zip((*law.states, *HEARD), unit.tolist(), strict=True))
        state = own | {"inner_m": own["inner_displacement_m"], "pressure_a_Pa": own["load_pressure_Pa"]}
        state["pressure_b_Pa"], own["actuator_force_N"] = 0.0, own["screw_force_N"]
        rates = law.rates(own, figure, state)
        rows.append([*(rates[name] for name in law.states), law.current(own, figure, state)])
    whole, n = np.array(rows).T, len(law.states)
    return whole[:n, :n], whole[:n, n:], whole[n, :n], whole[n, n:]


SAMPLED, PROPORTIONAL, LAG = Sampled(), Series(), Series((1,))


def _filtered(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    if "filtered_V" not in state:
        return {}
    return {"filtered_V": low_pass_rate(figure["filter_frequency"], port["sensor_V"], state["filtered_V"])}


SENSOR = Component(
    {
        "sensor_V": lambda port, figure, state: figure["sensor_gain"] * port["sensed_m"],
        "measured_V": lambda port, figure, state: state.get("filtered_V", port["sensor_V"]),
    },
    _filtered,
)
"""From the sensed displacement to volts."""

CONTROLLER = Component(
    {
        "error_V": lambda port, figure, state: port["command_V"] - port["measured_V"],
        "demanded_A": PROPORTIONAL.current,
        "current_A": lambda port, figure, state: port["demanded_A"],
    },
)
"""From command and measurement to current; `Rig.with_law` puts another law into it."""

OPEN_LOOP = Component(
    {
        "demanded_A": lambda port, figure, state: figure["gain"] * port["command_V"],
        "current_A": lambda port, figure, state: port["demanded_A"],
    }
)
"""An amplifier that gives a current for every command, whatever is measured."""
