"""Tuning: the laws and the inner end mass with the largest guaranteed bandwidth over a payload range.

Whatever the kind, one engine searches (`beamdesign.synthesis.law_search`) and exact proofs decide: nothing is returned
that is not proved over the continuous range.

A scheduled controller has a law for each part of the payloads. Every stage performs over its own and is stable over all
of them and a little more, so that no estimate of the payload, however wrong, destabilises the loop: see
`beamdesign.plant.members.served`. A fixed law is the case of one stage.

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
from math import ceil, floor, log10, prod

import numpy as np

from beamdesign.arguments import checked, takes
from beamdesign.controllers import KINDS, SENSED, Estimator, Scheduled, Sensed, Stage, wrong_sensors
from beamdesign.controllers.scheduled import STAGES, sampling_period_s
from beamdesign.parameters import stated_or_typical
from beamdesign.plant.actuators import not_felt
from beamdesign.plant.assembly import mass_unit_kg, most_inside_kg, pace
from beamdesign.plant.members import served
from beamdesign.polynomial import nearest
from beamdesign.progress import Progress, part_of, silent
from beamdesign.proofs.box import BoxVerdict
from beamdesign.proofs.certifying import gain_and_mass
from beamdesign.proofs.lyapunov import Switching, switching
from beamdesign.proofs.mass_family import stage_families
from beamdesign.proofs.tolerance_box import between
from beamdesign.prototype import InStage, Prototype
from beamdesign.quantities import MassOrNone, Sigmas, stated_bandwidth
from beamdesign.records import InputError, Problem
from beamdesign.result import Result
from beamdesign.structure import lumped
from beamdesign.synthesis import SIGMAS
from beamdesign.synthesis.law_design import Proved, no_answer
from beamdesign.synthesis.law_search import Found, search
from beamdesign.synthesis.law_starts import from_seeds, widely
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_samples import Design, form_for
from beamdesign.synthesis.rig_spread import RigSpread, rig_spread
from beamdesign.synthesis.weight_search import ADDED_SENSORS_EFFORT, EFFORT, SYNTHESES, limited, search_observer
from beamdesign.time_limit import is_limited, over, while_time, within


def tunable() -> tuple[str, ...]:
    """What `tune` may be asked for: registered kinds of which a law can be sought, and kinds of synthesis."""
    return *(name for name, kind in KINDS.items() if any(seed.form() for seed in kind.seeds())), *SYNTHESES


SMALLEST_BANDWIDTH_HZ = 1e-3
"""Below this a loop does not hold its load still, and is no answer."""
NEARLY = 0.98
"""Share of the largest bandwidth of the worst stage that counts as nearly as much."""


@dataclass(frozen=True, repr=False)
class Tuning(Result):
    """Outcome of `tune`.

    Attributes:
        prototype: with the tuned controller and end mass; as given where nothing was found.
        outer_end_mass_kg: the range of the guarantee, of several laws all payloads.
        best: the proved loop, of several laws that of the least bandwidth; None where there is none.
        starts: bandwidths (Hz) that designs reached on samples, the largest first.
        certificates: how many exact stability proofs were run.
        reason: why there is no answer, empty where there is one.
        caution: a word on tolerances that are not stated.
        laws: of several laws the tuning of each over its own payloads.
        alone_Hz: of several laws, the bandwidth of each tuned with a mass inside of its own: what no common mass can
            exceed.
        switching: what is proved of changes between several laws; None with effects, which that does not cover.
        left_out: what was not tried for want of time, in words.
        between: of one law for exactly the figures stated, the verdict on all between the values that effects freeze.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    best: Proved | None = None
    starts: tuple[float, ...] = ()
    certificates: int = 0
    reason: str = ""
    caution: str = ""
    laws: "tuple[Tuning, ...]" = ()
    alone_Hz: tuple[float, ...] = ()
    switching: Switching | None = None
    left_out: tuple[str, ...] = ()
    between: BoxVerdict | None = None

    @property
    def yes(self) -> bool:
        """Whether there is an answer, also between what effects freeze, with changes between its laws if looked at."""
        return not (self.reason or self.open_between) and (self.switching is None or self.switching.stable)

    @property
    def open_between(self) -> str:
        """Why laws are not proved stable between the values that effects freeze; empty where they are."""
        return "; ".join(one.between.of_frozen for one in self.each if one.between and not one.between.stable)

    @property
    def each(self) -> "tuple[Tuning, ...]":
        """The tuning of every law, of a fixed one itself."""
        return self.laws or (self,)

    @property
    def stages(self) -> tuple[InStage, ...]:
        """The tuned prototype with each law."""
        return self.prototype.stages(self.outer_end_mass_kg)


