"""Tuning of state feedback with an observer: synthesised by Riccati equations or matrix inequalities, polished, proved.

Weights are searched for a synthesis that serves the whole range of payloads; its controller is reduced to an order that
can be realised. Then its entries themselves are polished within the limits at samples: the structure stays that of the
observer, the figures are no longer optimal by any weights. What is returned is proved by the same oracle as every other
loop: where it refutes a limit between the samples, all limits are tightened by what was missing, and it is polished
again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, log

import numpy as np

from beamdesign.controllers import SENSED, Observer, Sensed
from beamdesign.design.bandwidth_climb import climb
from beamdesign.design.loop_set import LOOSER_PEAK, ends, loop_set
from beamdesign.design.lqg import lqg
from beamdesign.design.observer_polish import TOUCH, ObserverPolish
from beamdesign.design.observer_record import DIGITS, rounded
from beamdesign.design.observer_slacks import BlockLaw, block_law, observer_slacks
from beamdesign.design.refinement import LARGEST_BANDWIDTH_HZ, Proved
from beamdesign.design.sampled_loops import Slacks, sampled_bandwidth
from beamdesign.design.sensed_samples import SensedSamples, sensed_samples
from beamdesign.design.state_space import StateSpace
from beamdesign.design.weight_search import Proposal, WeightSearch, least_norm
from beamdesign.linear import LinearModel
from beamdesign.members import Member
from beamdesign.proof.rational import nearest
from beamdesign.prototype import Goal

COARSE_HZ = np.concatenate(
    [np.geomspace(0.05, 5, 25), np.geomspace(5.3, 150, 130), np.geomspace(155, 1e3, 25), [3e3, 1e4, 1e5]]
)
FINE_HZ = np.concatenate(
    [
        np.geomspace(0.01, 4.9, 30),
        np.geomspace(5, 60, 250),
        np.geomspace(61, 150, 60),
        np.geomspace(153, 1200, 60),
        np.geomspace(1300, 1e5, 10),
    ]
)
"""Frequencies of the samples that weights are searched on, and of those that entries are polished on."""

OBSERVERS = ("lqg", "hinf")
"""Kinds of synthesis."""

BLOCKS = 4
"""Pairs of poles that are realised: order 8."""

CLIMBS, POLISHED = 5, 2
"""How many proposals are climbed from, and how many of these are polished, with one sensor; else the best alone."""

_SEARCH, _LMI_SEARCH, _LMI_STARTS = 150, 6, 3
"""Evaluations of the search for weights, with Riccati equations and with matrix inequalities."""

_STEPS, _ROUNDS = 150, 20
"""Of the climb and the polish."""

_NEARLY = 0.01
"""By how much (logarithm) a compliance may miss its limit, which a polish mends, where starts are compared."""

PROOFS = 10
_ENOUGH, _SPARE = 0.985, 2e-6
"""As in `beamdesign.design.structured_tuning`."""


@dataclass(frozen=True)
class TunedObserver:
    """Outcome of `tune_observer`.

    Attributes:
        proved: the best loop that was proved; None where there is none.
        synthesised_Hz: sampled bandwidth of the best controller as it was synthesised and reduced, within all limits;
            0 where it keeps them only once it is polished.
        sampled: bandwidths (Hz) reached on samples after the climbs, the largest first.
        certificates: how many exact proofs of a loop were run.
        reason: why nothing was proved, empty where something was.
    """

    proved: Proved | None
    synthesised_Hz: float
    sampled: tuple[float, ...]
    certificates: int
    reason: str = ""


@dataclass(frozen=True)
class _Task:
    members: Sequence[Member]
    goal: Goal
    masses_kg: tuple[float, float]
    largest_inner: float
    sensors: tuple[Sensed, ...]

    def points(self, frequency_Hz: np.ndarray) -> SensedSamples:
        """All loops at the ends and the middle of the range."""
        grid = np.union1d(frequency_Hz, [self.goal.loop_gain_from_Hz])
        return self._sampled(grid, np.unique(np.linspace(*self.masses_kg, 3)).tolist())

    def peak(self, frequency_Hz: float, outer_end_mass: float) -> SensedSamples:
        """All loops about a peak of the sensitivity, where nothing else is limited."""
        return self._sampled(frequency_Hz * np.linspace(0.97, 1.03, 61), [outer_end_mass], 1 + 1e-9)

    def _sampled(self, frequency_Hz: np.ndarray, masses: Sequence[float], least: float = 1.0) -> SensedSamples:
        found: SensedSamples | None = None
        for rig, factor, performs in ends(self.members):
            looser = least if performs else LOOSER_PEAK
            more = sensed_samples(rig, self.sensors, frequency_Hz, masses, factor, looser)
            found = more if found is None else found.joined(more)
        assert found is not None  # there is at least one loop
        return found

    @property
    def design_rig(self) -> LinearModel:
        """What controllers are synthesised on: the first member that is to perform."""
        return next(member.rig for member in self.members if member.performance is not None)

    def observer(self, law: BlockLaw, variables: np.ndarray) -> Observer:
        """The record: gain taken out, entries rounded."""
        whole = law.model(variables)
        gain = float(f"{law.units[0]:.{DIGITS}g}")
        return Observer.of(
            gain,
            self.sensors,
            rounded(whole.a),
            rounded(whole.b / gain),
            rounded(whole.c[0]),
            rounded(whole.d[0] / gain),
        )


def tune_observer(
    members: Sequence[Member],
    goal: Goal,
    masses_kg: tuple[float, float],
    largest_inner: float,
    kind: str | None = "lqg",
    sensors: Sequence[Sensed] = SENSED[:1],
    told: Callable[[float, str], None] = lambda share, text: None,
    starts: Sequence[tuple[Observer, float]] = (),
) -> TunedObserver:
    """Find the largest guaranteed bandwidth of a controller with an observer.

    Args:
        members: linear members of the rig.
        goal: limits of compliance, sensitivity, loop gain and effort.
        masses_kg: range of outer end mass.
        largest_inner: most mass that may be added inside, kg.
        kind: `lqg` or `hinf`: how the controllers that are polished are synthesised; None for the starts alone.
        sensors: what it reads, of `beamdesign.controllers.SENSED`.
        told: the share done and what is being done.
        starts: further controllers, with these sensors or fewer, and masses inside (kg) to polish from.
    """
    task = _Task(members, goal, masses_kg, largest_inner, tuple(sensors))
    if reason := _cannot(task):
        return TunedObserver(None, 0.0, (), 0, reason)
    if len(sensors) > 1 and kind and not starts:
        # What the displacement alone reaches is where an added sensor begins.
        alone = tune_observer(members, goal, masses_kg, largest_inner, kind, sensors[:1], _half(told))
        if alone.proved is not None and (own := alone.proved.controller.observer):
            starts = [(own, alone.proved.inner_end_mass_kg)]
    proposals = _proposals(task, kind, told) if kind else []
    laws = [(_extended(task, one), inner) for one, inner in starts if one.order <= 2 * BLOCKS]
    laws = [(law, inner) for law, inner in laws if law.stable]
    laws += [(one.law, one.inner_end_mass) for one in proposals[:CLIMBS]]
    if not laws:
        return TunedObserver(None, 0.0, (), 0, "no weights led to a stable controller with a stable loop")
    points = task.points(FINE_HZ)
    climbed = []
    for k, (law, inner) in enumerate(laws):
        told(0.3 + 0.2 * k / len(laws), f"polishing controller {k + 1} of {len(laws)}")
        climbed.append(_climbed(task, points, *block_law(law, BLOCKS, inner, _worth(points))))
    climbed.sort(key=lambda found: -found[2])
    synthesised = max((one.bandwidth_Hz for one in proposals), default=0.0)
    bandwidth = 0.0
    for k, (form, first, _) in enumerate(climbed[: POLISHED if len(sensors) == 1 else 1]):
        candidate = ObserverPolish(points, goal, form, largest_inner)
        better, reached_Hz = _polished(candidate, first, _part(told, 0.5 + 0.35 * k / POLISHED, 0.35 / POLISHED))
        if reached_Hz > bandwidth or not k:
            polish, variables, bandwidth = candidate, better, reached_Hz
    reached = (bandwidth, *sorted((found[2] for found in climbed[1:]), reverse=True))
    if bandwidth <= 0:
        return TunedObserver(
            None, synthesised, reached, 0, "no start led to a stable loop within the limits on samples"
        )
    told(0.85, f"proving {bandwidth:.3g} Hz")
    proved, proofs, reason = _proved(task, polish, variables, bandwidth)
    return TunedObserver(proved, synthesised, reached, proofs, "" if proved else reason)


def _polished(
    polish: ObserverPolish, variables: np.ndarray, told: Callable[[float, str], None]
) -> tuple[np.ndarray, float]:
    """Polish until smaller steps help no more."""
    bandwidth, reach = 0.0, 0.5
    for k in range(_ROUNDS // 2):
        told(2 * k / _ROUNDS, f"polishing: {bandwidth:.3g} Hz on samples" if k else "polishing")
        before = bandwidth
        variables, bandwidth = polish(variables, rounds=2, reach=reach)
        if bandwidth < before * 1.003:
            reach /= 4
        if reach < 0.02:
            break
    return variables, bandwidth


def _part(told: Callable[[float, str], None], start: float, length: float) -> Callable[[float, str], None]:
    """Progress of a part of the whole."""
    return lambda share, text: told(start + length * share, text)


def _half(told: Callable[[float, str], None]) -> Callable[[float, str], None]:
    """Progress of work that comes before all else, on a scale of its own below zero."""
    return lambda share, text: told(0.0, f"displacement alone, {100 * share:.0f} %: {text}")


def _cannot(task: _Task) -> str:
    """Why such a loop cannot be proved at all; empty where it can."""
    if len(task.sensors) > 1 and any(member.gain.low != member.gain.high for member in task.members):
        return "with added sensors no tuner serves the range of gains that an effect of this prototype asks for"
    return ""


def _proposals(task: _Task, kind: str, told: Callable[[float, str], None]) -> list[Proposal]:
    """Controllers that were synthesised, the best first."""
    told(0.0, "searching weights")
    points = task.points(COARSE_HZ)
    search = WeightSearch(
        task.design_rig, task.sensors, points, task.goal, task.masses_kg, task.largest_inner, 2 * BLOCKS
    )
    found = search.sampled()
    if found:
        told(0.1, "improving weights")
        found = [search.improved(found[0], lqg, _SEARCH), *found]
    if kind == "lqg" or not found:
        return found
    solved = []
    for k, start in enumerate(found[:_LMI_STARTS]):
        told(0.15 + 0.1 * k / _LMI_STARTS, f"matrix inequalities {k + 1} of {_LMI_STARTS}")
        one = search.proposal(start.variables, least_norm)
        if one is not None:
            solved.append(one)
    if solved:
        solved.sort(key=lambda one: one.cost)
        told(0.25, "improving weights")
        solved.insert(0, search.improved(solved[0], least_norm, _LMI_SEARCH))
    return solved


def _worth(points: SensedSamples) -> np.ndarray:
    """Gains through each sensor, over that through the first, that make the same loop gain about 10 Hz, (p,)."""
    near = (points.frequency_Hz > 5) & (points.frequency_Hz < 20)
    size = np.median(np.abs(points.control[:, 0, near]), axis=1)
    return np.asarray(size[0] / size)


def _extended(task: _Task, known: Observer) -> StateSpace:
    """The matrices of a controller with fewer sensors, which does nothing yet with the others."""
    n, gain = known.order, known.gain_A_per_V
    b, d = np.zeros((n, len(task.sensors))), np.zeros((1, len(task.sensors)))
    for k, name in enumerate(known.sensors):
        b[:, task.sensors.index(name)] = [row[k] for row in known.b]
        d[0, task.sensors.index(name)] = gain * known.d[k]
    return StateSpace(np.array(known.a), b, gain * np.array([known.c]), d)


def _climbed(
    task: _Task, points: SensedSamples, law: BlockLaw, variables: np.ndarray
) -> tuple[BlockLaw, np.ndarray, float]:
    """Form, variables and sampled bandwidth after a climb; a bandwidth is halved by what violates the limits."""

    def measure(at: SensedSamples, goal: Goal, here: np.ndarray) -> Slacks:
        return observer_slacks(at, goal, law, here)

    found = climb(points, task.goal, variables, *law.bounds(task.largest_inner), most=_STEPS, measure=measure)
    left = observer_slacks(points, task.goal, law, found.variables, slopes=False)
    bandwidth = sampled_bandwidth(points, left.compliance + _NEARLY) if left.settled else 0.0
    bandwidth /= 1 + 10 * left.violation
    before = observer_slacks(points, task.goal, law, variables, slopes=False)
    own = (
        sampled_bandwidth(points, before.compliance + _NEARLY)
        if before.settled and before.violation < _NEARLY / 10
        else 0.0
    )
    return (law, variables, own) if own > bandwidth else (law, found.variables, bandwidth)


def _proved(task: _Task, polish: ObserverPolish, variables: np.ndarray, aimed: float) -> tuple[Proved | None, int, str]:
    """The best loop proved at the variables or a little inside the limits; how many proofs that took; or why none."""
    inside, stiffer, reason = 0.0, TOUCH, ""
    best: Proved | None = None
    for proofs in range(1, PROOFS + 1):
        controller, inner = task.observer(polish.law, variables), round(float(variables[-1]), 6)
        loops = loop_set(task.members, controller, inner, task.masses_kg)
        if loops.unstable():
            return best, proofs, "the loop is not stable over the whole range"
        refuted = loops.refuted(task.goal)
        if refuted:
            reason = f"{refuted[0][0].kind.replace('_', ' ')} refuted: {refuted[0][0].reason}"
            excess = loops.excess(task.goal) + _SPARE
            claim = refuted[0][0]
            if claim.kind == "peak_sensitivity" and excess < inf and claim.witness is not None:
                # The next polish sees the peak that stood between the samples, and a third of the excess beside.
                polish = replace(
                    polish,
                    points=polish.points.joined(task.peak(claim.witness.frequency_Hz, nearest(claim.witness.mass))),
                )
                excess /= 3
            inside += excess
        else:
            bandwidth = min(*loops.bandwidths(task.goal.compliance_m_per_N).values(), LARGEST_BANDWIDTH_HZ)
            if best is None or bandwidth > best.bandwidth_Hz:
                peak = min(loops.peak_sensitivity(), task.goal.peak_sensitivity)
                kept = np.append(variables, log(max(bandwidth, 1e-9)))
                best = Proved(controller, inner, bandwidth, peak, kept)
            if bandwidth > _ENOUGH * aimed:
                break
            stiffer *= 3
        if not inside < inf:
            break
        before = variables
        variables, _ = polish(variables, inside, stiffer, rounds=4, reach=max(0.05, 10 * inside))
        if np.array_equal(before, variables) and refuted and excess > _SPARE * 100:
            inside += excess
    return best, proofs, "" if best else reason
