"""From fits to a verdict: probabilities of causes, of none, and of one that the library does not hold."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import logsumexp

from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import NOTHING, WRONG, Hypothesis
from beamdesign.gap.fitting.search import Search

EFFECT_ODDS, FIGURE_ODDS = log(0.05), log(0.05)
"""Prior odds of one more effect, and of one more plainly wrong figure, against none."""
LAW_ODDS = log(0.33)
"""Prior odds of another law for an effect than the usual one."""
_NOT_EXPLAINED = 0.15  # share of the excess misfit: a right cause, differently realised, leaves less
_MUCH = 2.5  # times the misfit of noise alone: what rigs leave that have a little of everything
_STEEP = 4.0
_NEARLY = 1.5  # in the logarithm of the probability: what is chosen among on held-out conditions
STRAINED = 4.0
"""Tolerances by which no figure is off in a rig whose gap has been understood."""
_SLIGHT = 1.0  # of the misfit of noise alone
_FAINT = 0.75  # of the mean square of the sensor's noise
_MINOR = 0.03  # of the gap
_PART = 0.3
_PLAIN = 8.0  # in cost: about three tolerances
_AS_MUCH = 0.8  # of what a plainly wrong figure gains


@dataclass(frozen=True)
class Judgement:
    """Probabilities.

    Attributes:
        of: each hypothesis, the null among them; with that of the unknown they add up to one.
        unknown: that something outside the library is behind the gap.
        best: of the most probable fits, that which predicts conditions held out best (the null's without a gap).
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

    Where two figures under one tolerance have been set free (both beams' stiffness), both may be wrong, or either one
    with the other within its tolerance: the mean of the three.

    Args:
        found: a fit; its prior is the standard normal distribution of z.
        spread: how much larger misfit is than its units say, for the best of all fits (overdispersion).
    """
    if found.reason:
        return -np.inf
    free = [k for k, unknown in enumerate(found.unknowns) if unknown.kind == "free"]
    held = [k for k in free if found.unknowns[k].tolerance > 0] if len(free) > 1 else []
    ways = [_laplace(found, spread, np.ones(len(found.z)))]
    for k in held:
        precision = np.ones(len(found.z))
        precision[k] = (found.unknowns[k].spread / found.unknowns[k].tolerance) ** 2
        ways.append(_laplace(found, spread, precision))
    return float(logsumexp(ways)) - log(len(ways))


def _laplace(found: Fit, spread: float, precision: np.ndarray, kept: Iterable[int] | None = None) -> float:
    """About the optimum under other priors than those of the fit, or for less evidence, as its own quadratic has it."""
    shares = found.shares if kept is None else [found.shares[k] for k in kept]
    a = sum((s.a for s in shares), np.zeros(2 * found.z.shape)) / spread + np.diag(precision)
    slope = sum((s.g for s in shares), np.zeros_like(found.z)) / spread + precision * found.z
    misfit = sum(s.c for s in shares) / spread + float(precision @ found.z**2)
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(slope))):
        return -np.inf
    # No curvature is less than that of the priors; that of a motion hard to repeat may swamp it in rounding.
    values, vectors = np.linalg.eigh(a)
    values = np.maximum(values, precision.min())
    curved = float(np.sum((vectors.T @ slope) ** 2 / values))
    return -0.5 * (misfit - curved + float(np.sum(np.log(values))) - float(np.sum(np.log(precision))))


def _nested(fits: Sequence[Fit], spread: float) -> dict[Hypothesis, float]:
    """Evidence of every fit, no more than a simpler one's with what the larger one improves.

    More unknowns cannot leave more room about the optimum. Where curvatures say so, the laws have kinks that Laplace's
    method takes for sharpness, at the one optimum and not at the other.
    """
    found: dict[Hypothesis, float] = {}
    for fit in sorted(fits, key=lambda f: len(f.hypothesis.names)):
        own = evidence(fit, spread)
        for simpler in fits:
            if set(simpler.hypothesis.names) < set(fit.hypothesis.names):
                improved = (simpler.misfit - fit.misfit) / spread + float(simpler.z @ simpler.z - fit.z @ fit.z)
                own = min(own, found[simpler.hypothesis] + max(0.0, improved) / 2)
        found[fit.hypothesis] = own
    return found


def _chosen(fits: Sequence[Fit], logs: np.ndarray, conditions: Sequence[object], spread: float) -> int:
    """Of the most probable fit and those with as many causes that are nearly as probable, the best on held-out ones.

    Conditions held out say nothing of how far a figure is off its tolerance, so that fewer causes are no rival here.
    """
    first = int(np.argmax(logs))
    count = len(fits[first].hypothesis.causes)
    near = [k for k, f in enumerate(fits) if logs[k] > logs[first] - _NEARLY and len(f.hypothesis.causes) == count]
    return max(near, key=lambda k: held_out_score(fits[k], conditions, spread) + odds(fits[k].hypothesis))


def held_out_score(found: Fit, conditions: Sequence[object], spread: float) -> float:
    """Sum of the logarithms of the predictive densities of each condition, with a fit to all others.

    Fits without a condition are those of the quadratic that stands for the fit to all of them. Constants that all
    hypotheses share are left out.

    Args:
        found: a fit to all conditions.
        conditions: of each piece of evidence; pieces of one condition are held out together.
        spread: see `evidence`.
    """
    kept = range(len(found.shares))
    whole = _laplace(found, spread, np.ones(len(found.z)), kept)
    if not np.isfinite(whole):
        return -np.inf
    groups = [[k for k in kept if conditions[k] == condition] for condition in dict.fromkeys(conditions)]
    without = [[k for k in kept if k not in group] for group in groups]
    return sum(whole - _laplace(found, spread, np.ones(len(found.z)), rest) for rest in without)


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
    by_hypothesis = {f.hypothesis: f for f in fits}
    plausible = _nested(fits, spread)
    plain = _plain(fits, plausible)
    logs = np.array(
        [plausible[f.hypothesis] + odds(f.hypothesis) - _slight(f, by_hypothesis, found, spread, plain) for f in fits]
    )
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    best = fits[_chosen(fits, logs, found.conditions, spread)]
    # Where all that helps is slight, what it leaves tells whether there is more than a little of everything.
    unknown = _unknown(found, best if best.hypothesis != NOTHING else min(fits, key=lambda f: f.misfit))
    return Judgement(
        {f.hypothesis: float(w) * (1 - unknown) for f, w in zip(fits, weights, strict=True)}, unknown, best
    )


def _plain(fits: Sequence[Fit], plausible: Mapping[Hypothesis, float]) -> float:
    """The most that a wrong figure gains which by itself is more probable than none."""
    least, null = plausible[NOTHING], next(f.cost for f in fits if f.hypothesis == NOTHING)
    figures = [f for f in fits if len(f.hypothesis.names) == 1 and not f.hypothesis.effects]
    gains = [null - f.cost for f in figures if plausible[f.hypothesis] + odds(f.hypothesis) > least]
    return max(gains, default=0.0)


def _slight(found: Fit, fits: Mapping[Hypothesis, Fit], of: Search, spread: float, figure: float) -> float:
    """What is taken off the evidence for causes that explain no more than a rig's many small imperfections may.

    Every real rig has a little of everything, so that one more cause always improves a fit. What a cause improves
    counts by what its removal brings back, see `_size`; that of all of them by what they bring together, as two that
    work against each other may both look large. A wrong figure alone is told by how far off its tolerance it is, so
    that what comes back need only be `_PLAIN`; and where a figure is plainly wrong, whatever explains about as much as
    that `figure` gains is not slight either.
    """

    def cost(without: Hypothesis) -> float:
        rest = fits.get(without)
        if rest is None or (gained := rest.cost - found.cost) <= 0:
            return 0.0
        plain = without == NOTHING and (not found.hypothesis.effects or 0 < _AS_MUCH * figure <= gained)
        size = gained / _PLAIN if plain else _size(found, rest, of)
        return gained / (2 * spread) / (1 + size ** (2 * _STEEP))

    each = sum(cost(found.hypothesis.without(name)) for name in found.hypothesis.causes)
    return max(each, cost(NOTHING))


def _size(found: Fit, rest: Fit, of: Search) -> float:
    """How large the cause is that one fit has and another lacks; from 1 it is more than a small imperfection.

    It is large if its removal brings back as much misfit as noise alone leaves, which counts every frequency alike, or
    moves the displacement by about the noise of its sensor, which counts the largest motion. In the same measure it is
    no less than `_MINOR` of the gap and `_PART` of what is left without it: what the dominant cause leaves because it
    is another realisation is no second one.
    """
    misfit = (rest.cost - found.cost) / max(
        _SLIGHT * of.expected, _MINOR * (of.null.cost - of.expected), _PART * (rest.cost - of.expected)
    )
    moved = rest.error - found.error
    if of.floor <= 0:
        return misfit
    if moved < -of.floor:  # it improves what hardly moves, and spoils what does
        return 0.0
    least = max(_FAINT * of.floor, _MINOR * (of.null.error - of.floor), _PART * (rest.error - of.floor))
    return max(misfit, moved / least)


def _unknown(found: Search, best: Fit) -> float:
    """Probability of an unknown cause: the best known one leaves much in units of misfit, and much of the gap."""
    much = 1 / (1 + (_MUCH * found.expected / best.misfit) ** _STEEP)
    left = max(found.excess(best), 1e-6)
    return much / (1 + (_NOT_EXPLAINED / left) ** _STEEP)
