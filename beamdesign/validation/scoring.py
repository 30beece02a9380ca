"""What a blind check comes to: each case said and true; rates with exact bounds, calibration, confusion, targets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from typing import Any, Literal

import numpy as np

from beamdesign.diagnosis.fitting.hypothesis import subsystem
from beamdesign.plant.effects import library
from beamdesign.validation.bounds import bootstrap, clopper_pearson

NO_GAP, UNKNOWN, FAILED = "no_gap", "unknown", "failed"
_OTHER_LAW = "entrained_air"
"""Its law has other exponents in either model; of every other effect the first parameter means the same in both."""


@dataclass(frozen=True)
class Outcome:
    """One case.

    Attributes:
        key: of the case.
        kind: null, single, pair, outside, parameter, triple or alone.
        rig: which rigs it was drawn from.
        effects: that were in it, the dominant one first; none for a null.
        subsystem: of the dominant one.
        gap_over_floor: how far the effects stand out of the noise; without records, of the errors of the figures.
        each_over_floor: the least of the effects alone.
        verdict: what was said; `failed` where the diagnosis broke off.
        chosen: causes held responsible.
        named: the first of them, or `no_gap`, `unknown`, `failed`.
        where: subsystem that was said.
        probability: of each stated cause, by name; a law learnt from the data is none.
        exactly: of exactly what was in it (an effect outside the library: that it is unknown).
        no_gap: probability that was given to no gap at all.
        unknown: to something outside the library.
        alternatives: names in the classes of what cannot be told apart.
        closed: share of the gap that was said to close, with its interval; None without one.
        interval: of it.
        closed_truly: against the noise-free rig.
        left: error that re-tuned tolerances leave against the noise-free rig, over the floor; None where unknown.
        parameter_error: relative, of the effect named first where that is right; None where not comparable.
        seconds: of its diagnosis, and of processor time; None where parts were done before.
        baselines: causes chosen by each.
        failure: why the diagnosis broke off, and where; empty where it did not.
        figures: whether frequency responses and critical gains were measured as well, or alone.
    """

    key: str
    kind: str
    effects: tuple[str, ...]
    subsystem: str
    gap_over_floor: float
    each_over_floor: float
    verdict: str
    chosen: tuple[str, ...] = ()
    named: str = FAILED
    where: str = ""
    probability: Mapping[str, float] = field(default_factory=dict)
    exactly: float = 0.0
    no_gap: float = 0.0
    unknown: float = 0.0
    alternatives: tuple[str, ...] = ()
    closed: float | None = None
    interval: tuple[float, float] | None = None
    closed_truly: float | None = None
    left: float | None = None
    parameter_error: float | None = None
    seconds: tuple[float, float] | None = None
    baselines: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    failure: str = ""
    rig: str = "lag"  # as in checks whose answers name none
    figures: bool = False

    @property
    def on_truth(self) -> list[float]:
        """Stated probability of each of its effects."""
        return [self.probability.get(name, 0.0) for name in self.effects]

    @property
    def label(self) -> str:
        """Its row in a table of confusion; several effects go by the dominant one."""
        if self.kind == "null":
            return NO_GAP
        before = {"outside": "outside: ", "alone": "without records: "}.get(self.kind, "")
        return before + self.effects[0] + " +" * (len(self.effects) - 1)


def closed_by(errors: Mapping[str, float]) -> float | None:
    """1 - after^2 / before^2 of `squares`; None where there is nothing to close."""
    return 1 - errors["after"] / errors["before"] if errors.get("before", 0.0) > 0 else None


def outcome(key: str, answer: dict[str, Any], found: dict[str, Any], errors: Mapping[str, float]) -> Outcome:
    """Put what was said beside what is true.

    Args:
        key: of the case.
        answer: what was in it.
        found: what was written down about it; `failed` instead of `diagnosis` where there is none.
        errors: against the noise-free rig, see `beamdesign.validation.blindcheck.squares`.
    """
    effects = tuple(name for name in answer["effects"] if name != NO_GAP)
    gaps = answer["gaps_over_floor"]
    base = {
        "key": key,
        "kind": answer["kind"],
        "rig": answer.get("rig", "lag"),
        "figures": answer.get("figures", False),
        "effects": effects,
        "subsystem": answer["subsystem"],
        "gap_over_floor": answer.get("figures_over_errors", answer["gap_over_floor"]),
        "each_over_floor": min((gaps[name] for name in effects), default=0.0),
    }
    if "diagnosis" not in found:
        failure = " at ".join(str(found[key]) for key in ("failed", "failed_at") if key in found)
        return Outcome(**base, verdict=FAILED, failure=failure)
    said = found["diagnosis"]
    verdict, gap = said["verdict"], said["gap"]
    causes = {cause["name"]: cause for cause in said["effects"]}
    probability = {name: cause["probability"] for name, cause in causes.items() if not cause.get("like")}
    stated = {frozenset(row["names"]): row["probability"] for row in said["hypotheses"]}
    unknown = said["probability_unknown"]
    named = verdict if verdict in (NO_GAP, UNKNOWN) else next(iter((*said["chosen"], *causes)), UNKNOWN)
    rivals = {name for each in said["classes"] for text in each for name in text.split(" + ")}
    comparable = (verdict != UNKNOWN or bool(said["chosen"])) and gap["closed"] is not None
    time, floor = found.get("time"), answer.get("relative_floor", 0.0)
    return Outcome(
        **base,
        verdict=verdict,
        chosen=tuple(said["chosen"]),
        named=named,
        where=said["where"]["subsystem"],
        probability=probability,
        exactly=unknown if answer["kind"] == "outside" else stated.get(frozenset(effects), 0.0),
        no_gap=stated.get(frozenset(), 0.0),
        unknown=unknown,
        alternatives=tuple(sorted(rivals)),
        closed=gap["closed"] if comparable else None,
        interval=tuple(gap["closed_interval"]) if comparable else None,
        closed_truly=closed_by(errors),
        left=float(np.sqrt(errors["tuned"]) / floor) if "tuned" in errors and floor > 0 else None,
        parameter_error=_parameter_error(named, answer, causes),
        seconds=(time["seconds"], time["cpu_seconds"]) if time else None,
        baselines={name: tuple(way["chosen"]) for name, way in found["baselines"].items()},
    )


def _parameter_error(named: str, answer: dict[str, Any], causes: dict[str, Any]) -> float | None:
    true, said = answer["parameters"].get(named), causes.get(named, {}).get("parameters", {})
    if true is None or (named == "sensor_lag" and true.get("order") != 1):
        return None
    effect = None if named == _OTHER_LAW else library().get(named)
    key, at = (true["figure"], "value") if "figure" in true else (effect.parameters[0].name if effect else "",) * 2
    value = true.get(at)
    return abs(said[key]["value"] / value - 1) if value and key in said else None


Sense = Literal["at least", "at most", "between", ""]
SMALL = 3.0
"""Gap over the floor below which a case is scored apart."""
IMITATED = 1.2
"""Floors that a null's own small imperfections may come to, see `beamdesign.validation.truth.drawing`: a gap of which
re-tuned tolerances leave no more is one that a rig without a gap may have, so that no test tells it from a null."""
CONFIDENT, _BINS = 0.7, 10


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
        least = -inf if self.sense == "at most" else self.target[0]
        most = inf if self.sense == "at least" else self.target[-1]
        return least <= self.value <= most


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
    """All figures of the diagnosis, over cases whose gaps are all large or all small; nulls belong to both.

    Cases without records have rows of their own and are in no other but that of what broke off.
    """
    every, outcomes = outcomes, [o for o in outcomes if o.kind != "alone"]
    with_gap = [o for o in outcomes if o.kind != "null"]
    kinds = ("null", "single", "parameter", "pair", "triple", "outside")
    nulls, single, figure, pair, triple, outside = (_of(kind, outcomes) for kind in kinds)
    known, alone = single + figure + pair + triple, _of("alone", every)
    bins, error = calibration(outcomes)
    closed = [o for o in with_gap if o.closed is not None and o.closed_truly is not None]
    plain = [o for o in with_gap if o.left is not None and o.left > IMITATED]
    return (
        _rate("gap detected", with_gap, _detected),
        _rate("gap detected, tolerances cannot imitate it", plain, _detected, (0.96,), "at least"),
        _rate("false alarms", nulls, lambda o: o.verdict != NO_GAP, (0.02,), "at most"),
        _rate("single effect named first", single, lambda o: o.named == o.effects[0], (0.97,), "at least"),
        _rate("single effect in the class", single, in_class, (0.99,), "at least"),
        _rate("wrong figure named first", figure, lambda o: o.named == o.effects[0]),
        _rate("exact pair", pair, exact, (0.80,), "at least"),
        _rate("exact pair, each effect large", [o for o in pair if o.each_over_floor >= SMALL], exact),
        _rate("one of the pair named first", pair, lambda o: o.named in o.effects),
        _rate("dominant of three named first", triple, lambda o: o.named == o.effects[0], (0.90,), "at least"),
        _rate("one of the three named first", triple, lambda o: o.named in o.effects),
        _rate("exactly the three", triple, exact),
        _rate("subsystem right, known causes", known, lambda o: o.where == o.subsystem, (0.95,), "at least"),
        _rate("subsystem right, outside the library", outside, lambda o: o.where == o.subsystem),
        _mean("mean probability on the truth, singles", single, lambda o: o.on_truth[0], (0.85,), "at least"),
        _mean("mean probability on exactly the truth, all", outcomes, lambda o: o.exactly),
        _rate("outside the library, confidently wrong", outside, confidently_wrong, (0.0,), "at most"),
        _rate("outside the library, called unknown", outside, lambda o: o.verdict == UNKNOWN),
        _rate("outside the library, 80 % closed", outside, lambda o: (o.closed_truly or 0) >= 0.8, (0.8,), "at least"),
        Score("calibration error", error, np.nan, np.nan, sum(b.count for b in bins), None, (0.03,), "at most"),
        _median("error of the effect's parameter, median", single, lambda o: o.parameter_error, (0.10,), "at most"),
        _median("error of `closed`, median", closed, lambda o: abs((o.closed or 0.0) - (o.closed_truly or 0.0))),
        _rate("true `closed` inside the interval", closed, _covered, (0.85, 0.95), "between"),
        _median("seconds per case, median", outcomes, lambda o: o.seconds[0] if o.seconds else None),
        _median("seconds of processor time per case, median", outcomes, lambda o: o.seconds[1] if o.seconds else None),
        _rate("diagnosis broke off", every, lambda o: o.verdict == FAILED),
        _rate("without records: gap detected", alone, _detected),
        _rate("without records: effect in the class", alone, in_class),
        _rate("without records: confidently wrong", alone, confidently_wrong),
        _rate("without records: subsystem right", alone, lambda o: o.where == o.subsystem),
    )


def baseline_scores(name: str, outcomes: Sequence[Outcome]) -> tuple[Score, ...]:
    """What can be said of a baseline, which names causes without a probability: no target is set for it."""
    given = [_as_named(o, o.baselines[name]) for o in outcomes if name in o.baselines]
    found = [replace(score, target=None, sense="") for score in scores(given) if score.name in _OF_NAMES]
    return *found, _rate("outside the library, names a cause", _of("outside", given), lambda o: bool(o.chosen))


_OF_NAMES = {
    "gap detected", "false alarms", "single effect named first", "wrong figure named first", "exact pair",
    "one of the pair named first", "dominant of three named first", "subsystem right, known causes",
}  # fmt: skip
"""Scores of whoever names causes."""


def _as_named(o: Outcome, chosen: tuple[str, ...]) -> Outcome:
    """The outcome had these causes been named, without a probability."""
    verdict, named, where = ("effect", chosen[0], subsystem(chosen[0])) if chosen else (NO_GAP, NO_GAP, "")
    return replace(o, verdict=verdict, chosen=chosen, named=named, where=where)


def split(outcomes: Sequence[Outcome]) -> tuple[tuple[Outcome, ...], tuple[Outcome, ...]]:
    """Nulls and large gaps; small gaps."""
    small = tuple(o for o in outcomes if o.kind != "null" and o.gap_over_floor < SMALL)
    return tuple(o for o in outcomes if o not in small), small


def _detected(o: Outcome) -> bool:
    return o.verdict not in (NO_GAP, FAILED)


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
    """How true stated probabilities are, of cases with records.

    Statements are: each cause that is listed is at work; there is no gap; it is something outside the library.

    Returns:
        bins of probability with any statement in them, and the mean distance of stated from true, weighed by statements
        (M. P. Naeini, G. Cooper, M. Hauskrecht, Obtaining well calibrated probabilities using Bayesian binning, 2015).
    """
    stated = [
        pair
        for o in outcomes
        if o.verdict != FAILED and o.kind != "alone"
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


def _of(kind: str, outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.kind == kind]


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
