"""What error a steady load leaves: the tip's own motion, the end that turns, and twist, with the servos and without.

Forces and displacements are in the order x, y, z, then moments and rotations about them, SI. A rotation is small and
turns a point at the lever a by theta x a.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from beamdesign.plant.members import own_sag_m, weight_N
from beamdesign.prototype import Beam, Prototype
from beamdesign.structure.arm import ArmFigures, arm_figures, arm_of
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.section import Tube
from beamdesign.structure.shapes import FIT_M, gaps

# Static compliance at the tip and at the payload, with the servos and without.


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


def carried(lever: tuple[float, float, float]) -> np.ndarray:
    """Matrix (6, 6) from force and moment at the lever to those at the tip; its transpose takes motions back."""
    matrix = np.eye(6)
    matrix[3:, :3] = np.cross(np.eye(3), lever)  # a force F at the lever a has the moment a x F about the tip
    return matrix


def at_point(compliance: np.ndarray, lever: tuple[float, float, float]) -> np.ndarray:
    """Compliance (6, 6) at a point fixed to the tip, from that at the tip."""
    there = carried(lever)
    return there.T @ compliance @ there


def held(
    compliance: np.ndarray, closed: tuple[float, float], sensor: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Add the servos in y and z: forces on the tip against the displacement that they measure.

    Args:
        compliance: (6, 6) of the tip without servos.
        closed: static compliance x / F_d of the loop in y and z that is closed at the tip, m/N; zero holds it still.
        sensor: where they measure, from the tip, m. Anywhere else the compliance is no longer symmetric.

    Returns:
        compliance (6, 6) at the tip, and forces (2, 6) of the actuators in y and z on the outer tip per force and
        moment on it.
    """
    own = np.array([compliance[i, i] for i in _ACTUATED])
    spring = np.array(closed) * own / (own - np.array(closed))  # the servo's own compliance, beside the beam's
    chosen = compliance[:, list(_ACTUATED)]
    measured = carried(sensor).T[list(_ACTUATED)]
    actuators = -np.linalg.solve(measured @ chosen + np.diag(spring), measured @ compliance)
    return compliance + chosen @ actuators, actuators


# The error that remains.


Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Remaining:
    """Motions under one load, in x, y, z (and about them), SI.

    Attributes:
        tip_m: displacement of the tip, which is what the servos see and hold in y and z.
        rotation_rad: of the tip, about x (twist), y and z.
        from_turning_m: of the point that counts, because the end of the outer beam turns in bending.
        from_twist_m: of that point, because it twists.
        error_m: of that point, the sum of the three.
        actuators_N: forces of the actuators in y and z on the outer tip; zeros without servos.
    """

    tip_m: Vector
    rotation_rad: Vector
    from_turning_m: Vector
    from_twist_m: Vector
    error_m: Vector
    actuators_N: tuple[float, float]

    @property
    def size_m(self) -> float:
        """How far the point is off."""
        return float(np.linalg.norm(self.error_m))

    @property
    def causes_m(self) -> dict[str, Vector]:
        """What each cause alone moves the point by."""
        return {"tip": self.tip_m, "turning": self.from_turning_m, "twist": self.from_twist_m}

    @property
    def shares_m(self) -> dict[str, float]:
        """How far each cause alone moves the point; they are vectors, so that these need not add up."""
        return {name: float(np.linalg.norm(vector)) for name, vector in self.causes_m.items()}

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        return vars(self) | {"size_m": self.size_m, "shares_m": self.shares_m}


def remaining(
    figures: ArmFigures,
    force_N: Vector,
    payload: Vector,
    tool: Vector,
    closed: tuple[float, float] | None,
    sensor: Vector = (0.0, 0.0, 0.0),
) -> Remaining:
    """Work out the motions under a force on the payload's centre.

    Args:
        figures: of the outer beam.
        force_N: in x, y, z.
        payload: its centre from the tip, m.
        tool: the point that counts, m.
        closed: static compliance of the closed loops in y and z, m/N; None without servos.
        sensor: where the servos measure, from the tip, m.
    """
    load = carried(payload) @ np.array([*force_N, 0.0, 0.0, 0.0])
    compliance, actuators = tip_compliance(figures), np.zeros(2)
    if closed is not None:
        compliance, per_load = held(compliance, closed, sensor)
        actuators = per_load @ load
    motion = compliance @ load
    tip, turn = motion[:3], motion[3:]
    twist = np.array([turn[0], 0.0, 0.0])
    by_turning, by_twist = (np.cross(part, tool) for part in (turn - twist, twist))
    found = tip, turn, by_turning, by_twist, tip + by_turning + by_twist, actuators
    return Remaining(*(tuple(part.tolist()) for part in found))


