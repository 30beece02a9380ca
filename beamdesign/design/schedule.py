"""Tuning of a scheduled controller: one law for each part of the payload's range, all with the same mass inside.

Every stage performs over its own payloads and is stable over all of them and a little more, so that no estimate of the
payload, however wrong, destabilises the loop. The second is a member of its own to the tuner: the same plant, its
payload stretched from the stage's range to the whole one, which only has to be stable.

The mass inside is one for all stages. Alone, each stage is tuned with a mass of its own, which bounds what it can
reach. Then these masses and those halfway between them are tried for all stages. Of those that leave the worst stage
nearly as much as the best of them, the one with the largest product of bandwidths is taken: the last percent of the
worst stage may cost another stage a sixth of its bandwidth.

Stages are lags. Of a prototype whose own controller is structured, by itself or in its stages, they are structured too:
each is tuned from the law that acts in its middle, with the prototype's mass inside, which is for them what a search
would take hours for.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import prod

import numpy as np

from beamdesign.controllers import Estimator, Lag, Scheduled, Stage
from beamdesign.design.law_search import Search, from_seeds, search
from beamdesign.design.refinement import Proved
from beamdesign.design.tuning import SMALLEST_BANDWIDTH_HZ
from beamdesign.members import Member, family
from beamdesign.prototype import Goal, Prototype

Progress = Callable[[float, str], None]

BEYOND = 0.03
"""Share of the payload's range by which every stage is stable beyond its heaviest."""

NEARLY = 0.98
"""Share of the largest bandwidth of the worst stage that counts as nearly as much."""


def stage_members(
    prototype: Prototype, stage_kg: tuple[float, float], whole_kg: tuple[float, float]
) -> tuple[Member, ...]:
    """What the law of a stage has to serve: its own payloads with performance, all payloads with stability.

    Args:
        prototype: with or without effects.
        stage_kg: payloads of the stage.
        whole_kg: all payloads.

    Raises:
        InputError: for effects for which no linear loop stands.
    """
    own = family(prototype, whole_kg[1]).members
    factor = (1 + BEYOND) * (whole_kg[1] - whole_kg[0]) / (stage_kg[1] - stage_kg[0])
    offset = whole_kg[0] - factor * stage_kg[0]
    stretched = [replace(one, rig=replace(one.rig, stretch=(offset, factor)), performance=None) for one in own]
    return (*own, *stretched)


@dataclass(frozen=True)
class ScheduleTuning:
    """Outcome of `tune_schedule`.

    Attributes:
        rig: the prototype with its laws; None where a stage was not proved.
        proved: of every stage, what it guarantees over its own payloads.
        alone_Hz: bandwidth of every stage tuned with a mass inside of its own: what no common mass can exceed.
        reason: why there is no answer, empty where there is one.
    """

    rig: Prototype | None
    proved: tuple[Proved, ...]
    alone_Hz: tuple[float, ...]
    reason: str = ""


def stage_ranges(whole_kg: tuple[float, float], count: int, overlap_kg: float) -> list[tuple[float, float]]:
    """Equal parts of a range, each widened by half an overlap towards its neighbours; bounds in whole grams.

    Raises:
        ValueError: where the parts are not wider than the overlap.
    """
    low, high = whole_kg
    width = (high - low) / count
    if not width > overlap_kg:
        raise ValueError(
            f"{count} stages of {width:.4g} kg each leave no room for overlaps of {overlap_kg:.4g} kg; fewer stages or"
            " a narrower band of the estimate would"
        )
    half = overlap_kg / 2
    edges = [low + k * width for k in range(count + 1)]
    return [
        (low if k == 0 else round(edges[k] - half, 3), high if k == count - 1 else round(edges[k + 1] + half, 3))
        for k in range(count)
    ]


@dataclass(frozen=True)
class _Task:
    prototype: Prototype
    whole_kg: tuple[float, float]
    largest_inner: float

    @property
    def goal(self) -> Goal:
        return self.prototype.goal

    def tuned(self, stage_kg: tuple[float, float], inner: float | None) -> tuple[Proved | None, str]:
        """The best law of a stage, with a given mass inside or with the best; or why there is none."""
        members = stage_members(self.prototype, stage_kg, self.whole_kg)
        own, middle = self.prototype.controller, sum(stage_kg) / 2
        law = next((law for law, (low, high) in own.laws if low <= middle <= high), None) if own is not None else None
        if law is not None and law.sections and (opened := law.form()) is not None:
            inside = self.prototype.payload.inner_end_mass_kg
            task = Search(members, self.goal, stage_kg, (inside, inside))
            starts = [(opened[0], np.append(opened[1], inside))]
        else:
            least, most = (0.0, self.largest_inner) if inner is None else (inner, inner)
            task = Search(members, self.goal, stage_kg, (least, most))
            starts = from_seeds(task, Lag)
        found = search(task, starts)
        return found.proved, found.reason


