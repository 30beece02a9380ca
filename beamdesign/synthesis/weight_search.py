"""Search of a law given by matrices: weights of a synthesis, its law reduced, then refined entry by entry.

A regulator that is optimal by its weights knows nothing of limits on peaks; the weights, the mass inside and the
payload that it is designed for are what a search can choose, for the law that does best at sampled points of the loops
it serves. It is reduced to an order that can be realised. What is then refined are its entries themselves: the
structure stays that of the observer, the figures are no longer optimal by any weights.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, log, log2, pi
from types import MappingProxyType

import numpy as np

from beamdesign.controllers import KINDS, Controller, Sensed
from beamdesign.controllers.observer import block_form
from beamdesign.plant.assembly import mass_unit_kg, pace, sizes
from beamdesign.plant.equilibrium import StateSpace
from beamdesign.plant.linear import LinearModel
from beamdesign.progress import Progress, part_of, silent
from beamdesign.prototype import Goal, Prototype
from beamdesign.structure.lumped import figures
from beamdesign.synthesis.law_search import Found, search
from beamdesign.synthesis.law_task import Effort, Search
from beamdesign.synthesis.loop_samples import Design, Samples, form_for, rig_samples, sampled_masses, slacks_of
from beamdesign.synthesis.sampled_frequencies import COARSE_HZ
from beamdesign.synthesis.synthesis import Solver, Weights, hinf, lqg, realised, scaled_plant, sensed_model, weighted
from beamdesign.time_limit import leave_out, over, share, while_time

AIM_HZ = 5.0
"""Up to where the search betters the compliance."""

_PENALTY = 4.0
"""What a violation of the other limits costs, over the slack of compliance."""

_UNSTABLE, _NONE = 50.0, 60.0
"""Cost of a loop that is not stable, and of weights that lead to no stable controller."""

_LOG_BOUNDS = (  # of weights in the units of the scaled plant
    (0.2, 3.0),  # corner
    (0.05, 1.0),  # its damping ratio
    (2.0, 12.0),  # roll-off
    (1e-2, 1e2),  # current
    (1e-3, 1e2),  # noise
    (1e-3, 1e2),  # recovery
    (1e-2, 1e2),  # white force
    (1e-2, 1e2),  # noise of added sensors
)

_STEP = 0.6
"""How far a search for better weights goes at first: logarithms, and masses (kg) of a rig as heavy as the published."""


@dataclass(frozen=True)
class Proposal:
    """A controller that was synthesised.

    Attributes:
        law: in SI, reduced to the order that is realised.
        inner_end_mass: kg.
        cost: the smaller the better.
        variables: logarithms of the weights, mass inside, payload it is designed for.
    """

    law: StateSpace
    inner_end_mass: float
    cost: float
    variables: np.ndarray


@dataclass(frozen=True)
class WeightSearch:
    """What is asked, with samples of all loops that are to be served.

    Attributes:
        task: its sensors are what the controller reads.
    """

    task: Search

    @cached_property
    def rig(self) -> LinearModel:
        """That the controller is designed on."""
        return next(member.rig for member in self.task.members if member.performance is not None)

    @cached_property
    def points(self) -> Samples:
        """Samples, the same frequencies in every row."""
        task, frequencies = self.task, np.union1d(self.task.pace * COARSE_HZ, [self.task.goal.loop_gain_from_Hz])
        return rig_samples(task.members, frequencies, sampled_masses(task.masses_kg), task.sensors)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, (10,) each."""
        rows = [(log(low), log(high)) for low, high in _LOG_BOUNDS]
        found = np.array([*rows, (0.0, self.task.inner_kg[1]), self.task.masses_kg])
        return found[:, 0], found[:, 1]

    def proposal(self, variables: np.ndarray, solve: Solver) -> Proposal | None:
        """The controller of some weights; None where there is none, or none that is stable."""
        weights, inner = Weights(*np.exp(variables[: len(_LOG_BOUNDS)])), float(variables[-2])
        goal, points = self.task.goal, self.points
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)  # an equation that is all but singular is no design
                model = sensed_model(self.rig, float(variables[-1]), inner, self.task.sensors)
                plant = scaled_plant(model, goal.compliance_m_per_N, self.task.pace)
                law = realised(plant, weights, solve(weighted(plant, weights)), 2 * self.task.effort.blocks)
        except (np.linalg.LinAlgError, ValueError, RuntimeWarning):
            return None
        rows = int(points.row.max()) + 1
        s = 2j * pi * points.frequency_Hz[: len(points.frequency_Hz) // rows]
        left = slacks_of(points, goal, np.tile(law.at(s)[:, 0].T, (1, rows)), inner)
        if not left.settled or not self._stable(law, inner):
            return Proposal(law, inner, _UNSTABLE, variables)
        aimed = left.compliance[points.frequency_Hz <= self.task.pace * AIM_HZ]
        return Proposal(law, inner, _PENALTY * left.violation() - float(aimed.min()), variables)

    def _stable(self, law: StateSpace, inner: float) -> bool:
        """Whether the loops of the rig that is designed on are stable at the ends and in the middle of the range."""
        for mass in sampled_masses(self.task.masses_kg):
            plant = sensed_model(self.rig, mass, inner, self.task.sensors)
            current, sensed = plant.b[:, 1:], plant.c[1:]
            whole = np.block([[plant.a - current @ law.d @ sensed, current @ law.c], [-law.b @ sensed, law.a]])
            # The mean pressure of the chambers and the like neither are driven nor show; they are stable by themselves.
            if np.linalg.eigvals(whole).real.max() >= 0:
                return False
        return True

    def sampled(self, count: int) -> list[Proposal]:
        """Regulators of weights that fill their bounds evenly, the best first; only those with stable loops."""
        from scipy.stats import qmc

        lower, upper = self.bounds()
        unit = qmc.Sobol(len(lower), scramble=True, rng=0).random(count)
        rows = while_time(unit, lambda _: "some weights", least=1)
        found = [self.proposal(lower + row * (upper - lower), lqg) for row in rows]
        return sorted((one for one in found if one is not None and one.cost < _UNSTABLE), key=lambda one: one.cost)

    def improved(self, start: Proposal, solve: Solver, evaluations: int) -> Proposal:
        """The best that a simplex search (J. A. Nelder and R. Mead, Computer Journal 7, 1965) finds from a start."""
        from scipy.optimize import minimize

        lower, upper = self.bounds()
        best = start

        def cost(variables: np.ndarray) -> float:
            nonlocal best
            if over():
                leave_out("some weights")
                return _NONE
            found = self.proposal(np.clip(variables, lower, upper), solve)
            if found is not None and found.cost < best.cost:
                best = found
            return _NONE if found is None else found.cost

        units = np.append(np.ones(len(_LOG_BOUNDS)), [mass_unit_kg(self.rig.figures)] * 2)
        steps = np.minimum(_STEP * units, (upper - lower) / 4)
        moves = np.diag(np.where(start.variables + steps < upper, steps, -steps))
        options = {
            "maxfev": evaluations, "adaptive": True, "initial_simplex": start.variables + np.vstack([0 * steps, moves])
        }  # fmt: skip
        minimize(cost, start.variables, method="Nelder-Mead", options=options)
        return best


SYNTHESES = ("lqg", "hinf")
"""Kinds of synthesis."""

EFFORT = Effort(starts=2, candidates=1)
ADDED_SENSORS_EFFORT = Effort(starts=1, candidates=1)

_HINF_STARTS = 3
"""From how many weights of the regulator the least norm is sought; with half the evaluations, each takes so long."""

_SEEKING = 0.4
"""Share of the time that is left which goes into weights, or into the displacement alone before sensors are added."""

Given = tuple[Controller, float]
"""A law to begin with, and the mass inside, kg."""


def search_observer(task: Search, kind: str | None, starts: Sequence[Given] = (), report: Progress = silent) -> Found:
    """Find the largest guaranteed bandwidth of a law given by matrices.

    Args:
        task: what is asked; its sensors are those of the law.
        kind: one of `SYNTHESES`: how laws to refine are synthesised; None for the starts alone.
        starts: further laws to refine, with these sensors or fewer; others than linear ones are passed over.
        report: told the share done and what is being done.
    """
    if len(task.sensors) > 1 and any(member.gain.low != member.gain.high for member in task.members):
        why = "with added sensors no tuner serves the range of gains that an effect of this prototype asks for"
        return Found(None, (), 0, why)
    given = [one for one in starts if one[0].sought.get("kind") in SYNTHESES or one[0].sections]
    if len(task.sensors) > 1 and kind and not given:
        # What the displacement alone reaches is where an added sensor begins.
        first = replace(task, sensors=task.sensors[:1], effort=replace(task.effort, starts=EFFORT.starts))
        with share(_SEEKING):
            alone = search_observer(
                first, kind, (), lambda part, text: report(0.4 * part, f"displacement alone, {text}")
            )
        if alone.proved is not None:
            given = [(alone.proved.controller, alone.proved.inner_end_mass_kg)]
    laws = [(StateSpace(*_matrices(law, task.sensors)), inner) for law, inner in given]
    if kind:
        with share(_SEEKING):
            found = _proposals(task, kind, report)
        laws += [(one.law, one.inner_end_mass) for one in found[: task.effort.synthesised]]
    worth, blocks, rig = _worth(task.points, task.pace), task.effort.blocks, task.members[0].rig.figures
    proposed = [
        Design(form_for(form[0], rig), np.append(form[1], inner))
        for law, inner in laws
        if len(law.a) <= 2 * blocks
        and (form := block_form(task.sensors, law.a, law.b, law.c, law.d, blocks, worth, task.pace)) is not None
    ]
    if not proposed:
        return Found(None, (), 0, "no weights led to a stable controller with a stable loop")
    return search(task, proposed, report=part_of(report, 0.4, 1.0))


def _proposals(task: Search, kind: str, report: Progress) -> list[Proposal]:
    """Laws that were synthesised, the best first."""
    report(0.0, "searching weights")
    weights = WeightSearch(task)
    found = weights.sampled(task.effort.weights)
    if found:
        report(0.1, "improving weights")
        found = [weights.improved(found[0], lqg, task.effort.evaluations), *found]
    if kind == "lqg" or not found:
        return found
    report(0.2, "improving weights of the least norm")
    starts = while_time(found[:_HINF_STARTS], lambda _: "some weights", least=1)
    tried = [weights.proposal(start.variables, hinf) for start in starts]
    solved = sorted((one for one in tried if one is not None), key=lambda one: one.cost)
    return [weights.improved(solved[0], hinf, task.effort.evaluations // 2), *solved] if solved else []


def _worth(points: Samples, pace: float) -> np.ndarray:
    """Gains through each sensor, over that through the first, that make the same loop gain about the bandwidth, (p,).

    That is about 10 Hz of a rig as quick as the published one.
    """
    near = (points.frequency_Hz > 5 * pace) & (points.frequency_Hz < 20 * pace)
    size = np.median(np.abs(points.control[:, 0, near]), axis=1)
    return np.asarray(size[0] / size)


def _matrices(law: Controller, sensors: tuple[Sensed, ...]) -> tuple[np.ndarray, ...]:
    """The matrices of a law with fewer sensors, which does nothing yet with the others."""
    a, b_own, c, d_own, _ = law.state_space()
    b, d = np.zeros((len(a), len(sensors))), np.zeros((1, len(sensors)))
    places = [sensors.index(name) for name in law.senses]
    b[:, places], d[:, places] = b_own, d_own
    return a, b, c[None], d


LARGEST_LOOP_GAIN = 0.25
"""From `goal.loop_gain_from_Hz` up, where neither a goal nor who asks says otherwise."""
VALVE_EFFORT_A_PER_V = 0.06
"""What the published valve bears on the published rig, likewise; a motor's current is of another order."""
_PUBLISHED_V_PER_M = 1180.0


def limited(rig: Prototype, kind: str, given: Mapping[str, float | None] = MappingProxyType({})) -> Prototype:
    """A rig whose goal has the limits that laws of high order need; a lag and less keeps them by its form.

    The usual ones are of a rig like the published one. That of the loop gain begins higher where a rig is quicker; that
    of effort goes with what a loop so many times as quick asks of a valve per volt, to a power of two.

    Args:
        rig: its goal's own limits stand. The laws of its controller say of what order a schedule's stages are.
        kind: of the controller that is sought, as `tune` has it.
        given: limits that stand before those of the goal, by name; infinite for none, None for nothing said.
    """
    high_order = kind in SYNTHESES or (kind in KINDS and KINDS[kind].grows)
    if kind == "scheduled" and rig.controller is not None:
        high_order = any(law.sections for law, _ in rig.controller.laws)
    usual = {"loop_gain": LARGEST_LOOP_GAIN} if high_order else {}
    new_limit = rig.goal.loop_gain is None and (high_order or given.get("loop_gain"))
    if new_limit and rig.goal.loop_gain_from_Hz == Goal().loop_gain_from_Hz:
        rig = rig.but(goal=rig.goal.but(loop_gain_from_Hz=pace(figures(rig)) * rig.goal.loop_gain_from_Hz))
    if high_order and rig.servovalve is not None:
        size = sizes(rig)
        asks = size["frequency"] * size["current"] * _PUBLISHED_V_PER_M / rig.sensor.gain_V_per_m
        usual["controller_effort_A_per_V"] = VALVE_EFFORT_A_PER_V * 2.0 ** round(log2(asks))
    changes = {name: value for name, value in usual.items() if getattr(rig.goal, name) is None}
    changes |= {name: value for name, value in given.items() if value is not None}
    return rig.but(goal=rig.goal.but(**{name: None if value == inf else value for name, value in changes.items()}))
