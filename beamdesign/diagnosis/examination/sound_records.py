"""Whether time records are fit to be evidence: whole, long enough, excited where it matters, begun at rest.

What a recorder does to a signal is seen in the signal alone: clipping, outliers, sticking, coarse steps, noise.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.data.input_noise import TOP
from beamdesign.diagnosis.examination.nominal import commanded_current, described, mismatch, nominal_loop
from beamdesign.diagnosis.fitting.weighting import white
from beamdesign.plant.assembly import widened
from beamdesign.prototype import Prototype
from beamdesign.structure.lumped import figures

_PLATEAU = 4  # samples at the very same value
_CUT = 8  # samples on plateaus altogether: fewer may be chance, and spoil nothing
_STUCK = 6
_MANY = 12
NOISY = 0.5
"""Of the finest step: noise that carries every sample to another one."""
_KINK = 3.0  # by how many of its finest steps, or of its noise, a signal runs into a plateau
_JUMP = 8.0  # in the noise of the signal
_FEW = 5  # samples
_BEYOND = 10.0
_SPIKE = 15.0  # in typical second or fourth differences
_UNLIKE = 0.4  # of the largest difference about a sample that is off
_OFTEN = 0.01  # of all samples


@dataclass(frozen=True)
class Caution:
    """Something about a data set that whoever reads a verdict on it should know.

    Attributes:
        name: short, for programs: `clipped`, `no_content`, `controller`, ...
        record: name of the record, empty for the set as a whole.
        text: in words, with what to do.
        left_out: whether the record was left out.
        limits_confidence: whether a verdict must not be a confident one.
    """

    name: str
    record: str
    text: str
    left_out: bool = False
    limits_confidence: bool = False

    def __str__(self) -> str:
        out = "; the record was left out" if self.left_out else ""
        return f"{self.record}: {self.text}{out}" if self.record else f"{self.text}{out}"


def finest_step(signal: np.ndarray) -> float:
    """Least difference between two values of a signal; 0 for a constant one."""
    steps = np.diff(np.unique(signal))
    real = steps[steps > 1e-9 * float(np.ptp(signal))]
    return float(real.min()) if len(real) else 0.0


def rms(signal: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(signal**2)))


def noise_std(signal: np.ndarray) -> float:
    """White noise of a signal, from the top of its spectrum, or that of rounding where this is more."""
    window = np.hanning(len(signal))
    power = np.abs(np.fft.rfft((signal - signal.mean()) * window)) ** 2
    return float(np.sqrt(white(power[round(TOP * (len(power) - 1)) :]) / float(np.sum(window**2))))


def share_in_band(signals: np.ndarray, step_s: float, low_Hz: float, high_Hz: float) -> float:
    """Share of the variance of signals (N, m) that lies in a band of frequency."""
    window = np.hanning(len(signals))[:, None]
    power = np.sum(np.abs(np.fft.rfft((signals - signals.mean(axis=0)) * window, axis=0)) ** 2, axis=1)
    frequencies = np.fft.rfftfreq(len(signals), step_s)
    total = float(power.sum())
    return float(power[(frequencies >= low_Hz) & (frequencies <= high_Hz)].sum()) / total if total > 0 else 0.0


def outlier(signal: np.ndarray) -> int | None:
    """Index of a sample so far beyond all others but a few that nothing which moves comes there and back."""
    off = np.abs(signal - np.median(signal))
    rest = float(np.partition(off, -_FEW)[-_FEW])
    return int(np.argmax(off)) if off.max() > _BEYOND * rest > 0 else None


_BLIP = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
"""Fourth differences about a single sample that is off by one."""


def blips(signal: np.ndarray) -> np.ndarray:
    """Indices of single samples that are off while all around them is smooth: a recorder's, since nothing moves so."""
    bend = np.convolve(signal, _BLIP, "valid")
    height = np.convolve(bend, _BLIP, "same") / float(_BLIP @ _BLIP)
    least = _SPIKE * max(float(np.median(np.abs(height))), finest_step(signal))
    found = []
    for k in np.flatnonzero(np.abs(height[2:-2]) > least) + 2:
        rest = bend[k - 2 : k + 3] - height[k] * _BLIP
        sticks_out = np.min(np.sign(height[k]) * (signal[k + 2] - signal[[k + 1, k + 3]])) > 0.5 * abs(height[k])
        if sticks_out and np.abs(rest).max() < _UNLIKE * abs(height[k]) * float(_BLIP.max()):
            found.append(k + 2)
    return np.array(found, dtype=int)


