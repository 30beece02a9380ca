"""The outer beam of a true rig as one plane of an arm: its tube, where payload and sensor stand on its end, its modes.

Across the beam in the plane, a place that stands ahead of the tip moves with the slope of the end as well, and one
beside the plane with its roll; a place off the axis in the plane is drawn along the beam as the end slopes. The slope
is that of the first bending mode of the tube with all that is fixed to its end, by elements; the roll that of the tube
in twist.

Both planes would be coupled by a payload off the axis to both sides, of which there is none. Weight is left out as on
the other rigs, and so are the rotation of a mount below the payload and its inertia against the slope of the end.
"""

from typing import Any

import numpy as np

from beamdesign.validation.truth.beams import at_end, tip_slope, twist_modes
from beamdesign.validation.truth.effects import Shape, rounded

Table = dict[str, Any]

ALLOY = {"youngs_modulus_Pa": 69e9, "shear_modulus_Pa": 26e9, "density_kg_per_m3": 2700.0, "proof_strength_Pa": 240e6}
_EFFECTIVE = 33 / 140
"""Of a bare beam's mass that counts at its tip (Rayleigh)."""
STATED = {
    "torsional_stiffness": ("arm", "torsional_stiffness_N_m_per_rad", "stiffness"),
    "torsional_damping_ratio": ("arm", "torsional_damping_ratio", "beam_damping_ratio"),
}
"""Figures of an arm that its builder vouches for as for those of bending."""


def tube_mass(beam: Table, density: float = ALLOY["density_kg_per_m3"]) -> float:
    """Of a square tube from clamp to tip, kg."""
    middle = beam["width_m"] - beam["wall_m"]
    return float(density * 4 * middle * beam["wall_m"] * beam["free_length_m"])


def end_module(beam: Table, tube: float) -> float:
    """What is fixed to the end of a tube of some mass, kg: what the effective mass has beyond the tube's own share."""
    return max(0.0, float(beam["effective_mass_kg"] - _EFFECTIVE * tube))


def with_arm(table: Table, rng: np.random.Generator) -> Table:
    """A believed rig, its outer beam a tube of the stiffness stated, with a payload on an arm, mostly off its axis.

    Args:
        table: a believed prototype with tips and nothing else.
        rng: drawn from.
    """
    beam = table["outer_beam"]
    length, wall = rounded(rng.uniform(0.95, 1.4)), rounded(rng.uniform(2e-3, 4e-3))
    second_moment = beam["stiffness_N_per_m"] * length**3 / (3 * ALLOY["youngs_modulus_Pa"])
    middle = (1.5 * second_moment / wall) ** (1 / 3)  # of four thin walls: I = 2 t b^3 / 3
    beam = beam | {"free_length_m": length, "wall_m": wall, "width_m": rounded(middle + wall), "material": "alloy"}
    module = end_module(beam, tube_mass(beam))
    # Bredt: J = 4 A^2 t / s of the walls' middle line; it was measured, and is that within some per cent.
    twisted = ALLOY["shear_modulus_Pa"] * wall * middle**3 / length * float(np.exp(rng.normal(0, 0.05)))
    ahead = rounded(rng.uniform(0.0, 0.12))
    side = rounded(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.04), np.log(0.3))))
    plane, stands = str(rng.choice(["y", "z"])), str(rng.choice(["beside", "beside", "beside", "in", "on"]))
    offset = [0.0, 0.0, 0.0]
    if stands != "on":
        offset[0] = ahead
        offset[1 if (stands == "beside") == (plane == "z") else 2] = side
    arm = {
        "plane": plane,
        "offset_m": offset,
        "end_polar_inertia_kg_m2": rounded(module * rng.uniform(0.04, 0.08) ** 2),
        "payload_polar_inertia_kg_m2": rounded(rng.uniform(0.0, 0.02)),
        "torsional_stiffness_N_m_per_rad": rounded(twisted),
        "torsional_damping_ratio": rounded(rng.uniform(0.01, 0.05), 2),
    }
    share = float(rng.uniform(0.3, 1.0))
    if rng.uniform() < 0.35 and stands != "on":  # else the servo measures on the axis at the tip
        arm["sensor_m"] = [rounded(share * part) for part in offset]
    return table | {"outer_beam": beam, "arm": arm, "material": {"alloy": dict(ALLOY)}}


def arm_figures(table: Table, own: Shape) -> Shape:
    """Flat figures `arm.*` of an arm, for `arm_modes`; none of a rig that is none.

    Args:
        table: the believed prototype.
        own: of the true rig, by the names of `STATED`.
    """
    if "arm" not in table:
        return {}
    beam, arm = table["outer_beam"], table["arm"]
    tube = tube_mass(beam, table["material"][beam["material"]]["density_kg_per_m3"])
    middle = beam["width_m"] - beam["wall_m"]
    return {
        **{f"arm.{name}": own[name] for name in STATED},
        "arm.length": beam["free_length_m"],
        "arm.module": end_module(beam, tube),
        "arm.tube": tube,
        "arm.tube_inertia": tube * middle**2 / 3,  # b^2 / 4 + b^2 / 12 of each wall
        "arm.end_inertia": arm["end_polar_inertia_kg_m2"] + arm["payload_polar_inertia_kg_m2"],
        "arm.payload": _seen_in(arm["plane"], arm["offset_m"]),
        "arm.watched": _seen_in(arm["plane"], arm.get("sensor_m", (0.0, 0.0, 0.0))),
    }


def _seen_in(plane: str, place: Any) -> tuple[float, float, float]:
    """How far a place of the end stands ahead of the tip, off it in the plane, and to what side of the plane, m.

    By a roll of the end in the right hand's sense about the beam, a place to a side moves that far in the plane.
    """
    ahead, y, z = place
    return (ahead, y, -z) if plane == "y" else (ahead, z, y)


def arm_modes(
    bending: np.ndarray, carried: float, *, length: float, tube: float, module: float, torsional_stiffness: float,
    torsional_damping_ratio: float, tube_inertia: float, end_inertia: float, payload: tuple[float, float, float],
    watched: tuple[float, float, float],
) -> np.ndarray:  # fmt: skip
    """(7, n) modes of an arm's end, see `at_end`: of its bending, and of its twist where this has a part in the plane.

    Args:
        bending: (3, 1) mode of bending, counted at the tip.
        carried: payload, kg, with which the tube bends more as under a force on its tip.
        length: of the tube, m.
        tube: its mass, kg.
        module: mass of the end module, kg.
        torsional_stiffness: G J / L, N m/rad.
        torsional_damping_ratio: of a mode of twist.
        tube_inertia: polar, kg m2.
        end_inertia: likewise, of what is fixed to the end but for the payload's mass.
        payload: see `_seen_in`.
        watched: the same of where the sensor measures.
    """
    slope = tip_slope((module + carried) / tube) / length
    twist = twist_modes(torsional_stiffness, tube_inertia, end_inertia, torsional_damping_ratio)
    if payload[2] == 0 and watched[2] == 0:
        twist = twist[:, :0]
    bends, twists = np.ones(bending.shape[1]), np.ones(twist.shape[1])

    def across(place: tuple[float, float, float]) -> np.ndarray:
        return np.append((1 + slope * place[0]) * bends, place[2] * twists)

    of_tip = np.append(bends, 0 * twists)
    modes = np.hstack([bending, twist])
    return at_end(modes, across(watched), across(payload), -slope * payload[1] * of_tip, of_tip)
