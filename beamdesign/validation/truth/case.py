"""One blind case: a believed rig, the rig that is really there, what drives it, and the data set it is written as."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import tomli_w
from scipy.interpolate import CubicSpline

from beamdesign.files import write_whole
from beamdesign.result import picked
from beamdesign.validation.truth.effects import KINDS, LISTED, Scales, Shape
from beamdesign.validation.truth.nominal import FIGURES, assembled, nominal_figures, rig_figures
from beamdesign.validation.truth.rig import SAMPLE_S, STEP_S, Motion, Noise, controller_figures, march
from beamdesign.validation.truth.rig_kinds import PARAMETERS, Rig

FADE_S = 0.1


@dataclass(frozen=True)
class Drive:
    """One input signal.

    Attributes:
        channel: what it drives.
        shape: many lines of random phase, steps of load, or a wave that is given.
        size: RMS of the lines, or the largest step; N or V.
        highest_Hz: of the lines.
        seed: of phases, or of times and heights.
        wave: at every sample, where it is given.
    """

    channel: Literal["disturbance_N", "command_V"]
    shape: Literal["lines", "steps", "given"]
    size: float
    highest_Hz: float
    seed: int
    wave: tuple[float, ...] = field(default=(), repr=False)


def _lines(drive: Drive, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lines of equal height at logarithmic spacing from 1 Hz, on a grid of a quarter hertz."""
    frequencies = np.unique(np.round(np.geomspace(1.0, drive.highest_Hz, 60) * 4)) / 4
    phases = rng.uniform(0, 2 * np.pi, len(frequencies))
    # A line at k/4 Hz repeats after 4 s: one inverse transform of that period holds them all.
    period = round(4.0 / (times[1] - times[0]))
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[np.round(frequencies * 4).astype(int)] = np.exp(1j * phases)
    wave = np.fft.irfft(spectrum, period)
    wave *= drive.size / np.sqrt(np.mean(wave**2))
    rise = np.clip(times / FADE_S, 0, 1)
    return wave[np.arange(len(times)) % period] * (0.5 - 0.5 * np.cos(np.pi * rise))


