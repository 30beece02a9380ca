"""The shipped design whose every claim is proved of a whole box, on rigs drawn from it and written down once more.

Equations (7) to (16) of Zalucky and Hardt (1984) as polynomials in s, by numpy alone: roots, and values along the axis.
"""

import tomllib
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import polynomial as poly

SHIPPED = Path(__file__).parent.parent / "studies" / "prototypes" / "structured_within_tolerances.toml"
BANDWIDTH_Hz = 4.09
MASSES_KG = (0.0, 0.7, 2.0, 6.8)
SHARES = (0.02, 0.1, 0.3, 0.6, 1.0)
S = 2j * pi * np.append(np.geomspace(0.05, 2000.0, 1500), BANDWIDTH_Hz)


@pytest.fixture(scope="module")
def table() -> dict[str, Any]:
    return tomllib.loads(SHIPPED.read_text())


def law(table: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of the lag and its sections, A/V, coefficients ascending."""
    own = table["controller"]
    above, below = ([1, 1 / (2 * pi * own[f"{key}_Hz"])] for key in ("zero", "pole"))
    for section in own["section"]:
        quadratics = []
        for key in ("zero", "pole"):
            w = 2 * pi * section[f"{key}_Hz"]
            quadratics.append([1, 2 * section[f"{key}_damping_ratio"] / w, 1 / w**2])
        above, below = poly.polymul(above, quadratics[0]), poly.polymul(below, quadratics[1])
    return own["gain_A_per_V"] * np.asarray(above), np.asarray(below)


def figures(table: dict[str, Any], shares: np.ndarray) -> list[float]:
    """Fourteen figures, at shares from -1 to 1 of two standard deviations to either side; as `loop` takes them."""
    off, outer, inner, valve = (table[key] for key in ("tolerance", "outer_beam", "inner_beam", "servovalve"))

    def at(k: int, value: float, deviation: str) -> float:
        return value * (1 + 2 * off[deviation] * shares[k])

    found = []
    for k, beam in enumerate((outer, inner)):
        stiffness, mass = beam["stiffness_N_per_m"], beam["effective_mass_kg"]
        dashpot = 2 * beam["damping_ratio"] * sqrt(stiffness * mass)
        found += [
            at(3 * k, stiffness, "stiffness"), at(3 * k + 1, dashpot, "beam_damping_ratio"),
            at(3 * k + 2, mass, "effective_mass"),
        ]  # fmt: skip
    return [
        *found,
        at(6, table["actuator"]["oil_stiffness_N_per_m"], "oil_stiffness"),
        at(7, table["actuator"]["piston_area_m2"], "piston_area"),
        at(8, valve["flow_gain_m3_per_s_per_A"], "flow_gain"),
        at(9, valve["leakage_m3_per_s_per_Pa"], "leakage"),
        at(10, 2 * pi * valve["natural_frequency_Hz"], "valve_natural_frequency"),
        at(11, valve["damping_ratio"], "valve_damping_ratio"),
        at(12, table["sensor"]["gain_V_per_m"], "sensor_gain"),
        at(13, 2 * pi * table["sensor"]["filter_Hz"], "sensor_filter"),
    ]


def loop(of: list[float], outer_kg: float, inner_kg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numerators of volts over current and of x over force, and what both are over; valve and filter left out."""
    k_m, b_m, m_m, k_f, b_f, m_f, k_c, area, flow, leak, _, _, volts, _ = of
    outer, inner, oil = [k_m, b_m, m_m + outer_kg], [k_f, b_f, m_f + inner_kg], [leak, area**2 / k_c]
    both = poly.polymul([0, area**2], poly.polyadd(outer, inner))
    below = poly.polyadd(poly.polymul(oil, poly.polymul(outer, inner)), both)
    pushed = poly.polyadd(poly.polymul(oil, inner), [0, area**2])
    return flow * volts * poly.polymul([area], inner), pushed, below


def test_every_rig_that_is_drawn_keeps_every_claim(table: dict[str, Any]) -> None:
    random, (above, below), goal = np.random.default_rng(416), law(table), table["goal"]
    drawn = [*random.choice([-1.0, 1.0], (700, 14)), *random.uniform(-1, 1, (300, 14))]
    top, found = np.abs(S) >= 2 * pi * goal["loop_gain_from_Hz"], []
    control = poly.polyval(S, above) / poly.polyval(S, below)
    for shares in drawn:
        of = figures(table, shares)
        w, damping, corner = of[10], of[11], of[13]
        lags = poly.polymul([1, 2 * damping / w, 1 / w**2], [1, 1 / corner])
        delayed = control / poly.polyval(S, lags)
        for mass in MASSES_KG:
            moved, pushed, beams = loop(of, mass, table["payload"]["inner_end_mass_kg"])
            numerator, denominator = poly.polymul(above, moved), poly.polymul(poly.polymul(lags, below), beams)
            slowest = [poly.polyroots(poly.polyadd(denominator, g * numerator)).real.max() for g in SHARES]
            per_beams = 1 / poly.polyval(S, beams)
            gain, idle = delayed * poly.polyval(S, moved) * per_beams, np.abs(poly.polyval(S, pushed) * per_beams)
            closed = 1 / (1 + gain)
            compliance = idle * np.abs(closed)
            effort = np.abs(control * closed)
            slow = compliance[np.abs(S) <= 2 * pi * BANDWIDTH_Hz]
            peaks = (np.abs(closed), slow, np.abs(gain[top]), effort, compliance)
            found.append([max(slowest), *(one.max() for one in peaks), idle.max()])
    slowest, peak, slow, high, effort, largest, passive = np.max(found, axis=0)
    assert slowest < 0
    assert peak <= goal["peak_sensitivity"]
    assert slow <= goal["compliance_m_per_N"]
    assert high <= goal["loop_gain"]
    assert effort <= goal["controller_effort_A_per_V"]
    assert largest <= goal["peak_over_passive"] * passive
    assert peak > 0.95 * goal["peak_sensitivity"]  # the box is not one that any loop would keep
    assert slow > 0.95 * goal["compliance_m_per_N"]
