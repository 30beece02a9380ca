"""Periodic motions of the nonlinear rig by harmonic balance.

The states are Fourier series of so many harmonics. Their coefficients are found by Newton's method on the projection of
the assembled equations x' = f(x) on those harmonics, the laws themselves being evaluated in time (T. M. Cameron and
J. H. Griffin, J. Appl. Mech. 56 (1989) 149). With one harmonic it is the describing-function method with bias (A. Gelb
and W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968), exact in what the linear
parts do and blind to what the higher harmonics do to each other.

Where it fails: one harmonic is 20 % off in gain where a limiter works nearly as a relay. Nine leave up to 0.5 % at the
corners of the laws. Sampled controllers and effects that depend on time are not covered. With play in the joint a start
is found at amplitudes well above the play only.

Of the steady motions under a sinusoidal force that is sought to which the rig comes, not any that balances. Harmonic
balance also finds motions that nothing tends to, and with play misses much in the higher harmonics. So its motion
counts where the Floquet multipliers say that a departure from it dies out, and where a simulated period closes on it;
else the rig is simulated from rest until its periods are alike.
"""

from dataclasses import dataclass, field
from functools import cache
from math import ceil, inf, tau

import casadi as ca
import numpy as np
from scipy.linalg import expm

from beamdesign.plant.assembly import OUTPUTS, Structure, assemble, parameters_of, structure_of
from beamdesign.plant.compiled import integrate
from beamdesign.plant.equilibrium import MOST_STEPS, StateSpace, equilibrium, linearise, scales, substeps_for
from beamdesign.prototype import Prototype

DISPLACEMENT = OUTPUTS.index("displacement_m")
_NEWTON_STEPS, _TOLERANCE, _LEAST_SHARE = 40, 1e-8, 0.03
HARMONICS = 9
_POINTS = 16  # per harmonic: corners of the laws are met to 1/points^2


class NoBalance(ValueError):
    """Newton's method found no periodic motion."""


class FreeRig:
    """Equations of a prototype's rig with the gain free.

    Raises:
        ValueError: where an effect shakes the rig in time.
    """

    def __init__(self, prototype: Prototype, outer_end_mass: float) -> None:
        self.assembly = assemble(structure_of(prototype))
        if any(self.assembly.function.which_depends("t", ["rate"])):
            raise ValueError("an effect shakes the rig in time; harmonic balance has no single period then")
        self.parameters = parameters_of(prototype, outer_end_mass, prototype.payload.inner_end_mass_kg)
        self.gain = self.parameters["gain"]

    def at_gain(self, gain: float) -> np.ndarray:
        """Parameters of the assembly with another gain (A/V)."""
        return np.array(list((self.parameters | {"gain": gain}).values()))

    def rest(self, gain: float, preload: float = 0.0) -> np.ndarray:
        """States (n,) at rest under a constant force on the tip (N)."""
        return equilibrium(self.assembly, np.array([preload, 0.0, 0.0]), self.at_gain(gain))

    def linear(self, gain: float, preload: float = 0.0) -> StateSpace:
        """The rig linearised there."""
        return linearise(self.assembly, self.rest(gain, preload), np.array([preload, 0.0, 0.0]), self.at_gain(gain))

    def along(self, x: np.ndarray, u: np.ndarray, gain: float) -> list[np.ndarray]:
        """Along N points: rate, displacement, the derivatives of both by x, and of the rate by the gain."""
        count, n = x.shape
        found = _equations(self.assembly.kinds)(0.0, x.T, u.T, self.at_gain(gain))
        rate, y, by_x, y_by_x, by_gain = map(np.asarray, found)
        square = by_x.reshape(n, count, n).transpose(1, 0, 2)
        return [rate.T, y.ravel(), square, y_by_x.reshape(count, n), by_gain.T]


@cache
def _equations(kinds: Structure) -> ca.Function:
    assembly = assemble(kinds)
    t, x, u, p = assembly.function.sx_in()
    rate, y = assembly.function(t, x, u, p)
    gain = p[assembly.parameters.index("gain")]
    seen = y[DISPLACEMENT]
    results = [rate, seen, ca.jacobian(rate, x), ca.jacobian(seen, x), ca.jacobian(rate, gain)]
    return ca.Function("balance", [t, x, u, p], [ca.densify(value) for value in results])


