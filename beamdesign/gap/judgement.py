"""From fits to a verdict: probabilities of causes, of none, and of one that the library does not hold."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import NOTHING, WRONG, Hypothesis
from beamdesign.gap.fitting.search import Search

EFFECT_ODDS, FIGURE_ODDS = log(0.05), log(0.02)
"""Prior odds of one more effect, and of one more plainly wrong figure, against none."""
LAW_ODDS = log(0.33)
"""Prior odds of another law for an effect than the usual one."""
_NOT_EXPLAINED = 0.15  # share of the excess misfit: a right cause, differently realised, leaves less
_MUCH = 2.5  # times the misfit of noise alone: what rigs leave that have a little of everything
_STEEP = 4.0
STRAINED = 4.0
"""Tolerances by which no figure is off in a rig whose gap has been understood."""
_SLIGHT = 0.5  # of the misfit of noise alone
_MINOR = 0.03
_PLAIN = 8.0  # in cost: about three tolerances


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

    @property
    def strained(self) -> tuple[str, ...]:
        """Tolerated figures that the best fit has moved further than anyone would believe: it may stand for another."""
        pairs = zip(self.best.unknowns, self.best.z, strict=True)
        return tuple(u.name for u, z in pairs if u.kind == "figure" and abs(z) > STRAINED)

    def cause(self, name: str) -> float:
        """Probability that a cause is at work, alone or with others."""
        return sum(p for h, p in self.of.items() if name in h.causes)

    @property
    def of_causes(self) -> dict[tuple[str, ...], float]:
        """Probability of every set of causes, whatever laws they follow; most probable first."""
        sums: dict[tuple[str, ...], float] = {}
        for hypothesis, p in self.of.items():
            sums[hypothesis.causes] = sums.get(hypothesis.causes, 0.0) + p
        return dict(sorted(sums.items(), key=lambda item: -item[1]))

    @property
    def sure(self) -> float:
        """Probability of the causes of the best fit."""
        return self.of_causes[self.best.hypothesis.causes]


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
    laws = sum(1 for name in hypothesis.names if name not in hypothesis.causes)
    figures = sum(1 for name in hypothesis.names if name.startswith(WRONG))
    effects = len(hypothesis.names) - figures
    return effects * EFFECT_ODDS + figures * FIGURE_ODDS + laws * LAW_ODDS


def judge(found: Search) -> Judgement:
    """Weigh all fits of a search."""
    fits: Sequence[Fit] = [f for f in (found.null, *found.fits) if not f.reason]
    spread = max(1.0, min(f.misfit for f in fits) / found.expected)
    costs = {f.hypothesis: f.cost for f in fits}
    logs = np.array(
        [evidence(f, spread) + odds(f.hypothesis) - _slight(f, costs, found.expected, spread) for f in fits]
    )
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    best = fits[int(np.argmax(weights))]
    unknown = _unknown(found, best)
    return Judgement(
        {f.hypothesis: float(w) * (1 - unknown) for f, w in zip(fits, weights, strict=True)}, unknown, best
    )


def _slight(found: Fit, costs: Mapping[Hypothesis, float], expected: float, spread: float) -> float:
    """What is taken off the evidence for causes that explain no more than a rig's many small imperfections may.

    Every real rig has a little of everything, so that one more cause always improves a fit. What a cause improves
    counts by what its removal brings back, in misfit and in figures off their tolerances: `_SLIGHT` of the noise's own
    misfit or more, and no less than `_MINOR` of the gap's. A wrong figure alone is told by how far off its tolerance
    it is, so that what comes back need only be `_PLAIN`.
    """
    cost = 0.0
    least = max(_SLIGHT * expected, _MINOR * (costs[NOTHING] - expected))
    for name in found.hypothesis.names:
        rest = Hypothesis(tuple(n for n in found.hypothesis.names if n != name))
        gained = costs.get(rest, np.inf) - found.cost
        enough = _PLAIN if rest == NOTHING and name.startswith(WRONG) else least
        if 0 < gained < np.inf:
            cost += gained / (2 * spread) / (1 + (gained / enough) ** (2 * _STEEP))
    return cost


def _unknown(found: Search, best: Fit) -> float:
    """Probability of an unknown cause: the best known one leaves much in units of misfit, and much of the gap."""
    much = 1 / (1 + (_MUCH * found.expected / best.misfit) ** _STEEP)
    left = max(found.excess(best), 1e-6)
    return much / (1 + (_NOT_EXPLAINED / left) ** _STEEP)
