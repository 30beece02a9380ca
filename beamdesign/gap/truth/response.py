"""Compliance of the true rig line by line, as a frequency analyser would measure it."""

import numpy as np

from beamdesign.gap.truth.believed import assembled
from beamdesign.gap.truth.case import Case, Run, run_figures, step_of
from beamdesign.gap.truth.rig import SAMPLE_S, march

LINES = 40
SETTLE_S = 2.0
LISTEN_S = 4.0


def compliance(case: Case, run: Run) -> tuple[float, dict[str, np.ndarray]]:
    """Displacement over force at lines from 1 to 300 Hz, all at once with random phases and equal heights.

    The first `SETTLE_S` are thrown away; the lines lie on the grid of the `LISTEN_S` that follow.

    Returns:
        height of one line (N), and the columns of the file.
    """
    figures = run_figures(case, run)
    step = step_of(figures)
    rng = np.random.default_rng([case.seed, run.drive.seed, 4])
    frequencies = np.unique(np.round(np.geomspace(1.0, 300.0, LINES) * 4)) / 4
    height = float(f"{run.drive.size / np.sqrt(len(frequencies) / 2):.3g}")
    times = np.arange(2 * round((SETTLE_S + LISTEN_S) / step) + 1) * (step / 2)
    inputs = np.zeros((len(times), 3))
    phases = rng.uniform(0, 2 * np.pi, len(frequencies))
    for frequency, phase in zip(frequencies, phases, strict=True):
        inputs[:, 0] += height * np.cos(2 * np.pi * frequency * times + phase)
    record, modes = assembled(figures)
    motion = march(record, modes, inputs, None, step)
    count = round(LISTEN_S / SAMPLE_S)
    first = round(SETTLE_S / SAMPLE_S)
    taken = motion.displacement[first : first + count] + rng.normal(0, case.noise.floor_m, count)
    force = inputs[:: round(2 * SAMPLE_S / step), 0][first : first + count]
    lines = np.round(frequencies * LISTEN_S).astype(int)
    ratio = np.fft.rfft(taken)[lines] / np.fft.rfft(force)[lines]
    return height, {
        "frequency_Hz": frequencies,
        "magnitude_m_per_N": np.abs(ratio),
        "phase_deg": np.degrees(np.angle(ratio)),
    }
