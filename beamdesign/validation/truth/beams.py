"""Modes of the true rig's beams, bending and twist, by finite elements, and how places on the outer one's end move."""

import numpy as np
from scipy.linalg import eigh

HIGHEST_RATE = 2 * np.pi * 2500
"""rad/s; modes above it are left out, since they neither move nor fit into the steps of the simulation."""


AT_TIP, WATCHED, PAYLOAD, ALONG = 3, 4, 5, 6
"""Rows of `at_end`: motion, per motion of a mode, of the tip on the axis, of what the sensor watches and of the
payload, all across the beam in its plane, and of the payload along the beam."""


def at_end(
    modes: np.ndarray, watched: np.ndarray | float = 1.0, payload: np.ndarray | float = 1.0,
    along: np.ndarray | float = 0.0, of_tip: np.ndarray | float = 1.0,
) -> np.ndarray:  # fmt: skip
    """(7, n) stiffness, mass and damping of modes, then how the tip and other places move with each.

    Args:
        modes: (3, n).
        watched: what the sensor watches; as the tip where nothing else is said, like the payload.
        payload: across the beam.
        along: the payload along the beam.
        of_tip: the tip.
    """
    places = (np.broadcast_to(place, modes.shape[1]) for place in (of_tip, watched, payload, along))
    return np.array([*modes, *places])


def cantilever_modes(
    rigidity: np.ndarray, mass_per_length: np.ndarray, length_m: float, lumps: dict[int, float], count: int
) -> np.ndarray:
    """Modes of an Euler-Bernoulli cantilever of cubic elements of equal length (consistent masses), lowest first.

    Args:
        rigidity: (n,) E I of each element from the clamp, N m2.
        mass_per_length: (n,) kg/m.
        length_m: of the whole.
        lumps: mass in kg by node, 1 to n (the tip).
        count: how many modes.

    Returns:
        (3, count) frequency (rad/s), stiffness (N/m, each mode alone pressed at the tip) and mass (kg) of each.
    """
    squares, shapes = _bending(rigidity, mass_per_length, length_m, lumps, count)
    at_tip = shapes[-2] ** 2  # shapes have unit modal mass
    return np.array([np.sqrt(squares), squares / at_tip, 1 / at_tip])


def tip_slope(tip_share: float) -> float:
    """Slope of the tip of a uniform cantilever in its first mode, times its length, over the tip's motion.

    Args:
        tip_share: mass fixed to the tip over that of the beam.
    """
    elements = 16
    _, shapes = _bending(np.ones(elements), np.ones(elements), 1.0, {elements: tip_share}, 1)
    return float(shapes[-1, 0] / shapes[-2, 0])


def _bending(
    rigidity: np.ndarray, mass_per_length: np.ndarray, length_m: float, lumps: dict[int, float], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """(count,) squares of frequencies and (2 n, count) shapes of unit modal mass: motion and slope of every node."""
    elements, h = len(rigidity), length_m / len(rigidity)
    stiffness, mass = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    bending = np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
         [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]
    ) / h**3  # fmt: skip
    inertia = np.array(
        [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
         [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
    ) * h / 420  # fmt: skip
    for e in range(elements):
        own = slice(2 * e, 2 * e + 4)
        stiffness[own, own] += rigidity[e] * bending
        mass[own, own] += mass_per_length[e] * inertia
    for node, lump in lumps.items():
        mass[2 * node, 2 * node] += lump
    squares, shapes = eigh(stiffness[2:, 2:], mass[2:, 2:], subset_by_index=[0, count - 1])
    return squares, shapes


def twist_modes(stiffness: float, polar_inertia: float, end_inertia: float, zeta: float) -> np.ndarray:
    """(3, 2) stiffness, inertia and damping of the twist of a clamped tube's end, by elements that twist evenly.

    The first mode is itself; all others together are as soft as they are, so that the end held by a steady moment
    twists as the whole tube does, and move as the second.

    Args:
        stiffness: G J / L, N m/rad.
        polar_inertia: of the tube about its axis, kg m2.
        end_inertia: of what is fixed to its end, kg m2.
        zeta: damping ratio of either.
    """
    elements = 24
    k, m = np.zeros((2, elements + 1, elements + 1))
    for e in range(elements):
        own = slice(e, e + 2)
        k[own, own] += elements * np.array([[1.0, -1.0], [-1.0, 1.0]])
        m[own, own] += polar_inertia / (6 * elements) * np.array([[2.0, 1.0], [1.0, 2.0]])
    m[-1, -1] += end_inertia
    squares, shapes = eigh(stiffness * k[1:, 1:], m[1:, 1:])
    soft = shapes[-1] ** 2 / squares
    held = 1 / np.array([soft[0], soft[1:].sum()])
    inertia = held / squares[:2]
    return np.array([held, inertia, 2 * zeta * np.sqrt(held * inertia)])


def outer_modes(
    stiffness: float, mass: float, damping: float, softness: float = 0.0, joint_mass: float = 0.0,
    tip_share: float = 0.0, zeta: float = 0.01, count: float = 1,
) -> np.ndarray:  # fmt: skip
    """(3, n) stiffness, mass and damping of an outer beam whose first mode at the tip has the figures given.

    A bolted joint a little beyond the middle makes it softer there and heavier: the softer, the lower the second mode
    and the more it gives at the tip.

    Args:
        stiffness: of the first mode, N/m.
        mass: of the first mode, kg.
        damping: of the first mode, N s/m.
        softness: rigidity of the tube over that at the joint, less one.
        joint_mass: over the mass of the tube.
        tip_share: mass fixed to the tip over that of the tube.
        zeta: damping ratio of the higher modes.
        count: how many modes at most.
    """
    elements = 16
    rigidity = np.ones(elements)
    rigidity[9:11] = 1 / (1 + softness)
    found = cantilever_modes(rigidity, np.ones(elements), 1.0, {10: joint_mass, elements: tip_share}, int(count))
    first = np.sqrt(stiffness / mass)
    _, own_k, own_m = found[:, found[0] / found[0, 0] * first < HIGHEST_RATE]
    scaled_k, scaled_m = own_k * stiffness / own_k[0], own_m * mass / own_m[0]
    losses = 2 * zeta * np.sqrt(scaled_k * scaled_m)
    losses[0] = damping
    return np.array([scaled_k, scaled_m, losses])
