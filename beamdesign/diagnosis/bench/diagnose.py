"""Diagnosis of an actuator bench from its steady motions, with its records replayed as a check, and in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.bench.data import BenchSet, read_bench_set, saturates_at
from beamdesign.diagnosis.bench.diagnosis import (
    BenchDiagnosis,
    ReplayError,
    asked_for,
    condition_rows,
    replay_errors,
    rows_of,
    updated_prototype,
    where_of,
)
from beamdesign.diagnosis.bench.fit import HeldOut, SteadyFit, held_out
from beamdesign.diagnosis.bench.hypothesis import (
    NOTHING,
    STEADY_EFFECTS,
    BenchHypothesis,
    candidates,
    nominal,
    parameters,
    subsystem,
)
from beamdesign.diagnosis.bench.motions import (
    CHANNELS,
    Observations,
    averaged,
    errors,
    observations,
    scatter,
    steady,
    steady_motions,
)
from beamdesign.diagnosis.diagnosis import Cause, CauseSet, Gap, NextExperiment, Verdict
from beamdesign.diagnosis.gap_metrics import gap_of_pieces
from beamdesign.diagnosis.judgement import THRESHOLDS

_DRAWS = 4000
_GO_WITH = {
    "seal_friction": ("parameter:constant_load",),
    "pressure_dependent_flow": ("parameter:edge_b", "parameter:line_loss"),
}
"""Causes that mean nothing without another."""


def diagnose_bench(dataset_folder: str | Path) -> BenchDiagnosis:
    """Diagnose an actuator bench.

    Every combination of causes is fitted with the prototype's tolerances as priors, once to everything and once without
    each condition. Probabilities follow from the predictive densities of the conditions left out (pseudo-Bayesian
    model averaging with a Bayesian bootstrap over conditions; Yao, Vehtari, Simpson and Gelman, Bayesian Analysis 13
    (2018) 917), so that one condition cannot decide alone; every further cause starts at the odds of
    `Thresholds.bench_odds`, and what moves a figure out of its tolerance pays for it.

    Raises:
        InputError: for data that cannot be used; see `read_bench_set` and `steady_motions`.
    """
    return diagnose_bench_set(read_bench_set(dataset_folder))


def diagnose_bench_set(data: BenchSet, among: Sequence[BenchHypothesis] | None = None) -> BenchDiagnosis:
    """Diagnose an actuator bench from what `read_bench_set` gives; see `diagnose_bench`.

    Args:
        data: the runs.
        among: candidates, with the one of no cause and of every chosen set less one cause; all where not given.
    """
    motions = steady_motions(data)
    actuator = data.prototype.actuator
    seen = observations(motions, actuator.asymmetry, data.prototype.servovalve.null_V)
    floor = scatter(seen, actuator.supply_pressure_Pa)
    known = nominal(data.prototype)[0]
    tried = [held_out(data.prototype, hypothesis, seen, floor) for hypothesis in among or candidates(known)]
    weights = probabilities(tried, data.conditions)
    order = np.argsort(-weights, kind="stable")
    ranked = tuple(replace(tried[k], probability=float(weights[k])) for k in order)
    marginal = _marginals(ranked)
    best = _responsible(ranked, marginal)
    replayed = replay_errors(data, best)
    gap = _gap(data.prototype, ranked, best, seen, floor, replayed)
    marginal = {name: probability for name, probability in marginal.items() if name not in known.names}
    strained = any(each.fit.flags for each in ranked if each.hypothesis == known)
    verdict, reason = _verdict([name for name in best.hypothesis.names if name in marginal], gap, marginal, strained)
    chosen = () if verdict == "no_gap" else tuple(name for name in best.hypothesis.names if name in marginal)
    causes = _causes(data.prototype, ranked, best, gap, marginal, chosen)
    table = condition_rows(data.prototype, motions, best)
    zero = float(np.median([m.rest_m for m in motions if m.direction < 0]))
    readings = {"displacement_zero_m": zero, "displacement_most_m": saturates_at(data)}
    notes = notes_on(ranked, best, marginal, len(data.conditions), known) if chosen else ()
    return BenchDiagnosis(
        data.name,
        verdict,
        reason,
        causes,
        chosen,
        np.nan,
        where_of(table, actuator.stroke_m, causes, chosen),
        gap,
        (),
        _next_experiment(ranked, seen) if verdict in ("ambiguous", "unknown") else None,
        updated_prototype(data.prototype, best.fit, **readings) if chosen else data.prototype,
        data.warnings,
        hypotheses=_sets(ranked, gap),
        notes=(*notes, *_still(data.prototype)),
        ranked=ranked,
        table=table,
        replay=replayed,
    )


def _still(prototype: BenchPrototype) -> tuple[str, ...]:
    left = [name for name in prototype.effects if name not in STEADY_EFFECTS]
    return (f"not looked at, having no part in steady motion: {', '.join(left)}",) if left else ()


def _sets(ranked: Sequence[HeldOut], gap: Gap) -> tuple[CauseSet, ...]:
    """Sets of causes, whatever friction's law, most probable first; of errors on conditions held out."""
    by_names: dict[tuple[str, ...], list[HeldOut]] = {}
    for each in ranked:
        by_names.setdefault(each.hypothesis.names, []).append(each)
    explainable = max(gap.tuned**2 - gap.noise_floor**2, 1e-12)
    found = [
        CauseSet(
            names,
            sum(each.probability for each in alike),
            (min(each.total for each in alike) ** 2 - gap.noise_floor**2) / explainable,
        )
        for names, alike in by_names.items()
    ]
    return tuple(sorted(found, key=lambda one: -one.probability))


