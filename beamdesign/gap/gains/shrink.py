"""How far a gap in critical gains and responses closes: relative errors of each as predicted from all the others."""

from collections.abc import Sequence

import numpy as np

from beamdesign.gap.diagnosis import Gap, RecordGap
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import NOTHING, Hypothesis
from beamdesign.gap.gains.search import Figure

_DRAWS = 2000
_LOST = 1.0  # relative error of a model that cannot predict at all
_FURTHEST = 2.0


def left_out(piece: Figure, hypothesis: Hypothesis, z: np.ndarray) -> float:
    """Rms of ln(measured/predicted) of one piece of evidence."""
    placement = hypothesis.placement(piece.prototype)
    residual = piece.residual(placement, z)
    if residual is None:
        return _LOST
    return float(np.sqrt(np.mean((residual * piece.units) ** 2)))


def without(found: Fit, position: int) -> np.ndarray:
    """Unknowns of a fit as all the evidence but one piece would have them, by one Newton step."""
    share = found.shares[position]
    rest = np.eye(len(found.z)) + sum(s.a for k, s in enumerate(found.shares) if k != position)
    move = np.clip(np.linalg.solve(rest, share.g), -_FURTHEST, _FURTHEST)
    low, high = (np.array(side) for side in zip(*(u.bounds for u in found.unknowns), strict=True))
    return np.asarray(np.clip(found.z + move, low, high))


def figures_of_gap(evidence: Sequence[Figure], null: Fit, after: Fit) -> Gap:
    """Relative errors before, with tolerances fitted and with the best explanation, one piece left out at a time.

    Args:
        evidence: in the order of the fits' shares.
        null: tolerances alone.
        after: the explanation.

    Returns:
        with a 90 % interval of `closed` by the bootstrap over pieces.
    """
    nominal = np.zeros(len(null.z))
    rows = [
        (
            left_out(piece, NOTHING, nominal),
            left_out(piece, NOTHING, without(null, k)),
            left_out(piece, after.hypothesis, without(after, k)),
            float(np.sqrt(np.mean(piece.units**2) * piece.expected / len(piece.units))),
        )
        for k, piece in enumerate(evidence)
    ]
    squares = np.array(rows) ** 2
    means = squares.mean(axis=0)
    rng = np.random.default_rng(0)
    drawn = squares[rng.integers(len(rows), size=(_DRAWS, len(rows)))].mean(axis=1)
    low, high = (float(v) for v in np.quantile([_closed(row) for row in drawn], (0.05, 0.95)))
    before, tuned, left, floor = (float(v) for v in np.sqrt(means))
    records = tuple(RecordGap(piece.name, True, *row) for piece, row in zip(evidence, rows, strict=True))
    return Gap(before, tuned, left, floor, _closed(means), (low, high), records)


def _closed(squares: np.ndarray) -> float:
    before, _, after, floor = squares
    return min(1.0, float((before - after) / (before - floor))) if before > floor else 0.0
