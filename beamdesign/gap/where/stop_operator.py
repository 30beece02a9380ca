"""The stop operator in compiled code: one loop over samples that cannot be vectorised."""

import numpy as np
from numba import njit


def _run(signal: np.ndarray, width: float) -> np.ndarray:
    """(N,) output that follows the changes of a signal and stays within plus and minus `width`."""
    out = np.empty_like(signal)
    held = 0.0
    before = signal[0]
    for k in range(len(signal)):
        held = min(max(held + signal[k] - before, -width), width)
        before = signal[k]
        out[k] = held
    return out


try:
    run = njit(cache=True)(_run)
except RuntimeError:  # no folder that could be written to; each process then compiles for itself
    run = njit(_run)
