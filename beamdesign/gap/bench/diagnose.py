"""Diagnosis of an actuator bench from its steady motions, with its records replayed as a check, and in words."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.gap.bench.data import BenchSet, read_bench_set, saturates_at
from beamdesign.gap.bench.diagnosis import BenchDiagnosis, Cause, ConditionRow, Gap, NextExperiment, Ranked
from beamdesign.gap.bench.fit import HeldOut, SteadyFit, held_out
from beamdesign.gap.bench.hypothesis import BenchHypothesis, candidates
from beamdesign.gap.bench.model import NOTHING, steady
from beamdesign.gap.bench.observed import CHANNELS, Observations, averaged, errors, observations, scatter
from beamdesign.gap.bench.priors import STEADY_EFFECTS, believed
from beamdesign.gap.bench.replay import amended, parameters, replay_errors
from beamdesign.gap.bench.steady import SteadyMotion, steady_motions
from beamdesign.rig.effects import library

__all__ = ["BenchDiagnosis", "diagnose_bench", "diagnose_bench_set", "probabilities"]

PRIOR_ODDS = 1 / 3
"""Of one more cause against none."""

_SURE, _LIKELY = 0.9, 0.5
_DRAWS = 4000
_SOUND = 3.0  # times the floor: a gap smaller than this is not worth a cause
_SUBSYSTEMS = {
    "parameter:piston_leakage": "actuator",
    "parameter:line_loss": "oil",
    "parameter:edge_b": "servovalve",
    "parameter:constant_load": "actuator",
    "parameter:flow_gain": "servovalve",
}
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
    (2018) 917), so that one condition cannot decide alone; every further cause starts at odds of `PRIOR_ODDS`,
    and what moves a figure out of its tolerance pays for it.

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
    known = believed(data.prototype)[0]
    tried = [held_out(data.prototype, hypothesis, seen, floor) for hypothesis in among or candidates(known)]
    weights = probabilities(tried, data.conditions)
    order = np.argsort(-weights, kind="stable")
    ranked = tuple(Ranked(tried[k].fit.hypothesis, float(weights[k]), tried[k]) for k in order)
    marginal = _marginals(ranked)
    best = _responsible(ranked, marginal)
    gap = _gap(data.prototype, ranked, best, seen, floor)
    marginal = {name: probability for name, probability in marginal.items() if name not in known.names}
    strained = any(each.held_out.fit.flags for each in ranked if each.hypothesis == known)
    verdict, reason = _verdict([name for name in best.hypothesis.names if name in marginal], gap, marginal, strained)
    chosen = () if verdict == "no_gap" else tuple(name for name in best.hypothesis.names if name in marginal)
    causes = _causes(data.prototype, ranked, best, gap, marginal, chosen)
    replayed = replay_errors(data, best.held_out)
    zero = float(np.median([m.rest_m for m in motions if m.direction < 0]))
    readings = {"displacement_zero_m": zero, "displacement_most_m": saturates_at(data)}
    found = amended(data.prototype, best.held_out.fit, **readings) if chosen else data.prototype
    return BenchDiagnosis(
        verdict,
        reason,
        chosen,
        causes,
        ranked,
        gap,
        _table(data.prototype, motions, best.held_out),
        replayed,
        all(each.after[channel] < each.before[channel] for each in replayed for channel in each.before),
        _next_experiment(ranked, seen) if verdict in ("ambiguous", "unknown") else None,
        found,
        tuple(notes_on(ranked, best, marginal, len(data.conditions), known) if chosen else ()) + _still(data.prototype),
        data.warnings,
    )


def _still(prototype: BenchPrototype) -> tuple[str, ...]:
    left = [name for name in prototype.effects if name not in STEADY_EFFECTS]
    return (f"not looked at, having no part in steady motion: {', '.join(left)}",) if left else ()


def probabilities(tried: Sequence[HeldOut], conditions: Sequence[str]) -> np.ndarray:
    """Probability of each candidate, see `diagnose_bench`."""
    densities = np.array([[each.density[c] for c in conditions] for each in tried])
    prior = np.array([each.fit.hypothesis.causes for each in tried]) * np.log(PRIOR_ODDS)
    share = np.random.default_rng(0).dirichlet(np.ones(len(conditions)), _DRAWS) * len(conditions)
    strain = np.array([each.fit.strain for each in tried])
    score = share @ densities.T + prior - strain / 2
    weight = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray((weight / weight.sum(axis=1, keepdims=True)).mean(axis=0))


def _marginals(ranked: Sequence[Ranked]) -> dict[str, float]:
    names = sorted({name for each in ranked for name in each.hypothesis.names})
    return {name: sum(each.probability for each in ranked if name in each.hypothesis.names) for name in names}


def _responsible(ranked: Sequence[Ranked], marginal: Mapping[str, float]) -> Ranked:
    """The median probability model: all causes that are more likely at work than not.

    It predicts best where candidates are all combinations (Barbieri and Berger, Annals of Statistics 32 (2004) 870).
    """
    names = tuple(sorted(name for name, probability in marginal.items() if probability > _LIKELY))
    return next(each for each in ranked if each.hypothesis.names == names)


def _gap(
    prototype: BenchPrototype, ranked: Sequence[Ranked], best: Ranked, seen: Observations, floor: Mapping[str, float]
) -> Gap:
    supply = prototype.actuator.supply_pressure_Pa
    conditions = list(dict.fromkeys(seen.condition.tolist()))
    known, figures = believed(prototype)
    before, after, noise = [], [], []
    for condition in conditions:
        left = seen.of([condition])
        missed = averaged(left, errors(left, figures, known.orifices, supply))
        before.append(np.mean([np.mean(missed[channel] ** 2) for channel in CHANNELS]))
        after.append(np.mean([value**2 for value in best.held_out.error[condition].values()]))
        runs = {"speed": len(left.volts) / 2} | {f"pressure_{s}": np.sum(left.side == s) / 2 for s in "ab"}
        noise.append(np.mean([floor[channel] ** 2 / runs[channel] for channel in CHANNELS]))
    b, a, f = np.array(before), np.array(after), np.array(noise)
    pick = np.random.default_rng(1).integers(len(conditions), size=(_DRAWS, len(conditions)))
    closed = _closed(b[pick].mean(axis=1), a[pick].mean(axis=1), f[pick].mean(axis=1))
    low, high = np.quantile(closed, [0.05, 0.95])
    retuned = next(each for each in ranked if each.hypothesis == known)
    return Gap(
        float(np.sqrt(b.mean())),
        retuned.held_out.total,
        float(np.sqrt(a.mean())),
        float(np.sqrt(f.mean())),
        float(_closed(b.mean(), a.mean(), f.mean())),
        (float(low), float(high)),
    )


def _closed(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    return np.asarray((before - after) / np.maximum(before - floor, 1e-12))


def _verdict(names: Sequence[str], gap: Gap, marginal: Mapping[str, float], strained: bool) -> tuple[str, str]:
    told = f"Held-out error {gap.before:.3f} before, {gap.after:.3f} after, {gap.noise_floor:.3f} of it noise."
    open_ = [name for name, p in marginal.items() if 1 - _SURE < p < _SURE]
    sure = [name for name in names if name not in open_]
    if gap.before < _SOUND * gap.noise_floor or (gap.retuned < _SOUND * gap.noise_floor and not strained):
        return "no_gap", f"The prototype predicts the bench within its tolerances. {told}"
    if not names or gap.closed < _LIKELY:
        return "unknown", f"No set of causes known here explains the better part of the gap. {told}"
    if open_:
        listed = ", ".join(f"{name} ({marginal[name]:.2f})" for name in open_)
        certain = " + ".join(sure) or "no single cause"
        return "ambiguous", f"Responsible beyond doubt: {certain}; not decided: {listed}. {told}"
    return "effect", f"Responsible: {' + '.join(names)}. {told}"


def _causes(
    prototype: BenchPrototype,
    ranked: Sequence[Ranked],
    best: Ranked,
    gap: Gap,
    marginal: Mapping[str, float],
    chosen: Sequence[str],
) -> tuple[Cause, ...]:
    named = parameters(prototype, best.held_out.fit)
    found = []
    for name, probability in marginal.items():
        share = 0.0
        if name in chosen:
            rest = set(best.hypothesis.names) - {name, *_GO_WITH.get(name, ())}
            without = min(r.held_out.total for r in ranked if set(r.hypothesis.names) == rest)
            share = (without**2 - gap.after**2) / max(gap.before**2 - gap.noise_floor**2, 1e-12)
            share = min(max(share, 0.0), 1.0)
        subsystem = _SUBSYSTEMS[name] if name in _SUBSYSTEMS else library()[name].subsystem
        found.append(Cause(name, subsystem, float(probability), float(share), named.get(name, {})))
    return tuple(sorted(found, key=lambda cause: (-round(cause.probability, 3), -cause.share)))


def _table(prototype: BenchPrototype, motions: Sequence[SteadyMotion], chosen: HeldOut) -> tuple[ConditionRow, ...]:
    actuator = prototype.actuator
    areas = {
        1: actuator.piston_area_m2 * (1 + actuator.asymmetry),
        -1: actuator.piston_area_m2 * (1 - actuator.asymmetry),
    }
    supply = float(np.mean([m.stall for m in motions if (m.direction > 0) == (m.side == "a")]))
    tank = float(np.mean([m.stall for m in motions if (m.direction > 0) == (m.side == "b")]))
    rows = []
    for condition, direction in dict.fromkeys((m.condition, m.direction) for m in motions):
        own = [m for m in motions if (m.condition, m.direction) == (condition, direction)]
        speeds = np.array([m.speed for m in own])
        a, b = (float(np.mean([m.pressure for m in own if m.side == side])) for side in "ab")
        full, empty = (a, b) if direction > 0 else (b, a)
        speed, volts = float(speeds.mean()), own[0].command_V
        into, out = areas[direction] * abs(speed), areas[-direction] * abs(speed)
        opening = (into / max(supply - full, 1.0) ** 0.5, out / max(empty - tank, 1.0) ** 0.5)
        fitted = chosen.without[condition]
        opened = volts - prototype.servovalve.null_V
        found = steady(NOTHING | fitted.values, np.array([opened]), fitted.hypothesis.orifices)
        rows.append(
            ConditionRow(
                condition,
                direction,
                volts,
                speed,
                float(speeds.std(ddof=1)) if len(speeds) > 1 else 0.0,
                (a, b),
                areas[1] * a - areas[-1] * b,
                opening,
                (float(found.speed[0]), float(found.pressure_a[0]), float(found.pressure_b[0])),
            )
        )
    return tuple(rows)


def _next_experiment(ranked: Sequence[Ranked], seen: Observations) -> NextExperiment:
    """Where the predictions of what is still probable lie apart the most."""
    largest, least = float(np.abs(seen.volts).max()), float(np.abs(seen.volts).min())
    grid = np.round(np.geomspace(0.3 * least, 1.5 * largest, 25), 2)
    alive = [each for each in ranked if each.probability > 0.01] or list(ranked[:2])
    weight = np.array([each.probability for each in alive])
    weight /= weight.sum()
    deviation = alive[0].held_out.fit.deviation
    best = NextExperiment(float(grid[0]), "speed", 0.0)
    for sign in (1, -1):
        found = [steady(NOTHING | each.held_out.fit.values, sign * grid, each.hypothesis.orifices) for each in alive]
        supply = alive[0].held_out.fit.values["supply_pressure"]
        speed = np.array([each.speed for each in found])
        channels = {"speed": speed / (weight @ speed)}
        channels |= {f"pressure_{s}": np.array([each.pressure(s) for each in found]) / supply for s in "ab"}
        for channel, values in channels.items():
            spread = np.sqrt(weight @ (values - weight @ values) ** 2) / deviation[channel]
            k = int(np.argmax(spread))
            if spread[k] > best.separation:
                best = NextExperiment(float(grid[k]), channel, float(spread[k]))
    return best


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
