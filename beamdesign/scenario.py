"""Scenario files: what is done to a rig in a simulation."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, SerializeAsAny, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.arguments import takes
from beamdesign.columns import read_columns, uniform_times
from beamdesign.controllers import Controller
from beamdesign.records import FileName, InputError, Problem, Record, numbers, stated

CHANNELS = ("disturbance_N", "command_V")
COLUMNS = ("t_s", *CHANNELS, "current_A", "displacement_m", "load_pressure_Pa", "inner_displacement_m")
"""Of a record."""


class _Amplitude(Record):
    """A signal on one channel: a force where `amplitude_N` is given, a command where `amplitude_V` is."""

    lasts: ClassVar[str] = ""
    """Key of how long a level lasts after `rise_s` of rising to it; empty where there are no levels."""
    amplitude_N: q.SignedForce | None = Field(None, description="peak of a force on the outer tip")
    amplitude_V: q.SignedVoltage | None = Field(None, description="peak of a command")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """One channel per signal, bands that hold something, and levels no shorter than the rise to them."""
        if (table.get("amplitude_N") is None) == (table.get("amplitude_V") is None):
            yield Problem("", "needs one of amplitude_N (force on the tip) and amplitude_V (command)")
        if (band := numbers(table, "low_Hz", "high_Hz")) and band[0] >= band[1]:
            yield Problem("high_Hz", f"must be greater than low_Hz, {band[0]:g}, is {band[1]:g}")
        if cls.lasts and (pair := numbers(cls.whole(table), cls.lasts, "rise_s")) and pair[0] < pair[1]:
            words = f"must be at least rise_s, {pair[1]:g}, is {pair[0]:g}: the amplitude is never reached"
            yield Problem(cls.lasts, words)

    @property
    def channel(self) -> int:
        """Column of `CHANNELS`."""
        return 0 if self.amplitude_N is not None else 1

    @property
    def amplitude(self) -> float:
        """In the channel's unit."""
        return self.amplitude_N or self.amplitude_V or 0.0


class Step(_Amplitude):
    """From zero to the amplitude along half a cosine, and back where it has a length."""

    lasts = "length_s"
    kind: Literal["step"] = Field("step", description="shape of the signal")
    at_s: q.DurationOrNone = Field(0.1, description="when it begins")
    rise_s: q.Duration = Field(0.002, description="how long it takes to rise")
    length_s: q.Duration | None = Field(None, description="after which it goes back to zero; none: it stays")


class Sine(_Amplitude):
    """A sine from time zero, faded in over a given time."""

    kind: Literal["sine"] = Field("sine", description="shape of the signal")
    frequency_Hz: q.Frequency = Field(description="of the sine")
    fade_s: q.DurationOrNone = Field(0.1, description="over which it fades in; 0: at once")


class Multisine(_Amplitude):
    """Equal lines at multiples of 1/duration within a band, with random phases; scaled to the amplitude as its peak."""

    kind: Literal["multisine"] = Field("multisine", description="shape of the signal")
    low_Hz: q.Frequency = Field(1.0, description="lower end of the band")
    high_Hz: q.Frequency = Field(100.0, description="upper end of the band")
    seed: int = Field(0, ge=0, description="of the random phases; the same seed gives the same signal")
    fade_s: q.DurationOrNone = Field(0.1, description="over which it fades in; 0: at once")


class LoadSteps(_Amplitude):
    """One level after another, as shares of the amplitude, each reached along half a cosine."""

    lasts = "dwell_s"
    kind: Literal["load_steps"] = Field("load_steps", description="shape of the signal")
    levels: tuple[q.Level, ...] = Field(
        (1.0, 0.0, -1.0, 0.0), min_length=1, description="one after another, as shares of the amplitude"
    )
    dwell_s: q.Duration = Field(0.5, description="how long each level lasts")
    rise_s: q.Duration = Field(0.01, description="how long each change takes")


class FromCsv(Record):
    """Measured inputs: a CSV file with uniform `t_s` and `disturbance_N`, `command_V` or both."""

    kind: Literal["csv"] = Field("csv", description="shape of the signal")
    file: FileName = Field(description="CSV file, looked for beside the scenario")


Input = Annotated[Step | Sine | Multisine | LoadSteps | FromCsv, Field(discriminator="kind")]