def bridged(record: TimeRecord) -> tuple[TimeRecord, list[Caution]]:
    """A record with single samples of one channel that are off put onto the cubic through the two on either side."""
    at = {name: blips(signal) for name, signal in record.measured.items()}
    steps = np.abs(np.diff(record.inputs, axis=0))
    kicks = (np.minimum(steps[:-1], steps[1:]) > _SPIKE * np.median(steps, axis=0)).any(axis=1)  # by force or command
    many = np.bincount(np.concatenate([*at.values(), np.flatnonzero(kicks) + 1]), minlength=1)
    measured, found = dict(record.measured), []
    for name, every in at.items():
        own = every[many[every] == 1]  # what several channels show has happened
        if not len(own):
            continue
        measured[name] = measured[name].copy()
        for k in own:
            measured[name][k] -= float(_BLIP @ measured[name][k - 2 : k + 3]) / float(_BLIP.max())
        own = own[record.counted[own] > 0]  # of spans that do not count nothing is to be said
        if len(own):
            first = f"first at {record.times[own[0]]:.4g} s"
            text = f"{name} has {len(own)} single samples that are spoilt, {first}: bridged"
            found.append(Caution("spoilt", record.name, text, limits_confidence=len(own) > _OFTEN * len(record.times)))
    return replace(record, measured=measured), found


def equal_runs(signal: np.ndarray, least: int) -> list[tuple[int, int]]:
    """First index and length of every run of equal values that is long enough."""
    edges = np.flatnonzero(np.diff(signal) != 0) + 1
    starts = np.concatenate([[0], edges])
    lengths = np.diff(np.concatenate([starts, [len(signal)]]))
    return [(int(a), int(n)) for a, n in zip(starts[lengths >= least], lengths[lengths >= least], strict=True)]


def clipped(signal: np.ndarray) -> tuple[float, int, str] | None:
    """Find flat tops or bottoms that a signal runs into at speed.

    A signal that comes to rest at its extreme, or whose recorder rounds, does so slowly; one that is cut off has a
    kink. Where there is noise enough to carry every sample to another step, many equal ones at an extreme say the same.

    Returns:
        the level, how many samples are cut off, and where: `top`, `bottom` or `both`.
    """
    step, noise = finest_step(signal), noise_std(signal)
    if step == 0:
        return None
    found: dict[str, list[tuple[int, int]]] = {}
    levels = {"bottom": float(signal.min()), "top": float(signal.max())}
    for side, level in levels.items():
        runs = [run for run in equal_runs(signal, _PLATEAU) if signal[run[0]] == level]
        kinked = [run for run in runs if _kinked(signal, *run, _KINK * max(step, noise))]
        if noise > NOISY * step and sum(n for _, n in runs) >= _MANY:
            found[side] = runs
        elif sum(n for _, n in kinked) >= _CUT:
            found[side] = kinked
    if not found:
        return None
    side = next(iter(found)) if len(found) == 1 else "both"
    return levels.get(side, levels["top"]), sum(n for runs in found.values() for _, n in runs), side


def _kinked(signal: np.ndarray, first: int, length: int, least: float) -> bool:
    """Whether a signal runs into a plateau and out of it at speed."""
    level, after = signal[first], first + length
    if first < 2 or after + 1 >= len(signal):
        return False
    ends = signal[[first - 1, after]], signal[[first - 2, after + 1]]
    return bool(np.minimum(np.abs(ends[0] - level), 2 * np.abs(ends[1] - level)).min() > least)


