"""Static compliance of the arm at its tip and at the payload, with the servos and without.

Forces and displacements in the order x, y, z, then moments and rotations about them, SI. A rotation is small and turns
a point at the lever a by theta x a.
"""

from dataclasses import dataclass

import numpy as np

from beamdesign.arm.figures import ArmFigures

_ACTUATED = (1, 2)  # y and z


def tip_compliance(figures: ArmFigures) -> np.ndarray:
    """Displacements and rotations (6,) of the tip per force and moment on it, (6, 6), the outer beam alone.

    The cantilever's end deflections and slopes, e.g. Roark's Formulas for Stress and Strain, 7th edition, table 8.1,
    cases 1a and 3a: P L^3 / 3EI and P L^2 / 2EI, M L^2 / 2EI and M L / EI; twist T L / GJ.
    """
    length, rigidity = figures.length, figures.bending_rigidity
    deflection, mixed, slope = length**3 / (3 * rigidity), length**2 / (2 * rigidity), length / rigidity
    matrix = np.zeros((6, 6))
    matrix[0, 0] = 0.0 if figures.axial_stiffness is None else 1 / figures.axial_stiffness
    matrix[1, 1] = matrix[2, 2] = deflection
    matrix[3, 3] = 1 / figures.torsional_stiffness
    matrix[4, 4] = matrix[5, 5] = slope
    matrix[1, 5] = matrix[5, 1] = mixed
    matrix[2, 4] = matrix[4, 2] = -mixed  # a slope upwards turns about -y
    return matrix


def cross(lever: tuple[float, float, float]) -> np.ndarray:
    """Matrix (3, 3) of a x: a force F at the lever a has the moment a x F about the tip."""
    x, y, z = lever
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def carried(lever: tuple[float, float, float]) -> np.ndarray:
    """Matrix (6, 6) from force and moment at the lever to those at the tip; its transpose takes motions back."""
    matrix = np.eye(6)
    matrix[3:, :3] = cross(lever)
    return matrix


def at_point(compliance: np.ndarray, lever: tuple[float, float, float]) -> np.ndarray:
    """Compliance (6, 6) at a point fixed to the tip, from that at the tip."""
    there = carried(lever)
    return there.T @ compliance @ there


@dataclass(frozen=True)
class Held:
    """The tip with both servos.

    Attributes:
        compliance: (6, 6) at the tip.
        actuators: forces (2, 6) of the actuators in y and z on the outer tip per force and moment on it.
    """

    compliance: np.ndarray
    actuators: np.ndarray


def held(
    compliance: np.ndarray, closed: tuple[float, float], sensor: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Held:
    """Add the servos in y and z: forces on the tip against the displacement that they measure.

    Args:
        compliance: (6, 6) of the tip without servos.
        closed: static compliance x / F_d of the loop in y and z that is closed at the tip, m/N; zero holds it still.
        sensor: where they measure, from the tip, m. Anywhere else the compliance is no longer symmetric.
    """
    own = np.array([compliance[i, i] for i in _ACTUATED])
    spring = np.array(closed) * own / (own - np.array(closed))  # the servo's own compliance, beside the beam's
    chosen = compliance[:, list(_ACTUATED)]
    measured = carried(sensor).T[list(_ACTUATED)]
    actuators = -np.linalg.solve(measured @ chosen + np.diag(spring), measured @ compliance)
    return Held(compliance + chosen @ actuators, actuators)
