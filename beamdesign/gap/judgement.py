"""From fits to a verdict: probabilities of causes, of none, and of one that the library does not hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from beamdesign.gap.fit import Fit
from beamdesign.gap.hypothesis import WRONG, Hypothesis
from beamdesign.gap.search import Search

EFFECT_ODDS, FIGURE_ODDS = log(0.05), log(0.02)
"""Prior odds of one more effect, and of one more plainly wrong figure, against none."""
_NOT_EXPLAINED = 0.15  # share of the excess misfit: a right cause, differently realised, leaves less
_MUCH = 2.5  # times the misfit of noise alone: what rigs leave that have a little of everything
_STEEP = 4.0


@dataclass(frozen=True)
class Judgement:
    """Probabilities.

    Attributes:
        of: each hypothesis, the null among them; with that of the unknown they add up to one.
        unknown: that something outside the library is behind the gap.
        best: the most probable fit (the null's where there is no gap).
    """

    of: dict[Hypothesis, float]
    unknown: float
    best: Fit

    def cause(self, name: str) -> float:
        """Probability that a cause is at work, alone or with others."""
        return sum(p for h, p in self.of.items() if name in h.names)


def evidence(found: Fit, spread: float) -> float:
    """Logarithm of the marginal likelihood by Laplace's method, up to a constant.

    Args:
        found: a fit; its prior is the standard normal distribution of z.
        spread: how much larger misfit is than its units say, for the best of all fits (overdispersion).
    """
    if found.reason:
        return -np.inf
    curvature = np.eye(len(found.z)) + sum(s.a for s in found.shares) / spread
    _, volume = np.linalg.slogdet(curvature)
    return -0.5 * (found.misfit / spread + float(found.z @ found.z) + float(volume))


def odds(hypothesis: Hypothesis) -> float:
    """Logarithm of the prior odds against no cause at all."""
    return sum(FIGURE_ODDS if name.startswith(WRONG) else EFFECT_ODDS for name in hypothesis.names)


def judge(found: Search) -> Judgement:
    """Weigh all fits of a search."""
    fits: Sequence[Fit] = [f for f in (found.null, *found.fits) if not f.reason]
    spread = max(1.0, min(f.misfit for f in fits) / found.expected)
    logs = np.array([evidence(f, spread) + odds(f.hypothesis) for f in fits])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    best = fits[int(np.argmax(weights))]
    unknown = _unknown(found, best)
    return Judgement(
        {f.hypothesis: float(w) * (1 - unknown) for f, w in zip(fits, weights, strict=True)}, unknown, best
    )


def _unknown(found: Search, best: Fit) -> float:
    """Probability of an unknown cause: the best known one leaves much in units of misfit, and much of the gap."""
    much = 1 / (1 + (_MUCH * found.expected / best.misfit) ** _STEEP)
    left = max(found.excess(best), 1e-6)
    return much / (1 + (_NOT_EXPLAINED / left) ** _STEEP)
