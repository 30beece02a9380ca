"""Pictures of a diagnosis: records beside their predictions, errors by frequency, compliance before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from beamdesign.diagnosis.diagnosis import BandGap, Errors
from beamdesign.diagnosis.gap_metrics import in_bands
from beamdesign.loop import LoopAtMass
from beamdesign.report.canvas import new_figure
from beamdesign.report.figures import plot_compliance

MODELS = ("before", "tuned", "after")
WORDS = {"before": "as believed", "tuned": "re-tuned", "after": "with the cause", "noise": "noise alone"}
# Told apart on white, on black and, by their dashes, in grey print.
LINES: dict[str, dict[str, Any]] = {
    "before": {"color": "#d1495b", "linestyle": (0, (5, 2))},
    "tuned": {"color": "#c08a1e", "linestyle": (0, (1.5, 1.2))},
    "after": {"color": "#2a8fb8", "linestyle": "-"},
    "noise": {"color": "0.5", "linestyle": ":"},
}
_TURNS = 7.0  # of the largest error's main frequency that a zoom shows
_SHORTEST_S, _LONGEST_S = 0.04, 0.8
_MOST_POINTS = 500
_LOWEST_HZ, _HIGHEST_HZ = 0.5, 400.0
_PER_OCTAVE = 6
_LEAST = 1e-12  # so that nothing has a logarithm as well


@dataclass(frozen=True)
class Zoom:
    """A stretch of a record: samples from `start` to before `stop`."""

    start: int
    stop: int


def zoom(errors: Errors) -> Zoom:
    """Where the believed model is furthest off, for a few turns of that error."""
    step = float(errors.times[1] - errors.times[0])
    error = errors.before - errors.before.mean()
    power = np.abs(np.fft.rfft(error)) ** 2
    power[0] = 0.0
    frequency = np.fft.rfftfreq(len(error), step)
    main = float(frequency[int(np.argmax(power))]) or 1.0
    count = round(float(np.clip(_TURNS / main, _SHORTEST_S, _LONGEST_S)) / step)
    count = min(max(count, 8), len(error))
    total = np.concatenate([[0.0], np.cumsum(errors.before**2)])
    energy = total[count:] - total[:-count]
    start = int(np.argmax(energy))
    return Zoom(start, start + count)


def record_picture(errors: Errors) -> Figure:
    """A stretch of the displacement beside its predictions, and the spectra of their errors."""
    figure = new_figure(170.0, 68.0)
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    part = zoom(errors)
    every = max(1, (part.stop - part.start) // _MOST_POINTS)
    shown = slice(part.start, part.stop, every)
    rms = float(np.std(errors.measured))
    factor, unit = (1e3, "mm") if np.abs(errors.measured).max() >= 1e-3 else (1e6, "μm")
    times = errors.times[shown]
    left.plot(times, factor * errors.measured[shown], color="black", linewidth=1.8, label="measured")
    for name in MODELS:
        error = getattr(errors, name)
        if diverged(errors, name):
            left.plot([], [], linewidth=1.2, label=f"{WORDS[name]}: diverges", **LINES[name])
            continue
        left.plot(
            times, factor * (errors.measured - rms * error)[shown], linewidth=1.2, label=WORDS[name], **LINES[name]
        )
    left.set_xlabel("time, s")
    left.set_ylabel(f"displacement, {unit}")
    left.margins(x=0)
    left.grid(color="0.88", linewidth=0.6)
    edges = bands(errors)
    centres = np.sqrt(edges[:-1] * edges[1:])
    right.loglog(centres, _LEAST + in_bands(errors, errors.measured / rms, edges), color="black", linewidth=1.8)
    for name in MODELS:
        right.loglog(centres, _LEAST + in_bands(errors, getattr(errors, name), edges), linewidth=1.2, **LINES[name])
    half = 0.5 / float(errors.times[1] - errors.times[0])
    noise = errors.noise * np.sqrt(np.diff(edges) / half)
    right.loglog(centres, noise, linewidth=1.2, label=WORDS["noise"], **LINES["noise"])
    right.set_xlabel("frequency, Hz")
    right.set_ylabel(f"rms per 1/{_PER_OCTAVE} octave")
    right.margins(x=0)
    right.grid(color="0.88", linewidth=0.6)
    right.set_ylim(bottom=max(0.2 * float(noise.min()), 1e-7))
    figure.legend(fontsize=7.5, loc="outside upper center", ncols=5, frameon=False)
    return figure


def diverged(errors: Errors, name: str) -> bool:
    """Whether a model gave no prediction, which counts as an error of the whole signal."""
    return bool(np.allclose(getattr(errors, name) * np.std(errors.measured), errors.measured, rtol=1e-9, atol=0.0))


def bands(errors: Errors) -> np.ndarray:
    """Edges of sixths of octaves that each hold at least one line of a record's spectrum, Hz."""
    duration = float(errors.times[-1] - errors.times[0])
    highest = min(_HIGHEST_HZ, 0.45 * len(errors.times) / duration)
    edges = [max(_LOWEST_HZ, 0.5 / duration)]
    while edges[-1] < highest:
        edges.append(max(edges[-1] * 2 ** (1 / _PER_OCTAVE), edges[-1] + 1.001 / duration))
    return np.array(edges)


def band_picture(rows: Sequence[BandGap]) -> Figure:
    """Errors on held-out records band by band."""
    figure = new_figure(170.0, 62.0)
    axes = figure.subplots()
    edges = [row.low_Hz for row in rows] + [rows[-1].high_Hz]
    for name, attribute in (*((m, m) for m in MODELS), ("noise", "noise_floor")):
        values = [getattr(row, attribute) for row in rows]
        axes.stairs(np.maximum(values, 1e-9), edges, baseline=None, linewidth=1.6, label=WORDS[name], **LINES[name])
    axes.set(xscale="log", yscale="log", xlabel="frequency, Hz", ylabel="error over the signal's rms")
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xticks(edges, [f"{edge:g}" for edge in edges])
    axes.minorticks_off()
    axes.grid(color="0.88", linewidth=0.6)
    figure.legend(fontsize=7.5, loc="outside upper center", ncols=4, frameon=False)
    return figure


def compliance_picture(loops: Mapping[str, LoopAtMass], limit_m_per_N: float) -> Figure:
    """Closed-loop compliance of several loops."""
    figure = new_figure(170.0, 92.0)
    plot_compliance(figure.subplots(), loops, limit_m_per_N)
    return figure
