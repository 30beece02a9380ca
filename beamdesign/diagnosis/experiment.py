"""What to measure next: of all that can be done with the rig, what would separate the rival causes best.

Each rival predicts each experiment with its fitted figures. If one is true, the other will re-tune, within what the
data so far leave open; what then remains of the difference, in units of misfit, is the separation: its square is by how
much the cost of the wrong one will rise over that of the right one. Of all separations, and of how probable each rival
is, follows how much an experiment is expected to tell about which of them it is.

An experiment is a record or a few, one after another, as many as tell most of what is open: a fit counts every record
alike, so that a longer one tells no more than two short ones tell. They stay within about what the rig's records have
already asked of it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import inf
from typing import Any, NamedTuple

import numpy as np

from beamdesign.controllers.protocol import ANY_PAYLOAD
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.data.dataset_index import OFF
from beamdesign.diagnosis.data.input_noise import denoised
from beamdesign.diagnosis.diagnosis import NextExperiment, controller_text
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.fitting.weighting import HIGHEST_HZ, LOWEST_HZ, weighting
from beamdesign.plant.assembly import RIGS, pace, widened
from beamdesign.prototype import Prototype
from beamdesign.scenario import Input, LoadSteps, Multisine, Scenario, ScenarioRecord, Sine, inputs_of
from beamdesign.spelling import shorter
from beamdesign.structure.lumped import figures
from beamdesign.time_limit import while_time

DURATION_S, SAMPLE_S, _SLOW_HZ = 4.0, 0.5e-3, 0.5
_BANDS_HZ = ((1.0, 20.0), (1.0, 80.0), (30.0, 200.0), (100.0, 400.0))
"""The last for what differs in the order of its phase only, such as a lag and a delay.

