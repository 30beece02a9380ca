"""Whether what a certificate of one plane of an arm states is true: a model in floats, which no checker shares.

The end of the outer beam moves by u and twists by phi; a payload stands off it on a rigid lever (as in `stated_rig`,
grids refute and do not prove).
"""

from collections.abc import Iterator
from math import inf, pi, sqrt
from typing import Any

import numpy as np
from stated_rig import (
    StatedRig,
    Table,
    Verdict,
    below,
    frequencies,
    grid,
    listed,
    near,
    number,
    numbers,
    pair,
    repeats,
    stable,
    together,
)

CLAIMS = ("tip_compliance", "load_compliance", "peak_sensitivity", "loop_gain", "controller_effort")


def true(table: dict[str, Any]) -> Verdict:
    """Whether what a certificate states is true; None where that is too close to call.

    Raises:
        Exception: of some kind, for a table that is not of the format.
    """
    if table["kind"] != "beamdesign.arm_plane":
        raise ValueError("of another kind")
    return together(_statements(table))


def _statements(table: Table) -> Iterator[Verdict]:
    yield from repeats(table)
    plane, masses = Plane(table), pair(table["outer_end_mass_kg"])
    yield from plane.torsion_follows(table)
    second = table.get("arm", {}).get("second_controller")
    if second is not None and plane.name == "y":
        yield _figures(second) == _figures({k: v for k, v in table["controller"].items() if k != "law"})
    yield from listed(plane.poles, table["stability"], *masses)
    for claim in table.get("claim", []):
        yield plane.claimed(claim, grid(*masses))


def _figures(value: Any) -> Any:
    """A controller's table with its numbers by their value."""
    if isinstance(value, dict):
        return {key: item if key in ("kind", "sensors") else _figures(item) for key, item in value.items()}
    return [_figures(item) for item in value] if isinstance(value, list) else number(value)


