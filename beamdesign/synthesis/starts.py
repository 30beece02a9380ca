"""Where refinement begins: the best of sampled designs, each with the best gain the samples allow, proved stable.

A coarse search on a grid of frequencies and masses finds for each controller shape the best gain. Everything here but
the stability of what is chosen is sampled and only proposes; what is proposed is refined and proved elsewhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from beamdesign.controllers.form import Form
from beamdesign.synthesis.loop_limits import loop_set
from beamdesign.synthesis.loop_samples import Samples, first_miss, rig_samples
from beamdesign.synthesis.refinement import LoopProgram

SEARCH_FREQUENCIES_HZ = np.geomspace(0.05, 600.0, 300)
"""Grid of the coarse search: 3 % steps, finer than the half-width of a mode with 5 % damping."""


@dataclass(frozen=True)
class Candidate:
    """A sampled guess: guaranteed bandwidth on the grid, gain in A/V, the shape's parameters, inner end mass in kg."""

    bandwidth_Hz: float
    gain: float
    shape: tuple[float, ...]
    inner_end_mass: float


def feasible_gain_ends(loop_per_gain: np.ndarray, peak_sensitivity: float) -> np.ndarray:
    """Upper ends of the intervals of gain K on which |1 / (1 + K l)| stays within the limit at every sample l.

    Each sample forbids one interval of K, the roots of |1 + K l|^2 = 1 / Ms^2; a lightly damped resonance forbids low
    gains as well, so that the allowed set need not begin at zero.
    """
    real, square = loop_per_gain.real.ravel(), (np.abs(loop_per_gain) ** 2).ravel()
    discriminant = real**2 - square * (1 - peak_sensitivity**-2)
    forbids = (real < 0) & (discriminant > 0)
    if not forbids.any():
        return np.array([])
    root, middle, scale = np.sqrt(discriminant[forbids]), -real[forbids], square[forbids]
    starts, ends = (middle - root) / scale, (middle + root) / scale
    order = np.argsort(starts)
    starts, reach = starts[order], np.maximum.accumulate(ends[order])
    return np.concatenate([starts[:1], starts[1:][starts[1:] > reach[:-1] * (1 + 1e-9)]])


def sampled_bandwidth(frequency_Hz: np.ndarray, worst_compliance: np.ndarray, limit: float) -> float:
    """First frequency at which the compliance passes the limit, interpolated between samples on logarithmic axes."""
    slack = np.log(limit / worst_compliance)
    reached = first_miss(frequency_Hz, slack)
    return float(min(reached or frequency_Hz[0] * np.exp(slack[0]), frequency_Hz[-1]))


def best_gain(
    points: Samples,
    form: Form,
    shape: Sequence[float],
    inner_end_mass: float,
    peak_sensitivity: float,
    compliance: float,
    only_stable: bool = False,
) -> Candidate:
    """Best gain of one controller shape and inner end mass on samples; bandwidth 0 where none is allowed.

    Args:
        points: of all plants that are to do with this controller, the same frequencies in every row.
        form: of the controller; its first variable is the logarithm of the gain.
        shape: what the others are logarithms of.
        inner_end_mass: kg.
        peak_sensitivity: limit of max |S|.
        compliance: limit of |x / F_d|, m/N.
        only_stable: leave out gains at which 1 + L winds about the origin on the grid. With much phase beyond the grid,
            loops that are far from stable have small sensitivities on it.
    """
    rows = int(points.row.max()) + 1
    frequency = points.frequency_Hz[: len(points.frequency_Hz) // rows]
    own = form.responses(np.log([1.0, *shape]), 2j * pi * points.frequency_Hz)[0]
    _, control, disturbance, crossed = points.at(inner_end_mass)
    per_gain, open_compliance = (own * control[0]).reshape(rows, -1), np.abs(disturbance).reshape(rows, -1)
    per_gain_crossed = (own * crossed[0] / disturbance).reshape(rows, -1)  # by what share a unit of gain changes that
    best = Candidate(0.0, 0.0, tuple(shape), inner_end_mass)
    for gain in feasible_gain_ends(per_gain, peak_sensitivity):
        return_difference = 1 + gain * per_gain
        if only_stable and (np.abs(np.unwrap(np.angle(return_difference), axis=1)[:, -1]) > pi).any():
            continue
        worst = (open_compliance * np.abs(1 + gain * per_gain_crossed) / np.abs(return_difference)).max(axis=0)
        bandwidth = sampled_bandwidth(frequency, worst, compliance)
        if bandwidth > best.bandwidth_Hz:
            best = Candidate(bandwidth, float(gain), tuple(shape), inner_end_mass)
    return best


_APART = 0.1
"""Least distance between starts, as a share of the range of each variable that is free."""


def best_starts(
    program: LoopProgram, samples: np.ndarray, score: Callable[[np.ndarray], float], count: int
) -> tuple[list[np.ndarray], int]:
    """Choose starts among samples of a program's variables; their gain and bandwidth are found here.

    Args:
        program: what is to be optimised.
        samples: (k, n) variables; the first, the gain's logarithm, and the bandwidth's are overwritten.
        score: of a sample's variables, the least is tried first.
        count: how many starts are wanted.

    Returns:
        Up to `count` starts, mutually distant, each proved stable over the range; and how many proofs that took.
    """
    low, high = program.outer_end_mass_kg
    masses = np.unique(np.linspace(low, high, 7))
    names = program.form.size
    responses: dict[bytes, Samples] = {}
    found: list[np.ndarray] = []
    for sample in samples:
        sections = sample[names + 2 :]
        if sections.tobytes() not in responses:
            members = program.members(sections)
            if members is None:
                continue
            responses = {sections.tobytes(): rig_samples(members, SEARCH_FREQUENCIES_HZ, masses.tolist())}
        best = best_gain(
            responses[sections.tobytes()],
            program.form,
            np.exp(sample[1:names]),
            float(sample[names]),
            program.goal.peak_sensitivity,
            program.goal.compliance_m_per_N,
            only_stable=True,
        )
        if best.gain > 0.0:
            variables = sample.copy()
            variables[0], variables[names + 1] = np.log(best.gain), np.log(best.bandwidth_Hz)
            found.append(np.clip(variables, program.lower, program.upper))
    spread = program.upper - program.lower
    free = spread > 0
    chosen: list[np.ndarray] = []
    proofs = 0
    for variables in sorted(found, key=score):
        if len(chosen) == count:
            break
        if any(np.linalg.norm((variables - other)[free] / spread[free]) < _APART for other in chosen):
            continue
        members = program.members(variables[names + 2 :])
        if members is None:
            continue
        proofs += 1
        controller = program.form.record(variables[:names])
        if not loop_set(members, controller, float(variables[names]), (low, high)).unstable():
            chosen.append(variables)
    return chosen, proofs