All of these are for a rig as quick as the published one; of a quicker or slower one frequencies are so much higher or
lower, and records so much shorter or longer.
"""
_SHARES = (0.1, 1.0, 2.0)
"""Of the largest peak of an input recorded so far."""
_PAYLOADS = (0.5, 1.5)
"""Of the largest payload so far."""
_ANOTHER_PAYLOAD = 1.3  # effort
_NOISE = 0.5  # of a signal's rms: what is left without noise, where it is noise


@dataclass(frozen=True)
class Experiment:
    """Something that could be measured.

    Attributes:
        texts: each record in words.
        scenario: which simulates or prescribes them.
        effort: against an experiment on the rig as it stands.
        added: channel of an added sensor; empty for none.
        between: (R, R) by how much it separates rivals, units of misfit (square root), the lesser of both cases; empty
            where that is not worked out.
    """

    texts: tuple[str, ...]
    scenario: Scenario
    effort: float = 1.0
    added: str = ""
    between: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def text(self) -> str:
        """In words."""
        if len(self.texts) == 1:
            return self.texts[0]
        numbered = (f"({k}) {one}" for k, one in enumerate(self.texts, start=1))
        return f"{len(self.texts)} records of {self.scenario.duration_s:g} s: {'; '.join(numbered)}"

    @property
    def least(self) -> float:
        """Between the first rival and the one closest to it."""
        return float(self.between[0, 1:].min())

    def worth(self, weights: Sequence[float]) -> tuple[float, float]:
        """By which experiments are compared: information for the effort, then the least separation.

        Where several tell all but a hundredth of a bit, the one counts that leaves most room for what no rival is
        quite.
        """
        return round(information(self.between, weights) / self.effort, 2), self.least / self.effort


def menu(data: Dataset) -> Iterator[Experiment]:
    """All records: each signal at each setting of controller and masses, and at payloads not yet measured."""
    name = f"{shorter(data.prototype.name)}: next experiment"
    stated, quick = data.prototype.outer_end_mass_kg or ANY_PAYLOAD, pace(figures(data.prototype))
    for record, outer, inner, effort in _settings(data):
        law, payload = record.controller, f"a payload of {outer:.3g} kg" if outer > 0 else "no payload"
        beyond = f" (more than the {stated[1]:g} kg that the prototype is stated for)" if outer > stated[1] else ""
        for signal, words in _signals(data, quick, commanded=law != OFF):
            acting = f"servo off, {inner:.3g} kg inside" if law == OFF else controller_text(law, inner)
            text = f"{words}, {payload}{beyond}, {acting}"
            row = ScenarioRecord(
                name="next", input=(signal,), outer_end_mass_kg=outer, inner_end_mass_kg=inner, controller=law
            )
            length, step = DURATION_S / quick, SAMPLE_S / quick
            plan = Scenario(name=name, duration_s=length, sample_s=step, start="rest", record=(row,))
            yield Experiment((text,), plan, effort)


def _settings(data: Dataset) -> list[tuple[TimeRecord, float, float, float]]:
    """Record whose controller is used, payload, inner end mass, effort."""
    seen: dict[object, TimeRecord] = {}
    for r in data.records:
        seen.setdefault((r.controller, r.masses), r)
    found = [(r, *r.masses, 1.0) for r in seen.values()]
    heaviest = max(data.records, key=lambda r: r.outer_end_mass)
    laws = () if data.prototype.controller is None else data.prototype.controller.laws
    ranges = [masses for law, masses in laws if law == heaviest.controller] or [ANY_PAYLOAD]
    if heaviest.outer_end_mass > 0:
        for share in _PAYLOADS:
            outer = round(share * heaviest.outer_end_mass, 2)
            if any(low <= outer <= high for low, high in ranges):
                found.append((heaviest, outer, heaviest.inner_end_mass, _ANOTHER_PAYLOAD))
    return found


def _signals(data: Dataset, quick: float, commanded: bool) -> Iterator[tuple[Input, str]]:
    channels = ((1, "amplitude_V", "V", "command"), (0, "amplitude_N", "N", "force on the tip"))
    for column, key, unit, words in channels[0 if commanded else 1 :]:
        largest = max(_peak(r, column) for r in data.records)
        if largest <= 0:
            continue
        for share in _SHARES:
            peak = float(f"{share * largest:.2g}")
            size: dict[str, Any] = {key: peak}
            for low, high in _BANDS_HZ:
                tones = _at_pace(Multisine(low_Hz=low, high_Hz=high, **size), quick)
                text = f"{words}: many lines from {quick * low:g} to {quick * high:g} Hz with a peak of {peak:g} {unit}"
                yield tones, text
            sine = _at_pace(Sine(frequency_Hz=_SLOW_HZ, fade_s=0.2, **size), quick)
            yield sine, f"{words}: slow sine, {quick * _SLOW_HZ:g} Hz, {peak:g} {unit}"
            if column == 0:
                steps = _at_pace(LoadSteps(rise_s=0.03, **size), quick)
                yield steps, f"{words}: load steps of {peak:g} {unit}, both ways"


def _at_pace(signal: Input, pace: float) -> Input:
    """The same so many times as quick."""
    given = signal.model_dump(exclude_none=True)
    quicker = {name: value * pace for name, value in given.items() if name.endswith("_Hz")}
    return signal.but(**quicker, **{name: value / pace for name, value in given.items() if name.endswith("_s")})


def _peak(record: TimeRecord, column: int) -> float:
    """Largest value of an input; 0 where it is the noise of its sensor."""
    signal = record.inputs[:, column]
    still = denoised(signal)[0] if column else record.denoised[0]
    return float(np.abs(signal).max()) if np.std(still) > _NOISE * np.std(signal) else 0.0


_RIVALS = 4
_CLOSER_LOOK = 8
_NEXT = "what to measure next"  # is left out where the time is up
_RECORDS, _ENOUGH = 4, 0.95  # of one experiment, and what they need not tell more than, of what is open
_LEAST_WEIGHT = 0.01  # a rival is never so improbable that telling it apart is worth nothing
_ANOTHER_SENSOR = 1.6  # effort
_FURTHEST = 3.0  # times the largest displacement recorded so far
_SENSOR_NOISE = 0.003  # of the rms of a channel that no record holds yet
_LEAST = 1e-9
ADDED = {
    "load_pressure_Pa": "load pressure",
    "screw_force_N": "force of the screw",
    "inner_displacement_m": "displacement of the inner beam",
}
"""Channels that a sensor could be added for."""


def information(between: np.ndarray, weights: Sequence[float]) -> float:
    """Least expected information about which rival it is, bits.

    That of a mixture of Gaussians of one covariance, by their Bhattacharyya distances d^2 / 8: A. Kolchinsky and B. D.
    Tracey, Entropy 19 (2017) 361, equation (10).

    Args:
        between: (R, R) separations in standard deviations.
        weights: (R,) probabilities, up to a factor.
    """
    p = np.asarray(weights) / np.sum(weights)
    return float(-p @ np.log2(np.exp(-(between**2) / 8) @ p))


def next_experiment(data: Dataset, rivals: Sequence[Fit], weights: Sequence[float]) -> NextExperiment | None:
    """The experiment that is expected to tell most about which rival it is, for its effort.

    Args:
        data: measured so far; its largest inputs and displacements bound what is proposed.
        rivals: fits, the most probable first; no more than four count, of several for the same causes the first.
        weights: their probabilities.

    Returns:
        None where there are no two rivals, no time record to go by, or no experiment that every rival predicts.
    """
    first: dict[tuple[str, ...], tuple[Fit, float]] = {}
    for fit, weight in zip(rivals, weights, strict=True):
        if not fit.reason:
            first.setdefault(fit.hypothesis.causes, (fit, max(weight, _LEAST_WEIGHT)))
    if len(first) < 2 or not data.records:
        return None
    among, weights = zip(*list(first.values())[:_RIVALS], strict=True)
    ranked = experiments(data, among, weights)
    if not ranked:
        return None
    best = ranked[0]
    names = tuple(str(fit.hypothesis) for fit in among)
    plain = [s for s in ranked if not s.added]
    also = f", with a sensor for the {ADDED[best.added]} added" if best.added else ""
    text = f"{best.text}{also}. Expected separation of {names[0]} from "
    text += " and ".join(f"{name} {best.between[0, k]:.1f}" for k, name in enumerate(names) if k > 0)
    text += " units of misfit, figures re-tuned"
    if best.added and plain:
        text += f"; without the added sensor {plain[0].least:.1f} ({plain[0].text})"
    if best.least < 2.0:
        text += "; none of the experiments tried separates them clearly"
    plan = best.scenario.model_dump(mode="json", exclude_none=True)
    row = plan["record"][0]
    settings = row["input"][0] | {key: row[key] for key in ("outer_end_mass_kg", "inner_end_mass_kg")}
    settings |= {"added_sensor": best.added, "scenario": plan}
    decided, open_ = information(best.between, weights), information(np.where(np.eye(len(among)), 0.0, inf), weights)
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

    Records that promise most are looked at with re-tuning. To the best of them others are added, as long as that tells
    more and they do not tell nearly all.
    """
    looks = ((_without_retuning(data, one, rivals), one) for one in while_time(menu(data), lambda _: _NEXT))
    quick = [(information(between, weights) / one.effort, one) for between, one in looks if between is not None]
    quick.sort(key=lambda look: -look[0])
    seen: dict[str, list[_Foreseen]] = {}
    for _, one in while_time(quick[:_CLOSER_LOOK], lambda _: _NEXT):
        for found in _closely(data, one, rivals):
            seen.setdefault(found.experiment.added, []).append(found)
    grown = (_grown(records, weights) for records in seen.values())
    return sorted(grown, key=lambda one: one.worth(weights), reverse=True)


