"""A data set: what came back from a rig, with the prototype that was believed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from beamdesign import records
from beamdesign.arguments import takes
from beamdesign.columns import read_columns, refuse_missing, uniform_times
from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset_index import (
    OFF,
    GainEntry,
    ResponseEntry,
    Taken,
    TimeEntry,
    index_of,
    read_index,
)
from beamdesign.diagnosis.data.input_noise import denoised, is_answered
from beamdesign.diagnosis.data.stamps import refuse_uneven
from beamdesign.plant.actuators import not_felt
from beamdesign.plant.assembly import wrong_effects
from beamdesign.prototype import Prototype, read_prototype
from beamdesign.quantities import quantity
from beamdesign.records import InputError, Problem, Record
from beamdesign.result import Result
from beamdesign.structure.arm import arm_of, in_plane, lever_figures

INPUTS = ("disturbance_N", "command_V")
MEASURED = ("current_A", "displacement_m")
MAGNITUDES = ("magnitude_m_per_N", "magnitude_m_per_V")
"""Of a frequency response, by which of `INPUTS` drove it."""
_EDGE_S = 5e-3


@dataclass(frozen=True)
class TimeRecord:
    """One time record.

    Attributes:
        name: file name without its ending.
        times: (N,) s, uniform.
        inputs: (N, 2) columns as in `INPUTS`.
        measured: (N,) each, by channel: `displacement_m`, and `current_A`, what the actuator feels and
            `inner_displacement_m` where these were recorded.
        outer_end_mass: payload, kg.
        inner_end_mass: kg, added to the inner tip.
        controller: of the loop while it was taken.
        source: file it was read from.
        left_out: spans in s, each a beginning and an end, that do not count.
    """

    name: str
    times: np.ndarray = field(repr=False)
    inputs: np.ndarray = field(repr=False)
    measured: Mapping[str, np.ndarray] = field(repr=False)
    outer_end_mass: float
    inner_end_mass: float
    controller: Controller
    source: str = ""
    left_out: tuple[tuple[float, float], ...] = ()

    @property
    def step(self) -> float:
        """Sampling interval, s."""
        return float(self.times[-1] - self.times[0]) / (len(self.times) - 1)

    @cached_property
    def since_start(self) -> np.ndarray:
        """(N,) s, from its first sample: a drift begins with the record."""
        return self.times - self.times[0]

    @cached_property
    def counted(self) -> np.ndarray:
        """(N,) 1 where the record counts, 0 within the spans that do not, between them a cosine of `_EDGE_S`."""
        weight = np.ones(len(self.times))
        for begin, end in self.left_out:
            away = np.maximum(np.maximum(begin - self.times, self.times - end), 0.0)
            weight *= 0.5 - 0.5 * np.cos(np.pi * np.minimum(away / _EDGE_S, 1.0))
        return weight

    @cached_property
    def excitation(self) -> str:
        """Which input drives it: `command`, `disturbance`, `both` or `none`; a force sensor's noise drives nothing."""
        forced, commanded = bool(np.any(self.denoised[0])), bool(np.std(self.inputs[:, 1]) > 0)
        return (("none", "command"), ("disturbance", "both"))[forced][commanded]

    @cached_property
    def denoised(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) the force as it acted, and (N,) what its sensor's noise leaves in it, see `input_noise.denoised`.

        White noise that the displacement answers is no sensor's, but a force: of which most looks like noise, all is
        kept then; so it is where no displacement is at hand and nothing else drives.
        """
        force, command = self.inputs.T
        moved, (found, left) = self.measured.get("displacement_m"), denoised(force)
        if moved is None:
            answered = np.ptp(command) == 0
        else:
            there = self.counted > 0
            answered = is_answered(force - found, np.interp(self.times, self.times[there], moved[there]))
        if answered and np.var(force - found) > np.var(found):
            return force, np.zeros(len(force))
        return found, left

    @property
    def cleaned(self) -> "TimeRecord":
        """The record with its force as it acted, without the noise of the sensor that recorded it."""
        return replace(self, inputs=np.column_stack([self.denoised[0], self.inputs[:, 1]]))

    @property
    def masses(self) -> tuple[float, float]:
        """On the outer and on the inner tip, kg."""
        return self.outer_end_mass, self.inner_end_mass

    @cached_property
    def drive(self) -> float:
        """Root mean square of the command where that drives it, V, else of the force, N."""
        return float(np.sqrt(np.mean(self.inputs[:, 1 if self.excitation == "command" else 0] ** 2)))

    @cached_property
    def condition(self) -> tuple[Any, ...]:
        """What the rig was asked to do, apart from the run of the input: masses, controller, excitation, its size.

        Sizes count as one condition within a factor of two.
        """
        size = round(float(np.log2(self.drive))) if self.drive > 0 else None
        return (*self.masses, self.controller, self.excitation, size)


@dataclass(frozen=True)
class FrequencyResponse:
    """Displacement over the force on the outer tip (compliance) or over the command, of the loop, measured at lines.

    Attributes:
        name: file name without its ending.
        frequencies_Hz: (N,) rising.
        response: (N,) complex where the phase was measured, else its magnitude; m/N or m/V.
        has_phase: whether it was.
        amplitude: of what drove it, N or V; None where it is not stated.
        outer_end_mass: payload, kg.
        inner_end_mass: kg.
        controller: of the loop.
        source: file it was read from.
        driven_by: column of `INPUTS`.
    """

    name: str
    frequencies_Hz: np.ndarray = field(repr=False)
    response: np.ndarray = field(repr=False)
    has_phase: bool
    amplitude: float | None
    outer_end_mass: float
    inner_end_mass: float
    controller: Controller
    source: str = ""
    driven_by: int = 0
    load_N: ClassVar[float] = 0.0  # none stands on the tip beside what drives it

    @property
    def column(self) -> str:
        """Of the file, with its magnitude."""
        return MAGNITUDES[self.driven_by]


@dataclass(frozen=True)
class MeasuredGain:
    """A gain at which sustained oscillation set in.

    Attributes:
        controller: with that gain.
        outer_end_mass: payload, kg.
        inner_end_mass: kg.
        relative_std: of the gain.
        frequency_Hz: of the oscillation, where it was noted.
        predicted_gain: that its designers predicted with a model of their own, where they said so, A/V.
        raised_from: gain that the law has in the prototype, below which its loop need not be stable, A/V; 0 of others.
        load_N: constant force on the outer tip.
    """

    controller: Controller
    outer_end_mass: float
    inner_end_mass: float
    relative_std: float
    frequency_Hz: float | None = None
    predicted_gain: float | None = None
    raised_from: float = 0.0
    load_N: float = 0.0

    @property
    def gain(self) -> float:
        """A/V."""
        return self.controller.gain_A_per_V


@dataclass(frozen=True, repr=False)
class Dataset(Result):
    """Everything that came back.

    Attributes:
        name: of the set.
        folder: where it was read from.
        prototype: the model that was believed.
        records: time records.
        responses: frequency responses.
        gains: critical gains.
        warnings: what was left aside while reading, in words.
        stated: the prototype as its file states it, where that is another one: of an arm in y the law of z is its own.
    """

    name: str
    folder: Path
    prototype: Prototype
    records: tuple[TimeRecord, ...] = ()
    responses: tuple[FrequencyResponse, ...] = ()
    gains: tuple[MeasuredGain, ...] = ()
    warnings: tuple[str, ...] = ()
    stated: Prototype | None = None

    @property
    def status(self) -> str:
        """How much there is of each kind of evidence."""
        kinds = {"time record": self.records, "frequency response": self.responses, "critical gain": self.gains}
        return ", ".join(f"{len(of)} {kind}{'s' * (len(of) > 1)}" for kind, of in kinds.items() if of) or "empty"

    def rows(self) -> list[tuple[str, str, str]]:
        """What was measured, under which masses and controller: for people."""
        found: list[tuple[TimeRecord | FrequencyResponse | MeasuredGain, str, str]] = [
            *((one, one.name, f"{len(one.times)} samples, {np.ptp(one.times):.4g} s") for one in self.records),
            *((one, one.name, f"{len(one.frequencies_Hz)} frequencies, {one.column}") for one in self.responses),
            *((one, "critical gain", quantity(one.gain, "A/V")) for one in self.gains),
        ]
        laws = ("servo off" if one.controller == OFF else one.controller.words() for one, *_ in found)
        return [
            (name, size, f"{one.outer_end_mass:g} kg outside, {one.inner_end_mass:g} kg inside, {law}")
            for (one, name, size), law in zip(found, laws, strict=True)
        ] + [("warning", words, "") for words in self.warnings]

    def as_stated(self, prototype: Prototype) -> Prototype:
        """What was found, with the controller and the tolerances that the file of the set states."""
        stated = self.stated or self.prototype
        return prototype.but(controller=stated.controller, tolerance=stated.tolerance)


class _Gained(Record):
    """A controller with the critical gain put in."""

    controller: Controller


@takes()
def read_dataset(folder: str | Path) -> Dataset:
    """Read a data set from its folder (or from its dataset.toml).

    Keys that this version does not know are left aside with a warning, unless they look like a known one misspelt.

    Raises:
        InputError: with everything wrong in dataset.toml, or in the first record that cannot be used: file, column,
            row and reason.
    """
    path = index_of(Path(folder))
    entry, warnings = read_index(path)
    prototype = read_prototype(path.parent / entry.prototype)
    if wrong := wrong_effects(prototype):
        raise InputError(path.parent / entry.prototype, wrong)
    if not lever_figures(prototype) and any(arm_of(prototype).offset_m):
        warnings.append(
            "the payload counts as on the axis: [arm] states an offset, but not by `plane` in which of its planes the"
            " records were taken"
        )
    stated, prototype = prototype, in_plane(prototype)
    rows = [("record", r) for r in entry.record] + [("frequency_response", r) for r in entry.frequency_response]
    lawless = [(kind, row.file) for kind, row in rows if row.law is None and prototype.controller is None]
    if lawless:
        words = "missing for {}, and the prototype has none"
        raise InputError(path, [(f"{kind}.controller", words.format(file)) for kind, file in lawless])

    def law(row: TimeEntry | ResponseEntry) -> Controller:
        chosen = row.law or prototype.controller
        assert chosen is not None  # checked above
        if wrong := list(not_felt(type(prototype.actuator), chosen.senses, f"controller of {row.file}")):
            raise InputError(path, wrong)
        return _acting(chosen, row, row.file, path)

    felt = prototype.actuator.feels[0]
    taken = tuple(_time_record(path, row, law(row), felt, warnings) for row in entry.record)
    responses = tuple(_response(path.parent / row.file, row, law(row), warnings) for row in entry.frequency_response)
    gains = tuple(_measured_gain(row, prototype, path) for row in entry.critical_gain)
    return Dataset(entry.name, path.parent, prototype, taken, responses, gains, tuple(warnings), stated)


def _acting(controller: Controller, row: Taken, name: str, path: Path) -> Controller:
    """The law that acted while an entry was taken: of several the one for its payload, which does not change."""
    try:
        return controller.law_for(row.outer_end_mass_kg)
    except ValueError as error:
        reason = f"of {name}: {error}; state the one that acted as its controller"
        raise InputError(path, [("outer_end_mass_kg", reason)]) from error


def _time_record(index: Path, row: TimeEntry, controller: Controller, felt: str, warnings: list[str]) -> TimeRecord:
    path = index.parent / row.file

    def spared(name: str, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Within spans that do not count anything may stand, but what drives the rig and when."""
        if name in ("t_s", *INPUTS) or "t_s" not in columns:
            return np.zeros(len(columns[name]), dtype=bool)
        times = columns["t_s"]
        row.refuse_spans(index, times[0], times[-1])
        return np.any([(begin <= times) & (times <= end) for begin, end in row.left_out_s], axis=0)

    columns = read_columns(path, spared=spared if row.left_out_s else None)
    recorded = row.current_recorded and not row.servo_off
    why = "servo_off = true" if row.servo_off else "current_recorded = false"
    if not recorded and np.any(columns.pop("current_A", np.zeros(1))):
        warnings.append(f"{path.name}: current_A is not to count ({why}) and was left aside")
    if row.servo_off and np.any(columns.get("command_V", np.zeros(1))):
        warnings.append(f"{path.name}: command_V moves nothing ({why}) and was left aside")
        columns["command_V"] = np.zeros(len(columns["command_V"]))
    needed = ("t_s", *INPUTS, *MEASURED[0 if recorded else 1 :])
    refuse_missing(path, needed, columns)
    times = uniform_times(path, columns["t_s"])
    for name, values in columns.items():
        there = np.isfinite(values)  # everywhere but where it does not count
        columns[name] = values if there.all() else np.interp(times, times[there], values[there])
    warnings += [f"{path.name}: {words}" for words in (row.note, refuse_uneven(path, columns, times)) if words]
    more = felt, "inner_displacement_m"
    warnings += _unknown(path, columns, (*needed, *more))
    dead = [name for name in more if name in columns and not np.ptp(columns[name]) > 0]
    warnings += [f"{path.name}: {name} never changes (is the sensor connected?) and was left aside" for name in dead]
    measured = {name: columns[name] for name in (*MEASURED, *more) if name in columns and name not in dead}
    inputs = np.column_stack([columns[name] for name in INPUTS])
    masses = (row.outer_end_mass_kg, row.inner_end_mass_kg)
    return TimeRecord(path.stem, times, inputs, measured, *masses, controller, str(path), row.left_out_s)


