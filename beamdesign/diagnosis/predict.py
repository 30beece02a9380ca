"""What a prototype would have recorded under the inputs of a data set; nothing that was measured is looked at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.arguments import takes
from beamdesign.bench_prototype import AnyPrototype, BenchPrototype, read_bench_prototype
from beamdesign.columns import read_columns, uniform_times
from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.data.dataset_index import index_of, kind_of, read_index, wrong_files
from beamdesign.diagnosis.fitting.replay import FURTHEST_M
from beamdesign.plant.actuators import not_felt
from beamdesign.plant.assembly import NO_CONTROLLER, OUTPUTS, assemble, parameters_of, structure_of
from beamdesign.plant.compiled import integrate, measured_half_steps, refined
from beamdesign.plant.equilibrium import equilibrium, substeps_for
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype, read_prototype
from beamdesign.records import InputError, read_table
from beamdesign.result import Result
from beamdesign.simulation import SimulatedRecord, simulate_scheduled
from beamdesign.structure.arm import in_plane

COLUMNS = ("t_s", "current_A", "displacement_m")
BENCH_COLUMNS = ("t_s", "displacement_m", "pressure_a_Pa", "pressure_b_Pa")


@dataclass(frozen=True, repr=False)
class Prediction(Result):
    """All records of a data set as a model has them.

    Attributes:
        records: simulated.
        noise_N: by the names of records, the root mean square of a force beside a command that looks like nothing but
            noise of its sensor, and is none for the model.
    """

    records: tuple[SimulatedRecord, ...]
    noise_N: Mapping[str, float] = field(default_factory=dict)

    @property
    def reasons(self) -> dict[str, str]:
        """Why records end early, by their names."""
        return {record.name: record.reason for record in self.records if record.reason}

    @property
    def yes(self) -> bool:
        """Whether every record is complete."""
        return not self.reasons

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign gap predict` writes, beside the records' files."""
        return {"complete": self.yes, "reasons": self.reasons, "noise_N": dict(self.noise_N)}

    def rows(self) -> list[tuple[str, int, float, str]]:
        """Record, number of samples, largest displacement in m, why it ends early, and what else to say of it."""
        peaks = [float(abs(one.column("displacement_m")).max()) for one in self.records]
        noise = {name: f"{rms:.3g} N rms taken for noise of the load cell" for name, rms in self.noise_N.items()}
        parts = [(one.reason or "complete", one.uncertain, noise.get(one.name)) for one in self.records]
        words = ["; ".join(filter(None, each)) for each in parts]
        rows = zip(self.records, peaks, words, strict=True)
        return [(one.name, len(one.samples), peak, said) for one, peak, said in rows]


def read_inputs(folder: str | Path, rig: Prototype | None = None) -> tuple[tuple[TimeRecord, ...], float]:
    """Read what was done to a twin-beam rig in the time records of a data set; measured columns may be missing or bad.

    Args:
        folder: of the set, or its dataset.toml.
        rig: whose controller counts where neither a record nor the believed prototype says.

    Returns:
        records without what was measured, and the sensor gain that was believed, V/m, by which displacements of the set
        are stated.

    Raises:
        InputError: with what is wrong in dataset.toml, in its prototype or in an input column; without a controller.
    """
    path = index_of(Path(folder))
    entry, _ = read_index(path)
    nominal = in_plane(read_prototype(path.parent / entry.prototype))
    rig = rig and in_plane(rig)
    found = []
    for row in entry.record:
        times, disturbance, command = _columns(path.parent / row.file, ("t_s", "disturbance_N", "command_V"))
        controller = row.law or nominal.controller or (rig or nominal).controller
        if controller is None:
            raise InputError((rig or nominal).name, [NO_CONTROLLER])
        inputs, masses = np.column_stack([disturbance, command]), (row.outer_end_mass_kg, row.inner_end_mass_kg)
        found.append(TimeRecord(Path(row.file).stem, times, inputs, {}, *masses, controller))
    if not found:
        raise InputError(path, [("record", "the set holds no time record to predict")])
    return tuple(found), nominal.sensor.gain_V_per_m


