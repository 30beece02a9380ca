"""The one engine of tuning: from laws that are given or grown to the largest bandwidth that is proved.

Laws are searched for coarsely and refined on samples of all loops; what grows is grown and refined anew, the best few
go on. What is returned is proved by the same oracle as every other loop: where it refutes a limit between the samples,
the peak that stood there joins them, all limits are tightened by what was missing, and the refinement is done again.

Of a robust search limits are held on samples at the worst rig of every point; of the best design the worst rigs are
collected, and each is proved over the whole payload range as the nominal one is. The rigs between are not proved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf, log

import numpy as np

from beamdesign.controllers import SENSED, Controller, Sensed
from beamdesign.controllers.form import Form
from beamdesign.plant.members import VertexModel, family
from beamdesign.progress import Progress, silent
from beamdesign.proofs.certificate import Claim
from beamdesign.prototype import Goal
from beamdesign.rational import nearest
from beamdesign.records import InputError, Problem
from beamdesign.synthesis.bandwidth import NEARLY, TOUCH, WORTH, LawRefinement, coarse_search
from beamdesign.synthesis.loop_limits import ends, loop_set
from beamdesign.synthesis.loop_samples import (
    COMPLIANCE,
    FINE_HZ,
    MODES_HZ,
    Samples,
    rig_samples,
    sampled_bandwidth,
    slacks,
    worst_samples,
)
from beamdesign.synthesis.refinement import LARGEST_BANDWIDTH_HZ, Proved
from beamdesign.synthesis.rig_spread import RigSpread


@dataclass(frozen=True)
class Effort:
    """How much is tried.

    Attributes:
        steps: linear programs of a coarse search, at most.
        rounds: of a refinement, at most.
        starts: how many starts are refined, and how many laws of one size the next are grown from.
        refined: how many of the laws that are grown are refined for good.
        candidates: how many designs are proved, at most.
        proofs: rounds of proof and back-off for one design, at most.
        weights: of a synthesis: how many are sampled, a power of two, as Sobol's sequence wants.
        evaluations: of the search that improves weights.
        synthesised: how many laws of a synthesis are searched from.
        blocks: pairs of poles that are realised of these: order 8.
        frequency_Hz: of the samples.
    """

    steps: int = 150
    rounds: int = 20
    starts: int = 2
    refined: int = 3
    candidates: int = 3
    proofs: int = 10
    weights: int = 256
    evaluations: int = 150
    synthesised: int = 5
    blocks: int = 4
    frequency_Hz: tuple[float, ...] = tuple(FINE_HZ)


_FIRST_ROUNDS = 5
"""Of a refinement of many, before the best of them are refined for good."""

_FURTHER = 0.2
"""How far a variable may move in a step of the last refinement."""

_ENOUGH = 0.985
"""Share of the sampled bandwidth which, if proved, ends the search for more."""

_SPARE = 2e-6
"""What limits are tightened by beyond what was missing, for the rounding of figures."""

_PEAK = np.linspace(0.97, 1.03, 61)
"""Frequencies about a peak that a proof has found, over its own."""

_STRICTER = 1 + 1e-9
"""Factor on the limit of sensitivity about a peak, so that nothing else is limited there."""


@dataclass(frozen=True)
class Search:
    """What a law has to serve, with the samples of all its loops.

    Attributes:
        members: linear members of the rig.
        goal: limits of compliance, sensitivity, loop gain and effort.
        masses_kg: range of outer end mass.
        inner_kg: least and most mass inside.
        sensors: what the law senses.
        spread: rigs that are off, among which the worst are to keep all limits as well; none: the nominal rig alone.
    """

    members: Sequence[VertexModel]
    goal: Goal
    masses_kg: tuple[float, float]
    inner_kg: tuple[float, float]
    sensors: tuple[Sensed, ...] = SENSED[:1]
    spread: RigSpread | None = None
    effort: Effort = Effort()
    points: Samples = field(init=False, repr=False)
    _refinements: dict[Form, LawRefinement] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Sample the loops."""
        frequencies = np.union1d(self.effort.frequency_Hz, [self.goal.loop_gain_from_Hz])
        if any(member.rig.effects for member in self.members):
            frequencies = np.union1d(frequencies, MODES_HZ)
        object.__setattr__(self, "points", self.sampled(frequencies, sampled_masses(self.masses_kg)))

    def sampled(self, frequency_Hz: np.ndarray, masses: Sequence[float], relaxed: float = 1.0) -> Samples:
        """All loops at some frequencies and outer end masses (kg), and those of the rigs that are off."""

        def of(members: Sequence[VertexModel]) -> Samples:
            return rig_samples(members, frequency_Hz, masses, self.sensors, relaxed)

        return of(self.members) if self.spread is None else worst_samples(self.spread, self.members, of)

    def settled(self, form: Form, variables: np.ndarray, inner_end_mass: float) -> bool:
        """Whether the loops of a law with a mass inside (kg) are stable as far as the samples tell."""
        return slacks(self.points, self.goal, form, np.append(variables, inner_end_mass), slopes=False).settled

    def refinement(self, form: Form) -> LawRefinement:
        """The refinement of laws of a form, built once."""
        if form not in self._refinements:
            masses = sampled_masses(self.masses_kg)
            listed = [
                (rig.polynomials(self.sensors), factor, k * len(masses))
                for k, (rig, factor, performs) in enumerate(ends(self.members))
                if performs
            ]
            self._refinements[form] = LawRefinement(self.points, self.goal, form, self.inner_kg, listed, masses)
        return self._refinements[form]

    def with_peak(self, refinement: LawRefinement, claim: Claim) -> LawRefinement:
        """A refinement that sees the peak about which a limit of the sensitivity was refuted."""
        assert claim.witness is not None
        at = claim.witness.frequency_Hz * _PEAK
        more = self.sampled(at, [nearest(claim.witness.mass)], _STRICTER)
        return replace(refinement, points=refinement.points.joined(more))

    def coarsely_searched(self, form: Form, variables: np.ndarray) -> tuple[np.ndarray, float]:
        """Variables and sampled bandwidth after a coarse search, or of the start where that is better."""
        lower, upper = np.append(form.lower, self.inner_kg[0]), np.append(form.upper, self.inner_kg[1])
        higher = coarse_search(self.points, self.goal, form, variables, lower, upper, most=self.effort.steps)
        return max(((one, self._worth(form, one)) for one in (variables, higher)), key=lambda pair: pair[1])

    def _worth(self, form: Form, variables: np.ndarray) -> float:
        """Sampled bandwidth (Hz), made less by what violates the limits; 0 of a loop that is not stable."""
        left = slacks(self.points, self.goal, form, variables, slopes=False)
        if not left.settled:
            return 0.0
        return sampled_bandwidth(self.points, left.compliance + NEARLY / 2) / (1 + 10 * left.violation)


