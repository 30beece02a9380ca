"""Robust tuning: the controller and inner end mass with the largest guaranteed bandwidth over a payload range.

A coarse search proposes, an interior-point method refines on finitely many points, and exact proofs decide: what they
refute becomes a further point, and nothing is returned that is not proved over the continuous range.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.stats import qmc

from beamdesign.controllers import SENSED, Sensed
from beamdesign.design.controller_forms import FORMS, ControllerForm
from beamdesign.design.loop_set import constraints, first_active
from beamdesign.design.observer_record import as_observer
from beamdesign.design.observer_tuning import OBSERVERS, tune_observer
from beamdesign.design.refinement import LARGEST_BANDWIDTH_HZ, LoopProgram, Proved, Refinement, refine
from beamdesign.design.starts import best_starts
from beamdesign.design.structured_tuning import grow
from beamdesign.members import Member, family
from beamdesign.proof.family_certificate import gain_and_mass
from beamdesign.prototype import Goal, Prototype
from beamdesign.records import InputError

Progress = Callable[[float, str], None]

SAMPLES = 256
"""Of the coarse search; a power of two, as Sobol's sequence wants."""

STARTS = 3
"""How many of the samples are refined."""

SMALLEST_BANDWIDTH_HZ = 1e-3
"""Below this a loop does not hold its load still, and is no answer."""

STRICTER_PEAKS = (5.0, 2.0)
"""Peak sensitivities to tune for where a looser limit led nowhere: at the brink of instability samples find little."""


