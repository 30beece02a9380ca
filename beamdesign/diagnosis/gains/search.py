"""All hypotheses about a few critical gains and frequency responses, fitted: nulls, single causes, pairs."""

from collections.abc import Sequence

import numpy as np

from beamdesign.diagnosis import judgement
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, singles
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.fitting.starts import fit_from_starts
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype

Figure = GainEvidence | ResponseEvidence
"""What is not a time record."""
_SINGLES = 0.3  # of the work
_QUICK = 3  # iterations, which show whether a pair is worth settling
_BEST = 5  # single causes that pairs are made with
_EXPLAINED = 1.5  # times the misfit of noise: what a single cause leaves at most where it explains the figures
_HOPEFUL = 4.0  # in the logarithm of the probability


def figures_of(data: Dataset) -> tuple[Figure, ...]:
    """Critical gains and frequency responses of a data set."""
    responses = tuple(ResponseEvidence(taken, data.prototype) for taken in data.responses)
    return (*(GainEvidence(taken, data.prototype) for taken in data.gains), *responses)


def search_few(
    evidence: Sequence[Figure],
    prototype: Prototype,
    progress: Progress = silent,
    among: Sequence[str] = (),
) -> tuple[Search, tuple[str, ...]]:
    """Fit tolerances alone, every cause, and pairs of which one is an effect.

    Pairs are tried though a single cause may suffice: with few figures they decide how sure it can be. They are those
    with one of the most probable single causes, or all where none of these explains the figures. Pairs far from the
    most probable are left where a few iterations have brought them. Two plainly wrong figures at once are not tried.

    Args:
        evidence: what is to be explained.
        prototype: that was believed.
        progress: told the share done and what is being done.
        among: names of the causes that come into question; all where empty.

    Returns:
        the fits, and the effects that do not show in such data at all; these are in no pair.
    """
    progress(0.0, "tolerances")
    null = fit_from_starts(NOTHING, prototype, evidence, {}, most=1)
    expected = sum(piece.expected for piece in evidence)
    names = tuple(e.name for e in evidence)
    if null.reason:
        return Search(null, (), expected, names), ()
    alone = {}
    own = [h for h in singles(prototype) if h.names == h.causes]  # gains tell no two laws of one effect apart
    listed = [h for h in own if not among or h.names[0] in among]
    for k, hypothesis in enumerate(listed):
        alone[hypothesis] = fit_from_starts(hypothesis, prototype, evidence, null.values)
        progress(_SINGLES * (k + 1) / len(listed), "single causes")
    silent = tuple(h.names[0] for h, found in alone.items() if h.effects and not found.reason and not _shows(found))
    visible = [h for h in listed if h.names[0] not in silent]
    best = sorted((h for h in visible if not alone[h].reason), key=lambda h: -log_posterior(alone[h]))[:_BEST]
    if best and alone[best[0]].misfit > _EXPLAINED * expected:
        best = visible
    pairs = [
        a | b
        for k, a in enumerate(visible)
        for b in visible[k + 1 :]
        if (a.effects or b.effects) and (a in best or b in best)
    ]
    quick = []
    for k, hypothesis in enumerate(pairs):
        known: dict[str, float] = dict(null.values)
        for name in hypothesis.names:
            if not (single := alone[Hypothesis((name,))]).reason:
                known |= single.values
        quick.append(fit_from_starts(hypothesis, prototype, evidence, known, most=1, iterations=_QUICK))
        progress(_SINGLES + (1 - _SINGLES) * (k + 1) / len(pairs), "pairs")
    found = [*alone.values(), *quick]
    leading = max(log_posterior(f) for f in (null, *found))
    for k, hopeful in enumerate(found):
        if len(hopeful.hypothesis.names) == 2 and log_posterior(hopeful) > leading - _HOPEFUL:
            found[k] = fit_from_starts(hopeful.hypothesis, prototype, evidence, hopeful.values, most=1)
    return Search(null, tuple(sorted(found, key=lambda f: f.cost)), expected, names), silent


def log_posterior(found: Fit, spread: float = 1.0) -> float:
    """Logarithm of a fit's probability, up to a constant: Laplace's marginal likelihood and the odds of its causes.

    Args:
        found: the fit.
        spread: how much larger the best misfit is than the measurements' errors explain; 1 where these are right.
    """
    return judgement.evidence(found, spread) + judgement.odds(found.hypothesis)


def _shows(found: Fit) -> bool:
    """Whether some parameter of the effect has a part in what was measured."""
    own = [k for k, u in enumerate(found.unknowns) if u.kind == "effect"]
    return bool(np.any(np.abs(np.array([share.a for share in found.shares])[:, own]) > 0))