def predict_record(prototype: Prototype, given: TimeRecord, nominal_sensor_gain: float) -> SimulatedRecord:
    """Simulate a record from rest.

    Args:
        prototype: with its effects. Its sensor gain is what the rig has; the controller believes these figures where it
            estimates the payload.
        given: what was done.
        nominal_sensor_gain: V/m, by which volts became the displacement of the data set.

    Raises:
        InputError: for effects that cannot be, where there is no equilibrium to start from, or
            where the record takes too many steps; see `beamdesign.plant.compiled`.
    """
    if wrong := list(not_felt(type(prototype.actuator), given.controller.senses, "controller")):
        raise InputError(prototype.name, wrong)
    rig = prototype.but(controller=given.controller)
    moved = _fixed if rig.schedule is None else _stages
    samples, same = moved(rig, given, nominal_sensor_gain)
    until = None if same == len(samples) else float(given.times[same])
    if len(samples) == len(given.times):
        return SimulatedRecord(given.name, samples, True, columns=COLUMNS, certain_until_s=until)
    at = float(given.times[len(samples)])
    reason = f"the model's loop diverges: its outer tip passes {FURTHEST_M:g} m at {at:.4g} s"
    return SimulatedRecord(given.name, samples, False, reason, at, columns=COLUMNS, certain_until_s=until)


def _fixed(rig: Prototype, given: TimeRecord, nominal_sensor_gain: float) -> tuple[np.ndarray, int]:
    """(M, 3) as `COLUMNS`, with one law; and up to which sample other steps of integration give the same."""
    kinds = structure_of(rig)
    assembly = assemble(kinds)
    values = parameters_of(rig, *given.masses)
    values["believed_sensor_gain"] = nominal_sensor_gain
    parameters = np.array(list(values.values()))
    try:
        start = equilibrium(assembly, np.zeros(3), parameters)
    except ValueError as error:
        raise InputError(rig.name, [("(figures)", str(error))]) from error
    substeps = substeps_for(assembly, parameters, given.times)

    def course(factor: int) -> np.ndarray:
        inputs = measured_half_steps(given.cleaned.inputs, given.step, factor * substeps)
        return integrate(kinds, given.since_start, inputs, start, parameters, factor * substeps, FURTHEST_M)[0]

    y, same = refined(course, np.asarray, OUTPUTS, substeps * len(given.times))
    columns = [OUTPUTS.index(name) for name in COLUMNS[1:]]
    return np.column_stack([given.times[: len(y)], y[:, columns]]), same


def _stages(rig: Prototype, given: TimeRecord, nominal_sensor_gain: float) -> tuple[np.ndarray, int]:
    """The same with several laws: they work at samples of their own, without noise.

    A record begins with the first law that is for its payload, as a rig does that has carried it before.
    """
    from scipy.interpolate import CubicSpline

    from beamdesign.scenario import Course

    assert rig.schedule is not None
    period, times = rig.schedule.period_s, given.times - given.times[0]
    inside = np.minimum(np.arange(ceil(times[-1] / period) + 1) * period, times[-1])
    force, command = CubicSpline(times, given.cleaned.inputs)(inside).T
    built = rig.but(payload=rig.payload.but(inner_end_mass_kg=given.inner_end_mass))
    course = Course(force, ((0.0, given.outer_end_mass),), command_V=command, before_N=0.0)
    fit = (k for k, (_, (low, high)) in enumerate(rig.schedule.laws) if low <= given.outer_end_mass <= high)
    try:
        found = simulate_scheduled(rig, course, built, next(fit, 0), limit_m=FURTHEST_M)
    except ValueError as error:
        raise InputError(rig.name, [("(figures)", str(error))]) from error
    own = found.column("t_s")
    seen = times[times <= own[-1] + 1e-9 * period]
    held = found.column("current_A")[np.searchsorted(own, seen + 1e-9 * period, side="right") - 1]
    sensed = CubicSpline(own, found.column("sensor_V"))(seen) / nominal_sensor_gain
    same = len(seen) if found.certain_until_s is None else int(np.searchsorted(seen, found.certain_until_s))
    return np.column_stack([given.times[: len(seen)], held, sensed]), same


