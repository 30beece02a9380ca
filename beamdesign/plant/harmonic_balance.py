"""Periodic motions of the nonlinear rig by harmonic balance: limit cycles over the gain, and forced response.

The states are Fourier series of so many harmonics. Their coefficients are found by Newton's method on the projection of
the assembled equations x' = f(x) on those harmonics, the laws themselves being evaluated in time (T. M. Cameron and
J. H. Griffin, J. Appl. Mech. 56 (1989) 149). With one harmonic it is the describing-function method with bias (A. Gelb
and W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968), exact in what the linear
parts do and blind to what the higher harmonics do to each other.

A limit cycle has its amplitude given and its gain sought: so the curve of gain over amplitude is a function, and both
its stable and its unstable parts are found. At amplitude zero it begins at the critical gain of the linearised loop.

Where it fails: one harmonic is 20 % off in gain where a limiter works nearly as a relay. Nine leave up to 0.5 % at the
corners of the laws. Sampled controllers and effects that depend on time are not covered. With play in the joint a start
is found at amplitudes well above the play only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import pi, tau

import numpy as np

from beamdesign.loop import CriticalGain
from beamdesign.plant.equilibrium import scales
from beamdesign.plant.fourier_balance import DISPLACEMENT, FreeRig, NoBalance, Unknown, balance, basis
from beamdesign.prototype import Prototype

__all__ = ["LimitCycle", "Motion", "NoBalance", "forced_motion", "limit_cycles", "linear_critical_gain"]

HARMONICS = 9
_NEARBY = 0.999
_SLOWEST = 1.0  # rad/s


@dataclass(frozen=True)
class Motion:
    """A periodic motion.

    Attributes:
        frequency_Hz: of its first harmonic.
        phasor_m: complex amplitude of the displacement's first harmonic; in phase with the force, or real.
        mean_m: of the displacement.
        swing_m: half the difference of its largest and smallest value.
        coefficients: (n, 2 H + 1) Fourier coefficients of the states: mean, then cosine and sine of each harmonic.
    """

    frequency_Hz: float
    phasor_m: complex
    mean_m: float
    swing_m: float
    coefficients: np.ndarray = field(repr=False)

    @property
    def amplitude_m(self) -> float:
        """Of the displacement's first harmonic."""
        return abs(self.phasor_m)


@dataclass(frozen=True)
class LimitCycle:
    """An oscillation that feeds itself.

    Attributes:
        gain_A_per_V: at which it exists.
        motion: what it looks like.
        steepness: d ln(gain) / d ln(amplitude) along the curve. Where it is positive, oscillations at that gain tend to
            this one in amplitude; where negative, smaller ones die out and larger ones grow (J. M. Loeb's rule).
        stable: whether all neighbours tend to it: the rule above, and no Floquet multiplier outside the unit circle.
    """

    gain_A_per_V: float
    motion: Motion
    steepness: float
    stable: bool


def linear_critical_gain(
    prototype: Prototype, outer_end_mass: float = 0.0, preload: float = 0.0, low: float = 1e-4, high: float = 10.0
) -> CriticalGain:
    """Lowest gain (A/V) at which the rig, linearised where it rests under a preload, has a pole on the axis.

    Args:
        prototype: rig with its effects; the controller's breaks are kept.
        outer_end_mass: payload, kg.
        preload: constant force on the outer tip, N.
        low: where the search begins, A/V.
        high: where it ends.

    Raises:
        ValueError: where there is none in between, as with a deadband, which closes no loop at rest.
    """
    from scipy.optimize import brentq

    rig = FreeRig(prototype, outer_end_mass)

    def poles(logarithm: float) -> np.ndarray:
        found = np.linalg.eigvals(rig.linear(float(np.exp(logarithm)), preload).a)
        # Friction's memory and a rod free in its play are poles at the origin, which are no oscillation.
        return np.asarray(found[np.abs(found.imag) > _SLOWEST])

    grid = np.linspace(np.log(low), np.log(high), 60)
    before = -1.0
    for left, right in pairwise(grid):
        after = float(poles(right).real.max())
        if before < 0 <= after:
            found = brentq(lambda at: float(poles(at).real.max()), left, right, xtol=1e-10)
            crossing = max(poles(found), key=lambda pole: pole.real)
            return CriticalGain(float(np.exp(found)), abs(crossing.imag) / tau)
        before = after
    raise ValueError(f"the linearised loop begins to oscillate at no gain from {low:g} to {high:g} A/V")


