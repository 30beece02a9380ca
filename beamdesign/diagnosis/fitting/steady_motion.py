"""Steady motion of a bench: found in its runs, predicted in closed form for any set of causes, and the difference."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from math import exp
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.stats import median_abs_deviation, theilslopes

from beamdesign.diagnosis.data.bench_set import BenchRun, BenchSet, held, stretches
from beamdesign.diagnosis.examination.sound_records import equal_runs
from beamdesign.plant.compiled import as_machine_code
from beamdesign.plant.effects import laws_of
from beamdesign.records import InputError

_MARGIN = 0.1  # of the travel next to either stop is left out
_BINS = 10  # the rest is looked at in as many parts
_LEAST_BINS = 4
_WITHIN = 4.0  # robust standard deviations by which a part may differ from the later half and still be steady
_STRAIGHT = 0.03  # a part whose speed differs by less counts as equal whatever the noise
_BLOCKS = 100


class SteadyMotion(NamedTuple):
    """Steady motion in one direction of one run, and where it ended.

    Attributes:
        condition: of the run.
        side: chamber whose pressure was recorded.
        direction: 1 extending, -1 retracting.
        command_V: while it moved.
        speed: m/s, positive extending, by Theil and Sen's median of slopes.
        pressure: Pa, median over that part.
        stall: Pa, median against the end stop.
        rest_m: reading of the displacement there.
    """

    condition: str
    side: str
    direction: int
    command_V: float
    speed: float
    pressure: float
    stall: float
    rest_m: float


def steady_motions(data: BenchSet) -> "Observations":
    """Steady motion of every run in both directions.

    Raises:
        InputError: where a run does not move steadily for long enough to tell its speed.
    """
    found = tuple(steady_motion(run, direction) for run in data.runs for direction in (1, -1))
    actuator = data.prototype.actuator
    return Observations(found, actuator.asymmetry, actuator.supply_pressure_Pa, data.prototype.servovalve.null_V)


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
    # A median over a short window takes out the sensor's spikes.
    smooth = median_filter(progress, max(5, len(progress) // 200) | 1, mode="nearest")
    begins = int(np.argmax(smooth > _MARGIN))
    ends = int(np.argmax(smooth > 1 - _MARGIN))
    if not smooth[0] < 0.5 or ends - begins < 2 * _BINS:
        raise InputError(run.name, [("displacement_m", f"no whole stroke {way_of(direction)} at {volts:g} V")])
    edges = np.linspace(begins + i, ends + i, _BINS + 1).astype(int)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    speeds = np.array([_slope(run, part) for part in parts])
    pressures = np.array([float(np.median(run.pressure_Pa[part])) for part in parts])
    alike = _like_later_half(speeds) & _like_later_half(pressures)
    first, count = max((run for run in equal_runs(alike, 1) if alike[run[0]]), key=lambda run: run[1], default=(0, 0))
    if count < _LEAST_BINS:
        raise InputError(run.name, [("displacement_m", f"no steady speed {way_of(direction)} at {volts:g} V")])
    part = slice(edges[first], edges[first + count])
    stop = held(run, direction)
    settled = (run.pressure_Pa[part], run.pressure_Pa[stop], run.displacement_m[stop])
    pressure, stall, rest = (float(np.median(values)) for values in settled)
    return SteadyMotion(run.condition, run.side, direction, volts, _slope(run, part), pressure, stall, rest)


def way_of(direction: int) -> str:
    """A direction in words."""
    return "extending" if direction > 0 else "retracting"


def _slope(run: BenchRun, part: slice) -> float:
    """Speed by medians of blocks, m/s: so every sample counts, and a spoilt one does not."""
    length = max(1, (part.stop - part.start) // _BLOCKS)
    blocks = slice(part.start, part.start + (part.stop - part.start) // length * length)
    at, times = (values[blocks].reshape(-1, length) for values in (run.displacement_m, run.times))
    return float(theilslopes(np.median(at, axis=1), times.mean(axis=1))[0])


def _like_later_half(values: np.ndarray) -> np.ndarray:
    later = values[_BINS // 2 :]
    middle = float(np.median(later))
    spread = max(float(median_abs_deviation(later, scale="normal")), _STRAIGHT / _WITHIN * abs(middle))
    return np.asarray(np.abs(values - middle) <= _WITHIN * spread)


_ROUNDS = 30
_SETTLED = 1e-6  # relative: Newton's next step would be of its square
_LEAST_A = 1e-9  # of a valve that is just not shut
_FRICTIONLESS = (("coulomb_N", 0.0), ("viscous_N_s_per_m", 0.0), ("breakaway_ratio", 1.0), ("stribeck_m_per_s", 1.0))


def steady(figure: Mapping[str, Any], volts: np.ndarray) -> dict[str, np.ndarray]:
    """Steady motion at constant commands.

    With orifices (`pressure_dependent_flow`), each edge passes q sqrt(2 dp / P_S), q being the flow of the opening at
    half the supply pressure, the lines lose pressure with the square of the flow, and both flows carry the piston:
    A_f p_f - A_e p_e = friction, f the side that fills and e the one that empties (Merritt 1967, chapters 5 and 6). A
    linear valve fills one side, the other empties as the piston drives it; of its pressures only the difference
    follows, and their sum is taken as supply plus tank, as leakage alike on all edges leaves it.

    Args:
        figure: parameters of the bench's equations and of the effects at work in them, by name as in
            `beamdesign.plant.bench_simulation.bench_parameters`; each a number, or (m, 1) for m sets at once.
        volts: (N,) commands from the null.

    Returns:
        (N,) each, or (m, N): `speed`, m/s, positive extending; `pressure_a` and `pressure_b`, Pa.
    """
    sign = np.where(volts < 0, -1.0, 1.0)
    area, asymmetry = figure["piston_area"], figure.get("unequal_piston_areas.asymmetry", 0.0)
    fills, empties = area * (1 + sign * asymmetry), area * (1 - sign * asymmetry)
    (supply, tank), flow = _pressures(figure), _rated_flow(figure, volts)
    leakage = figure["piston_leakage"]
    filling, drop = _lost(figure, volts)
    rubbing = [figure.get(f"seal_friction.{name}", none) for name, none in _FRICTIONLESS]
    given = (0.5 * flow / area, fills, empties, flow, filling, drop, supply, tank, leakage, sign)
    given = (*given, figure["constant_load"], *rubbing)
    each = np.empty((len(given), *np.broadcast_shapes(*map(np.shape, given))))
    for row, value in zip(each, given, strict=True):
        row[...] = value
    speed, full, empty = _balanced(_SUPPLY in figure, each.reshape(len(each), -1)).reshape(3, *each.shape[1:])
    extending = sign > 0
    pressures = np.where(extending, full, empty), np.where(extending, empty, full)
    return dict(zip(CHANNELS, (sign * speed, *pressures), strict=True))


@partial(as_machine_code, error_model="numpy")
def _balanced(orifices, given):  # type: ignore[no-untyped-def]
    """Where forces balance: (3, n) speeds without their sign, pressures of the side that fills and of the other one.

    Args:
        orifices: whether edges lose pressure with the square of the flow.
        given: (15, n) speeds to begin with, areas of either side, flow, pressure lost over its square on either side,
            supply, tank, leakage, 1 extending and -1 retracting, load, and figures of friction.
    """
    count = given.shape[1]
    found = np.zeros((3, count))
    past = np.zeros(count)  # the piston, from the side that fills
    for k in range(count):
        found[0, k] = given[0, k]
    for _ in range(_ROUNDS):
        settled = True
        for k in range(count):
            speed, lost = found[0, k], past[k]
            fills, empties, flow, filling, drop = given[1, k], given[2, k], given[3, k], given[4, k], given[5, k]
            supply, tank, leakage, sign, load = given[6, k], given[7, k], given[8, k], given[9, k], given[10, k]
            coulomb, viscous, ratio, stribeck = given[11, k], given[12, k], given[13, k], given[14, k]
            force = coulomb + viscous * speed + sign * load
            slope = viscous
            if ratio != 1.0:
                excess = (ratio - 1) * exp(-((speed / stribeck) ** 2))
                force = force + coulomb * excess
                slope = slope - coulomb * excess * 2 * speed / stribeck**2
            if orifices:
                into, out = fills * speed + lost, empties * speed + lost
                full = supply - filling * into * abs(into)
                empty = tank + drop * out * abs(out)
                falls, rises = -2 * filling * abs(into), 2 * drop * abs(out)
                # Newton's step in the speed and in the flow past the piston
                unbalanced, unmet = fills * full - empties * empty - force, leakage * (full - empty) - lost
                by_speed = fills**2 * falls - empties**2 * rises - slope
                by_past = fills * falls - empties * rises
                met_by_speed, met_by_past = leakage * by_past, leakage * (falls - rises) - 1
                determinant = by_speed * met_by_past - by_past * met_by_speed
                moved = speed - (met_by_past * unbalanced - by_past * unmet) / determinant
                lost = lost - (by_speed * unmet - met_by_speed * unbalanced) / determinant
                least, most = 0.1 * speed, 2 * flow / min(fills, empties)
            else:
                full = (force + empties * (supply + tank)) / (fills + empties)
                empty = supply + tank - full
                lost = leakage * (full - empty)
                least, most = 1e-9, np.inf
            # What is not a number stays so, as no comparison with it holds.
            lost = -flow if lost < -flow else flow if lost > flow else lost
            if not orifices:
                moved = (flow - lost) / fills
            moved = least if moved < least else moved
            moved = most if moved > most else moved
            settled = settled and abs(moved - speed) <= _SETTLED * speed
            found[0, k], found[1, k], found[2, k], past[k] = moved, full, empty, lost
        if settled:
            break
    return found


def stalled(figure: Mapping[str, Any], volts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressures, Pa, of the chambers that fill and empty against a stop; arguments as of `steady`.

    Nothing flows there but what passes the piston, and orifices take their share of the pressure for that. A linear
    valve heeds none.
    """
    supply, tank = _pressures(figure)
    filling, drop = _lost(figure, volts) if _SUPPLY in figure else (0.0, 0.0)
    leakage = figure["piston_leakage"]
    # The difference d solves (filling + drop) (leakage d)^2 + d = supply - tank.
    difference = 2 * (supply - tank) / (1 + np.sqrt(1 + 4 * (filling + drop) * leakage**2 * (supply - tank)))
    past = leakage * difference
    return supply - filling * past**2, tank + drop * past**2