@takes("Prototype BenchPrototype str Path", "Path str")
def predict(prototype: AnyPrototype | str | Path, dataset: str | Path, progress: Progress = silent) -> Prediction:
    """Predict the records of a data set from its inputs alone; a bench's by a bench.

    Args:
        prototype: the model, or its file.
        dataset: folder of the data set.
        progress: called with the share done and what is being done.

    Raises:
        InputError: where either cannot be read or is none, or where they are of different kinds of rig.
    """
    if kind_of(dataset) == "actuator_bench":
        rig = read_bench_prototype(prototype) if isinstance(prototype, str | Path) else prototype
        if not isinstance(rig, BenchPrototype):
            raise InputError(rig.name, [("kind", "is a twin beam, and the data set is of a bench")])
        return Prediction(tuple(_predict_bench(rig, Path(dataset), progress)))
    model = read_prototype(prototype) if isinstance(prototype, str | Path) else prototype
    if isinstance(model, BenchPrototype):
        raise InputError(model.name, [("kind", "is a bench, and the data set is of a twin beam")])
    inputs, gain = read_inputs(dataset, model)
    found, done, total = [], 0, sum(len(given.times) for given in inputs)
    for given in inputs:
        progress(done / total, f"{given.name}, {given.times[-1] - given.times[0]:.4g} s")
        found.append(predict_record(model, given, gain))
        done += len(given.times)
    noise = {one.name: float(np.std(one.inputs[:, 0])) for one in inputs if not np.any(one.denoised[0])}
    return Prediction(tuple(found), {name: rms for name, rms in noise.items() if rms > 0})


def _predict_bench(prototype: BenchPrototype, folder: Path, progress: Progress) -> list[SimulatedRecord]:
    from beamdesign.plant.bench_simulation import BENCH_COLUMNS as MADE
    from beamdesign.plant.bench_simulation import replay

    path = index_of(folder)
    files = _files(path)
    found: list[SimulatedRecord] = []
    made: dict[bytes, np.ndarray] = {}
    for k, file in enumerate(files):
        progress(k / len(files), file)
        times, command = _columns(path.parent / file, ("t_s", "command_V"))
        key = command.tobytes() + times.tobytes()
        if key not in made:  # both chambers of a condition come from two runs of one command
            made[key] = replay(prototype, times, command)[:, [MADE.index(name) for name in BENCH_COLUMNS]]
        found.append(SimulatedRecord(Path(file).stem, made[key], True, columns=BENCH_COLUMNS))
    return found


def _files(path: Path) -> list[str]:
    """Of the records in a dataset.toml, whatever else it says of them."""
    rows = read_table(path).get("record")
    named = [row.get("file") if isinstance(row, dict) else None for row in rows] if isinstance(rows, list) else []
    files = [file if isinstance(file, str) else "" for file in named]
    if wrong := wrong_files("record.file", files, path.parent):
        raise InputError(path, wrong)
    if not files:
        raise InputError(path, [("record", "the set holds no time record to predict")])
    return files


def _columns(path: Path, names: Sequence[str]) -> list[np.ndarray]:
    columns = read_columns(path, only=names)
    if missing := [name for name in names if name not in columns]:
        raise InputError(path, [(name, "column missing") for name in missing])
    times = uniform_times(path, columns["t_s"])
    if len(times) < 4:
        raise InputError(path, [("t_s", f"too short: {len(times)} samples")])
    return [times, *(columns[name] for name in names[1:])]
