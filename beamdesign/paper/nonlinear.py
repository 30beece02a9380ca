"""The measured cases of the paper on the nonlinear rig: orifices, unequal piston sides and the sensor's filter.

The paper's measured points are lost. Where it measured, from 0 to 10 Hz under 50 to 500 N peak to peak, the response of
the nonlinear rig stands in for them.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from beamdesign.harmonic_balance import forced_motion
from beamdesign.linear_reach import with_published_effects
from beamdesign.loop import critical_gain
from beamdesign.paper.rig import (
    INNER_END_MASS_KG,
    OUTER_END_MASS_KG,
    filtered,
    filtered_smaller_side,
    lag,
)
from beamdesign.prototype import Prototype

FORCES_PEAK_TO_PEAK_N = (50.0, 500.0)
TESTED_HZ = (0.5, 1.0, 2.0, 4.0, 7.0, 10.0)


@dataclass(frozen=True)
class MeasuredCase:
    """A case of Figures 15 and 16.

    Attributes:
        rig: with the 400 Hz filter, at the measured largest gain; the gain of the tests is not printed.
        outer_end_mass_kg: payload.
        measured_mA_per_V: the gain at which it began to oscillate.
    """

    rig: Prototype
    outer_end_mass_kg: float
    measured_mA_per_V: float

    def predicted_mA_per_V(self) -> float:
        """Critical gain with the filter and the smaller side of the piston."""
        return 1e3 * critical_gain(filtered_smaller_side(self.rig), self.outer_end_mass_kg).gain_A_per_V


MEASURED = {
    15: MeasuredCase(filtered(lag(200.0)), 0.0, 200.0),
    16: MeasuredCase(filtered(lag(150.0, INNER_END_MASS_KG)), OUTER_END_MASS_KG, 150.0),
}


@cache
def nonlinear_compliance(figure: int, force_peak_to_peak: float) -> np.ndarray:
    """|x / F_d| in m/N at `TESTED_HZ` on the nonlinear rig, first harmonic, under a force of so many N peak to peak."""
    case = MEASURED[figure]
    rig, force = with_published_effects(case.rig), force_peak_to_peak / 2
    found = [forced_motion(rig, force, f, case.outer_end_mass_kg, harmonics=3).amplitude_m for f in TESTED_HZ]
    return np.array(found) / force
