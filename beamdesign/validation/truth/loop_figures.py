"""What is measured of a true loop beside records: its compliance, sine by sine, and the gain at which it oscillates.

Both are found as on a rig: a force is swept, and the gain is turned up until a push no longer dies away.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import detrend

from beamdesign.files import write_whole
from beamdesign.validation.truth.case import Case, Run, run_figures, step_of
from beamdesign.validation.truth.effects import Shape, rounded
from beamdesign.validation.truth.nominal import assembled
from beamdesign.validation.truth.rig import SAMPLE_S, Motion, march

LINES_HZ = np.round(np.geomspace(2.0, 250.0, 30), 2)
AMPLITUDE_SHARE = 0.5
"""Of the RMS of a record's force: amplitude of the sines."""
RESPONSE_STD, GAIN_STD, FREQUENCY_STD = 0.01, 0.03, 0.01
"""Relative errors of each line (and, in radians, of its phase), of a critical gain and of its frequency."""
_LISTEN_S, _PERIODS, _REPEATS, _PATIENCE_S = 0.5, 4, 0.3 * RESPONSE_STD, 8.0
_WATCHED_S, _PUSH_S, _PUSH_SHARE = 1.5, 5e-3, 0.1
_FADES, _FLOORS = 0.97, 2.0
_LEAST, _MOST, _STEP, _NEAR = 0.2, 100.0, 1.5, 1.01
_HIGHEST_A_PER_V = 5e3  # nobody turns an amplifier up further


