"""From fits to a verdict: probabilities of causes, of none, and of one that the library does not hold; then causes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import log, nan, sqrt

import numpy as np
from scipy.special import logsumexp, softmax

from beamdesign.diagnosis.diagnosis import Cause, CauseSet, Estimate
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, WRONG, Hypothesis, subsystem
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.parameters import RIG_TOLERANCES


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
    ways = [_laplace(found, spread, np.ones(len(found.z)))]
    for k in (k for k in free if found.unknowns[k].tolerance > 0 and len(free) > 1):
        precision = np.ones(len(found.z))
        precision[k] = (found.unknowns[k].spread / found.unknowns[k].tolerance) ** 2
        ways.append(_laplace(found, spread, precision))
    return float(logsumexp(ways)) - log(len(ways))


def _laplace(found: Fit, spread: float, precision: np.ndarray, kept: Iterable[int] | None = None) -> float:
    """About the optimum under other priors than those of the fit, or for less evidence, as its own quadratic has it.

    For all of it the fit is where its own cost is least: a slope that it has left is that of a bound, or of a fit that
    was broken off, and promises nothing.
    """
    shares = found.shares if kept is None else [found.shares[k] for k in kept]
    a = sum((s.a for s in shares), np.zeros(2 * found.z.shape)) / spread + np.diag(precision)
    g = -found.z if kept is None else sum((s.g for s in shares), np.zeros_like(found.z))
    slope = g / spread + precision * found.z
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

    It has to be better there than it is less probable: where they tell nothing apart, the most probable stays. They say
    nothing of how far a figure is off its tolerance, so that fewer causes are no rival here.
    """
    first = int(np.argmax(logs))
    count = len(fits[first].hypothesis.causes)
    close = logs > logs[first] - THRESHOLDS.nearly
    near = [k for k, fit in enumerate(fits) if close[k] and len(fit.hypothesis.causes) == count]
    return max(near, key=lambda k: held_out_score(fits[k], conditions, spread) + logs[k])


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
    without = [[k for k in kept if k not in group] for group in pieces_of(conditions)]
    return sum(whole - _laplace(found, spread, np.ones(len(found.z)), rest) for rest in without)


def pieces_of(conditions: Sequence[object]) -> list[list[int]]:
    """Positions of the pieces of evidence of each condition."""
    return [[k for k, own in enumerate(conditions) if own == condition] for condition in dict.fromkeys(conditions)]


def odds(hypothesis: Hypothesis) -> float:
    """Logarithm of the prior odds against no cause at all."""
    laws = sum(1 for name in hypothesis.names if name not in hypothesis.causes)
    figures = sum(1 for name in hypothesis.names if name.startswith(WRONG))
    effects = len(hypothesis.names) - figures
    return effects * THRESHOLDS.effect_odds + figures * THRESHOLDS.figure_odds + laws * THRESHOLDS.law_odds


def judge(found: Search, few: bool = False) -> Judgement:
    """Weigh all fits of a search.

    Args:
        found: the fits.
        few: whether these are of the linear loop alone, which has no laws with kinks, and to too few figures to tell
            that a cause is slight.
    """
    fits: Sequence[Fit] = [f for f in (found.null, *found.fits) if not f.reason]
    spread, by_hypothesis = found.spread, {f.hypothesis: f for f in fits}
    plausible = {f.hypothesis: evidence(f, spread) for f in fits} if few else _nested(fits, spread)
    plain = _plain(fits, plausible)
    slight = [0.0 if few else _slight(f, by_hypothesis, found, spread, plain) for f in fits]
    logs = np.array([plausible[f.hypothesis] + odds(f.hypothesis) - less for f, less in zip(fits, slight, strict=True)])
    best = fits[_chosen(fits, logs, found.conditions, spread)]
    # Where all that helps is slight, what it leaves tells whether there is more than a little of everything.
    unknown = _unknown(found, best if best.hypothesis != NOTHING else min(fits, key=lambda f: f.misfit))
    weights = (1 - unknown) * softmax(logs)
    return Judgement({f.hypothesis: float(w) for f, w in zip(fits, weights, strict=True)}, unknown, best)


def _plain(fits: Sequence[Fit], plausible: Mapping[Hypothesis, float]) -> tuple[float, float]:
    """What a wrong figure gains most which by itself is more probable than none, and what it eases the others."""
    least, null = plausible[NOTHING], next(f for f in fits if f.hypothesis == NOTHING)
    figures = [f for f in fits if len(f.hypothesis.names) == 1 and not f.hypothesis.effects]
    wrong = [f for f in figures if plausible[f.hypothesis] + odds(f.hypothesis) > least]
    return max(((null.cost - f.cost, null.strain - f.strain) for f in wrong), default=(0.0, 0.0))