def _steps(drive: Drive, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rounded steps of load, up and down, the last one taking it off."""
    whole = times[-1]
    count = max(3, round(whole / 0.6))
    at = (np.arange(count) + rng.uniform(0.25, 0.75, count)) * whole / count
    levels = drive.size * rng.uniform(-1, 1, count)
    levels[rng.integers(0, count - 1)] = drive.size * rng.choice([-1, 1])
    levels[-1] = 0.0
    wave, before = np.zeros_like(times), 0.0
    for moment, level in zip(at, levels, strict=True):
        wave += (level - before) * (0.5 - 0.5 * np.cos(np.pi * np.clip((times - moment) / 0.03, 0, 1)))
        before = level
    return wave


def fine_times(duration_s: float, step_s: float = STEP_S) -> np.ndarray:
    """Every half step of a record whose last sample lies one interval before its end."""
    steps = round((duration_s - SAMPLE_S) / step_s)
    return np.arange(2 * steps + 1) * (step_s / 2)


@dataclass(frozen=True)
class Departure:
    """One effect in a rig.

    Attributes:
        name: key of `effects.KINDS`, or `parameter:NAME`.
        severity: how strong; for a wrong figure the logarithm of its factor.
        shape: what does not grow with it.
        figure: which figure is wrong, else empty.
    """

    name: str
    severity: float
    shape: Shape = field(default_factory=dict, hash=False)
    figure: str = ""

    @property
    def subsystem(self) -> str:
        """Where it sits."""
        if self.name.startswith("parameter:"):
            return PARAMETERS[self.name.removeprefix("parameter:")][1]
        return KINDS[self.name].subsystem

    def changes(self, scales: Scales) -> Shape:
        """Changed figures of a rig; none for a wrong figure, which is a factor."""
        return {} if self.figure else KINDS[self.name].figures(scales, self.shape, self.severity)


@dataclass(frozen=True)
class Run:
    """One time record to be taken.

    Attributes:
        name: of its file.
        drive: input.
        controller: table of the contract.
        outer_end_mass_kg: payload.
        inner_end_mass_kg: on the inner tip.
    """

    name: str
    drive: Drive
    controller: dict[str, Any] = field(hash=False)
    outer_end_mass_kg: float = 0.0
    inner_end_mass_kg: float = 0.0

    @property
    def setting(self) -> dict[str, Any]:
        """Masses and controller, as an entry of a data set states them."""
        return picked(self, "outer_end_mass_kg inner_end_mass_kg controller")


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        seed: that it was drawn with.
        kind: null, single, pair, outside, parameter, triple, or alone (a single effect, to be found without records).
        nominal: prototype's tables.
        factors: truth over belief of every tolerated figure, wrong figures included.
        habits: figures of the true rig that no prototype states.
        background: little effects that every real rig has.
        departures: the effects in question, the one that matters most first.
        runs: records.
        noise: of recording.
        duration_s: of each record.
        rig: which rigs it was drawn from.
        scales: magnitudes by which effects are sized.
        gaps: RMS over the records of what the effects change over the displacement itself: `all`, each alone by its
            name; `background` and `tolerances`, over the first part of the records; and `floor`, the same of the noise.
        notes: what had to be drawn again, in words.
    """

    seed: int
    kind: str
    nominal: dict[str, Any] = field(hash=False)
    factors: Shape = field(hash=False)
    habits: Shape = field(hash=False)
    background: tuple[Departure, ...]
    departures: tuple[Departure, ...]
    runs: tuple[Run, ...]
    noise: Noise
    duration_s: float
    scales: Scales = field(hash=False)
    gaps: dict[str, float] = field(default_factory=dict, hash=False)
    notes: tuple[str, ...] = ()
    rig: Rig = "lag"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects in question, `no_gap` where there is none."""
        return tuple(d.name for d in self.departures) or ("no_gap",)

    @property
    def gap_over_floor(self) -> float:
        """How far the effects stand out of the noise; 0 for a null."""
        return self.gaps.get("all", 0.0) / self.gaps["floor"] if self.gaps else 0.0

    def only(self, *departures: Departure) -> "Case":
        """The same rig with other effects, wrong figures as believed but for those given."""
        kept = dict(self.factors)
        for given in self.departures:
            if given.figure:
                kept[given.figure] /= float(np.exp(given.severity))
        for given in departures:
            if given.figure:
                kept[given.figure] *= float(np.exp(given.severity))
        return replace(self, departures=tuple(departures), factors=kept)


def run_figures(case: Case, run: Run) -> Shape:
    """Flat figures of the true rig as it stands in one run."""
    figures = rig_figures(case.nominal, case.factors, case.habits)
    for departure in (*case.background, *case.departures):
        figures |= departure.changes(case.scales)
    masses = {"outer_end_mass": run.outer_end_mass_kg, "inner_end_mass": run.inner_end_mass_kg}
    return figures | controller_figures(run.controller) | masses


def step_of(figures: Shape) -> float:
    """Half the usual step where a joint hammers or a seal turns over within some micrometres."""
    bristles = figures.get("bristle_stiffness", 0.0)
    stiff_seal = bristles > 0 and figures["breakaway"] / bristles < 12e-6
    return STEP_S / 2 if figures.get("joint_on", 0.0) > 0 or stiff_seal else STEP_S


@cache
def _driven(drive: Drive, duration_s: float, step_s: float) -> np.ndarray:
    """(N,) a drive at every half step; it starts from nothing."""
    times = fine_times(duration_s, step_s)
    if drive.shape == "given":
        samples = SAMPLE_S * np.arange(len(drive.wave))
        wave = CubicSpline(samples, drive.wave)(times)  # straight lines would take an eighth of what is at 400 Hz
    else:
        wave = (_lines if drive.shape == "lines" else _steps)(drive, times, np.random.default_rng(drive.seed))
    wave.flags.writeable = False
    return wave


def inputs_of(case: Case, run: Run, noisy: bool, step_s: float, duration_s: float) -> np.ndarray:
    """(2 N + 1, 3) force, command and sensor noise (V) at every half step."""
    wave = _driven(run.drive, case.duration_s, step_s)[: len(fine_times(duration_s, step_s))]
    inputs = np.zeros((len(wave), 3))
    inputs[:, 0 if run.drive.channel == "disturbance_N" else 1] = wave
    if noisy:
        rng = np.random.default_rng([case.seed, run.drive.seed, 1])
        per_sample = round(2 * SAMPLE_S / step_s)
        samples = (len(wave) - 1) // per_sample + 1
        fine = np.arange((samples - 1) * per_sample + 1) / per_sample  # straight between the samples
        noise = np.interp(fine, np.arange(samples), case.noise.of_sensor(samples, rng))
        noise += rng.normal(0, case.noise.drift_m) * np.linspace(0, 1, len(noise))
        inputs[:, 2] = case.nominal["sensor"]["gain_V_per_m"] * noise
    return inputs


def _lost(case: Case, run: Run, figures: Shape, steps: int, step_s: float) -> np.ndarray | None:
    if figures.get("dropouts_per_s", 0.0) <= 0:
        return None
    rng = np.random.default_rng([case.seed, run.drive.seed, 2])
    lost = np.zeros(steps + 1, dtype=np.bool_)
    whole = case.duration_s
    for _ in range(max(1, rng.poisson(figures["dropouts_per_s"] * whole))):
        start = rng.uniform(0.05, 0.95) * whole
        first, length = int(start / step_s), max(1, int(figures["dropout_s"] / step_s))
        lost[first : first + length] = True
    return lost


def take(case: Case, run: Run, noisy: bool = False, duration_s: float | None = None) -> Motion:
    """Take one run on the true rig.

    Args:
        case: whose rig.
        run: which.
        noisy: whether the sensor is noisy inside the loop.
        duration_s: only the first part of the record.
    """
    figures = run_figures(case, run)
    step = step_of(figures)
    inputs = inputs_of(case, run, noisy, step, duration_s or case.duration_s)
    record, modes = assembled(figures)
    return march(record, modes, inputs, _lost(case, run, figures, (len(inputs) - 1) // 2, step), step)


def noise_free(case: Case, duration_s: float | None = None) -> dict[str, Motion]:
    """Every run by its name, as an ideal recorder would have it on a rig without noise."""
    return {run.name: take(case, run, duration_s=duration_s) for run in case.runs}


def relative_gap(taken: dict[str, Motion], without: dict[str, Motion]) -> float:
    """RMS over the records of the change of displacement over the displacement without it.

    Infinite where a record has left its bounds or has grown threefold: that rig is not stable.
    """
    squares = []
    for name, before in without.items():
        after = taken[name]
        size = float(np.sqrt(np.mean(before.displacement**2)))
        if not after.bounded or float(np.sqrt(np.mean(after.displacement**2))) > 3 * size:
            return float("inf")
        squares.append(float(np.mean((after.displacement - before.displacement) ** 2)) / size**2)
    return float(np.sqrt(np.mean(squares)))


def relative_floor(case: Case, without: dict[str, Motion]) -> float:
    """The same of the noise of the sensor and the step of the recorder."""
    sizes = [float(np.mean(motion.displacement**2)) for motion in without.values()]
    return float(np.sqrt(np.mean([case.noise.floor_m**2 / size for size in sizes])))


_ROW = ("%.4f", "%.2f", "%.6f", "%.7f", "%.4e", "%.5e")


def recorded(case: Case, run: Run) -> dict[str, np.ndarray]:
    """Columns of one record as the recorder writes them."""
    motion = take(case, run, noisy=True)
    rng = np.random.default_rng([case.seed, run.drive.seed, 3])
    count = len(motion.times)
    inputs = inputs_of(case, run, False, STEP_S, case.duration_s)[:: round(2 * SAMPLE_S / STEP_S)]
    quantum = case.noise.quantum_m
    columns = {
        "t_s": motion.times,
        "disturbance_N": inputs[:, 0] + rng.normal(0, case.noise.force_N, count),
        "command_V": inputs[:, 1],
        "current_A": motion.current + rng.normal(0, case.noise.current_A, count),
        "displacement_m": quantum * np.round(motion.displacement / quantum),
    }
    for _ in range(rng.poisson(case.noise.outliers) if case.noise.outliers else 0):
        channel = columns[str(rng.choice(["current_A", "displacement_m"]))]
        channel[rng.integers(count)] += rng.choice([-1, 1]) * rng.uniform(0.2, 1.5) * np.std(channel)
    added = {name for each in case.runs for name in each.controller.get("sensors", ())}
    for name, wave, noise in (
        ("load_pressure_Pa", motion.load_pressure, case.noise.pressure_Pa),
        ("inner_displacement_m", motion.inner, case.noise.floor_m),
    ):
        if name in added:
            columns[name] = wave + rng.normal(0, noise, count)
    return columns


def write_case(case: Case, folder: Path | str, more: Mapping[str, Any] = MappingProxyType({})) -> None:
    """Write the data set of a case, without its answer; of the kind `alone`, without its records.

    Args:
        case: drawn.
        folder: made where it is not there.
        more: further tables of dataset.toml, whose files are there already.

    Raises:
        OSError: where it cannot be written.
    """
    folder = Path(folder)
    (folder / "records").mkdir(parents=True, exist_ok=True)
    index: dict[str, Any] = {"name": f"case-{case.seed}", "prototype": "prototype.toml", "record": [], **more}
    for run in case.runs if case.kind != "alone" else ():
        file = f"records/{run.name}.csv"
        columns = recorded(case, run)
        form = ",".join((*_ROW, _ROW[-1])[: len(columns)])
        lines = (form % tuple(line) for line in np.column_stack(list(columns.values())).tolist())
        write_whole(folder / file, "\n".join((",".join(columns), *lines)) + "\n")
        index["record"].append({"file": file} | run.setting)
    write_whole(folder / "prototype.toml", tomli_w.dumps(case.nominal))
    write_whole(folder / "dataset.toml", tomli_w.dumps(index))


def stated(case: Case, departure: Departure) -> dict[str, Any]:
    """Parameters of one effect in the units of the contract's effects, and the severity it was drawn with."""
    if departure.figure:
        factor = float(np.exp(departure.severity))
        value = nominal_figures(case.nominal)[departure.figure] * case.factors[departure.figure]
        return {"figure": departure.figure, "factor": factor, "value": value}
    record, modes = assembled(run_figures(case, case.runs[0]))
    values = {name: float(record[name][0]) for name in FIGURES}
    found: dict[str, Any] = KINDS[departure.name].stated(values)
    if departure.name == "second_beam_mode":
        rates = np.sqrt(modes[0] / modes[1])
        found |= {
            "frequency_Hz": float(rates[1] / (2 * np.pi)),
            "compliance_share": float(modes[0, 0] / modes[0, 1]),
            "damping_ratio": float(modes[2, 1] / (2 * np.sqrt(modes[0, 1] * modes[1, 1]))),
        }
    return found | {"severity": departure.severity, "figures": departure.changes(case.scales)}


def answer(case: Case) -> dict[str, Any]:
    """What is in a case, as tables of plain values (JSON and TOML alike).

    `effects` and `subsystem` are those of the contract's answer files; `subsystem` is that of the effect with the
    largest gap. `gap_over_floor` compares the rig with and without the effects, tolerances and background the same,
    free of noise.
    """
    floor = case.gaps["floor"]
    return {
        **picked(case, "seed kind rig"),
        "noise": picked(case.noise, "coloured break_Hz outliers"),
        "effects": list(case.names),
        "subsystem": case.departures[0].subsystem if case.departures else "",
        "subsystems": [d.subsystem for d in case.departures],
        "in_library": all(d.name in LISTED or d.figure != "" for d in case.departures),
        "parameters": {d.name: stated(case, d) for d in case.departures},
        "gap_over_floor": case.gap_over_floor,
        "gaps_over_floor": {name: value / floor for name, value in case.gaps.items()},
        "relative_floor": floor,
        "noise_floor_m": case.noise.floor_m,
        "tolerance_factors": dict(case.factors),
        "background": {d.name: d.severity for d in case.background},
        "notes": list(case.notes),
    }