class Plane:
    """The loop of one plane."""

    def __init__(self, table: Table) -> None:
        self.rig, plane, arm = StatedRig(table), table["plane"], table.get("arm", {})
        self.name, length = plane["name"], number(plane["free_length_m"])
        (x, y, z), (sx, sy, sz) = (numbers(arm.get(key, ["0"] * 3)) for key in ("offset_m", "sensor_m"))
        turn = 1.5 / length
        in_plane, lever, self.seen = {"y": (y, -z, (1 + turn * sx, -sz)), "z": (z, y, (1 + turn * sx, sy))}[self.name]
        if length <= 0 or (in_plane != 0 and lever != 0):
            raise ValueError("no plane")
        self.load, self.along = np.array([1 + turn * x, lever]), turn * in_plane
        stiffness = self.rig.figure["outer_stiffness_N_per_m"]
        # What a held end gives way by under the moment of a force, M L / 4 E I with E I = K L^3 / 3, at the lever x.
        self.rest, self.seen_rest = (3 * x * at / (4 * stiffness * length**2) for at in (x, sx))
        self.torsion = None
        if lever != 0:
            keys = ("stiffness_N_m_per_rad", "damping_N_m_s_per_rad", "polar_inertia_kg_m2")
            self.torsion = [number(plane["torsion"][key]) for key in keys]
        elif "torsion" in plane or "section" in plane:
            raise ValueError("torsion has no part")

    def torsion_follows(self, table: Table) -> Iterator[Verdict]:
        """That torsion is that of a square tube, or given (Bredt; EN 10219-2:2006, Annex B)."""
        if self.torsion is None:
            return
        arm, section, figure = table["arm"], table["plane"].get("section"), self.rig.figure
        inertia = sum(number(arm.get(f"{which}_polar_inertia_kg_m2", "0")) for which in ("end", "payload"))
        length, computed = number(table["plane"]["free_length_m"]), None
        if section is not None:
            width, wall, radius = (number(section[f"{key}_m"]) for key in ("width", "wall", "corner_radius"))
            alloy = table["material"][section["material"]]
            if not 0 < 2 * wall < width or not 0 <= 2 * radius <= width:
                raise ValueError("no tube")
            polar = 2 * (_second_moment(width, radius) - _second_moment(width - 2 * wall, max(radius - wall, 0.0)))
            inertia += number(alloy["density_kg_per_m3"]) * polar * length / 3
            side, turn = width - wall, max(radius - wall / 2, 0.0)
            area, around = side**2 - (4 - pi) * turn**2, 4 * side - (8 - 2 * pi) * turn
            constant = 4 * area**2 * wall / around + around * wall**3 / 3
            computed = number(alloy["shear_modulus_Pa"]) * constant / length
        given = arm.get("torsional_stiffness_N_m_per_rad")
        expected = computed if given is None else number(given)
        yield False if expected is None else near(self.torsion[0], expected)
        bending = 2 * sqrt(figure["outer_stiffness_N_per_m"] * figure["outer_mass_kg"])
        ratio = number(arm.get("torsional_damping_ratio", "0")) or figure["outer_damping_N_s_per_m"] / bending
        yield near(self.torsion[2], inertia)
        yield near(self.torsion[1], 2 * ratio * sqrt(self.torsion[0] * self.torsion[2]))

    def poles(self, mass: float) -> np.ndarray:
        """Of the closed loop with a payload, rad/s."""
        figure = self.rig.figure
        bending = (figure[f"outer_{of}"] for of in ("stiffness_N_per_m", "damping_N_s_per_m", "mass_kg"))
        n = 1 if self.torsion is None else 2
        matrices = [np.diag([own, twist][:n]) for own, twist in zip(bending, self.torsion or [1.0] * 3, strict=True)]
        matrices[2] = matrices[2] + mass * self._carried()[:n, :n]
        return self.rig.poles((matrices[0], matrices[1], matrices[2]), self.seen[:n])

    def _carried(self) -> np.ndarray:
        """Inertia of 1 kg at the payload's centre."""
        return np.outer(self.load, self.load) + np.diag([self.along**2, 0.0])

    def magnitudes(self, kind: str, mass: float, w: np.ndarray) -> np.ndarray:
        """What a claim bounds, at frequencies in rad/s."""
        s = 1j * w
        servo, none = self.rig.servo(s), np.zeros_like(s)
        twist = np.ones_like(s) if self.torsion is None else np.polynomial.polynomial.polyval(s, self.torsion)
        passive = np.array([[self.rig.beam(s), none], [none, twist]]) + mass * self._carried()[:, :, None] * s**2
        passive = passive.transpose(2, 0, 1)
        seen, load, tip = np.array(self.seen), self.load, np.array([1.0, 0.0])
        if kind.endswith("compliance"):
            closed = passive.copy()
            closed[:, 0] += servo.displaced[:, None] * seen + servo.moved[:, None] * tip
            push = np.broadcast_to(tip if kind == "tip_compliance" else load, (len(s), 2)).astype(complex)
            if kind == "tip_compliance":
                return np.abs(np.linalg.solve(closed, push[:, :, None])[:, 0, 0])
            push = push - servo.displaced[:, None] * self.seen_rest * tip
            return np.abs(np.linalg.solve(closed, push[:, :, None])[:, :, 0] @ load + self.rest)
        by_force = np.linalg.solve(passive, np.broadcast_to(tip[:, None], (len(s), 2, 1)).astype(complex))[:, :, 0]
        loop = (servo.around * (by_force @ seen) + servo.added) / (1 / servo.alone + by_force @ tip)
        values = {"peak_sensitivity": 1 / (1 + loop), "loop_gain": loop, "controller_effort": servo.law / (1 + loop)}
        return np.abs(values[kind])

    def claimed(self, claim: Table, masses: np.ndarray) -> Verdict:
        """One claim, at every point of a grid; a refuted one is false where it holds by far."""
        kind, limit, start, end = claim["kind"], number(claim["limit"]), 0.0, inf
        if kind not in CLAIMS or limit <= 0 or "witness" in claim:
            raise ValueError("no claim")
        if kind.endswith("compliance") and claim["bandwidth_Hz"] != "infinite":
            end = 2 * pi * number(claim["bandwidth_Hz"])
        if kind == "loop_gain":
            start = 2 * pi * number(claim["from_Hz"])
        poles = [self.poles(mass) for mass in masses]
        kept = together(stable(each) for each in poles)
        worst = max(
            self.magnitudes(kind, mass, frequencies(each, start, end)).max()
            for mass, each in zip(masses, poles, strict=True)
        )
        if claim["holds"]:
            return together([kept, below(worst, limit)])
        return False if kept and worst < 0.99 * limit else True if kept is False or worst > limit * 1.000001 else None


def _second_moment(side: float, radius: float) -> float:
    """Of a square with rounded corners about its middle: a cross of two rectangles, and four quarter discs."""
    straight = side - 2 * radius
    cross = straight * side**3 / 12 + 2 * radius * straight**3 / 12
    centroid = 4 * radius / (3 * pi)
    disc = pi * radius**2 / 4
    own = pi * radius**4 / 16 - disc * centroid**2
    return cross + 4 * (own + disc * (straight / 2 + centroid) ** 2)
