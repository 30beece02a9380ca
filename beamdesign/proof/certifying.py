"""Certificates made: stability and claims decided over a range of outer end masses, and the proof written."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from beamdesign.members import LinearFamily, family
from beamdesign.polynomial import exact
from beamdesign.proof.certificate import (
    INEQUALITIES,
    METHOD,
    Asked,
    Certificate,
    Claim,
    Guaranteed,
    as_claims,
    describe,
    implies,
    least_limits,
)
from beamdesign.proof.family_certificate import Proved, common_ranges, covered, rectangles, scope
from beamdesign.proof.mass_tables import KIND, claim_tables, common_table, loop_table, stability_table
from beamdesign.proof.performance import bandwidth, least_limit, prove
from beamdesign.proof.rational import nearest, text
from beamdesign.proof.stability import StabilityMap
from beamdesign.proof.writer import certificate
from beamdesign.prototype import Goal, InStage, Prototype


def certify(prototype: Prototype, low_kg: float, high_kg: float, claims: Sequence[Asked] = ()) -> Certificate:
    """Decide stability and claims over every outer end mass from `low_kg` to `high_kg`, and write the proof.

    Where the range is stable, the guaranteed bandwidth (for the goal's compliance) and the guaranteed peak sensitivity
    are worked out and proved as well. Everything is about all linear members of the prototype, of which there is one
    without effects: stability, decay and gain margin at every factor on the gain that the effects allow; the rest at
    those at which the effects are to let the loop perform.

    Raises:
        ValueError: for an empty range, or without a controller.
        InputError: for effects for which no linear loop stands.
    """
    low, high = exact(low_kg), exact(high_kg)
    if low > high:
        raise ValueError(f"empty range: {low_kg} is above {high_kg}")
    found = family(prototype, high_kg)
    proved = rectangles(prototype, found, low, high)
    stability = common_ranges([part.stable for part in proved], low, high)
    decided = [_decide(proved, asked) for asked in claims]
    guaranteed: Guaranteed | None = None
    reached: list[Claim] = []
    if stability.stable:
        guaranteed, reached = _guarantees(proved, prototype.goal, (low_kg, high_kg))
    written = decided + [claim for claim in reached if not any(implies(other, claim) for other in decided)]
    summary = _summary(prototype, found, stability, written)
    alone = len(proved) == 1 and proved[0].stable.least == proved[0].stable.most == 1
    body = {
        "outer_end_mass_kg": [text(low), text(high)],
        "stability": stability_table(stability) if alone else common_table(stability),
    }
    body |= claim_tables(written, alone) | {"loop": [loop_table(part.stable.loop) for part in proved]}
    written_text = certificate(KIND, prototype, body, summary, high_kg)
    method = f"{METHOD}; {scope(prototype, found)}" if prototype.effects else METHOD
    about = tuple(covered(prototype, found)) if prototype.effects else ()
    return Certificate((low_kg, high_kg), stability, tuple(decided), guaranteed, written_text, method, about)


def guaranteed_by_all(stages: Iterable[InStage]) -> Guaranteed | None:
    """The worst of what is proved with each law over its own payloads; None where a loop is not stable."""
    each = [certify(stage.prototype, *stage.outer_end_mass_kg).guaranteed for stage in stages]
    found = [one for one in each if one is not None]
    if len(found) < len(each):
        return None
    return Guaranteed(
        min(one.bandwidth_Hz for one in found),
        max(one.peak_sensitivity for one in found),
        max((one.loop_gain for one in found if one.loop_gain is not None), default=None),
        max(
            (one.controller_effort_A_per_V for one in found if one.controller_effort_A_per_V is not None), default=None
        ),
    )


def _decide(proved: Sequence[Proved], asked: Asked) -> Claim:
    """A claim about every member: the first that refutes it, or that it holds."""
    performance = asked.kind in INEQUALITIES
    alone = len(proved) == 1 and proved[0].stable.least == proved[0].stable.most  # so that the proof says where
    for part in proved:
        if performance and not alone and not part.stable.stable:
            masses = nearest(part.stable.low), nearest(part.stable.high)
            reason = "not every member is stable for all of these masses and factors on the gain"
            return asked.decided(masses, False, reason)
    claim: Claim | None = None
    for part in proved:
        rectangle = part.performing if performance else part.stable
        if rectangle is None:
            continue
        claim = prove(rectangle, asked)
        if not claim.holds:
            where = f" (with {part.member.name})" if part.member.name else ""
            return replace(claim, reason=claim.reason + where)
    assert claim is not None  # some member performs
    return claim


def _guarantees(proved: Sequence[Proved], goal: Goal, ends: tuple[float, float]) -> tuple[Guaranteed, list[Claim]]:
    """The best figures that every member has, and each as a claim that holds."""
    performing = [part.performing for part in proved if part.performing is not None]
    reached = Asked("compliance", goal.compliance_m_per_N, bandwidth(performing, goal.compliance_m_per_N))
    peak, *others = least_limits(goal, lambda kind, from_Hz: least_limit(performing, kind, from_Hz))
    figures = {one.kind: one.limit for one in (peak, *others)}
    guaranteed = Guaranteed(
        reached.bandwidth_Hz, peak.limit, figures.get("loop_gain"), figures.get("controller_effort")
    )
    return guaranteed, as_claims((peak, reached, *others), ends)


def _summary(prototype: Prototype, found: LinearFamily, stability: StabilityMap, claims: Sequence[Claim]) -> str:
    """The result in words, for the top of the certificate."""
    low, high = nearest(stability.low), nearest(stability.high)
    effects = " with effects" if prototype.effects else ""
    lines = [f"Certificate of {prototype.name!r}{effects} for every outer end mass from {low:g} to {high:g} kg."]
    if prototype.effects:
        lines += [f"{scope(prototype, found).capitalize()}.", *covered(prototype, found)]
    every, all_of_it = ("Every member", "") if len(found.members) > 1 else ("It", "The closed loop is ")
    if stability.stable:
        lines.append(f"{all_of_it or 'Every member is '}stable over the whole range.")
    else:
        lines.append(f"{all_of_it}NOT stable over the whole range: {stability.reason}.")
        lines += [f"{every} is stable from {least:.9g} to {most:.9g} kg." for least, most in stability.stable_ranges]
    lines += [f"{'Proved' if claim.holds else 'Refuted'}: {describe(claim)}." for claim in claims]
    return "\n".join(lines)
