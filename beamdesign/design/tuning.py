"""Tuning: the controller and inner end mass with the largest guaranteed bandwidth over a payload range.

Whatever the kind, one engine searches (`beamdesign.design.law_search`) and exact proofs decide: nothing is returned
that is not proved over the continuous range.

Laws for several sensors are synthesised by Riccati equations, or given: weights are searched for a synthesis that
serves the whole range of payloads; its law is reduced to an order that can be realised. What is then polished are its
entries themselves: the structure stays that of the observer, the figures are no longer optimal by any weights.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from types import MappingProxyType

import numpy as np

from beamdesign.controllers import KINDS, SENSED, Controller, Sensed
from beamdesign.controllers.block_form import block_form
from beamdesign.design.law_search import Effort, Found, Search, Told, from_seeds, sampled_masses, search
from beamdesign.design.loop_samples import COARSE_HZ, Samples, rig_samples
from beamdesign.design.refinement import Proved
from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.synthesis import StateSpace, hinf, lqg
from beamdesign.design.weight_search import Proposal, WeightSearch
from beamdesign.members import Member, served
from beamdesign.proof.family_certificate import gain_and_mass
from beamdesign.prototype import Goal, Prototype
from beamdesign.records import InputError

SYNTHESES = ("lqg", "hinf")
"""Kinds of synthesis."""

EFFORT = Effort(polished=2, candidates=1)
ADDED_SENSORS_EFFORT = Effort(polished=1, candidates=1)

_HINF_STARTS = 3
"""From how many weights of the regulator the least norm is sought; with half the evaluations, each takes so long."""

Given = tuple[Controller, float]
"""A law to begin with, and the mass inside, kg."""


def search_observer(
    task: Search, kind: str | None, starts: Sequence[Given] = (), told: Told = lambda share, text: None
) -> Found:
    """Find the largest guaranteed bandwidth of a law given by matrices.

    Args:
        task: what is asked; its sensors are those of the law.
        kind: one of `SYNTHESES`: how laws to polish are synthesised; None for the starts alone.
        starts: further laws to polish, with these sensors or fewer; others than linear ones are passed over.
        told: the share done and what is being done.
    """
    if len(task.sensors) > 1 and any(member.gain.low != member.gain.high for member in task.members):
        why = "with added sensors no tuner serves the range of gains that an effect of this prototype asks for"
        return Found(None, (), 0, why)
    given = [one for one in starts if one[0].observer or one[0].sections]
    if len(task.sensors) > 1 and kind and not given:
        # What the displacement alone reaches is where an added sensor begins.
        first = replace(task, sensors=task.sensors[:1], effort=replace(task.effort, polished=EFFORT.polished))
        alone = search_observer(first, kind, (), lambda share, text: told(0.4 * share, f"displacement alone, {text}"))
        if alone.proved is not None:
            given = [(alone.proved.controller, alone.proved.inner_end_mass_kg)]
    laws = [(StateSpace(*_matrices(law, task.sensors)), inner) for law, inner in given]
    if kind:
        laws += [(one.law, one.inner_end_mass) for one in _proposals(task, kind, told)[: task.effort.synthesised]]
    worth = _worth(task.points)
    opened = [
        (form[0], np.append(form[1], inner))
        for law, inner in laws
        if len(law.a) <= 2 * task.effort.blocks
        and (form := block_form(task.sensors, law.a, law.b, law.c, law.d, task.effort.blocks, worth)) is not None
    ]
    if not opened:
        return Found(None, (), 0, "no weights led to a stable controller with a stable loop")
    return search(task, opened, told=lambda share, text: told(0.4 + 0.6 * share, text))


def _proposals(task: Search, kind: str, told: Told) -> list[Proposal]:
    """Laws that were synthesised, the best first."""
    told(0.0, "searching weights")
    frequencies = np.union1d(COARSE_HZ, [task.goal.loop_gain_from_Hz])
    points = rig_samples(task.members, frequencies, sampled_masses(task.masses_kg), task.sensors)
    rig = next(member.rig for member in task.members if member.performance is not None)
    weights = WeightSearch(
        rig, task.sensors, points, task.goal, task.masses_kg, task.inner_kg[1], 2 * task.effort.blocks
    )
    found = weights.sampled(task.effort.weights)
    if found:
        told(0.1, "improving weights")
        found = [weights.improved(found[0], lqg, task.effort.evaluations), *found]
    if kind == "lqg" or not found:
        return found
    told(0.2, "improving weights of the least norm")
    tried = [weights.proposal(start.variables, hinf) for start in found[:_HINF_STARTS]]
    solved = sorted((one for one in tried if one is not None), key=lambda one: one.cost)
    return [weights.improved(solved[0], hinf, task.effort.evaluations // 2), *solved] if solved else []


def _worth(points: Samples) -> np.ndarray:
    """Gains through each sensor, over that through the first, that make the same loop gain about 10 Hz, (p,)."""
    near = (points.frequency_Hz > 5) & (points.frequency_Hz < 20)
    size = np.median(np.abs(points.control[:, 0, near]), axis=1)
    return np.asarray(size[0] / size)


def _matrices(law: Controller, sensors: tuple[Sensed, ...]) -> tuple[np.ndarray, ...]:
    """The matrices of a law with fewer sensors, which does nothing yet with the others."""
    model = law.control_model()
    a, b_own, c, d_own = (np.asarray(part) for part in (model.A, model.B, model.C, model.D))
    b, d = np.zeros((len(a), len(sensors))), np.zeros((1, len(sensors)))
    places = [sensors.index(name) for name in law.senses]
    b[:, places], d[:, places] = b_own, d_own
    return a, b, c, d


Progress = Told


def tunable() -> tuple[str, ...]:
    """What `tune` may be asked for: registered kinds of which a law can be sought, and kinds of synthesis."""
    return *(name for name, kind in KINDS.items() if kind.seeds()), *SYNTHESES


SMALLEST_BANDWIDTH_HZ = 1e-3
"""Below this a loop does not hold its load still, and is no answer."""


@dataclass(frozen=True)
class Tuning:
    """Outcome of `tune`.

    Attributes:
        prototype: with the tuned controller and end mass; as given where nothing was found.
        outer_end_mass_kg: the range of the guarantee.
        best: the proved loop, None where there is none.
        starts: bandwidths (Hz) that designs reached on samples, the largest first.
        certificates: how many exact stability proofs were run.
        reason: why there is no answer, empty where there is one.
        worst: of a robust design, (d,) standard deviations of each rig that was proved beside the nominal one.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    best: Proved | None
    starts: tuple[float, ...]
    certificates: int
    reason: str = ""
    worst: tuple[np.ndarray, ...] = ()


