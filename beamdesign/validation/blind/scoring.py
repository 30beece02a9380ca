"""What a blind check comes to: rates with exact bounds, calibration, confusion, held against targets."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from scipy.stats import beta

from beamdesign.validation.blind.outcome import FAILED, NO_GAP, UNKNOWN, Outcome, subsystem_of

CONFIDENCE = 0.95
Sense = Literal["at least", "at most", "between", ""]


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


SMALL = 3.0
"""Gap over the floor below which a case is scored apart."""
CONFIDENT = 0.7
_BINS = 10


@dataclass(frozen=True)
class Score:
    """One figure.

    Attributes:
        name: what it is.
        value: found; nan where no case tells.
        low: 95 % bound.
        high: 95 % bound.
        of: cases, or statements, that it rests on.
        count: how many of them, for a rate; None otherwise.
        target: to be reached; None where there is none.
        sense: whether the value is to be at least or at most the target, or between two.
    """

    name: str
    value: float
    low: float
    high: float
    of: int
    count: int | None = None
    target: tuple[float, ...] | None = None
    sense: Sense = ""

    @property
    def reached(self) -> bool | None:
        """Whether the value reaches the target; None without one, or without a case."""
        if self.target is None or not self.of:
            return None
        match self.sense:
            case "at least":
                return self.value >= self.target[0]
            case "at most":
                return self.value <= self.target[0]
            case _:
                return self.target[0] <= self.value <= self.target[1]


@dataclass(frozen=True)
class Bin:
    """Statements of about one probability.

    Attributes:
        low: least probability.
        high: largest.
        count: of statements.
        stated: mean of their probabilities.
        true: share of them that are true.
    """

    low: float
    high: float
    count: int
    stated: float
    true: float


def scores(outcomes: Sequence[Outcome]) -> tuple[Score, ...]:
    """All figures of the diagnosis, over cases whose gaps are all large or all small; nulls belong to both."""
    with_gap = [o for o in outcomes if o.kind != "null"]
    nulls = _of("null", outcomes)
    single, figure, pair, outside = (_of(kind, outcomes) for kind in ("single", "parameter", "pair", "outside"))
    known = single + figure + pair
    bins, error = calibration(outcomes)
    statements = sum(b.count for b in bins)
    closed = [o for o in outcomes if o.kind != "null" and o.closed is not None and o.closed_truly is not None]
    return (
        _rate("gap detected", with_gap, lambda o: o.verdict not in (NO_GAP, FAILED), (0.98,), "at least"),
        _rate("false alarms", nulls, lambda o: o.verdict != NO_GAP, (0.02,), "at most"),
        _rate("single effect named first", single, lambda o: o.named == o.effects[0], (0.95,), "at least"),
        _rate("single effect in the class", single, in_class, (0.99,), "at least"),
        _rate("wrong figure named first", figure, lambda o: o.named == o.effects[0]),
        _rate("exact pair", pair, exact, (0.75,), "at least"),
        _rate("exact pair, each effect large", [o for o in pair if o.each_over_floor >= SMALL], exact),
        _rate("one of the pair named first", pair, lambda o: o.named in o.effects),
        _rate("subsystem right, known causes", known, lambda o: o.where == o.subsystem, (0.95,), "at least"),
        _rate("subsystem right, outside the library", outside, lambda o: o.where == o.subsystem),
        _mean("mean probability on the truth, singles", single, _on_truth, (0.85,), "at least"),
        _mean("mean probability on exactly the truth, all", outcomes, lambda o: o.exactly),
        _rate("outside the library, confidently wrong", outside, confidently_wrong, (0.05,), "at most"),
        _rate("outside the library, called unknown", outside, lambda o: o.verdict == UNKNOWN),
        Score("calibration error", error, np.nan, np.nan, statements, None, (0.05,), "at most"),
        _median("error of the effect's parameter, median", single, lambda o: o.parameter_error, (0.10,), "at most"),
        _median("error of `closed`, median", closed, lambda o: abs((o.closed or 0.0) - (o.closed_truly or 0.0))),
        _rate("true `closed` inside the interval", closed, _covered, (0.85, 0.95), "between"),
        _median("seconds per case, median", outcomes, lambda o: o.seconds[0] if o.seconds else None),
        _median("seconds of processor time per case, median", outcomes, lambda o: o.seconds[1] if o.seconds else None),
        _rate("diagnosis broke off", outcomes, lambda o: o.verdict == FAILED),
    )


def baseline_scores(name: str, outcomes: Sequence[Outcome]) -> tuple[Score, ...]:
    """What can be said of a baseline, which names causes without a probability."""

    def chosen(o: Outcome) -> tuple[str, ...]:
        return o.baselines.get(name, ())

    given = [o for o in outcomes if name in o.baselines]
    single, pair = _of("single", given), _of("pair", given)
    known = [o for o in given if o.kind in ("single", "pair", "parameter")]
    return (
        _rate("gap detected", [o for o in given if o.kind != "null"], lambda o: bool(chosen(o))),
        _rate("false alarms", _of("null", given), lambda o: bool(chosen(o))),
        _rate("single effect named first", single, lambda o: chosen(o)[:1] == o.effects),
        _rate("wrong figure named first", _of("parameter", given), lambda o: chosen(o)[:1] == o.effects),
        _rate("exact pair", pair, lambda o: set(chosen(o)) == set(o.effects)),
        _rate("one of the pair named first", pair, lambda o: bool(set(chosen(o)[:1]) & set(o.effects))),
        _rate("subsystem right, known causes", known, lambda o: subsystem_of(chosen(o)) == o.subsystem),
        _rate("outside the library, names a cause", _of("outside", given), lambda o: bool(chosen(o))),
    )


def split(outcomes: Sequence[Outcome]) -> tuple[tuple[Outcome, ...], tuple[Outcome, ...]]:
    """Nulls and large gaps; small gaps."""
    small = tuple(o for o in outcomes if o.kind != "null" and o.gap_over_floor < SMALL)
    return tuple(o for o in outcomes if o not in small), small


def in_class(o: Outcome) -> bool:
    """Whether the true effect is named first, or stated to be one of those that cannot be told apart."""
    return o.named == o.effects[0] or (o.verdict not in (NO_GAP, UNKNOWN, FAILED) and o.effects[0] in o.alternatives)


def exact(o: Outcome) -> bool:
    """Whether just what was in it is held responsible."""
    return set(o.chosen) == set(o.effects)


def confidently_wrong(o: Outcome) -> bool:
    """Whether a cause that is not there is named without a doubt."""
    sure = o.verdict == "effect" and o.probability.get(o.named, 0.0) >= CONFIDENT
    return sure and o.named not in o.effects


def calibration(outcomes: Sequence[Outcome]) -> tuple[tuple[Bin, ...], float]:
    """How true stated probabilities are.

    Statements are: each cause that is listed is at work; there is no gap; it is something outside the library.

    Returns:
        bins of probability with any statement in them, and the mean distance of stated from true, weighed by
        statements (M. P. Naeini, G. Cooper, M. Hauskrecht, Obtaining well calibrated probabilities using Bayesian
        binning, 2015).
    """
    stated = [
        pair
        for o in outcomes
        if o.verdict != FAILED
        for pair in (
            *((p, name in o.effects) for name, p in o.probability.items()),
            (o.no_gap, o.kind == "null"),
            (o.unknown, o.kind == "outside" and not set(o.effects) & set(o.probability)),
        )
    ]
    if not stated:
        return (), np.nan
    p, true = np.array([s[0] for s in stated]), np.array([s[1] for s in stated], dtype=float)
    index = np.minimum((p * _BINS).astype(int), _BINS - 1)
    bins = tuple(
        Bin(k / _BINS, (k + 1) / _BINS, int(inside.sum()), float(p[inside].mean()), float(true[inside].mean()))
        for k in range(_BINS)
        if (inside := index == k).any()
    )
    return bins, sum(b.count * abs(b.stated - b.true) for b in bins) / len(stated)


def confusion(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """How often each truth (row) was named as what (column); rows and columns in order of their names."""
    rows: dict[str, Counter[str]] = {}
    for o in outcomes:
        rows.setdefault(o.label, Counter())[o.named] += 1
    return {label: dict(sorted(rows[label].items())) for label in sorted(rows, key=_place)}


def _place(label: str) -> tuple[int, str]:
    order = 0 if label == NO_GAP else 4 if label.startswith("outside") else 3 if label.endswith("+") else 1
    return (2 if label.startswith("parameter:") and order == 1 else order, label)


def _of(kind: str, outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.kind == kind]


def _on_truth(o: Outcome) -> float:
    return o.probability.get(o.effects[0], 0.0)


def _covered(o: Outcome) -> bool:
    return o.interval is not None and o.closed_truly is not None and o.interval[0] <= o.closed_truly <= o.interval[1]


def _rate(
    name: str,
    among: Sequence[Outcome],
    happened: Callable[[Outcome], bool],
    target: tuple[float, ...] | None = None,
    sense: Sense = "",
) -> Score:
    count, of = sum(map(bool, map(happened, among))), len(among)
    low, high = clopper_pearson(count, of)
    return Score(name, count / of if of else np.nan, low, high, of, count, target, sense)


def _statistic(
    statistic: Callable[..., np.ndarray],
    name: str,
    among: Sequence[Outcome],
    value: Callable[[Outcome], float | None],
    target: tuple[float, ...] | None = None,
    sense: Sense = "",
) -> Score:
    """Of a value that each outcome has, or None for those that tell nothing."""
    values = [found for o in among if (found := value(o)) is not None]
    if not values:
        return Score(name, np.nan, np.nan, np.nan, 0, None, target, sense)
    return Score(name, float(statistic(values)), *bootstrap(values, statistic), len(values), None, target, sense)


_mean = partial(_statistic, np.mean)
_median = partial(_statistic, np.median)
