"""Newton's method for the Fourier coefficients of a rig's periodic motion, used by `beamdesign.plant.harmonic_balance`.

The states are series of a mean and H harmonics; the assembled laws are evaluated along one period and projected back
(T. M. Cameron and J. H. Griffin, J. Appl. Mech. 56 (1989) 149).
"""

from functools import cache
from math import tau

import casadi as ca
import numpy as np

from beamdesign.plant.assembly import OUTPUTS, Assembly, Structure, assemble, parameters_of, structure_of
from beamdesign.plant.equilibrium import Linearisation, equilibrium, linearise, scales
from beamdesign.prototype import Prototype

DISPLACEMENT = OUTPUTS.index("displacement_m")
_MOST_STEPS, _TOLERANCE = 40, 1e-8
_POINTS = 16  # per harmonic: corners of the laws are met to 1/points^2


class NoBalance(ValueError):
    """Newton's method found no periodic motion."""


class FreeRig:
    """Equations of a prototype's rig with the gain free.

    Raises:
        ValueError: where an effect shakes the rig in time.
    """

    def __init__(self, prototype: Prototype, outer_end_mass: float) -> None:
        kinds = structure_of(prototype)
        self.assembly: Assembly = assemble(kinds)
        if any(self.assembly.function.which_depends("t", ["rate"])):
            raise ValueError("an effect shakes the rig in time; harmonic balance has no single period then")
        self.states = self.assembly.states
        inner = prototype.payload.inner_end_mass_kg
        self.parameters = np.array(list(parameters_of(prototype, outer_end_mass, inner).values()))
        self.gain_at = self.assembly.parameters.index("gain")
        self.gain = float(self.parameters[self.gain_at])
        self.equations = _equations(kinds)

    def at_gain(self, gain: float) -> np.ndarray:
        """Parameters of the assembly with another gain (A/V)."""
        p = self.parameters.copy()
        p[self.gain_at] = gain
        return p

    def rest(self, gain: float, preload: float = 0.0) -> np.ndarray:
        """States (n,) at rest under a constant force on the tip (N)."""
        return equilibrium(self.assembly, np.array([preload, 0.0, 0.0]), self.at_gain(gain))

    def linear(self, gain: float, preload: float = 0.0) -> Linearisation:
        """The rig linearised there."""
        p, u = self.at_gain(gain), np.array([preload, 0.0, 0.0])
        return linearise(self.assembly, self.rest(gain, preload), u, p)

    def along(self, x: np.ndarray, u: np.ndarray, gain: float) -> list[np.ndarray]:
        """Along N points: rate, displacement, the derivatives of both by x, and of the rate by the gain."""
        count, n = x.shape
        rate, y, by_x, y_by_x, by_gain = (
            np.asarray(value) for value in self.equations(0.0, x.T, u.T, self.at_gain(gain))
        )
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


Unknown = tuple[np.ndarray, float, float]
"""Fourier coefficients (n, 2 H + 1), frequency in rad/s, gain in A/V."""


def balance(rig: FreeRig, guess: Unknown, amplitude: float | None, preload: float = 0.0, force: float = 0.0) -> Unknown:
    """Coefficients, frequency (rad/s) and gain (A/V) at which every harmonic balances.

    Args:
        rig: its equations.
        guess: where Newton's method begins.
        amplitude: of the displacement's first harmonic, m; frequency and gain are then sought, else they are given.
        preload: constant force, N.
        force: amplitude of a force in phase with the first harmonic's cosine, N.

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
    weight = scales(rig.assembly)
    scale_y = amplitude if free and amplitude else 1e-6
    weight *= min(1.0, scale_y / 1e-4) if free else 1.0

    def residual(c: np.ndarray, omega: float, gain: float) -> tuple[np.ndarray, list[np.ndarray]]:
        parts = rig.along(forward @ c.T, u, gain)
        rows = ((back @ parts[0]).T - omega * c @ rotate.T) / (weight[:, None] * omega)
        y = back @ parts[1]
        ends = [(y[1] - amplitude) / scale_y, y[2] / scale_y] if amplitude is not None else []
        return np.concatenate([rows.ravel(), ends]), parts

    value, parts = residual(c, omega, gain)
    for _ in range(_MOST_STEPS):
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
        try:
            change = np.linalg.solve(matrix, -value)
        except np.linalg.LinAlgError:
            break
        norm, share = np.linalg.norm(value), 1.0
        while True:
            part = share * change
            trial = c + weight[:, None] * part[: n * size].reshape(n, size)
            # Rows were divided by omega, which the change of omega leaves in place.
            turn = omega * (1 + np.clip(part[-2], -0.2, 0.2)) if free else omega
            step = gain * float(np.exp(np.clip(part[-1], -0.5, 0.5))) if free else gain
            value, parts = residual(trial, turn, step)
            if np.linalg.norm(value) < (1 - 0.1 * share) * norm or share < 1e-3 or norm < _TOLERANCE:
                break
            share /= 2
        c, omega, gain = trial, turn, step
        if np.linalg.norm(value) < _TOLERANCE and np.abs(part).max() < 1e-6 * max(
            1.0, np.abs(c / weight[:, None]).max()
        ):
            return c, omega, gain
    raise NoBalance("no periodic motion found" + (f" of amplitude {amplitude:g} m" if free else ""))