@dataclass(frozen=True)
class LawOptions:
    """What one law is sought with.

    Attributes:
        kind: a registered kind of controller, or one of `SYNTHESES`; these refine the prototype's own controller as
            well, where it is structured or an observer. A kind without seeds is tuned from the prototype's own; so,
            beside its seeds, is the lag of a stage.
        inner_kg: least and most mass on the inner tip.
        sections: second-order sections of a structured controller.
        sensors: what an observer reads, of `beamdesign.controllers.SENSORS`.
        spread: rigs that are off, of which the worst are proved as well; none: the nominal rig alone.
        near: begin with the prototype's own controller, where it is of this kind and its loop stable, instead of
            growing or synthesising others; these come after all where nothing next to it is proved.
        stable_kg: payloads for all of which it is to be stable, beside those it is for; None: for these alone.
    """

    kind: str = "lag"
    inner_kg: tuple[float, float] = (0.0, 6.0)
    sections: int = 3
    sensors: tuple[Sensed, ...] = SENSED[:1]
    spread: RigSpread | None = None
    near: bool = False
    stable_kg: tuple[float, float] | None = None


@takes("Prototype")
def tune(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float] | None = None,
    kind: str = "lag",
    largest_inner_end_mass_kg: float | None = None,
    progress: Progress | None = None,
    sections: int = 3,
    sensors: Sequence[Sensed] = SENSED[:1],
    sigmas: float = SIGMAS,
    stages: int = 3,
    near: bool = False,
    estimator: Estimator | None = None,
    minutes: float | None = None,
) -> Tuning:
    """Tune a controller of one law, or of a law for each part of the payloads, for the largest guaranteed bandwidth.

    Args:
        prototype: the rig; its goal sets the limits of compliance, peak sensitivity, loop gain and effort. A structured
            controller of its own sets the form of the stages of a scheduled one.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed; else the prototype's.
        kind: see `LawOptions`; "scheduled" for several laws.
        largest_inner_end_mass_kg: most mass that may be added to the inner tip; else what is usually enough, see
            `beamdesign.plant.assembly.most_inside_kg`.
        progress: told the share done and what is being done.
        sections: see `LawOptions`.
        sensors: see there.
        near: see there.
        sigmas: standard deviations of the prototype's `[tolerance]` by which every figure may be off at once, which
            all is guaranteed for; typical ones where none is stated. Zero: for exactly its figures.
        stages: how many laws a scheduled controller has.
        estimator: of the payload, for a scheduled controller, else a usual one; stages overlap by two and a half times
            its band, of which half a band is hysteresis.
        minutes: after about which the best that was proved until then is the answer.

    Returns:
        the tuned prototype with what was proved of it, or a reason why there is none. Of a prototype with effects every
        linear member is proved. Changes between several laws are proved, and set as far apart as that needs, where it
        has no effects.

    Raises:
        InputError: for figures that are not plausible; for effects for which no linear loop stands, or which together
            allow no proof; where so many stages do not fit into the range, and for structured stages without a filter
            before them whose changes are to be proved.
        ValueError: for a kind that is none of these, or an empty range.
    """
    masses_kg = prototype.asked_kg(outer_end_mass_kg)
    given, most = lumped.figures(prototype), largest_inner_end_mass_kg
    most = most_inside_kg(given, masses_kg[1]) if most is None else most
    checked(prototype.name, "largest_inner_end_mass_kg", MassOrNone, most)
    checked(prototype.name, "sigmas", Sigmas, sigmas)
    if kind not in (*KINDS, *SYNTHESES):
        raise ValueError(f"no tuning of kind {kind!r}; expected one of {', '.join(tunable())}, scheduled")
    wrong = [*not_felt(type(prototype.actuator), sensors, "controller"), *wrong_sensors(sensors)]
    if len(sensors) > 1 and kind not in SYNTHESES:
        wrong.append(Problem("sensors", f"a {kind} controller reads the displacement alone; ask for lqg or hinf"))
    if prototype.goal.comes_to_rest and not prototype.goal.lower_gains:
        reason = "asks for lower_gains, which are what a saturated current comes to"
        wrong.append(Problem("goal.comes_to_rest", reason))
    if wrong:
        raise InputError(prototype.name, wrong)
    report, caution, spread = progress or silent, "", None
    if sigmas:
        tolerance, caution = stated_or_typical(prototype.tolerance, type(prototype.actuator))
        prototype = prototype.but(tolerance=tolerance)
        spread = rig_spread(prototype.but(controller=None, guarantee=None), masses_kg[1], sigmas)
    asked = LawOptions(kind, (0.0, most), sections, tuple(sensors), spread, near)
    with within(minutes) as limit:
        if kind == Scheduled.model_fields["kind"].default:
            usual = Estimator.usual(pace(given), mass_unit_kg(given))
            figures = estimator or usual.but(noise_V=prototype.sensor.noise_V or usual.noise_V)
            found = _tune_stages(prototype, masses_kg, asked, stages, figures, report)
        else:
            found = tune_law(prototype, masses_kg, asked, report)
    return replace(found, caution=caution, left_out=tuple(limit.left_out))


