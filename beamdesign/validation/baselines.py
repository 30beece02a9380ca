"""Three simple ways to name a cause, scored on the same data as the diagnosis, to see what that is worth.

Largest score statistic (C. R. Rao, Large sample tests of statistical hypotheses, 1948): the fall of the misfit that
one more severity would bring, linearised where nothing but tolerances is at work. Greedy BIC (G. Schwarz, Estimating
the dimension of a model, 1978): forward selection by a white-noise likelihood of fitted models. Sparse regression
(R. Tibshirani, Regression shrinkage and selection via the lasso, 1996): the residual of the tuned model as a sparse sum
of what weak effects would change.

They see the records that the fits of the diagnosis have seen, without those left out and with single spoilt samples
bridged, and take the null fit from it; greedy BIC takes all its fitted models from there, since fits of its own would
be the same fits. None of the three gives a probability.

The sparse regression looks linearly at the residual, by columns that say what each cause would change if there were a
little of it, and finds its sum by coordinate descent on a Gram matrix.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import log
from typing import Any

import numpy as np
from scipy.stats import chi2

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, linearised
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, WRONG, Hypothesis, Unknown
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.fitting.weighting import INDEPENDENT
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.plant.assembly import suits
from beamdesign.plant.effects import causes, library
from beamdesign.prototype import Prototype

_SHRINK = 0.8  # from one penalty to the next
_LEAST = 1e-3  # of the largest that leaves anything
_SWEEPS = 500
_SETTLED = 1e-9


def lasso(gram: np.ndarray, slope: np.ndarray, penalty: float, start: np.ndarray | None = None) -> np.ndarray:
    """Minimise w'Gw/2 - b'w + penalty |w|_1.

    Coordinate descent with soft thresholds (J. Friedman, T. Hastie, R. Tibshirani, Regularization paths for generalized
    linear models via coordinate descent, J. Stat. Software 33, 2010).

    Args:
        gram: (K, K) G, positive semidefinite with a positive diagonal.
        slope: (K,) b.
        penalty: not negative.
        start: (K,) where to begin.
    """
    w = np.zeros(len(slope)) if start is None else start.copy()
    left = slope - gram @ w
    for _ in range(_SWEEPS):
        most = 0.0
        for k in range(len(w)):
            raw = left[k] + gram[k, k] * w[k]
            new = np.sign(raw) * max(abs(raw) - penalty, 0.0) / gram[k, k]
            move = new - w[k]
            if move:
                left -= gram[:, k] * move
                w[k] = new
                most = max(most, abs(move))
        if most <= _SETTLED * max(1.0, float(np.abs(w).max(initial=0.0))):
            break
    return w


def lasso_path(gram: np.ndarray, slope: np.ndarray) -> Iterator[list[int]]:
    """Sets of terms that come in as the penalty falls, each once."""
    w, before = np.zeros(len(slope)), list[int]()
    penalty = largest = float(np.abs(slope).max(initial=0.0))
    while penalty > _LEAST * largest:
        penalty *= _SHRINK
        w = lasso(gram, slope, penalty, w)
        active = [int(k) for k in np.nonzero(w)[0]]
        if active and active != before:
            before = active
            yield active


_STRENGTH = {
    "carrier_ripple": ("depth", 1),
    "current_saturation": ("limit_A", -1),
    "motor_current_limit": ("limit_A", -1),
    "mount_compliance": ("stiffness_N_per_m", -1),
    "pressure_dependent_flow": ("supply_pressure_Pa", -1),
    "second_beam_mode": ("compliance_share", 1),
    "sensor_lag": ("break_Hz", -1),
}
"""The parameter by which an effect grows, and whether with it or against it. All others grow with their first one."""
_LADDER = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0)  # prior standard deviations from the default, weak first
_WEAK = 0.1  # of the default, for a parameter that may be none
_SEEN = 0.1  # unit of misfit: what changes less is not there


@dataclass(frozen=True)
class Dictionary:
    """Terms, each of one severity, with the tolerances free to make up for what they can.

    The misfit falls by slope^2 / gram of one term, and by b'G^-1 b of several.

    Attributes:
        names: (K,) cause that each term belongs to.
        gram: (K, K) G.
        slope: (K,) b.
    """

    names: tuple[str, ...]
    gram: np.ndarray = field(repr=False)
    slope: np.ndarray = field(repr=False)


def dictionary(prototype: Prototype, evidence: Sequence[RecordEvidence], null: Fit) -> Dictionary:
    """Linearise about the null fit.

    An effect's term is the change of the residual at the weakest of some severities at which it can be seen; its
    other parameters have their defaults. A wrong figure's term is the derivative by it.

    Args:
        prototype: that was believed.
        evidence: time records.
        null: fit of the tolerances alone.
    """
    placement = NOTHING.placement(prototype)
    if null.reason or (base := linearised(evidence, placement, null.z)) is None:
        return Dictionary((), np.zeros((0, 0)), np.zeros(0))
    residual, tolerances = (np.concatenate(parts) for parts in zip(*base, strict=True))
    usual = (name for name, effect in causes().items() if not effect.realises and suits(name, prototype))
    changes = ((name, _change(name, prototype, evidence, null, residual)) for name in usual)
    seen = {name: change for name, change in changes if change is not None}
    names = [*seen, *(WRONG + RIG_TOLERANCES[unknown.name] for unknown in null.unknowns)]
    d = np.column_stack([*seen.values(), *tolerances.T])
    # Tolerances follow a term as far as their priors let them; at the null fit itself they have nothing to gain.
    across = tolerances.T @ d
    curvature = np.eye(tolerances.shape[1]) + tolerances.T @ tolerances
    gram = d.T @ d - across.T @ np.linalg.solve(curvature, across)
    slope = -(d.T @ residual) + across.T @ np.linalg.solve(curvature, tolerances.T @ residual + null.z)
    good = np.diag(gram) > 1e-9 * np.diag(d.T @ d)
    return Dictionary(tuple(n for n, g in zip(names, good, strict=True) if g), gram[np.ix_(good, good)], slope[good])


def _change(
    name: str, prototype: Prototype, evidence: Sequence[RecordEvidence], null: Fit, residual: np.ndarray
) -> np.ndarray | None:
    """Of the residual, by a little of an effect; None where no severity of the ladder can be seen and is stable."""
    placement = Hypothesis((name,)).placement(prototype)
    known = null.values
    base = np.array([u.z(known[u.name]) if u.name in known else 0.0 for u in placement.unknowns])
    key, sign = _STRENGTH.get(name, (library()[name].parameters[0].name, 1))
    position = [u.name for u in placement.unknowns].index(f"{name}.{key}")
    last = None
    for step in _rungs(placement.unknowns[position], sign):
        z = base.copy()
        z[position] = step
        parts = [piece.residual(placement, z) for piece in evidence]
        if any(part is None for part in parts):
            return last
        change = np.concatenate([p for p in parts if p is not None]) - residual
        if not np.all(np.isfinite(change)):
            return last
        size = float(np.sqrt(change @ change))
        if size > _SEEN:
            return change / size
        last = change / size if size > 1e-6 else last
    return last


def _rungs(unknown: Unknown, sign: int) -> list[float]:
    """Severities as z, from weak to strong."""
    if unknown.linear:
        return [unknown.z(share * unknown.nominal) for share in (_WEAK, 0.3, 1.0, 3.0)]
    low, high = unknown.bounds
    return list(dict.fromkeys(float(np.clip(sign * step, low, high)) for step in _LADDER))


NAMES = ("largest score", "greedy BIC", "sparse regression")
_LEVEL = 0.01  # of the test that something is there at all, shared by all causes (Bonferroni)
_MOST = 2  # causes that greedy BIC may name: the search fits three together beside the best pair alone
_WORTH = 0.1  # of what a sparse sum explains: terms below it are not named


def baselines(data: Dataset, found: Search) -> dict[str, dict[str, Any]]:
    """What each would name.

    Args:
        data: the records, as read.
        found: those fits.

    Returns:
        by name of the way: `chosen`, causes in order, none where it finds no gap; empty without a sound record, as they
        look at nothing else.

    Raises:
        InputError: see `examine`.
    """
    data = examine(data).data
    if not data.records:
        return {}
    evidence = record_evidence(data)
    terms = dictionary(data.prototype, evidence, found.null)
    units = INDEPENDENT * sum(len(e.weight.channels) for e in evidence)
    named = largest_score(terms), greedy_bic(evidence, data, found), sparse_sum(terms, units)
    return {name: {"chosen": chosen} for name, chosen in zip(NAMES, named, strict=True)}


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
    models = [fit for fit in (found.null, *found.fits) if not fit.reason]
    chosen, value = found.null, _criterion(found.null, evidence, data)
    for _ in range(_MOST):
        own = {*chosen.hypothesis.names}
        larger = [fit for fit in models if len({*fit.hypothesis.names} - own) == 1 and {*fit.hypothesis.names} > own]
        least, best = min(((_criterion(fit, evidence, data), k) for k, fit in enumerate(larger)), default=(np.inf, 0))
        if least >= value:
            break
        chosen, value = larger[best], least
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
        if (predicted := piece.predicted(placement, fit.z)) is None:
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
    least, chosen, explained = 0.0, list[int](), np.zeros(0)
    for active in lasso_path(gram, slope):
        weights = np.linalg.lstsq(gram[np.ix_(active, active)], slope[active], rcond=1e-9)[0]
        value = len(active) * log(units) - float(slope[active] @ weights)
        if value < least:
            least, chosen, explained = value, active, weights * slope[active]
    kept = (chosen[k] for k in np.argsort(-explained) if explained[k] > _WORTH * explained.sum())
    return list(dict.fromkeys(terms.names[k] for k in kept))