class Sampled(Record):
    """A controller that works at sample times instead of continuously."""

    period_s: q.Duration = Field(description="from sample to sample; a whole multiple of sample_s")
    delay_periods: int = Field(0, ge=0, le=100, description="how many periods late its output is")
    least_volt_V: q.Noise = Field(0.0, description="step of the converter that reads the sensor")


class Measurement(Record):
    """What the instruments add to the written channels (not to what the controller sees)."""

    seed: int = Field(0, ge=0, description="of the random noise; the same seed gives the same noise")
    disturbance_std_N: q.ForceOrNone = Field(0.0, description="standard deviation of the noise on the force channel")
    current_std_A: q.Noise = Field(0.0, description="standard deviation of the noise on the current channel")
    displacement_std_m: q.Resolution = Field(
        0.0, description="standard deviation of the noise on the displacement of the outer tip"
    )
    displacement_step_m: q.Resolution = Field(0.0, description="resolution of the same; 0 for none")

    def of(self, samples: np.ndarray, position: int) -> np.ndarray:
        """Samples (N, 7 or more) as the instruments give them; a seed and a position give the same noise."""
        random = np.random.default_rng([self.seed, position])
        measured, displacement = samples.copy(), COLUMNS.index("displacement_m")
        for name, deviation in (
            ("disturbance_N", self.disturbance_std_N),
            ("current_A", self.current_std_A),
            ("displacement_m", self.displacement_std_m),
        ):
            measured[:, COLUMNS.index(name)] += deviation * random.standard_normal(len(samples))
        if self.displacement_step_m > 0:
            steps = np.round(measured[:, displacement] / self.displacement_step_m)
            measured[:, displacement] = self.displacement_step_m * steps
        return measured


class WallAhead(Record):
    """A wall before the outer tip: a spring and a dashpot that the tip touches from one side."""

    at_m: q.Position = Field(description="where it stands: it presses on a tip that is beyond")
    stiffness_N_per_m: q.Stiffness = Field(description="of its spring")
    damping_N_s_per_m: q.Damping = Field(0.0, description="of its dashpot")
    rounding_m: q.Rounding = Field(
        1e-7, description="over which touch sets in; half of it is what the spring yields at the face itself"
    )


class PayloadChange(Record):
    """A payload that is gripped, released or exchanged during a record."""

    at_s: q.DurationOrNone = Field(description="when")
    outer_end_mass_kg: q.MassOrNone = Field(description="mass on the outer tip from then on")
    joining: Literal["matched", "from_rest"] = Field(
        "matched", description="whether what joins has the tip's velocity, or is at rest and takes some of it"
    )


