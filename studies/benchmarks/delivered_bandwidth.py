"""What structured controllers promise and what the nonlinear rig delivers, with the valve's limits and without them.

Rigs are drawn from the tolerances of each prototype, or from those below where it states none, get the effects that the
linear design leaves out, and are measured as on a bench: a step, then a random force, whose response is held against
the goal. Claimed is what the prototype guarantees, or else what is proved of the nominal rig. Usage, from
the root of the project:

    python studies/benchmarks/delivered_bandwidth.py PROTOTYPE... [--rigs 8] [--force-N 40] [--delay-s 0.0003]
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from beamdesign import Prototype, certify, read_prototype, simulate
from beamdesign.proofs.tolerance_box import TOLERANCES
from beamdesign.prototype import Tolerance
from beamdesign.scenario import Input, Multisine, Scenario, ScenarioRecord, Step
from beamdesign.simulation import SimulatedRecord
from beamdesign.structure.lumped import CHANGEABLE, with_figures
from beamdesign.synthesis.loop_samples import first_miss
from beamdesign.synthesis.rig_spread import rig_spread

MEASURED_WITHIN = 0.1
"""Excess of the compliance over the goal that counts as met: what a measured response of a few seconds can tell."""

_NOISE_HZ = 900.0
_SEGMENT_S, _SEGMENTS, _LOWEST_HZ, _HIGHEST_HZ = 4.0, 3, 1.0, 100.0
_STEP_S = 3.0

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


@dataclass(frozen=True)
class Delivered:
    """What one rig delivered.

    Attributes:
        stable: whether it came to rest after a step, and stayed within bounds under the force.
        bandwidth_Hz: up to which the measured compliance keeps to the goal; 0 where the rig is not stable.
        largest_current_A: in the record of the force.
        reason: why it is not stable, in words; empty where it is.
    """

    stable: bool
    bandwidth_Hz: float
    largest_current_A: float
    reason: str = ""


def delivered(prototype: Prototype, outer_end_mass: float, amplitude_N: float, seed: int = 0) -> Delivered:
    """Measure the closed-loop compliance of a rig, with its effects, under a random force on its tip.

    The sensor's noise, where the prototype states it, comes in with the command: to the controller that is the same.
    What it moves without the force is taken off, so that no averaging is needed.

    Args:
        prototype: with a controller.
        outer_end_mass: payload, kg.
        amplitude_N: peak of a multisine from 1 to 100 Hz; also the height of a step.
        seed: of the force's phases.

    Raises:
        InputError: for effects that cannot be, or where there is no equilibrium to start from.
    """
    force = Multisine(amplitude_N=amplitude_N, low_Hz=_LOWEST_HZ, high_Hz=_HIGHEST_HZ, seed=seed)
    noise, long = _noise(prototype, seed), _SEGMENT_S * (_SEGMENTS + 1) / 2

    def record(name: str, duration_s: float, *signals: Input) -> SimulatedRecord:
        row = ScenarioRecord(name=name, input=signals, outer_end_mass_kg=outer_end_mass)
        return simulate(prototype, Scenario(name=name, duration_s=duration_s, record=(row,))).records[0]

    step, answer = record("step", _STEP_S, Step(amplitude_N=amplitude_N)), record("force", long, force, *noise)
    current = float(np.abs(answer.column("current_A")).max())
    if not step.stable:
        return Delivered(False, 0.0, current, step.reason)
    moved = answer.column("displacement_m")
    if noise and answer.diverged_at_s is None:
        moved = moved - record("noise", long, *noise).column("displacement_m")
    if answer.diverged_at_s is not None:
        return Delivered(False, 0.0, current, answer.reason)
    rate = 1 / Scenario.model_fields["sample_s"].default
    frequency, compliance = response(answer.column("disturbance_N"), moved, rate, _SEGMENT_S, _HIGHEST_HZ)
    limit = (1 + MEASURED_WITHIN) * prototype.goal.compliance_m_per_N
    reached = min(first_miss(frequency, np.log(limit / compliance)), float(frequency[-1]))
    return Delivered(True, reached, current)


def _noise(prototype: Prototype, seed: int) -> tuple[Multisine, ...]:
    """Noise of the stated RMS up to 1 kHz; a multisine of many lines is nearly Gaussian, its peak some 3.5 times it."""
    level = prototype.sensor.noise_V
    if not level:
        return ()
    return (Multisine(amplitude_V=3.5 * level, low_Hz=1.0, high_Hz=_NOISE_HZ, seed=seed + 1000),)


def response(
    force: np.ndarray, displacement: np.ndarray, rate: float, segment_s: float, highest_Hz: float
) -> tuple[np.ndarray, np.ndarray]:
    """Magnitude of displacement over force, by cross and power spectra over half overlapping segments (Welch)."""
    from scipy.signal import csd, welch

    length = round(segment_s * rate)
    frequency, across = csd(force, displacement, rate, "hann", length, detrend=False)
    _, own = welch(force, rate, "hann", length, detrend=False)
    band = (frequency >= _LOWEST_HZ + 1) & (frequency <= highest_Hz)
    return frequency[band], np.abs(across[band]) / own[band]


def drawn(prototype: Prototype, deviations: Mapping[str, float], count: int, seed: int = 1) -> list[Prototype]:
    """Rigs whose figures are off by random factors.

    Args:
        prototype: nominal.
        deviations: relative standard deviations, by figure as in `beamdesign.structure.lumped`; normal,
            cut at two of them.
        count: how many rigs.
        seed: of the draws.
    """
    random = np.random.default_rng(seed)
    rigs = []
    for _ in range(count):
        parts = np.clip(random.standard_normal(len(deviations)), -2, 2)
        factors = {name: 1 + float(z) * size for z, (name, size) in zip(parts, deviations.items(), strict=True)}
        rigs.append(with_figures(prototype, factors))
    return rigs


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
