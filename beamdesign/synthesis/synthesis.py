"""Linear models as matrices, and two syntheses of a controller for a weighted plant by a pair of Riccati equations.

The regulator of least variance is state feedback with a Kalman filter. That of least norm is the central controller of
J. C. Doyle, K. Glover, P. Khargonekar and B. Francis, State-space solutions to standard H2 and H-infinity control
problems, IEEE Transactions on Automatic Control 34, 1989, of which the first is the case of an infinite level.

The plant that an observer-based controller is synthesised for: scaled, and weighted in physical terms.

It begins with the state space of a rig whose controller reads several sensors, in floats; the inner tip's displacement
and the load pressure are states of the rig, or sums of them. The tip's displacement under a coloured force is weighed
against the current, which goes through a roll-off of its own; the sensors are noisy, and a fictitious noise on the
current recovers the loop of the state feedback (J. C. Doyle and G. Stein, Robustness with observers, IEEE Transactions
on Automatic Control 24, 1979; N. K. Gupta, Frequency-shaped cost functionals, Journal of Guidance and Control 3, 1980).
Time is in units of 10 ms of a rig as quick as the published one, displacement in units of what the goal allows per
newton, and current in units of what a newton asks for at one radian per unit of time.

A synthesised controller is given fewer states by balanced residualisation, exact at zero frequency. The error is at
most twice the sum of the Hankel singular values left out (K. Glover, International Journal of Control 39, 1984; Y. Liu
and B. D. O. Anderson, International Journal of Control 50, 1989, for the residualised model).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy.linalg import block_diag, cholesky, solve_continuous_are, solve_continuous_lyapunov, svd

from beamdesign.controllers import SENSED, Sensed
from beamdesign.plant.equilibrium import StateSpace
from beamdesign.plant.linear import SEEN_AS, LinearModel


@dataclass(frozen=True)
class GeneralisedPlant:
    """x' = a x + b1 w + b2 u, z = c1 x + d12 u, y = c2 x + d21 w.

    w disturbs, z is to be small, y is measured and u acts. There is no cost between states and input (d12'c1 = 0), and
    none between noises (b1 d21' = 0).
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    d12: np.ndarray
    d21: np.ndarray


Solver = Callable[[GeneralisedPlant], StateSpace]
"""Gives the controller of a plant."""


def lqg(plant: GeneralisedPlant) -> StateSpace:
    """The controller from y to u of least variance of z under white noise w, of the plant's order.

    Raises:
        numpy.linalg.LinAlgError: where a Riccati equation has no stabilising solution.
    """
    return central(plant, inf)


SLACK = 1.05
"""Factor on the least norm at which a controller is taken: the optimum itself is singular."""

_TOLERANCE, _SMALLEST, _LARGEST = 1e-6, 1e-9, 1e9
"""Relative tolerance of the least norm, and between what it is sought."""


def hinf(plant: GeneralisedPlant) -> StateSpace:
    """The central controller from y to u a little above the least H-infinity norm from w to z.

    Raises:
        numpy.linalg.LinAlgError: where there is none.
    """
    return central(plant, SLACK * least_norm(plant))


def least_norm(plant: GeneralisedPlant) -> float:
    """Least H-infinity norm from w to z that a controller reaches, by bisection, on its upper side.

    Raises:
        numpy.linalg.LinAlgError: where there is none.
    """

    def reached(level: float) -> bool:
        try:
            central(plant, level)
        except np.linalg.LinAlgError:
            return False
        return True

    high = 1.0
    while not reached(high):
        high *= 2
        if high > _LARGEST:
            raise np.linalg.LinAlgError("no controller keeps any norm")
    low = high / 2
    while low > _SMALLEST and reached(low):
        low, high = low / 2, low
    while high / low > 1 + _TOLERANCE:
        middle = sqrt(low * high)
        low, high = (low, middle) if reached(middle) else (middle, high)
    return high


def central(plant: GeneralisedPlant, level: float) -> StateSpace:
    """The central controller from y to u that keeps the H-infinity norm from w to z below a level.

    Raises:
        numpy.linalg.LinAlgError: where no controller does.
    """
    cost, noise = plant.d12.T @ plant.d12, plant.d21 @ plant.d21.T
    x = _stabilising(plant.a, plant.b2, plant.c1.T @ plant.c1, cost, plant.b1 / level)
    y = _stabilising(plant.a.T, plant.c2.T, plant.b1 @ plant.b1.T, noise, plant.c1.T / level)
    coupled = y @ x / level**2
    if np.abs(np.linalg.eigvals(coupled)).max() >= 1:
        raise np.linalg.LinAlgError("the two equations do not go together at this level")
    k = np.linalg.solve(cost, plant.b2.T @ x)
    f = np.linalg.solve(np.eye(len(x)) - coupled, np.linalg.solve(noise, plant.c2 @ y).T)
    inside = plant.a + plant.b1 @ plant.b1.T @ x / level**2 - plant.b2 @ k - f @ plant.c2
    return StateSpace(inside, f, -k, np.zeros((plant.b2.shape[1], plant.c2.shape[0])))


_INDEFINITE = 1e-9
"""Least eigenvalue of a solution over its largest, from which it counts as one that is nowhere negative."""


def _stabilising(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray, worst: np.ndarray) -> np.ndarray:
    """The solution x, nowhere negative, of a'x + xa + q - x (b inv(r) b' - worst worst') x = 0 that stabilises."""
    if not worst.any():
        return np.asarray(solve_continuous_are(a, b, q, r))
    both, weights = np.hstack([worst, b]), block_diag(-np.eye(worst.shape[1]), r)
    x = np.asarray(solve_continuous_are(a, both, q, weights))
    values = np.linalg.eigvalsh(x)
    if values[0] < -_INDEFINITE * values[-1]:
        raise np.linalg.LinAlgError("the solution is negative somewhere")
    return x


def sensed_model(
    rig: LinearModel, outer_end_mass: float, inner_end_mass: float, sensors: Sequence[Sensed] = SENSED[:1]
) -> StateSpace:
    """State space of a rig with its sensors at one pair of end masses, SI.

    Args:
        rig: of a prototype, or of one of its linear members.
        outer_end_mass: kg.
        inner_end_mass: kg.
        sensors: of `beamdesign.controllers.SENSORS`, the displacement first.

    Returns:
        From tip force (N) and current (A) to the tip's displacement (m) and what the p sensors give (V, m, Pa).

    Raises:
        ValueError: without the displacement in the first place.
    """
    a, b, c = rig.matrices(outer_end_mass, inner_end_mass)
    if not sensors or sensors[0] != SENSED[0]:
        raise ValueError("the first sensor is that of the outer tip's displacement")
    outputs = c[[0, 1, *(SEEN_AS[name] for name in sensors[1:])]]
    return StateSpace(a, b, outputs, np.zeros((len(outputs), b.shape[1])))


TIME_UNIT_S = 0.01

_ROLL_OFF_DAMPING = 0.7


@dataclass(frozen=True)
class ScaledPlant:
    """A stable plant in units in which everything is of order one, balanced.

    Attributes:
        model: from a newton and a unit of current to the displacement over what the goal allows per newton and the p
            sensors, in their units.
        time_unit_s: unit of time, s.
        current_A: unit of current.
        sensor_units: (p,) of the sensors, V, m and Pa.
    """

    model: StateSpace
    time_unit_s: float
    current_A: float
    sensor_units: np.ndarray


def scaled_plant(plant: StateSpace, compliance_m_per_N: float, pace: float = 1.0) -> ScaledPlant:
    """Scale a plant so many times as quick as the published one; the goal's compliance is the unit of displacement.

    Raises:
        ValueError: for a plant that is not stable.
    """
    time = TIME_UNIT_S / pace
    at = plant.at(np.array([1j / time]))[0]
    current = float(abs(at[0, 0] / at[0, 1]))
    # A sensor's unit is what a newton moves it by while the current holds the tip still.
    held = np.abs(at[1:, 0] - at[1:, 1] * at[0, 0] / at[0, 1])
    held[0] = abs(at[1, 1] / at[0, 1]) * compliance_m_per_N
    b = time * plant.b * [1.0, current]
    c = plant.c / np.append(compliance_m_per_N, held)[:, None]
    whole = StateSpace(time * plant.a, b, c, np.zeros((len(c), 2)))
    return ScaledPlant(residualised(whole, len(whole.a)), time, current, held)


@dataclass(frozen=True)
class Weights:
    """What the synthesis trades, in the units of `ScaledPlant`.

    Attributes:
        corner: natural frequency, rad per unit of time, of the low-pass of second order that colours the force.
        damping: its damping ratio; a small one asks for most at the edge of the band.
        roll_off: likewise of the low-pass of second order that the current goes through.
        current: displacement that a unit of current before its roll-off is worth.
        noise: intensity of the displacement sensor's noise.
        recovery: of a white noise on the current.
        white: of a white force beside the coloured one.
        other_noise: intensity of the noise of every other sensor.
    """

    corner: float
    damping: float
    roll_off: float
    current: float
    noise: float
    recovery: float
    white: float
    other_noise: float


def weighted(plant: ScaledPlant, weights: Weights) -> GeneralisedPlant:
    """The plant with the models of the force and the roll-off: four more states.

    w is coloured force, white force, noise on the current and noises of the sensors; z displacement and current; y is
    minus what the sensors give.
    """
    g, corner = plant.model, weights.corner
    n, p = len(g.a), len(g.c) - 1
    force, colour, filtered = slice(n, n + 1), n + 1, slice(n + 2, n + 4)
    a = np.zeros((n + 4, n + 4))
    a[:n, :n], a[:n, force] = g.a, g.b[:, :1]
    a[n, colour], a[colour, n], a[colour, colour] = corner, -corner, -2 * weights.damping * corner
    low_pass = _roll_off(weights)
    a[filtered, filtered], a[:n, filtered] = low_pass.a, g.b[:, 1:] @ low_pass.c
    b1, b2 = np.zeros((n + 4, 3 + p)), np.zeros((n + 4, 1))
    b1[colour, 0] = corner
    b1[:n, 1], b1[:n, 2], b2[filtered] = weights.white * g.b[:, 0], weights.recovery * g.b[:, 1], low_pass.b
    c1, c2 = np.zeros((2, n + 4)), np.zeros((p, n + 4))
    c1[0, :n], c2[:, :n] = g.c[0], -g.c[1:]
    noise = np.diag([weights.noise, *[weights.other_noise] * (p - 1)])
    d12, d21 = np.array([[0.0], [weights.current]]), np.hstack([np.zeros((p, 3)), noise])
    return GeneralisedPlant(a, b1, b2, c1, c2, d12, d21)


def _roll_off(weights: Weights) -> StateSpace:
    w = weights.roll_off
    a, b = np.array([[0.0, w], [-w, -2 * _ROLL_OFF_DAMPING * w]]), np.array([[0.0], [w]])
    return StateSpace(a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1)))