def _unknown(path: Path, columns: Mapping[str, np.ndarray], known: tuple[str, ...]) -> list[str]:
    return [f"{path.name}: column {name} is not known here and was left aside" for name in columns if name not in known]


def _response(path: Path, row: ResponseEntry, controller: Controller, warnings: list[str]) -> FrequencyResponse:
    columns = read_columns(path)
    driven_by = int(MAGNITUDES[1] in columns)
    column, other = MAGNITUDES[driven_by], MAGNITUDES[1 - driven_by]
    phases = [name for name in columns if name.lower().startswith("phase")]
    refuse_missing(path, ("frequency_Hz", column, *["phase_deg"] * bool(phases)), columns)
    warnings += _unknown(path, columns, ("frequency_Hz", *MAGNITUDES, "phase_deg"))
    frequencies, magnitude = columns["frequency_Hz"], columns[column]
    wrong = []
    if other in columns:
        wrong.append(Problem(other, f"stands beside {column}: give each response a file of its own"))
    if (row.amplitude_V, row.amplitude_N)[driven_by] is not None:
        key = ("amplitude_V", "amplitude_N")[driven_by]
        wrong.append(Problem(key, f"is stated for a file of {column}: it is driven by the other input"))
    if driven_by and row.servo_off:
        wrong.append(Problem("servo_off", "with the servo off a command moves nothing"))
    if np.any(np.diff(frequencies) <= 0) or frequencies[0] <= 0:
        wrong.append(Problem("frequency_Hz", "must be positive and rise from row to row"))
    if np.all(magnitude < 0):
        unit = column[10:].replace("_per_", "/")
        wrong.append(Problem(column, f"all are negative: give the ratio in {unit}, not decibels"))
    elif np.any(magnitude <= 0):
        first = int(np.argmax(magnitude <= 0))
        wrong.append(Problem(column, f"must be positive, is {magnitude[first]:g} in row {first + 2}"))
    if wrong:
        raise InputError(path, wrong)
    phase = columns.get("phase_deg")
    response = magnitude if phase is None else magnitude * np.exp(1j * np.deg2rad(phase))
    amplitude, masses = (row.amplitude_N, row.amplitude_V)[driven_by], (row.outer_end_mass_kg, row.inner_end_mass_kg)
    taken = (phase is not None, amplitude, *masses, controller, str(path), driven_by)
    return FrequencyResponse(path.stem, frequencies, response, *taken)


def _measured_gain(row: GainEntry, prototype: Prototype, path: Path) -> MeasuredGain:
    own, least = prototype.controller, 0.0
    if row.controller is None and own is not None:
        law = _acting(own, row, "a critical gain", path)
        given, least = law.model_dump(), law.gain_A_per_V
    else:
        given = dict(row.controller or {"kind": "proportional"})
    found = records.parse(_Gained, {"controller": given | {"gain_A_per_V": row.gain_A_per_V}}, path).controller
    masses, noted = (row.outer_end_mass_kg, row.inner_end_mass_kg), (row.relative_std, row.frequency_Hz)
    return MeasuredGain(found, *masses, *noted, row.predicted_gain_A_per_V, least, row.load_N)
