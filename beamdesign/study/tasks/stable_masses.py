"""Task `stable_masses`: which masses on the outer tip are stable, exactly, with the frequencies at the crossings."""

from beamdesign.proof.certifying import certify
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import RangeOptions


def compute(prototype: Prototype, options: RangeOptions) -> Answer:
    """Exact stable ranges of outer end mass of one prototype; none at all is a no."""
    found = certify(prototype, options.from_kg, options.to_kg)
    ranges = found.stable_ranges_kg
    outputs = {
        "stable_from_kg": [low for low, _ in ranges],
        "stable_to_kg": [high for _, high in ranges],
        "crossings_kg": [crossing.value for crossing in found.crossings],
        "crossing_frequencies_Hz": [crossing.frequency_Hz for crossing in found.crossings],
    }
    return Answer(outputs, {"method": found.method}, "" if ranges else found.stability.reason)
