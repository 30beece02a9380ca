"""What a diagnosis of a bench has to say beside its figures."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from beamdesign.gap.bench.diagnosis import Ranked
from beamdesign.gap.bench.fit import SteadyFit
from beamdesign.gap.bench.hypothesis import BenchHypothesis

_CLOSE = 0.8  # correlation from which two figures are told as one
_FEW = 5


def notes_on(
    ranked: Sequence[Ranked], best: Ranked, marginal: Mapping[str, float], conditions: int, known: BenchHypothesis
) -> Iterator[str]:
    """Notes on what is uncertain and why."""
    if conditions < _FEW:
        yield f"{conditions} conditions are few: probabilities follow from how each is predicted without the others"
    yield from _greedy(ranked, best, known)
    yield from _frictions(ranked)
    yield from (f"cannot be told apart: {words}" for words in correlated(best.held_out.fit))
    yield from _rest(best)
    undecided = [name for name, p in marginal.items() if 0.1 < p < 0.9]
    if len(undecided) > 1:
        yield f"not decided by these conditions: {', '.join(undecided)}"
    yield from best.held_out.fit.flags
    if not best.hypothesis.orifices:
        yield "a linear valve says nothing of the chambers' mean pressure; supply and tank are shared between them here"


def correlated(fit: SteadyFit) -> list[str]:
    """Pairs of figures which the data determine together but not each, with their correlation."""
    deviation = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(deviation, deviation)
    names = list(fit.values)
    return [
        f"{names[i]} and {names[j]} (correlation {correlation[i, j]:+.2f})"
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > _CLOSE
    ]


def _greedy(ranked: Sequence[Ranked], best: Ranked, known: BenchHypothesis) -> Iterator[str]:
    """What adding one cause at a time would have found, against the chosen set."""
    error = {each.hypothesis: each.held_out.total for each in ranked}
    path = [known]
    while True:
        nearer = [h for h in error if len(_parts(h)) == len(_parts(path[-1])) + 1 and _parts(path[-1]) <= _parts(h)]
        step = min(nearer, key=lambda h: error[h], default=None)
        if step is None or error[step] >= error[path[-1]]:
            break
        path.append(step)
    if error[path[-1]] > error[best.hypothesis]:
        yield f"one cause at a time ends at {path[-1]} with a held-out error of {error[path[-1]]:.3f}"
    if known.names:
        return
    areas, root = BenchHypothesis(unequal_areas=True), BenchHypothesis(orifices=True)
    both, none = BenchHypothesis(unequal_areas=True, orifices=True), BenchHypothesis()
    if error[both] < error[none] <= 1.02 * min(error[areas], error[root]):
        yield (
            f"areas and square-root flow help only together: held-out error {error[none]:.3f} without, "
            f"{error[areas]:.3f} with areas, {error[root]:.3f} with square-root flow, {error[both]:.3f} with both"
        )


def _rest(best: Ranked) -> Iterator[str]:
    """Which prediction is off most on conditions held out."""
    worst = max(
        (
            (value, channel, condition)
            for condition, each in best.held_out.error.items()
            for channel, value in each.items()
        )
    )
    yield f"what is left is largest in {worst[1]} at {worst[2]}: {100 * worst[0]:.1f} %"


def _parts(hypothesis: BenchHypothesis) -> set[str]:
    return set(hypothesis.names) | ({"stribeck"} if hypothesis.friction == "stribeck" else set())


def _frictions(ranked: Sequence[Ranked]) -> Iterator[str]:
    kinds: dict[str, float] = {}
    for each in ranked:
        kinds[each.hypothesis.friction] = kinds.get(each.hypothesis.friction, 0.0) + each.probability
    listed = ", ".join(f"{kind} {p:.2f}" for kind, p in sorted(kinds.items(), key=lambda item: -item[1]) if p > 0.01)
    yield f"friction by kind: {listed}"
