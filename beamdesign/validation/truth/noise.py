"""What recording adds to the motion of the true rig."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from beamdesign.validation.truth.rig import SAMPLE_S


@dataclass(frozen=True)
class Noise:
    """What recording adds, one standard deviation each.

    Attributes:
        displacement_m: of the sensor, inside the loop.
        quantum_m: step of the recorder.
        force_N: of the force sensor.
        current_A: of the current's.
        drift_m: of the sensor's zero over a record, inside the loop.
        coloured: share of the sensor's power that has passed a first-order low-pass.
        break_Hz: of that.
        outliers: mean number of samples in a record that the recorder spoils, each of one channel.
        pressure_Pa: of the recorder, where the load pressure is recorded.
    """

    displacement_m: float
    quantum_m: float
    force_N: float
    current_A: float
    drift_m: float
    coloured: float = 0.0
    break_Hz: float = 100.0
    outliers: float = 0.0
    pressure_Pa: float = 2e3

    def of_sensor(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """(count,) at every sample, m."""
        white = rng.normal(0, self.displacement_m, count)
        if not self.coloured:
            return white
        memory = float(np.exp(-2 * np.pi * self.break_Hz * SAMPLE_S))
        drawn = rng.normal(0, self.displacement_m, count)
        drawn[1:] *= np.sqrt(1 - memory**2)  # the first is as large as all that follow
        slow = lfilter([1.0], [1.0, -memory], drawn)
        return np.asarray(np.sqrt(1 - self.coloured) * white + np.sqrt(self.coloured) * slow)

    @property
    def floor_m(self) -> float:
        """RMS of what no model can predict of the displacement."""
        return float(np.sqrt(self.displacement_m**2 + self.quantum_m**2 / 12))