class _Foreseen(NamedTuple):
    """One record as every rival predicts it, weighed by its noise, and what each may still re-tune of that."""

    experiment: Experiment
    values: list[np.ndarray]
    free: list[np.ndarray]


def _grown(records: Sequence[_Foreseen], weights: Sequence[float]) -> Experiment:
    """The best record, and whatever others tell more beside it."""
    every = information(np.where(np.eye(len(weights)), 0.0, inf), weights)
    best, chosen = None, list[_Foreseen]()
    while len(chosen) < min(_RECORDS, len(records)):
        left = [one for one in records if all(one is not other for other in chosen)]
        wider = [(_joined([*chosen, one]), one) for one in left]
        found, further = max(wider, key=lambda each: each[0].worth(weights))
        if best is not None and found.worth(weights)[0] <= best.worth(weights)[0]:
            break
        best = found
        chosen.append(further)
        if information(best.between, weights) >= _ENOUGH * every:
            break
    assert best is not None  # there is a record
    return best


def _joined(records: Sequence[_Foreseen]) -> Experiment:
    """Records one after another as one experiment, figures re-tuned to all of them at once."""
    first, rivals = records[0].experiment, range(len(records[0].values))
    values = [np.concatenate([one.values[k] for one in records]) for k in rivals]
    free = [np.concatenate([one.free[k] for one in records]) for k in rivals]
    between = np.full((len(values), len(values)), inf)
    np.fill_diagonal(between, 0.0)
    for i, j in combinations(rivals, 2):
        between[i, j] = between[j, i] = min(distance(values[i] - values[j], free[k]) for k in (i, j))
    rows = tuple(
        one.experiment.scenario.record[0].but(name="next" if k == 1 else f"next_{k}")
        for k, one in enumerate(records, start=1)
    )
    texts = tuple(text for one in records for text in one.experiment.texts)
    effort = max(one.experiment.effort for one in records)
    return replace(first, texts=texts, scenario=first.scenario.but(record=rows), effort=effort, between=between)


