"""Task `robust`: guaranteed bandwidth and the longest stable range of payloads, for studies of tolerances."""

from beamdesign.proof.certifying import certify
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import RangeOptions
from beamdesign.study.tasks.certify import payload_range


def compute(prototype: Prototype, options: RangeOptions) -> Answer:
    """Prove one rig over its payload range, and find its longest stable range between the masses of the options.

    Everything is exact for this one set of figures. A loop that is not stable over its payload has no bandwidth: 0.
    """
    found = certify(prototype, *payload_range(prototype))
    around = certify(prototype, options.from_kg, options.to_kg)
    low, high = max(around.stable_ranges_kg, key=lambda ends: ends[1] - ends[0], default=(0.0, 0.0))
    outputs = {
        "stable": found.stable,
        "bandwidth_Hz": found.guaranteed.bandwidth_Hz if found.guaranteed else 0.0,
        "peak_sensitivity": found.guaranteed.peak_sensitivity if found.guaranteed else None,
        "stable_from_kg": low,
        "stable_to_kg": high,
        "stable_width_kg": high - low,
    }
    return Answer(outputs, {"method": found.method}, found.reason)