@dataclass(frozen=True)
class Tuning:
    """Outcome of `tune`.

    Attributes:
        prototype: with the tuned controller and end mass; as given where nothing was found.
        outer_end_mass_kg: the range of the guarantee.
        best: the proved loop, None where there is none.
        starts: bandwidth that each start of the refinement was proved to reach, 0 for a failed one; of a structured
            controller or one with an observer, what designs reach on samples, the largest first.
        failures: why starts failed, under the last limit that was tried.
        certificates: how many exact stability proofs were run.
        reason: why there is no answer, empty where there is one.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    best: Proved | None
    starts: tuple[float, ...]
    failures: tuple[str, ...]
    certificates: int
    reason: str = ""


def bandwidth_program(
    members: tuple[Member, ...],
    form: ControllerForm,
    goal: Goal,
    masses_kg: tuple[float, float],
    largest_inner: float,
) -> LoopProgram:
    """Largest bandwidth of all members of a rig whose sections stand."""
    low, high = np.log(SMALLEST_BANDWIDTH_HZ), np.log(LARGEST_BANDWIDTH_HZ)
    bounds = np.array([*form.log_bounds, (0.0, largest_inner), (low, high)])
    return LoopProgram(
        form=form,
        goal=goal,
        outer_end_mass_kg=masses_kg,
        figures=lambda sections: ca.MX(0, 1),
        constraints=lambda active: constraints(form.kind, members, active),
        structure=lambda variables: ca.MX(0, 1),
        objective=lambda variables: -variables[len(form.names) + 1],
        lower=bounds[:, 0],
        upper=bounds[:, 1],
        reach=2.0,
        tighten_below=6e-5,
        members=lambda sections: members,
        flaw=lambda variables: "",
        cost=lambda proved: -proved.bandwidth_Hz,
        enforced=frozenset(first_active(members)),
    )


def tune(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str = "lag",
    largest_inner_end_mass_kg: float = 6.0,
    progress: Progress | None = None,
    sections: int = 3,
    sensors: Sequence[Sensed] = SENSED[:1],
) -> Tuning:
    """Tune controller and inner end mass for the largest guaranteed bandwidth.

    Args:
        prototype: the rig; its goal sets the limits of compliance and peak sensitivity.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed.
        kind: controller kind, a key of `beamdesign.design.controller_forms.FORMS`, `structured`, or one of `OBSERVERS`;
            these polish the prototype's own controller as well, where it is structured or an observer.
        largest_inner_end_mass_kg: most mass that may be added to the inner tip.
        progress: told the share done and what is being done.
        sections: second-order sections of a structured controller.
        sensors: what a controller with an observer reads, of `beamdesign.controllers.SENSED`.

    Returns:
        the tuned prototype with what was proved of it, or a reason why there is none. Of a prototype with effects every
        linear member is proved.

    Raises:
        InputError: for effects for which no linear loop stands, or which together allow no proof.
    """
    told = progress or (lambda fraction, text: None)
    members = family(prototype, outer_end_mass_kg[1]).members
    if any(_varies_on_the_mount(member) for member in members):
        raise InputError(prototype.name, gain_and_mass(prototype, outer_end_mass_kg[1]))
    if kind == "structured":
        grown = grow(members, prototype.goal, outer_end_mass_kg, largest_inner_end_mass_kg, sections, told)
        if grown.proved is None or grown.proved.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
            why = no_answer(kind, prototype.goal, outer_end_mass_kg, grown.reason)
            return Tuning(prototype, outer_end_mass_kg, None, grown.sampled, (grown.reason,), grown.certificates, why)
        found = tuned(prototype, grown.proved, outer_end_mass_kg)
        return Tuning(found, outer_end_mass_kg, grown.proved, grown.sampled, (), grown.certificates)
    if kind in OBSERVERS:
        own = [start for start in as_observer(prototype) if set(start[0].sensors) <= set(sensors)]
        asked = (outer_end_mass_kg, largest_inner_end_mass_kg, kind, sensors, told, own)
        seen = tune_observer(members, prototype.goal, *asked)
        if seen.proved is None or seen.proved.bandwidth_Hz < SMALLEST_BANDWIDTH_HZ:
            why = no_answer(kind, prototype.goal, outer_end_mass_kg, seen.reason)
            return Tuning(prototype, outer_end_mass_kg, None, seen.sampled, (seen.reason,), seen.certificates, why)
        found = tuned(prototype, seen.proved, outer_end_mass_kg)
        return Tuning(found, outer_end_mass_kg, seen.proved, seen.sampled, (), seen.certificates)
    form = FORMS[kind]
    peaks = [limit for limit in STRICTER_PEAKS if limit < prototype.goal.peak_sensitivity]
    certificates = 0
    for k, peak in enumerate([prototype.goal.peak_sensitivity, *peaks]):
        goal = prototype.goal.but(peak_sensitivity=peak)
        program = bandwidth_program(members, form, goal, outer_end_mass_kg, largest_inner_end_mass_kg)
        refined, proofs = refine_best(program, _within(told, k, len(peaks) + 1))
        certificates += proofs
        proved = [refinement.proved for refinement in refined if refinement.proved]
        if proved:
            break
    reached = tuple(refinement.proved.bandwidth_Hz if refinement.proved else 0.0 for refinement in refined)
    failures = tuple(refinement.reason for refinement in refined if refinement.reason)
    if not proved:
        failure = failures[0] if failures else "no sampled design keeps within that peak"
        reason = no_answer(kind, prototype.goal, outer_end_mass_kg, failure)
        return Tuning(prototype, outer_end_mass_kg, None, reached, failures, certificates, reason)
    best = min(proved, key=program.cost)
    return Tuning(tuned(prototype, best, outer_end_mass_kg), outer_end_mass_kg, best, reached, failures, certificates)


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


def _within(told: Progress, k: int, count: int) -> Progress:
    """Progress of the k-th of so many equal parts."""
    return lambda fraction, text: told((k + fraction) / count, text)


def refine_best(program: LoopProgram, told: Progress) -> tuple[list[Refinement], int]:
    """Refine the best samples of a program; with the number of stability proofs."""
    told(0.0, "coarse search")
    unit = qmc.Sobol(len(program.lower), scramble=True, rng=0).random(SAMPLES)
    samples = program.lower + unit * (program.upper - program.lower)
    starts, proofs = best_starts(program, samples, lambda variables: -float(variables[-1]), STARTS)
    refined = []
    for k, start in enumerate(starts):
        told((k + 1) / (len(starts) + 1), f"refining and proving start {k + 1} of {len(starts)}")
        refined.append(refine(program, start, SMALLEST_BANDWIDTH_HZ))
    return refined, proofs + sum(refinement.certificates for refinement in refined)
