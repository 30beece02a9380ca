"""Sensor, controller and amplifier as components, and their laws."""

from typing import Any

from beamdesign.rig.component import Component, Signals


def low_pass_rate(frequency: Any, signal: Any, filtered: Any) -> Any:
    """Rate of a first-order low-pass filter with the given break (rad/s)."""
    return frequency * (signal - filtered)


def lag_current(gain: Any, pole: Any, zero: Any, error: Any, slow: Any) -> Any:
    """Current of a lag K (1 + s/zero)/(1 + s/pole), A; `slow` is the error through 1/(1 + s/pole)."""
    return gain * (slow + (error - slow) * pole / zero)


def _controller(port: Signals, figure: Signals, state: Signals) -> Any:
    if "slow_error_V" in state:
        return lag_current(figure["gain"], figure["pole"], figure["zero"], port["error_V"], state["slow_error_V"])
    return port.get("sampled_current_A", figure["gain"] * port["error_V"])


def _filtered(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    if "filtered_V" not in state:
        return {}
    return {"filtered_V": low_pass_rate(figure["filter_frequency"], port["sensor_V"], state["filtered_V"])}


def _slow_error(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    if "slow_error_V" not in state:
        return {}
    return {"slow_error_V": low_pass_rate(figure["pole"], port["error_V"], state["slow_error_V"])}


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
    _slow_error,
)
"""From command and measurement to current."""

OPEN_LOOP = Component(
    {
        "demanded_A": lambda port, figure, state: figure["gain"] * port["command_V"],
        "current_A": lambda port, figure, state: port["demanded_A"],
    }
)
"""An amplifier that gives a current for every command, whatever is measured."""
