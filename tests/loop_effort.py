"""What a loop asks of its valve, which tests compare with what samples and proofs say of it."""

from math import pi

import numpy as np

from beamdesign.loop import LoopAtMass
from beamdesign.polynomial import at_points


def effort_response(loop: LoopAtMass, frequency_Hz: np.ndarray) -> np.ndarray:
    """C S, current over volts at the controller's input, A/V at the given frequencies, complex."""
    assert loop.effort_numerator is not None
    s = 2j * pi * frequency_Hz
    return np.asarray(at_points(loop.effort_numerator, s) / at_points(loop.characteristic, s))
