"""Bending modes of the true rig's beams: those of a cantilever by finite elements, counted at its tip."""

import numpy as np
from scipy.linalg import eigh

HIGHEST_RATE = 2 * np.pi * 2500
"""rad/s; modes above it are left out, since they neither move nor fit into the steps of the simulation."""


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
    at_tip = shapes[-2] ** 2  # shapes have unit modal mass
    return np.array([np.sqrt(squares), squares / at_tip, 1 / at_tip])


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
