"""What a robust design keeps: its worst rigs, each with a certificate, and rigs drawn at random, each decided."""

from collections.abc import Sequence
from dataclasses import dataclass

from beamdesign.design.refinement import Proved
from beamdesign.design.rig_spread import RigSpread
from beamdesign.proof.certificate import Certificate
from beamdesign.proof.certifying import certify
from beamdesign.prototype import Prototype
from beamdesign.study.design_run import claims_of

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Draws:
    """How many of the rigs drawn at random keep what is claimed.

    Attributes:
        count: how many were drawn.
        kept: how many keep every limit.
        bandwidth_kept: how many are stable and keep the compliance up to the bandwidth, whatever else they miss.
        missed: what each of the others misses, in words.
    """

    count: int
    kept: int
    bandwidth_kept: int
    missed: tuple[str, ...]

    @property
    def least_share(self) -> float:
        """Least share of all rigs that keep the bandwidth, by Clopper and Pearson (1934), one-sided."""
        return least_share(self.bandwidth_kept, self.count)


def least_share(kept: int, count: int) -> float:
    """Lower end of the one-sided confidence interval of a share, of Clopper and Pearson (Biometrika 26, 1934)."""
    from scipy.stats import binomtest

    return float(binomtest(kept, count, alternative="greater").proportion_ci(CONFIDENCE, "exact").low)


def prove_rigs(rigs: Sequence[Prototype], proved: Proved, masses_kg: tuple[float, float]) -> list[Certificate]:
    """Certify every rig with what is claimed of the nominal one."""
    return [certify(rig, *masses_kg, claims_of(rig, proved)) for rig in rigs]


def draw_rigs(
    spread: RigSpread,
    proved: Proved,
    masses_kg: tuple[float, float],
    count: int,
    seed: int = 1,
    inside: bool = False,
) -> Draws:
    """Decide in exact arithmetic whether rigs drawn from the tolerances keep what is claimed, over all masses.

    Args:
        spread: of the tuned prototype; its deviations are those of the draws, normal, whatever its sigmas.
        inside: draw from within its sigmas instead, each of these rigs as likely as the others.
        proved: what is claimed.
        masses_kg: range of outer end mass.
        count: how many rigs.
        seed: of the draws.
    """
    kept, wide, missed = 0, 0, []
    for z in spread.drawn(count, seed, inside):
        rig = spread.rig(z)
        found = certify(rig, *masses_kg, claims_of(rig, proved))
        kept += found.holds
        wide += found.stable and all(claim.holds for claim in found.claims if claim.kind == "compliance")
        missed += [] if found.holds else [found.reason]
    return Draws(count, kept, wide, tuple(missed))
