"""What a design run claims, and how well each claim is founded: proved, verified numerically, or sampled."""

from math import isfinite
from typing import Literal, NamedTuple

from beamdesign.proof.certificate import Certificate, Claim
from beamdesign.report.quantity import at_least, decimal, mass_range_text, quantity
from beamdesign.study.design_run import DesignRun

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
            Claim("compliance", compliance_m_per_N, masses, best.bandwidth_Hz > 0, best.bandwidth_Hz),
            Claim("peak_sensitivity", best.peak_sensitivity, masses, isfinite(best.peak_sensitivity)),
        ]
        claims += [claim for claim in reached if not any(_implies(asked, claim) for asked in certificate.claims)]
    return [stability, *(_of_claim(claim) for claim in claims)]


def _implies(asked: Claim, other: Claim) -> bool:
    """Whether a claim that was asked and holds says as much as another one, over the same masses."""
    if not asked.holds or asked.kind != other.kind or asked.limit > other.limit:
        return False
    return other.bandwidth_Hz is None or (asked.bandwidth_Hz or 0.0) >= other.bandwidth_Hz


def _of_claim(claim: Claim) -> Statement:
    masses = mass_range_text(claim.outer_end_mass_kg)
    match claim.kind:
        case "compliance":
            words = (
                f"|x/F_d| at most {quantity(claim.limit, 'm/N')} at every frequency up to"
                f" {at_least(claim.bandwidth_Hz or 0.0, 'Hz', 7)}"
            )
        case "peak_sensitivity":
            words = f"|1/(1+L)| at most {decimal(claim.limit, 6)} at every frequency"
        case "loop_gain":
            words = f"|L| at most {decimal(claim.limit, 6)} from {decimal(claim.from_Hz or 0.0, 6)} Hz up"
        case "controller_effort":
            words = f"|C/(1+L)| at most {quantity(claim.limit, 'A/V')} at every frequency"
        case "decay_rate":
            words = f"every motion dies out at least as fast as exp(-{decimal(claim.limit, 6)} t / s)"
        case "gain_margin":
            words = f"stable with the gain times every factor from 1 to {decimal(claim.limit, 6)}"
    how = "polynomial inequality in mass and frequency decided by exact root isolation"
    if not claim.holds:
        how = claim.reason
    return Statement(f"{words}, for every outer end mass of {masses}", "proved" if claim.holds else "refuted", how)


def statements(run: DesignRun) -> list[Statement]:
    """Everything the report of a run claims, the best founded first."""
    found = proved_statements(run.certificate, run.problem.goal.compliance_m_per_N) if run.certificate else []
    sizing = run.sizing
    found.append(
        Statement(
            f"the chosen sections pass all {len(sizing.checks)} structural checks",
            "verified numerically" if sizing.feasible else "refuted",
            "closed formulas in floating point",
        )
    )
    if sizing.stock:
        found.append(
            Statement(
                "no lighter pair of the stock list passes",
                "verified numerically",
                f"all {sizing.stock.pairs} pairs were checked",
            )
        )
    if sizing.free:
        free = sizing.free
        found.append(
            Statement(
                "the free optimum fulfils the first-order conditions",
                "verified numerically",
                f"residual {free.kkt_residual:.1e}, from the gradients and not from the solver",
            )
        )
        found.append(
            Statement(
                "no lighter pair of free sizes exists",
                "sampled",
                f"{free.starts_agreeing} of {free.starts} local searches ended at the same mass",
            )
        )
    found.append(
        Statement(
            "critical gains, margins and bandwidths at single masses",
            "verified numerically",
            "roots of polynomials with error bounds at those masses, nothing swept in frequency",
        )
    )
    if run.tuning and run.tuning.best:
        found.append(
            Statement(
                "no other controller of this kind guarantees more",
                "sampled",
                f"best of {len(run.tuning.starts)} local searches from a coarse one; that it is the best is not proved",
            )
        )
    found.append(Statement("the curves between the points drawn", "sampled", "grids of frequencies and masses"))
    return found
