"""What is proved here, as the other scripts of this folder call it: the one place that knows where proofs live."""

from math import inf

from beamdesign import certify
from beamdesign.loop import Loop
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Asked, Certificate
from beamdesign.proofs.performance import bandwidth, least_limit, prove
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.stability import StabilityMap, is_stable_over, stable_ranges

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
    return prove(_over(closed, low_kg, high_kg), Asked("peak_sensitivity", limit)).holds


def guaranteed_bandwidth(closed: Loop, limit_m_per_N: float, low_kg: float, high_kg: float) -> float:
    """The largest bandwidth (Hz) that is proved, rounded down; 0 where the range is not stable."""
    over = _over(closed, low_kg, high_kg)
    return bandwidth([over], limit_m_per_N) if over.stable else 0.0


def guaranteed_peak_sensitivity(closed: Loop, low_kg: float, high_kg: float) -> float:
    """The least peak sensitivity that is proved, rounded up; infinite where the range is not stable."""
    over = _over(closed, low_kg, high_kg)
    return least_limit([over], "peak_sensitivity") if over.stable else inf


def _over(closed: Loop, low_kg: float, high_kg: float) -> Rectangle:
    return Rectangle(closed, exact(low_kg), exact(high_kg))