def tune_law(prototype: Prototype, masses_kg: tuple[float, float], asked: LawOptions, report: Progress) -> Tuning:
    """Tune one law over a range of payloads (kg); arguments and errors as of `tune`."""
    kind, own = asked.kind, prototype.controller
    inner = float(np.clip(prototype.payload.inner_end_mass_kg, *asked.inner_kg))
    stage = None if asked.stable_kg is None else (masses_kg, asked.stable_kg)
    members = served(prototype.but(controller=None), (asked.stable_kg or masses_kg)[1], stage)  # whatever law it has
    spread = asked.spread and replace(asked.spread, stage=stage)
    riding = [member.performance for member in members if member.rig.sensor_rides and member.performance is not None]
    if any(inside.low < inside.high for inside in riding):  # the gain varies while the end mass shows in the feedback
        raise InputError(prototype.name, gain_and_mass(prototype, masses_kg[1]))
    given = (members, prototype.goal, masses_kg, asked.inner_kg)
    own_kind = own is not None and own.sought["kind"] == kind
    sought_from = own.form() if own is not None and own_kind else None
    start = None
    if sought_from is not None:
        start = Design(form_for(sought_from[0], members[0].rig.figures), np.append(sought_from[1], inner))
    if kind in SYNTHESES:
        effort = EFFORT if len(asked.sensors) == 1 else ADDED_SENSORS_EFFORT
        task = Search(*given, asked.sensors, spread, effort)
        alone = asked.near and start is not None and start.form.sensors == task.sensors and task.settled(start)
        near = [(own, inner)] if own is not None and set(own.senses) <= set(asked.sensors) else []
        found = search_observer(task, None if alone else kind, near, report)
    else:
        task = Search(*given, start.form.sensors if start else SENSED[:1], spread)
        seeds = KINDS[kind].seeds()
        starts, alone = from_seeds(task, seeds), False
        growths = asked.sections if KINDS[kind].grows else 0
        if start is not None and (asked.near or not starts or (stage and not growths)) and task.settled(start):
            alone = growths > 0
            starts, growths = [start, *([] if growths else starts)], 0
        none = f"a {kind} controller is tuned from one of its kind with a stable loop, and the prototype has none"
        if start is None and not starts and (seeds or own_kind):
            raise InputError(prototype.name, [("controller.kind", f"{kind!r} has no form that is tuned; give a lag")])
        found = search(task, starts + widely(task, starts), growths, report) if starts else Found(None, (), 0, none)
    best = found.proved
    if best is None and alone and not over():
        return tune_law(prototype.but(controller=None), masses_kg, replace(asked, near=False), report)
    if best is None or best.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
        failure = found.reason if best is None else f"guarantees {stated_bandwidth(best.bandwidth_Hz)}"
        why = no_answer(kind, prototype.goal, masses_kg, failure, 0.0 if spread is None else spread.sigmas)
        return Tuning(prototype, masses_kg, None, found.sampled, found.certificates, why)
    rig = prototype.with_law(best.controller, masses_kg, best.inner_end_mass_kg)
    inside = between(rig, *masses_kg) if rig.effects and spread is None else None  # a box of rigs holds all of it
    return Tuning(rig, masses_kg, best, found.sampled, found.certificates, between=inside)