def stuck(signal: np.ndarray) -> list[tuple[int, int]]:
    """First index and length of runs of one value from which a signal jumps: lost samples filled with the last one."""
    step = finest_step(signal)
    moves = np.abs(np.diff(signal))
    moving = moves[moves > 0]
    if step == 0 or not len(moving):
        return []
    usual = max(_KINK * step, 4 * float(np.median(moving)), _JUMP * noise_std(signal))
    low, high = float(signal.min()), float(signal.max())
    runs = []
    for first, length in equal_runs(signal, _STUCK):
        after = first + length
        if after >= len(signal) or first == 0 or signal[first] in (low, high):
            continue
        # One that rested before, and then was pushed, has lost nothing.
        before = signal[max(first - length, 0) : first + 1]
        if abs(signal[after] - signal[first]) > usual and float(np.ptp(before)) > usual:
            runs.append((first, length))
    return runs


def ended(signal: np.ndarray) -> int:
    """Samples at the end that are exactly alike though noise moved all before them: a recorder's that had stopped."""
    first, length = equal_runs(signal, 1)[-1]
    before = signal[:first]
    noisy = first >= _FEWEST_SAMPLES and noise_std(before) > NOISY * finest_step(before) > 0
    return length if noisy and length >= 2 * _MANY else 0


def holes(signal: np.ndarray) -> int:
    """Samples that are exactly zero though both neighbours are far from it: a recorder's missing values."""
    bend = np.abs(np.diff(signal, 2))
    usual = float(np.median(bend))
    far = np.minimum(signal[:-2] * np.sign(signal[2:]), np.abs(signal[2:])) > 0.5 * float(np.std(signal))
    return int(np.sum((signal[1:-1] == 0) & far & (bend > _SPIKE * usual) & (usual > 0)))


Finding = tuple[str, str]
"""Name of a caution, and its words."""
Check = Callable[[TimeRecord, Prototype], Iterator[Finding]]
_LEFT_IN = ("stuck", "not_at_rest", "sensor_zero", "unfelt_force")
_HARMLESS = ("short", "no_content", "sensor_zero")  # to the confidence in the other records

LOW_HZ, HIGH_HZ = 0.5, 300.0
"""Band in which a record must say something, of a rig as quick as the published one."""
_SHORTEST_S = 0.3
_PERIODS = 3  # a loop of high order swings slowly itself, and a fit knows how it begins: at rest
_FEWEST_SAMPLES = 32
_SAMPLES_PER_PERIOD = 5.0
_LEAST_SHARE = 0.02
_LEAST_SIGNAL = 3.0  # over its noise
_RESTLESS = 8.0  # in standard deviations of the noise
_MOVED = 0.1  # of the rms
_SET_OFF_S, ENDS = 3e-3, 3  # in which a drive moves a rig at rest but little; samples
_NOTHING = 1e-30  # in any unit
_STIFFER = 30.0  # than believed no rig is
_MISFIT = 0.6  # of the displacement
_HEAVIEST = 50.0  # times the outer beam's own mass


def cautions(
    check: Check, records: Iterable[TimeRecord], prototype: Prototype, most: int | None = None
) -> list[Caution]:
    """What a check finds of every record, no more than so many of each; by its name whether the record is left out."""
    found = ((record.name, *each) for record in records for each in islice(check(record, prototype), most))
    return [Caution(name, of, text, name not in _LEFT_IN, name not in _HARMLESS) for of, name, text in found]


def where_it_counts(record: TimeRecord) -> TimeRecord:
    """A record with straight lines across the spans that do not count: what is spoilt there spoils nothing."""
    there = record.counted > 0
    if there.all() or not there.any():
        return record
    across = {name: np.interp(record.times, record.times[there], y[there]) for name, y in record.measured.items()}
    return replace(record, measured=across)


