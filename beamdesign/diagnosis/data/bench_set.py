"""What came back from an actuator bench: runs out and back between the end stops, with pressures of the chambers.

A data set of this kind names `rig = "actuator_bench"`, and per record its `condition` and `replicate`. Both chambers of
one condition come from one run or from two.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.ndimage import median_filter

from beamdesign import records
from beamdesign.arguments import takes
from beamdesign.bench_prototype import BenchPrototype, read_bench_prototype
from beamdesign.columns import read_columns, refuse_missing, uniform_times
from beamdesign.diagnosis.data.dataset_index import SetFile, index_of, wrong_files
from beamdesign.diagnosis.data.measured_files import UNITS
from beamdesign.diagnosis.examination.sound_records import equal_runs
from beamdesign.records import FileName, InputError, Problem, Record
from beamdesign.result import Result

LEAST_SAMPLES = 200
_STEP = 3.0
_LONGEST_S = 0.5  # between samples: a steady speed asks for no rate, and 1 kHz in ms is steps of 1
_ONE_COMMAND = 0.05
"""Relative difference of commands of one condition."""
_CLIPPED = 0.02  # share of samples that hold the very same extreme value
_SLOW = 500  # times as long as without load: a thousand times in mV, and overlap leaves of a speed what it may
_SCALES = {1 / UNITS["Pa"][unit]: unit for unit in ("MPa", "bar", "kPa", "psi")}


@dataclass(frozen=True)
class BenchRun:
    """One run, as far as one chamber tells; a file with the pressures of both gives two.

    Attributes:
        name: file name without its ending.
        condition: as the data set calls it.
        replicate: number within the condition.
        side: `a` or `b`, the chamber whose pressure was recorded.
        times: (N,) s, uniform.
        command_V: (N,).
        displacement_m: (N,).
        pressure_Pa: (N,) of that chamber.
    """

    name: str
    condition: str
    replicate: int
    side: str
    times: np.ndarray = field(repr=False)
    command_V: np.ndarray = field(repr=False)
    displacement_m: np.ndarray = field(repr=False)
    pressure_Pa: np.ndarray = field(repr=False)

    @property
    def channels(self) -> dict[str, np.ndarray]:
        """(N,) what was measured, by column."""
        return {"displacement_m": self.displacement_m, f"pressure_{self.side}_Pa": self.pressure_Pa}


@dataclass(frozen=True, repr=False)
class BenchSet(Result):
    """All runs of a bench with the prototype that was believed.

    Attributes:
        name: of the set.
        prototype: the model that was believed.
        runs: in the order of the file.
        warnings: what is odd about them, in words.
        doubtful: whether runs of one condition contradict one another.
    """

    name: str
    prototype: BenchPrototype
    runs: tuple[BenchRun, ...]
    warnings: tuple[str, ...] = ()
    doubtful: bool = False

    @property
    def status(self) -> str:
        """How many conditions there are."""
        return f"{len({run.condition for run in self.runs})} conditions"

    def rows(self) -> list[tuple[str, str, str]]:
        """What was measured under which command: for people."""
        sizes = (f"{len(run.times)} samples, {np.ptp(run.times):.4g} s" for run in self.runs)
        taken = (f"{run.condition}, replicate {run.replicate}, chamber {run.side}" for run in self.runs)
        names = (run.name for run in self.runs)
        return [*zip(names, sizes, taken, strict=True), *(("warning", words, "") for words in self.warnings)]


class _Entry(Record):
    file: Annotated[
        FileName,
        Field(
            description="CSV file beside dataset.toml: t_s, command_V, displacement_m and pressure_a_Pa, pressure_b_Pa"
            " or one of these"
        ),
    ]
    condition: Annotated[str, Field(min_length=1, description="what the runs that belong together have in common")]
    replicate: Annotated[int, Field(ge=0, description="number of the run within its condition")] = 1


class _File(SetFile):
    rig: Annotated[str, Field(description="kind of rig it came from: actuator_bench")]
    record: Annotated[tuple[_Entry, ...], Field(min_length=1, description="one run out or back each")]


@takes()
def read_bench_set(folder: str | Path) -> BenchSet:
    """Read the data set of a bench from its folder (or from its dataset.toml).

    Raises:
        InputError: with everything wrong in dataset.toml, or with the first record that cannot be used: missing
            columns, figures that are not finite, times that are not uniform, units out of scale, a chamber or a
            direction that contradicts the command.
    """
    path = index_of(Path(folder))
    entry = records.read(_File, path)
    if entry.rig != "actuator_bench":
        raise InputError(path, [("rig", f"{entry.rig!r} is not a bench; expected 'actuator_bench'")])
    if wrong := wrong_files("record.file", [row.file for row in entry.record], path.parent):
        raise InputError(path, wrong)
    prototype = read_bench_prototype(path.parent / entry.prototype)
    runs = tuple(run for row in entry.record for run in _runs(path.parent / row.file, row, prototype))
    taken = Counter((run.condition, run.replicate, run.side) for run in runs)
    if twice := [each for each, count in taken.items() if count > 1]:
        raise InputError(path, [("record", f"{c}, replicate {r}, chamber {s} stands twice") for c, r, s in twice])
    conditions = dict.fromkeys(run.condition for run in runs)
    there = {(run.condition, run.side) for run in runs}
    lacking = (each for each in product(conditions, "ab") if each not in there)
    unseen = (f"{condition} has no run with the pressure of chamber {side}" for condition, side in lacking)
    alone = [Problem("record.condition", reason) for reason in unseen]
    if len(conditions) < 2:
        alone.append(Problem("record.condition", "one condition only; what is held out of a fit must be another one"))
    for condition, sign in product(conditions, (1, -1)):
        volts = [_last(run, sign)[2] for run in runs if run.condition == condition]
        if np.ptp(volts) > _ONE_COMMAND * np.max(np.abs(volts)):
            words = f"{condition} has runs at {min(volts):g} and at {max(volts):g} V"
            alone.append(Problem("record.condition", f"{words}; what belongs together has one command"))
    if alone:
        raise InputError(path, alone)
    return BenchSet(entry.name, prototype, runs, tuple(dict.fromkeys(words for run in runs for words in _odd(run))))


def stretches(command_V: np.ndarray) -> list[tuple[int, int, float]]:
    """Where the command stays at one value other than zero: first sample, sample after the last, volts."""
    found = equal_runs(command_V, LEAST_SAMPLES // 4)
    return [(i, i + count, float(command_V[i])) for i, count in found if command_V[i] != 0]


def held_commands(command_V: np.ndarray) -> np.ndarray:
    """(N,) a command without the noise and the spikes of what recorded it, as it is held.

    It is taken to step where it changes from one sample to the next by more than `_STEP` times as much as nearly
    always, and to stay at the median of what lies between; one that does not step both ways so is left as it is.
    """
    calm = np.asarray(median_filter(command_V, 5, mode="nearest"))
    moves = np.abs(np.diff(calm))
    usual, levels = _STEP * float(np.quantile(moves, 0.99)), [np.zeros(0)]
    for piece in np.split(calm, np.flatnonzero(moves > usual) + 1):
        level = float(np.median(piece))
        alike = (each for each in (0.0, *levels[-1][-1:]) if abs(level - each) <= usual)
        levels.append(np.full(len(piece), next(alike, level)))
    levelled = np.concatenate(levels)
    return levelled if {np.sign(volts) for _, _, volts in stretches(levelled)} >= {1, -1} else command_V


def _last(run: BenchRun, sign: int) -> tuple[int, int, float]:
    """The last stretch with commands of one sign."""
    return [each for each in stretches(run.command_V) if each[2] * sign > 0][-1]


def held(run: BenchRun, sign: int) -> slice:
    """The last fifth of the last stretch with commands of one sign, where the piston rests against its stop."""
    i, j, _ = _last(run, sign)
    return slice(j - max(1, (j - i) // 5), j)


def _runs(path: Path, row: _Entry, prototype: BenchPrototype) -> list[BenchRun]:
    columns = read_columns(path)
    refuse_missing(path, ("t_s", "command_V", "displacement_m"), columns)
    sides = [side for side in "ab" if f"pressure_{side}_Pa" in columns]
    if not sides:
        reason = "neither of pressure_a_Pa and pressure_b_Pa; a run records one or both"
        raise InputError(path, [("pressure_a_Pa", reason)])
    times = uniform_times(path, columns["t_s"], _LONGEST_S)
    moved = times, held_commands(columns["command_V"]), columns["displacement_m"]
    named = path.stem, row.condition, row.replicate
    runs = [BenchRun(*named, side, *moved, columns[f"pressure_{side}_Pa"]) for side in sides]
    if problems := list(dict.fromkeys(problem for run in runs for problem in _contradictions(run, prototype))):
        raise InputError(path, problems)
    return runs


def _contradictions(run: BenchRun, prototype: BenchPrototype) -> list[Problem]:
    """What cannot be of this bench."""
    if len(run.times) < LEAST_SAMPLES:
        return [Problem("t_s", f"too short: {len(run.times)} samples, at least {LEAST_SAMPLES} are needed")]
    signs = {int(np.sign(volts)) for _, _, volts in stretches(run.command_V)}
    if signs != {1, -1}:
        return [Problem("command_V", "needs one stretch of constant positive and one of constant negative command")]
    found, stroke = [], prototype.actuator.stroke_m
    out, back = (float(np.median(run.displacement_m[held(run, sign)])) for sign in (1, -1))
    travel = out - back
    if travel < 0:
        found.append(Problem("displacement_m", "falls under positive commands: turned round, or the command is"))
    elif travel > 20 * stroke:
        found.append(Problem("displacement_m", f"travels {travel:.3g} m of {stroke:g} m: in mm, it seems"))
    elif not 0.5 * stroke < travel < 1.2 * stroke:
        words = f"travels {travel:.3g} m; the stroke is {stroke:g} m from stop to stop"
        found.append(Problem("displacement_m", words))
    else:
        i, j, volts = _last(run, 1)
        between = np.abs(run.displacement_m[i:j] - (out + back) / 2) < travel / 4
        took_s = np.count_nonzero(between) * (run.times[1] - run.times[0])
        volume = travel / 2 * prototype.actuator.piston_area_m2
        takes_s = volume / (prototype.servovalve.flow_gain_m3_per_s_per_V * volts)
        if took_s > _SLOW * takes_s:
            words = f"by which half the way takes {takes_s:.3g} s and not {took_s:.3g} s: in mV, or t_s in ms, it seems"
            found.append(Problem("command_V", f"stays at {volts:.3g} V, {words}"))
    key, supply = f"pressure_{run.side}_Pa", prototype.actuator.supply_pressure_Pa
    extended, retracted = (float(np.median(run.pressure_Pa[held(run, sign)])) for sign in (1, -1))
    top = max(extended, retracted)
    if top < 0.05 * supply:
        scale = min(_SCALES, key=lambda s: abs(np.log(max(abs(top), 1e-12) / (s * supply))))
        found.append(Problem(key, f"reaches {top:.3g} of {supply:.3g} Pa supply: in {_SCALES[scale]}, it seems"))
    elif (extended > retracted) != (run.side == "a"):
        where = "extended" if extended > retracted else "retracted"
        other = "b" if run.side == "a" else "a"
        found.append(Problem(key, f"is at supply pressure where the piston is held {where}: that is chamber {other}"))
    elif not 0.5 * supply < top < 1.5 * supply:
        found.append(Problem(key, f"reaches {top:.3g} Pa against a stop; the supply is {supply:.3g} Pa"))
    return found


def saturates_at(data: BenchSet) -> float | None:
    """Reading (m) at which the displacement of any run is clipped; None where it is of none."""
    found = [run.displacement_m for run in data.runs]
    return max((float(x.max()) for x in found if _clipped(x, float(x.max()))), default=None)


def _clipped(values: np.ndarray, extreme: float) -> bool:
    return bool(np.mean(values == extreme) > _CLIPPED)


def _odd(run: BenchRun) -> Iterator[str]:
    """What is odd about a run, in words."""
    for name, values in run.channels.items():
        for extreme in (float(values.max()), float(values.min())):
            if _clipped(values, extreme):
                share = 100 * float(np.mean(values == extreme))
                yield f"{run.name}: {name} is clipped at {extreme:g} ({share:.0f} % of its samples)"


def runs_of(tables: Mapping[str, Mapping[str, np.ndarray]]) -> list[dict[str, object]]:
    """Entries of the runs of a bench: those with the same commands out and back are replicates of one condition."""
    found, conditions, count = list[dict[str, object]](), dict[str, tuple[float, ...]](), Counter[tuple[str, str]]()
    for file, table in tables.items():
        last = {volts > 0: volts for _, _, volts in stretches(held_commands(table["command_V"]))}
        own = tuple(float(f"{last.get(way, 0.0):.3g}") for way in (True, False))
        alike = (name for name, volts in conditions.items() if np.allclose(own, volts, rtol=_ONE_COMMAND / 2))
        name = next(alike, f"{own[0]:g} V" if own[0] == -own[1] else f"{own[0]:g} V out, {own[1]:g} V back")
        conditions.setdefault(name, own)
        each = [(name, column) for column in table if column.startswith("pressure")]
        count.update(each)
        found.append({"file": file, "condition": name, "replicate": max((count[one] for one in each), default=1)})
    return found
