"""A data set: what came back from a rig, with the prototype that was believed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from beamdesign import records
from beamdesign.prototype import Controller, Prototype, read_prototype
from beamdesign.records import InputError, NonNegative, Positive, Problem, Record

INPUTS = ("disturbance_N", "command_V")
MEASURED = ("current_A", "displacement_m")
MORE_MEASURED = ("load_pressure_Pa", "inner_displacement_m")
_UNEVEN = 1e-3  # of a sample interval


@dataclass(frozen=True)
class TimeRecord:
    """One time record.

    Attributes:
        name: file name without its ending.
        times: (N,) s, uniform.
        inputs: (N, 2) columns as in `INPUTS`.
        measured: (N,) each, by channel: `current_A`, `displacement_m` and those of `MORE_MEASURED` that were recorded.
        outer_end_mass: payload, kg.
        inner_end_mass: kg, added to the inner tip.
        controller: of the loop while it was taken.
    """

    name: str
    times: np.ndarray = field(repr=False)
    inputs: np.ndarray = field(repr=False)
    measured: Mapping[str, np.ndarray] = field(repr=False)
    outer_end_mass: float
    inner_end_mass: float
    controller: Controller

    @property
    def step(self) -> float:
        """Sampling interval, s."""
        return float(self.times[-1] - self.times[0]) / (len(self.times) - 1)

    @cached_property
    def excitation(self) -> str:
        """Which input drives it: `command`, `disturbance`, `both` or `none`.

        A force that is only the noise of its sensor drives nothing: it counts from a tenth of what would hold the
        beam where the command asks it to be.
        """
        disturbance, command = (float(np.std(self.inputs[:, k])) for k in (0, 1))
        forced, commanded = disturbance > _FORCE_NOISE_N, command > 0
        return {(1, 1): "both", (1, 0): "disturbance", (0, 1): "command", (0, 0): "none"}[forced, commanded]

    @cached_property
    def condition(self) -> tuple[Any, ...]:
        """What the rig was asked to do, apart from the run of the input: masses, controller, excitation, its size.

        Sizes count as one condition within a factor of two.
        """
        column = 1 if self.excitation == "command" else 0
        rms = float(np.sqrt(np.mean(self.inputs[:, column] ** 2)))
        size = round(float(np.log2(rms))) if rms > 0 else None
        return (self.outer_end_mass, self.inner_end_mass, self.controller, self.excitation, size)


_FORCE_NOISE_N = 3.0


@dataclass(frozen=True)
class FrequencyResponse:
    """Closed-loop compliance |x/F_d| of the outer tip, measured at lines.

    Attributes:
        name: file name without its ending.
        frequencies_Hz: (N,) rising.
        response: (N,) complex where the phase was measured, else its magnitude; m/N.
        has_phase: whether it was.
        amplitude_N: of the force.
        outer_end_mass: payload, kg.
        inner_end_mass: kg.
        controller: of the loop.
    """

    name: str
    frequencies_Hz: np.ndarray = field(repr=False)
    response: np.ndarray = field(repr=False)
    has_phase: bool
    amplitude_N: float
    outer_end_mass: float
    inner_end_mass: float
    controller: Controller


@dataclass(frozen=True)
class MeasuredGain:
    """A gain at which sustained oscillation set in.

    Attributes:
        controller: with that gain.
        outer_end_mass: payload, kg.
        inner_end_mass: kg.
        relative_std: of the gain.
        frequency_Hz: of the oscillation, where it was noted.
    """

    controller: Controller
    outer_end_mass: float
    inner_end_mass: float
    relative_std: float
    frequency_Hz: float | None = None

    @property
    def gain(self) -> float:
        """A/V."""
        return self.controller.gain_A_per_V


@dataclass(frozen=True)
class Dataset:
    """Everything that came back.

    Attributes:
        name: of the set.
        folder: where it was read from.
        prototype: the model that was believed.
        records: time records.
        responses: frequency responses.
        gains: critical gains.
        warnings: what was left aside while reading, in words.
    """

    name: str
    folder: Path
    prototype: Prototype
    records: tuple[TimeRecord, ...] = ()
    responses: tuple[FrequencyResponse, ...] = ()
    gains: tuple[MeasuredGain, ...] = ()
    warnings: tuple[str, ...] = ()


class _Taken(Record):
    """What every entry of a data set says of the rig at that time."""

    outer_end_mass_kg: NonNegative = 0.0
    inner_end_mass_kg: NonNegative = 0.0


class _TimeEntry(_Taken):
    file: str
    controller: Controller | None = None


class _ResponseEntry(_Taken):
    file: str
    controller: Controller | None = None
    amplitude_N: Positive = 1.0


class _GainEntry(_Taken):
    controller: dict[str, Any] | None = None
    gain_A_per_V: Positive
    relative_std: Annotated[Positive, Field(le=1)] = 0.03
    frequency_Hz: Positive | None = None


class _Gained(Record):
    """A controller with the critical gain put in."""

    controller: Controller


class _DatasetFile(Record):
    name: str = "data set"
    rig: str = "twin_beam"
    prototype: str = "prototype.toml"
    record: tuple[_TimeEntry, ...] = ()
    frequency_response: tuple[_ResponseEntry, ...] = ()
    critical_gain: tuple[_GainEntry, ...] = ()


def kind_of(folder: str | Path) -> str:
    """Kind of rig a data set came from: `twin_beam` or `actuator_bench`.

    Raises:
        InputError: where the folder holds no readable dataset.toml.
    """
    return str(records.read_table(_index(Path(folder))).get("rig", "twin_beam"))


def read_dataset(folder: str | Path) -> Dataset:
    """Read a data set from its folder (or from its dataset.toml).

    Keys that this version does not know are left aside with a warning.

    Raises:
        InputError: with everything wrong in dataset.toml, or in the first record that cannot be used: file, column,
            row and reason.
    """
    path = _index(Path(folder))
    table, warnings = _known_keys(records.read_table(path))
    entry = records.parse(_DatasetFile, table, path)
    if entry.rig != "twin_beam":
        raise InputError(path, [("rig", f"{entry.rig!r} is not a rig this reader knows; expected 'twin_beam'")])
    prototype = read_prototype(path.parent / entry.prototype)
    problems = list(_missing_controllers(entry, prototype))
    if not (entry.record or entry.frequency_response or entry.critical_gain):
        problems.append(Problem("record", "the set holds no record, no frequency_response and no critical_gain"))
    if problems:
        raise InputError(path, problems)

    def controller(given: Controller | None) -> Controller:
        chosen = given or prototype.controller
        assert chosen is not None  # checked above
        return chosen

    taken = tuple(
        _time_record(path.parent / row.file, row, controller(row.controller), warnings) for row in entry.record
    )
    responses = tuple(
        _response(path.parent / row.file, row, controller(row.controller)) for row in entry.frequency_response
    )
    gains = tuple(_measured_gain(row, prototype, path) for row in entry.critical_gain)
    return Dataset(entry.name, path.parent, prototype, taken, responses, gains, tuple(warnings))


def _index(folder: Path) -> Path:
    return folder if folder.is_file() else folder / "dataset.toml"


def _known_keys(table: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Integers become floats where figures are meant; unknown keys go, each with a warning."""
    warnings: list[str] = []
    shapes: dict[str, type[Record]] = {
        "record": _TimeEntry,
        "frequency_response": _ResponseEntry,
        "critical_gain": _GainEntry,
    }
    kept: dict[str, Any] = {}
    for key, value in table.items():
        if key not in _DatasetFile.model_fields:
            warnings.append(f"dataset.toml: key {key} is not known here and was left aside")
        elif key in shapes and isinstance(value, list):
            rows = []
            for row in value:
                unknown = [k for k in row if k not in shapes[key].model_fields] if isinstance(row, dict) else []
                warnings += [f"dataset.toml: {key}.{k} is not known here and was left aside" for k in unknown]
                rows.append({k: v for k, v in row.items() if k not in unknown} if unknown else row)
            kept[key] = rows
        else:
            kept[key] = value
    return kept, list(dict.fromkeys(warnings))


