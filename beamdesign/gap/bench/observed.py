"""Steady motions of a bench as numbers, and how far a prediction is off them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamdesign.gap.bench.model import NOTHING, steady
from beamdesign.gap.bench.steady import SteadyMotion

CHANNELS = ("speed", "pressure_a", "pressure_b")
EDGES = "edges"
"""One more channel, a contrast in which command, flow gain and deadband cancel: the logarithm of flow over root of
pressure at the edge that empties, extending over retracting."""
_NO_REPLICATE = 0.01  # deviation taken where nothing was repeated
_LEAST_DROP_PA = 1e3


@dataclass(frozen=True)
class Observations:
    """Steady motions as numbers, one row per run and direction.

    Attributes:
        condition: (N,) names.
        volts: (N,) commands.
        speed: (N,) m/s.
        side: (N,) `a` or `b`.
        pressure: (N,) of that chamber, Pa.
        stall: (N,) of that chamber against the stop, Pa.
        filled: (N,) whether that chamber is then the one at supply pressure.
        asymmetry: of the piston by bore and rod.
    """

    condition: np.ndarray
    volts: np.ndarray
    speed: np.ndarray
    side: np.ndarray
    pressure: np.ndarray
    stall: np.ndarray
    filled: np.ndarray
    asymmetry: float

    def of(self, conditions: Sequence[str]) -> "Observations":
        """Those of some conditions."""
        keep = np.isin(self.condition, list(conditions))
        return Observations(
            self.condition[keep],
            self.volts[keep],
            self.speed[keep],
            self.side[keep],
            self.pressure[keep],
            self.stall[keep],
            self.filled[keep],
            self.asymmetry,
        )

    @property
    def tank(self) -> float:
        """Mean pressure of chambers that a stop holds empty, Pa."""
        return float(np.mean(self.stall[~self.filled]))

    @property
    def both_ways(self) -> list[tuple[str, float, float]]:
        """Conditions with their commands out and back."""
        named = dict.fromkeys(self.condition.tolist())
        own = {c: self.volts[self.condition == c] for c in named}
        return [(c, float(v[v > 0][0]), float(v[v < 0][0])) for c, v in own.items()]

    def contrast(self, speeds: tuple[Any, Any], empty: tuple[Any, Any]) -> Any:
        """The channel `EDGES` from speeds (m/s, both positive) and pressures of the emptying chambers, out and back."""
        areas = np.log((1 - self.asymmetry) / (1 + self.asymmetry))
        drops = [np.maximum(pressure - self.tank, _LEAST_DROP_PA) for pressure in empty]
        return areas + np.log(speeds[0] / speeds[1]) - 0.5 * np.log(drops[0] / drops[1])

    def contrasts(self) -> np.ndarray:
        """Measured, one per condition of `both_ways`."""

        def mean(values: np.ndarray, condition: str, sign: int, side: str = "") -> float:
            row = (self.condition == condition) & (np.sign(self.volts) == sign)
            return float(np.mean(values[row & (self.side == side)] if side else np.abs(values[row])))

        return np.array(
            [
                self.contrast(
                    (mean(self.speed, c, 1), mean(self.speed, c, -1)),
                    (mean(self.pressure, c, 1, "b"), mean(self.pressure, c, -1, "a")),
                )
                for c, _, _ in self.both_ways
            ]
        )


def observations(motions: Sequence[SteadyMotion], asymmetry: float, null_V: float = 0.0) -> Observations:
    """Rows of steady motions of a piston with the given asymmetry by bore and rod; commands count from the null."""
    return Observations(
        np.array([m.condition for m in motions]),
        np.array([m.command_V - null_V for m in motions]),
        np.array([m.speed for m in motions]),
        np.array([m.side for m in motions]),
        np.array([m.pressure for m in motions]),
        np.array([m.stall for m in motions]),
        np.array([(m.direction > 0) == (m.side == "a") for m in motions]),
        asymmetry,
    )


def errors(seen: Observations, figure: Mapping[str, float], orifices: bool, supply: float) -> dict[str, np.ndarray]:
    """Relative errors of speeds and errors of pressures over the supply, per row; NaN for the chamber not recorded."""
    found = steady(dict(NOTHING) | dict(figure), seen.volts, orifices)
    errors = {"speed": found.speed / seen.speed - 1}
    for side in "ab":
        errors[f"pressure_{side}"] = np.where(
            seen.side == side, (found.pressure(side) - seen.pressure) / supply, np.nan
        )
    return errors


def averaged(seen: Observations, error: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Mean error per channel over the runs of each condition and direction, so that replicates count once."""
    keys = sorted(set(zip(seen.condition.tolist(), np.sign(seen.volts).tolist(), strict=True)))
    rows = [(seen.condition == condition) & (np.sign(seen.volts) == sign) for condition, sign in keys]
    return {channel: np.array([np.nanmean(values[row]) for row in rows]) for channel, values in error.items()}


def scatter(seen: Observations, supply: float) -> dict[str, float]:
    """Standard deviation of single runs about the mean of their condition and direction, in the units of `errors`."""
    found: dict[str, list[float]] = {channel: [] for channel in CHANNELS}
    freedom = dict.fromkeys(CHANNELS, 0)
    for condition in dict.fromkeys(seen.condition.tolist()):
        for sign in (-1, 1):
            row = (seen.condition == condition) & (np.sign(seen.volts) == sign)
            groups = {"speed": seen.speed[row] / np.mean(seen.speed[row])}
            groups |= {f"pressure_{side}": seen.pressure[row & (seen.side == side)] / supply for side in "ab"}
            for channel, values in groups.items():
                if len(values) > 1:
                    found[channel].append(float(np.sum((values - np.mean(values)) ** 2)))
                    freedom[channel] += len(values) - 1
    deviation = {c: (sum(found[c]) / freedom[c]) ** 0.5 if freedom[c] else _NO_REPLICATE for c in CHANNELS}
    # Of a contrast between means over the runs of two directions.
    runs = len(seen.volts) / max(2 * len(seen.both_ways), 1)
    deviation[EDGES] = deviation["speed"] * (2 / max(runs, 1)) ** 0.5
    return deviation