def limit_cycles(
    prototype: Prototype,
    amplitudes: Sequence[float],
    outer_end_mass: float = 0.0,
    harmonics: int = HARMONICS,
) -> tuple[LimitCycle, ...]:
    """Gains at which the loop oscillates with given amplitudes, each found from the one before.

    Args:
        prototype: rig with its effects and a controller, whose gain does not matter.
        amplitudes: of the displacement's first harmonic, m, in the order in which they are gone through; begin where
            the effects matter least.
        outer_end_mass: payload, kg.
        harmonics: how many; 1 gives the describing-function method.

    Raises:
        NoBalance: where no balance is found at one of them.
        ValueError: where an effect shakes the rig in time, or no linear loop is found to begin from.
    """
    rig = FreeRig(prototype, outer_end_mass)
    try:
        first = linear_critical_gain(prototype, outer_end_mass)
        shape = _eigenmotion(rig, first)
    except ValueError:
        plain = prototype.but(effects={})
        first, bare = linear_critical_gain(plain, outer_end_mass), FreeRig(plain, outer_end_mass)
        # The oscillation of the rig without effects, among the states of the one with them.
        own = dict(zip(bare.states, _eigenmotion(bare, first), strict=True))
        shape = np.array([own.get(name, 0.0) for name in rig.states])
    guess = np.zeros((len(rig.states), 2 * harmonics + 1))
    guess[:, 0] = rig.rest(first.gain_A_per_V)
    guess[:, 1], guess[:, 2] = amplitudes[0] * shape.real, -amplitudes[0] * shape.imag
    unknown = (guess, tau * first.frequency_Hz, first.gain_A_per_V)
    found, at = [], amplitudes[0]
    for amplitude in amplitudes:
        unknown = _continued(rig, unknown, at, amplitude)
        at = amplitude
        c, omega, gain = unknown
        beyond = _continued(rig, unknown, at, amplitude * _NEARBY)[2]
        steepness = float(np.log(beyond / gain) / np.log(_NEARBY))
        stable = steepness > 0 and _settles(rig, c, omega, gain)
        found.append(LimitCycle(gain, _motion(rig, c, omega, gain), steepness, stable))
    return tuple(found)


def forced_motion(
    prototype: Prototype,
    force: float,
    frequency: float,
    outer_end_mass: float = 0.0,
    preload: float = 0.0,
    harmonics: int = HARMONICS,
) -> Motion:
    """Response to a sinusoidal force on the outer tip.

    Args:
        prototype: rig with its effects and a controller.
        force: amplitude, N.
        frequency: Hz.
        outer_end_mass: payload, kg.
        preload: constant force on top of it, N.
        harmonics: how many.

    Raises:
        NoBalance: where no periodic response is found, as beyond what the actuator can do.
        ValueError: where an effect shakes the rig in time.
    """
    rig = FreeRig(prototype, outer_end_mass)
    gain = rig.gain
    c = np.zeros((len(rig.states), 2 * harmonics + 1))
    c[:, 0] = rig.rest(gain, preload)
    done, step = 0.0, 1.0
    while done < 1.0:
        share = min(1.0, done + step)
        try:
            c, *_ = balance(rig, (c, tau * frequency, gain), None, preload, share * force)
            done, step = share, 2 * step
        except NoBalance:
            step /= 4
            if step < 1e-3:
                raise
    return _motion(rig, c, tau * frequency, gain)


def _continued(rig: FreeRig, start: Unknown, at: float, amplitude: float) -> Unknown:
    """Balance at an amplitude from that at another, in as many steps as it takes."""
    step, unknown = 1.0, start
    while True:
        target = at * (amplitude / at) ** step
        ratio = target / at
        c = unknown[0].copy()
        c[:, 1:] *= ratio
        try:
            unknown, at = balance(rig, (c, unknown[1], unknown[2]), target), target
            if abs(at / amplitude - 1) < 1e-12:
                return unknown
            step = 1.0
        except NoBalance:
            if ratio == 1.0 or step < 0.1:
                raise
            step /= 3


def _eigenmotion(rig: FreeRig, at: CriticalGain) -> np.ndarray:
    """Complex states (n,) of the linear oscillation at the critical gain, for a displacement of one."""
    model = rig.linear(at.gain_A_per_V)
    values, vectors = np.linalg.eig(model.a)
    shape = vectors[:, np.argmin(np.abs(values - 1j * tau * at.frequency_Hz))]
    return np.asarray(shape / (model.c[DISPLACEMENT] @ shape))


def _motion(rig: FreeRig, c: np.ndarray, omega: float, gain: float) -> Motion:
    forward, back, _ = basis(c.shape[1] // 2)
    y = rig.along(forward @ c.T, np.zeros((len(forward), 3)), gain)[1]
    series = back @ y
    return Motion(omega / tau, complex(series[1], -series[2]), float(series[0]), float(np.ptp(y)) / 2, c)


def _settles(rig: FreeRig, c: np.ndarray, omega: float, gain: float) -> bool:
    """Whether the Floquet multipliers lie inside the unit circle, but for the two nearest 1.

    These are that of a shift in time, and that of the amplitude, which `steepness` tells more sharply.
    """
    from scipy.linalg import expm

    forward, *_ = basis(c.shape[1] // 2)
    by_x = rig.along(forward @ c.T, np.zeros((len(forward), 3)), gain)[2]
    weight = scales(rig.assembly)
    turn = np.eye(len(c))
    for a in by_x:
        turn = expm(a / weight[:, None] * weight[None, :] * (2 * pi / omega / len(by_x))) @ turn
    multipliers = np.linalg.eigvals(turn)
    others = np.delete(multipliers, np.argsort(np.abs(multipliers - 1))[:2])
    return bool(np.all(np.abs(others) < 1))