def probabilities(tried: Sequence[HeldOut], conditions: Sequence[str]) -> np.ndarray:
    """Probability of each candidate, see `diagnose_bench`."""
    densities = np.array([[each.density[c] for c in conditions] for each in tried])
    prior = np.array([each.fit.hypothesis.causes for each in tried]) * THRESHOLDS.bench_odds
    share = np.random.default_rng(0).dirichlet(np.ones(len(conditions)), _DRAWS) * len(conditions)
    strain = np.array([each.fit.strain for each in tried])
    score = share @ densities.T + prior - strain / 2
    weight = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray((weight / weight.sum(axis=1, keepdims=True)).mean(axis=0))


def _marginals(ranked: Sequence[HeldOut]) -> dict[str, float]:
    names = sorted({name for each in ranked for name in each.hypothesis.names})
    return {name: sum(each.probability for each in ranked if name in each.hypothesis.names) for name in names}


def _responsible(ranked: Sequence[HeldOut], marginal: Mapping[str, float]) -> HeldOut:
    """The median probability model: all causes that are more likely at work than not.

    It predicts best where candidates are all combinations (Barbieri and Berger, Annals of Statistics 32 (2004) 870).
    """
    names = tuple(sorted(name for name, probability in marginal.items() if probability > THRESHOLDS.bench_likely))
    return next(each for each in ranked if each.hypothesis.names == names)


def _gap(
    prototype: BenchPrototype,
    ranked: Sequence[HeldOut],
    best: HeldOut,
    seen: Observations,
    floor: Mapping[str, float],
    replayed: Sequence[ReplayError],
) -> Gap:
    known, figures = nominal(prototype)
    retuned = next(each for each in ranked if each.hypothesis == known)
    rows = []
    for condition in best.error:
        left = seen.of([condition])
        missed = averaged(left, errors(left, figures, known.orifices, prototype.actuator.supply_pressure_Pa))
        runs = {"speed": len(left.volts) / 2} | {f"pressure_{s}": np.sum(left.side == s) / 2 for s in "ab"}
        noise = [floor[channel] ** 2 / runs[channel] for channel in CHANNELS]
        tuned, after = ([value**2 for value in each.error[condition].values()] for each in (retuned, best))
        rows.append([np.mean(squares) for squares in (np.square(list(missed.values())), tuned, after, noise)])
    return gap_of_pieces(np.sqrt(rows), rows_of(replayed), 1, _DRAWS)


def _verdict(names: Sequence[str], gap: Gap, marginal: Mapping[str, float], strained: bool) -> tuple[Verdict, str]:
    errors_text = f"Held-out error {gap.before:.3f} before, {gap.after:.3f} after, {gap.noise_floor:.3f} of it noise."
    open_ = [name for name, p in marginal.items() if 1 - THRESHOLDS.bench_sure < p < THRESHOLDS.bench_sure]
    sure = [name for name in names if name not in open_]
    if gap.before < THRESHOLDS.bench_sound * gap.noise_floor or (
        gap.tuned < THRESHOLDS.bench_sound * gap.noise_floor and not strained
    ):
        return "no_gap", f"The prototype predicts the bench within its tolerances. {errors_text}"
    if not names or gap.closed < THRESHOLDS.bench_likely:
        return "unknown", f"No set of causes known here explains the better part of the gap. {errors_text}"
    if open_:
        listed = ", ".join(f"{name} ({marginal[name]:.2f})" for name in open_)
        certain = " + ".join(sure) or "no single cause"
        return "ambiguous", f"Responsible beyond doubt: {certain}; not decided: {listed}. {errors_text}"
    return "effect", f"Responsible: {' + '.join(names)}. {errors_text}"