@dataclass(frozen=True)
class InnerTravel:
    """How far the inner beam's tip gives way under both actuators.

    Attributes:
        travel_m: in y and z, m; along z with the weight of the link, which lies level.
        gap_m: between the tubes on each side, at rest; None where a section is not known.
        round: whether the outer tube is, so that it is the whole way that counts and not that to each side.
    """

    travel_m: tuple[float, float]
    gap_m: float | None
    round: bool = False

    @property
    def touches(self) -> bool:
        """Whether the tubes touch; of one with corners in a round one, whether they may."""
        way = hypot(*self.travel_m) if self.round else max(map(abs, self.travel_m))
        return self.gap_m is not None and way >= self.gap_m


def inner_travel(prototype: Prototype, case: Remaining) -> InnerTravel:
    """Travel of the inner tip under a load that the servos carry; the tube is as stiff in any direction.

    The link lies level: along z the servo carries the outer beam's own weight too, and the inner beam sags by its own.
    """
    stiffness = lumped_beam(prototype.inner_beam, "inner_beam").stiffness
    y, z = (-force / stiffness for force in case.actuators_N)
    z -= weight_N(prototype, 0.0) / stiffness + own_sag_m(prototype)
    gap = gaps(prototype.outer_beam, prototype.inner_beam)
    return InnerTravel((y, z), None if gap is None else gap[0], prototype.outer_beam.shape == "round")


@dataclass(frozen=True)
class TwistRemedy:
    """What would keep the twist's share of the error below a wanted figure: no servo can.

    Attributes:
        allowed_m: wanted.
        needed_N_m_per_rad: torsional stiffness G J / L that does it; zero where the load does not twist the beam.
        wall_m: wall of the outer tube that does it at its width; None where there is no section or none does.
        wall_added_kg: mass of the tube that it adds.
        wall_fits: whether the inner tube still fits.
        width_m: width that does it with the wall as it is.
        width_added_kg: mass that it adds.
        counterweight_kg_m: mass times distance, on the other side of the axis, that balances the largest payload's
            weight; it does nothing against other forces.
    """

    allowed_m: float
    needed_N_m_per_rad: float
    wall_m: float | None
    wall_added_kg: float | None
    wall_fits: bool | None
    width_m: float | None
    width_added_kg: float | None
    counterweight_kg_m: float


_WALL_SHARE = 0.1
"""Of the width: the thickest wall looked at, up to which the torsion constant is good to a few per cent."""

_WIDEST_M = 2.0


def twist_remedy(prototype: Prototype, force_N: Vector, allowed_m: float, payload_kg: float) -> TwistRemedy:
    """The section that keeps the twist's share of the error at an allowed figure, and the counterweight.

    Raises:
        InputError: as `arm_figures`.
    """
    figures, arm = arm_figures(prototype), arm_of(prototype)
    offset, tool = arm.offset_m, arm.tool_m or arm.offset_m
    torque = offset[1] * force_N[2] - offset[2] * force_N[1]
    needed = abs(torque) * hypot(tool[1], tool[2]) / allowed_m
    weight = payload_kg * hypot(offset[1], offset[2])
    beam, wall, width = prototype.outer_beam, None, None
    fits: bool | None = None
    thicker: float | None = None
    wider: float | None = None
    tube = beam.tube
    if tube is not None and beam.geometry is not None and needed > 0:
        # A given stiffness need not be the section's: what is asked for scales the section as it stands.
        target = needed / figures.torsional_stiffness * float(tube.torsion_constant)
        wall = _least(lambda value: tube.at(tube.width_m, value), target, tube.wall_m, _WALL_SHARE * tube.width_m)
        width = _least(lambda value: tube.at(value, tube.wall_m), target, tube.width_m, _WIDEST_M)
        if wall is not None:
            made = tube.at(tube.width_m, wall)
            thicker, gap = _added_mass(beam, made), gaps(made, prototype.inner_beam)
            fits = None if gap is None else gap[0] >= FIT_M / 2
        wider = None if width is None else _added_mass(beam, tube.at(width, tube.wall_m))
    return TwistRemedy(allowed_m, needed, wall, thicker, fits, width, wider, weight)


def _least(tube: Callable[[float], Tube], target: float, own: float, most: float) -> float | None:
    """The size from its own figure up at which the torsion constant has grown to a target."""
    from scipy.optimize import brentq

    if float(tube(own).torsion_constant) >= target:
        return own
    if float(tube(most).torsion_constant) < target:
        return None
    return float(brentq(lambda size: float(tube(size).torsion_constant) - target, own, most, xtol=1e-9))


def _added_mass(beam: Beam, made: Tube) -> float:
    """Of a tube over the beam's own, kg."""
    assert beam.tube is not None
    assert beam.material is not None
    length = float(beam.length_m or beam.free_length_m or 0.0)
    return beam.material.density_kg_per_m3 * float(made.area - beam.tube.area) * length


def offset_for_goal_m(prototype: Prototype) -> float:
    """The sideways offset at which twist alone takes up the goal's compliance at the payload: sqrt(c G J / L)."""
    return float((prototype.goal.compliance_m_per_N * arm_figures(prototype).torsional_stiffness) ** 0.5)
