"""What to measure next: of all that can be done with the rig, what would separate the rival causes best.

Each rival predicts each experiment with its fitted figures. If one is true, the other will re-tune, within what the
data so far leave open; what then remains of the difference, in units of misfit, is the separation: its square is by how
much the cost of the wrong one will rise over that of the right one. Of all separations, and of how probable each rival
is, follows how much an experiment is expected to tell about which of them it is.

That holds where predictions follow figures by their derivatives. In a loop deep in saturation, or of little damping,
they do not: figures that differ by less than is known give motions with nothing in common, and a fit of the right rival
finds its way as little as that of the wrong one. So each rival is also simulated with figures drawn within what the
data leave open. What derivatives do not say of those motions the right rival will leave as well: that is taken off what
separates it from the others, and where it is much, what is separated will be taken for something that is not listed.

An experiment is a record or a few, one after another, as many as tell most of what is open: a fit counts every record
alike, so that a longer one tells no more than two short ones tell. Each is another one: what a rig has besides of which
no rival knows is the same in a record that is taken again. They stay within about what its records have asked of it.

A cause may follow one law or another: a lag of second order takes the place of a delay where one of first order cannot.
So laws are rivals of their own, but which of two laws of the same cause it is tells nothing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, permutations
from math import inf
from typing import Any, NamedTuple

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.diagnosis import NextExperiment
from beamdesign.diagnosis.experiment_menu import Experiment, menu
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.fitting.weighting import HIGHEST_HZ, LOWEST_HZ, Weighting, weighting
from beamdesign.diagnosis.judgement import unknown_by
from beamdesign.plant.assembly import RIGS, widened
from beamdesign.prototype import Prototype
from beamdesign.scenario import Scenario, inputs_of
from beamdesign.time_limit import while_time

_RIVALS, _LAWS = 4, 2  # sets of causes, and laws that each may follow
_LIKELY = 0.01  # of the probability of its first law, which another one has at least
_PROMISING, _CLOSER_LOOK = 40, 8
_NEXT = "what to measure next"  # is left out where the time is up
_RECORDS, _ENOUGH = 8, 0.95  # of one experiment, and what they need not tell more than, of what is open
_LEAST_WEIGHT = 0.01  # a rival is never so improbable that telling it apart is worth nothing
_ANOTHER_SENSOR = 1.6  # effort
_FURTHEST = 3.0  # times the largest displacement recorded so far
_INSIDE = 1.5  # times the largest pressure or force so far: beyond, a supply or a motor may have no more to give
_SENSOR_NOISE = 0.003  # of the rms of a channel that no record holds yet
_LEAST = 1e-9
_DRAWS = 2  # of a rival's figures, each to both sides
ADDED = {
    "load_pressure_Pa": "load pressure",
    "screw_force_N": "force of the screw",
    "inner_displacement_m": "displacement of the inner beam",
}
"""Channels that a sensor could be added for."""


def next_experiment(data: Dataset, rivals: Sequence[Fit], weights: Sequence[float]) -> NextExperiment | None:
    """The experiment that is expected to tell most about which rival it is, for its effort.

    Args:
        data: measured so far; its largest inputs and displacements bound what is proposed.
        rivals: fits, the most probable first; no more than four sets of causes count, and of each two laws.
        weights: their probabilities.

    Returns:
        None where there are no two rivals, no time record to go by, or no experiment that every rival predicts.
    """
    of: dict[tuple[str, ...], list[tuple[Fit, float]]] = {}
    for fit, weight in zip(rivals, weights, strict=True):
        if not fit.reason:
            of.setdefault(fit.hypothesis.causes, []).append((fit, weight))
    sets = dict(islice(of.items(), _RIVALS))
    if len(sets) < 2 or not data.records:
        return None
    likely = [pair for own in sets.values() for pair in own[:_LAWS] if pair[1] >= _LIKELY * own[0][1]]
    laws, weights = zip(*((fit, max(weight, _LEAST_WEIGHT)) for fit, weight in likely), strict=True)
    if not (ranked := experiments(data, laws, weights)):
        return None
    best = ranked[0]
    among = [own[0][0] for own in sets.values()]
    names = tuple(str(fit.hypothesis) for fit in among)
    apart = [
        min(best.between[0, k] for k, fit in enumerate(laws) if fit.hypothesis.causes == causes) for causes in sets
    ]
    plain = [s for s in ranked if not s.added]
    also = f", with a sensor for the {ADDED[best.added]} added" if best.added else ""
    text = f"{best.text}{also}. Expected separation of {names[0]} from "
    text += " and ".join(f"{name} {far:.1f}" for name, far in zip(names[1:], apart[1:], strict=True))
    text += " units of misfit, figures re-tuned"
    if best.added and plain:
        text += f"; without the added sensor {plain[0].least:.1f} ({plain[0].text})"
    plan = best.scenario.model_dump(mode="json", exclude_none=True)
    row = plan["record"][0]
    settings = row["input"][0] | {key: row[key] for key in ("outer_end_mass_kg", "inner_end_mass_kg")}
    settings |= {"added_sensor": best.added, "scenario": plan}
    decided, open_ = best.bits(weights), best.wide_apart.bits(weights)
    if decided < open_ / 2:  # a cause beside another can always be nothing: that alone says little
        text += "; none of the experiments tried separates them clearly"
    text += f"; of the {open_:.2g} bits that are open it is expected to tell {decided:.2g} at least"
    return NextExperiment(text + ".", names, best.least, settings, decided, _series(data, best, among))


def _series(data: Dataset, experiment: Experiment, rivals: Sequence[Fit]) -> dict[str, dict[str, np.ndarray]]:
    """Columns of every record to be taken: what to play, and what each rival predicts of it."""
    series = {}
    for job in _jobs(data.prototype, experiment.scenario):
        inputs = job.record.inputs
        columns = {"t_s": job.record.times, "disturbance_N": inputs[:, 0], "command_V": inputs[:, 1]}
        for fit in rivals:
            predicted = job.simulated(fit.hypothesis.placement(data.prototype), fit.z, ("displacement_m",))
            if predicted is not None:
                columns[f"displacement_m if {fit.hypothesis}"] = predicted[:, 0]
        series[job.record.name] = columns
    return series


def experiments(data: Dataset, rivals: Sequence[Fit], weights: Sequence[float]) -> list[Experiment]:
    """With the channels recorded so far and with one more each, best first.

    Of the records that promise most, those that can be predicted are looked at with re-tuning; where none can, as with
    a joint that hammers, the first of all. To the best of them others are added, as long as that tells more and they do
    not tell nearly all.
    """
    most = _INSIDE * reached(data, rivals[0])
    looks = (_without_retuning(data, one, rivals, most) for one in while_time(menu(data), lambda _: _NEXT))
    quick = [(one.bits(weights) / one.effort, one) for one in looks if one is not None]
    quick.sort(key=lambda look: -look[0])
    seen: dict[str, list[_Foreseen]] = {}
    promising = [one for _, one in quick[:_PROMISING]]
    steady = (one for one in while_time(promising, lambda _: _NEXT) if _repeats(data, one, rivals[0]))
    for one in while_time([*islice(steady, _CLOSER_LOOK)] or promising[:_CLOSER_LOOK], lambda _: _NEXT):
        for found in _closely(data, one, rivals):
            seen.setdefault(found.experiment.added, []).append(found)
    grown = (_grown(records, weights) for records in seen.values())
    return sorted(grown, key=lambda one: one.worth(weights), reverse=True)


class _Foreseen(NamedTuple):
    """One record as every rival predicts it, weighed by its noise, and what each may still re-tune of that.

    Attributes:
        experiment: the record alone.
        values: (M,) of each rival, with its fitted figures.
        free: (M, K) of each, change of it per standard deviation of what may be re-tuned.
        beyond: (D, M) of each, with figures drawn within what the data leave open, what is more than that change.
        noise: misfit that noise alone leaves.
    """

    experiment: Experiment
    values: list[np.ndarray]
    free: list[np.ndarray]
    beyond: list[np.ndarray]
    noise: float


def _grown(records: Sequence[_Foreseen], weights: Sequence[float]) -> Experiment:
    """The best record, and whatever others tell more beside it."""
    best, chosen = None, list[_Foreseen]()
    while len(chosen) < min(_RECORDS, len(records)):
        left = [one for one in records if all(one is not other for other in chosen)]
        wider = [(_joined([*chosen, one]), one) for one in left]
        found, further = max(wider, key=lambda each: each[0].worth(weights))
        if best is not None and found.worth(weights)[0] <= best.worth(weights)[0]:
            break
        best = found
        chosen.append(further)
        if best.bits(weights) >= _ENOUGH * best.wide_apart.bits(weights):
            break
    assert best is not None  # there is a record
    return best


def _joined(records: Sequence[_Foreseen]) -> Experiment:
    """Records one after another as one experiment, figures re-tuned to all of them at once."""
    first, rivals = records[0].experiment, range(len(records[0].values))
    values = [np.concatenate([one.values[k] for one in records]) for k in rivals]
    free = [np.concatenate([one.free[k] for one in records]) for k in rivals]
    beyond = [np.hstack([one.beyond[k] for one in records]) for k in rivals]
    noise, risen = sum(one.noise for one in records), np.zeros((len(values), len(values)))
    for true, wrong in permutations(rivals, 2):
        drawn = [(values[true] - values[wrong] + more, distance(more, free[true]) ** 2) for more in beyond[true]]
        risen[true, wrong] = min(_known(own, noise) * (distance(d, free[wrong]) ** 2 - own) for d, own in drawn)
    between = np.sqrt(np.maximum(np.minimum(risen, risen.T), 0.0))
    names = ("next", *(f"next_{k}" for k in range(2, len(records) + 1)))
    rows = tuple(one.experiment.scenario.record[0].but(name=name) for one, name in zip(records, names, strict=True))
    texts = tuple(text for one in records for text in one.experiment.texts)
    effort = max(one.experiment.effort for one in records)
    return replace(first, texts=texts, scenario=first.scenario.but(record=rows), effort=effort, between=between)


def _known(left: float, noise: float) -> float:
    """Probability that what the right rival leaves beyond noise is not called unknown, over that where that is none."""
    return (1 - unknown_by(noise + left, noise)) / (1 - unknown_by(noise, noise))


def reached(data: Dataset, rival: Fit) -> np.ndarray:
    """(W,) largest of all that no record need hold, see `ADDED`, in the records so far, as a rival predicts them."""
    placement = rival.hypothesis.placement(data.prototype)
    watched = _watched(data)
    made = (Replay(record, data.prototype).simulated(placement, rival.z, watched) for record in data.records)
    peaks = [np.abs(y).max(axis=0) for y in made if y is not None]
    return np.max(peaks, axis=0) if peaks else np.full(len(watched), inf)


def _watched(data: Dataset) -> tuple[str, ...]:
    return tuple(channel for channel in ADDED if channel in RIGS[data.prototype.rig].outputs)


def _without_retuning(
    data: Dataset, experiment: Experiment, rivals: Sequence[Fit], most: np.ndarray | float = inf
) -> Experiment | None:
    """With the differences of rivals with nothing re-tuned; None where one, or the prototype, does not predict it.

    A record that the prototype does not predict could not be diagnosed: fits begin there. Nor is one proposed of which
    rivals disagree whether the loop is stable: it would separate them by how little damping is left, which anything
    that none of them has changes as much. Nor one in which the first of them reaches more than `most` of `_watched`.
    """
    channels, nothing = _channels(data), NOTHING.placement(data.prototype)
    (job,), column = _jobs(data.prototype, experiment.scenario), channels.index("displacement_m")
    asked = [(nothing, np.zeros(len(nothing.unknowns)))]
    asked += [(fit.hypothesis.placement(data.prototype), fit.z) for fit in rivals]
    if len({job.grows(placement, z) for placement, z in asked[1:]}) > 1:
        return None
    count, every = len(channels), (*channels, *_watched(data))
    made = [job.simulated(placement, z, every) for placement, z in asked]
    predicted = [y[:, :count] for y in made if y is not None and np.all(np.isfinite(y))]
    furthest = _FURTHEST * max(float(np.abs(r.measured["displacement_m"]).max()) for r in data.records)
    if len(predicted) < len(made) or any(np.abs(y[:, column]).max() > furthest for y in predicted):
        return None
    if made[1] is None or np.any(np.abs(made[1][:, count:]).max(axis=0) > most):
        return None
    weight = _weight(data, job, predicted[1], channels)
    weighed = np.array([weight(y) for y in predicted[1:]])
    apart = np.asarray(np.linalg.norm(weighed[:, None] - weighed[None], axis=2))
    return replace(experiment, causes=tuple(fit.hypothesis.causes for fit in rivals), between=apart)


def _repeats(data: Dataset, experiment: Experiment, rival: Fit) -> bool:
    """Whether figures within what the data leave open move a record by their derivatives, but for what noise does.

    Of a straight line the value half way between two draws to either side of a fit is that of the fit.
    """
    channels, (job,) = _channels(data), _jobs(data.prototype, experiment.scenario)
    predicted = job.simulated(rival.hypothesis.placement(data.prototype), rival.z, channels)
    if predicted is None:
        return False
    weight = _weight(data, job, predicted, channels)
    (_, one), (_, other) = islice(_drawn(data, job, rival, channels), 2)
    off = weight((one + other) / 2 - predicted)
    return float(off @ off) < weight.expected


def _closely(data: Dataset, experiment: Experiment, rivals: Sequence[Fit]) -> Iterator[_Foreseen]:
    """With what the rivals may still re-tune: with the channels recorded so far, and one more."""
    recorded = _channels(data)
    others = [c for c in ADDED if c not in recorded and c in RIGS[data.prototype.rig].outputs]
    every = (*recorded, *others)
    made, (job,) = [], _jobs(data.prototype, experiment.scenario)
    for fit in rivals:
        found = job.simulated_with_slopes(fit.hypothesis.placement(data.prototype), fit.z, every)
        if found is None:
            return
        made.append(found)
    drawn = [[*_drawn(data, job, fit, every)] for fit in rivals]
    for added in ("", *others):
        channels = (*recorded, added) if added else recorded
        at = [every.index(c) for c in channels]
        weight = _weight(data, job, made[0][0][:, at], channels)
        free = [weight(dy[:, at]) @ _root(fit) for (_, dy), fit in zip(made, rivals, strict=True)]
        beyond = [
            np.array([weight((y - of)[:, at] - dy[:, at] @ move) for move, y in moved])
            for (of, dy), moved in zip(made, drawn, strict=True)
        ]
        effort = experiment.effort * (_ANOTHER_SENSOR if added else 1.0)
        one, values = replace(experiment, effort=effort, added=added), [weight(y[:, at]) for y, _ in made]
        yield _Foreseen(one, *_shortened(values, free, beyond), weight.expected)


def _shortened(values: list[np.ndarray], free: list[np.ndarray], beyond: list[np.ndarray]) -> tuple[Any, Any, Any]:
    """The same by their coordinates in the space that all of them span: all products of two of them stay."""
    every = [np.array(values), *beyond, *(one.T for one in free)]
    rows = np.vstack(every)
    if not np.all(np.abs(rows) <= _HUGE):  # on the way to diverge
        return values, free, beyond
    ends = np.cumsum([len(one) for one in every])[:-1]
    own, *parts = (part.T for part in np.split(np.linalg.qr(rows.T, mode="r"), ends, axis=1))
    return list(own), [part.T for part in parts[len(beyond) :]], parts[: len(beyond)]


def _root(fit: Fit) -> np.ndarray:
    """(K, K) moves of z by one standard deviation each."""
    return np.asarray(np.linalg.cholesky(fit.covariance + _LEAST * np.eye(len(fit.z))))


def _drawn(data: Dataset, job: Replay, fit: Fit, channels: tuple[str, ...]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Moves of z within what the data leave open, each to both sides alike, and (N, C) what is predicted there."""
    placement = fit.hypothesis.placement(data.prototype)
    low, high = (np.array(side) for side in zip(*(u.bounds for u in placement.unknowns), strict=True))
    room = np.minimum(high - fit.z, fit.z - low)  # a figure at its bound stays there
    for drawn in np.random.default_rng(0).standard_normal((_DRAWS, len(fit.z))) @ _root(fit).T:
        for move in (side * np.clip(drawn, -room, room) for side in (1, -1)):
            predicted = job.simulated(placement, fit.z + move, channels)
            diverged = np.full((len(job.record.times), len(channels)), _HUGE)
            yield move, diverged if predicted is None else predicted


