"""All hypotheses about a few critical gains and frequency responses, fitted: nulls, single causes, pairs."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from beamdesign.gap.fit import Evidence, Fit, fit
from beamdesign.gap.hypothesis import NOTHING, Hypothesis, singles
from beamdesign.gap.search import Search
from beamdesign.gap.starts import starts
from beamdesign.prototype import Prototype

Progress = Callable[[float, str], None]
_SINGLES = 0.3  # of the work


def search_few(
    evidence: Sequence[Evidence], prototype: Prototype, progress: Progress = lambda share, words: None
) -> tuple[Search, tuple[str, ...]]:
    """Fit tolerances alone, every cause, and every pair of which one is an effect.

    Unlike for time records nothing is skipped for having no need of a second cause: with few figures the pairs decide
    how sure a single cause can be. Two plainly wrong figures at once are not tried.

    Returns:
        the fits, and the effects that do not show in such data at all; these are in no pair.
    """
    progress(0.0, "tolerances")
    null = _fitted(NOTHING, {}, evidence, prototype, 1)
    alone = {}
    listed = singles(prototype)
    for k, hypothesis in enumerate(listed):
        alone[hypothesis] = _fitted(hypothesis, null.values, evidence, prototype, 2)
        progress(_SINGLES * (k + 1) / len(listed), "single causes")
    silent = tuple(h.names[0] for h, found in alone.items() if h.effects and not found.reason and not _shows(found))
    heard = [h for h in listed if h.names[0] not in silent]
    pairs = [a | b for k, a in enumerate(heard) for b in heard[k + 1 :] if a.effects or b.effects]
    found = list(alone.values())
    for k, hypothesis in enumerate(pairs):
        known: dict[str, float] = dict(null.values)
        for name in hypothesis.names:
            known |= alone[Hypothesis((name,))].values
        found.append(_fitted(hypothesis, known, evidence, prototype, 1))
        progress(_SINGLES + (1 - _SINGLES) * (k + 1) / len(pairs), "pairs")
    expected = sum(piece.expected for piece in evidence)
    names, conditions = tuple(e.name for e in evidence), tuple(e.condition for e in evidence)
    return Search(null, tuple(sorted(found, key=lambda f: f.cost)), expected, names, conditions), silent


def _fitted(
    hypothesis: Hypothesis, known: Mapping[str, float], evidence: Sequence[Evidence], prototype: Prototype, most: int
) -> Fit:
    placement = hypothesis.placement(prototype)
    begun = starts(placement, known, evidence, most)
    if not begun:
        return Fit(hypothesis, placement.unknowns, reason="the model oscillates at no gain, or at any")
    return min((fit(hypothesis, placement, evidence, z) for z in begun), key=lambda f: f.cost)


def _shows(found: Fit) -> bool:
    """Whether some parameter of the effect has a part in what was measured."""
    own = [k for k, u in enumerate(found.unknowns) if u.kind == "effect"]
    return bool(np.any(np.abs(sum(share.a for share in found.shares)[own]) > 0))
