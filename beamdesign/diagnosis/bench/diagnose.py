"""Diagnosis of an actuator bench from its steady motions, with its records replayed as a check, and in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf
from typing import Any

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.bench.data import BenchSet, saturates_at
from beamdesign.diagnosis.bench.fit import HeldOut, SteadyEvidence, held_out, moving, replayed, updated_prototype
from beamdesign.diagnosis.bench.hypothesis import (
    FRICTIONS,
    ORIFICES,
    STEADY_EFFECTS,
    BenchHypothesis,
    SteadyPlacement,
    candidates,
    laws,
    nominal,
    parameters,
    subsystem,
)
from beamdesign.diagnosis.bench.motions import CHANNELS, Observations, steady_motions, way_of
from beamdesign.diagnosis.diagnosis import Cause, CauseSet, Diagnosis, Gap, Indicator, NextExperiment, Verdict, Where
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.gap_metrics import gap_of_pieces
from beamdesign.diagnosis.judgement import SUSPICIOUS, THRESHOLDS, Judgement

_DRAWS = 4000
_GO_WITH = {
    "seal_friction": ("parameter:constant_load",),
    "pressure_dependent_flow": ("parameter:edge_b", "parameter:line_loss"),
}
"""Causes that mean nothing without another."""


@dataclass(frozen=True)
class BenchDiagnosis(Diagnosis[BenchPrototype]):
    """A diagnosis from steady motions; its gap is that of these on conditions held out.

    Its rows are of simulated records, by condition and channel; nothing lies between believed and diagnosed there.

    Attributes:
        ranked: sets of causes that were fitted, most probable first.
    """

    MEASURE = (
        "Together: relative errors of steady speed and of chamber pressures over the supply, each condition predicted"
        " from the others. By condition: errors of the simulated records over the stroke or the supply pressure."
    )

    ranked: tuple[HeldOut, ...] = field(default=(), repr=False)


def diagnose_bench(data: BenchSet, among: Sequence[BenchHypothesis] | None = None) -> BenchDiagnosis:
    """Diagnose an actuator bench from what `read_bench_set` gives.

    Every combination of causes is fitted with the prototype's tolerances as priors, once to everything and once without
    each condition. Probabilities follow from the predictive densities of the conditions left out (pseudo-Bayesian
    model averaging with a Bayesian bootstrap over conditions; Yao, Vehtari, Simpson and Gelman, Bayesian Analysis 13
    (2018) 917), so that one condition cannot decide alone; a set of causes that leaves more of the speeds or pressures
    than their replicates scatter is none where another leaves no more; every further cause starts at the odds of
    `Thresholds.bench_odds`, and what moves a figure out of its tolerance pays for it.

    Args:
        data: the runs.
        among: candidates, with the one of no cause and of every chosen set less one cause; all where not given.

    Raises:
        InputError: for runs that do not move steadily; see `steady_motions`.
    """
    rig, actuator = data.prototype, data.prototype.actuator
    seen = steady_motions(data)
    known, figures = nominal(rig)
    tried = [held_out(rig, hypothesis, seen) for hypothesis in among or candidates(known)]
    weights = probabilities(tried, seen.conditions)
    ranked = tuple(replace(tried[k], probability=float(weights[k])) for k in np.argsort(-weights, kind="stable"))
    judged = Judgement({each.hypothesis: each.probability for each in ranked}, 0.0, ranked[0].fit)
    every = {name for names in judged.of_causes for name in names}
    new = {name: judged.cause(name) for name in sorted(every - set(known.causes))}
    retuned = next(each for each in ranked if each.hypothesis == known)
    # The median probability model predicts best where candidates are all combinations (Barbieri and Berger, Annals of
    # Statistics 32 (2004) 870): all causes that are more likely at work than not.
    likely = tuple(sorted(name for name in every if judged.cause(name) > THRESHOLDS.bench_likely))
    best = next(each for each in ranked if each.hypothesis.causes == likely)
    gap = replace(_gap(retuned, best, figures, seen), records=replayed(data, best))
    strained = any(True for _ in strains(retuned.fit))
    verdict, reason = _verdict([name for name in likely if name in new], gap, new, strained)
    chosen = () if verdict == "no_gap" else tuple(name for name in likely if name in new)
    causes = _causes(rig, ranked, best, gap, new, chosen)
    zero = float(np.median([m.rest_m for m in seen.motions if m.direction < 0]))
    readings = {"displacement_zero_m": zero, "displacement_most_m": saturates_at(data)}
    notes = notes_on(ranked, best, new, len(seen.conditions), known) if chosen else ()
    left = [name for name in rig.effects if name not in STEADY_EFFECTS]
    still = (f"not looked at, having no part in steady motion: {', '.join(left)}",) if left else ()
    return BenchDiagnosis(
        data.name,
        verdict,
        reason,
        causes,
        chosen,
        np.nan,
        where_of(motion_table(rig, seen, best), actuator.stroke_m, causes, chosen),
        gap,
        (),
        _next_experiment(ranked, seen) if verdict in ("ambiguous", "unknown") else None,
        updated_prototype(rig, best.fit, **readings) if chosen else rig,
        data.warnings,
        hypotheses=_sets(ranked, judged, gap),
        notes=(*notes, *still),
        ranked=ranked,
    )


def _sets(ranked: Sequence[HeldOut], judged: Judgement, gap: Gap) -> tuple[CauseSet, ...]:
    """Sets of causes, whatever friction's law, most probable first; of errors on conditions held out."""
    explainable = max(gap.tuned**2 - gap.noise_floor**2, 1e-12)
    least: dict[tuple[str, ...], float] = {}
    for each in ranked:
        names = each.hypothesis.causes
        least[names] = min(each.total, least.get(names, inf))
    return tuple(
        CauseSet(names, p, (least[names] ** 2 - gap.noise_floor**2) / explainable)
        for names, p in judged.of_causes.items()
    )


