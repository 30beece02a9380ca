"""Diagnosis of an actuator bench from its steady motions, with its records replayed as a check, and in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from math import inf, nan
from typing import Any

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.data.bench_set import BenchRun, BenchSet, held, saturates_at
from beamdesign.diagnosis.diagnosis import (
    Cause,
    Diagnosis,
    Estimate,
    Gap,
    Indicator,
    NextExperiment,
    RecordGap,
    Verdict,
    Where,
    no_surer,
)
from beamdesign.diagnosis.examination.scattered_runs import without_scattered
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, together
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.fitting.steady_evidence import (
    AREAS,
    FRICTION,
    FRICTIONS,
    ORIFICES,
    STEADY_EFFECTS,
    HeldOut,
    candidates,
    correlated,
    gauge_doubts,
    held_out,
    moving,
    nominal_causes,
    nominal_evidence,
    size,
)
from beamdesign.diagnosis.fitting.steady_motion import CHANNELS, Observations, averaged, way_of
from beamdesign.diagnosis.gap_metrics import gap_of_pieces
from beamdesign.diagnosis.judgement import (
    SUSPICIOUS,
    Judgement,
    cause_sets,
    causes,
    flags,
    parameters,
    share_of,
)
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.diagnosis.verdict import sentences
from beamdesign.plant.bench_simulation import BENCH_COLUMNS, BENCH_STATED, replay
from beamdesign.plant.effects import library
from beamdesign.progress import Progress, silent
from beamdesign.records import InputError
from beamdesign.time_limit import left_out, while_time

_DRAWS = 4000


def diagnose_bench(
    data: BenchSet, among: Sequence[Hypothesis] | None = None, progress: Progress = silent
) -> Diagnosis[BenchPrototype]:
    """Diagnose an actuator bench from what `read_bench_set` gives.

    Every combination of causes is fitted with the prototype's tolerances as priors, once to everything and once without
    each condition; its gap, shares of causes and misfits in `search` are those of conditions left out. Rows of the gap
    are of simulated records, by condition and channel; nothing lies between believed and diagnosed there.

    Args:
        data: the runs.
        among: candidates, with the one of no cause and of every chosen set less one cause; all where not given.
        progress: told the share done and what is being fitted.

    Raises:
        InputError: for runs that do not move steadily; see `steady_motions`.
    """
    rig, (data, seen) = data.prototype, without_scattered(data)
    known = nominal_causes(rig)
    order = sorted(among or candidates(known), key=lambda one: (one != known, size(one)))  # the least first
    tried = list[HeldOut]()
    for one in while_time(order, least=1):
        progress(len(tried) / len(order), str(one))
        tried.append(held_out(rig, one, seen))
    return bench_diagnosis(data, seen, tried)


def bench_diagnosis(data: BenchSet, seen: Observations, tried: Sequence[HeldOut]) -> Diagnosis[BenchPrototype]:
    """What follows from candidates that were fitted, see `diagnose_bench`."""
    rig, known, weights = data.prototype, nominal_causes(data.prototype), probabilities(tried, seen.conditions)
    by_hypothesis = {tried[k].hypothesis: tried[k] for k in np.argsort(-weights, kind="stable")}
    ranked, retuned = tuple(by_hypothesis.values()), by_hypothesis[known]
    judged = Judgement({h: float(weights[tried.index(one)]) for h, one in by_hypothesis.items()}, nan, retuned.fit)
    # The median probability model predicts best where candidates are all combinations (Barbieri and Berger, Annals of
    # Statistics 32 (2004) 870): all causes that are more likely at work than not.
    every = sorted({name for names in judged.of_causes for name in names})
    likely = tuple(name for name in every if judged.cause(name) > THRESHOLDS.bench_likely)
    best = next((one for one in ranked if one.hypothesis.causes == likely), ranked[0])  # the first where time was up
    judged, lacking = replace(judged, best=best.fit), left_out()
    rows: tuple[RecordGap, ...] = ()
    idle = ", ".join(name for name in rig.effects if name not in STEADY_EFFECTS)
    still = [f"not looked at, having no part in steady motion: {idle}"] * bool(idle)
    try:
        rows = replayed(data, best)
    except InputError as error:  # steady motion tells what it tells without
        still.append(f"no record is simulated beside: {'; '.join(problem.reason for problem in error.problems)}")
    gap = replace(_gap(rig, retuned, best, seen), records=rows)
    found = Search(retuned.left_out, tuple(one.left_out for one in ranked if one is not retuned), gap.noise_floor**2)
    new = tuple(_with_values(rig, c, best, found) for c in causes(found, judged) if c.name not in known.causes)
    undecided = [c.name for c in new if 1 - THRESHOLDS.bench_sure < c.probability < THRESHOLDS.bench_sure]
    named = tuple(sorted({*best.hypothesis.causes} - {*known.causes}))
    doubts = gauge_doubts(rig, best.fit, seen)
    verdict = no_surer(_verdict(gap, bool(named), bool(undecided or doubts or data.doubtful), retuned.fit), lacking)
    chosen = () if verdict == "no_gap" else named
    where = where_of(motion_table(rig, seen, best), rig.actuator.stroke_m, new, chosen)
    words = f"Held-out error {gap.before:.3f} before, {gap.after:.3f} after, {gap.noise_floor:.3f} of it noise."
    zero = float(np.median([m.rest_m for m in seen.motions if m.direction < 0]))
    readings = {"displacement_zero_m": zero, "displacement_most_m": saturates_at(data)}
    notes = notes_on(ranked, judged, best, undecided, known) if chosen else ()
    return Diagnosis(
        data.name,
        verdict,
        sentences(verdict, new, chosen, words, where, complete=not lacking),
        new,
        chosen,
        nan,
        where,
        gap,
        (),
        _next_experiment(rig, ranked, judged, seen) if verdict in ("ambiguous", "unknown") and not lacking else None,
        updated_prototype(rig, best.fit, **readings) if chosen else rig,
        data.warnings + doubts,
        found,
        hypotheses=cause_sets(found, judged),
        notes=(*notes, *still),
        judged=judged,
        written=best.fit if chosen else retuned.fit,
        measure=(
            "Together: relative errors of steady speed and of chamber pressures over the supply, each condition"
            " predicted from the others. By condition: errors of the simulated records over the stroke or the supply"
            " pressure."
        ),
        left_out=lacking,
    )


def _with_values(rig: BenchPrototype, cause: Cause, best: HeldOut, found: Search) -> Cause:
    """A cause with its share in the chosen fit and the parameters it has there, by the names of the prototype."""
    fit = best.left_out
    if cause.name not in fit.hypothesis.causes:
        return replace(cause, parameters={}, flags=())
    share = share_of(cause.name, fit, found, {f.hypothesis: f for f in (found.null, *found.fits)})
    own = parameters(cause.name, fit, fit.standard_errors)
    own = {BENCH_STATED.get(name, name).rpartition(".")[2]: estimate for name, estimate in own.items()}
    if (gain := own.pop("flow_gain", None)) is not None:
        per_A = rig.servovalve.amplifier_A_per_V
        own["flow_gain_m3_per_s_per_V"] = Estimate(per_A * gain.value, per_A * gain.std)
    return replace(cause, share=share, parameters=own, flags=tuple(flags(cause.name, fit)))


def probabilities(tried: Sequence[HeldOut], conditions: Sequence[str]) -> np.ndarray:
    """Probability of each candidate, among these.

    They follow from the predictive densities of the conditions left out (pseudo-Bayesian model averaging with a
    Bayesian bootstrap over conditions; Yao, Vehtari, Simpson and Gelman, Bayesian Analysis 13 (2018) 917), so that one
    condition cannot decide alone; a set of causes that leaves more of the speeds or pressures than their replicates
    scatter is none where another leaves no more; every further cause starts at the odds of `Thresholds.bench_odds`, and
    what moves a figure out of its tolerance pays for it.
    """
    densities = np.array([[each.density[c] for c in conditions] for each in tried])
    prior = np.array([size(each.hypothesis) for each in tried]) * THRESHOLDS.bench_odds
    share = np.random.default_rng(0).dirichlet(np.ones(len(conditions)), _DRAWS) * len(conditions)
    moved = [[*each.fit.moved.values()] for each in tried]
    score = share @ densities.T + prior - np.sum(np.square(moved), axis=1) / 2
    # What leaves more of a channel than replicates scatter is out where something else does not.
    for channel in CHANNELS:
        fits = np.array([each.lack[channel] >= THRESHOLDS.bench_lack for each in tried])
        score = np.where(fits | ~fits.any(), score, -inf)
    weight = np.exp(score - score.max(axis=1, keepdims=True))
    return np.asarray((weight / weight.sum(axis=1, keepdims=True)).mean(axis=0))


def _gap(rig: BenchPrototype, retuned: HeldOut, best: HeldOut, seen: Observations) -> Gap:
    (whole, placement), rows = nominal_evidence(rig, retuned.hypothesis, seen), []
    for condition in seen.conditions:
        own = whole.of(condition)
        found = own.predicted(placement, np.zeros(0))
        missed = np.square(list(averaged(own.seen, found).values()))
        noise = [seen.scatter[channel] ** 2 / (len(found[channel]) / 2) for channel in CHANNELS]
        tuned, after = (np.square(list(one.error[condition].values())) for one in (retuned, best))
        rows.append([np.mean(squares) for squares in (missed, tuned, after, noise)])
    return gap_of_pieces(np.sqrt(rows), (), 1, _DRAWS)


def _verdict(gap: Gap, named: bool, undecided: bool, retuned: Fit) -> Verdict:
    sound = THRESHOLDS.bench_sound * gap.noise_floor
    if gap.before < sound or (gap.tuned < sound and all(abs(z) <= SUSPICIOUS for z in retuned.moved.values())):
        return "no_gap"
    if not named or gap.closed < THRESHOLDS.bench_likely:
        return "unknown"
    return "ambiguous" if undecided else "effect"


def _next_experiment(
    rig: BenchPrototype, ranked: Sequence[HeldOut], judged: Judgement, seen: Observations
) -> NextExperiment:
    """A run at a command both ways, where the predictions of what is still probable lie apart the most."""
    largest, least = float(np.abs(seen.volts).max()), float(np.abs(seen.volts).min())
    grid = np.round(np.geomspace(0.3 * least, 1.5 * largest, 25), 2)
    alive = [each for each in ranked if judged.of[each.hypothesis] > 0.01] or list(ranked[:2])
    weight = np.array([judged.of[each.hypothesis] for each in alive])
    weight /= weight.sum()
    separation, command_V, channel = 0.0, float(grid[0]), "speed"
    for sign in (1, -1):
        found = [moving(rig, each.fit, sign * grid) for each in alive]
        for name in CHANNELS:
            values = np.array([each[name] for each in found])
            values /= weight @ values if name == "speed" else seen.supply_Pa
            spread = np.sqrt(weight @ (values - weight @ values) ** 2) / alive[0].deviation[name]
            k = int(np.argmax(spread))
            if spread[k] > separation:
                separation, command_V, channel = float(spread[k]), float(grid[k]), name
    text = (
        f"Run the piston out and back at {command_V:.3g} V and measure {channel.replace('_', ' ')}:"
        " there the sets of causes that are left differ most."
    )
    names = tuple(str(each.hypothesis) for each in ranked[:4])
    return NextExperiment(text, names, separation, {"command_V": command_V, "channel": channel})


_FEW = 5  # conditions


def notes_on(
    ranked: Sequence[HeldOut], judged: Judgement, best: HeldOut, undecided: Sequence[str], known: Hypothesis
) -> Iterator[str]:
    """Notes on what is uncertain and why."""
    if (count := len(best.error)) < _FEW:
        yield f"{count} conditions are few: probabilities follow from how each is predicted without the others"
    yield from _greedy(ranked, best, known)
    kinds = {law: sum(p for h, p in judged.of.items() if law in h.names) for law in FRICTIONS}
    shown = sorted(((law, p) for law, p in kinds.items() if p > 0.01), key=lambda item: -item[1])
    yield f"friction by kind: {', '.join(f'{law.removeprefix(FRICTION)[2:-1]} {p:.2f}' for law, p in shown) or 'none'}"
    yield from (f"cannot be told apart: {words}" for words in correlated(best.fit))
    left = ((value, channel, condition) for condition, each in best.error.items() for channel, value in each.items())
    value, channel, condition = max(left)
    yield f"what is left is largest in {channel} at {condition}: {100 * value:.1f} %"
    if len(undecided) > 1:
        yield f"not decided by these conditions: {', '.join(undecided)}"
    if ORIFICES not in best.hypothesis.names:
        yield "a linear valve says nothing of the chambers' mean pressure; supply and tank are shared between them here"


def _greedy(ranked: Sequence[HeldOut], best: HeldOut, known: Hypothesis) -> Iterator[str]:
    """What adding one cause at a time would have found, against the chosen set."""
    error = {each.hypothesis: each.total for each in ranked}
    path = [known]
    while True:
        nearer = [h for h in error if size(h) == size(path[-1]) + 1 and set(path[-1].causes) <= set(h.causes)]
        step = min(nearer, key=lambda h: error[h], default=None)
        if step is None or error[step] >= error[path[-1]]:
            break
        path.append(step)
    if error[path[-1]] > error[best.hypothesis]:
        yield f"one cause at a time ends at {path[-1]} with a held-out error of {error[path[-1]]:.3f}"
    if known.names:
        return
    sets = (together(*names) for names in ((), (AREAS,), (ORIFICES,), (AREAS, ORIFICES)))
    none, areas, root, both = (error.get(one, nan) for one in sets)
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
        (predicted,) = moving(prototype, chosen.without[condition], np.array([volts - seen.null_V]))["speed"]
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


def updated_prototype(prototype: BenchPrototype, found: Fit, **readings: float | None) -> BenchPrototype:
    """The prototype with a fit's causes as effects and its figures in place of the believed ones.

    Args:
        prototype: what was believed.
        found: of what is held responsible.
        readings: figures of its sensors that the data show; None: as believed.
    """
    effects, values = dict(prototype.effects), found.values
    for name in (name for name in found.hypothesis.causes if name in library()):
        own = {key.removeprefix(f"{name}."): value for key, value in values.items() if key.startswith(f"{name}.")}
        effects[name] = ({"coulomb_N": 0.0} if name == FRICTION else {}) | own
    values["supply_pressure"] = values.get(f"{ORIFICES}.supply_pressure_Pa", values.get("supply_pressure", nan))
    tables: dict[str, dict[str, float]] = {
        "actuator": {},
        "servovalve": {"flow_gain_m3_per_s_per_V": values["flow_gain"] * prototype.servovalve.amplifier_A_per_V},
        "sensors": {key: value for key, value in readings.items() if value is not None},
    }
    for name, place in BENCH_STATED.items():
        table, _, key = place.partition(".")
        if name in values:
            tables[table][key] = values[name]
    changes = {table: getattr(prototype, table).but(**new) for table, new in tables.items()}
    return prototype.but(**changes, effects=effects)


def replayed(data: BenchSet, chosen: HeldOut) -> tuple[RecordGap, ...]:
    """Simulate every condition under its recorded command and compare with all its runs, channel by channel.

    Root mean square errors over the stroke or the supply pressure: as believed, and with the chosen causes, fitted
    without the condition. The floor is half the mean square difference of replicates, as its root; NaN with one.

    The reading of the displacement at the retracted stop is taken from the record: it is where the sensor was mounted,
    and neither model speaks of it.
    """
    actuator, rows = data.prototype.actuator, list[RecordGap]()
    over = {"displacement_m": actuator.stroke_m}
    over |= dict.fromkeys(("pressure_a_Pa", "pressure_b_Pa"), actuator.supply_pressure_Pa)
    for condition, trained in chosen.without.items():
        runs = [run for run in data.runs if run.condition == condition]
        rigs = data.prototype, updated_prototype(data.prototype, trained)
        squares = *([*_missed(rig, runs)] for rig in rigs), [*_scattered(runs)]
        for channel, unit in over.items():
            own = ([square / unit**2 for name, square in each if name == channel] for each in squares)
            before, after, floor = (float(np.sqrt(np.mean(each))) if each else nan for each in own)
            rows.append(RecordGap(f"{condition}, {channel}", True, before, nan, after, floor))
    return tuple(rows)


def simulated(prototype: BenchPrototype, run: BenchRun) -> np.ndarray:
    """A run's record as `prototype` makes it, columns as in `BENCH_COLUMNS`, read by the run's own sensor."""
    zero, top = _ends(run)
    sensors = prototype.sensors.but(displacement_zero_m=zero, displacement_most_m=top)
    return replay(prototype.but(sensors=sensors), run.times, run.command_V)


def _ends(run: BenchRun) -> tuple[float, float]:
    """What the sensor reads at the retracted stop, and at most."""
    return float(np.median(run.displacement_m[held(run, -1)])), float(np.max(run.displacement_m))


def _missed(prototype: BenchPrototype, runs: Sequence[BenchRun]) -> Iterator[tuple[str, float]]:
    """By channel, what a model misses of each run."""
    made: dict[tuple[object, ...], np.ndarray] = {}
    for run in runs:
        key = run.command_V.tobytes(), run.times.tobytes(), *_ends(run)
        if key not in made:
            made[key] = simulated(prototype, run)
        for channel, measured in run.channels.items():
            yield channel, float(np.mean((made[key][:, BENCH_COLUMNS.index(channel)] - measured) ** 2))


def _scattered(runs: Sequence[BenchRun]) -> Iterator[tuple[str, float]]:
    """By channel, half of what each two replicates differ in."""
    for one, other in combinations(runs, 2):
        for channel, measured in one.channels.items():
            theirs = other.channels.get(channel, np.zeros(0))
            if len(theirs) == len(measured) and theirs is not measured:  # as that of a run with both chambers is
                yield channel, float(np.mean((theirs - measured) ** 2)) / 2
