"""Sensor, controller and amplifier as laws at ports."""

from typing import Any


def low_pass_rate(frequency: Any, signal: Any, filtered: Any) -> Any:
    """Rate of a first-order low-pass filter with the given break (rad/s)."""
    return frequency * (signal - filtered)


def lag_current(gain: Any, pole: Any, zero: Any, error: Any, slow: Any) -> Any:
    """Current of a lag K (1 + s/zero)/(1 + s/pole), A; `slow` is the error through 1/(1 + s/pole)."""
    return gain * (slow + (error - slow) * pole / zero)
