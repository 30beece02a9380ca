"""Simulate rigs that are drawn within tolerances, with drawn effects, and count what contradicts a proof.

Usage, from the root of the project:

    python studies/contradictions.py studies/prototypes/tame_lag.toml --rigs 2500 --workers 2

Every rig has figures drawn within two standard deviations (one in three at corners), payloads drawn, and effects drawn
with their sizes. What `certify --nonlinear` proves of it is compared with four simulated motions of the full model: how
far the tip strays from that of the same rig without the effects, against the proved bound; and whether a rig whose
current saturates comes to rest after a blow that saturates it. Proofs hold for all rigs and motions; these are samples.
"""

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from beamdesign import Prototype, read_prototype, simulate
from beamdesign.parameters import stated_or_typical
from beamdesign.proofs.absolute_stability import METHOD as COMES_TO_REST
from beamdesign.proofs.bounded_error import METHOD as STRAYS
from beamdesign.proofs.certifying import nonlinear_rows
from beamdesign.proofs.scope import members
from beamdesign.scenario import Multisine, Scenario, ScenarioRecord, Step
from beamdesign.synthesis import SIGMAS
from beamdesign.synthesis.rig_spread import rig_spread

MOTIONS = 4
"""Of every rig."""
SIZES = {
    "seal_friction": ("coulomb_N", 5.0, 100.0),
    "valve_hysteresis": ("half_width_A", 2e-5, 5e-4),
    "valve_deadband": ("half_width_A", 2e-5, 5e-4),
}
"""Of each effect whose error is bounded the figure that is drawn, and between which."""
RATED_A = (1e-3, 15e-3)
QUIET = 0.02
"""Share of its largest motion that a rig may have left at the end to count as at rest."""


def drawn(prototype: Prototype, number: int) -> tuple[Prototype, float, bool]:
    """A rig with effects, its payload (kg), and whether its current saturates: the rig of a number, always the same."""
    random = np.random.default_rng((1984, number))
    masses = prototype.asked_kg()
    spread = rig_spread(prototype, masses[1], SIGMAS)
    shares = random.uniform(-1, 1, len(spread.deviations))
    z = SIGMAS * (np.sign(shares) if number % 3 == 0 else shares)
    payload, saturates = float(random.uniform(*masses)), bool(number % 2)
    if saturates:
        effects = {"current_saturation": {"limit_A": float(np.exp(random.uniform(*np.log(RATED_A))))}}
    else:
        names = [name for name in SIZES if random.random() < 0.6] or ["seal_friction"]
        effects = {name: {SIZES[name][0]: float(np.exp(random.uniform(*np.log(SIZES[name][1:]))))} for name in names}
    return spread.rig(np.round(z, 3)).but(effects=effects, guarantee=None), payload, saturates


def outcome(prototype: Prototype, number: int) -> Counter[str]:
    """What came of the proofs of one rig, and of its motions beside them."""
    rig, payload, saturates = drawn(prototype, number)
    random, found = np.random.default_rng((6, number)), Counter[str]()
    low, high = max(payload - 0.2, 0.0), payload + 0.2
    rows = [
        row for row in nonlinear_rows(members(rig, low, high)) if row.method == (COMES_TO_REST if saturates else STRAYS)
    ]
    if not rows or not rows[-1].proved:
        return Counter({"not proved": 1})
    found["proved"] += 1
    for k in range(MOTIONS):
        mass = float(random.uniform(low, high))
        if saturates:
            length = float(random.uniform(0.02, 0.3))
            blow = Step(amplitude_N=float(random.uniform(200, 3000)), at_s=0.01, length_s=length)
            (moved,) = motions(rig, (blow,), mass, 4.0)
            quiet = abs(moved[-len(moved) // 8 :]).max() < QUIET * abs(moved).max()
            found["came to rest" if quiet else "CONTRADICTED: did not come to rest"] += 1
        else:
            signals = (
                Multisine(amplitude_N=float(random.uniform(20, 1500)), low_Hz=1.0, high_Hz=60.0, seed=number + k),
                Multisine(amplitude_V=float(random.uniform(0.01, 0.5)), low_Hz=1.0, high_Hz=40.0, seed=number + k + 1),
            )
            bound = rows[-1].bound_m
            assert bound is not None  # it is proved
            plain, moved = (motions(one, signals, mass, 1.0)[0] for one in (rig.but(effects={}), rig))
            share = abs(moved - plain).max() / bound
            found["within the bound" if share <= 1 else "CONTRADICTED: strayed farther"] += 1
            found["beyond half of it"] += 0.5 < share <= 1
    return found


def motions(rig: Prototype, signals: tuple[Step | Multisine, ...], mass: float, seconds: float) -> list[np.ndarray]:
    """Displacements of the tip, m."""
    record = ScenarioRecord(name="drawn", outer_end_mass_kg=mass, input=signals)
    scenario = Scenario(name="drawn", duration_s=seconds, start="rest", record=(record,))
    return [one.column("displacement_m") for one in simulate(rig, scenario).records]


def main() -> None:
    """Print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("--rigs", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    prototype = read_prototype(given.prototype)
    prototype = prototype.but(tolerance=stated_or_typical(prototype.tolerance, type(prototype.actuator))[0])
    total = Counter[str]()
    with ProcessPoolExecutor(given.workers) as pool:
        for one in pool.map(partial(outcome, prototype), range(given.rigs), chunksize=5):
            total += one
    for words, count in sorted(total.items()):
        print(f"{count:7d}  {words}")


if __name__ == "__main__":
    main()
