"""What designs keep of what they claim when their rig is off: exact decisions about rigs drawn from the tolerances.

For each prototype: the bandwidth proved of the nominal rig and of the worst rigs one and two standard deviations off,
and of rigs drawn from the tolerances (normal) how many keep the claim over the whole payload range. Usage, from the
root of the project:

    python studies/benchmarks/robust_designs.py PROTOTYPE... [--draws 64] [--claim-Hz 16.3]

A prototype that states no tolerances is given those of `delivered_bandwidth.py`.
"""

import argparse
from pathlib import Path

import numpy as np
from delivered_bandwidth import TOLERANCE

from beamdesign.proofs.certifying import certify
from beamdesign.prototype import Prototype, read_prototype
from beamdesign.synthesis.design_run import draw_rigs, worst_of
from beamdesign.synthesis.loop_limits import Proved
from beamdesign.synthesis.rig_spread import rig_spread


def proved_bandwidth(prototype: Prototype, sigmas: float) -> float:
    """Least bandwidth that is proved of the nominal rig and of the worst so many standard deviations off, Hz."""
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    rigs = [prototype]
    if sigmas > 0:
        spread = rig_spread(prototype, masses[1], sigmas)
        rigs += map(spread.rig, worst_of(spread, masses))
    found = [certify(rig, *masses).guaranteed for rig in rigs]
    return min(0.0 if one is None else one.bandwidth_Hz for one in found)


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
        assert record.controller is not None
        asked = Proved(record.controller, record.payload.inner_end_mass_kg, claim, 1000.0, np.zeros(0))
        draws = draw_rigs(rig_spread(record, masses[1], 2.0), asked, masses, given.draws, seed=5)
        figures = " ".join(f"{one:8.4g}" for one in reached)
        share = f"{draws.bandwidth_kept} of {draws.count} keep {claim:.4g} Hz"
        print(f"{path.stem:32} {figures}  {share}, at least {100 * draws.least_share:.0f} % of all", flush=True)


if __name__ == "__main__":
    main()