_SUPPLY = "pressure_dependent_flow.supply_pressure_Pa"


def _pressures(figure: Mapping[str, Any]) -> tuple[Any, Any]:
    """Of supply and tank, Pa."""
    return figure.get(_SUPPLY, figure["supply_pressure"]), figure["tank_pressure"]


def _rated_flow(figure: Mapping[str, Any], volts: np.ndarray) -> Any:
    """Flow through an edge at half the supply pressure, m3/s."""
    overlaps = (figure.get(f"{law}.half_width_A") for law in laws_of("valve_deadband"))
    lapped = next((overlap for overlap in overlaps if overlap is not None), 0.0)
    return figure["flow_gain"] * np.maximum(np.abs(figure["gain"] * volts) - lapped, _LEAST_A)


def _lost(figure: Mapping[str, Any], volts: np.ndarray) -> tuple[Any, Any]:
    """Pressure lost over flow squared, on the way to the chamber that fills and from the one that empties."""
    (supply, _), flow, line = _pressures(figure), _rated_flow(figure, volts), figure["line_loss"]
    filling = flow * np.where(volts < 0, figure["edge_b"], 1.0)
    return supply / 2 / filling**2 + line, supply / 2 / flow**2 + line


CHANNELS = ("speed", "pressure_a", "pressure_b")
EDGES = "edges"
"""One more channel, a contrast in which command, flow gain and deadband cancel: the logarithm of flow over root of
pressure at the edge that empties, extending over retracting."""
NO_REPLICATE = 0.01
"""Deviation taken where nothing was repeated."""
_LEAST_DROP_PA = 1e3
_GAUGES = 0.01  # of the supply: by as much two gauges may differ