def distance(difference: np.ndarray, free: np.ndarray) -> float:
    """Least norm of a difference and of what is moved: min |d + F m|^2 + |m|^2, its root.

    Args:
        difference: (M,) between two predictions.
        free: (M, K) change of it per standard deviation of what may be re-tuned.
    """
    if not all(np.abs(each).max(initial=0.0) <= _HUGE for each in (free, difference)):  # on the way to diverge
        return 0.0
    right = free.T @ difference
    a = free.T @ free + np.eye(free.shape[1])
    return float(np.sqrt(max(difference @ difference - right @ np.linalg.solve(a, right), 0.0)))


_HUGE = 1e6


def _channels(data: Dataset) -> tuple[str, ...]:
    """Channels that every record holds."""
    return tuple(c for c in data.records[0].measured if all(c in record.measured for record in data.records))


def _jobs(prototype: Prototype, plan: Scenario) -> Iterator[Replay]:
    for row in plan.record:
        assert row.controller is not None  # the menu names it
        masses = row.outer_end_mass_kg or 0.0, row.inner_end_mass_kg or 0.0
        yield Replay(TimeRecord(row.name, plan.times, inputs_of(row, plan), {}, *masses, row.controller), prototype)


def _weight(data: Dataset, job: Replay, predicted: np.ndarray, channels: tuple[str, ...]) -> Weighting:
    """Weighs a prediction with the noise of the channels as recorded so far, as if it had been measured."""
    rng = np.random.default_rng(0)
    measured = {}
    for k, name in enumerate(channels):
        noise = [weighting(r, (name,)).noise_std[0] for r in data.records if name in r.measured]
        std = float(np.median(noise)) if noise else _SENSOR_NOISE * float(np.std(predicted[:, k]))
        measured[name] = predicted[:, k] + rng.normal(0, std, len(predicted))
    band_Hz = widened(data.prototype, LOWEST_HZ, HIGHEST_HZ)
    return weighting(replace(job.record, measured=measured), channels, band_Hz)
