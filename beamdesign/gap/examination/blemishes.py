"""What a recorder does to a signal, seen in the signal alone: clipping, outliers, sticking, coarse steps, noise."""

from dataclasses import dataclass

import numpy as np

_PLATEAU = 4  # samples at the very same value
_CUT = 8  # samples on plateaus altogether: fewer may be chance, and spoil nothing
_STUCK = 6
_TOP = 0.8  # of the Nyquist frequency: above it there is only noise
_MANY = 12
_KINK = 3.0  # by how many of its finest steps, or of its noise, a signal runs into a plateau
_JUMP = 8.0  # in the noise of the signal
_FEW = 5  # samples
_BEYOND = 10.0
_SPIKE = 15.0  # in typical second differences


@dataclass(frozen=True)
class Plateau:
    """Samples that stay at one value though the signal moves.

    Attributes:
        level: that value.
        samples: how many.
        first: index of the first.
        side: `top`, `bottom` or `both` where the value is an extreme; empty where it is not.
    """

    level: float
    samples: int
    first: int
    side: str = ""


def finest_step(signal: np.ndarray) -> float:
    """Least difference between two values of a signal; 0 for a constant one."""
    values = np.unique(signal)
    if len(values) < 2:
        return 0.0
    steps = np.diff(values)
    span = float(values[-1] - values[0])
    real = steps[steps > 1e-9 * span]
    return float(real.min()) if len(real) else 0.0


def noise_std(signal: np.ndarray) -> float:
    """White noise of a signal, from the top of its spectrum, or that of rounding where this is more."""
    centred = signal - signal.mean()
    power = np.abs(np.fft.rfft(centred * np.hanning(len(signal)))) ** 2
    top = power[round(_TOP * (len(power) - 1)) :]
    white = float(np.median(top)) / np.log(2) / float(np.sum(np.hanning(len(signal)) ** 2))
    return float(np.sqrt(white))


def share_between(signals: np.ndarray, step_s: float, low_Hz: float, high_Hz: float) -> float:
    """Share of the variance of signals (N, m) that lies within a band."""
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


def _runs(signal: np.ndarray, least: int) -> list[tuple[int, int]]:
    """First index and length of every run of equal values that is long enough."""
    edges = np.flatnonzero(np.diff(signal) != 0) + 1
    starts = np.concatenate([[0], edges])
    lengths = np.diff(np.concatenate([starts, [len(signal)]]))
    return [(int(a), int(n)) for a, n in zip(starts[lengths >= least], lengths[lengths >= least], strict=True)]


def clipped(signal: np.ndarray) -> Plateau | None:
    """Find flat tops or bottoms that a signal runs into at speed.

    A signal that comes to rest at its extreme, or whose recorder rounds, does so slowly; one that is cut off has a
    kink. Where there is noise enough to carry every sample to another step, many equal ones at an extreme say the same.
    """
    step, low, high = finest_step(signal), float(signal.min()), float(signal.max())
    if step == 0:
        return None
    noise = noise_std(signal)
    least = max(_KINK * step, _KINK * noise)
    noisy = noise > 0.5 * step
    kinked: dict[str, list[tuple[int, int]]] = {"bottom": [], "top": []}
    all_runs: dict[str, list[tuple[int, int]]] = {"bottom": [], "top": []}
    for first, length in _runs(signal, _PLATEAU):
        level = signal[first]
        if level not in (low, high):
            continue
        after = first + length
        jumps = []
        if first >= 2:
            jumps.append(min(abs(signal[first - 1] - level), 2 * abs(signal[first - 2] - level)))
        if after + 1 < len(signal):
            jumps.append(min(abs(signal[after] - level), 2 * abs(signal[after + 1] - level)))
        side = "top" if level == high else "bottom"
        all_runs[side].append((first, length))
        if len(jumps) == 2 and min(jumps) > least:
            kinked[side].append((first, length))
    found = {}
    for side, runs in all_runs.items():
        cut = kinked[side] if sum(n for _, n in kinked[side]) >= _CUT else []
        found[side] = runs if noisy and sum(n for _, n in runs) >= _MANY else cut
    sides = [side for side, runs in found.items() if runs]
    if not sides:
        return None
    runs = [run for side in sides for run in found[side]]
    side = sides[0] if len(sides) == 1 else "both"
    return Plateau(low if side == "bottom" else high, sum(n for _, n in runs), min(a for a, _ in runs), side)


def stuck(signal: np.ndarray) -> Plateau | None:
    """Find runs of one value from which a signal goes on with a jump: lost samples filled with the last one."""
    step = finest_step(signal)
    moves = np.abs(np.diff(signal))
    moving = moves[moves > 0]
    if step == 0 or not len(moving):
        return None
    usual = max(_KINK * step, 4 * float(np.median(moving)), _JUMP * noise_std(signal))
    low, high = float(signal.min()), float(signal.max())
    runs = []
    for first, length in _runs(signal, _STUCK):
        after = first + length
        if after >= len(signal) or first == 0 or signal[first] in (low, high):
            continue
        # One that rested before, and then was pushed, has lost nothing.
        before = signal[max(first - length, 0) : first + 1]
        if abs(signal[after] - signal[first]) > usual and float(np.ptp(before)) > usual:
            runs.append((first, length))
    if not runs:
        return None
    return Plateau(float(signal[runs[0][0]]), sum(n for _, n in runs), runs[0][0])


def holes(signal: np.ndarray) -> int:
    """Samples that are exactly zero though both neighbours are far from it: a recorder's missing values."""
    bend = np.abs(np.diff(signal, 2))
    usual = float(np.median(bend))
    far = np.minimum(signal[:-2] * np.sign(signal[2:]), np.abs(signal[2:])) > 0.5 * float(np.std(signal))
    return int(np.sum((signal[1:-1] == 0) & far & (bend > _SPIKE * usual) & (usual > 0)))