def probabilities(tried: Sequence[HeldOut], conditions: Sequence[str]) -> np.ndarray:
    """Probability of each candidate, see `diagnose_bench`."""
    densities = np.array([[each.density[c] for c in conditions] for each in tried])
    prior = np.array([each.hypothesis.size for each in tried]) * THRESHOLDS.bench_odds
    share = np.random.default_rng(0).dirichlet(np.ones(len(conditions)), _DRAWS) * len(conditions)
    figures = [[z for u, z in zip(t.fit.unknowns, t.fit.z, strict=True) if u.kind == "figure"] for t in tried]
    score = share @ densities.T + prior - np.sum(np.square(figures), axis=1) / 2
    # What leaves more of a channel than replicates scatter is out where something else does not.
    for channel in CHANNELS:
        fits = np.array([each.lack[channel] >= THRESHOLDS.bench_lack for each in tried])
        score = np.where(fits | ~fits.any(), score, -inf)
    weight = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray((weight / weight.sum(axis=1, keepdims=True)).mean(axis=0))


def _gap(retuned: HeldOut, best: HeldOut, figures: Mapping[str, float], seen: Observations) -> Gap:
    plain = SteadyPlacement((), ORIFICES in retuned.hypothesis.names, figures)
    rows = []
    for condition in seen.conditions:
        found, missed = SteadyEvidence(seen, seen.scatter).left(condition, plain, np.zeros(0))
        noise = [seen.scatter[channel] ** 2 / (len(found[channel]) / 2) for channel in CHANNELS]
        tuned, after = ([value**2 for value in each.error[condition].values()] for each in (retuned, best))
        rows.append([np.mean(squares) for squares in (np.square(list(missed.values())), tuned, after, noise)])
    return gap_of_pieces(np.sqrt(rows), (), 1, _DRAWS)


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
    named = parameters(prototype, best.fit)
    found = []
    for name, probability in marginal.items():
        share = 0.0
        if name in chosen:
            rest = set(best.hypothesis.causes) - {name, *_GO_WITH.get(name, ())}
            without = min(r.total for r in ranked if set(r.hypothesis.causes) == rest)
            share = (without**2 - gap.after**2) / max(gap.before**2 - gap.noise_floor**2, 1e-12)
            share = min(max(share, 0.0), 1.0)
        found.append(Cause(name, subsystem(name), float(probability), float(share), named.get(name, {})))
    return tuple(sorted(found, key=lambda cause: (-round(cause.probability, 3), -cause.share)))


def _next_experiment(ranked: Sequence[HeldOut], seen: Observations) -> NextExperiment:
    """A run at a command both ways, where the predictions of what is still probable lie apart the most."""
    largest, least = float(np.abs(seen.volts).max()), float(np.abs(seen.volts).min())
    grid = np.round(np.geomspace(0.3 * least, 1.5 * largest, 25), 2)
    alive = [each for each in ranked if each.probability > 0.01] or list(ranked[:2])
    weight = np.array([each.probability for each in alive])
    weight /= weight.sum()
    separation, command_V, channel = 0.0, float(grid[0]), "speed"
    for sign in (1, -1):
        found = [moving(each.fit, sign * grid) for each in alive]
        for name in CHANNELS:
            values = np.array([each[name] for each in found])
            values /= weight @ values if name == "speed" else alive[0].fit.values["supply_pressure"]
            spread = np.sqrt(weight @ (values - weight @ values) ** 2) / alive[0].deviation[name]
            k = int(np.argmax(spread))
            if spread[k] > separation:
                separation, command_V, channel = float(spread[k]), float(grid[k]), name
    text = (
        f"Run the piston out and back at {command_V:.3g} V and measure {channel.replace('_', ' ')}:"
        " there the sets of causes that are left differ most."
    )
    names = tuple(" + ".join(each.hypothesis.causes) or "no cause" for each in ranked[:4])
    return NextExperiment(text, names, separation, {"command_V": command_V, "channel": channel})


_CLOSE = 0.8  # correlation from which two figures are told as one
_FEW = 5
_AT_BOUND = 1e-3  # of a prior standard deviation


