"""What lies between measured and predicted critical gains: one factor, or known causes, each at a stated size.

One factor is the simplest answer after none; of causes, it is told how much of the distance they carry.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from math import exp, log, sqrt

import numpy as np

from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import together
from beamdesign.plant.effects import library


@dataclass(frozen=True)
class CommonFactor:
    """The one factor on all predictions that suits measured gains best.

    Attributes:
        factor: measured over predicted.
        std: of the factor, from the errors of the measurements alone.
        before: rms of ln(measured/predicted).
        left: rms that remains with the factor.
        noise: rms of the measurements' own relative errors.
    """

    factor: float
    std: float
    before: float
    left: float
    noise: float

    @property
    def explained(self) -> float:
        """Share of the mean square of ln(measured/predicted) that the factor takes away."""
        return 1 - (self.left / self.before) ** 2 if self.before > 0 else 0.0


def common_factor(measured: Sequence[float], predicted: Sequence[float], relative_std: Sequence[float]) -> CommonFactor:
    """Fit one factor to gains by weighted least squares in their logarithms.

    Raises:
        ValueError: without gains, or where the three differ in length.
    """
    ratios = np.array([np.log(m / p) for m, p in zip(measured, predicted, strict=True)])
    errors = np.array(relative_std, dtype=float)
    if not len(ratios) or len(errors) != len(ratios):
        raise ValueError(f"{len(ratios)} gains with {len(errors)} errors")
    weights = errors**-2
    mean = float(weights @ ratios / weights.sum())
    factor = exp(mean)
    rms = [float(np.sqrt(np.mean(values**2))) for values in (ratios, ratios - mean, errors)]
    return CommonFactor(factor, factor / sqrt(float(weights.sum())), *rms)


SUSPECTS = ("sensor_lag", "unequal_piston_areas")
"""What Zalucky and Hardt (1984) had in their rig and not in their model: the sensor's filter, the smaller side."""


@dataclass(frozen=True)
class GainShare:
    """What one cause carries of the mean of ln(measured/predicted).

    Attributes:
        name: of the effect, or `common_factor` for what is left to one factor on all gains.
        parameters: the size it is taken at.
        alone: mean change of ln(gain) by it alone.
        share: mean, over all orders in which the causes may be added, of what it adds (L. S. Shapley, Contributions to
            the Theory of Games II (1953) 307); for the factor, what the others leave.
    """

    name: str
    parameters: Mapping[str, float]
    alone: float
    share: float


@dataclass(frozen=True)
class GainShares:
    """Of all causes; their shares add up to the total.

    Attributes:
        total: mean of ln(measured/predicted).
        together: mean change of ln(gain) by all stated causes at once.
        shares: one per cause, the common factor last.
        left: rms of ln(measured/predicted) that is left with all of them, the factor included.
    """

    total: float
    together: float
    shares: tuple[GainShare, ...]
    left: float


def gain_shares(gains: Sequence[GainEvidence]) -> GainShares | None:
    """Share out the distance between measured and predicted gains, all figures of the rig as believed.

    Args:
        gains: measured.

    Returns:
        None without gains, or where the model with some of `SUSPECTS` oscillates at no gain.
    """
    if not gains:
        return None
    logs: dict[frozenset[str], np.ndarray] = {}
    for chosen in (some for count in range(len(SUSPECTS) + 1) for some in combinations(SUSPECTS, count)):
        found = _log_gains(gains, chosen)
        if found is None:
            return None
        logs[frozenset(chosen)] = found
    base, everything = logs[frozenset()], logs[frozenset(SUSPECTS)]
    measured = np.array([log(piece.measured.gain) - piece.offset for piece in gains])
    total, carried = float(np.mean(measured - base)), float(np.mean(everything - base))
    shares = []
    for name in SUSPECTS:
        before = [frozenset(order[: order.index(name)]) for order in permutations(SUSPECTS)]
        steps = [float(np.mean(logs[others | {name}] - logs[others])) for others in before]
        sizes = {q.name: float(q.default) for q in library()[name].parameters}
        shares.append(GainShare(name, sizes, float(np.mean(logs[frozenset({name})] - base)), float(np.mean(steps))))
    shares.append(GainShare("common_factor", {"factor": float(np.exp(total - carried))}, total, total - carried))
    return GainShares(total, carried, tuple(shares), float(np.std(measured - everything)))


def _log_gains(gains: Sequence[GainEvidence], effects: tuple[str, ...]) -> np.ndarray | None:
    """(G,) ln of predicted gains with effects at their usual sizes and everything else as believed."""
    found = []
    for piece in gains:
        placement = together(*effects).placement(piece.prototype)
        at = piece.predicted(placement, np.zeros(len(placement.unknowns)))
        if at is None:
            return None
        found.append(log(at.gain))
    return np.array(found)
