"""Steady motion of a bench: found in its runs, predicted in closed form for any set of causes, and the difference."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np
from scipy.stats import theilslopes

from beamdesign.diagnosis.bench.data import BenchRun, BenchSet, held, stretches
from beamdesign.diagnosis.bench.hypothesis import NOTHING
from beamdesign.records import InputError

_MARGIN = 0.1  # of the travel next to either stop is left out
_BINS = 10  # the rest is looked at in as many parts
_LEAST_BINS = 4
_WITHIN = 4.0  # robust standard deviations by which a part may differ from the later half and still be steady
_STRAIGHT = 0.03  # a part whose speed differs by less counts as equal whatever the noise
_MAD = 1 / NormalDist().inv_cdf(0.75)
_MOST_POINTS = 400


@dataclass(frozen=True)
class SteadyMotion:
    """Steady motion in one direction of one run, and where it ended.

    Attributes:
        condition: of the run.
        replicate: of the run.
        side: chamber whose pressure was recorded.
        direction: 1 extending, -1 retracting.
        command_V: while it moved.
        begins_s: of the part that counts as steady.
        ends_s: of it.
        speed: m/s, positive extending, by Theil and Sen's median of slopes.
        pressure: Pa, median over that part.
        stall: Pa, median against the end stop.
        rest_m: reading of the displacement there.
    """

    condition: str
    replicate: int
    side: str
    direction: int
    command_V: float
    begins_s: float
    ends_s: float
    speed: float
    pressure: float
    stall: float
    rest_m: float


def steady_motions(data: BenchSet) -> tuple[SteadyMotion, ...]:
    """Steady motion of every run in both directions.

    Raises:
        InputError: where a run does not move steadily for long enough to tell its speed.
    """
    return tuple(steady_motion(run, direction) for run in data.runs for direction in (1, -1))


def steady_motion(run: BenchRun, direction: int) -> SteadyMotion:
    """Find the steady part of a run's stroke in one direction.

    The stroke is what lies between the readings at both stops, less a margin. Parts of it count as steady which move
    and press as its later half does; the median of that half is little disturbed by how long the start takes.

    Raises:
        InputError: where too little of the stroke is steady.
    """
    i, j, volts = [each for each in stretches(run.command_V) if each[2] * direction > 0][-1]
    rests = [float(np.median(run.displacement_m[held(run, sign)])) for sign in (-1, 1)]
    position = (run.displacement_m[i:j] - rests[0]) / (rests[1] - rests[0])
    progress = position if direction > 0 else 1 - position
    smooth = _running_median(progress)
    begins = int(np.argmax(smooth > _MARGIN))
    ends = int(np.argmax(smooth > 1 - _MARGIN))
    if not smooth[0] < 0.5 or ends - begins < 2 * _BINS:
        raise InputError(run.name, [("displacement_m", f"no whole stroke {_words(direction)} at {volts:g} V")])
    edges = np.linspace(begins + i, ends + i, _BINS + 1).astype(int)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    speeds = np.array([_slope(run, part) for part in parts])
    pressures = np.array([float(np.median(run.pressure_Pa[part])) for part in parts])
    alike = _like_later_half(speeds) & _like_later_half(pressures)
    first, last = _longest(alike)
    if last - first < _LEAST_BINS:
        raise InputError(run.name, [("displacement_m", f"no steady speed {_words(direction)} at {volts:g} V")])
    part = slice(edges[first], edges[last])
    stop = held(run, direction)
    return SteadyMotion(
        run.condition,
        run.replicate,
        run.side,
        direction,
        volts,
        float(run.times[part.start]),
        float(run.times[part.stop]),
        _slope(run, part),
        float(np.median(run.pressure_Pa[part])),
        float(np.median(run.pressure_Pa[stop])),
        float(np.median(run.displacement_m[stop])),
    )


def _words(direction: int) -> str:
    return "extending" if direction > 0 else "retracting"


def _running_median(values: np.ndarray) -> np.ndarray:
    """Median over a short window, which takes out the sensor's spikes."""
    width = max(5, len(values) // 200) | 1
    padded = np.pad(values, width // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1))


def _slope(run: BenchRun, part: slice) -> float:
    every = max(1, (part.stop - part.start) // _MOST_POINTS)
    return float(theilslopes(run.displacement_m[part][::every], run.times[part][::every])[0])


def _like_later_half(values: np.ndarray) -> np.ndarray:
    later = values[_BINS // 2 :]
    middle = float(np.median(later))
    spread = max(_MAD * float(np.median(np.abs(later - middle))), _STRAIGHT / _WITHIN * abs(middle))
    return np.asarray(np.abs(values - middle) <= _WITHIN * spread)


def _longest(flags: np.ndarray) -> tuple[int, int]:
    """First and one past the last of the longest row of flags."""
    best = (0, 0)
    begin = 0
    for k, flag in enumerate([*flags.tolist(), False]):
        if not flag:
            best = max(best, (begin, k), key=lambda pair: pair[1] - pair[0])
            begin = k + 1
    return best


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
        figure: all of `hypothesis.FIGURES` by name; each a number, or (m, 1) for m sets at once.
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
        rows = {f.name: getattr(self, f.name)[keep] for f in fields(self) if f.name != "asymmetry"}
        return replace(self, **rows)

    @property
    def tank(self) -> float:
        """Mean pressure of chambers that a stop holds empty, Pa."""
        return float(np.mean(self.stall[~self.filled]))

    @cached_property
    def commands(self) -> tuple[np.ndarray, np.ndarray]:
        """Each command once, (U,), and which of them each row has, (N,)."""
        volts, row = np.unique(self.volts, return_inverse=True)
        return volts, row

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

    @cached_property
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


def errors(seen: Observations, figure: Mapping[str, Any], orifices: bool, supply: float) -> dict[str, np.ndarray]:
    """Relative errors of speeds, errors of pressures over the supply, and of the contrast `EDGES`.

    Args:
        seen: N rows.
        figure: as `steady` takes them, those of causes that are not at work left out.
        orifices: whether flow goes with the root of the pressure drop.
        supply: pressure, Pa.

    Returns:
        (..., n) by channel: of speeds one per row, of a pressure one per row that recorded it, of edges one per
        condition; before that (m,) for m sets of figures.
    """
    volts, row = seen.commands
    found = steady(NOTHING | dict(figure), volts, orifices)
    error = {"speed": found.speed[..., row] / seen.speed - 1}
    for side in "ab":
        there = seen.side == side
        error[f"pressure_{side}"] = (found.pressure(side)[..., row[there]] - seen.pressure[there]) / supply
    out, back = ([int(np.searchsorted(volts, pair[k])) for pair in seen.both_ways] for k in (1, 2))
    speeds = found.speed[..., out], -found.speed[..., back]
    empty = found.pressure_b[..., out], found.pressure_a[..., back]
    return error | {EDGES: seen.contrast(speeds, empty) - seen.contrasts}


def averaged(seen: Observations, error: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """(..., 2) mean errors of speed and pressures, retracting and extending, so that replicates count once.

    Args:
        seen: of one condition.
        error: as `errors` has it.
    """
    found = {}
    for channel in CHANNELS:
        volts = seen.volts if channel == "speed" else seen.volts[seen.side == channel[-1]]
        means = [error[channel][..., np.sign(volts) == sign].mean(axis=-1) for sign in (-1, 1)]
        found[channel] = np.stack(means, axis=-1)
    return found


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