def realised(plant: ScaledPlant, weights: Weights, law: StateSpace, order: int) -> StateSpace:
    """The law with its roll-off, reduced to an order, in SI: from error volts, -m and -Pa to amperes.

    Raises:
        ValueError: for a law that is not stable.
    """
    model = residualised(_roll_off(weights).behind(law), order)
    b, d = model.b / plant.sensor_units / plant.time_unit_s, model.d * plant.current_A / plant.sensor_units
    return StateSpace(model.a / plant.time_unit_s, b, model.c * plant.current_A, d)


def residualised(whole: StateSpace, order: int) -> StateSpace:
    """The balanced residualisation of a stable model.

    Args:
        whole: stable and minimal.
        order: states to keep; the whole comes back balanced where it has no more.

    Raises:
        ValueError: for a model that is not stable.
        numpy.linalg.LinAlgError: where it is too far from minimal for the figures of a float.
    """
    if not whole.stable:
        raise ValueError("only a stable controller is reduced")
    controllable = _root(solve_continuous_lyapunov(whole.a, -whole.b @ whole.b.T))
    observable = _root(solve_continuous_lyapunov(whole.a.T, -whole.c.T @ whole.c))
    left, hankel, right = svd(observable.T @ controllable)
    if hankel[0] <= 0:
        raise np.linalg.LinAlgError("the controller does nothing")
    kept = hankel > 1e-13 * hankel[0]
    root = np.sqrt(hankel[kept])
    into = controllable @ right.T[:, kept] / root
    back = (observable @ left[:, kept] / root).T
    a, b, c = back @ whole.a @ into, back @ whole.b, whole.c @ into
    n = min(order, len(a))
    fast = np.linalg.solve(a[n:, n:], np.hstack([a[n:, :n], b[n:]])) if n < len(a) else np.zeros((0, n + b.shape[1]))
    return StateSpace(
        a[:n, :n] - a[:n, n:] @ fast[:, :n],
        b[:n] - a[:n, n:] @ fast[:, n:],
        c[:, :n] - c[:, n:] @ fast[:, :n],
        whole.d - c[:, n:] @ fast[:, n:],
    )


def _root(gramian: np.ndarray) -> np.ndarray:
    """Root r with r r' the Gramian, lifted by the rounding errors of a float where it is not definite."""
    symmetric = (gramian + gramian.T) / 2
    try:
        return np.asarray(cholesky(symmetric, lower=True))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(symmetric)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
