"""Three simple ways to name a cause, scored on the same data as the diagnosis, to see what that is worth.

Largest score statistic (C. R. Rao, Large sample tests of statistical hypotheses, 1948): the fall of the misfit that
one more severity would bring, linearised where nothing but tolerances is at work. Greedy BIC (G. Schwarz, Estimating
the dimension of a model, 1978): forward selection by a white-noise likelihood of fitted models. Sparse regression
(R. Tibshirani, Regression shrinkage and selection via the lasso, 1996): the residual of the tuned model as a sparse sum
of what weak effects would change.

They see the records that the fits of the diagnosis have seen, and take the null fit from it; greedy BIC takes all its
fitted models from there, since fits of its own would be the same fits. None of the three gives a probability.
"""

from collections.abc import Sequence
from math import log
from typing import Any

import numpy as np
from scipy.stats import chi2

from beamdesign.gap.blind.dictionary import Dictionary, dictionary
from beamdesign.gap.blind.lasso import lasso_path
from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.fitting.evidence import RecordEvidence, record_evidence
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.search import Search
from beamdesign.gap.fitting.weighting import INDEPENDENT

NAMES = ("largest score", "greedy BIC", "sparse regression")
_LEVEL = 0.01  # of the test that something is there at all, shared by all causes (Bonferroni)
_MOST = 2  # causes that greedy BIC may name: the search fits no three together
_WORTH = 0.1  # of what a sparse sum explains: terms below it are not named


def baselines(data: Dataset, found: Search) -> dict[str, dict[str, Any]]:
    """What each would name.

    Args:
        data: the records.
        found: those fits.

    Returns:
        by name of the way: `chosen`, causes in order, none where it finds no gap.
    """
    evidence = record_evidence(data)
    terms = dictionary(data.prototype, evidence, found.null)
    return {
        NAMES[0]: {"chosen": largest_score(terms)},
        NAMES[1]: {"chosen": greedy_bic(evidence, data, found)},
        NAMES[2]: {"chosen": sparse_sum(terms, INDEPENDENT * sum(len(e.weight.channels) for e in evidence))},
    }


def largest_score(terms: Dictionary) -> list[str]:
    """The cause with the largest score statistic, where that is significant."""
    if not terms.names:
        return []
    statistics = terms.slope**2 / np.diag(terms.gram)
    best = int(np.argmax(statistics))
    tests = len(set(terms.names))
    return [terms.names[best]] if statistics[best] > chi2.isf(_LEVEL / tests, 1) else []


def greedy_bic(evidence: Sequence[RecordEvidence], data: Dataset, found: Search) -> list[str]:
    """Forward selection among the fitted hypotheses while the criterion falls."""
    models = {fit.hypothesis: fit for fit in (found.null, *found.fits) if not fit.reason}
    chosen, value = found.null, _criterion(found.null, evidence, data)
    for _ in range(_MOST):
        size = len(chosen.hypothesis.names) + 1
        larger = [
            fit
            for hypothesis, fit in models.items()
            if len(hypothesis.names) == size and set(hypothesis.names) > set(chosen.hypothesis.names)
        ]
        values = [_criterion(fit, evidence, data) for fit in larger]
        if not values or min(values) >= value:
            break
        chosen, value = larger[int(np.argmin(values))], min(values)
    if len(chosen.hypothesis.names) < 2:
        return list(chosen.hypothesis.causes)
    singles = sorted((fit for fit in found.fits if len(fit.hypothesis.names) == 1), key=lambda fit: -fit.cost)
    alone = {fit.hypothesis.causes[0]: fit.cost for fit in singles}
    return sorted(chosen.hypothesis.causes, key=lambda name: alone.get(name, np.inf))


def _criterion(fit: Fit, evidence: Sequence[RecordEvidence], data: Dataset) -> float:
    """The sum of n log(SSE / n) of each channel, all samples alike, and k log n."""
    placement = fit.hypothesis.placement(data.prototype)
    squares: dict[str, list[np.ndarray]] = {}
    for piece in evidence:
        predicted = piece.predicted(placement, fit.z)
        if predicted is None:
            return np.inf
        for k, name in enumerate(piece.weight.channels):
            squares.setdefault(name, []).append((piece.measured[:, k] - predicted[:, k]) ** 2)
    totals = [(sum(map(len, parts)), sum(float(p.sum()) for p in parts)) for parts in squares.values()]
    samples = sum(count for count, _ in totals)
    free = sum(unknown.kind != "figure" for unknown in fit.unknowns)
    return sum(count * log(max(sse, 1e-300) / count) for count, sse in totals) + free * log(samples)


def sparse_sum(terms: Dictionary, units: float) -> list[str]:
    """Causes in the sparse sum that BIC prefers along the path of the lasso, what explains most first.

    Args:
        terms: of the sum.
        units: independent units of misfit in the data.
    """
    scale = np.sqrt(np.diag(terms.gram))
    gram, slope = terms.gram / np.outer(scale, scale), terms.slope / scale
    best: tuple[float, list[int]] = (0.0, [])
    for active in lasso_path(gram, slope):
        gain = float(slope[active] @ np.linalg.lstsq(gram[np.ix_(active, active)], slope[active], rcond=1e-9)[0])
        value = len(active) * log(units) - gain
        if value < best[0]:
            best = (value, active)
    if not best[1]:
        return []
    weights = np.linalg.lstsq(gram[np.ix_(best[1], best[1])], slope[best[1]], rcond=1e-9)[0]
    explained = weights * slope[best[1]]
    order = np.argsort(-explained)
    kept = [best[1][k] for k in order if explained[k] > _WORTH * explained.sum()]
    return list(dict.fromkeys(terms.names[k] for k in kept))
