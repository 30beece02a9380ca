"""What a design run claims, and how well each claim is founded: proved, verified numerically, or sampled."""

from typing import Literal, NamedTuple

from beamdesign.certify.certificate import Certificate
from beamdesign.certify.performance import Claim
from beamdesign.report.quantity import at_least, decimal, mass_range_text, quantity
from beamdesign.study.design_run import DesignRun

Foundation = Literal["proved", "refuted", "verified numerically", "sampled"]


class Statement(NamedTuple):
    """One claim in words, how well it is founded, and by what."""

    claim: str
    foundation: Foundation
    how: str


def proved_statements(certificate: Certificate, outer_end_mass_kg: tuple[float, float]) -> list[Statement]:
    """Stability over a range of masses and the further claims of its certificate."""
    masses = mass_range_text(outer_end_mass_kg)
    stability = Statement(
        f"stable for every outer end mass of {masses}",
        "proved" if certificate.stable else "refuted",
        "roots of one polynomial isolated in rational arithmetic, one exact Routh test per range",
    )
    return [stability, *(_of_claim(claim) for claim in certificate.claims)]


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
    masses = run.problem.payload.outer_end_mass_kg
    found = proved_statements(run.certificate, masses) if run.certificate and masses else []
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