@dataclass(frozen=True)
class Found:
    """Outcome of a search.

    Attributes:
        proved: the best loop that was proved; None where there is none.
        sampled: bandwidths (Hz) that designs reached on samples, the largest first.
        certificates: how many exact proofs of a loop were run.
        reason: why nothing was proved, empty where something was.
        worst: of a robust design, (d,) standard deviations of each rig that was proved beside the nominal one.
    """

    proved: Proved | None
    sampled: tuple[float, ...]
    certificates: int
    reason: str = ""
    worst: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class _Design:
    """A form, variables with the mass inside, and the bandwidth on samples."""

    form: Form
    variables: np.ndarray
    bandwidth_Hz: float

    @property
    def law(self) -> Controller:
        return self.form.record(self.variables[:-1])

    @property
    def inner_end_mass(self) -> float:
        return round(float(self.variables[-1]), 6)


Start = tuple[Form, np.ndarray]
"""A form and variables (v,) of it, the mass inside (kg) last."""


def search(task: Search, starts: Sequence[Start], growths: int = 0, report: Progress = silent) -> Found:
    """Find the largest guaranteed bandwidth.

    Args:
        task: what is asked.
        starts: laws to begin with; those with unstable loops lead nowhere.
        growths: how often they are grown.
        report: told the share done and what is being done.
    """
    effort, pool = task.effort, []
    for k, (form, variables) in enumerate(starts):
        report(0.2 * k / len(starts), f"start {k + 1} of {len(starts)}")
        pool.append(_Design(form, *task.coarsely_searched(form, variables)))
    pool = _refined(task, _best(pool)[: effort.starts], _part(report, 0.2, 0.65 / (1 + growths)))
    for growth in range(growths):
        more = [
            _Design(form, np.append(variables, design.variables[-1]), 0.0)
            for design in pool[: effort.starts]
            for law in design.law.grown()
            if (opened := law.form()) is not None
            for form, variables in [opened]
        ]
        pool = _refined(task, more, _part(report, 0.2 + 0.65 * (growth + 1) / (1 + growths), 0.65 / (1 + growths)))
    reached = tuple(design.bandwidth_Hz for design in pool)
    certificates, best = 0, Found(None, reached, 0, "no start led to a stable loop within the limits on the samples")
    for rough in pool[: effort.candidates]:
        if rough.bandwidth_Hz <= 0 or (best.proved and best.proved.bandwidth_Hz > _ENOUGH * rough.bandwidth_Hz):
            continue
        report(0.85, f"refining {rough.bandwidth_Hz:.3g} Hz for good")
        further = task.refinement(rough.form)(rough.variables, rounds=3 * effort.rounds, reach=_FURTHER)
        design = _Design(rough.form, *further)
        report(0.9, f"proving {design.bandwidth_Hz:.3g} Hz")
        found = _proved(task, design, reached)
        certificates += found.certificates
        if best.proved is None or (found.proved and found.proved.bandwidth_Hz > best.proved.bandwidth_Hz):
            best = found
    return replace(best, certificates=certificates)


