"""Whether what a certificate about the tip as a port states is true: a model in floats, which no checker shares.

F / x of the closed loop by the impedances of its parts, and poles with springs, dashpots and masses at the tip (as in
`stated_rig`, grids refute and do not prove).
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf, pi
from typing import Any

import numpy as np
from stated_rig import (
    CLOSE,
    StatedRig,
    Table,
    Verdict,
    agrees,
    below,
    frequencies,
    grid,
    number,
    pair,
    repeats,
    stable,
    together,
)

ENVIRONMENT = ("stiffness_N_per_m", "damping_N_s_per_m", "mass_kg")
BESIDE = 1e-4
"""Relative: so near to the end of a band whose ends are stated as two, nothing is looked at."""


def true(table: dict[str, Any]) -> Verdict:
    """Whether what a certificate states is true; None where that is too close to call.

    Raises:
        Exception: of some kind, for a table that is not of the format.
    """
    if table["kind"] != "beamdesign.contact":
        raise ValueError("of another kind")
    return together(_statements(table))


def _statements(table: Table) -> Iterator[Verdict]:
    yield from repeats(table)
    port, masses = Port(StatedRig(table)), pair(table["outer_end_mass_kg"])
    stands = together(port.stable(0.0, 0.0, mass) for mass in grid(*masses))
    yield agrees(table["stability"]["stable"], stands)
    yield from _passivity(table["passivity"], port, stands, masses[0])
    yield from _contact(table["contact"], port, masses)
    yield _bouncing(table["bouncing"], port, stands, masses)
    yield _stiffness(table["stiffness"], port, stands, masses)


class Port:
    """The tip of a closed loop."""

    def __init__(self, rig: StatedRig) -> None:
        self.rig = rig

    def poles(self, stiffness: float, damping: float, mass: float) -> np.ndarray:
        """With these fixed to the tip, rad/s."""
        added = {"stiffness_N_per_m": stiffness, "damping_N_s_per_m": damping, "mass_kg": mass}
        one = [np.array([[self.rig.figure[f"outer_{key}"] + value]]) for key, value in added.items()]
        return self.rig.poles((one[0], one[1], one[2]), [1.0])

    def stable(self, stiffness: float, damping: float, mass: float) -> Verdict:
        """Whether it is with these."""
        return stable(self.poles(stiffness, damping, mass))

    def impedance(self, w: np.ndarray, mass: float = 0.0) -> np.ndarray:
        """F / x, N/m."""
        s, servo = 1j * w, self.rig.servo(1j * w)
        return self.rig.beam(s) + mass * s**2 + servo.displaced + servo.moved


def _environment(table: Table) -> list[float]:
    found = [number(table[key]) for key in ENVIRONMENT]
    if min(found) < 0:
        raise ValueError("below zero")
    return found


def _passivity(table: Table, port: Port, stands: Verdict, least: float) -> Iterator[Verdict]:
    bands = [[_band(band[key]) for key in ("outer", "inner")] for band in table.get("band", [])]
    for (low, high), (a, b) in bands:
        yield low <= a < b <= high
    yield all(one[0][1] <= two[0][0] for one, two in pairwise(bands))
    w = frequencies(port.poles(0.0, 0.0, least), 0.0, inf)
    ends = [end for band in bands for pair in band for end in pair if 0 < end < inf]
    w = np.sort(np.concatenate([w, *(end * (1 + np.array([-1e-3, -BESIDE, BESIDE, 1e-3])) for end in ends)]))
    away = np.ones(len(w), dtype=bool)
    for end in ends:
        away &= abs(w / end - 1) > BESIDE / 2
    mobility = 1j * w / port.impedance(w)
    share = mobility.real / abs(mobility)
    inside, around = (_within(w, [band[k] for band in bands]) for k in (1, 0))
    yield not (share[inside & away] > CLOSE).any()
    yield not (share[~around & away] < -CLOSE).any()
    works = bool((share < -CLOSE).any())
    yield agrees(table["passive"], False if stands is False or bands or works else stands)
    if "troublemaker" in table:
        stiffness, damping, mass = _environment(table["troublemaker"])
        yield agrees(False, port.stable(stiffness, damping, mass + least))


def _band(texts: Sequence[str]) -> tuple[float, float]:
    low, high = texts
    return number(low) ** 0.5, inf if high == "infinite" else number(high) ** 0.5


def _within(w: np.ndarray, bands: Sequence[tuple[float, float]]) -> np.ndarray:
    found = np.zeros(len(w), dtype=bool)
    for low, high in bands:
        found |= (w > low) & (w < high)
    return found


def _contact(table: Table, port: Port, masses: tuple[float, float]) -> Iterator[Verdict]:
    walls, dashpots = (pair(table[key]) for key in ENVIRONMENT[:2])
    between = np.geomspace(max(walls[0], 1.0), max(walls[1], 1.0), 40)
    stiff = [*walls, *(k for k in between if walls[0] < k < walls[1])]
    every = [port.stable(k, b, m) for k in stiff for b in grid(*dashpots, 3) for m in grid(*masses, 5)]
    witness = _environment(table["witness"]) if "witness" in table else None
    if witness is not None:
        sides = zip(witness, (walls, dashpots, masses), strict=True)
        yield all(low <= value <= high for value, (low, high) in sides)
        yield agrees(False, port.stable(*witness))
    yield agrees(table["stable"], together([*every, *([] if witness is None else [port.stable(*witness)])]))


def _bouncing(table: Table, port: Port, stands: Verdict, masses: tuple[float, float]) -> Verdict:
    """1 / k + Re[(1 + j w q) x / F] is above zero."""
    wall, multiplier = number(table["stiffness_N_per_m"]), number(table["multiplier_s"])
    if min(wall, multiplier) < 0:
        raise ValueError("below zero")
    if wall == 0:
        return True
    verdicts = [stands]
    for mass in grid(*masses):
        w = frequencies(port.poles(0.0, 0.0, mass), 0.0, inf)
        popov = 1 / wall + ((1 + 1j * w * multiplier) / port.impedance(w, mass)).real
        verdicts.append(True if popov.min() * wall > CLOSE else False if popov.min() * wall < -CLOSE else None)
    return together(verdicts)


def _stiffness(table: Table, port: Port, stands: Verdict, masses: tuple[float, float]) -> Verdict:
    stiffness, share = number(table["end_stiffness_N_per_m"]), number(table["share"])
    band = inf if table["bandwidth_Hz"] == "infinite" else 2 * pi * number(table["bandwidth_Hz"])
    if stiffness == 0 or share <= 0 or band < 0:
        raise ValueError("no stiffness, or not above zero")
    if band == 0:
        return True
    off = 0.0
    for mass in grid(*masses):
        w = np.append(np.linspace(0, band, 200)[1:] if band < inf else [], frequencies(port.poles(0, 0, mass), 0, band))
        off = max(off, float(abs(port.impedance(w, mass) / stiffness - 1).max()))
    return together([stands, below(off, share)])
