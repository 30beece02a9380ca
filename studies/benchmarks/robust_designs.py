"""What designs keep of what they claim when their rig is off: exact decisions about rigs drawn from the tolerances.

For each prototype: the bandwidth proved of the nominal rig and of every rig within one and two standard deviations (0
where the box is not proved stable), and of rigs drawn from the tolerances (normal) how many keep the claim over the
whole payload range. Usage, from the
root of the project:

    python studies/benchmarks/robust_designs.py PROTOTYPE... [--draws 64] [--claim-Hz 16.3]

A prototype that states no tolerances is given those of `delivered_bandwidth.py`.
"""

import argparse
from pathlib import Path

from delivered_bandwidth import TOLERANCE, least_share

from beamdesign import Prototype, certify, read_prototype
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.box_claims import best_over_box, guaranteed_fields
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.synthesis.rig_spread import rig_spread
from beamdesign.time_limit import share, within

SECONDS = 60.0
"""Most time for what is proved of stability over a box, and for the best of the rest."""


def proved_bandwidth(prototype: Prototype, sigmas: float) -> float:
    """Bandwidth that is proved of the nominal rig, or of all within so many standard deviations; 0 if none. Hz."""
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    if sigmas == 0:
        found = certify(prototype, *masses).guaranteed
        return 0.0 if found is None else found.bandwidth_Hz
    box = tolerance_box(prototype, sigmas, None, masses)
    if not certify_box(prototype, box, seconds=SECONDS, volumes=False).stable:
        return 0.0
    with within(SECONDS / 60), share(1.0, within_steps=True):
        return guaranteed_fields(best_over_box(prototype, box))["bandwidth_Hz"] or 0.0


def main() -> None:
    """Print a row for every prototype."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototypes", nargs="+", type=Path)
    parser.add_argument("--draws", type=int, default=64)
    parser.add_argument("--claim-Hz", type=float, help="claimed bandwidth; else what is proved of the nominal rig")
    given = parser.parse_args()
    print(f"{'':32} {'nominal':>8} {'1 sigma':>8} {'2 sigma':>8}  proved, Hz; drawn rigs that keep the claim")
    for path in given.prototypes:
        record = read_prototype(path).but(guarantee=None)
        if not any(record.tolerance.model_dump().values()):
            record = record.but(tolerance=TOLERANCE)
        masses = record.payload.outer_end_mass_kg or (0.0, 0.0)
        reached = [proved_bandwidth(record, sigmas) for sigmas in (0.0, 1.0, 2.0)]
        claim = given.claim_Hz or float(f"{0.9999 * reached[0]:.4g}")
        asked, spread = Asked("compliance", record.goal.compliance_m_per_N, claim), rig_spread(record, masses[1])
        kept = sum(certify(spread.rig(z), *masses, [asked]).holds for z in spread.drawn(given.draws, seed=5))
        figures = " ".join(f"{one:8.4g}" for one in reached)
        share = f"{kept} of {given.draws} keep {claim:.4g} Hz, at least {100 * least_share(kept, given.draws):.0f} %"
        print(f"{path.stem:32} {figures}  {share} of all", flush=True)


if __name__ == "__main__":
    main()