def from_seeds(task: Search, kind: type[Controller]) -> list[Start]:
    """The seeds of a kind with little and with much mass inside, their gains lowered until the loops are stable."""
    least, most = task.inner_kg
    found = []
    for seed in kind.seeds():
        for inner in sorted({least, least + 0.3 * (most - least)}):
            if (opened := seed.form()) is None:
                continue
            form, variables = opened[0], np.append(opened[1], inner)
            while not task.settled(form, variables[:-1], inner):
                if variables[0] <= form.lower[0]:
                    break
                variables[0] -= 0.5
            found.append((form, variables))
    return found


def sampled_masses(masses_kg: tuple[float, float]) -> list[float]:
    """Outer end masses of the samples, kg."""
    return [float(mass) for mass in np.unique(np.linspace(*masses_kg, 3))]


def _refined(task: Search, designs: Sequence[_Design], report: Progress) -> list[_Design]:
    """The best designs, refined: all of them a little, then those that came out best for good."""
    going, most = list(designs), task.effort.rounds
    passes = (min(_FIRST_ROUNDS, most), most) if len(designs) > task.effort.refined else (most,)
    done, count = 0, len(designs) + (len(passes) - 1) * task.effort.refined
    for rounds in passes:
        found = []
        for design in going:
            report(done / count, f"refining {done + 1} of {count}")
            found.append(_Design(design.form, *task.refinement(design.form)(design.variables, rounds=rounds)))
            done += 1
        going = _best(found)[: task.effort.refined]
    return going


def _best(found: Sequence[_Design]) -> list[_Design]:
    """The designs with the largest bandwidth first, each bandwidth once."""
    chosen: list[_Design] = []
    for design in sorted(found, key=lambda one: -one.bandwidth_Hz):
        if not chosen or design.bandwidth_Hz < chosen[-1].bandwidth_Hz * (1 - 1e-3):
            chosen.append(design)
    return chosen


def _part(report: Progress, start: float, length: float) -> Progress:
    """Progress of a part of the whole."""
    return lambda share, text: report(start + length * share, text)


