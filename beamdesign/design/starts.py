"""Where refinement begins: the best of sampled designs, each with the best gain the samples allow, proved stable."""

from collections.abc import Callable

import numpy as np

from beamdesign.design.loop_samples import Samples, rig_samples
from beamdesign.design.loop_search import SEARCH_FREQUENCIES_HZ, best_gain
from beamdesign.design.loop_set import loop_set
from beamdesign.design.refinement import LoopProgram

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
