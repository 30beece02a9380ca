"""Describing functions in closed form.

A. Gelb and W. E. Vander Velde, "Multiple-Input Describing Functions and Nonlinear System Design", McGraw-Hill 1968,
appendix B: limiter, relay and dead zone under a sine of amplitude A.
"""

from math import asin, pi, sqrt

import pytest
from lowest_edge import limit_cycles

from beamdesign import Prototype, critical_gain
from beamdesign.controllers import Proportional


def limiter(ratio: float) -> float:
    """Gain of a limiter of unit slope; `ratio` is the limit over the amplitude."""
    return 2 / pi * (asin(ratio) + ratio * sqrt(1 - ratio**2)) if ratio < 1 else 1.0


@pytest.fixture
def rig(paper: Prototype) -> Prototype:
    return paper.but(controller=Proportional(gain_A_per_V=0.02))


@pytest.mark.parametrize("amplitude", [2e-4, 3.6e-4, 4e-4, 4.3e-4])
def test_limiter(rig: Prototype, amplitude: float):
    """The describing function is real: the frequency stays, and gain times it is the critical gain."""
    limit, linear = 0.01, critical_gain(rig)
    limited = rig.but(effects={"current_saturation": {"limit_A": limit}})
    (cycle,) = limit_cycles(limited, [2e-4, amplitude], harmonics=1)[1:]
    sine = cycle.gain_A_per_V * rig.sensor.gain_V_per_m * amplitude
    assert cycle.gain_A_per_V * limiter(limit / sine) == pytest.approx(linear.gain_A_per_V, rel=1e-3)
    assert cycle.motion.frequency_Hz == pytest.approx(linear.frequency_Hz, rel=1e-6)


def test_relay(rig: Prototype):
    """A limiter far beyond its limit is a relay, 4 D / (pi A): the amplitude tends to one that needs infinite gain."""
    limit, linear = 0.01, critical_gain(rig)
    most = 4 * limit / (pi * rig.sensor.gain_V_per_m * linear.gain_A_per_V)
    limited = rig.but(effects={"current_saturation": {"limit_A": limit}})
    near = limit_cycles(limited, [2e-4, 0.9 * most, 0.99 * most, 0.998 * most], harmonics=1)[-1]
    assert near.gain_A_per_V > 5 * linear.gain_A_per_V
    # The next term of the limiter's series: N = 4 r / pi (1 - r^2 / 6).
    ratio = limit / (near.gain_A_per_V * rig.sensor.gain_V_per_m * near.motion.amplitude_m)
    assert near.motion.amplitude_m == pytest.approx(most * (1 - ratio**2 / 6), rel=1e-3)


@pytest.mark.parametrize("amplitude", [1e-3, 1e-4, 3e-5, 1e-5])
def test_dead_zone(rig: Prototype, amplitude: float):
    """It lies behind the valve's second-order lag, which lessens the amplitude that reaches it."""
    width, linear, valve = 2e-4, critical_gain(rig), rig.servovalve
    overlapped = rig.but(effects={"valve_deadband": {"half_width_A": width}})
    cycle = limit_cycles(overlapped, [1e-3, amplitude], harmonics=1)[1]
    share = linear.frequency_Hz / valve.natural_frequency_Hz
    reached = abs(1 / (1 - share**2 + 2j * valve.damping_ratio * share))
    sine = cycle.gain_A_per_V * rig.sensor.gain_V_per_m * amplitude * reached
    slope = 1 - limiter(width / sine)
    assert cycle.gain_A_per_V * slope == pytest.approx(linear.gain_A_per_V, rel=5e-3)
    assert cycle.motion.frequency_Hz == pytest.approx(linear.frequency_Hz, rel=5e-3)
