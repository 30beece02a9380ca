"""Where fits begin: the figures of a simpler fit, with the new effect as strong as suits the records best."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import qmc

from beamdesign.gap.fit import Evidence, misfit_at
from beamdesign.gap.unknowns import Placement, Unknown

_DRAWS = 12
_WIDTH = 1.5  # in prior standard deviations
_WEAK = 0.1  # of the default


def starts(
    placement: Placement, known: Mapping[str, float], evidence: Sequence[Evidence], most: int = 2
) -> list[np.ndarray]:
    """The most promising starts, best first.

    Args:
        placement: the unknowns of the hypothesis.
        known: SI values of unknowns that simpler fits have found.
        evidence: by which starts are compared; no fit is made.
        most: how many at most.

    Returns:
        (K,) z each; none where the model's loop is unstable at all of them.
    """
    low, high = (np.array(side) for side in zip(*(u.bounds for u in placement.unknowns), strict=True))
    base = np.array([_at(u, known) for u in placement.unknowns])
    new = [k for k, u in enumerate(placement.unknowns) if u.name not in known]
    tried = [(misfit_at(evidence, placement, z), z) for z in _trials(placement.unknowns, base, new, low, high)]
    stable = sorted((pair for pair in tried if np.isfinite(pair[0])), key=lambda pair: pair[0])
    return [z for _, z in stable[:most]]


def _at(unknown: Unknown, known: Mapping[str, float]) -> float:
    return unknown.z(known[unknown.name]) if unknown.name in known else 0.0


def _trials(
    unknowns: Sequence[Unknown], base: np.ndarray, new: Sequence[int], low: np.ndarray, high: np.ndarray
) -> list[np.ndarray]:
    """The base, draws from the prior of the new unknowns, and each new effect nearly absent."""
    if not new:
        return [base]
    trials = [np.clip(base, low, high)]
    weak = base.copy()
    for k in new:
        u = unknowns[k]
        if u.linear:
            weak[k] = u.z(_WEAK * u.nominal)
    trials.append(np.clip(weak, low, high))
    draws = qmc.Sobol(len(new), scramble=True, seed=0).random(_DRAWS + 4)[:_DRAWS]
    for row in draws:
        z = base.copy()
        z[list(new)] = _WIDTH * (2 * row - 1)
        trials.append(np.clip(z, low, high))
    return trials
