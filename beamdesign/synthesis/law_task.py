"""What a law is sought for: all loops that it has to serve, sampled, with a coarse search and a refinement over them.

At each step of the coarse search the least slack of compliance up to a little beyond the bandwidth reached is
maximised, linearised, with the other limits as constraints (sequential linear programming; R. Fletcher and E. Sainz de
la Maza, Nonlinear programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43,
1989). At such an optimum nearly as many limits are active as there are variables, so that steps of first order are
enough.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from math import inf, log

import numpy as np

from beamdesign.controllers import SENSED, Controller, Sensed
from beamdesign.controllers.protocol import Form
from beamdesign.plant.assembly import pace
from beamdesign.plant.members import VertexModel, served
from beamdesign.plant.rigs import figures_of
from beamdesign.proofs.certificate import Kind
from beamdesign.prototype import Goal, Prototype
from beamdesign.synthesis.loop_samples import (
    COMPLIANCE,
    OTHERS,
    Design,
    Samples,
    Slacks,
    ends,
    form_for,
    rig_samples,
    sampled_bandwidth,
    sampled_masses,
    slacks,
)
from beamdesign.synthesis.refinement import NEARLY, TOUCH, WORTH, LawRefinement
from beamdesign.synthesis.rig_spread import Cut, RigSpread
from beamdesign.synthesis.sampled_frequencies import COARSE_HZ, FINE_HZ, MODES_HZ, about_poles_Hz
from beamdesign.synthesis.sections import Sections
from beamdesign.time_limit import over


@dataclass(frozen=True)
class Effort:
    """How much is tried.

    Attributes:
        steps: linear programs of a coarse search, at most.
        rounds: of a refinement, at most.
        wide: rounds of differential evolution about starts of few variables.
        starts: how many starts are refined, and how many laws of one size the next are grown from.
        refined: how many of the laws that are grown are refined for good.
        candidates: how many designs are proved, at most.
        proofs: rounds of proof and back-off for one design, at most.
        weights: of a synthesis: how many are sampled, a power of two, as Sobol's sequence wants.
        evaluations: of the search that improves weights.
        synthesised: how many laws of a synthesis are searched from.
        blocks: pairs of poles that are realised of these: order 8.
        frequency_Hz: of the samples, of a rig as quick as the published one.
    """

    steps: int = 150
    rounds: int = 20
    wide: int = 50
    starts: int = 2
    refined: int = 3
    candidates: int = 3
    proofs: int = 10
    weights: int = 256
    evaluations: int = 150
    synthesised: int = 5
    blocks: int = 4
    frequency_Hz: tuple[float, ...] = tuple(FINE_HZ)


_PEAK = np.linspace(0.97, 1.03, 61)
"""Frequencies about a peak that a proof has found, over its own."""

_CLOSE_HZ = np.geomspace(1.0, 500.0, 4000)

_STRICTER = 1 + 1e-9
"""Factor on the limit of sensitivity about a peak, so that nothing but peaks is limited there."""


@dataclass(frozen=True)
class Search:
    """What a law has to serve, with the samples of all its loops.

    Attributes:
        members: linear members of the nominal rig.
        goal: limits of compliance, sensitivity, loop gain and effort.
        masses_kg: range of outer end mass.
        inner_kg: least and most mass inside.
        sensors: what the law senses.
        spread: rigs that are off, which are to keep all limits as well; none: the nominal rig alone.
        effort: how much is tried.
        sections: of the beams, to be chosen as well, those of `members` at first; None where they stand.
        cuts: those of these rigs that are sampled.
    """

    members: Sequence[VertexModel]
    goal: Goal
    masses_kg: tuple[float, float]
    inner_kg: tuple[float, float]
    sensors: tuple[Sensed, ...] = SENSED[:1]
    spread: RigSpread | None = None
    effort: Effort = Effort()
    sections: Sections | None = None
    cuts: tuple[Cut, ...] = ()
    _refinements: dict[Form, LawRefinement] = field(init=False, repr=False, default_factory=dict)

    @cached_property
    def points(self) -> Samples:
        """Of all loops."""
        return self.sampled(self.frequency_Hz, self._masses, self.start)

    @property
    def _masses(self) -> list[float]:
        """Outer end masses of the samples, kg: closer where every step may move the peaks between them."""
        return sampled_masses(self.masses_kg, 3 if self.sections is None else 9)

    @cached_property
    def frequency_Hz(self) -> np.ndarray:
        """Those of the samples."""
        with_effects = any(member.rig.effects for member in self.members)
        frequencies = np.union1d(self.effort.frequency_Hz, MODES_HZ if with_effects else [])
        frequencies = np.union1d(self.pace * frequencies, [self.goal.loop_gain_from_Hz])
        return np.union1d(frequencies, about_poles_Hz(self.members, frequencies, self.masses_kg, self.inner_kg))

    @cached_property
    def pace(self) -> float:
        """How quick the rig is, see `beamdesign.plant.assembly.pace`."""
        return pace(self.members[0].rig.figures)

    def sought_form(self, law: Controller, known: int = 0) -> tuple[Form, np.ndarray] | None:
        """Form of a law with bounds for this rig, and its variables; None where it has none.

        Of the variables those behind the known ones are of a rig as quick as the published one.
        """
        if (found := law.form()) is None:
            return None
        form, own = form_for(found[0], self.members[0].rig.figures), found[1]
        return form, own + log(self.pace) * form.frequencies * (np.arange(len(own)) >= known)

    @property
    def start(self) -> np.ndarray:
        """Sections to begin with, none where they stand."""
        return np.zeros(0) if self.sections is None else self.sections.start

    def sampled(
        self, frequency_Hz: np.ndarray, masses: Sequence[float], chosen: np.ndarray, relaxed: float = 1.0
    ) -> Samples:
        """All loops of the rig with these sections at some frequencies and outer end masses (kg), then of its cuts.

        Raises:
            ValueError: where there is no such rig.
        """
        parts = [rig_samples(self.members_with(chosen), frequency_Hz, masses, self.sensors, relaxed)]
        for cut in self.cuts:
            members = self.members_with(chosen, z=np.array(cut.z))
            near = np.union1d(frequency_Hz, cut.frequency_Hz * _PEAK)
            parts.append(rig_samples(members, near[near > 0], [cut.outer_end_mass_kg], self.sensors, relaxed))
        return reduce(Samples.joined, parts)

    def prototype_with(self, chosen: np.ndarray, rounded: bool = False) -> Prototype:
        """The rig with these sections, without a law; of a task whose rigs may be off or whose sections are chosen.

        Raises:
            ValueError: where there is no such rig.
        """
        if self.sections is not None:
            return self.sections.prototype(chosen, rounded)
        assert self.spread is not None
        return self.spread.prototype

    def members_with(
        self, chosen: np.ndarray, rounded: bool = False, z: np.ndarray | None = None
    ) -> Sequence[VertexModel]:
        """Members of the rig with these sections, its figures off by (d,) standard deviations; errors likewise."""
        if self.sections is None and z is None:
            return self.members
        rig = self.prototype_with(chosen, rounded)
        if z is None or self.spread is None:
            return served(rig, self.masses_kg[1])
        return replace(self.spread, prototype=rig).members(z)

    def points_with(self, chosen: np.ndarray) -> Samples | None:
        """All loops of the rig with these sections; None where there is no such rig."""
        if self.sections is None:
            return self.points
        with suppress(ValueError):
            return self.sampled(self.frequency_Hz, self._masses, chosen)
        return None

    def with_cuts(self, cuts: Iterable[Cut]) -> "Search":
        """The search with more rigs sampled."""
        every = {cut[:2]: cut for cut in (*cuts, *self.cuts)}
        return replace(self, cuts=tuple(every.values()))

    def reached(self, design: Design, spare: float = 0.0) -> float:
        """Bandwidth (Hz) of a design on the samples, with so much of the compliance (logarithm) to spare."""
        points = self.points_with(design.chosen) or self.points
        return sampled_bandwidth(points, self._left(points, design).compliance - spare)

    def _left(self, points: Samples, design: Design, unsettled: bool = True) -> Slacks:
        return slacks(points, self.goal, design.form, design.variables, slopes=False, unsettled=unsettled)

    def violation(self, design: Design) -> float:
        """By how much (logarithm) a design misses limits but the compliance; infinite where a loop is unstable."""
        points = self.points_with(design.chosen)
        left = None if points is None else self._left(points, design, unsettled=False)
        return left.violation() if left is not None and left.settled else inf

    def settled(self, design: Design) -> bool:
        """Whether the loops of a design are stable as far as the samples tell."""
        return self.violation(design) < inf

    def refined(
        self, design: Design, inside: float = 0.0, stiffer: float = TOUCH, rounds: int = 20, reach: float = 0.5
    ) -> Design:
        """A design after its refinement, see `LawRefinement`."""
        return Design(design.form, *self.refinement(design.form)(design.variables, inside, stiffer, rounds, reach))

    def refinement(self, form: Form) -> LawRefinement:
        """The refinement of laws of a form, built once."""
        if form not in self._refinements:
            nominal = self.members_with(self.start), sampled_masses(self.masses_kg), None
            off = ((self.members_with(self.start, z=np.array(c.z)), [c.outer_end_mass_kg], c) for c in self.cuts)
            listed = [
                (rig.polynomials(self.sensors), factor, masses, cut is None, self._factors(cut))
                for members, masses, cut in (nominal, *off)
                for rig, factor, performs in ends(members)
                if performs
            ]
            rows = len(self._masses) * len(ends(self.members))
            given = self.points, self.goal, form, self.inner_kg, listed, rows, self._row_factors(self._masses)
            resampled = None if self.sections is None else self.points_with
            self._refinements[form] = LawRefinement(*given, self.sections, resampled, self.pace)
        return self._refinements[form]

    def _factors(self, cut: Cut | None) -> np.ndarray:
        """(15,) what the mass inside and the lumped figures of a rig are multiplied by."""
        names = ("inner_end_mass", *figures_of(self.members[0].rig.rig)[:-2])
        if cut is None or self.spread is None:
            return np.ones(len(names))
        off = self.spread.factors(np.array(cut.z))
        return np.array([off.get(name, 1.0) for name in names])

    def _row_factors(self, masses: Sequence[float]) -> np.ndarray:
        """The same for every row of samples of a rig of one member."""
        return np.array([*[self._factors(None)] * len(masses), *map(self._factors, self.cuts)])

    def worst_peak(self, design: Design) -> tuple[float, float]:
        """Frequency (Hz) and outer end mass (kg) of the largest sensitivity on samples close together."""
        points = self.sampled(self.pace * _CLOSE_HZ, self._masses, design.chosen)
        k = int(self._left(points, design).sensitivity.argmin())
        return float(points.frequency_Hz[k]), float(points.outer_end_mass[k])

    def with_peak(
        self, refinement: LawRefinement, frequency_Hz: float, mass: float, kind: Kind = "peak_sensitivity"
    ) -> LawRefinement:
        """A refinement that sees a peak of what is limited at a frequency and an outer end mass (kg)."""
        at, masses, relaxed = frequency_Hz * _PEAK, [mass], _STRICTER
        if kind in ("loop_gain", "controller_effort"):
            # These count where the compliance does, which is read off a row that begins at rest.
            at, relaxed = np.union1d(self.pace * COARSE_HZ, at), 1.0

        def joined(points: Samples, chosen: np.ndarray) -> Samples:
            return points.joined(self.sampled(at, masses, chosen, relaxed))

        def resampled(chosen: np.ndarray) -> Samples | None:
            points = before and before(chosen)
            return None if points is None else joined(points, chosen)

        before, factors = refinement.resampled, np.vstack([refinement.factors, self._row_factors(masses)])
        points = joined(refinement.points, self.start)
        return replace(refinement, points=points, resampled=before and resampled, factors=factors)

    def coarsely_searched(self, start: Design, points: Samples | None = None) -> Design:
        """What a coarse search of the law leads to, or the start where that is better.

        Args:
            start: to begin with.
            points: that are looked at; None for those of the task.
        """
        own, chosen = np.split(start.variables, [start.form.size + 1])
        if (points := points or self.points_with(chosen)) is None:
            return replace(start, value=0.0)
        found = replace(start, variables=np.append(self._coarsely(points, start.form, own), chosen))
        return max((replace(one, value=self.worth(points, one)) for one in (start, found)), key=lambda one: one.value)

    def _coarsely(self, points: Samples, form: Form, start: np.ndarray) -> np.ndarray:
        """Variables (v,) that a coarse search leads to; its start, within its bounds, where no loop is stable.

        Args:
            points: where the limits are kept.
            form: of the law.
            start: (v,) variables.
        """
        lower, upper = np.append(form.lower, self.inner_kg[0]), np.append(form.upper, self.inner_kg[1])
        goal, here = self.goal, np.clip(start, lower, upper)
        now = slacks(points, goal, form, here)
        if not now.settled:
            return here
        aim, sizes = _aim(points, now), np.append(np.ones(form.size), form.mass_unit_kg)
        steps, still, reach = 0, 0, _FIRST_REACH
        while steps < self.effort.steps and reach > _SMALLEST_REACH and still < 12 and not over():
            steps += 1
            least, greatest = np.maximum(lower - here, -reach * sizes), np.minimum(upper - here, reach * sizes)
            merit = _merit(points, now, aim)
            move, foreseen = _step(points, now, aim, least, greatest)
            tried = here + move
            then = slacks(points, goal, form, tried)
            gained = _merit(points, then, aim) - merit
            if gained < 0.7 * (foreseen - merit) or not then.settled:
                # Curvature ruined the step: linearise again with what the limits are at its end,
                # taken back along it with the slopes of its beginning.
                bent = replace(now, values=then.values - now.slopes @ move)
                again, _ = _step(points, bent, aim, least, greatest)
                found = slacks(points, goal, form, here + again)
                more = _merit(points, found, aim) - merit
                if found.settled and (not then.settled or more > gained):
                    tried, then, gained = here + again, found, more
            if not then.settled or gained <= 0:
                reach /= 3
                continue
            if gained < 0.3 * (foreseen - merit):
                reach /= 2
            still = still + 1 if gained < 1e-4 else 0
            here, now = tried, then
            if gained > 0.5 * (foreseen - merit):
                reach = min(reach * 2, _LARGEST_REACH)
            aim = _aim(points, now)
        return here

    def worth(self, points: Samples, design: Design, price: float = WORTH) -> float:
        """Sampled value, made less by what violates the limits, times a price; 0 of a loop that is not stable."""
        left = self._left(points, design, unsettled=False)
        if not left.settled:
            return 0.0
        reached = sampled_bandwidth(points, left.compliance + NEARLY / 2)
        return self.value(design, reached) / (1 + price * left.violation())

    @property
    def needed_Hz(self) -> float:
        """Bandwidth that is to be had with the least moving mass; 0 where the largest bandwidth is sought."""
        return 0.0 if self.sections is None else self.sections.needed_Hz or 0.0

    def value(self, design: Design, bandwidth_Hz: float) -> float:
        """What a design of a bandwidth is worth: that, or what its sections say."""
        return self.refinement(design.form).value(design.variables, bandwidth_Hz)


_BEYOND = 1.06
"""Up to how many times the bandwidth reached the compliance is bettered."""

_PENALTY = 20.0
"""What a violation of the other limits costs, over the slack of compliance."""

_SMALLEST_REACH, _FIRST_REACH, _LARGEST_REACH = 1e-4, 0.3, 0.5
"""How far a variable may move in a step."""


def _aim(points: Samples, now: Slacks) -> float:
    """Up to which frequency the compliance is to be bettered."""
    return max(sampled_bandwidth(points, now.compliance), float(points.frequency_Hz.min())) * _BEYOND


def _merit(points: Samples, found: Slacks, aim: float) -> float:
    return float(found.compliance[points.frequency_Hz <= aim].min()) - _PENALTY * found.violation()


def _step(points: Samples, now: Slacks, aim: float, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, float]:
    """The best move within bounds by the linearised slacks, and the merit that is foreseen of it."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    widest = np.maximum(np.abs(least), np.abs(most))
    below = points.frequency_Hz <= aim
    compliance, slopes = now.compliance[below], now.slopes[COMPLIANCE][below]
    # What cannot become active within these bounds is left out.
    worst = float(compliance.min()) + float((np.abs(slopes) @ widest).max())
    near = compliance - np.abs(slopes) @ widest < worst
    count = len(least)
    rows, right = [np.hstack([-slopes[near], np.ones((near.sum(), 1)), np.zeros((near.sum(), 1))])], [compliance[near]]
    for slack, slope in zip(now.values[OTHERS], now.slopes[OTHERS], strict=True):
        near = slack - np.abs(slope) @ widest < 0
        rows.append(np.hstack([-slope[near], np.zeros((near.sum(), 1)), -np.ones((near.sum(), 1))]))
        right.append(slack[near])
    cost = np.zeros(count + 2)
    cost[count], cost[count + 1] = -1.0, _PENALTY
    bounds = Bounds(np.append(least, [-inf, 0.0]), np.append(most, [inf, inf]))
    kept = LinearConstraint(np.vstack(rows), -inf, np.concatenate(right))
    # Of no integers: `linprog` has the same of HiGHS, in half as much time again.
    found = milp(cost, constraints=kept, bounds=bounds)
    if found.x is None:
        return np.zeros(count), -np.inf
    return np.asarray(found.x[:count]), -float(found.fun)
