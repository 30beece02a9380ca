"""The stop operator in compiled code: one loop over samples that cannot be vectorised."""

import numpy as np
from numba import njit


@njit(cache=True)
def run(signal: np.ndarray, width: float) -> np.ndarray:
    """(N,) output that follows the changes of a signal and stays within plus and minus `width`."""
    out = np.empty_like(signal)
    held = 0.0
    before = signal[0]
    for k in range(len(signal)):
        held = min(max(held + signal[k] - before, -width), width)
        before = signal[k]
        out[k] = held
    return out
