"""Bounds of what a finite number of cases says."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import beta

CONFIDENCE = 0.95


def clopper_pearson(count: int, of: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Exact two-sided bounds of a probability.

    C. J. Clopper, E. S. Pearson, The use of confidence or fiducial limits illustrated in the case of the binomial,
    Biometrika 26 (1934), 404-413.

    Args:
        count: how often it happened.
        of: in how many independent cases; (0, 1) where there are none.
        confidence: of the two bounds together.

    Raises:
        ValueError: for counts that cannot be.
    """
    if not 0 <= count <= of:
        raise ValueError(f"{count} of {of}")
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, count, of - count + 1)) if count else 0.0
    high = float(beta.isf(tail, count + 1, of - count)) if count < of else 1.0
    return low, high


def bootstrap(
    values: Sequence[float], statistic: Callable[..., np.ndarray], confidence: float = CONFIDENCE, draws: int = 4000
) -> tuple[float, float]:
    """Percentile bounds of a statistic of independent values, by drawing them again (B. Efron, 1979).

    Args:
        values: at least one.
        statistic: of an array along `axis`.
        confidence: of the two bounds together.
        draws: how many.
    """
    given = np.asarray(values, dtype=float)
    random = np.random.default_rng(0)
    found = statistic(given[random.integers(0, len(given), (draws, len(given)))], axis=1)
    low, high = np.quantile(found, ((1 - confidence) / 2, (1 + confidence) / 2))
    return float(low), float(high)