def tune_alike(
    prototype: Prototype, outer_end_mass_kg: tuple[float, float], progress: Progress | None = None
) -> Tuning:
    """Tune another controller of the kind that a prototype has, from that one; a lag where it has none.

    For exactly its figures, which have been measured.

    Raises:
        InputError: for a kind that has no form to be tuned, and as `tune`.
    """
    asked = {"kind": "lag"} if prototype.controller is None else prototype.controller.sought
    if (kind := asked["kind"]) not in (*KINDS, *SYNTHESES):
        raise InputError(prototype.name, [("controller.kind", f"{kind!r} has no form that is tuned; give a lag")])
    return tune(limited(prototype, kind), outer_end_mass_kg, progress=progress, sigmas=0.0, near=True, **asked)


def _tune_stages(
    prototype: Prototype,
    whole_kg: tuple[float, float],
    asked: LawOptions,
    stages: int,
    figures: Estimator,
    report: Progress,
) -> Tuning:
    """Tune a law for each of some overlapping parts of a payload range, with one mass inside for all."""
    ranges = _ranges(prototype, whole_kg, stages, 2.5 * figures.band_kg)
    steps, done = 2 * stages * stages + 1, 0

    def tuned(stage_kg: tuple[float, float], inner: float | None) -> Tuning:
        nonlocal done
        begun, done = done, done + 1
        with_mass = "by itself" if inner is None else f"with {inner:.4g} kg inside"
        words = f"stage {ranges.index(stage_kg) + 1} of {stages} {with_mass}"
        own, middle = prototype.controller, sum(stage_kg) / 2
        law = next((law for law, (low, high) in own.laws if low <= middle <= high), None) if own is not None else None
        near = law is not None and bool(law.sections)
        if near:  # from the law that acts there, with the mass that it has inside
            inner = prototype.payload.inner_end_mass_kg
        inside_kg = asked.inner_kg if inner is None else (inner, inner)
        one = replace(asked, kind="structured" if near else "lag", inner_kg=inside_kg, near=near, stable_kg=whole_kg)
        return tune_law(
            prototype.but(controller=law), stage_kg, one, lambda share, _: report((begun + share) / steps, words)
        )

    alone: list[Tuning] = []
    for k, stage_kg in enumerate(ranges, start=1):
        alone.append(tuned(stage_kg, None))
        if alone[-1].best is None:
            reason = f"stage {k}, stable for all payloads as well: {alone[-1].reason}"
            return Tuning(prototype, whole_kg, reason=reason, alone_Hz=tuple(map(_hertz, alone[:-1])))

    decimals = 2 + _finer(asked.inner_kg[1])
    own_kg = sorted({round(one.best.inner_end_mass_kg, decimals) for one in alone if one.best is not None})
    tried_kg = sorted({*own_kg, *(round((one + two) / 2, decimals) for one, two in pairwise(own_kg))})
    same = len({one.best.inner_end_mass_kg for one in alone if one.best is not None}) == 1
    if is_limited():  # the one in the middle first
        tried_kg.insert(0, tried_kg.pop(len(tried_kg) // 2))
    masses_kg = while_time(tried_kg, lambda inner: f"{inner:g} kg inside", least=1)
    tried = [alone] if same else [[tuned(stage_kg, inner) for stage_kg in ranges] for inner in masses_kg]
    enough = NEARLY * max(min(map(_hertz, found)) for found in tried)
    best = max((f for f in tried if min(map(_hertz, f)) >= enough), key=lambda found: prod(map(_hertz, found)))
    alone_Hz = tuple(map(_hertz, alone))
    if min(map(_hertz, best)) == 0:
        reason = "no mass inside was found with which every stage can be proved" + " in the time given" * over()
        return Tuning(prototype, whole_kg, reason=reason, alone_Hz=alone_Hz)
    laws, inside = tuple(map(_stage, best)), best[0].prototype.payload
    schedule = Scheduled(stage=laws, estimator=figures, period_s=sampling_period_s(laws, figures))
    rig = prototype.with_law(schedule, whole_kg, inside.inner_end_mass_kg)
    whole = Tuning(rig, whole_kg, min(best, key=_hertz).best, laws=tuple(best), alone_Hz=alone_Hz)
    if rig.effects:  # of which no states are known in which laws could change
        return whole
    of_changes = part_of(report, (steps - 1) / steps, 1.0)
    proved = switching(stage_families(rig), *whole_kg, dwell_s=schedule.dwell_s, update=of_changes)
    rig = kept_apart(rig, proved)
    assert rig.schedule is not None
    return replace(whole, prototype=rig, switching=replace(proved, dwell_s=rig.schedule.dwell_s))


def kept_apart(rig: Prototype, found: Switching) -> Prototype:
    """The rig with changes of stage at least so far apart as is proved to be enough."""
    schedule = rig.schedule
    if schedule is None or found.stages.dwell_s is None or found.stages.suffices(schedule.dwell_s):
        return rig
    return rig.but(controller=schedule.but(dwell_s=ceil(100 * nearest(found.stages.dwell_s)) / 100))


def _finer(most_kg: float) -> int:
    """How many decimals more masses have than those of kilograms."""
    return max(0, -floor(log10(most_kg))) if most_kg > 0 else 0


def stage_ranges(whole_kg: tuple[float, float], count: int, overlap_kg: float) -> list[tuple[float, float]]:
    """Equal parts of a range, each widened by half an overlap towards its neighbours; in grams or finer."""
    (low, high), half, decimals = whole_kg, overlap_kg / 2, 3 + _finer(whole_kg[1])
    edges = [low + k * ((high - low) / count) for k in range(1, count)]
    lows, highs = ([round(edge + by, decimals) for edge in edges] for by in (-half, half))
    return list(zip([low, *lows], [*highs, high], strict=True))


def _ranges(
    prototype: Prototype, whole_kg: tuple[float, float], stages: int, overlap_kg: float
) -> list[tuple[float, float]]:
    """Payloads of the stages; what stands against them, all at once."""
    problems = []
    if not STAGES[0] <= stages <= STAGES[1]:
        words = "one law for all payloads is of another kind: ask for it"
        problems.append(("stages", f"must be {STAGES[0]} to {STAGES[1]}, is {stages}; {words}"))
    elif not whole_kg[0] < whole_kg[1]:
        reason = f"{whole_kg[0]:g}:{whole_kg[1]:g} holds one payload, which needs no stages"
        problems.append(("payload.outer_end_mass_kg", reason))
    elif not (width := (whole_kg[1] - whole_kg[0]) / stages) > overlap_kg:
        reason = f"{stages} stages of {width:.4g} kg each leave no room for overlaps of {overlap_kg:.4g} kg"
        problems.append(("stages", f"{reason}; fewer stages or a narrower band of the estimate would"))
    laws = () if prototype.controller is None else prototype.controller.laws
    # With effects no proof of changes asks for states to hand over.
    if not prototype.effects and prototype.sensor.filter_Hz is None and any(law.sections for law, _ in laws):
        reason = "missing; structured stages need a filter before them to hand over states"
        problems.append(("sensor.filter_Hz", reason))
    if problems:
        raise InputError(f"{prototype.name}: scheduled", problems)
    return stage_ranges(whole_kg, stages, overlap_kg)


def _hertz(found: Tuning) -> float:
    return 0.0 if found.best is None else found.best.bandwidth_Hz


def _stage(found: Tuning) -> Stage:
    assert found.best is not None
    return Stage(outer_end_mass_kg=found.outer_end_mass_kg, **found.best.controller.model_dump(exclude={"kind"}))