def _proved(task: Search, design: _Design, sampled: tuple[float, ...]) -> Found:
    """The best loop proved at a design or a little inside the limits.

    A compliance that touches its limit far below the bandwidth costs most of it: then more of it is kept to spare.
    """
    refinement, inside, stiffer, reason = task.refinement(design.form), 0.0, TOUCH, ""
    best: Proved | None = None
    rigs: tuple[np.ndarray, ...] = ()
    proofs = 0
    while proofs < task.effort.proofs:
        proofs += 1
        law, inner, members = design.law, design.inner_end_mass, list(task.members)
        worst: tuple[np.ndarray, ...] = ()
        if task.spread is not None:
            worst = worst_rigs(task.points, task.goal, design.form, design.variables)
            for z in worst:
                members += task.spread.members(z)
        loops = loop_set(members, law, inner, task.masses_kg)
        if loops.unstable():
            reason = "the loop is not stable over the whole range"
            break
        refuted = loops.refuted(task.goal)
        if refuted:
            (claim, member), excess = refuted[0], loops.excess(task.goal) + _SPARE
            reason = f"{claim.kind.replace('_', ' ')} refuted: {claim.reason}"
            nominal = member < len(task.members)  # of a rig that is off the samples are not exact
            if nominal and claim.kind == "peak_sensitivity" and excess < inf and claim.witness is not None:
                # The next refinement sees the peak that stood between the samples, and a third of the excess beside.
                refinement = task.with_peak(refinement, claim)
                excess /= 3
            inside += excess
        else:
            bandwidth = min(*loops.bandwidths(task.goal.compliance_m_per_N).values(), LARGEST_BANDWIDTH_HZ)
            if best is None or bandwidth > best.bandwidth_Hz:
                peak = min(loops.peak_sensitivity(), task.goal.peak_sensitivity)
                kept = np.append(design.variables, log(max(bandwidth, 1e-9)))
                best, rigs = Proved(law, inner, bandwidth, peak, kept), worst
            if bandwidth > _ENOUGH * design.bandwidth_Hz:
                break
            stiffer *= 3
        if not inside < inf:
            break
        for worth in (WORTH, inf):
            variables, _ = refinement(design.variables, inside, stiffer, 6, max(0.05, 10 * inside), worth)
            moved = not np.array_equal(variables, design.variables)
            design = replace(design, variables=variables)
            if moved or not refuted:
                break
        else:
            break
    return Found(best, sampled, proofs, "" if best else reason, rigs)


MOST_RIGS = 8
"""How many of the worst rigs of a design are proved, at most."""

_NEAR, _APART = 0.08, 0.5
"""Slack (logarithm) up to which a limit counts as reached, and how many of the standard deviations in all two rigs have
to be apart to be two."""


def worst_rigs(
    points: Samples, goal: Goal, form: Form, variables: np.ndarray, most: int = MOST_RIGS
) -> tuple[np.ndarray, ...]:
    """(d,) deviations of each of the worst rigs for all limits that are about to be reached, the worst first."""
    assert points.spread is not None
    found = slacks(points, goal, form, variables, slopes=False)
    reached = sampled_bandwidth(points, found.compliance)
    limits, compliance, gain = points.deviations(form, variables)
    found.values[COMPLIANCE, points.frequency_Hz > reached] = np.inf
    listed: list[tuple[float, np.ndarray]] = []
    for slack, z in zip(found.values, (limits, compliance, gain, limits), strict=True):
        listed += [(float(slack[k]), points.spread.rounded(z[:, k])) for k in np.nonzero(slack < _NEAR)[0]]
    chosen: list[np.ndarray] = []
    for _, z in sorted(listed, key=lambda pair: pair[0]):
        size = np.linalg.norm(z)
        if len(chosen) < most and all(np.linalg.norm(z - other) > _APART * size for other in chosen):
            chosen.append(z)
    return tuple(chosen)


def worst_of(spread: RigSpread, outer_end_mass_kg: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """Seek the rigs of a spread that are worst for the limits of the goal, on samples: (d,) standard deviations each.

    Args:
        spread: of a prototype with a controller.
        outer_end_mass_kg: range of outer end mass.

    Raises:
        InputError: for a controller that a tuner has no form for, or none.
    """
    prototype, law = spread.prototype, spread.prototype.controller
    if law is None or (opened := law.form()) is None:
        reason = "worst rigs are sought for a controller that a tuner has a form for"
        raise InputError(prototype.name, [Problem("controller.kind", reason)])
    members = family(prototype, outer_end_mass_kg[1]).members
    task = Search(members, prototype.goal, outer_end_mass_kg, (0.0, 0.0), law.senses, spread)
    form, variables = opened
    inside = prototype.payload.inner_end_mass_kg
    return worst_rigs(task.points, prototype.goal, form, np.append(variables, inside))
