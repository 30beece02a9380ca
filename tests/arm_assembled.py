"""The arm assembled by hand in numpy, to judge what the package has proved; only its records are shared with it.

Tip motions u_y and u_z, twist, two inner tips, two cylinders, two valves and two controllers, with the payload as a
point mass on a rigid lever.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from beamdesign import Prototype
from beamdesign.controllers import Lag

LENGTH_M, SHEAR_PA, DENSITY_KG_PER_M3 = 1.195, 27e9, 2700.0


def tube(width: float, wall: float) -> tuple[float, float]:
    """Second moment about one axis and Bredt's torsion constant with the wall's own, sharp corners, m4."""
    side = width - wall
    return (width**4 - (width - 2 * wall) ** 4) / 12, side**3 * wall + 4 * side * wall**3 / 3


@dataclass(frozen=True)
class Assembled:
    """x' = A x + B F, with F the force on the payload's centre in x, y, z.

    Attributes:
        a: (n, n).
        b: (n, 3).
        motion: (4, n), motion of the payload's centre in x, y, z and twist.
        passive: (n, n), A with no current in either valve.
        opened: (n, n), A with the controller of the plane z cut off at its valve.
        valve: (n,), how a current in the valve of the plane z enters.
        current: (n,), the current that the controller of the plane z asks for.
    """

    a: np.ndarray
    b: np.ndarray
    motion: np.ndarray
    passive: np.ndarray
    opened: np.ndarray
    valve: np.ndarray
    current: np.ndarray


def assemble(
    rig: Prototype,
    payload: float,
    offset: tuple[float, float, float],
    end_inertia: float,
    pressure_A_per_Pa: float = 0.0,
) -> Assembled:
    """Put the arm of the published tubes together; load pressure takes this much from each current."""
    second, constant = tube(0.140, 0.0023)
    twist_stiffness = SHEAR_PA * constant / LENGTH_M
    inertia = end_inertia + DENSITY_KG_PER_M3 * 2 * second * LENGTH_M / 3
    outer, inner = rig.outer_beam, rig.inner_beam
    k, m = outer.stiffness_N_per_m, outer.effective_mass_kg
    ki, mi = inner.stiffness_N_per_m, inner.effective_mass_kg
    assert k is not None
    assert m is not None
    assert ki is not None
    assert mi is not None
    zeta = outer.damping_ratio
    x, y, z = offset
    # Rotation of the end, theta = (phi, -3 u_z / 2L, 3 u_y / 2L), takes the payload by theta x offset.
    turn = 3 / (2 * LENGTH_M)
    motion = np.array([[-turn * y, -turn * z, 0.0], [1 + turn * x, 0.0, -z], [0.0, 1 + turn * x, y]])
    mass = np.diag([m, m, inertia]) + payload * motion.T @ motion
    stiffness = np.diag([k, k, twist_stiffness])
    damping = np.diag([2 * zeta * sqrt(k * m), 2 * zeta * sqrt(k * m), 2 * zeta * sqrt(twist_stiffness * inertia)])
    arm = rig.arm
    at = (0.0, 0.0, 0.0) if arm is None or arm.sensor_m is None else arm.sensor_m
    seen = np.array([[1 + turn * at[0], 0.0, -at[2]], [0.0, 1 + turn * at[0], at[1]]])
    laws = [rig.controller if arm is None or arm.second_controller is None else arm.second_controller, rig.controller]
    oil, area = rig.actuator.oil_stiffness_N_per_m, rig.actuator.piston_area_m2
    valve, sensor = rig.servovalve, rig.sensor
    w = 2 * pi * valve.natural_frequency_Hz
    n_plane = 6  # inner tip, its speed, cylinder, flow, flow's rate, controller
    n = 6 + 2 * n_plane
    a, b = np.zeros((n, n)), np.zeros((n, 3))
    a[:3, 3:6] = np.eye(3)
    solve = np.linalg.inv(mass)
    a[3:6, :3], a[3:6, 3:6] = -solve @ stiffness, -solve @ damping
    b[3:6] = solve @ motion.T
    total_inner = mi + rig.payload.inner_end_mass_kg
    drives = {}
    for axis, law in enumerate(laws):
        assert isinstance(law, Lag)
        f, v, c, q, r, h = range(6 + axis * n_plane, 6 + (axis + 1) * n_plane)
        force = np.zeros(n)
        force[[c, axis]] = oil, -oil
        a[3:6] += np.outer(solve[:, axis], force)
        a[f, v] = 1.0
        a[v] -= force / total_inner
        a[v, f] -= ki / total_inner
        a[v, v] -= 2 * inner.damping_ratio * sqrt(ki * mi) / total_inner
        a[c, v], a[c, q] = 1.0, 1 / area
        a[c] -= valve.leakage_m3_per_s_per_Pa / area**2 * force
        a[q, r] = 1.0
        a[r, [q, r]] = -(w**2), -2 * valve.damping_ratio * w
        slow, ratio = 2 * pi * law.pole_Hz, law.pole_Hz / law.zero_Hz
        error = np.zeros(n)
        error[:3] = -sensor.gain_V_per_m * seen[axis]
        a[h] = slow * error
        a[h, h] -= slow
        current = law.gain_A_per_V * ratio * error - pressure_A_per_Pa / area * force
        current[h] += law.gain_A_per_V * (1 - ratio)
        entry = np.zeros(n)
        entry[r] = w**2 * valve.flow_gain_m3_per_s_per_A
        drives[axis] = entry, current
    closed = a + sum(np.outer(entry, current) for entry, current in drives.values())
    opened = a + np.outer(*drives[0])
    there = np.zeros((4, n))
    there[:3, :3], there[3, 2] = motion, 1.0
    return Assembled(closed, b, there, a, opened, *drives[1])
