"""Steady motion of a bench in closed form: speed and chamber pressures over command, for any set of causes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

NOTHING = {
    "asymmetry": 0.0,
    "deadband_V": 0.0,
    "piston_leakage": 0.0,
    "line_loss": 0.0,
    "edge_b": 1.0,
    "coulomb_N": 0.0,
    "viscous": 0.0,
    "constant_load_N": 0.0,
    "breakaway_ratio": 1.0,
    "stribeck_m_per_s": 0.005,
}
"""Figures with no cause at work. Beside them stand flow_gain (m3/s/V), piston_area (m2), both pressures (Pa)."""

_ROUNDS = 30
_SETTLED = 1e-6  # relative: Newton's next step would be of its square


@dataclass(frozen=True)
class Steady:
    """Prediction per command, (N,) each, or (m, N) for m sets of figures.

    Attributes:
        speed: m/s, positive extending.
        pressure_a: Pa.
        pressure_b: Pa.
    """

    speed: np.ndarray
    pressure_a: np.ndarray
    pressure_b: np.ndarray

    def pressure(self, side: str) -> np.ndarray:
        """Of chamber `a` or `b`."""
        return self.pressure_a if side == "a" else self.pressure_b


def friction(figure: Mapping[str, Any], speed: np.ndarray, sign: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force against the motion at a speed (both positive), and its slope; the constant load is against extension."""
    force = figure["coulomb_N"] + figure["viscous"] * speed + sign * figure["constant_load_N"]
    slope = figure["viscous"] + np.zeros_like(speed)
    if np.any(figure["breakaway_ratio"] != 1):
        excess = (figure["breakaway_ratio"] - 1) * np.exp(-((speed / figure["stribeck_m_per_s"]) ** 2))
        force = force + figure["coulomb_N"] * excess
        slope = slope - figure["coulomb_N"] * excess * 2 * speed / figure["stribeck_m_per_s"] ** 2
    return force, slope


def steady(figure: Mapping[str, Any], volts: np.ndarray, orifices: bool) -> Steady:
    """Steady motion at constant commands.

    With orifices, each edge passes q sqrt(2 dp / P_S), q being the flow of the opening at half the supply pressure, the
    lines lose pressure with the square of the flow, and both flows carry the piston: A_f p_f - A_e p_e = friction, f
    the side that fills and e the one that empties (Merritt 1967, chapters 5 and 6). A linear valve fills one side, the
    other empties as the piston drives it; of its pressures only the difference follows, and their sum is taken as
    supply plus tank, as leakage alike on all edges leaves it.

    Args:
        figure: as in `NOTHING`, with flow_gain, piston_area, supply_pressure and tank_pressure; each a number, or
            (m, 1) for m sets at once.
        volts: (N,) commands.
        orifices: whether flow goes with the root of the pressure drop.
    """
    sign = np.where(volts < 0, -1.0, 1.0)
    area, asymmetry = figure["piston_area"], figure["asymmetry"]
    fills, empties = area * (1 + sign * asymmetry), area * (1 - sign * asymmetry)
    supply, tank = figure["supply_pressure"], figure["tank_pressure"]
    flow = figure["flow_gain"] * np.maximum(np.abs(volts) - figure["deadband_V"], 1e-6)
    leakage, line = figure["piston_leakage"], figure["line_loss"]
    speed = 0.5 * flow / area
    past = np.zeros_like(speed)  # the piston, from the side that fills
    full = empty = np.full_like(speed, supply / 2)
    for _ in range(_ROUNDS):
        force, slope = friction(figure, speed, sign)
        if orifices:
            drop = supply / 2 / flow**2 + line  # pressure per flow squared
            filling = supply / 2 / (flow * np.where(sign < 0, figure["edge_b"], 1.0)) ** 2 + line
            into, out = fills * speed + past, empties * speed + past
            full, empty = supply - filling * into * np.abs(into), tank + drop * out * np.abs(out)
            falls, rises = -2 * filling * np.abs(into), 2 * drop * np.abs(out)
            # Newton's step in the speed and in the flow past the piston
            unbalanced, unmet = fills * full - empties * empty - force, leakage * (full - empty) - past
            by_speed = fills**2 * falls - empties**2 * rises - slope
            by_past = fills * falls - empties * rises
            met_by_speed, met_by_past = leakage * by_past, leakage * (falls - rises) - 1
            determinant = by_speed * met_by_past - by_past * met_by_speed
            moved = speed - (met_by_past * unbalanced - by_past * unmet) / determinant
            past = np.clip(past - (by_speed * unmet - met_by_speed * unbalanced) / determinant, -flow, flow)
            moved = np.clip(moved, 0.1 * speed, 2 * flow / np.minimum(fills, empties))
        else:
            full = (force + empties * (supply + tank)) / (fills + empties)
            empty = supply + tank - full
            past = np.clip(leakage * (full - empty), -flow, flow)
            moved = np.maximum((flow - past) / fills, 1e-9)
        settled = bool(np.all(np.abs(moved - speed) <= _SETTLED * speed))
        speed = moved
        if settled:
            break
    extending = sign > 0
    return Steady(sign * speed, np.where(extending, full, empty), np.where(extending, empty, full))