def signals(record: TimeRecord, _: Prototype) -> Iterator[Finding]:
    """What its signals show on their own, where they count."""
    record, there = where_it_counts(record), record.counted > 0
    if len(record.times) < _FEWEST_SAMPLES:
        yield "short", f"only {len(record.times)} samples: record at least {_FEWEST_SAMPLES}"
        return
    for name, signal in record.measured.items():
        if float(np.ptp(signal)) < _NOTHING:
            yield "dead_channel", f"{name} never changes (is the sensor connected?)"
        elif name != "current_A" and (at := outlier(signal)) is not None:  # a law's kick may be one sample long
            text = f"{name} is {signal[at]:.4g} at {record.times[at]:.4g} s, far beyond all others"
            yield "outlier", f"{text}: a sample is spoilt"
        elif cut := clipped(signal):
            # An amplifier at its limit cuts a current as well; its equation tells more.
            level, samples, side = cut
            if name != "current_A" or not _symmetric(signal, side):
                text = f"{level:.4g}{' and its opposite' if side == 'both' else ''}, {samples} samples long"
                yield "clipped", f"{name} is cut off at {text}: widen the recorder's range, or drive less"
        elif name != "current_A" and (still := ended(signal[there])):  # a current may be held by a coarse controller
            since = record.times[there][-still]
            text = f"{name} stands exactly still over its last {still} samples, from {since:.4g} s on"
            yield "ended", f"{text}: its recorder had stopped, so cut the record there"
        elif gaps := stuck(signal):
            text = f"for {sum(n for _, n in gaps)} samples and jumps, first at {record.times[gaps[0][0]]:.4g} s"
            yield "stuck", f"{name} stands still {text}: samples were lost"
        elif lost := holes(signal):
            places = "1 place" if lost == 1 else f"{lost} places"
            yield "stuck", f"{name} is exactly zero in mid-motion, in {places}: samples were lost"


def _symmetric(current: np.ndarray, side: str) -> bool:
    high, low = float(current.max()), -float(current.min())
    if side == "both":
        return abs(high - low) < 0.05 * max(high, low)
    # One side only is an amplifier's doing where the other never came as far.
    return (low if side == "top" else high) <= 1.02 * (high if side == "top" else low)


def law(record: TimeRecord, prototype: Prototype) -> Iterator[Finding]:
    """Whether its current has a sample that is none of its controller's making."""
    if (asked := commanded_current(record, record.controller, prototype.sensor.gain_V_per_m)) is None:
        return
    current, command = record.measured["current_A"], record.inputs[:, 1]
    for at in (outlier(current), outlier(command)):
        if at is not None and abs(current[at] - asked[at]) > 0.5 * max(abs(current[at]), abs(asked[at])):
            text = (
                f"current_A is {current[at]:.4g} at {record.times[at]:.4g} s, where its controller "
                f"({described(record.controller)}) makes {asked[at]:.4g} of command_V ({command[at]:.4g}) and "
                "displacement_m: a sample is spoilt"
            )
            yield "outlier", text


def too_heavy(end_masses_kg: Iterable[float], prototype: Prototype) -> str:
    """Why end masses are in another unit, in words; empty where they may be kilograms."""
    heaviest, own = max(end_masses_kg), figures(prototype)["outer_mass"]
    words = f"an end mass of {heaviest:g} kg on a beam of {own:.3g} kg is not credible (is it in grams?)"
    return words if heaviest > _HEAVIEST * own else ""


def suitability(record: TimeRecord, prototype: Prototype) -> Iterator[Finding]:
    """Whether it is long and fine enough and excited where it matters, for the loop as believed."""
    of, loop, moved = figures(prototype), nominal_loop(prototype, record), record.measured["displacement_m"]
    if heavy := too_heavy(record.masses, prototype):
        yield "units", heavy

    length, slowest = float(record.times[-1] - record.times[0]), loop.slowest_Hz
    low, high = widened(prototype, LOW_HZ, HIGH_HZ)
    shortest = _SHORTEST_S * HIGH_HZ / high
    if length < (least := max(shortest, _PERIODS / slowest)):
        needed = f"{_PERIODS} periods of the slowest mode, and at least {shortest:.2g} s"
        yield "short", f"too short: {length:.3g} s, but {least:.2g} s are needed ({needed})"
    if 1 / record.step < _SAMPLES_PER_PERIOD * slowest:
        needed = f"for a mode at {slowest:.3g} Hz at least {_SAMPLES_PER_PERIOD * slowest:.3g} Hz is needed"
        yield "coarse_sampling", f"sampled too coarsely: {1 / record.step:.4g} Hz, {needed} (are the times in seconds?)"

    # A rig may stand still where it is commanded to move, but it cannot help bending under a force.
    force, size = record.inputs[:, 0], rms(moved)
    pushed = loop.stable and rms(force) >= size * of["outer_stiffness"]
    if pushed and (bent := rms(loop.driven(record.inputs, record.step)[:, 1, 0])) >= _STIFFER * size:
        at = int(np.argmax(np.abs(force)))
        text = (
            f"disturbance_N would move the believed rig by {bent:.2g} m rms, but displacement_m is {size:.2g} m: check "
            "the units of both, and zero and outliers of the force "
            f"(it reaches {force[at]:.4g} N at {record.times[at]:.4g} s)"
        )
        yield "force", text

    band = f"between {low:g} and {high:g} Hz"
    if not np.any(np.ptp(record.inputs, axis=0) > 0):
        yield "no_content", f"both inputs are constant: excite the rig {band}"
    # What each input would move the tip by, if slowly.
    given = record.inputs / np.array([of["outer_stiffness"], prototype.sensor.gain_V_per_m])
    share, of_motion = (share_in_band(signals, record.step, low, high) for signals in (given, moved[:, None]))
    if share < _LEAST_SHARE and of_motion < 10 * _LEAST_SHARE:
        lies = f"only {share:.1%} of the inputs' power lies {band}, and little of the motion"
        yield "no_content", f"{lies}: excite the rig there"
    size, noise = float(np.std(moved)), max(noise_std(moved), finest_step(moved) / np.sqrt(12))
    if size < _LEAST_SIGNAL * noise:
        seen = f"displacement_m is {size:.2g} m rms with a noise of {noise:.2g} m"
        yield "no_content", f"{seen}: nothing is to be seen, drive harder"


