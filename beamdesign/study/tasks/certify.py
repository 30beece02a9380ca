"""Task `certify`: what is proved over the payload range."""

from beamdesign.proof.certificate import Asked, Certificate, describe
from beamdesign.proof.certifying import certify as prove
from beamdesign.prototype import Prototype
from beamdesign.study.answer import Answer
from beamdesign.study.tasks import CertifyOptions


def payload_range(prototype: Prototype) -> tuple[float, float]:
    """The range of outer end mass of a prototype, kg."""
    masses = prototype.payload.outer_end_mass_kg
    assert masses is not None  # what a task needs is there before it computes
    return masses


def compute(prototype: Prototype, options: CertifyOptions) -> Answer:
    """Certify one prototype over its own payload range."""
    masses = payload_range(prototype)
    asked = []
    if options.bandwidth_Hz is not None:
        asked.append(Asked("compliance", prototype.goal.compliance_m_per_N, options.bandwidth_Hz))
    if options.peak_sensitivity is not None:
        asked.append(Asked("peak_sensitivity", options.peak_sensitivity))
    found = prove(prototype, *masses, asked)
    below, above = found.stability.below, found.stability.above
    outputs = {
        "stable": found.stable,
        "bandwidth_Hz": found.guaranteed.bandwidth_Hz if found.guaranteed else None,
        "peak_sensitivity": found.guaranteed.peak_sensitivity if found.guaranteed else None,
        "stable_ranges_kg": [f"{low:.7g} to {high:.7g}" for low, high in found.stable_ranges_kg],
        "stable_share": _share(found),
        "unstable_below_kg": below.value if below is not None and below.value >= 0 else None,
        "unstable_above_kg": above.value if above is not None else None,
        "crossings_kg": [crossing.value for crossing in found.crossings],
        "crossing_frequencies_Hz": [crossing.frequency_Hz for crossing in found.crossings],
    }
    claims = [
        {
            "claim": describe(claim),
            "holds": claim.holds,
            "reason": claim.reason,
            "mass_kg": claim.witness_outer_end_mass_kg,
        }
        for claim in found.claims
    ]
    details = {"method": found.method, "scope": list(found.scope), "claims": claims}
    return Answer(outputs, details, found.reason)


def _share(found: Certificate) -> float:
    """Share of the payload range that is stable; of a single mass, 1 or 0."""
    low, high = found.outer_end_mass_kg
    if low == high:
        return float(found.stable)
    return sum(most - least for least, most in found.stable_ranges_kg) / (high - low)