def _slight(found: Fit, fits: Mapping[Hypothesis, Fit], of: Search, spread: float, wrong: tuple[float, float]) -> float:
    """What is taken off the evidence for causes that explain no more than a rig's many small imperfections may.

    Every real rig has a little of everything, so that one more cause always improves a fit. What a cause improves
    counts by what its removal brings back, see `_size`; that of all of them by what they bring together, as two that
    work against each other may both look large. A wrong figure alone is told by how far off its tolerance it is, so
    that what comes back need only be `Thresholds.plain`; and where a figure is plainly `wrong`, whatever gains about as
    much and eases the others as much as it does is not slight either; what leaves them strained explains something
    else. Beside another cause it is an effect that eases a figure further off than in any rig, for what the laws leave.
    """

    def cost(without: Hypothesis) -> float:
        by_any_law = (f for other, f in fits.items() if other.causes == without.causes)
        rest = fits.get(without) or min(by_any_law, key=lambda f: f.cost, default=None)
        if rest is None or (gained := rest.cost - found.cost) <= 0:
            return 0.0
        alone, eased = without == NOTHING, rest.strain - found.strain
        effect = found.hypothesis.effects != without.effects
        furthest = max(map(abs, rest.moved.values()), default=0.0)
        off = furthest**2 * (effect and furthest > THRESHOLDS.strained * sqrt(spread))
        gain, ease = (THRESHOLDS.as_much * part for part in (wrong if alone else (off, off)))
        plain = (0 < gain <= gained and ease <= eased) or (alone and not found.hypothesis.effects)
        size = gained / THRESHOLDS.plain if plain else _size(found, rest, of)
        return gained / (2 * spread) / (1 + size ** (2 * THRESHOLDS.steep))

    each = sum(cost(found.hypothesis.without(name)) for name in found.hypothesis.causes)
    return max(each, cost(NOTHING))


def _size(found: Fit, rest: Fit, of: Search) -> float:
    """How large the cause is that one fit has and another lacks; from 1 it is more than a small imperfection.

    It is large if its removal brings back as much misfit as noise alone leaves, which counts every frequency alike, or
    moves the displacement by about the noise of its sensor, which counts the largest motion. In the same measure it is
    no less than `Thresholds.minor` of the gap and `Thresholds.part` of what is left without it: what the dominant cause
    leaves because it is another realisation is no second one. Nor is it explained by one so well that the displacement
    is off by no more than its noise: that is a cause however large the gap is.
    """

    def least(share: float, noise: float, minor: float, left: float) -> float:
        return max(share * noise, minor, THRESHOLDS.part * (left - noise))

    minor = THRESHOLDS.minor * (of.null.cost - of.expected)
    misfit = (rest.cost - found.cost) / least(THRESHOLDS.slight, of.expected, minor, rest.cost)
    moved = rest.error - found.error
    if of.floor <= 0:
        return misfit
    if moved < -of.floor:  # it improves what hardly moves, and spoils what does
        return 0.0
    beyond = max(found.error - of.floor, 0.0)
    minor = min(THRESHOLDS.minor * (of.null.error - of.floor), THRESHOLDS.all_but * beyond)
    return max(misfit, moved / least(THRESHOLDS.faint, of.floor, minor, rest.error))


def _unknown(found: Search, best: Fit) -> float:
    """Probability of an unknown cause: the best known one leaves much in units of misfit, and much of the gap."""
    left = max(found.excess(best), 1e-6)
    return unknown_by(best.misfit, found.expected) / (1 + (THRESHOLDS.not_explained / left) ** THRESHOLDS.steep)


def unknown_by(misfit: float, noise: float) -> float:
    """Probability that something unknown leaves a misfit, by how much more that is than noise leaves."""
    misfit = max(misfit, 1e-9 * noise)  # a figure that was copied from the model is off by nothing
    return 1 / (1 + (THRESHOLDS.much * noise / misfit) ** THRESHOLDS.steep)


LEAST_PROBABILITY = 0.01
SUSPICIOUS = 2.0
"""Tolerances by which a figure may be off before it is told."""


