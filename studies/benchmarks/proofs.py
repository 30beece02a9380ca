"""What is proved here, as the other scripts of this folder call it: the one place that knows where proofs live."""

from beamdesign.loop import Loop
from beamdesign.polynomial import exact
from beamdesign.proof.certificate import Certificate
from beamdesign.proof.certifying import certify
from beamdesign.proof.performance import guaranteed_bandwidth, guaranteed_peak_sensitivity, prove_peak_sensitivity
from beamdesign.proof.stability import StabilityMap, is_stable_over, stable_ranges

__all__ = [
    "Certificate",
    "always_stable",
    "certify",
    "guaranteed_bandwidth",
    "guaranteed_peak_sensitivity",
    "keeps_peak_sensitivity",
    "stability_map",
]


def stability_map(closed: Loop, low_kg: float, high_kg: float) -> StabilityMap:
    """Stable ranges and crossings over the outer end mass, exact."""
    return stable_ranges(closed.characteristic, exact(low_kg), exact(high_kg))


def always_stable(closed: Loop, low_kg: float, high_kg: float) -> bool:
    """Whether every outer end mass of the range is stable, exact: the check inside the tuner."""
    return is_stable_over(closed.characteristic, exact(low_kg), exact(high_kg))


def keeps_peak_sensitivity(closed: Loop, limit: float, low_kg: float, high_kg: float) -> bool:
    """Whether the range is stable and its peak sensitivity at most the limit, proved."""
    return prove_peak_sensitivity(closed, limit, low_kg, high_kg).holds