def _missing_controllers(entry: _DatasetFile, prototype: Prototype) -> list[Problem]:
    rows = [("record", r) for r in entry.record] + [("frequency_response", r) for r in entry.frequency_response]
    if prototype.controller is not None:
        return []
    return [
        Problem(f"{kind}.controller", f"missing for {row.file}, and the prototype has none")
        for kind, row in rows
        if row.controller is None
    ]


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Read a CSV file of numbers with one line of column names.

    Raises:
        InputError: naming file, column and row where something is not a finite number, or where the file has no rows.
    """
    try:
        with open(path, encoding="utf-8-sig") as file:
            names = [name.strip() for name in file.readline().split(",")]
            body = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, [("(file)", getattr(error, "strerror", None) or str(error))]) from error
    lines = [line for line in body.splitlines() if line.strip()]
    if not lines:
        raise InputError(path, [("(file)", "holds no rows")])
    try:
        values = np.array([line.split(",") for line in lines], dtype=float)
    except ValueError:
        raise InputError(path, _bad_cells(names, lines)) from None
    if values.shape[1] != len(names):
        raise InputError(path, [("(file)", f"{len(names)} column names but {values.shape[1]} columns")])
    wrong = []
    for k, name in enumerate(names):
        bad = np.nonzero(~np.isfinite(values[:, k]))[0]
        if len(bad):
            wrong.append(Problem(name, f"{len(bad)} values are not finite, the first in row {bad[0] + 2}"))
    if wrong:
        raise InputError(path, wrong)
    return {name: values[:, k].copy() for k, name in enumerate(names)}


def _bad_cells(names: list[str], lines: list[str]) -> list[Problem]:
    for row, line in enumerate(lines, start=2):
        cells = line.split(",")
        if len(cells) != len(names):
            return [Problem("(file)", f"row {row} has {len(cells)} cells, the header {len(names)}")]
        for name, cell in zip(names, cells, strict=True):
            try:
                float(cell)
            except ValueError:
                shown = cell.strip() or "empty"
                return [Problem(name, f"row {row} is not a number: {shown}")]
    return [Problem("(file)", "cannot be read as numbers")]


def uniform_times(path: Path, times: np.ndarray) -> None:
    """Refuse times that do not rise in equal steps.

    Raises:
        InputError: naming the first row at which they do not.
    """
    if len(times) < 3:
        raise InputError(path, [("t_s", f"too short: {len(times)} samples")])
    steps = np.diff(times)
    typical = float(np.median(steps))
    if typical <= 0:
        raise InputError(path, [("t_s", "does not rise")])
    # Times are written with few digits: what counts is how far a sample is from where it should be.
    should = times[0] + typical * np.arange(len(times))
    drift = (times[-1] - should[-1]) / max(len(times) - 1, 1)
    off = np.abs(times - should - drift * np.arange(len(times)))
    bad = np.nonzero(off > max(0.26, _UNEVEN) * typical)[0]
    if len(bad):
        row = int(bad[0]) + 2
        raise InputError(
            path, [("t_s", f"not uniform: row {row} is {off[bad[0]] / typical:.2g} samples off its place")]
        )


def _time_record(path: Path, row: _TimeEntry, controller: Controller, warnings: list[str]) -> TimeRecord:
    columns = read_columns(path)
    needed = ("t_s", *INPUTS, *MEASURED)
    missing = [name for name in needed if name not in columns]
    if missing:
        held = ", ".join(columns)
        raise InputError(path, [(name, f"column missing; the file has {held}") for name in missing])
    uniform_times(path, columns["t_s"])
    known = (*needed, *MORE_MEASURED)
    warnings += [
        f"{path.name}: column {name} is not known here and was left aside" for name in columns if name not in known
    ]
    measured = {name: columns[name] for name in (*MEASURED, *MORE_MEASURED) if name in columns}
    inputs = np.column_stack([columns[name] for name in INPUTS])
    times = columns["t_s"]
    times = np.linspace(times[0], times[-1], len(times))
    return TimeRecord(path.stem, times, inputs, measured, row.outer_end_mass_kg, row.inner_end_mass_kg, controller)


def _response(path: Path, row: _ResponseEntry, controller: Controller) -> FrequencyResponse:
    columns = read_columns(path)
    missing = [name for name in ("frequency_Hz", "magnitude_m_per_N") if name not in columns]
    if missing:
        raise InputError(path, [(name, f"column missing; the file has {', '.join(columns)}") for name in missing])
    frequencies, magnitude = columns["frequency_Hz"], columns["magnitude_m_per_N"]
    wrong = []
    if np.any(np.diff(frequencies) <= 0) or frequencies[0] <= 0:
        wrong.append(Problem("frequency_Hz", "must be positive and rise from row to row"))
    if np.any(magnitude <= 0):
        wrong.append(Problem("magnitude_m_per_N", "must be positive"))
    if wrong:
        raise InputError(path, wrong)
    phase = columns.get("phase_deg")
    response = magnitude if phase is None else magnitude * np.exp(1j * np.deg2rad(phase))
    return FrequencyResponse(
        path.stem,
        frequencies,
        response,
        phase is not None,
        row.amplitude_N,
        row.outer_end_mass_kg,
        row.inner_end_mass_kg,
        controller,
    )


def _measured_gain(row: _GainEntry, prototype: Prototype, path: Path) -> MeasuredGain:
    if row.controller is None:
        given = prototype.controller.model_dump() if prototype.controller is not None else {"kind": "proportional"}
    else:
        given = dict(row.controller)
    table = {"controller": given | {"gain_A_per_V": row.gain_A_per_V}}
    found = records.parse(_Gained, table, path).controller
    return MeasuredGain(found, row.outer_end_mass_kg, row.inner_end_mass_kg, row.relative_std, row.frequency_Hz)
