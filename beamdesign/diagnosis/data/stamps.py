"""Time stamps that jitter, and samples that are lost: which instants samples belong to, and their values at even times.

A computer that stamps what an even clock has sampled is late by a little, now more, now less; one that samples when it
gets round to it stamps truly. Either reading has its own error where it is wrong, the slope of a signal times what the
stamp is off, and the samples tell which is right: a curve through six neighbours meets a sample better at the instants
at which they were taken.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.fft import dct
from scipy.interpolate import CubicSpline

from beamdesign.columns import unrising
from beamdesign.diagnosis.data.input_noise import denoised, is_answered
from beamdesign.records import InputError, Problem

Clock = Literal["even", "stamps"]
LARGEST_ERROR = 0.01
"""Of a channel's root mean square: what values at even times may be off, and what may stay untold."""
_NO_ERROR = 1e-3
_IN_PLACE = 1e-3  # of an interval
_HALF, _FOLLOWED = 0.5, 0.1  # of an interval; how quickly an interval that is looked for follows the stamps
_FEWEST, _EXACT = 16, 1e-12
_CLEARER, _CHANCE = 1.2, 3.0  # times as rough, at any length and by chance among N samples over sqrt(N)
_SPLINE = 5 / 384  # of h^4 |x''''|: C. A. Hall and W. W. Meyer, J. Approximation Theory 16 (1976) 105
_MAY_STAND = ("t_s", "command_V", "current_A")
_MOSTLY = 0.8  # of the rows at which a value may change
_AROUND = np.array([-3, -2, -1, 1, 2, 3])


@dataclass(frozen=True)
class Stamps:
    """Stamps of a record beside an even clock.

    Attributes:
        times: (N,) s, rising.
        number: (N,) whole intervals of the even clock from the first sample; empty where no even clock has such stamps.
        even_s: (N,) instants of that clock.
        better: by channel how many times better its samples fit the even clock than their stamps.
        apart: by channel how far both readings are apart, over its standard deviation.
    """

    times: np.ndarray = field(repr=False)
    number: np.ndarray = field(repr=False)
    even_s: np.ndarray = field(repr=False)
    better: Mapping[str, float]
    apart: Mapping[str, float]

    @property
    def jitter(self) -> float:
        """How far a stamp lies at most from the even clock, in intervals."""
        return float(np.abs(self.times - self.even_s).max() / self.interval_s) if len(self.number) else np.inf

    @property
    def interval_s(self) -> float:
        """Of the clock; the median of the stamps' where there is none."""
        if not len(self.number):
            return float(np.median(np.diff(self.times)))
        return float((self.even_s[-1] - self.even_s[0]) / self.number[-1])

    @property
    def lost(self) -> int:
        """Samples that the even clock has and the record has not."""
        return int(self.number[-1]) + 1 - len(self.number) if len(self.number) else 0

    @property
    def clear(self) -> float:
        """How many times better samples have to fit for that to count."""
        return _CLEARER + _CHANCE / float(np.sqrt(len(self.times)))

    @property
    def clock(self) -> Clock | None:
        """At which instants samples were taken, as far as they tell; None where it matters and they do not."""
        if not len(self.number):
            return "stamps"
        if max(self.apart.values(), default=0.0) <= _NO_ERROR:
            return "even"
        for_even, for_stamps = (any(b**sign > self.clear for b in self.better.values()) for sign in (1, -1))
        if for_even != for_stamps:
            return "even" if for_even else "stamps"
        return "even" if not for_even and max(self.apart.values()) <= LARGEST_ERROR else None


def stamps_of(times: np.ndarray, channels: Mapping[str, np.ndarray]) -> Stamps:
    """What stamps say, beside an even clock.

    Args:
        times: (N,) s, rising.
        channels: (N,) each, finite, by name.
    """
    number, even = _even(times)
    better, apart = dict[str, float](), dict[str, float]()
    for name, values in channels.items() if len(number) and len(times) >= _FEWEST else ():
        if np.ptp(values) > 0:
            slope = np.gradient(denoised(values)[0], even)
            apart[name] = float(np.sqrt(np.mean((slope * (times - even)) ** 2)) / np.std(values))
            rough = [_roughness(instants, values) for instants in (times, even)]
            better[name] = rough[0] / rough[1] if min(rough) > _EXACT * np.std(values) else 1.0
    return Stamps(times, number, even, better, apart)


