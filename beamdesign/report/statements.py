"""What a report says: claims with how well each is founded (proved, verified numerically, sampled), and prices."""

from collections.abc import Iterator
from math import isfinite
from typing import Literal, NamedTuple

from beamdesign.proofs.certificate import Asked, Certificate, Claim, implies
from beamdesign.quantities import at_least, decimal, mass_range_text, quantity, rigs_in_words
from beamdesign.synthesis.design_run import DesignRun

Foundation = Literal["proved", "refuted", "verified numerically", "sampled"]


class Statement(NamedTuple):
    """One claim in words, how well it is founded, and by what."""

    claim: str
    foundation: Foundation
    how: str


def proved_statements(certificate: Certificate, compliance_m_per_N: float) -> list[Statement]:
    """Stability, the guaranteed figures and the further claims of a certificate.

    Args:
        certificate: of a range of outer end masses.
        compliance_m_per_N: the limit that its guaranteed bandwidth refers to.
    """
    masses = certificate.outer_end_mass_kg
    stability = Statement(
        f"stable for every outer end mass of {mass_range_text(masses)}",
        "proved" if certificate.stable else "refuted",
        "roots of one polynomial isolated in rational arithmetic, one exact Routh test per range",
    )
    claims = list(certificate.claims)
    if best := certificate.guaranteed:
        reached = [
            Asked("compliance", compliance_m_per_N, best.bandwidth_Hz).decided(masses, best.bandwidth_Hz > 0),
            Asked("peak_sensitivity", best.peak_sensitivity).decided(masses, True),
            Asked("peak_compliance", best.peak_compliance_m_per_N).decided(masses, True),
        ]
        finite = [claim for claim in reached if isfinite(claim.limit)]
        claims += [claim for claim in finite if not any(implies(asked, claim) for asked in certificate.claims)]
    return [stability, *(_of_claim(claim) for claim in claims)]


def _of_claim(claim: Claim) -> Statement:
    masses = mass_range_text(claim.outer_end_mass_kg)
    match claim.kind:
        case "compliance":
            words = (
                f"|x/F_d| at most {quantity(claim.limit, 'm/N')} at every frequency up to"
                f" {at_least(claim.bandwidth_Hz, 'Hz', 7)}"
            )
        case "peak_compliance":
            words = f"|x/F_d| at most {quantity(claim.limit, 'm/N')} at every frequency"
        case "peak_sensitivity":
            words = f"|1/(1+L)| at most {decimal(claim.limit, 6)} at every frequency"
        case "loop_gain":
            words = f"|L| at most {decimal(claim.limit, 6)} from {decimal(claim.from_Hz, 6)} Hz up"
        case "controller_effort":
            words = f"|C/(1+L)| at most {quantity(claim.limit, 'A/V')} at every frequency"
        case "decay_rate":
            words = f"every motion dies out at least as fast as exp(-{decimal(claim.limit, 6)} t / s)"
        case "slope":
            where = "without command and load" if claim.for_odd_only else "under any constant command and load"
            words = f"comes to rest from every state while the current saturates, {where}"
        case "gain_margin" if claim.limit == 0:
            words = "stable at every lower gain too"
        case "gain_margin":
            words = f"stable with the gain times every factor from 1 to {decimal(claim.limit, 6)}"
    how = "polynomial inequality in mass and frequency decided by exact root isolation"
    if not claim.holds:
        how = claim.reason
    return Statement(f"{words}, for every outer end mass of {masses}", "proved" if claim.holds else "refuted", how)


_BOX = "zero exclusion by branch and bound, each piece in ball arithmetic"


def statements(run: DesignRun) -> Iterator[Statement]:
    """Everything the report of a run claims, the best founded first."""
    best = run.tuning and run.tuning.best
    if run.tuning and best and best.over_box:
        rigs = f"and {rigs_in_words(best.sigmas)}"
        for asked in best.over_box.claims:
            claim = _of_claim(asked.decided(run.tuning.outer_end_mass_kg, True)).claim
            yield Statement(f"{claim} {rigs}", "proved", _BOX)
    if run.certificate:
        for one in proved_statements(run.certificate, run.problem.goal.compliance_m_per_N):
            yield one._replace(claim=f"{one.claim}, of {rigs_in_words(0.0)}")
    sizing = run.sizing
    yield Statement(
        f"the chosen sections pass all {len(sizing.checks)} structural checks",
        "verified numerically" if sizing.feasible else "refuted",
        "closed formulas in floating point",
    )
    if run.holding:
        unasked = f"; not asked for want of figures: {', '.join(run.holding.missing)}" if run.holding.missing else ""
        yield Statement(
            f"the actuator holds {run.holding.held}, the link level",
            "refuted" if run.holding.missed else "verified numerically",
            f"closed formulas, the root law of orifices, and the linear loop on a grid of frequencies{unasked}",
        )
    if sizing.stock:
        yield Statement(
            "no lighter pair of the stock list passes",
            "verified numerically",
            f"all {sizing.stock.pairs} pairs were checked",
        )
    if sizing.free:
        free = sizing.free
        yield Statement(
            "the free optimum fulfils the first-order conditions",
            "verified numerically",
            f"residual {free.kkt_residual:.1e}, from the gradients and not from the solver",
        )
        yield Statement(
            "no lighter pair of free sizes exists",
            "sampled",
            f"{free.starts_agreeing} of {free.starts} local searches ended at the same mass",
        )
    yield Statement(
        "critical gains, margins and bandwidths at single masses",
        "verified numerically",
        "roots of polynomials with error bounds at those masses, nothing swept in frequency",
    )
    if run.tuning and run.tuning.best:
        yield Statement(
            "no other controller of this kind guarantees more",
            "sampled",
            f"best of {len(run.tuning.starts)} local searches from a coarse one; that it is the best is not proved",
        )
    yield Statement("the curves between the points drawn", "sampled", "grids of frequencies and masses")


_REQUIREMENTS = {
    "tip_force": "tip force",
    "safety_strength": "safety factor on strength",
    "safety_local_buckling": "safety factor on local buckling",
    "clearance_assembly": "clearance at assembly",
    "clearance_under_load": "clearance under load",
    "least_wall": "least wall",
    "largest_width": "largest width",
    "width_to_wall_at_most": "largest width to wall",
}
_STEPS = {"percent": ("1 % more", 1.0), "mm": ("0.1 mm more", 0.1)}
"""Small enough that a slope is a fair account of the change: in words, and in the price's unit."""

NEGLIGIBLE_KG = 1e-6
"""Prices below this are called none."""


def price_words(prices: dict[str, float]) -> list[str]:
    """One sentence per requirement that has a price, the dearest first, and one that names those that have none.

    Args:
        prices: kg per unit, by names such as "tip_force_kg_per_percent".
    """
    dear = sorted((name for name in prices if abs(prices[name]) > NEGLIGIBLE_KG), key=lambda name: -abs(prices[name]))
    said = []
    for name in dear:
        requirement, unit = _split(name)
        step, share = _STEPS.get(unit, (f"one {unit} more", 1.0))
        effect = f"{'costs' if prices[name] > 0 else 'saves'} {decimal(abs(prices[name]) * share, 3)} kg"
        said.append(f"{step[:1].upper()}{step[1:]} {requirement} {effect} of beam mass.")
    free = [_split(name)[0] for name in prices if name not in dear]
    if free:
        said.append(f"A little more or less of these changes nothing: {', '.join(free)}.")
    return said


def _split(name: str) -> tuple[str, str]:
    requirement, _, unit = name.partition("_kg_per_")
    return _REQUIREMENTS.get(requirement, requirement.replace("_", " ")), unit
