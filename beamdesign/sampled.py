"""A controller that works at sample times: held current, quantised volts, whole periods of delay."""

from math import pi

import numpy as np

from beamdesign.controllers import Break, Controller, refuse


def tustin(lag: Break | None, period_s: float) -> tuple[float, float, float]:
    """b0, b1, a1 of i = K (b0 e + b1 e_old) - a1 i_old, by the trapezoidal rule; K C(0) is kept exactly."""
    if lag is None:
        return 1.0, 0.0, 0.0
    pole, zero = (2 / (2 * pi * frequency * period_s) for frequency in (lag.pole_Hz, lag.zero_Hz))
    return (1 + zero) / (1 + pole), (1 - zero) / (1 + pole), (1 - pole) / (1 + pole)


def digital_law(
    controller: Controller, period_steps: int, step_s: float, delay_periods: int, least_volt: float, rest: float
) -> np.ndarray:
    """The controller as `beamdesign.rig.compiled.integrate` takes it.

    Args:
        controller: continuous law.
        period_steps: integration steps per period.
        step_s: integration step, s.
        delay_periods: whole periods between reading a sample and giving its current.
        least_volt: step of the converter that reads the sensor, V; 0 for none.
        rest: error voltage (V) in the equilibrium from which a record starts.

    Raises:
        InputError: for a controller with second-order sections.
    """
    refuse(controller, "lag", "a sampled loop", "scenario")
    b0, b1, a1 = tustin(controller.lag, period_steps * step_s)
    gain = controller.gain_A_per_V
    return np.array([period_steps, delay_periods, gain, b0, b1, a1, least_volt, rest, gain * rest])