class ScenarioRecord(Record):
    """One time record to be made."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", description="also of its CSV file")
    input: tuple[Input, ...] = Field((), description="signals that add up; none: nothing is done to the rig")
    outer_end_mass_kg: q.MassOrNone = Field(0.0, description="mass on the outer tip")
    inner_end_mass_kg: q.MassOrNone | None = Field(
        None, description="mass added to the inner tip; none: that of the prototype's payload"
    )
    preload_N: q.SignedForce = Field(0.0, description="constant force on the outer tip, on top of the inputs")
    wall: WallAhead | None = Field(None, description="what the outer tip may touch; none: nothing")
    controller: SerializeAsAny[Controller] | None = Field(
        None, description="the law during this record; none: the prototype's"
    )
    payload_change: PayloadChange | None = Field(
        None, description="scheduled controller: a payload that changes during the record"
    )
    start_m: q.StartPosition | None = Field(
        None, description="actuator bench: where the piston starts; none: at the retracted stop"
    )


class Scenario(Record):
    """Records to be made of one rig."""

    name: str = Field(description="what the scenario is called in tables")
    duration_s: q.Duration = Field(description="length of every record")
    sample_s: q.SamplePeriod = Field(
        0.5e-3, description="from row to row of the records; else the period of a scheduled controller"
    )
    start: Literal["rest", "loaded"] = Field(
        "loaded", description="rest: before the preload comes on; loaded: at rest under it"
    )
    displacement_limit_m: q.Excursion = Field(0.02, description="of the outer tip; a loop that passes it has diverged")
    sampled: Sampled | None = None
    measurement: Measurement = Measurement()
    record: tuple[ScenarioRecord, ...]

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Names differ, times fit into each other."""
        rows = table.get("record")
        if rows in ((), {}):
            yield Problem("record", "holds no record")
        given = [stated(row, "name") for row in rows] if isinstance(rows, tuple) else []
        for name in dict.fromkeys(n for n in given if isinstance(n, str) and given.count(n) > 1):
            yield Problem("record.name", f"{name!r} stands twice")
        table = cls.whole(table)
        if (pair := numbers(table, "duration_s", "sample_s")) and pair[1] > 0 and pair[0] < 10 * pair[1]:
            yield Problem("duration_s", f"holds fewer than ten samples of {pair[1]:g} s")
        pair = numbers(table, "sample_s", "sampled.period_s") or ()
        if pair and pair[0] > 0 and abs(pair[1] / pair[0] - round(pair[1] / pair[0])) > 1e-9:
            yield Problem("sampled.period_s", f"must be a whole multiple of sample_s, {pair[0]:g}, is {pair[1]:g}")

    @model_validator(mode="after")
    def _samples_show_signals(self) -> Self:
        wrong, lasts = [], len(self.times) > 1  # else that is told
        for i, row in enumerate(self.record if lasts else ()):
            for signal in row.input:
                if not isinstance(signal, FromCsv) and (reason := _unseen(signal, self.times)):
                    kind = PydanticCustomError("relation", "{reason}", {"reason": reason})
                    wrong.append(InitErrorDetails(type=kind, loc=("record", i, "input"), input=signal))
        if wrong:
            raise ValidationError.from_exception_data("Scenario", wrong)
        return self

    def every(self, period_s: float | None) -> "Scenario":
        """With a period from row to row where it states none; None: as it is.

        Raises:
            InputError: where it does not go together with that period.
        """
        if period_s is None or "sample_s" in self.model_fields_set:
            return self
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return records.parse(Scenario, fields | {"sample_s": period_s}, self.name)

    @property
    def times(self) -> np.ndarray:
        """(N,) sample times, s."""
        return np.arange(round(self.duration_s / self.sample_s) + 1) * self.sample_s


@takes()
def read_scenario(path: str | Path) -> Scenario:
    """Read a scenario file; the CSV files it names are looked for beside it.

    Raises:
        InputError: naming file, key and reason of everything wrong with it, its CSV files included.
    """
    scenario = records.read(Scenario, path)
    folder = Path(path).parent
    rows, wrong = [], []
    for i, row in enumerate(scenario.record):
        signals = []
        for j, signal in enumerate(row.input):
            if isinstance(signal, FromCsv):
                signal = signal.model_copy(update={"file": str(folder / signal.file)})
                try:
                    inputs_from_csv(Path(signal.file), scenario.times)
                except InputError as error:
                    where = f"record.{i}.input.{j}.file"
                    wrong += [(where, f"{error.source}: {key}: {reason}") for key, reason in error.problems]
            signals.append(signal)
        rows.append(row.but(input=tuple(signals)))
    if wrong:
        raise InputError(path, wrong)
    return scenario.model_copy(update={"record": tuple(rows)})  # which keeps what is stated apart from what is usual


def files_of(scenario: Scenario) -> list[Path]:
    """CSV files that its inputs are read from."""
    return [Path(signal.file) for row in scenario.record for signal in row.input if isinstance(signal, FromCsv)]


def inputs_of(row: ScenarioRecord, scenario: Scenario) -> np.ndarray:
    """(N, 2) disturbance (N, without the preload) and command (V) of a record at its sample times."""
    times = scenario.times
    inputs = np.zeros((len(times), 2))
    for signal in row.input:
        if isinstance(signal, FromCsv):
            inputs += inputs_from_csv(Path(signal.file), times)
        else:
            inputs[:, signal.channel] += signal.amplitude * _shape(signal, times)
    return inputs


@dataclass(frozen=True)
class Course:
    """What is done to a rig whose payload may change.

    Attributes:
        force_N: (N,) on the tip, one figure for each sample of the law.
        payload_kg: (time in s, payload) pairs from time 0 on; each lasts until the next.
        joining: whether payload joins with the tip's velocity, or at rest, which takes some of it.
        command_V: (N,) on top of the sensor's noise; none where left out.
        before_N: force that it rests under before; the first of force_N where left out.
    """

    force_N: np.ndarray
    payload_kg: tuple[tuple[float, float], ...]
    joining: Literal["matched", "from_rest"] = "matched"
    command_V: np.ndarray | None = None
    before_N: float | None = None