def _causes(
    prototype: BenchPrototype,
    ranked: Sequence[HeldOut],
    best: HeldOut,
    gap: Gap,
    marginal: Mapping[str, float],
    chosen: Sequence[str],
) -> tuple[Cause, ...]:
    named = parameters(prototype, best.hypothesis.names, best.fit.values, best.fit.standard_errors)
    found = []
    for name, probability in marginal.items():
        share = 0.0
        if name in chosen:
            rest = set(best.hypothesis.names) - {name, *_GO_WITH.get(name, ())}
            without = min(r.total for r in ranked if set(r.hypothesis.names) == rest)
            share = (without**2 - gap.after**2) / max(gap.before**2 - gap.noise_floor**2, 1e-12)
            share = min(max(share, 0.0), 1.0)
        found.append(Cause(name, subsystem(name), float(probability), float(share), named.get(name, {})))
    return tuple(sorted(found, key=lambda cause: (-round(cause.probability, 3), -cause.share)))


def _next_experiment(ranked: Sequence[HeldOut], seen: Observations) -> NextExperiment:
    """Where the predictions of what is still probable lie apart the most."""
    largest, least = float(np.abs(seen.volts).max()), float(np.abs(seen.volts).min())
    grid = np.round(np.geomspace(0.3 * least, 1.5 * largest, 25), 2)
    alive = [each for each in ranked if each.probability > 0.01] or list(ranked[:2])
    weight = np.array([each.probability for each in alive])
    weight /= weight.sum()
    deviation = alive[0].fit.deviation
    best = (0.0, float(grid[0]), "speed")
    for sign in (1, -1):
        found = [steady(NOTHING | each.fit.values, sign * grid, each.hypothesis.orifices) for each in alive]
        supply = alive[0].fit.values["supply_pressure"]
        speed = np.array([each.speed for each in found])
        channels = {"speed": speed / (weight @ speed)}
        channels |= {f"pressure_{s}": np.array([each.pressure(s) for each in found]) / supply for s in "ab"}
        for channel, values in channels.items():
            spread = np.sqrt(weight @ (values - weight @ values) ** 2) / deviation[channel]
            k = int(np.argmax(spread))
            if spread[k] > best[0]:
                best = (float(spread[k]), float(grid[k]), channel)
    return asked_for(*best, ranked)


_CLOSE = 0.8  # correlation from which two figures are told as one
_FEW = 5


def notes_on(
    ranked: Sequence[HeldOut], best: HeldOut, marginal: Mapping[str, float], conditions: int, known: BenchHypothesis
) -> Iterator[str]:
    """Notes on what is uncertain and why."""
    if conditions < _FEW:
        yield f"{conditions} conditions are few: probabilities follow from how each is predicted without the others"
    yield from _greedy(ranked, best, known)
    yield from _frictions(ranked)
    yield from (f"cannot be told apart: {words}" for words in correlated(best.fit))
    yield from _rest(best)
    undecided = [name for name, p in marginal.items() if 0.1 < p < 0.9]
    if len(undecided) > 1:
        yield f"not decided by these conditions: {', '.join(undecided)}"
    yield from best.fit.flags
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


def _greedy(ranked: Sequence[HeldOut], best: HeldOut, known: BenchHypothesis) -> Iterator[str]:
    """What adding one cause at a time would have found, against the chosen set."""
    error = {each.hypothesis: each.total for each in ranked}
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


def _rest(best: HeldOut) -> Iterator[str]:
    """Which prediction is off most on conditions held out."""
    worst = max(
        ((value, channel, condition) for condition, each in best.error.items() for channel, value in each.items())
    )
    yield f"what is left is largest in {worst[1]} at {worst[2]}: {100 * worst[0]:.1f} %"


def _parts(hypothesis: BenchHypothesis) -> set[str]:
    return set(hypothesis.names) | ({"stribeck"} if hypothesis.friction == "stribeck" else set())


def _frictions(ranked: Sequence[HeldOut]) -> Iterator[str]:
    kinds: dict[str, float] = {}
    for each in ranked:
        kinds[each.hypothesis.friction] = kinds.get(each.hypothesis.friction, 0.0) + each.probability
    listed = ", ".join(f"{kind} {p:.2f}" for kind, p in sorted(kinds.items(), key=lambda item: -item[1]) if p > 0.01)
    yield f"friction by kind: {listed}"
