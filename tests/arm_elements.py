"""A cantilever in bending both ways and torsion by finite elements, with a payload on a rigid lever at its end."""

import numpy as np


def matrices(
    count: int, length: float, rigidity: float, twist: float, per_length: float, polar: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a clamped beam; per node u_y, u_z, phi, theta_y, theta_z, the clamped node left out.

    Hermite's cubic in bending, linear in torsion; e.g. Przemieniecki, Theory of Matrix Structural Analysis (1968).

    Args:
        count: elements.
        length: of the beam, m.
        rigidity: E I, N m2.
        twist: G J, N m2.
        per_length: mass, kg/m.
        polar: polar inertia per length, kg m.
    """
    h = length / count
    k = rigidity / h**3 * np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
         [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]
    )  # fmt: skip
    m = per_length * h / 420 * np.array(
        [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
         [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
    )  # fmt: skip
    n = 5 * (count + 1)
    stiffness, mass = np.zeros((n, n)), np.zeros((n, n))
    for e in range(count):
        first, second = 5 * e, 5 * (e + 1)
        in_y = [first + 0, first + 4, second + 0, second + 4]
        in_z = [first + 1, first + 3, second + 1, second + 3]
        slope = np.array([1.0, -1.0, 1.0, -1.0])  # theta_y = -u_z'
        stiffness[np.ix_(in_y, in_y)] += k
        mass[np.ix_(in_y, in_y)] += m
        stiffness[np.ix_(in_z, in_z)] += slope[:, None] * k * slope
        mass[np.ix_(in_z, in_z)] += slope[:, None] * m * slope
        in_twist = [first + 2, second + 2]
        stiffness[np.ix_(in_twist, in_twist)] += twist / h * np.array([[1, -1], [-1, 1]])
        mass[np.ix_(in_twist, in_twist)] += polar * h / 6 * np.array([[2, 1], [1, 2]])
    return stiffness[5:, 5:], mass[5:, 5:]


def lever(offset: tuple[float, float, float]) -> np.ndarray:
    """Motion in x, y, z of a point fixed to the end, per u_y, u_z, phi, theta_y, theta_z of the end, (3, 5)."""
    x, y, z = offset
    return np.array([[0, 0, 0, z, -y], [1, 0, -z, 0, x], [0, 1, y, -x, 0]], dtype=float)