def causes(found: Search, judged: Judgement) -> tuple[Cause, ...]:
    """All causes that are not out of the question, most probable first; of the best fit in the order of their shares.

    The parameters of a cause are those of the most probable fit that holds it.
    """
    fits = {f.hypothesis: f for f in (found.null, *found.fits) if not f.reason}
    listed, responsible = [], judged.best.hypothesis.causes
    for name in {name for h in judged.of for name in h.causes}:
        probability = judged.cause(name)
        if probability < LEAST_PROBABILITY and name not in responsible:
            continue
        holder = fits[max((h for h in judged.of if name in h.causes), key=lambda h: judged.of[h])]
        figures, strains = parameters(name, holder, deviations(holder, found)), tuple(flags(name, holder))
        place = subsystem(holder.hypothesis.realisation(name))
        listed.append(Cause(name, place, probability, share_of(name, holder, found, fits), figures, strains))
    others = {c.name: c.name not in responsible for c in listed}
    return tuple(sorted(listed, key=lambda c: (others[c.name], 0 if others[c.name] else -c.share, -c.probability)))


def cause_sets(found: Search, judged: Judgement) -> tuple[CauseSet, ...]:
    """All sets of causes, most probable first; of what is left where tolerances leave no more than noise, no share."""
    sets, left = judged.of_causes.items(), found.null.misfit > found.expected
    return tuple(CauseSet(names, p, found.excess(found.best_of(names)) if left else nan) for names, p in sets)


def share_of(name: str, holder: Fit, found: Search, fits: dict[Hypothesis, Fit]) -> float:
    """Part of the explainable misfit that comes back when one cause is taken away; 0 where tolerances leave none."""
    rest = {*holder.hypothesis.without(name).names}  # some of these, where the others mean nothing by themselves
    left = min((found.excess(f) for f in fits.values() if {*f.hypothesis.names} <= rest), default=1.0)
    return float(min(1.0, max(0.0, min(left, 1.0) - found.excess(holder)))) * (found.null.misfit > found.expected)


def deviations(found: Fit, of: Search) -> dict[str, float]:
    """Standard errors of all unknowns, SI, of a law that is not quite the rig's.

    Variances are those of the fit times the misfit that is left over that of noise (overdispersion; P. McCullagh and
    J. A. Nelder, Generalized Linear Models, 1989, section 4.5), and of fits without each condition in turn, by the
    quadratic that stands for the fit to all of them (the jackknife; B. Efron and C. Stein, Ann. Statist. 9 (1981) 586):
    a wrong law is tuned to one amplitude otherwise than to another.
    """
    variance = np.diag(found.covariance) * max(1.0, found.misfit / max(of.expected, 1e-300))
    if found.shares and len(groups := pieces_of(of.conditions)) > 1:
        a, g = (np.array([sum(getattr(found.shares[k], part) for k in group) for group in groups]) for part in "ag")
        curvature, slope = np.eye(len(found.z)) + a.sum(0), found.z + g.sum(0)
        moved = np.array([np.linalg.solve(curvature - ai, gi - slope) for ai, gi in zip(a, g, strict=True)])
        variance = variance + (len(groups) - 1) * np.var(moved, axis=0)
    pairs = zip(found.unknowns, found.z, np.sqrt(variance), strict=True)
    return {u.name: abs(u.slope(z)) * float(std) for u, z, std in pairs}


def parameters(name: str, holder: Fit, errors: Mapping[str, float]) -> dict[str, Estimate]:
    """Of an effect, or the figures of a wrong one, with their standard errors; SI."""
    if name.startswith(WRONG):
        key = name.removeprefix(WRONG)
        keys = [figure for figure, tolerance in RIG_TOLERANCES.items() if tolerance == key] or [key]
        return {key: Estimate(holder.values[key], errors[key]) for key in keys if key in holder.values}
    prefix = holder.hypothesis.realisation(name) + "."
    own = {key: value for key, value in holder.values.items() if key.startswith(prefix)}
    return {key.removeprefix(prefix): Estimate(value, errors[key]) for key, value in own.items()}


def flags(name: str, holder: Fit) -> list[str]:
    """Parameters at a bound, and tolerated figures that had to move far to make it fit."""
    said = []
    prefix = holder.hypothesis.realisation(name) + "."
    for unknown, z in zip(holder.unknowns, holder.z, strict=True):
        low, high = unknown.bounds
        if unknown.kind == "effect" and unknown.name.startswith(prefix):
            # A parameter that may be none, and is, is no bound reached: zero, or a ratio of 1 that is the usual one.
            at_low = z <= low + 1e-6 and unknown.low not in (0.0, unknown.nominal)
            if at_low or z >= high - 1e-6:
                said.append(f"{unknown.name} is at its bound, {unknown.value(z):.4g}")
        if unknown.kind == "figure" and abs(z) > SUSPICIOUS:
            said.append(f"{unknown.name} had to move by {z:+.1f} tolerances")
    return said