def course_of(row: ScenarioRecord, scenario: Scenario) -> Course:
    """What a record does to the rig: force, command, and payload with its change."""
    inputs, begun = inputs_of(row, scenario), (0.0, row.outer_end_mass_kg)
    force, command = inputs[:, 0] + row.preload_N, inputs[:, 1]
    before = row.preload_N if scenario.start == "loaded" else 0.0
    if (change := row.payload_change) is None:
        return Course(force, (begun,), command_V=command, before_N=before)
    return Course(force, (begun, (change.at_s, change.outer_end_mass_kg)), change.joining, command, before)


def _rise(times: np.ndarray, at: float, length: float) -> np.ndarray:
    """From 0 to 1 along half a cosine that begins at `at`."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((times - at) / length, 0.0, 1.0))


def _lines(signal: Multisine, times: np.ndarray) -> np.ndarray:
    """Its lines, as multiples of one over the length of the record."""
    base = 1 / times[-1]
    return np.arange(np.ceil(signal.low_Hz / base), np.floor(signal.high_Hz / base) + 1).astype(int)


def _unseen(signal: Step | Sine | Multisine | LoadSteps, times: np.ndarray) -> str:
    """Why samples at these times do not show a signal, in words; empty where they do."""
    if isinstance(signal, Multisine) and not len(_lines(signal, times)):
        band = f"no multiple of {1 / times[-1]:g} Hz, one over the duration, lies from {signal.low_Hz:g}"
        return f"{band} to {signal.high_Hz:g} Hz: the multisine would be nothing"
    highest = {Sine: "frequency_Hz", Multisine: "high_Hz"}.get(type(signal))
    if highest is not None and (frequency := getattr(signal, highest)) >= 0.5 / times[1]:
        alias = f"samples every {times[1]:g} s take {frequency:g} Hz for a lower frequency"
        return f"{alias}: {highest} must be less than {0.5 / times[1]:g} Hz, or sample_s less than {0.5 / frequency:g}"
    if signal.amplitude and not np.any(_shape(signal, times)):
        return f"a {signal.kind} that is over between two samples, or begins after the last: it would be nothing"
    return ""


def _shape(signal: Step | Sine | Multisine | LoadSteps, times: np.ndarray) -> np.ndarray:
    """A signal of amplitude one."""
    match signal:
        case Step():
            back = 0.0 if signal.length_s is None else _rise(times, signal.at_s + signal.length_s, signal.rise_s)
            return _rise(times, signal.at_s, signal.rise_s) - back
        case LoadSteps():
            levels = np.array([0.0, *signal.levels])
            steps = [
                change * _rise(times, k * signal.dwell_s, signal.rise_s) for k, change in enumerate(np.diff(levels))
            ]
            return np.sum(steps, axis=0)
        case Sine():
            wave = np.sin(2 * np.pi * signal.frequency_Hz * times)
        case Multisine():
            lines = _lines(signal, times)
            phases = np.random.default_rng(signal.seed).uniform(0, 2 * np.pi, len(lines))
            spectrum = np.zeros(len(times) - 1, dtype=complex)  # of one period, which is the record's length
            spectrum[lines] = np.exp(1j * phases)
            wave = np.resize(np.fft.ifft(spectrum).real, len(times))
            wave /= max(np.abs(wave).max(), 1e-300)
    return wave * (_rise(times, 0.0, signal.fade_s) if signal.fade_s > 0 else 1.0)


def inputs_from_csv(path: Path, times: np.ndarray) -> np.ndarray:
    """(N, 2) inputs read from a CSV file with the same sample times.

    Raises:
        InputError: where the file cannot be read, with row and column; where a column is missing, or the times are
            not those of the scenario.
    """
    columns = read_columns(path, only=("t_s", *CHANNELS))
    if "t_s" not in columns or not set(CHANNELS) & set(columns):
        raise InputError(path, [("(columns)", "needs t_s and disturbance_N, command_V or both")])
    own = columns["t_s"]
    uniform_times(path, own)
    if len(own) < len(times) or np.abs(own[: len(times)] - own[0] - times).max() > 0.01 * (times[1] - times[0]):
        raise InputError(path, [("t_s", "does not have the sample times of the scenario")])
    return np.column_stack([columns.get(name, np.zeros(len(own)))[: len(times)] for name in CHANNELS])
