"""Bounds of rates and of other figures found in independent cases."""

from collections.abc import Callable, Sequence

import numpy as np

CONFIDENCE, _DRAWS = 0.95, 4000


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
    from scipy.stats import binomtest

    if not 0 <= count <= of:
        raise ValueError(f"{count} of {of}")
    bounds = binomtest(count, of).proportion_ci(confidence, method="exact") if of else (0.0, 1.0)
    return float(bounds[0]), float(bounds[1])


def bootstrap(values: Sequence[float], statistic: Callable[..., np.ndarray]) -> tuple[float, float]:
    """Percentile bounds of a statistic of independent values, by drawing them again (B. Efron, 1979).

    Args:
        values: at least one.
        statistic: of an array along `axis`.
    """
    given = np.asarray(values, dtype=float)
    drawn = given[np.random.default_rng(0).integers(0, len(given), (_DRAWS, len(given)))]
    low, high = np.quantile(statistic(drawn, axis=1), ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2))
    return float(low), float(high)