def _without_retuning(data: Dataset, experiment: Experiment, rivals: Sequence[Fit]) -> np.ndarray | None:
    """(R, R) differences of rivals with nothing re-tuned; None where one, or the prototype itself, does not predict it.

    A record that the prototype does not predict could not be diagnosed: fits begin there. Nor is one proposed of which
    rivals disagree whether the loop is stable: it would separate them by how little damping is left, which anything
    that none of them has changes as much.
    """
    channels, nothing = _channels(data), NOTHING.placement(data.prototype)
    (job,), column = _jobs(data.prototype, experiment.scenario), channels.index("displacement_m")
    asked = [(nothing, np.zeros(len(nothing.unknowns)))]
    asked += [(fit.hypothesis.placement(data.prototype), fit.z) for fit in rivals]
    if len({job.grows(placement, z) for placement, z in asked[1:]}) > 1:
        return None
    made = [job.simulated(placement, z, channels) for placement, z in asked]
    predicted = [y for y in made if y is not None and np.all(np.isfinite(y))]
    reached = max(float(np.abs(r.measured["displacement_m"]).max()) for r in data.records)
    if len(predicted) < len(made) or any(np.abs(y[:, column]).max() > _FURTHEST * reached for y in predicted):
        return None
    weight = weighting(_as_record(data, job, predicted[1], channels), channels, _band_Hz(data))
    weighed = np.array([weight(y) for y in predicted[1:]])
    return np.asarray(np.linalg.norm(weighed[:, None] - weighed[None], axis=2))


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
    covariances = [np.linalg.cholesky(fit.covariance + _LEAST * np.eye(len(fit.z))) for fit in rivals]
    for added in ("", *others):
        channels = (*recorded, added) if added else recorded
        at = [every.index(c) for c in channels]
        weight = weighting(_as_record(data, job, made[0][0][:, at], channels), channels, _band_Hz(data))
        free = [weight(dy[:, at]) @ root for (_, dy), root in zip(made, covariances, strict=True)]
        effort = experiment.effort * (_ANOTHER_SENSOR if added else 1.0)
        yield _Foreseen(replace(experiment, effort=effort, added=added), [weight(y[:, at]) for y, _ in made], free)


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


def _band_Hz(data: Dataset) -> tuple[float, float]:
    return widened(data.prototype, LOWEST_HZ, HIGHEST_HZ)


def _channels(data: Dataset) -> tuple[str, ...]:
    """Channels that every record holds."""
    first = tuple(data.records[0].measured)
    return tuple(c for c in first if all(c in record.measured for record in data.records))


def _jobs(prototype: Prototype, plan: Scenario) -> Iterator[Replay]:
    for row in plan.record:
        assert row.controller is not None  # the menu names it
        masses = row.outer_end_mass_kg or 0.0, row.inner_end_mass_kg or 0.0
        yield Replay(TimeRecord(row.name, plan.times, inputs_of(row, plan), {}, *masses, row.controller), prototype)


def _as_record(data: Dataset, job: Replay, predicted: np.ndarray, channels: tuple[str, ...]) -> TimeRecord:
    """A prediction with the noise of the channels as recorded so far, as if it had been measured."""
    rng = np.random.default_rng(0)
    measured = {}
    for k, name in enumerate(channels):
        noise = [weighting(r, (name,)).noise_std[0] for r in data.records if name in r.measured]
        std = float(np.median(noise)) if noise else _SENSOR_NOISE * float(np.std(predicted[:, k]))
        measured[name] = predicted[:, k] + rng.normal(0, std, len(predicted))
    return replace(job.record, measured=measured)
