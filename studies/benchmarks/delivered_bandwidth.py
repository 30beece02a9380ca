"""What structured controllers promise and what the nonlinear rig delivers, with the valve's limits and without them.

Rigs are drawn from tolerances, get the effects that the linear design leaves out, and are measured as on a bench: a
step, then a random force, whose response is held against the goal. Usage, from the root of the project:

    python studies/benchmarks/delivered_bandwidth.py PROTOTYPE... [--rigs 8] [--force-N 40]
"""

import argparse
from pathlib import Path

import numpy as np

from beamdesign.proof.certificate import certify
from beamdesign.prototype import Prototype, read_prototype
from beamdesign.study.delivered import Delivered, delivered, drawn

DEVIATIONS = {
    "outer_stiffness": 0.02,
    "inner_stiffness": 0.02,
    "outer_mass": 0.02,
    "inner_mass": 0.02,
    "outer_damping": 0.15,
    "inner_damping": 0.15,
    "oil_stiffness": 0.1,
    "flow_gain": 0.05,
    "valve_frequency": 0.05,
    "valve_damping_ratio": 0.1,
    "sensor_gain": 0.01,
    "filter_frequency": 0.03,
}
"""Relative standard deviations of the rigs that are drawn."""

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


def measured(prototype: Prototype, rigs: int, force_N: float) -> list[Delivered]:
    """Every drawn rig, with the least payload of its range and with the largest in turn."""
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    return [
        delivered(rig, masses[k % 2], force_N, seed=k)
        for k, rig in enumerate(drawn(rig_of(prototype), DEVIATIONS, rigs))
    ]


def main() -> None:
    """Print a row for every prototype."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototypes", nargs="+", type=Path)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--force-N", type=float, default=40.0)
    parser.add_argument("--delay-s", type=float, help="a delay in the loop beside the other effects")
    parser.add_argument("--mode-damping", type=float, default=0.02, help="damping ratio of the second beam mode")
    given = parser.parse_args()
    EFFECTS["second_beam_mode"]["damping_ratio"] = given.mode_damping
    if given.delay_s:
        EFFECTS["transport_delay"] = {"delay_s": given.delay_s}
    print(f"{'prototype':28} {'proved, Hz':>10} {'stable':>8} {'least':>7} {'median':>7} {'largest':>8}  delivered, Hz")
    for path in given.prototypes:
        record = read_prototype(path)
        found = measured(record, given.rigs, given.force_N)
        reached = np.array([one.bandwidth_Hz for one in found])
        guaranteed = certify(record, *(record.payload.outer_end_mass_kg or (0.0, 0.0))).guaranteed
        proved = f"{guaranteed.bandwidth_Hz:.4g}" if guaranteed else "none"
        stable = f"{sum(one.stable for one in found)} of {len(found)}"
        least, middle, most = reached.min(), np.median(reached), reached.max()
        print(f"{path.stem:28} {proved:>10} {stable:>8} {least:7.1f} {middle:7.1f} {most:8.1f}")
        for reason in sorted({one.reason for one in found if one.reason})[:3]:
            print(f"    {reason}")


if __name__ == "__main__":
    main()