@dataclass(frozen=True)
class Observations:
    """Steady motions as numbers, one row per run and direction.

    Attributes:
        motions: N of them.
        asymmetry: of the piston by bore and rod.
        supply_Pa: pressure that was believed.
        null_V: from which commands count.
    """

    motions: tuple[SteadyMotion, ...]
    asymmetry: float
    supply_Pa: float
    null_V: float

    @cached_property
    def rows(self) -> Any:
        """The same by columns: what each motion has of an attribute, (N,) each."""
        return SteadyMotion(*(np.array(column) for column in zip(*self.motions, strict=True)))  # type: ignore[arg-type]

    @cached_property
    def timed(self) -> np.ndarray:
        """(N,) whether its speed counts: that of a run which recorded both chambers does once."""
        first = {(m.condition, m.speed): k for k, m in reversed([*enumerate(self.motions)])}
        return np.isin(np.arange(len(self.motions)), [*first.values()])

    @cached_property
    def volts(self) -> np.ndarray:
        """(N,) commands from the null."""
        return np.asarray(self.rows.command_V - self.null_V)

    @cached_property
    def filled(self) -> np.ndarray:
        """(N,) whether the chamber that was recorded is the one at supply pressure, against the stop."""
        return (self.rows.direction > 0) == (self.rows.side == "a")

    @property
    def conditions(self) -> tuple[str, ...]:
        """In order of appearance."""
        return tuple(dict.fromkeys(m.condition for m in self.motions))

    def of(self, conditions: Sequence[str]) -> "Observations":
        """Those of some conditions."""
        return replace(self, motions=tuple(m for m in self.motions if m.condition in conditions))

    @cached_property
    def tank(self) -> float:
        """Mean pressure of chambers that a stop holds empty, Pa."""
        return float(np.mean(self.rows.stall[~self.filled]))

    @cached_property
    def gauges_apart_Pa(self) -> tuple[float, float]:
        """By how much chamber a reads more than b at a stop, at supply and at tank."""
        side, stall = self.rows.side, self.rows.stall
        means = [[float(np.mean(stall[(self.filled == full) & (side == of)])) for full in (True, False)] for of in "ab"]
        return means[0][0] - means[1][0], means[0][1] - means[1][1]

    @cached_property
    def gauges_differ_Pa(self) -> float:
        """By how much chamber a reads more than b at supply and tank alike; 0 within what gauges err."""
        full, empty = self.gauges_apart_Pa
        alike = full * empty > 0 and min(abs(full), abs(empty)) > _GAUGES * self.supply_Pa
        return (full + empty) / 2 if alike else 0.0

    def mean(self, column: str, condition: str, direction: int, sides: str = "ab") -> float:
        """Of a column of `rows`, over the runs of a condition in one direction that recorded one of these chambers."""
        rows = self.rows
        at = (rows.condition == condition) & (rows.direction == direction) & np.isin(rows.side, list(sides))
        return float(np.mean(getattr(rows, column)[at]))

    @cached_property
    def both_ways(self) -> tuple[np.ndarray, np.ndarray]:
        """A row with the command that each condition has out, and one with that back."""
        volts = [[self.mean("command_V", c, way) - self.null_V for c in self.conditions] for way in (1, -1)]
        out, back = (np.abs(np.subtract.outer(own, self.volts)).argmin(axis=1) for own in volts)
        return out, back

    def contrast(self, speeds: tuple[Any, Any], empty: tuple[Any, Any]) -> Any:
        """The channel `EDGES` from speeds (m/s, both positive) and pressures of the emptying chambers, out and back."""
        areas = np.log((1 - self.asymmetry) / (1 + self.asymmetry))
        drops = [np.maximum(pressure - self.tank, _LEAST_DROP_PA) for pressure in empty]
        return areas + np.log(speeds[0] / speeds[1]) - 0.5 * np.log(drops[0] / drops[1])

    @cached_property
    def contrasts(self) -> np.ndarray:
        """Measured, one per condition."""
        found = []
        for c in self.conditions:
            speeds = self.mean("speed", c, 1), -self.mean("speed", c, -1)
            found.append(self.contrast(speeds, (self.mean("pressure", c, 1, "b"), self.mean("pressure", c, -1, "a"))))
        return np.array(found)

    def spread(self, condition: str, channel: str) -> tuple[float, int]:
        """Sum of squares of single runs about their mean in each direction, and its degrees of freedom."""
        squares, freedom, rows, timed = 0.0, 0, self.rows, channel == "speed"
        column, counts = (rows.speed, self.timed) if timed else (rows.pressure, rows.side == channel[-1])
        for way in (-1, 1):
            values = column[(rows.condition == condition) & (rows.direction == way) & counts]
            values = values / (np.mean(values) if timed else self.supply_Pa)
            squares += float(np.sum((values - np.mean(values)) ** 2)) if len(values) else 0.0
            freedom += max(len(values) - 1, 0)
        return squares, freedom

    @cached_property
    def scatter(self) -> dict[str, float]:
        """Standard deviation of single runs about the mean of their condition and direction, in units of `averaged`."""
        found = {c: np.sum([self.spread(each, c) for each in self.conditions], axis=0) for c in CHANNELS}
        deviation = {c: float(s / n) ** 0.5 if n else NO_REPLICATE for c, (s, n) in found.items()}
        # Of a contrast between means over the runs of two directions.
        runs = np.count_nonzero(self.timed) / (2 * len(self.conditions))
        return deviation | {EDGES: deviation["speed"] * (2 / max(runs, 1)) ** 0.5}


def averaged(seen: Observations, error: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """(..., 2) mean errors of speed and pressures, retracting and extending, so that replicates count once.

    Args:
        seen: of one condition.
        error: as `errors` has it.
    """
    found, rows = {}, seen.rows
    for channel in CHANNELS:
        way = rows.direction[seen.timed if channel == "speed" else rows.side == channel[-1]]
        found[channel] = np.stack([error[channel][..., way == sign].mean(axis=-1) for sign in (-1, 1)], axis=-1)
    return found
