"""Tuning of a scheduled controller: one law for each part of the payload's range, all with the same mass inside.

Every stage performs over its own payloads and is stable over all of them and a little more, so that no estimate of the
payload, however wrong, destabilises the loop: see `beamdesign.members.served`. A fixed law is the case of one stage.

The mass inside is one for all stages. Alone, each stage is tuned with a mass of its own, which bounds what it can
reach. Then these masses and those halfway between them are tried for all stages. Of those that leave the worst stage
nearly as much as the best of them, the one with the largest product of bandwidths is taken: the last percent of the
worst stage may cost another stage a sixth of its bandwidth.

Stages are lags. Of a prototype whose own controller is structured, by itself or in its stages, they are structured too:
each is tuned from the law that acts in its middle, with the prototype's mass inside, which is for them what a search
would take hours for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, prod

from beamdesign.controllers import SENSED, Estimator, Scheduled, Sensed, Stage
from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.tuning import Progress, Tuning, tune
from beamdesign.proof.lyapunov import Switching, switching
from beamdesign.proof.rational import nearest
from beamdesign.proof.stage_family import stage_families
from beamdesign.prototype import InStage, Prototype
from beamdesign.records import InputError

NEARLY = 0.98
"""Share of the largest bandwidth of the worst stage that counts as nearly as much."""


@dataclass(frozen=True)
class LawsTuning:
    """Outcome of `tune_laws`.

    Attributes:
        prototype: with its controller and the mass inside; as given where nothing was found.
        outer_end_mass_kg: the payloads of all laws.
        laws: of every law its tuning over its own payloads; of a fixed law the only one.
        reason: why there is no answer, empty where there is one.
        alone_Hz: of several laws, the bandwidth of each tuned with a mass inside of its own: what no common mass can
            exceed.
        switching: what is proved of changes between several laws; None with effects, which that does not cover.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    laws: tuple[Tuning, ...]
    reason: str = ""
    alone_Hz: tuple[float, ...] = ()
    switching: Switching | None = None

    @property
    def stages(self) -> tuple[InStage, ...]:
        """The tuned prototype with each law."""
        return self.prototype.stages(self.outer_end_mass_kg)


def tune_laws(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str = "lag",
    largest_inner_end_mass_kg: float = 6.0,
    progress: Progress | None = None,
    sections: int = 3,
    sensors: Sequence[Sensed] = SENSED[:1],
    spread: RigSpread | None = None,
    stages: int = 3,
) -> LawsTuning:
    """Tune a controller of one law, or of a law for each part of the payloads.

    Arguments and errors are those of `beamdesign.design.tuning.tune`, and of `tune_schedule`, which is for the kind
    "scheduled" and a number of stages.
    """
    if kind == Scheduled.model_fields["kind"].default:
        asked = (largest_inner_end_mass_kg, None, progress, spread)
        return tune_schedule(prototype, outer_end_mass_kg, stages, *asked)
    found = tune(prototype, outer_end_mass_kg, kind, largest_inner_end_mass_kg, progress, sections, sensors, spread)
    return LawsTuning(found.prototype, outer_end_mass_kg, (found,), found.reason)


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


