"""What a compliant controller promises and what nonlinear rigs deliver: stiffness at rest, and a strike on a wall.

Rigs are drawn from the tolerances of a prototype and get the effects that the linear design leaves out. Each is pushed
slowly, then made to strike a wall and pushed off it. Usage, from the root of the project:

    python studies/benchmarks/delivered_stiffness.py studies/prototypes/compliant.toml [--rigs 8] [--force-N 100]
"""

import argparse
from pathlib import Path

import numpy as np

from beamdesign import Prototype, read_prototype, simulate
from beamdesign.scenario import Scenario, ScenarioRecord, Step, WallAhead
from beamdesign.simulation import SimulatedRecord
from beamdesign.synthesis.rig_spread import rig_spread

EFFECTS: dict[str, dict[str, dict[str, float]]] = {
    "as designed": {},
    "orifices, air, limit of current": {
        "pressure_dependent_flow": {}, "entrained_air": {}, "current_saturation": {"limit_A": 0.015},
    },
    "and a second mode of the inner beam": {
        "pressure_dependent_flow": {}, "entrained_air": {}, "current_saturation": {"limit_A": 0.015},
        "second_beam_mode": {"frequency_Hz": 327.0},
    },
    "and 0.3 ms of delay": {
        "pressure_dependent_flow": {}, "entrained_air": {}, "current_saturation": {"limit_A": 0.015},
        "second_beam_mode": {"frequency_Hz": 327.0}, "transport_delay": {"delay_s": 0.0003},
    },
}  # fmt: skip
"""What the rigs have that the linear design leaves out."""

WALLS_N_PER_M = (1e5, 1e6, 1e7)


def records(rig: Prototype, mass: float, force_N: float, stiffness: float) -> list[SimulatedRecord]:
    """A slow push, and a strike on each wall halfway to where the push would end."""
    push = Step(amplitude_N=force_N, at_s=0.05, rise_s=1.0)
    strike = Step(amplitude_N=force_N, at_s=0.05, rise_s=0.002, length_s=0.6)
    halfway = force_N / stiffness / 2
    slow = Scenario(
        name="slow",
        duration_s=2.0,
        sample_s=1e-3,
        record=(ScenarioRecord(name="push", input=(push,), outer_end_mass_kg=mass),),
    )
    quick = Scenario(
        name="quick",
        duration_s=1.5,
        record=tuple(
            ScenarioRecord(
                name=f"wall{wall:.0f}",
                input=(strike,),
                outer_end_mass_kg=mass,
                wall=WallAhead(at_m=halfway, stiffness_N_per_m=wall),
            )
            for wall in WALLS_N_PER_M
        ),
    )
    return [*simulate(rig, slow).records, *simulate(rig, quick).records]


def main() -> None:
    """Print what every set of effects leaves of the promise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--force-N", type=float, default=100.0)
    given = parser.parse_args()
    prototype = read_prototype(given.prototype)
    if prototype.compliance is None:
        raise SystemExit("the prototype needs [compliance]; `beamdesign stiffness` writes it")
    asked = prototype.compliance.end_stiffness_N_per_m
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    spread = rig_spread(prototype, masses[1], 1.0)
    rigs = [spread.rig(z) for z in spread.drawn(given.rigs, 1)]
    for words, effects in EFFECTS.items():
        measured, calm = [], np.zeros(len(WALLS_N_PER_M), dtype=int)
        for k, rig in enumerate(rigs):
            slow, *struck = records(rig.but(effects=effects), masses[k % 2], given.force_N, asked)
            if slow.stable:
                measured.append(slow.column("disturbance_N")[-1] / slow.column("displacement_m")[-1])
            calm += [record.stable for record in struck]
        ends = f"{min(measured) / asked:.3f} to {max(measured) / asked:.3f}" if measured else "none"
        walls = ", ".join(f"{n} at {wall:g} N/m" for n, wall in zip(calm, WALLS_N_PER_M, strict=True))
        print(
            f"{words}: {len(measured)} of {len(rigs)} at rest under a push, at {ends} of the stiffness asked for;"
            f" come to rest after a strike on a wall: {walls}",
            flush=True,
        )


if __name__ == "__main__":
    main()