def tune(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str = "lag",
    largest_inner_end_mass_kg: float = 6.0,
    progress: Progress | None = None,
    sections: int = 3,
    sensors: Sequence[Sensed] = SENSED[:1],
    spread: RigSpread | None = None,
    near: bool = False,
    stable_kg: tuple[float, float] | None = None,
    least_inner_end_mass_kg: float = 0.0,
) -> Tuning:
    """Tune controller and inner end mass for the largest guaranteed bandwidth.

    Args:
        prototype: the rig; its goal sets the limits of compliance, peak sensitivity, loop gain and effort.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed.
        kind: a registered kind of controller, or one of `SYNTHESES`; these polish the prototype's own controller as
            well, where it is structured or an observer. A kind without seeds is tuned from the prototype's own.
        largest_inner_end_mass_kg: most mass that may be added to the inner tip.
        progress: told the share done and what is being done.
        sections: second-order sections of a structured controller.
        sensors: what an observer reads, of `beamdesign.controllers.SENSED`.
        spread: rigs that are off, of which the worst are proved as well; none: the nominal rig alone.
        near: begin with the prototype's own controller, where it is of this kind and its loop stable, instead of
            growing or synthesising others; these come after all where nothing next to it is proved.
        stable_kg: payloads for all of which it is to be stable, beside those it is for; None: for these alone.
        least_inner_end_mass_kg: least mass on the inner tip.

    Returns:
        the tuned prototype with what was proved of it, or a reason why there is none. Of a prototype with effects every
        linear member is proved.

    Raises:
        InputError: for effects for which no linear loop stands, or which together allow no proof.
        ValueError: for a kind that is none of these.
    """
    if kind not in (*KINDS, *SYNTHESES):
        raise ValueError(f"no tuning of kind {kind!r}")
    told = progress or (lambda share, text: None)
    stage = None if stable_kg is None else (outer_end_mass_kg, stable_kg)
    members = served(prototype, (stable_kg or outer_end_mass_kg)[1], stage)
    spread = spread and replace(spread, stage=stage)
    if any(_varies_on_the_mount(member) for member in members):
        raise InputError(prototype.name, gain_and_mass(prototype, outer_end_mass_kg[1]))
    own, inside = prototype.controller, (least_inner_end_mass_kg, largest_inner_end_mass_kg)
    asked = (members, prototype.goal, outer_end_mass_kg, inside)
    inner = prototype.payload.inner_end_mass_kg
    given = [] if own is None else [(own, inner)]
    opened = own.form() if own is not None and own.sought["kind"] == kind else None
    if kind in SYNTHESES:
        effort = EFFORT if len(sensors) == 1 else ADDED_SENSORS_EFFORT
        task = Search(*asked, tuple(sensors), spread, effort)
        alone = near and opened is not None and opened[0].sensors == task.sensors and task.settled(*opened, inner)
        heard = [one for one in given if set(one[0].senses) <= set(sensors)]
        found = search_observer(task, None if alone else kind, heard, told)
    else:
        task = Search(*asked, opened[0].sensors if opened else SENSED[:1], spread)
        starts, growths, alone = from_seeds(task, KINDS[kind]), sections if KINDS[kind].grows else 0, False
        if opened is not None and (near or not starts) and task.settled(*opened, inner):
            alone = growths > 0
            starts, growths = [(opened[0], np.append(opened[1], inner)), *([] if growths else starts)], 0
        found = search(task, starts, growths, told) if starts else Found(None, (), 0, _NO_START.format(kind))
    best = found.proved
    if best is None and alone:
        rest = (kind, largest_inner_end_mass_kg, progress, sections, sensors, spread)
        bare = prototype.but(controller=None)
        return tune(bare, outer_end_mass_kg, *rest, stable_kg=stable_kg, least_inner_end_mass_kg=inside[0])
    if best is None or best.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
        why = no_answer(kind, prototype.goal, outer_end_mass_kg, found.reason)
        return Tuning(prototype, outer_end_mass_kg, None, found.sampled, found.certificates, why)
    built = tuned(prototype, best, outer_end_mass_kg)
    return Tuning(built, outer_end_mass_kg, best, found.sampled, found.certificates, worst=found.worst)


