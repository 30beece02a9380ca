"""Before any fit: which causes a data set cannot tell apart, and which it cannot show at all.

The signature of a cause is what it does, at its typical severity, to the predictions of everything measured, in units
of misfit. What re-tuned tolerances would take up of it, at the price of their priors, does not count; nor, of two
causes, what the other would take up with its severity and parameters free to first order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np
from scipy.sparse.csgraph import connected_components

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.fit import Evidence, linearised
from beamdesign.diagnosis.fitting.hypothesis import (
    NOTHING,
    Hypothesis,
    Placement,
    Unknown,
    cause,
    known_effects,
    place,
    singles,
)
from beamdesign.time_limit import heed

ALIKE = 0.98
"""Cosine between signatures from which two causes are called close."""
LEAST = 2.0
"""Units of misfit below which a signature, or what separates two of them, is not seen."""
_WRONG_BY = 0.15  # relative, of a plainly wrong figure, typically
_WEAKER = (1.0, 0.5, 0.25)
_RIDGE = 1e-9


@dataclass(frozen=True)
class Separability:
    """What a data set can tell.

    Attributes:
        names: of the causes.
        visible: (H,) size of each signature beyond tolerances, in units of misfit (square root).
        separation: (H, H) what is left of one signature once the other cause has taken up what it can; the lesser of
            both ways round.
        cosine: (H, H) between signatures, beyond tolerances; 1 for the same direction.
        classes: sets of two or more visible causes that cannot be told apart: less than `LEAST` separates them.
        close: pairs of visible causes whose signatures nearly agree (`ALIKE`): only records as good as these tell
            them apart.
        invisible: causes whose signature does not stand out.
    """

    names: tuple[str, ...]
    visible: np.ndarray = field(repr=False)
    separation: np.ndarray = field(repr=False)
    cosine: np.ndarray = field(repr=False)
    classes: tuple[tuple[str, ...], ...]
    close: tuple[tuple[str, str], ...]
    invisible: tuple[str, ...]


def indistinguishable(
    data: Dataset, evidence: Sequence[Evidence], hypotheses: Sequence[Hypothesis] = ()
) -> Separability:
    """Find the causes that this data set cannot tell apart.

    Args:
        data: with the believed prototype.
        evidence: everything measured; only its conditions and its noise count, not what came out.
        hypotheses: to be compared; none: all single causes but for effects that the prototype has already, of those
            with several laws the usual one.

    Raises:
        ValueError: where the believed prototype itself is unstable under the conditions measured.
        TimeUp: see `beamdesign.time_limit.heed`.
    """
    nothing = NOTHING.placement(data.prototype)
    if (rest := linearised(evidence, nothing, np.zeros(len(nothing.unknowns)))) is None:
        raise ValueError("the believed prototype's loop is unstable under the conditions measured")
    base, tolerances = (np.concatenate(parts) for parts in zip(*rest, strict=True))
    known = {cause(name) for name in known_effects(data.prototype)}
    among = hypotheses or [h for h in singles(data.prototype) if h.names == h.causes and not known & {*h.causes}]
    tried = {str(h): _signature(evidence, h.placement(data.prototype), base) for h in among}
    found = {name: columns for name, columns in tried.items() if columns is not None}
    matrix = np.hstack([tolerances, *found.values()])
    edges = np.cumsum([tolerances.shape[1], *(columns.shape[1] for columns in found.values())])
    parts = [range(first, last) for first, last in pairwise(edges.tolist())]
    return _judged(matrix.T @ matrix, tolerances.shape[1], parts, tuple(found))


def _signature(evidence: Sequence[Evidence], placement: Placement, base: np.ndarray) -> np.ndarray | None:
    """(M, 1 + Q) change of residuals by a cause at its typical severity, and derivatives by its own parameters."""
    # Tolerated figures stay as believed, and their derivatives are those without a cause.
    own = tuple(u for u in placement.unknowns if u.kind != "figure")
    alone = place(placement.assembly.kinds, own or placement.unknowns)  # what is missing has none of its own
    for share in _WEAKER:
        heed()
        rows = linearised(evidence, alone, np.array([_typical(u, share) for u in alone.unknowns]))
        if rows is not None:
            residual, slopes = (np.concatenate(parts) for parts in zip(*rows, strict=True))
            return np.column_stack([residual - base, slopes[:, : len(own)]])
    return None


def _typical(unknown: Unknown, share: float) -> float:
    """The z of a share of the typical severity."""
    if unknown.kind == "free":
        return unknown.z(unknown.nominal * (1 + share * _WRONG_BY))
    return unknown.z(share * unknown.nominal) if unknown.linear else 0.0


def _judged(gram: np.ndarray, tolerated: int, parts: Sequence[Sequence[int]], names: tuple[str, ...]) -> Separability:
    count, tuned = len(names), list(range(tolerated))
    size = np.array([_left(gram, part[0], tuned, []) for part in parts])
    visible = np.sqrt(size)
    cosine, separation = np.eye(count), np.zeros((count, count))
    for i, j in combinations(range(count), 2):
        left = [_left(gram, parts[a][0], tuned, list(parts[b])) for a, b in ((i, j), (j, i))]
        alike = [1 - x / max(s, 1e-300) for x, s in zip(left, (size[i], size[j]), strict=True)]
        separation[i, j] = separation[j, i] = float(np.sqrt(max(min(left), 0.0)))
        cosine[i, j] = cosine[j, i] = float(np.sqrt(np.clip(max(alike), 0.0, 1.0)))
    seen = [k for k in range(count) if visible[k] >= LEAST]
    of = connected_components(separation[np.ix_(seen, seen)] < LEAST, directed=False)[1]
    groups = (tuple(names[k] for k, own in zip(seen, of, strict=True) if own == n) for n in np.unique(of))
    classes = tuple(group for group in groups if len(group) > 1)
    close = tuple((names[i], names[j]) for i, j in combinations(seen, 2) if cosine[i, j] > ALIKE)
    invisible = tuple(names[k] for k in range(count) if k not in seen)
    return Separability(names, visible, separation, cosine, classes, close, invisible)


def _left(gram: np.ndarray, which: int, tuned: list[int], free: list[int]) -> float:
    """Square of what is left of a column: tolerances approximate it at the price of their priors, others for free."""
    at = tuned + free
    scale = np.sqrt(np.maximum(np.diag(gram)[at], 1e-300))
    scale[: len(tuned)] = 1.0
    price = np.concatenate([np.ones(len(tuned)), np.full(len(free), _RIDGE)])
    a = gram[np.ix_(at, at)] / scale / scale[:, None] + np.diag(price)
    b = gram[at, which] / scale
    return max(float(gram[which, which] - b @ np.linalg.solve(a, b)), 0.0)
