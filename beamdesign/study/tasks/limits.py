"""Task `limits`: what actuator and sensor can do at one mass on the outer tip."""

import numpy as np

from beamdesign.operating_limits import envelope, sensor_reach
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import AtMassOptions

_SHOWN_HZ = np.array([1.0, 10.0, 100.0])


def compute(prototype: Prototype, options: AtMassOptions) -> Answer:
    """Largest force on the tip at 1, 10 and 100 Hz, what governs it, and the static error."""
    found = envelope(prototype, options.outer_end_mass_kg, frequency_Hz=_SHOWN_HZ)
    outputs: dict[str, object] = {}
    for k, frequency in enumerate(_SHOWN_HZ if not found.reason else ()):
        outputs[f"load_at_{frequency:g}_Hz_N"] = float(found.load_N[k])
        outputs[f"governing_at_{frequency:g}_Hz"] = found.governing[k]
        outputs[f"displacement_at_{frequency:g}_Hz_m"] = float(found.displacement_m[k])
    if not found.reason:
        outputs["static_error_m_per_N"] = sensor_reach(prototype, options.outer_end_mass_kg).static_error_m_per_N
    return Answer(outputs, {"missing": found.missing}, found.reason)
