"""Steady motion of the nonlinear rig under a sinusoidal force: that to which it comes, not any that balances.

Harmonic balance finds it fast and, where the laws have no corners, exactly. It also finds motions that nothing tends
to, and with play misses much in the higher harmonics. So its motion counts where the Floquet multipliers say that a
departure from it dies out, and where a simulated period closes on it; else the rig is simulated from rest until its
periods are alike.
"""

from math import ceil, inf, tau

import numpy as np

from beamdesign.plant.compiled import integrate
from beamdesign.plant.equilibrium import MOST_STEPS, substeps_for
from beamdesign.plant.harmonic_balance import (
    DISPLACEMENT,
    HARMONICS,
    FreeRig,
    Motion,
    NoBalance,
    balance,
    motion_of,
    multipliers,
)
from beamdesign.prototype import Prototype

_STEPS_PER_RADIAN = 4  # of the fastest pole, as an impact in a joint is over in three
_LEAST_STEPS = 64
_NEWTON_STEPS = 10  # nearly all that are found take fewer, and a simulation costs less than more of them
_NEUTRAL = 1 + 1e-6  # as of a rod that is free in its play
_CLOSED, _ALIKE = 1e-2, 1e-4  # of the amplitude
_SETTLING_S, _SETTLING_PERIODS = 5.0, 30


def forced_motion(
    prototype: Prototype,
    force: float,
    frequency: float,
    outer_end_mass: float = 0.0,
    preload: float = 0.0,
    harmonics: int = HARMONICS,
) -> Motion:
    """Response to a sinusoidal force on the outer tip, to which the rig tends; one of them where it has several.

    Args:
        prototype: rig with its effects and a controller.
        force: amplitude, N.
        frequency: Hz.
        outer_end_mass: payload, kg.
        preload: constant force on top of it, N.
        harmonics: how many of them are balanced.

    Raises:
        NoBalance: where the rig comes to no motion of that period, as beyond what the actuator can do, or where it
            oscillates by itself.
        ValueError: where an effect shakes the rig in time.
    """
    rig, omega = FreeRig(prototype, outer_end_mass), tau * frequency
    c = np.zeros((len(rig.assembly.states), 2 * harmonics + 1))
    c[:, 0] = rest = rig.rest(rig.gain, preload)
    p, kinds = rig.at_gain(rig.gain), rig.assembly.kinds
    period = np.array([0.0, 1 / frequency])
    steps = max(_LEAST_STEPS, _STEPS_PER_RADIAN * substeps_for(rig.assembly, p, period))
    half, times = np.exp(1j * np.pi * np.arange(2 * steps + 1) / steps), np.linspace(0.0, period[-1], steps + 1)
    inputs = np.column_stack([preload + force * half.real, 0 * half.real])

    def moved(x: np.ndarray) -> tuple[np.ndarray, complex, np.ndarray]:
        """A period of the displacement (steps + 1,), its phasor, and the states at its end."""
        y, x = integrate(kinds, times, inputs, x, p, 1, inf)
        seen = y[:, DISPLACEMENT]
        if len(seen) < len(times):
            raise NoBalance("the rig leaves all bounds")
        return seen, complex(2 / steps * (seen[:-1] @ half[:-1:2].conj())), x

    try:
        c, *_ = balance(rig, (c, omega, rig.gain), None, preload, force, _NEWTON_STEPS)
        found = motion_of(rig, c, omega, rig.gain)
        if np.abs(multipliers(rig, c, omega, rig.gain)).max() < _NEUTRAL:
            _, closed, _ = moved(c[:, 0] + c[:, 1::2].sum(axis=1))
            if abs(closed - found.phasor_m) <= _CLOSED * abs(closed):
                return found
    except NoBalance:
        pass
    x, before = rest, [0j, 0j]
    for _ in range(min(max(_SETTLING_PERIODS, ceil(_SETTLING_S * frequency)), MOST_STEPS // steps)):
        seen, phasor, x = moved(x)
        if all(abs(phasor - one) <= _ALIKE * abs(phasor) for one in before):
            return Motion(frequency, phasor, float(seen[:-1].mean()), float(np.ptp(seen)) / 2, np.empty((len(x), 0)))
        before = [before[-1], phasor]
    raise NoBalance("the rig comes to no motion of the period of the force")
