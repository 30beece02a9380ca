"""The bandwidth that a rig with its nonlinear effects delivers, measured on simulated records as on a bench."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from beamdesign import Prototype, simulate
from beamdesign.scenario import Input, Multisine, Scenario, ScenarioRecord, Step
from beamdesign.simulation import SimulatedRecord
from beamdesign.structure.lumped import with_figures
from beamdesign.synthesis.loop_samples import first_miss

MEASURED_WITHIN = 0.1
"""Excess of the compliance over the goal that counts as met: what a measured response of a few seconds can tell."""

_NOISE_HZ = 900.0
_SEGMENT_S, _SEGMENTS, _LOWEST_HZ, _HIGHEST_HZ = 4.0, 3, 1.0, 100.0
_STEP_S = 3.0


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