def notes_on(
    ranked: Sequence[HeldOut], best: HeldOut, marginal: Mapping[str, float], conditions: int, known: BenchHypothesis
) -> Iterator[str]:
    """Notes on what is uncertain and why."""
    if conditions < _FEW:
        yield f"{conditions} conditions are few: probabilities follow from how each is predicted without the others"
    yield from _greedy(ranked, best, known)
    kinds = dict.fromkeys(("none", *FRICTIONS), 0.0)
    for each in ranked:
        kinds[next((name for name in each.hypothesis.names if name in FRICTIONS), "none")] += each.probability
    shown = sorted(((kind, p) for kind, p in kinds.items() if p > 0.01), key=lambda item: -item[1])
    listed = ", ".join(f"{kind.removeprefix('seal_friction (').removesuffix(')')} {p:.2f}" for kind, p in shown)
    yield f"friction by kind: {listed}"
    yield from (f"cannot be told apart: {words}" for words in correlated(best.fit))
    left = ((value, channel, condition) for condition, each in best.error.items() for channel, value in each.items())
    value, channel, condition = max(left)
    yield f"what is left is largest in {channel} at {condition}: {100 * value:.1f} %"
    undecided = [name for name, p in marginal.items() if 0.1 < p < 0.9]
    if len(undecided) > 1:
        yield f"not decided by these conditions: {', '.join(undecided)}"
    yield from strains(best.fit)
    if ORIFICES not in best.hypothesis.names:
        yield "a linear valve says nothing of the chambers' mean pressure; supply and tank are shared between them here"


def strains(fit: Fit) -> Iterator[str]:
    """Figures at a bound, and figures more than two tolerances off, in words."""
    for u, z in zip(fit.unknowns, fit.z, strict=True):
        low, high = u.bounds
        # A cause that is not there is no bound to be driven to.
        if z > high - _AT_BOUND or (z < low + _AT_BOUND and low != 0):
            yield f"{u.name} is driven to its bound"
        elif u.kind == "figure" and abs(z) > SUSPICIOUS:
            yield f"{u.name} is moved by {abs(z):.1f} tolerances"


def correlated(fit: Fit) -> list[str]:
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
        nearer = [h for h in error if h.size == path[-1].size + 1 and set(path[-1].causes) <= set(h.causes)]
        step = min(nearer, key=lambda h: error[h], default=None)
        if step is None or error[step] >= error[path[-1]]:
            break
        path.append(step)
    if error[path[-1]] > error[best.hypothesis]:
        yield f"one cause at a time ends at {path[-1]} with a held-out error of {error[path[-1]]:.3f}"
    if known.names:
        return
    sides = "unequal_piston_areas"
    none, areas, root, both = (error[laws(*names)] for names in ((), (sides,), (ORIFICES,), (sides, ORIFICES)))
    if both < none <= 1.02 * min(areas, root):
        yield (
            f"areas and square-root flow help only together: held-out error {none:.3f} without, "
            f"{areas:.3f} with areas, {root:.3f} with square-root flow, {both:.3f} with both"
        )


def motion_table(prototype: BenchPrototype, seen: Observations, chosen: HeldOut) -> dict[str, tuple[Any, ...]]:
    """Columns of steady motion by condition and direction, with the speed by the fit without the condition.

    The net force A_a p_a - A_b p_b, with the areas of bore and rod, is what friction and load take.
    """
    actuator, rows = prototype.actuator, []
    for condition, direction in product(seen.conditions, (1, -1)):
        speed, volts = (seen.mean(column, condition, direction) for column in ("speed", "command_V"))
        a, b = (seen.mean("pressure", condition, direction, side) for side in "ab")
        force = actuator.piston_area_m2 * ((1 + actuator.asymmetry) * a - (1 - actuator.asymmetry) * b)
        (predicted,) = moving(chosen.without[condition], np.array([volts - seen.null_V]))["speed"]
        rows.append((condition, way_of(direction), speed, float(predicted), a, b, force))
    names = "condition", "direction", "speed_m_per_s", "predicted_m_per_s", "pressure_a_Pa", "pressure_b_Pa"
    return dict(zip((*names, "net_force_N"), zip(*rows, strict=True), strict=True))


def where_of(
    table: Mapping[str, tuple[Any, ...]], stroke_m: float, causes: Sequence[Cause], chosen: Sequence[str]
) -> Where:
    """Steady motion is slow: the band ends at the strokes per second of the fastest condition of a `motion_table`."""
    speeds = table["speed_m_per_s"]
    fastest = max(abs(speed) for speed in speeds) / stroke_m
    worst = int(np.argmax(np.abs(np.subtract(table["predicted_m_per_s"], speeds))))
    place = next((c.subsystem for c in causes if c.name in chosen), "")
    text = (
        "Speed and pressures while the piston moves steadily, against those of the chosen causes fitted without each"
        f" condition; the largest error of speed is left at {table['condition'][worst]}, {table['direction'][worst]}."
    )
    indicator = Indicator("steady motions", place, 1.0 if place else 0.0, text, table)
    condition = "in steady motion, at every command that was tried"
    return Where(place, (0.0, float(f"{fastest:.3g}")), condition if place else "", "static", (indicator,))
