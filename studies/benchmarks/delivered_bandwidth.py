"""What structured controllers promise and what the nonlinear rig delivers, with the valve's limits and without them.

Rigs are drawn from the tolerances of each prototype, or from those below where it states none, get the effects that the
linear design leaves out, and are measured as on a bench: a step, then a random force, whose response is held against
the goal. Claimed is what the prototype guarantees, or else what is proved of the nominal rig. Usage, from
the root of the project:

    python studies/benchmarks/delivered_bandwidth.py PROTOTYPE... [--rigs 8] [--force-N 40] [--delay-s 0.0003]
"""

import argparse
from pathlib import Path

import numpy as np
from delivered import Delivered, delivered, drawn
from scipy.stats import binomtest

from beamdesign import Prototype, certify, read_prototype
from beamdesign.proofs.tolerance_box import TOLERANCES
from beamdesign.prototype import Tolerance
from beamdesign.structure.lumped import CHANGEABLE
from beamdesign.synthesis.rig_spread import rig_spread

TOLERANCE = Tolerance(
    stiffness=0.02,
    effective_mass=0.02,
    beam_damping_ratio=0.15,
    oil_stiffness=0.1,
    flow_gain=0.05,
    valve_natural_frequency=0.05,
    valve_damping_ratio=0.1,
    sensor_gain=0.01,
    sensor_filter=0.03,
)
"""Of rigs whose prototype states none."""

DEVIATIONS = {
    name: size for name in CHANGEABLE if name in TOLERANCES and (size := getattr(TOLERANCE, TOLERANCES[name]))
}
"""The same by figure."""

EFFECTS: dict[str, dict[str, float]] = {
    "current_saturation": {},
    "pressure_dependent_flow": {},
    "second_beam_mode": {"frequency_Hz": 327.0},
}
"""What the linear design leaves out; limits of current are the rig's rated one where it states that."""


def rig_of(prototype: Prototype) -> Prototype:
    """The nonlinear rig that a prototype is built as."""
    effects = {name: dict(figures) for name, figures in EFFECTS.items()}
    if prototype.servovalve.rated_current_A is not None:
        effects["current_saturation"]["limit_A"] = prototype.servovalve.rated_current_A
    return prototype.but(effects=effects | prototype.effects, guarantee=None)


def deviations_of(prototype: Prototype) -> dict[str, float]:
    """Standard deviations by figure: the prototype's own, or those above."""
    if not any(prototype.tolerance.model_dump().values()):
        absent = () if prototype.sensor.filter_Hz is not None else ("filter_frequency",)
        return {name: size for name, size in DEVIATIONS.items() if name not in absent}
    return dict(rig_spread(prototype, 0.0, 1.0).deviations)


def measured(prototype: Prototype, rigs: int, force_N: float, seed: int = 1) -> list[Delivered]:
    """Every drawn rig, with the least payload of its range and with the largest in turn."""
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    return [
        delivered(rig, masses[k % 2], force_N, seed=k)
        for k, rig in enumerate(drawn(rig_of(prototype), deviations_of(prototype), rigs, seed))
    ]


def claimed(prototype: Prototype) -> float:
    """Bandwidth that the prototype guarantees, or else that is proved of the nominal rig; 0 if none. Hz."""
    if prototype.guarantee is not None:
        return prototype.guarantee.bandwidth_Hz
    found = certify(prototype, *(prototype.payload.outer_end_mass_kg or (0.0, 0.0))).guaranteed
    return 0.0 if found is None else found.bandwidth_Hz


def least_share(kept: int, count: int) -> float:
    """Lower end of the one-sided 95 % confidence interval of a share, of Clopper and Pearson (Biometrika 26, 1934)."""
    return float(binomtest(kept, count, alternative="greater").proportion_ci(0.95, "exact").low)


def main() -> None:
    """Print a row for every prototype."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototypes", nargs="+", type=Path)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--force-N", type=float, default=40.0)
    parser.add_argument("--delay-s", type=float, help="a delay in the loop beside the other effects")
    parser.add_argument("--mode-damping", type=float, default=0.02, help="damping ratio of the second beam mode")
    parser.add_argument("--lag-Hz", type=float, help="a further first-order lag in the loop, such as a valve's")
    parser.add_argument("--seed", type=int, default=1, help="of the draws")
    parser.add_argument("--claim-Hz", type=float, help="claimed bandwidth; else the prototype's own")
    given = parser.parse_args()
    EFFECTS["second_beam_mode"]["damping_ratio"] = given.mode_damping
    if given.delay_s:
        EFFECTS["transport_delay"] = {"delay_s": given.delay_s}
    if given.lag_Hz:
        EFFECTS["sensor_lag"] = {"break_Hz": given.lag_Hz}
    print(f"{'':30} {'claimed':>8} {'stable':>9}  {'least':>6} {'median':>6} {'largest':>7}  delivered, Hz")
    for path in given.prototypes:
        record = read_prototype(path)
        found = measured(record, given.rigs, given.force_N, given.seed)
        reached, promised = np.array([one.bandwidth_Hz for one in found]), given.claim_Hz or claimed(record)
        stable = f"{sum(one.stable for one in found)} of {len(found)}"
        least, middle, most = reached.min(), np.median(reached), reached.max()
        print(f"{path.stem:30} {promised:8.4g} {stable:>9}  {least:6.2f} {middle:6.2f} {most:7.2f}", flush=True)
        kept = int((reached >= promised).sum())
        share = 100 * least_share(kept, len(found))
        print(f"    {kept} deliver what is claimed: at least {share:.0f} % of all rigs, at 95 % confidence")
        for reason in sorted({one.reason for one in found if one.reason})[:3]:
            print(f"    {reason}")


if __name__ == "__main__":
    main()