def _even(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) numbers of samples on an even clock, and (N,) s of them; empty where stamps are half of one off."""
    since, found, least = times - times[0], (np.empty(0, dtype=int), np.empty(0)), _HALF
    for tracked in (False, True):  # a line through all of them may pass a lost sample by half an interval
        number = _tracked(since) if tracked else np.arange(len(since))
        interval, begin = np.polyfit(number, since, 1)
        even = begin + interval * number
        if (off := float(np.abs(since - even).max() / interval)) < least:
            found, least = (number, times[0] + even), off
        if least < _HALF / 2:
            break
    return found


def _tracked(since: np.ndarray) -> np.ndarray:
    """(N,) numbers of samples by a clock that is led along by the stamps, so that lost ones count."""
    interval, at, numbers = float(np.median(np.diff(since))), 0.0, [0]
    for stamp in since[1:].tolist():
        passed = max(1, round((stamp - at) / interval))
        at += passed * interval
        at += _FOLLOWED * (stamp - at)
        numbers.append(numbers[-1] + passed)
    return np.array(numbers)


def _roughness(instants: np.ndarray, values: np.ndarray) -> float:
    """How far a sample is typically from the quintic through three neighbours to either side, over noise's part of it.

    Of white noise it is the median of its magnitude, whatever the instants are.
    """
    at = np.arange(3, len(values) - 3)
    near, here = instants[at[:, None] + _AROUND], instants[at][:, None]
    weights = np.ones(near.shape)
    for j in range(len(_AROUND)):
        others = np.delete(near, j, axis=1)
        weights[:, j] = np.prod((here - others) / (near[:, j : j + 1] - others), axis=1)
    off = values[at] - np.sum(weights * values[at[:, None] + _AROUND], axis=1)
    return float(np.median(np.abs(off) / np.sqrt(1 + np.sum(weights**2, axis=1))))


def spline_at(
    times: np.ndarray, instants: np.ndarray, values: np.ndarray, motion: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """A cubic spline through samples at other times, and by how much it may be off by their own spectrum.

    But for its ends, a spline through samples of a sine with h between them at most is off by 5/384 (2 pi f h)^4 of it
    at most; what is told is the root of the sum of the squares of that over the lines of the spectrum, as for phases
    that have nothing to do with one another. White noise is left out, which stays noise, unless a motion answers it.

    Args:
        times: (N,) s, in even steps or nearly so.
        instants: (M,) s, rising.
        values: (M,)
        motion: (N,) what answers these where they drive the rig.

    Returns:
        (N,) values; and their error over their standard deviation.
    """
    found = CubicSpline(instants, values)(times)
    signal, size = denoised(found)[0], float(np.std(found))
    if motion is not None and is_answered(found - signal, motion):
        signal = found
    length, widest = (times[-1] - times[0]) * len(times) / (len(times) - 1), float(np.diff(instants).max())
    gain = _SPLINE * (np.pi * np.arange(1, len(times)) / length * widest) ** 4
    error = np.sqrt(np.mean((gain * dct(signal, norm="ortho")[1:]) ** 2))
    return found, float(error / size) if size > 0 else 0.0


def standing(values: np.ndarray) -> int:
    """Rows for which every value of a channel stands, before there is another one; 1 where values do not repeat."""
    changes = np.flatnonzero(np.diff(values)) + 1
    if len(changes) < _FEWEST or len(np.unique(values)) < _FEWEST or not np.all(np.isfinite(values)):
        return 1
    rows = int(np.gcd.reduce(np.diff(changes)))
    return rows if rows * len(changes) > _MOSTLY * len(values) else 1


def _blanked(values: np.ndarray, rows: int) -> np.ndarray:
    """Values of a channel, each where it came and missing where it is repeated."""
    first = int(np.flatnonzero(np.diff(values))[0]) + 1
    return np.where((np.arange(len(values)) - first) % rows == 0, values, np.nan)


def filled(path: Path, table: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """A record in which channels have values that are missing, as where they were sampled less often: by splines.

    A recorder may repeat a value until there is another one: repeats are as good as missing. Not so of what a sampled
    controller puts out, which does stand still.

    Args:
        path: of the file it is from.
        table: (N,) each, by channel, of which all but the times in `t_s` may be NaN here and there.

    Returns:
        (M,) each, from where all have begun to where none has ended; and of those that were filled, what was done.

    Raises:
        InputError: with where values are missing and cannot be told from the others.
    """
    stands = {name: 1 if name in _MAY_STAND else standing(values) for name, values in table.items()}
    table = {name: values if stands[name] == 1 else _blanked(values, stands[name]) for name, values in table.items()}
    there = {name: np.flatnonzero(np.isfinite(values)) for name, values in table.items()}
    if not (lacking := [name for name, held in there.items() if len(held) < len(table["t_s"])]):
        return dict(table), {}
    if reason := unrising(table["t_s"]):
        raise InputError(path, [("t_s", reason)])
    if wrong := [Problem(name, "has hardly a number in it") for name in lacking if len(there[name]) < _FEWEST]:
        raise InputError(path, wrong)
    rows = slice(max(held[0] for held in there.values()), min(held[-1] for held in there.values()) + 1)
    found, words = {name: values[rows] for name, values in table.items()}, dict[str, str]()
    times, held = table["t_s"], there.get("displacement_m", ())
    motion = np.interp(found["t_s"], times[held], table["displacement_m"][held]) if len(held) else None
    for name in lacking:
        at = there[name]
        other = None if name == "displacement_m" else motion
        found[name], error = spline_at(found["t_s"], times[at], table[name][at], other)
        if error > LARGEST_ERROR:
            gap = int(np.argmax(np.diff(at)))
            first = f"{at[gap + 1] - at[gap] - 1} behind number {at[gap] + 1} of {len(times)}"
            many = f"{len(times) - len(at)} values that are {'repeated' if stands[name] > 1 else 'not finite'}"
            reason = f"has {many}: the most in a row are {first}, and by its"
            reason += f" spectrum a spline would be off by {min(error, 1):.2g} of it there (at most {LARGEST_ERROR:g})"
            wrong.append(Problem(name, reason))
        repeated = f"values that repeat the last, {stands[name] - 1} of {stands[name]},"
        what = repeated if stands[name] > 1 else "missing values"
        words[name] = f"{what} of {name} are splines, off by about {error:.1g} of it"
    if wrong:
        raise InputError(path, wrong)
    return found, words


def evened(
    path: Path, table: Mapping[str, np.ndarray], stated: Clock | None = None
) -> tuple[Mapping[str, np.ndarray], str]:
    """A record at even times, and what was done to it; as it is where stamps tell of an even clock without a gap.

    Args:
        path: of the file it is from.
        table: (N,) each, by channel, the times in `t_s`; as it is, too, where these fall or a few repeat.
        stated: whether samples were taken by an even clock or when their stamps say; else they tell it themselves.

    Raises:
        InputError: where they do not and it matters, where many repeat or there is no even clock, and where values at
            even times would be off by more than `LARGEST_ERROR`.
    """
    times, channels = table["t_s"], {name: values for name, values in table.items() if name != "t_s"}
    steps = np.diff(times)
    if np.sum(steps == 0) >= _FEWEST and steps.min() == 0 < steps.max():  # not a row that stands there twice
        interval = f"--column 't_s = {np.polyfit(np.arange(len(times)), times, 1)[0]:.4g} [s]'"
        reason = "where stamps have too few digits for an even clock, state its interval"
        raise InputError(path, [("t_s", f"{unrising(times)}: {reason}, such as {interval}")])
    if len(times) < _FEWEST or not np.all(steps > 0):
        return table, ""
    stamps = stamps_of(times, channels)
    clock, most = stated or stamps.clock, max(stamps.apart, key=lambda name: stamps.apart[name], default="")
    if clock is None:
        reason = (
            f"stamps lie up to {stamps.jitter:.2g} of an interval off an even clock, which makes"
            f" {stamps.apart[most]:.2g} of {most}, and the samples do not tell which is right: --clock even where a"
            " recorder took them and they were stamped later, --clock stamps where they were taken when the stamps say"
        )
        raise InputError(path, [("t_s", reason)])
    if clock == "even" and not len(stamps.number):
        how = "--clock stamps, or cut the record where it halts"
        raise InputError(path, [("--clock", f"no even clock is within half an interval of every stamp: {how}")])
    said, off = [], f"up to {stamps.jitter:.2g} of an interval off ({stamps.apart.get(most, 0.0):.2g} of {most})"
    if not len(stamps.number):
        said.append("samples are taken at their stamps, which are of no even clock")
    elif stamps.apart.get(most, 0.0) > _NO_ERROR:
        this, other = ("an even clock", "their stamps") if clock == "even" else ("their stamps", "an even clock")
        fits = max(b if clock == "even" else 1 / b for b in stamps.better.values())
        how = f"which they fit {fits:.2g} times as well as {other}"
        if stated:
            how = "as stated" + f", though they fit {other} better" * (stamps.clock not in (None, stated))
        elif fits <= stamps.clear:
            how = "though they do not tell"
        said.append(f"samples are taken at {this}, {how}; {'stamps are' if clock == 'even' else 'it is'} {off}")
    if clock == "even" and not stamps.lost:
        even = np.linspace(stamps.even_s[0], stamps.even_s[-1], len(times))
        return {**table, "t_s": even - even[0]} if said else table, "; ".join(said)
    instants = stamps.even_s if clock == "even" else times
    count = round(float(instants[-1] - instants[0]) / stamps.interval_s)
    even = np.linspace(instants[0], instants[-1], count + 1)
    motion = np.interp(even, instants, channels["displacement_m"]) if "displacement_m" in channels else None
    splines = {
        name: spline_at(even, instants, values, None if name == "displacement_m" else motion)
        for name, values in channels.items()
    }
    errors = {name: error for name, (_, error) in splines.items()}
    worst = max(errors, key=lambda name: errors[name])
    what = f"values of lost rows ({stamps.lost})" if clock == "even" else "values at even times"
    if errors[worst] > LARGEST_ERROR:
        gap = int(np.argmax(np.diff(instants)))
        where = f"behind {instants[gap]:.6g} s there is none for {instants[gap + 1] - instants[gap]:.3g} s"
        reason = (
            f"not uniform: {what} cannot be told from the others: by its spectrum {worst} would be off by"
            f" {errors[worst]:.2g} of itself (at most {LARGEST_ERROR:g}), as {where}: cut the record there, or"
            " take more samples a second"
        )
        raise InputError(path, [("t_s", reason)])
    said.append(f"{what} are splines, off by about {errors[worst]:.1g} of {worst}")
    return {name: even - even[0] if name == "t_s" else splines[name][0] for name in table}, "; ".join(said)


def refuse_uneven(path: Path, table: Mapping[str, np.ndarray], times: np.ndarray) -> str:
    """Refuse samples that were taken when their stamps say, where even times are taken for them.

    Args:
        path: of the file they are from.
        table: (N,) each, by channel, the stamps in `t_s`.
        times: (N,) s, even.

    Returns:
        what to warn of where samples do not tell; else empty.

    Raises:
        InputError: with what to do.
    """
    if len(times) < _FEWEST or np.abs(table["t_s"] - times).max() < _IN_PLACE * (times[1] - times[0]):
        return ""
    stamps = stamps_of(table["t_s"], {name: values for name, values in table.items() if name != "t_s"})
    words = f"stamps lie up to {stamps.jitter:.2g} of an interval off an even clock"
    if stamps.clock == "stamps":
        how = "`beamdesign gap import` puts them at even times"
        reason = f"not uniform: {words}, and samples were taken when these say: {how}"
        raise InputError(path, [("t_s", reason)])
    return "" if stamps.clock else f"{words}, which samples are taken at, though they do not tell that they were"
