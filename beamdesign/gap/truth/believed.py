"""Rigs as their designers believe them, and the rig that is really there: every tolerated figure a little off.

A beam's bending modes are those of a cantilever by finite elements, counted at its tip.
"""

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import Any

import numpy as np
from scipy.linalg import eigh

from beamdesign.gap.truth.effects import Shape
from beamdesign.gap.truth.figures import packed

HIGHEST_RATE = 2 * np.pi * 2500
"""rad/s; modes above it are left out, since they neither move nor fit into the steps of the simulation."""


@dataclass(frozen=True)
class Modes:
    """Modes of a beam, lowest first.

    Attributes:
        frequencies: (n,) rad/s.
        stiffness: (n,) N/m, each mode alone pressed at the tip.
        mass: (n,) kg.
    """

    frequencies: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray


def cantilever_modes(
    rigidity: np.ndarray, mass_per_length: np.ndarray, length_m: float, lumps: dict[int, float], count: int
) -> Modes:
    """Euler-Bernoulli cantilever of cubic elements of equal length (consistent masses).

    Args:
        rigidity: (n,) E I of each element from the clamp, N m2.
        mass_per_length: (n,) kg/m.
        length_m: of the whole.
        lumps: mass in kg by node, 1 to n (the tip).
        count: how many modes.
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
    return Modes(np.sqrt(squares), squares / at_tip, 1 / at_tip)


def outer_modes(
    stiffness: float, mass: float, damping: float, joint_softness: float, joint_mass: float, tip_share: float,
    damping_ratio: float, count: int,
) -> np.ndarray:  # fmt: skip
    """(3, n) stiffness, mass and damping of an outer beam whose first mode at the tip has the figures given.

    A bolted joint a little beyond the middle makes it softer there and heavier: the softer, the lower the second mode
    and the more it gives at the tip.

    Args:
        stiffness: of the first mode, N/m.
        mass: of the first mode, kg.
        damping: of the first mode, N s/m.
        joint_softness: rigidity of the tube over that at the joint, less one.
        joint_mass: over the mass of the tube.
        tip_share: mass fixed to the tip over that of the tube.
        damping_ratio: of the higher modes.
        count: how many modes at most.
    """
    elements = 16
    rigidity = np.ones(elements)
    rigidity[9:11] = 1 / (1 + joint_softness)
    found = cantilever_modes(rigidity, np.ones(elements), 1.0, {10: joint_mass, elements: tip_share}, count)
    first = np.sqrt(stiffness / mass)
    kept = found.frequencies / found.frequencies[0] * first < HIGHEST_RATE
    found = Modes(found.frequencies[kept], found.stiffness[kept], found.mass[kept])
    scaled_k, scaled_m = found.stiffness * stiffness / found.stiffness[0], found.mass * mass / found.mass[0]
    losses = 2 * damping_ratio * np.sqrt(scaled_k * scaled_m)
    losses[0] = damping
    return np.array([scaled_k, scaled_m, losses])


Table = dict[str, Any]

TOLERANCE = {
    "stiffness": 0.03,
    "effective_mass": 0.02,
    "beam_damping_ratio": 0.2,
    "oil_stiffness": 0.1,
    "piston_area": 0.005,
    "flow_gain": 0.05,
    "leakage": 0.2,
    "valve_natural_frequency": 0.05,
    "valve_damping_ratio": 0.1,
    "sensor_gain": 0.005,
}
"""What a builder can vouch for, relative."""

_TOLERATED_BY = {
    "outer_stiffness": "stiffness",
    "outer_mass": "effective_mass",
    "outer_damping_ratio": "beam_damping_ratio",
    "inner_stiffness": "stiffness",
    "inner_mass": "effective_mass",
    "inner_damping_ratio": "beam_damping_ratio",
    "oil_stiffness": "oil_stiffness",
    "piston_area": "piston_area",
    "flow_gain": "flow_gain",
    "leakage": "leakage",
    "valve_frequency": "valve_natural_frequency",
    "valve_damping_ratio": "valve_damping_ratio",
    "sensor_gain": "sensor_gain",
    "filter_rate": "sensor_filter",
}


def _rounded(value: float, digits: int = 3) -> float:
    return float(f"{value:.{digits}g}")


def draw_believed(rng: np.random.Generator, name: str) -> Table:
    """A believed prototype as nested tables: around the published rig, from half to twice its figures."""

    def about(value: float, factor: float) -> float:
        return _rounded(value * exp(rng.uniform(-np.log(factor), np.log(factor))))

    damping = _rounded(rng.uniform(0.02, 0.06), 2)
    size = exp(rng.uniform(np.log(0.6), np.log(1.4)))
    table: Table = {
        "name": name,
        "outer_beam": {
            "stiffness_N_per_m": about(486800 * size, 1.25),
            "effective_mass_kg": about(3.9 * size, 1.25),
            "damping_ratio": damping,
        },
        "inner_beam": {
            "stiffness_N_per_m": about(157500 * size, 1.25),
            "effective_mass_kg": about(1.6 * size, 1.25),
            "damping_ratio": damping,
        },
        "actuator": {
            "piston_area_m2": about(1.13e-4 * size, 1.2),
            "oil_stiffness_N_per_m": about(1.3e7 * size, 1.3),
        },
        "servovalve": {
            "flow_gain_m3_per_s_per_A": about(0.0113 * size, 1.3),
            "leakage_m3_per_s_per_Pa": about(3.8e-13 * size, 1.4),
            "natural_frequency_Hz": about(150, 1.4),
            "damping_ratio": _rounded(rng.uniform(0.45, 0.8), 2),
        },
        "sensor": {"gain_V_per_m": about(1180, 1.5)},
        "tolerance": {key: _rounded(value * exp(rng.uniform(-0.3, 0.3)), 2) for key, value in TOLERANCE.items()},
    }
    if rng.uniform() < 0.1:
        table["sensor"]["filter_Hz"] = about(500, 1.3)
        table["tolerance"]["sensor_filter"] = 0.05
    return table


def believed_figures(table: Table) -> Shape:
    """The figures that a believed prototype states, flat, as `_TOLERATED_BY` names them."""
    outer, inner = table["outer_beam"], table["inner_beam"]
    valve = table["servovalve"]
    return {
        "outer_stiffness": outer["stiffness_N_per_m"],
        "outer_mass": outer["effective_mass_kg"],
        "outer_damping_ratio": outer["damping_ratio"],
        "inner_stiffness": inner["stiffness_N_per_m"],
        "inner_mass": inner["effective_mass_kg"],
        "inner_damping_ratio": inner["damping_ratio"],
        "oil_stiffness": table["actuator"]["oil_stiffness_N_per_m"],
        "piston_area": table["actuator"]["piston_area_m2"],
        "flow_gain": valve["flow_gain_m3_per_s_per_A"],
        "leakage": valve["leakage_m3_per_s_per_Pa"],
        "valve_frequency": 2 * pi * valve["natural_frequency_Hz"],
        "valve_damping_ratio": valve["damping_ratio"],
        "sensor_gain": table["sensor"]["gain_V_per_m"],
        "filter_rate": 2 * pi * table["sensor"].get("filter_Hz", 0.0),
    }


def tolerance_of(table: Table, figure: str) -> float:
    """Relative standard deviation that a prototype states for one of its figures."""
    return float(table["tolerance"].get(_TOLERATED_BY[figure], 0.0))


def draw_true(table: Table, rng: np.random.Generator) -> Shape:
    """Factors of the true figures on the believed ones, log-normal by the stated tolerances."""
    return {name: exp(tolerance_of(table, name) * rng.normal()) for name in _TOLERATED_BY}


def rig_figures(table: Table, factors: Shape, habits: Shape) -> Shape:
    """Figures of the true rig, without effects, masses or controller; keys `modes.*` are of its outer beam.

    Args:
        table: the believed prototype.
        factors: of truth on belief, by figure; what is not named is as believed.
        habits: figures that no prototype states (bulk modulus, supply, where the leakage goes).
    """
    own = {name: value * factors.get(name, 1.0) for name, value in believed_figures(table).items()}
    bulk = habits.get("bulk_modulus", 1.3e9)
    return {
        "modes.stiffness": own["outer_stiffness"],
        "modes.mass": own["outer_mass"],
        "modes.damping": 2 * own["outer_damping_ratio"] * sqrt(own["outer_stiffness"] * own["outer_mass"]),
        "inner_stiffness": own["inner_stiffness"],
        "inner_mass": own["inner_mass"],
        "inner_damping": 2 * own["inner_damping_ratio"] * sqrt(own["inner_stiffness"] * own["inner_mass"]),
        "area_a": own["piston_area"],
        "area_b": own["piston_area"],
        # Chambers of this length have, in parallel, the stiffness of the oil spring: 2 bulk A / length.
        "chamber_length": 2 * bulk * own["piston_area"] / own["oil_stiffness"],
        "bulk_modulus": bulk,
        "flow_gain": own["flow_gain"],
        "leakage": own["leakage"],
        "valve_frequency": own["valve_frequency"],
        "valve_damping_ratio": own["valve_damping_ratio"],
        "sensor_gain": own["sensor_gain"],
        "filter_rate": own["filter_rate"],
        "believed_sensor_gain": table["sensor"]["gain_V_per_m"],
        **{key: value for key, value in habits.items() if key != "bulk_modulus"},
    }


def assembled(figures: Shape) -> tuple[np.ndarray, np.ndarray]:
    """The record that the equations read and the (3, n) modes of the outer beam, from flat figures."""
    own = {key.removeprefix("modes."): value for key, value in figures.items() if key.startswith("modes.")}
    modes = outer_modes(
        own["stiffness"], own["mass"], own["damping"], own.get("softness", 0.0), own.get("joint_mass", 0.0),
        own.get("tip_share", 0.0), own.get("zeta", 0.01), int(own.get("count", 1)),
    )  # fmt: skip
    return packed({key: value for key, value in figures.items() if not key.startswith("modes.")}), modes


def controller_figures(controller: Table) -> Shape:
    """Gain, pole and zero (rad/s) of a controller's table; a proportional one is a lag whose breaks coincide."""
    if controller["kind"] == "lag":
        pole, zero = 2 * pi * controller["pole_Hz"], 2 * pi * controller["zero_Hz"]
    else:
        pole = zero = 2 * pi * 10.0
    return {"gain": controller["gain_A_per_V"], "pole": pole, "zero": zero}
