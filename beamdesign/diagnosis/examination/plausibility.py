"""Whether a data set can be what it says it is: looked at after reading, before anything is concluded from it.

Frequency responses and critical gains are looked at here: whether they are in the units they should be in. Time
records are looked at in `sound_records`; here is whether their force is one that acted on the rig, as far as the rig
tells, which cannot help bending under it. What a load cell reads beside the force, as an offset, hum or a spoilt
sample, would move the believed rig. Where the displacement measured has nothing of such a motion, that was no force.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from math import pi
from pathlib import Path

import numpy as np

from beamdesign.diagnosis.data.dataset import MEASURED, Dataset, FrequencyResponse, MeasuredGain, TimeRecord
from beamdesign.diagnosis.data.dataset_index import OFF
from beamdesign.diagnosis.examination.nominal import ControllerFit, controller_fit, nominal_loop
from beamdesign.diagnosis.examination.off_zero import on_zero
from beamdesign.diagnosis.examination.readings import (
    Reading,
    as_it_stands,
    contradictions,
    lost_by_recorder,
    other_readings,
    other_units,
)
from beamdesign.diagnosis.examination.sound_records import (
    HIGH_HZ,
    LOW_HZ,
    NOISY,
    Caution,
    Finding,
    blips,
    bridged,
    cautions,
    equal_runs,
    finest_step,
    law,
    masses,
    noise_std,
    remarks,
    rms,
    signals,
    suitability,
    too_heavy,
    where_it_counts,
)
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import tolerated
from beamdesign.parameters import stated_or_typical
from beamdesign.plant.assembly import widened
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem

_UNITS = (
    {"mm/N": 1e3, "um/N": 1e6, "in/lbf": 4.4482216 / 0.0254, "mm/kN": 1e6, "m/kN": 1e3, "m/lbf": 4.4482216},
    {"mm/V": 1e3, "um/V": 1e6},
)
"""Of a response under a force and under a command."""
_FAR = np.log(3.0)
_NEAR = np.log(2.0)
_FEWEST = 3
GAIN_FAR = 10.0
"""Between a critical gain and what it is held against: a factor that is worth a word."""


def check_responses(responses: Sequence[FrequencyResponse], prototype: Prototype) -> None:
    """Refuse frequency responses that make sense only when read otherwise.

    Raises:
        InputError: of the first file that does, with column and reason.
    """
    for response in responses:
        if problems := _problems(response, prototype):
            raise InputError(response.source or response.name, problems)


def _problems(response: FrequencyResponse, prototype: Prototype) -> list[Problem]:
    frequencies = response.frequencies_Hz
    if heavy := too_heavy((response.outer_end_mass, response.inner_end_mass), prototype):
        return [Problem("frequency_response", f"its entry in dataset.toml states {heavy}")]
    if len(frequencies) < _FEWEST:
        return [Problem("frequency_Hz", f"only {len(frequencies)} lines: measure at least {_FEWEST}")]
    low, high = widened(prototype, LOW_HZ, HIGH_HZ)
    inside = (frequencies >= low) & (frequencies <= high)
    if inside.sum() < _FEWEST:
        return [Problem("frequency_Hz", f"fewer than {_FEWEST} lines between {low:g} and {high:g} Hz")]
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        loop = nominal_loop(prototype, response)
    if not loop.stable:
        return []
    nominal, slower = (loop.responses(at)[:, 1, response.driven_by] for at in (frequencies, frequencies / (2 * pi)))
    measured = np.abs(response.response)
    level, shape = _level_and_shape(measured, nominal)
    if abs(level) > _FAR:
        more = {"V/V, over the sensor's gain": prototype.sensor.gain_V_per_m} if response.driven_by else {}
        for unit, factor in (_UNITS[response.driven_by] | more).items():
            if abs(level - np.log(factor)) < min(_NEAR, 0.3 * np.log(factor)) and shape < _NEAR:
                return [Problem(response.column, f"values are in {unit}, by their scale: divide by {factor:g}")]
    problems = []
    slower_level, slower_shape = _level_and_shape(measured, slower)
    if max(shape, abs(level)) > 0.4 and max(slower_shape, abs(slower_level)) < 0.5 * max(shape, abs(level)):
        problems.append(Problem("frequency_Hz", "values are in rad/s, by the place of the resonances: divide by 2 pi"))
        nominal = slower
    if response.has_phase and (reason := _phase(response, nominal)):
        problems.append(Problem("phase_deg", reason))
    return problems


def _level_and_shape(measured: np.ndarray, nominal: np.ndarray) -> tuple[float, float]:
    """Median logarithm of measured over believed, and the typical distance of the lines from it."""
    ratio = np.log(measured / np.abs(nominal))
    level = float(np.median(ratio))
    return level, float(np.sqrt(np.mean((ratio - level) ** 2)))


def _phase(response: FrequencyResponse, nominal: np.ndarray) -> str:
    """What is wrong with phases, if they make sense only when read otherwise."""
    phases = np.unwrap(np.angle(response.response))
    expected = np.unwrap(np.angle(nominal))
    if np.ptp(expected) < 1.0:
        return ""
    as_written = _phase_error(phases, expected)
    if as_written < 0.5:
        return ""
    if _phase_error(np.rad2deg(np.angle(response.response)), expected) < 0.5 * as_written:
        return "values are in radians, by their scale: give degrees"
    if _phase_error(-phases, expected) < 0.4 * as_written:
        return "its sign is the other way round"
    return ""


def _phase_error(phases: np.ndarray, expected: np.ndarray) -> float:
    """Typical distance on the circle, rad."""
    return float(np.sqrt(np.mean(np.angle(np.exp(1j * (phases - expected))) ** 2)))


def check_gains(gains: Sequence[MeasuredGain], prototype: Prototype, folder: Path) -> list[Caution]:
    """Compare critical gains with those believed.

    A rig may well be that far off: whether one is, its diagnosis tells.

    Raises:
        InputError: where they are in another unit.
    """
    problems, warnings = [], []
    for k, gain in enumerate(gains, start=1):
        if heavy := too_heavy((gain.outer_end_mass, gain.inner_end_mass), prototype):
            problems.append(Problem("critical_gain", f"entry {k}: {heavy}"))
            continue
        if (nominal := GainEvidence(gain, prototype).nominal()) is None:
            continue
        ratio = gain.gain / nominal.gain
        if 0.2 < ratio / 1e3 < 3:
            words = f"entry {k}: {gain.gain:g} is {ratio:.0f} times what is believed: is it in mA/V? Divide by 1000"
            problems.append(Problem("critical_gain.gain_A_per_V", words))
        elif not 1 / GAIN_FAR < ratio < GAIN_FAR:
            text = f"critical gain {k}, {gain.gain:g} A/V, is {ratio:.3g} times what is believed"
            warnings.append(Caution("critical_gain", "", f"{text}: check it and its masses"))
    if problems:
        raise InputError(folder / "dataset.toml", problems)
    return warnings


_FELT = 0.3  # of what it would do in the believed rig: what moves less was no force
_SEEN = 4.0  # times the noise of the displacement: what would be seen
_COUNTS = 0.05  # of the rms of the displacement: what is worth a word
_STANDS_OUT = 2.0  # of the rms of what else is not as believed: a force leaves as much in a rig that rings elsewhere
_THERE = 0.1  # of the largest motion that it would make: where that is, it is looked for
_PLATEAU, _MANY = 4, 12  # equal samples in a row, and altogether
_NOISE = 1e-4  # of the rms of the force: less is no noise of a load cell


def force_channel(record: TimeRecord, prototype: Prototype) -> Iterator[Finding]:
    """What is to be said about the force of a usable record."""
    force, command = record.inputs.T
    if not np.ptp(force) > 0:
        return
    if samples := _cut_off(force):
        yield "clipped", f"disturbance_N is cut off, {samples} samples long: widen the recorder's range, or drive less"
        return
    still = record.denoised[0]
    if np.ptp(command) > 0 and (size := _unfelt(record, prototype, still)):
        text = f"disturbance_N of {rms(still):.3g} N rms would move the tip by {size:.2g} m rms, and does not"
        yield "unfelt_force", f"{text}: hum, an offset or a drift of the load cell; set it to zero where nothing pushes"
        return
    at = blips(force)
    spikes = np.zeros_like(force)
    spikes[at] = force[at] - (force[at - 1] + force[at + 1]) / 2
    if len(at) and _unfelt(record, prototype, spikes):
        text = f"{len(at)} single samples that the rig does not feel, first at {record.times[at[0]]:.4g} s"
        yield "unfelt_force", f"disturbance_N has {text}: they are spoilt, put them between their neighbours"


def _unfelt(record: TimeRecord, prototype: Prototype, part: np.ndarray) -> float:
    """Rms (m) of what a part of the force would make of the displacement, where that is not there; 0 else."""
    loop, moved = nominal_loop(prototype, record), record.measured["displacement_m"]
    if not loop.stable:
        return 0.0
    rest = record.inputs - np.column_stack([part, np.zeros_like(part)])
    made = loop.driven(np.column_stack([part, np.zeros_like(part)]), record.step)[:, 1, 0] * record.counted
    left = (moved - loop.driven(rest, record.step)[:, 1].sum(axis=1)) * record.counted
    there = np.abs(made) > _THERE * np.abs(made).max()
    if not there.any():
        return 0.0
    size, around, whole = (rms(signal[there]) for signal in (made, left, moved))
    felt = float(made[there] @ left[there]) / float(made[there] @ made[there])
    return size if size > max(_SEEN * noise_std(moved), _COUNTS * whole, _STANDS_OUT * around) and felt < _FELT else 0.0


def _cut_off(force: np.ndarray) -> int:
    """How many samples of a noisy force are exactly at its extremes, several in a row; 0 where it is not cut off."""
    rough = float(np.sqrt(np.median(np.diff(force, 2) ** 2) / 2.7))  # noise alone makes as much
    noise = min(rough, noise_std(force))
    if noise <= max(NOISY * finest_step(force), _NOISE * float(np.std(force))):
        return 0
    ends = {float(force.min()), float(force.max())} - {0.0}  # where nothing pushes nothing is cut off
    count = sum(length for first, length in equal_runs(force, _PLATEAU) if force[first] in ends)
    return count if count >= _MANY else 0


def twins(records: Sequence[TimeRecord]) -> list[Caution]:
    """Records that hold the same measurement twice."""
    found, first = [], dict[bytes, TimeRecord]()
    for record in records:
        channels = b"".join(record.measured[name].tobytes() for name in MEASURED if name in record.measured)
        other = first.setdefault(sha256(channels).digest(), record)
        if other is not record:
            same = (record.masses, record.controller) == (other.masses, other.controller)
            more = "" if same else ", though masses or controller are said to differ: one of them is not what it says"
            text = f"holds the same measurement as {other.name}{more}"
            found.append(Caution("duplicate", record.name, text, left_out=True, limits_confidence=not same))
    return found


@dataclass(frozen=True)
class Examination:
    """A data set with what is to be said about it.

    Attributes:
        data: the set without records that cannot be used; with typical tolerances where none are stated.
        warnings: named, in words.
    """

    data: Dataset
    warnings: tuple[Caution, ...] = ()

    @property
    def limits_confidence(self) -> bool:
        """Whether a verdict on this set must not be a confident one."""
        return any(warning.limits_confidence for warning in self.warnings)

    @property
    def words(self) -> tuple[str, ...]:
        """Warnings as lines of text, those of reading first; what holds of several records alike is said once."""
        of: dict[tuple[str, bool], list[str]] = {}
        for warning in self.warnings:
            of.setdefault((warning.text, warning.left_out), []).append(warning.record)
        lines = (str(Caution("", ", ".join(names), text, out)) for (text, out), names in of.items())
        return (*self.data.warnings, *lines)


def examine(data: Dataset) -> Examination:
    """Check a data set.

    Args:
        data: as read.

    Raises:
        InputError: where a column is plainly not what its name says, or no usable evidence remains.
    """
    tolerance, text = stated_or_typical(data.prototype.tolerance, type(data.prototype.actuator))
    prototype = data.prototype.but(tolerance=tolerance)
    if not tolerated(prototype):  # of figures alone that this rig does not have
        tolerance, text = stated_or_typical(type(tolerance)(), type(data.prototype.actuator))
        prototype = prototype.but(tolerance=tolerance)
    data, gain = replace(data, prototype=prototype), prototype.sensor.gain_V_per_m
    warnings = [Caution("tolerances", "", text)] if text else []

    def usable() -> tuple[TimeRecord, ...]:
        out = {caution.record for caution in warnings if caution.left_out}
        return tuple(record for record in data.records if record.name not in out)

    def seen() -> tuple[TimeRecord, ...]:
        return tuple(map(where_it_counts, usable()))

    # Each check sees what those before it have left.
    warnings += cautions(signals, usable(), prototype)
    warnings += cautions(law, seen(), prototype, most=1)
    named = {caution.record for caution in warnings}
    mended = [(record, []) if record.name in named else bridged(record) for record in data.records]
    data = replace(data, records=tuple(record for record, _ in mended))
    warnings += [caution for _, found in mended for caution in found]
    unchecked = "its current was not recorded: nothing tells whether it obeys the controller that is stated"
    blind = (r.name for r in data.records if "current_A" not in r.measured and r.controller != OFF)
    warnings += [Caution("no_current", name, unchecked) for name in blind]
    warnings += _misread(seen(), data)
    warnings += cautions(suitability, seen(), prototype, most=1)
    warnings += cautions(force_channel, seen(), prototype)
    warnings += twins(usable())
    fits = {r.name: fit for r in usable() if (fit := _controller_fit(r, gain)) is not None}
    warnings = [lost_by_recorder(caution, fits) for caution in warnings]
    stuck = {caution.record for caution in warnings if caution.name == "stuck"}
    warnings += contradictions([r for r in seen() if r.name in fits.keys() - stuck], fits, prototype)
    offset = {caution.record for caution in warnings if caution.name == "offset"}
    zeroed = (on_zero(r, fits[r.name], gain) if r.name in offset else r for r in data.records)
    data = replace(data, records=tuple(zeroed))
    pairs = list(dict.fromkeys(r.masses for r in usable()))
    warnings += cautions(partial(masses, pairs=pairs), seen(), prototype, most=1)
    warnings += cautions(remarks, seen(), prototype, most=1)
    check_responses(data.responses, prototype)
    warnings += check_gains(data.gains, prototype, data.folder)
    records = usable()
    if data.records and not records and not (data.responses or data.gains):
        raise InputError(data.folder, [Problem(w.record or "record", w.text) for w in warnings if w.left_out])
    gone = len({caution.record for caution in warnings if caution.left_out})
    if gone and 2 * gone >= len(data.records):  # what is left is no ground for confidence
        text = f"{gone} of {len(data.records)} records had to be left out; what remains cannot bear a confident answer"
        warnings.append(Caution("few_records", "", text, limits_confidence=True))
    return Examination(replace(data, records=records), tuple(warnings))


def _controller_fit(record: TimeRecord, gain: float) -> ControllerFit | None:
    """Of a record of which a span does not count the better one, whichever channel is spoilt there."""
    either = (record, where_it_counts(record)) if record.left_out else (record,)
    fits = (controller_fit(one, gain) for one in either)
    return min((fit for fit in fits if fit is not None), key=lambda fit: fit.residual, default=None)


def _misread(records: Sequence[TimeRecord], data: Dataset) -> list[Caution]:
    """Refuse a set of which a column, read otherwise, would make sense; warn where a rig might do that too."""
    refused: dict[str, tuple[Reading, ...]] = {}
    doubtful: dict[str, tuple[Reading, ...]] = {}
    for record in records:
        stands = as_it_stands(record, data.prototype)
        if found := (other_units if stands else other_readings)(record, data.prototype):
            (refused if stands or found[0].sure else doubtful)[record.name] = found
    # A small factor (pounds for newtons) is believed where no record with that input speaks against it.
    if doubtful:
        alike = [r.name for r in records if r.excitation in ("disturbance", "both")]
        if all(name in doubtful or name in refused for name in alike):
            refused |= doubtful
    if not refused:
        perhaps = {name: f"{found[0].key}: perhaps {found[0].words}" for name, found in doubtful.items()}
        return [Caution("units", name, words, limits_confidence=True) for name, words in perhaps.items()]
    sources = {record.name: record.source or record.name for record in records}
    problems = [(name, problem) for name, readings in refused.items() for problem in _merged(readings)]
    if len(refused) == 1:
        raise InputError(sources[problems[0][0]], [problem for _, problem in problems])
    of: dict[Problem, list[str]] = {}
    for name, problem in problems:
        of.setdefault(problem, []).append(name)
    raise InputError(data.folder, [Problem(p.key, f"{', '.join(names)}: {p.reason}") for p, names in of.items()])


def _merged(readings: Sequence[Reading]) -> list[Problem]:
    """One problem per column; readings of several columns that explain as much are alternatives to the first."""
    first, *others = readings
    if all(reading.fault == 0 for reading in readings):
        return [Problem(reading.key, reading.words) for reading in readings]
    words = "; or ".join(f"{reading.key}: {reading.words}" for reading in others[:2])
    return [Problem(first.key, first.words + (f" (or else {words})" if words else ""))]