def tune_schedule(
    prototype: Prototype,
    whole_kg: tuple[float, float],
    stages: int = 3,
    largest_inner_end_mass_kg: float = 6.0,
    estimator: Estimator | None = None,
    progress: Progress | None = None,
) -> ScheduleTuning:
    """Tune a law for each of some overlapping parts of a payload range, with one mass inside for all.

    Args:
        prototype: the rig; its goal sets the limits, and a structured controller of its own the form of the stages.
        whole_kg: range of outer end mass.
        stages: how many laws.
        largest_inner_end_mass_kg: most mass that may be added inside.
        estimator: of the payload; stages overlap by two and a half times its band, of which half a band is hysteresis.
        progress: told the share done and what is being done.

    Raises:
        ValueError: where so many stages do not fit into the range.
        InputError: for effects for which no linear loop stands.
    """
    told = progress or (lambda fraction, text: None)
    figures = estimator or Estimator(noise_V=prototype.sensor.noise_V or Estimator().noise_V)
    ranges = stage_ranges(whole_kg, stages, 2.5 * figures.band_kg)
    task = _Task(prototype, whole_kg, largest_inner_end_mass_kg)
    steps, done = 2 * stages * stages, 0
    alone: list[Proved] = []
    for k, stage_kg in enumerate(ranges):
        told(done / steps, f"stage {k + 1} of {stages} by itself")
        proved, reason = task.tuned(stage_kg, None)
        done += 1
        if proved is None or proved.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
            return ScheduleTuning(None, (), tuple(p.bandwidth_Hz for p in alone), _no_stage(stage_kg, reason))
        alone.append(proved)

    def together(inner: float) -> list[Proved | None]:
        nonlocal done
        found: list[Proved | None] = []
        for k, stage_kg in enumerate(ranges):
            told(done / steps, f"stage {k + 1} of {stages} with {inner:.4g} kg inside")
            done += 1
            found.append(task.tuned(stage_kg, inner)[0])
        return found

    def least(found: list[Proved | None]) -> float:
        return min(map(_hertz, found))

    own_kg = sorted({round(proved.inner_end_mass_kg, 2) for proved in alone})
    inside_kg = sorted({*own_kg, *(round((one + two) / 2, 2) for one, two in pairwise(own_kg))})
    same = len({proved.inner_end_mass_kg for proved in alone}) == 1
    tried: list[list[Proved | None]] = [[*alone]] if same else [together(inner) for inner in inside_kg]
    enough = NEARLY * max(least(found) for found in tried)
    best = max((found for found in tried if least(found) >= enough), key=lambda found: prod(map(_hertz, found)))
    complete = tuple(proved for proved in best if proved is not None)
    bandwidths = tuple(proved.bandwidth_Hz for proved in alone)
    if len(complete) < stages or least(best) < SMALLEST_BANDWIDTH_HZ:
        return ScheduleTuning(None, (), bandwidths, "no mass inside was found with which every stage can be proved")
    schedule = Scheduled(
        stage=tuple(_stage(proved, stage_kg) for proved, stage_kg in zip(complete, ranges, strict=True)),
        estimator=figures,
    )
    payload = prototype.payload.but(outer_end_mass_kg=whole_kg, inner_end_mass_kg=complete[0].inner_end_mass_kg)
    found = prototype.but(controller=schedule, payload=payload, guarantee=None)
    return ScheduleTuning(found, complete, bandwidths)


def _hertz(proved: Proved | None) -> float:
    return 0.0 if proved is None else proved.bandwidth_Hz


def _stage(proved: Proved, stage_kg: tuple[float, float]) -> Stage:
    law = proved.controller
    lag = law.lag
    assert lag is not None
    return Stage(
        outer_end_mass_kg=stage_kg,
        gain_A_per_V=law.gain_A_per_V,
        pole_Hz=lag.pole_Hz,
        zero_Hz=lag.zero_Hz,
        section=law.sections,
    )


def _no_stage(stage_kg: tuple[float, float], reason: str) -> str:
    return (
        f"no law was proved for the stage of {stage_kg[0]:g} to {stage_kg[1]:g} kg that is stable for every payload"
        f" ({reason}); more inner end mass, a larger peak sensitivity or a larger compliance may allow one"
    )