_NO_START = "a {} controller is tuned from one of its kind with a stable loop, and the prototype has none"


def _varies_on_the_mount(member: Member) -> bool:
    """Whether its gain varies where it is to perform while the end mass shows in what is fed back."""
    inside = member.performance
    return member.rig.sensor_rides and inside is not None and inside.low < inside.high


def no_answer(kind: str, goal: Goal, masses_kg: tuple[float, float], failure: str) -> str:
    """Why there is no design, and what may allow one."""
    low, high = masses_kg
    return (
        f"no {kind} controller was found that is proved stable with peak sensitivity at most"
        f" {goal.peak_sensitivity:g} for outer end masses of {low:g} to {high:g} kg, and keeps"
        f" {goal.compliance_m_per_N:g} m/N up to any useful frequency ({failure}); a narrower range,"
        " a larger peak sensitivity, a larger compliance or more inner end mass may allow one"
    )


def tuned(prototype: Prototype, best: Proved, masses_kg: tuple[float, float]) -> Prototype:
    """The prototype with controller, inner end mass and range of a proved loop."""
    return prototype.but(
        controller=best.controller,
        payload=prototype.payload.but(outer_end_mass_kg=masses_kg, inner_end_mass_kg=best.inner_end_mass_kg),
        guarantee=None,
    )


VALVE_LIMITS = {"loop_gain": 0.25, "controller_effort_A_per_V": 0.06}
"""What the published valve bears, where neither a goal nor who asks says otherwise."""


def limited(goal: Goal, kind: str, given: Mapping[str, float | None] = MappingProxyType({})) -> Goal:
    """A goal with the limits that a valve sets to laws of high order; a lag and less keeps them by its form.

    Args:
        goal: its own limits stand.
        kind: of the controller that is sought, as `tune` has it.
        given: limits that stand before those of the goal, by name; infinite for none, None for nothing said.
    """
    high_order = kind in SYNTHESES or (kind in KINDS and KINDS[kind].grows)
    own = VALVE_LIMITS if high_order else {}
    changes = {name: value for name, value in own.items() if getattr(goal, name) is None}
    changes |= {name: value for name, value in given.items() if value is not None}
    return goal.but(**{name: None if value == inf else value for name, value in changes.items()})


def tune_alike(
    prototype: Prototype, outer_end_mass_kg: tuple[float, float], progress: Progress | None = None
) -> Tuning:
    """Tune another controller of the kind that a prototype has, from that one; a lag where it has none.

    Raises:
        InputError: for a kind that has no form to be tuned, and as `tune`.
    """
    asked = {"kind": "lag"} if prototype.controller is None else prototype.controller.sought
    kind = asked["kind"]
    if kind not in (*KINDS, *SYNTHESES):
        raise InputError(prototype.name, [("controller.kind", f"{kind!r} has no form that is tuned; give a lag")])
    rig = prototype.but(goal=limited(prototype.goal, kind))
    return tune(rig, outer_end_mass_kg, progress=progress, near=True, **asked)