def tune_schedule(
    prototype: Prototype,
    whole_kg: tuple[float, float],
    stages: int = 3,
    largest_inner_end_mass_kg: float = 6.0,
    estimator: Estimator | None = None,
    progress: Progress | None = None,
    spread: RigSpread | None = None,
) -> LawsTuning:
    """Tune a law for each of some overlapping parts of a payload range, with one mass inside for all.

    Changes between the laws are proved, and set as far apart as that needs, where the prototype has no effects.

    Args:
        prototype: the rig; its goal sets the limits, and a structured controller of its own the form of the stages.
        whole_kg: range of outer end mass.
        stages: how many laws.
        largest_inner_end_mass_kg: most mass that may be added inside.
        estimator: of the payload; stages overlap by two and a half times its band, of which half a band is hysteresis.
        progress: told the share done and what is being done.
        spread: rigs that are off, of which the worst for every stage are proved as well; none: the nominal rig alone.

    Raises:
        InputError: where so many stages do not fit into the range, and for structured stages without a filter before
            them whose changes are to be proved.
    """
    told = progress or (lambda fraction, text: None)
    figures = estimator or Estimator(noise_V=prototype.sensor.noise_V or Estimator().noise_V)
    ranges = _ranges(prototype, whole_kg, stages, 2.5 * figures.band_kg)
    steps, done = 2 * stages * stages + 1, 0

    def tuned(stage_kg: tuple[float, float], inner: float | None) -> Tuning:
        nonlocal done
        begun, done = done, done + 1
        words = "by itself" if inner is None else f"with {inner:.4g} kg inside"
        words = f"stage {ranges.index(stage_kg) + 1} of {stages} {words}"
        own, middle = prototype.controller, sum(stage_kg) / 2
        law = next((law for law, (low, high) in own.laws if low <= middle <= high), None) if own is not None else None
        near = law is not None and bool(law.sections)
        if near:  # from the law that acts there, with the mass that it has inside
            inner = prototype.payload.inner_end_mass_kg
        least, most = (0.0, largest_inner_end_mass_kg) if inner is None else (inner, inner)
        return tune(
            prototype.but(controller=law),
            stage_kg,
            "structured" if near else "lag",
            most,
            lambda share, _: told((begun + share) / steps, words),
            spread=spread,
            near=near,
            stable_kg=whole_kg,
            least_inner_end_mass_kg=least,
        )

    alone: list[Tuning] = []
    for k, stage_kg in enumerate(ranges, start=1):
        alone.append(tuned(stage_kg, None))
        if alone[-1].best is None:
            reason = f"stage {k}, stable for all payloads as well: {alone[-1].reason}"
            return LawsTuning(prototype, whole_kg, (), reason, tuple(map(_hertz, alone[:-1])))

    def least(found: list[Tuning]) -> float:
        return min(map(_hertz, found))

    own_kg = sorted({round(one.best.inner_end_mass_kg, 2) for one in alone if one.best is not None})
    inside_kg = sorted({*own_kg, *(round((one + two) / 2, 2) for one, two in pairwise(own_kg))})
    same = len({one.best.inner_end_mass_kg for one in alone if one.best is not None}) == 1
    tried = [alone] if same else [[tuned(stage_kg, inner) for stage_kg in ranges] for inner in inside_kg]
    enough = NEARLY * max(least(found) for found in tried)
    best = max((found for found in tried if least(found) >= enough), key=lambda found: prod(map(_hertz, found)))
    bandwidths = tuple(map(_hertz, alone))
    if least(best) == 0:
        reason = "no mass inside was found with which every stage can be proved"
        return LawsTuning(prototype, whole_kg, (), reason, bandwidths)
    schedule = Scheduled(stage=tuple(map(_stage, best)), estimator=figures)
    inside = best[0].prototype.payload.inner_end_mass_kg
    payload = prototype.payload.but(outer_end_mass_kg=whole_kg, inner_end_mass_kg=inside)
    rig = prototype.but(controller=schedule, payload=payload, guarantee=None)
    if rig.effects:  # of which no states are known in which laws could change
        return LawsTuning(rig, whole_kg, tuple(best), "", bandwidths)
    proved = switching(
        stage_families(rig),
        *whole_kg,
        dwell_s=schedule.dwell_s,
        update=lambda share, text: told((steps - 1 + share) / steps, text),
    )
    rig = kept_apart(rig, proved)
    assert rig.schedule is not None
    return LawsTuning(rig, whole_kg, tuple(best), "", bandwidths, replace(proved, dwell_s=rig.schedule.dwell_s))


def kept_apart(rig: Prototype, found: Switching) -> Prototype:
    """The rig with changes of stage at least so far apart as is proved to be enough."""
    schedule = rig.schedule
    if schedule is None or found.stages.status != "proved" or found.stages.suffices(schedule.dwell_s):
        return rig
    needed = ceil(100 * nearest(found.stages.dwell_s)) / 100
    return rig.but(controller=schedule.but(dwell_s=needed))


def _ranges(
    prototype: Prototype, whole_kg: tuple[float, float], stages: int, overlap_kg: float
) -> list[tuple[float, float]]:
    """Payloads of the stages; what stands against them, all at once."""
    problems, found = [], []
    if not whole_kg[0] < whole_kg[1]:
        reason = f"{whole_kg[0]:g}:{whole_kg[1]:g} holds one payload, which needs no stages"
        problems.append(("payload.outer_end_mass_kg", reason))
    else:
        try:
            found = stage_ranges(whole_kg, stages, overlap_kg)
        except ValueError as error:
            problems.append(("stages", str(error)))
    laws = () if prototype.controller is None else prototype.controller.laws
    proved = not prototype.effects  # else no proof of changes asks for states to hand over
    if proved and prototype.sensor.filter_Hz is None and any(law.sections for law, _ in laws):
        problems.append(
            ("sensor.filter_Hz", "missing; structured stages need a filter before them to hand over states")
        )
    if problems:
        raise InputError(f"{prototype.name}: scheduled", problems)
    return found


def _hertz(found: Tuning) -> float:
    return 0.0 if found.best is None else found.best.bandwidth_Hz


def _stage(found: Tuning) -> Stage:
    assert found.best is not None
    law = found.best.controller
    assert law.lag is not None
    return Stage(
        outer_end_mass_kg=found.outer_end_mass_kg,
        gain_A_per_V=law.gain_A_per_V,
        pole_Hz=law.lag.pole_Hz,
        zero_Hz=law.lag.zero_Hz,
        section=law.sections,
    )
