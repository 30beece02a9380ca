"""Sensor, controller and amplifier as components, and their laws."""

from collections.abc import Callable, Sequence
from typing import Any

from beamdesign.rig.component import Component, Signals


def low_pass_rate(frequency: Any, signal: Any, filtered: Any) -> Any:
    """Rate of a first-order low-pass filter with the given break (rad/s)."""
    return frequency * (signal - filtered)


def lag_current(gain: Any, pole: Any, zero: Any, error: Any, slow: Any) -> Any:
    """Current of a lag K (1 + s/zero)/(1 + s/pole), A; `slow` is the error through 1/(1 + s/pole)."""
    return gain * (slow + (error - slow) * pole / zero)


SECTION_FIGURES = ("zero", "zero_damping_ratio", "pole", "pole_damping_ratio")
"""Of each second-order section of a controller; frequencies in rad/s."""


def section_figures(count: int) -> tuple[str, ...]:
    """Names of the figures of so many sections."""
    return tuple(f"section_{k}_{name}" for k in range(1, count + 1) for name in SECTION_FIGURES)


def section_states(count: int) -> tuple[str, ...]:
    """Names of their states: the input through 1 / (1 + 2 e s / p + s^2 / p^2), and its rate."""
    return tuple(f"section_{k}_{end}" for k in range(1, count + 1) for end in ("V", "V_per_s"))


def _sections(port: Signals, figure: Signals, state: Signals) -> tuple[Any, dict[str, Any]]:
    """Current of a lag with the sections that have states, A, and the rates of those."""
    signal = lag_current(1.0, figure["pole"], figure["zero"], port["error_V"], state["slow_error_V"])
    rates: dict[str, Any] = {}
    k = 1
    while f"section_{k}_V" in state:
        zero, zero_damping, pole, pole_damping = (figure[f"section_{k}_{name}"] for name in SECTION_FIGURES)
        slow, rate = state[f"section_{k}_V"], state[f"section_{k}_V_per_s"]
        bent = pole**2 * (signal - slow) - 2 * pole_damping * pole * rate
        rates |= {f"section_{k}_V": rate, f"section_{k}_V_per_s": bent}
        signal = slow + 2 * zero_damping * rate / zero + bent / zero**2
        k += 1
    return figure["gain"] * signal, rates


SENSED: dict[str, Callable[[Signals, Signals], Any]] = {
    "displacement_m": lambda port, state: port["error_V"],
    "inner_displacement_m": lambda port, state: -state["inner_m"],
    "load_pressure_Pa": lambda port, state: state["pressure_b_Pa"] - state["pressure_a_Pa"],
    "command_V": lambda port, state: port["command_V"],
}
"""What a controller of several sensors is given of each: what it should be less what it is; and its command."""


def observer_figures(order: int, sensors: Sequence[str]) -> tuple[str, ...]:
    """Names of the entries of an observer's matrices: a and b row by row, then c and d."""
    rows = range(1, order + 1)
    names = [f"observer_a_{i}_{j}" for i in rows for j in rows]
    names += [f"observer_b_{i}_{sensor}" for i in rows for sensor in sensors]
    return (*names, *(f"observer_c_{i}" for i in rows), *(f"observer_d_{sensor}" for sensor in sensors))


def observer_states(order: int) -> tuple[str, ...]:
    """Names of its states."""
    return tuple(f"observer_{i}" for i in range(1, order + 1))


def _observer_current(port: Signals, figure: Signals, state: Signals) -> Any:
    current = sum(
        figure[f"observer_d_{sensor}"] * signal(port, state)
        for sensor, signal in SENSED.items()
        if f"observer_d_{sensor}" in figure
    )
    i = 1
    while f"observer_{i}" in state:
        current += figure[f"observer_c_{i}"] * state[f"observer_{i}"]
        i += 1
    return figure["gain"] * current


def _observer_rates(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    given = {sensor: signal(port, state) for sensor, signal in SENSED.items() if f"observer_d_{sensor}" in figure}
    names = [name for name in state if name.removeprefix("observer_").isdigit()]
    return {
        row: sum(figure[f"observer_a_{row[9:]}_{column[9:]}"] * state[column] for column in names)
        + sum(figure[f"observer_b_{row[9:]}_{sensor}"] * signal for sensor, signal in given.items())
        for row in names
    }


def _controller(port: Signals, figure: Signals, state: Signals) -> Any:
    if "section_1_V" in state:
        return _sections(port, figure, state)[0]
    if "observer_d_displacement_m" in figure:
        return _observer_current(port, figure, state)
    if "slow_error_V" in state:
        return lag_current(figure["gain"], figure["pole"], figure["zero"], port["error_V"], state["slow_error_V"])
    return port.get("sampled_current_A", figure["gain"] * port["error_V"])


def _filtered(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    if "filtered_V" not in state:
        return {}
    return {"filtered_V": low_pass_rate(figure["filter_frequency"], port["sensor_V"], state["filtered_V"])}


def _controller_rates(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    if "observer_1" in state:
        return _observer_rates(port, figure, state)
    if "slow_error_V" not in state:
        return {}
    more = _sections(port, figure, state)[1] if "section_1_V" in state else {}
    return {"slow_error_V": low_pass_rate(figure["pole"], port["error_V"], state["slow_error_V"])} | more


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
        "demanded_A": _controller,
        "current_A": lambda port, figure, state: port["demanded_A"],
    },
    _controller_rates,
)
"""From command and measurement to current."""

OPEN_LOOP = Component(
    {
        "demanded_A": lambda port, figure, state: figure["gain"] * port["command_V"],
        "current_A": lambda port, figure, state: port["demanded_A"],
    }
)
"""An amplifier that gives a current for every command, whatever is measured."""
