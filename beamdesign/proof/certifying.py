"""Certificates made: stability and claims decided over a range of outer end masses, and the proof written."""

from collections.abc import Sequence
from math import isinf

from beamdesign.loop import Loop, loop
from beamdesign.polynomial import exact
from beamdesign.proof.certificate import Asked, Certificate, Guaranteed, describe, implies
from beamdesign.proof.document import document
from beamdesign.proof.performance import (
    Claim,
    bandwidth_where_stable,
    effort_where_stable,
    loop_gain_where_stable,
    peak_sensitivity_where_stable,
    prove_compliance,
    prove_controller_effort,
    prove_decay_rate,
    prove_gain_margin,
    prove_loop_gain,
    prove_peak_sensitivity,
)
from beamdesign.proof.rational import nearest
from beamdesign.proof.stability import StabilityMap, stable_ranges
from beamdesign.prototype import Goal, Prototype


def certify(prototype: Prototype, low_kg: float, high_kg: float, claims: Sequence[Asked] = ()) -> Certificate:
    """Decide stability and claims over every outer end mass from `low_kg` to `high_kg`, and write the proof.

    Where the range is stable, the guaranteed bandwidth (for the goal's compliance) and the guaranteed peak sensitivity
    are worked out and proved as well. A prototype with effects is certified as all of its linear members, see
    `beamdesign.proof.family_certificate`.

    Raises:
        ValueError: for an empty range, or without a controller.
        InputError: for effects for which no linear loop stands.
    """
    if prototype.effects:
        from beamdesign.proof.family_certificate import certify_family

        return certify_family(prototype, low_kg, high_kg, claims)
    closed = loop(prototype)
    stability = stable_ranges(closed.characteristic, exact(low_kg), exact(high_kg))
    decided = [decide(closed, asked, low_kg, high_kg) for asked in claims]
    guaranteed: Guaranteed | None = None
    proved: list[Claim] = []
    if stability.stable:
        guaranteed, proved = _guarantees(closed, prototype.goal, low_kg, high_kg)
    written = decided + [claim for claim in proved if not any(implies(other, claim) for other in decided)]
    text = document(prototype, closed, stability, written, _summary(prototype, stability, written))
    return Certificate((low_kg, high_kg), stability, tuple(decided), guaranteed, text)


def decide(closed: Loop, asked: Asked, low_kg: float, high_kg: float) -> Claim:
    """Prove or refute one claim over a range of outer end masses."""
    match asked.kind:
        case "compliance":
            return prove_compliance(closed, asked.limit, asked.bandwidth_Hz, low_kg, high_kg)
        case "peak_sensitivity":
            return prove_peak_sensitivity(closed, asked.limit, low_kg, high_kg)
        case "loop_gain":
            return prove_loop_gain(closed, asked.limit, asked.from_Hz, low_kg, high_kg)
        case "controller_effort":
            return prove_controller_effort(closed, asked.limit, low_kg, high_kg)
        case "decay_rate":
            return prove_decay_rate(closed, asked.limit, low_kg, high_kg)
        case "gain_margin":
            return prove_gain_margin(closed, asked.limit, low_kg, high_kg)


def _guarantees(closed: Loop, goal: Goal, low_kg: float, high_kg: float) -> tuple[Guaranteed, list[Claim]]:
    """The best figures of a range that is proved to be stable, and each as a claim that holds."""
    ends, masses = (low_kg, high_kg), (exact(low_kg), exact(high_kg))
    bandwidth = bandwidth_where_stable(closed, exact(goal.compliance_m_per_N), *masses)
    peak = peak_sensitivity_where_stable(closed, *masses)
    proved = [] if isinf(peak) else [Claim("peak_sensitivity", peak, ends, True)]
    if bandwidth > 0:
        proved.append(Claim("compliance", goal.compliance_m_per_N, ends, True, bandwidth))
    gain = effort = None
    if goal.loop_gain is not None:
        gain = loop_gain_where_stable(closed, goal.loop_gain_from_Hz, *masses)
        proved.append(Claim("loop_gain", gain, ends, True, from_Hz=goal.loop_gain_from_Hz))
    if goal.controller_effort_A_per_V is not None:
        effort = effort_where_stable(closed, *masses)
        proved.append(Claim("controller_effort", effort, ends, True))
    return Guaranteed(bandwidth, peak, gain, effort), proved


def _summary(prototype: Prototype, stability: StabilityMap, claims: Sequence[Claim]) -> str:
    """The result in words, for the top of the certificate."""
    low, high = nearest(stability.low), nearest(stability.high)
    lines = [f"Certificate of {prototype.name!r} for every outer end mass from {low:g} to {high:g} kg."]
    if stability.stable:
        lines.append("The closed loop is stable over the whole range.")
    else:
        lines.append(f"The closed loop is NOT stable over the whole range: {stability.reason}.")
        lines += [f"It is stable from {least:.9g} to {most:.9g} kg." for least, most in stability.stable_ranges]
    lines += [f"{'Proved' if claim.holds else 'Refuted'}: {describe(claim)}." for claim in claims]
    return "\n".join(lines)