def remarks(record: TimeRecord, prototype: Prototype) -> Iterator[Finding]:
    """What is worth saying of a record that is used."""
    moved = record.measured["displacement_m"]
    noise, size = max(noise_std(moved), finest_step(moved)), float(np.std(moved))
    start = float(np.mean(moved[:3]))
    most = max(_RESTLESS * noise, _MOVED * size)
    if abs(start) > most:
        begins = f"displacement_m begins at {start:.3g} m (rms {size:.2g} m); what it rests at is no part of it:"
        begins += " `beamdesign gap import --rest-s` takes that off"
        yield "not_at_rest", f"does not start at rest without load: {begins}"
    loop = nominal_loop(prototype, record)
    count = max(2 * ENDS, round(_SET_OFF_S / record.step))
    made = loop.driven(record.inputs, record.step)[:, 1].sum(axis=1) if loop.stable else moved
    gone, by_drive = (float(np.mean(y[count - ENDS : count]) - np.mean(y[:ENDS])) for y in (moved, made))
    if count * record.step <= 4 * _SET_OFF_S and abs(gone) > max(most, 2 * abs(by_drive)):
        goes = f"displacement_m goes {gone:.3g} m in its first {count} samples, its inputs make less"
        yield "not_at_rest", f"does not start at rest: {goes}"
    if (pressure := record.measured.get("load_pressure_Pa")) is not None:
        first = float(np.mean(pressure[:3]))
        if abs(first) > max(_RESTLESS * noise_std(pressure), _MOVED * float(np.std(pressure))):
            text = f"load_pressure_Pa begins at {first:.3g} Pa, and counts from rest without load"
            yield "sensor_zero", f"{text}: subtract what its sensor shows there"


def masses(record: TimeRecord, prototype: Prototype, pairs: Sequence[tuple[float, float]]) -> Iterator[Finding]:
    """Whether it fits the believed loop badly with its own end masses, and well with those of another record."""
    own = _misfit(record, prototype, *record.masses)
    if len(pairs) > 1 and own >= _MISFIT:
        best, (outer, inner) = min((_misfit(record, prototype, *pair), pair) for pair in pairs)
        if best < min(0.4 * own, 0.35):
            stated = f"its end masses ({record.outer_end_mass:g} and {record.inner_end_mass:g} kg)"
            others = f"those of another record ({outer:g} and {inner:g} kg)"
            yield "masses", f"does not fit {stated}, but {others}: correct dataset.toml"


def _misfit(record: TimeRecord, prototype: Prototype, outer: float, inner: float) -> float:
    loop = nominal_loop(prototype, replace(record, outer_end_mass=outer, inner_end_mass=inner))
    if not loop.stable:
        return np.inf
    return mismatch(record.measured["displacement_m"], loop.driven(record.inputs, record.step)[:, 1].sum(axis=1))[0]
