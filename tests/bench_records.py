"""Records of an imagined bench, written from closed forms of steady motion: nothing of the package is used here."""

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, pi, sqrt
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

STROKE, SUPPLY, TANK = 0.25, 7e6, 1.5e5
BORE, ROD = 0.020, 0.012
CAP, RING = pi / 4 * BORE**2, pi / 4 * (BORE**2 - ROD**2)
MEAN = (CAP + RING) / 2
ZERO = 0.004  # what the displacement reads at the retracted stop

PROTOTYPE = f"""
name = "imagined bench"
kind = "actuator_bench"
[actuator]
bore_m = {BORE}
rod_m = {ROD}
piston_area_m2 = {MEAN:.6e}
stroke_m = {STROKE}
supply_pressure_Pa = {SUPPLY}
tank_pressure_Pa = {TANK}
[servovalve]
flow_gain_m3_per_s_per_V = 9.0e-6
[tolerance]
flow_gain = 0.05
piston_area = 0.01
supply_pressure = 0.02
"""


@dataclass(frozen=True)
class Truth:
    """What the imagined bench is like.

    Attributes:
        flow_gain: m3/s/V at half the supply pressure.
        unequal: whether the sides are those of bore and rod.
        orifices: whether flow goes with the root of the pressure drop.
        deadband: V.
        friction: from speed (m/s, positive) and direction to N against the motion.
    """

    flow_gain: float = 9.0e-6
    unequal: bool = False
    orifices: bool = False
    deadband: float = 0.0
    friction: Callable[[float, int], float] = lambda speed, direction: 0.0


def steady_motion(truth: Truth, volts: float) -> tuple[float, float, float]:
    """Speed (positive) and pressures of the sides that fill and empty."""
    direction = 1 if volts > 0 else -1
    cap, ring = (CAP, RING) if truth.unequal else (MEAN, MEAN)
    fills, empties = (cap, ring) if direction > 0 else (ring, cap)
    flow = truth.flow_gain * (abs(volts) - truth.deadband)
    if not truth.orifices:
        speed = flow / fills
        full = (truth.friction(speed, direction) + empties * (SUPPLY + TANK)) / (fills + empties)
        return speed, full, SUPPLY + TANK - full
    edge = flow / sqrt(SUPPLY / 2)

    def unbalanced(speed: float) -> float:
        full, empty = SUPPLY - (fills * speed / edge) ** 2, TANK + (empties * speed / edge) ** 2
        return fills * full - empties * empty - truth.friction(speed, direction)

    speed = brentq(unbalanced, 1e-9, 10 * flow / MEAN, xtol=1e-12)
    return speed, SUPPLY - (fills * speed / edge) ** 2, TANK + (empties * speed / edge) ** 2


def record(truth: Truth, volts: float, side: str, random: np.random.Generator) -> np.ndarray:
    """Columns t_s, command_V, displacement_m and the pressure of one side, 1 kHz, with spikes in the displacement."""
    drift = 1 + 0.005 * random.standard_normal()  # from run to run
    out, back = (steady_motion(truth, sign * volts) for sign in (1, -1))
    hold = max(1.6 * STROKE / min(out[0], back[0]), 0.5)
    step = 1e-3
    times = np.arange(round((0.1 + 2 * hold) / step)) * step
    command = np.where(times < 0.1, 0.0, np.where(times < 0.1 + hold, volts, -volts))
    extended = np.clip((times - 0.1) * out[0] * drift / STROKE, 0, 1)
    progress = np.where(command < 0, 1 - np.clip((times - 0.1 - hold) * back[0] * drift / STROKE, 0, 1), extended)
    of_side = {"a": (TANK, out[1], SUPPLY, back[2]), "b": (SUPPLY, out[2], TANK, back[1])}[side]
    wanted = np.where(command < 0, of_side[3], of_side[1])
    wanted = np.where((command > 0) & (progress >= 1), of_side[2], wanted)
    wanted = np.where((command <= 0) & (progress <= 0), of_side[0], wanted)
    share = 1 - exp(-step / 0.01)
    pressure, _ = lfilter([share], [1, share - 1], wanted, zi=[(1 - share) * of_side[0]])
    pressure += 2e4 * random.standard_normal(len(times))
    position = ZERO + STROKE * progress + 3e-4 * random.standard_normal(len(times))
    position[random.random(len(times)) < 0.005] -= 0.01
    return np.column_stack([times, command, position, pressure])


def write_table(path: Path, header: str, table: np.ndarray) -> None:
    """A file as `numpy.savetxt` writes it, in a third of the time."""
    row = ",".join(["%.6g"] * table.shape[1]) + "\n"
    path.write_text(f"{header}\n" + row * len(table) % tuple(table.ravel().tolist()))


def write_set(
    folder: Path, truth: Truth, voltages: tuple[float, ...] = (1.0, 2.0, 4.0), seed: int = 1, every: int = 1
) -> Path:
    """A data set of two replicates per voltage and side, of every so many samples."""
    random = np.random.default_rng(seed)
    (folder / "records").mkdir(parents=True)
    (folder / "prototype.toml").write_text(PROTOTYPE)
    lines = ['name = "imagined"', 'rig = "actuator_bench"', 'prototype = "prototype.toml"']
    for volts in voltages:
        for replicate in (1, 2):
            for side in "ab":
                name = f"records/{volts:g}V_{side}_{replicate}.csv"
                header = f"t_s,command_V,displacement_m,pressure_{side}_Pa"
                write_table(folder / name, header, record(truth, volts, side, random)[::every])
                lines += ["[[record]]", f'file = "{name}"', f'condition = "{volts:g} V"', f"replicate = {replicate}"]
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n")
    return folder