@cache
def basis(harmonics: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Series to times (N, K), times to series (K, N), and d/d(phase) of a series (K, K)."""
    count = max(_POINTS * harmonics, 64)
    phase = tau * np.arange(count) / count
    columns, rotate = [np.ones(count)], np.zeros((2 * harmonics + 1, 2 * harmonics + 1))
    for h in range(1, harmonics + 1):
        columns += [np.cos(h * phase), np.sin(h * phase)]
        rotate[2 * h - 1, 2 * h], rotate[2 * h, 2 * h - 1] = h, -h
    forward = np.column_stack(columns)
    weight = np.full(2 * harmonics + 1, 2 / count)
    weight[0] = 1 / count
    return forward, weight[:, None] * forward.T, rotate


@cache
def _pairs(harmonics: int) -> np.ndarray:
    """From the derivatives of a law along the period (N) to those of its coefficients by coefficients (K * K, N)."""
    forward, back, _ = basis(harmonics)
    return np.asarray((back[:, None, :] * forward.T[None, :, :]).reshape(-1, len(forward)))


_UNDETERMINED = 1e9  # typical magnitudes: a step as large goes where nothing but rounding says how far


def _newton_step(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """The step (n,) of Newton's method, in typical magnitudes.

    Where it is not determined, as the mean pressure is not if nothing leaks, it is the smallest.
    """
    try:
        step = np.linalg.solve(jacobian, -residual)
    except np.linalg.LinAlgError:
        step = np.full(len(residual), np.inf)
    if np.abs(step).max() < _UNDETERMINED or not np.isfinite(jacobian).all():
        return step
    return np.asarray(np.linalg.lstsq(jacobian, -residual, rcond=None)[0])


Unknown = tuple[np.ndarray, float, float]
"""Fourier coefficients (n, 2 H + 1), frequency in rad/s, gain in A/V."""


def balance(
    rig: FreeRig,
    guess: Unknown,
    amplitude: float | None,
    preload: float = 0.0,
    force: float = 0.0,
    most_steps: int = _NEWTON_STEPS,
) -> Unknown:
    """Coefficients, frequency (rad/s) and gain (A/V) at which every harmonic balances.

    Args:
        rig: its equations.
        guess: where Newton's method begins.
        amplitude: of the displacement's first harmonic, m; frequency and gain are then sought, else they are given.
        preload: constant force, N.
        force: amplitude of a force in phase with the first harmonic's cosine, N.
        most_steps: of the method.

    Raises:
        NoBalance: where the method does not settle.
    """
    c, omega, gain = guess[0].copy(), guess[1], guess[2]
    n, size = c.shape
    forward, back, rotate = basis(size // 2)
    free = amplitude is not None
    u = np.zeros((len(forward), 3))
    u[:, 0] = preload + force * forward[:, 1]
    # A state is judged against its usual size, or against what it does where the motion is small.
    weight = scales(rig.assembly.states)
    scale_y = amplitude if free and amplitude else 1e-6
    weight *= min(1.0, scale_y / 1e-4) if free else 1.0

    def residual(c: np.ndarray, omega: float, gain: float) -> tuple[np.ndarray, list[np.ndarray]]:
        parts = rig.along(forward @ c.T, u, gain)
        rows = ((back @ parts[0]).T - omega * c @ rotate.T) / (weight[:, None] * omega)
        y = back @ parts[1]
        ends = [(y[1] - amplitude) / scale_y, y[2] / scale_y] if amplitude is not None else []
        return np.concatenate([rows.ravel(), ends]), parts

    value, parts = residual(c, omega, gain)
    for _ in range(most_steps):
        if not np.all(np.isfinite(value)):
            break
        _, _, by_x, y_by_x, by_gain = parts
        # Unknowns and rows run state by state, series coefficients within.
        jacobian = (_pairs(size // 2) @ by_x.reshape(len(by_x), n * n)).reshape(size, size, n, n).transpose(2, 0, 3, 1)
        jacobian = np.ascontiguousarray(jacobian)
        jacobian[np.arange(n), :, np.arange(n), :] -= omega * rotate
        jacobian *= weight[None, None, :, None] / (weight[:, None, None, None] * omega)
        matrix = jacobian.reshape(n * size, n * size)
        if free:
            turned = (-(c @ rotate.T) / weight[:, None]).ravel()
            raised = ((back @ by_gain).T * gain / (weight[:, None] * omega)).ravel()
            bottom = np.stack([(row[:, None] * y_by_x).T @ forward for row in back[1:3]])
            bottom = (bottom * weight[None, :, None] / scale_y).reshape(2, n * size)
            matrix = np.block([[matrix, turned[:, None], raised[:, None]], [bottom, np.zeros((2, 2))]])
        change = _newton_step(matrix, value)
        norm, share, whole = np.linalg.norm(value), 1.0, False
        while True:
            part = share * change
            trial = c + weight[:, None] * part[: n * size].reshape(n, size)
            # Rows were divided by omega, which the change of omega leaves in place.
            turn = omega * (1 + np.clip(part[-2], -0.2, 0.2)) if free else omega
            step = gain * float(np.exp(np.clip(part[-1], -0.5, 0.5))) if free else gain
            value, parts = residual(trial, turn, step)
            if np.linalg.norm(value) < (1 - 0.1 * share) * norm or whole or norm < _TOLERANCE:
                break
            # Shares shrink at the corners of a law, from one to the next of which a whole step leads all the same.
            whole = share < _LEAST_SHARE
            share = 1.0 if whole else share / 2
        c, omega, gain = trial, turn, step
        largest = max(1.0, np.abs(c / weight[:, None]).max())
        if np.linalg.norm(value) < _TOLERANCE and np.abs(part).max() < 1e-6 * largest:
            return c, omega, gain
    raise NoBalance("no periodic motion found" + (f" of amplitude {amplitude:g} m" if free else ""))


@dataclass(frozen=True)
class Motion:
    """A periodic motion.

    Attributes:
        frequency_Hz: of its first harmonic.
        phasor_m: complex amplitude of the displacement's first harmonic; in phase with the force, or real.
        mean_m: of the displacement.
        swing_m: half the difference of its largest and smallest value.
        coefficients: (n, 2 H + 1) Fourier coefficients of the states: mean, then cosine and sine of each harmonic;
            (n, 0) of one that was simulated.
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


def motion_of(rig: FreeRig, c: np.ndarray, omega: float, gain: float) -> Motion:
    """The motion of Fourier coefficients (n, 2 H + 1) at a frequency in rad/s and a gain in A/V."""
    forward, back, _ = basis(c.shape[1] // 2)
    y = rig.along(forward @ c.T, np.zeros((len(forward), 3)), gain)[1]
    series = back @ y
    return Motion(omega / tau, complex(series[1], -series[2]), float(series[0]), float(np.ptp(y)) / 2, c)


def multipliers(rig: FreeRig, c: np.ndarray, omega: float, gain: float) -> np.ndarray:
    """Floquet multipliers (n,) of a periodic motion: by what a small departure from it grows in a period."""
    forward, *_ = basis(c.shape[1] // 2)
    by_x = rig.along(forward @ c.T, np.zeros((len(forward), 3)), gain)[2]
    weight = scales(rig.assembly.states)
    turn = np.eye(len(c))
    for a in by_x:
        turn = expm(a / weight[:, None] * weight[None, :] * (tau / omega / len(by_x))) @ turn
    return np.asarray(np.linalg.eigvals(turn))


_STEPS_PER_RADIAN = 4  # of the fastest pole, as an impact in a joint is over in three
_LEAST_STEPS = 64
_FORCED_STEPS = 10  # nearly all that are found take fewer, and a simulation costs less than more of them
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
        c, *_ = balance(rig, (c, omega, rig.gain), None, preload, force, _FORCED_STEPS)
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
