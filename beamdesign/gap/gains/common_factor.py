"""One factor between what was measured and what was predicted: the simplest answer after none."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np


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