def loop_figures(case: Case, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Measure frequency responses and critical gains of a case, and write the files of the responses.

    Args:
        case: whose rig.
        folder: for the files.

    Returns:
        tables of dataset.toml.

    Raises:
        OSError: where a file cannot be written.
    """
    swept, raised = measured(case)
    responses, gains = [], []
    for run, columns in swept:
        if len(columns):
            file = f"response_{run.name}.csv"
            rows = (f"{hertz:.2f},{size:.5e},{degrees:.3f}" for hertz, size, degrees in columns.tolist())
            write_whole(folder / file, "\n".join(("frequency_Hz,magnitude_m_per_N,phase_deg", *rows)) + "\n")
            responses.append({"file": file, "amplitude_N": amplitude_of(run)} | run.setting)
    for run, (gain, hertz) in raised:
        law = {key: value for key, value in run.controller.items() if key != "gain_A_per_V"}
        at = {"gain_A_per_V": rounded(gain), "relative_std": GAIN_STD, "frequency_Hz": rounded(hertz)}
        gains.append(run.setting | {"controller": law} | at)
    return {"frequency_response": responses, "critical_gain": gains}


def gap_over_errors(case: Case) -> float:
    """How far the effects of a case stand out of its figures, as its gap over the floor says of records.

    Returns:
        RMS of the logarithms of every magnitude, gain and frequency over the same without the effects, each over its
        stated error; what was measured in one of the two alone does not count.
    """
    (swept, raised), (swept_without, raised_without) = measured(case), measured(case.only())
    off: list[float] = []
    for (_, here), (_, there) in zip(swept, swept_without, strict=True):
        _, k, m = np.intersect1d(here[:, 0], there[:, 0], return_indices=True)
        off += list(np.log(here[k, 1] / there[m, 1]) / RESPONSE_STD)
    known = {run.name: figures for run, figures in raised_without}
    for run, figures in raised:
        if run.name in known:
            off += list(np.log(np.divide(figures, known[run.name])) / (GAIN_STD, FREQUENCY_STD))
    return float(np.sqrt(np.mean(np.square(off)))) if off else 0.0


Swept = list[tuple[Run, np.ndarray]]
Raised = list[tuple[Run, tuple[float, float]]]


def measured(case: Case) -> tuple[Swept, Raised]:
    """Responses, see `compliance`, and critical gains, see `critical_gain`, with their errors.

    Returns:
        a response of every loop of the records that a force of many lines drives, the largest such force; and gain and
        frequency of every loop that comes to oscillate.
    """
    rng = np.random.default_rng([case.seed, 4])
    runs = sorted(case.runs, key=lambda run: run.drive.size)
    forces = [run for run in runs if run.drive.channel == "disturbance_N" and run.drive.shape == "lines"]
    forced, loops = ({str(run.setting): run for run in of} for of in (forces, runs))
    swept = [(run, compliance(case, run, amplitude_of(run), rng)) for run in forced.values()]
    raised = []
    for run in loops.values():
        errors = np.exp(rng.normal(0, (GAIN_STD, FREQUENCY_STD)))
        if (found := critical_gain(case, run)) is not None:
            raised.append((run, (found[0] * errors[0], found[1] * errors[1])))
    return swept, raised


def amplitude_of(run: Run) -> float:
    """Of the sines of a response of the loop of a record, N."""
    return rounded(AMPLITUDE_SHARE * run.drive.size)


def compliance(case: Case, run: Run, amplitude_N: float, rng: np.random.Generator) -> np.ndarray:
    """Displacement that the controller sees over a force of one sine at a time, each begun at rest.

    Args:
        case: whose rig.
        run: its loop.
        amplitude_N: of the force.
        rng: of the noise of the sensor and of the analyser.

    Returns:
        (n, 3) frequency in Hz, magnitude in m/N and phase in degrees, of those of `LINES_HZ` that stay in bounds.
    """
    figures, rows = run_figures(case, run), []
    for hertz in LINES_HZ:
        settled = _settled(figures, amplitude_N, hertz)
        errors = np.exp(complex(*rng.normal(0, RESPONSE_STD, 2)))
        if settled is not None:
            times, wave = settled
            seen = wave + rng.normal(0, case.noise.floor_m, len(wave))
            response = _turning(times, seen, hertz) / amplitude_N * errors
            rows.append((hertz, abs(response), np.degrees(np.angle(response))))
    return np.reshape(rows, (-1, 3))


def _settled(figures: Shape, amplitude_N: float, hertz: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and displacement, (n,), of the end of a sine's answer, waited for twice as long until it repeats itself.

    Whoever measures does not wait for ever: what a joint hammers repeats at no time, and is taken as it is then.
    """
    listen = wait = max(_LISTEN_S, _PERIODS / hertz)
    while True:
        motion = _pushed(figures, 2 * wait + listen, lambda t: amplitude_N * np.sin(2 * np.pi * hertz * t))
        if not motion.bounded:
            return None
        parts = [(motion.times >= begin) & (motion.times < begin + listen) for begin in (wait, 2 * wait)]
        early, late = (_turning(motion.times[part], motion.displacement[part], hertz) for part in parts)
        if abs(late - early) <= _REPEATS * abs(late) or 2 * wait >= _PATIENCE_S:
            return motion.times[parts[1]], motion.displacement[parts[1]]
        wait *= 2


def _turning(times: np.ndarray, wave: np.ndarray, hertz: float) -> complex:
    """Amplitude of the sine of a frequency in a wave, and its phase to one that began at time 0."""
    turns = 2 * np.pi * hertz * times
    basis = np.column_stack([np.cos(turns), np.sin(turns), np.ones(len(turns))])
    cosine, sine, _ = np.linalg.lstsq(basis, wave, rcond=None)[0]
    return complex(sine, cosine)


def critical_gain(case: Case, run: Run) -> tuple[float, float] | None:
    """The least gain at which a push is not seen to die away, to 1 %, in A/V, and the frequency then, Hz.

    Returns:
        None where the loop oscillates at a fifth of its gain already, or at no gain up to a hundred times its own, or
        to 5000 A/V.
    """
    own = float(run.controller["gain_A_per_V"])
    low = high = _LEAST * own
    if (after := _sustained(case, run, low)) is not None:
        return None
    while after is None:
        low, high = high, _STEP * high
        if high > min(_MOST * own, _HIGHEST_A_PER_V):
            return None
        after = _sustained(case, run, high)
    while high > _NEAR * low:
        middle = float(np.sqrt(low * high))
        found = _sustained(case, run, middle)
        low, high, after = (middle, high, after) if found is None else (low, middle, found)
    signs = np.sign(after)
    turned = np.nonzero(signs[1:] != signs[:-1])[0]
    if len(turned) < 3:
        return None  # it has run away, or creeps: no oscillation
    return float(np.sqrt(low * high)), float((len(turned) - 1) / (2 * SAMPLE_S * (turned[-1] - turned[0])))


def _sustained(case: Case, run: Run, gain_A_per_V: float) -> np.ndarray | None:
    """The last third of what a push leaves, about a straight line, where it is no less than in the one before."""
    figures = run_figures(case, run) | {"gain": gain_A_per_V}
    motion = _pushed(figures, _WATCHED_S, lambda t: _PUSH_SHARE * case.scales.force * (t < _PUSH_S))
    third = len(motion.times) // 3
    if not motion.bounded:
        return motion.displacement[np.nonzero(motion.displacement)[0]][-third:]
    middle, last = (detrend(part) for part in (motion.displacement[third : 2 * third], motion.displacement[-third:]))
    return last if np.std(last) > max(_FADES * np.std(middle), _FLOORS * case.noise.floor_m) else None


def _pushed(figures: Shape, duration_s: float, force: Callable[[np.ndarray], np.ndarray]) -> Motion:
    """The rig under a force alone, given over the times of all half steps, s."""
    step = step_of(figures)
    inputs = np.zeros((2 * round(duration_s / step) + 1, 3))
    inputs[:, 0] = force(np.arange(len(inputs)) * (step / 2))
    return march(*assembled(figures), inputs, None, step)
