"""A scheduled controller in the loop with the nonlinear rig: payload estimated, stage chosen, payload that changes.

Stages change by hysteresis through their overlaps, no sooner than the dwell time after the last change. The payload is
estimated from the loop's own signals: current and sensor volts, no added sensor.

A force on the tip is not measured, and a payload cannot be told from a force that moves as it likes. But a load comes
on and stays: then, for a while, the volts are the response of the plant, which depends on the payload through its
resonance, to the known current, from an unknown state and under an unknown constant force. For each of some candidate
payloads, the volts of a window less the response to the current are fitted by all free responses of that candidate; the
squares that remain, over the noise, are twice the negative log-likelihood. With volts y, responses r_j to the current,
and Q_j an orthonormal basis of the free responses,

    R_j = |y - r_j|^2 - |Q_j' (y - r_j)|^2,     the payload where R is least, its variance from the curvature of R.

Under white noise of the sensor and a force that stays constant this is the maximum-likelihood estimate, so it needs
no band-pass filter to be consistent. A window in which the force moved leaves more than noise (and a stated share of
the motion, for what the model leaves out) to every candidate, and is dropped. That rejects a random force rather than
being misled by it: under one, the estimate stays what it was. Predictors driven by the volts (Kalman filters with a
random force) were tried instead: they use every sample, but the payload they like best depends on the spectrum that
is assumed of the force, by kilograms.

As difference equations: one filter of the plant's order for each candidate at every sample, and one projection of a
window for each candidate at every update. Useful windows add up, older ones forgotten. A window that contradicts what
was added up begins anew if it is certain enough to count by itself, and is dropped otherwise.
"""

from dataclasses import dataclass, replace
from math import exp, inf, sqrt
from typing import Literal

import numpy as np

from beamdesign.controllers import Scheduled
from beamdesign.plant.assembly import OUTPUTS, assemble, parameters_of, structure_of
from beamdesign.plant.compiled import half_steps, integrate
from beamdesign.plant.equilibrium import equilibrium, substeps_for
from beamdesign.plant.linear import LinearModel
from beamdesign.plant.members import paper_model
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.scenario import Sampled, Scenario, ScenarioRecord, inputs_of
from beamdesign.simulation import COLUMNS as SIMULATED
from beamdesign.simulation import SimulatedRecord, as_measured, diverged, sampled_law
from beamdesign.structure import lumped

CANDIDATES = 17
MARGIN = 0.1
"""Share of the payload's range by which candidates go beyond either end, so that the end can be told from beyond."""
CONTRADICTION = 4.0
"""Standard deviations by which a window's estimate may be off what was added up, before that is dropped."""
FREE = 10
"""Figures that a candidate's free response takes: at most so many degrees of freedom of a window."""
_NOISE_ROOM = 1.3
"""Factor on the noise that a window without movement of the force may leave."""
_TYPICAL = {"_m3_per_s": 1e-6, "_m3_per_s2": 1e-3, "_m_per_s": 1e-3, "_m": 1e-5, "_V": 1e-2, "_A": 1.0}


@dataclass(frozen=True)
class Estimate:
    """A payload with its standard deviation.

    Attributes:
        outer_end_mass_kg: the most likely payload.
        std_kg: of the estimate, from noise and from what the model left unexplained; infinite where nothing is known.
    """

    outer_end_mass_kg: float
    std_kg: float


NOTHING = Estimate(0.0, inf)


@dataclass(frozen=True)
class PlantStep:
    """The plant at one payload from sample to sample, in scaled states, a constant force on the tip among them.

    Attributes:
        transition: (n, n).
        input: (n,) by the current held over the step, A.
        output: (n,) of the volts.
    """

    transition: np.ndarray
    input: np.ndarray
    output: np.ndarray


def plant_step(rig: LinearModel, outer_end_mass: float, inner_end_mass: float, period_s: float) -> PlantStep:
    """The plant between samples, exact for a held current and a constant force."""
    from scipy.linalg import expm

    a, b, c = rig.matrices(outer_end_mass, inner_end_mass)
    n = len(a)
    scale = np.array(
        [*(next(size for end, size in _TYPICAL.items() if name.endswith(end)) for name in rig.states), 10.0, 1.0]
    )  # then force (N) and current (A)
    motion = np.zeros((n + 2, n + 2))
    motion[:n, :n], motion[:n, n:] = a, b
    whole = expm(motion * scale / scale[:, None] * period_s)
    return PlantStep(whole[: n + 1, : n + 1], whole[: n + 1, n + 1], np.append(c[1], 0.0) * scale[: n + 1])


def free_responses(step: PlantStep, samples: int) -> np.ndarray:
    """(samples, f) orthonormal basis of the volts that a plant gives from any state under any constant force."""
    rows, row = np.empty((samples, len(step.output))), step.output
    for k in range(samples):
        rows[k], row = row, row @ step.transition
    left, sizes, _ = np.linalg.svd(rows / np.linalg.norm(rows, axis=0), full_matrices=False)
    return np.asarray(left[:, sizes > sizes[0] * 1e-10])


class PayloadEstimator:
    """An estimator at work; see the head of this file.

    Its candidates lie equally spaced over the payloads of a schedule and a little beyond, with the believed figures of
    the prototype, whose effects are left out: the estimator believes the linear rig.

    Attributes:
        estimate: the present one.
    """

    def __init__(self, prototype: Prototype, schedule: Scheduled):
        (low, high), self._figures = schedule.outer_end_mass_kg, schedule.estimator
        beyond = MARGIN * (high - low)
        self._masses = np.linspace(low - beyond, high + beyond, CANDIDATES)
        rig, inner = paper_model(prototype.but(effects={})), prototype.payload.inner_end_mass_kg
        steps = [plant_step(rig, float(mass), inner, schedule.period_s) for mass in self._masses]
        transitions, inputs = np.array([step.transition for step in steps]), np.array([step.input for step in steps])
        self._step = PlantStep(transitions, inputs, steps[0].output)  # of all candidates, which come first
        window = round(self._figures.window_s / schedule.period_s)
        bases = [free_responses(step, window) for step in steps]
        # (k, w, f), columns of zeros where one candidate has fewer
        self._free = np.zeros((CANDIDATES, window, max(basis.shape[1] for basis in bases)))
        for whole, basis in zip(self._free, bases, strict=True):
            whole[:, : basis.shape[1]] = basis
        self._state = np.zeros_like(inputs)
        self._volts, self._responses = np.zeros(window), np.zeros((CANDIDATES, window))
        self._measured = 0
        self._cost, self._in_a_row = np.zeros(CANDIDATES), False
        self._forget = exp(-self._figures.update_s / self._figures.forgetting_s)
        self.estimate = NOTHING

    def advance(self, volts: np.ndarray, current_A: np.ndarray) -> Estimate:
        """Take the samples of one update interval.

        Args:
            volts: (c,) as the law hears them.
            current_A: (c,) held from each sample to the next.
        """
        step, count = self._step, len(volts)
        answers = np.empty((CANDIDATES, count))
        for k in range(count):
            answers[:, k] = self._state @ step.output
            self._state = np.einsum("kij,kj->ki", step.transition, self._state) + step.input * current_A[k]
        self._volts = np.append(self._volts[count:], volts)
        self._responses = np.hstack([self._responses[:, count:], answers])
        self._measured += count
        if self._measured >= len(self._volts):
            self._weigh(count / len(self._volts))
        return self.estimate

    def _weigh(self, share: float) -> None:
        """Judge the present window, of which a share is new, and add it up if it is useful."""
        figures = self._figures
        rest = self._volts - self._responses
        explained = np.einsum("kwf,kw->kf", self._free, rest)
        left = np.maximum((rest**2).sum(axis=1) - (explained**2).sum(axis=1), 0.0)
        freedom = max(len(self._volts) - FREE, 1)
        noise = figures.noise_V**2
        variance = left.min() / freedom
        allowed = _NOISE_ROOM * noise + figures.model_error**2 * max(self._volts.var() - noise, 0.0)
        cost = left / max(variance, noise)
        alone = _lowest(self._masses, cost)
        doubt, contradicts = alone.std_kg / figures.largest_std_kg, self._contradicts(alone)
        if variance > allowed or doubt > (1 if contradicts else _WORTH):
            self._in_a_row = False
            return
        if contradicts:
            self._cost, self._in_a_row = np.zeros_like(self._cost), False
        # The first of a row of windows is all new, each further one brings its share.
        self._cost = self._forget * self._cost + cost * (share if self._in_a_row else 1.0)
        self._in_a_row = True
        self.estimate = _lowest(self._masses, self._cost)

    def _contradicts(self, alone: Estimate) -> bool:
        """Whether a window's own estimate cannot be of the payload that was added up so far."""
        known = self.estimate
        if not known.std_kg < inf:
            return False
        apart = abs(alone.outer_end_mass_kg - known.outer_end_mass_kg) - self._figures.band_kg
        return apart > CONTRADICTION * sqrt(alone.std_kg**2 + known.std_kg**2)


_WORTH = 4.0
"""A window whose own estimate is this many times less certain than the threshold tells too little to be added up."""


def _lowest(masses: np.ndarray, cost: np.ndarray) -> Estimate:
    """Where a cost, squares over their variance, is least: by a parabola through the lowest three candidates."""
    k = int(np.clip(cost.argmin(), 1, len(masses) - 2))
    step = masses[1] - masses[0]
    before, here, after = cost[k - 1 : k + 2]
    bend = (before - 2 * here + after) / step**2
    if not bend > 0:
        return Estimate(float(masses[cost.argmin()]), inf)
    place = masses[k] - (after - before) / (2 * step) / bend
    return Estimate(float(np.clip(place, masses[0], masses[-1])), sqrt(2 / bend))


COLUMNS = (*SIMULATED, "sensor_V", "outer_end_mass_kg", "stage", "estimate_kg", "estimate_std_kg")


@dataclass(frozen=True)
class Course:
    """What is done to a rig.

    Attributes:
        force_N: (N,) on the tip, one figure for each sample of the law.
        payload_kg: (time in s, payload) pairs from time 0 on; each lasts until the next.
        joining: whether payload joins with the tip's velocity, or at rest, which takes some of it.
        command_V: (N,) on top of the sensor's noise; none where left out.
        before_N: force that it rests under before; the first of force_N where left out.
    """

    force_N: np.ndarray
    payload_kg: tuple[tuple[float, float], ...]
    joining: Literal["matched", "from_rest"] = "matched"
    command_V: np.ndarray | None = None
    before_N: float | None = None


def simulate_scheduled(
    rig: Prototype,
    course: Course,
    built: Prototype | None = None,
    first_stage: int = 0,
    adaptive: bool = True,
    noise_V: float = 0.0,
    seed: int = 0,
    limit_m: float = 0.02,
) -> SimulatedRecord:
    """Simulate a scheduled controller; the record has the `COLUMNS`, and is called stable where it did not diverge.

    Law and estimator hear the sensor with its noise at sample times; the estimator believes the prototype of `rig`.

    Args:
        rig: the prototype with a controller that has several laws.
        course: what is done to it.
        built: the rig that really moves, with its effects; that of the prototype where left out.
        first_stage: that acts at first, from 0.
        adaptive: whether the stage follows the estimate; else it stays.
        noise_V: standard deviation of the sensor's noise.
        seed: of the noise.
        limit_m: displacement at which the loop has diverged.

    Raises:
        InputError: for effects that cannot be.
        ValueError: where there is no equilibrium to start from.
    """
    schedule = rig.schedule
    assert schedule is not None  # the caller has seen that there are several laws
    laws = [stage.law for stage in schedule.stage]
    plant = (built or rig).but(controller=laws[0])
    inner, period = plant.payload.inner_end_mass_kg, schedule.period_s
    kinds, continuous = structure_of(plant, True), assemble(structure_of(plant))
    states = assemble(kinds).states
    velocity = states.index("outer_m_per_s")

    def figures(mass: float) -> np.ndarray:
        return np.array(list(parameters_of(plant, mass, inner).values()))

    count = len(course.force_N)
    times = np.arange(count) * period
    substeps = max(substeps_for(continuous, figures(mass), times) for _, mass in course.payload_kg)
    noise = noise_V * np.random.default_rng(seed).standard_normal(count)
    command = np.zeros(count) if course.command_V is None else course.command_V
    inputs = half_steps(np.column_stack([course.force_N, np.zeros(count)]), substeps)
    inputs[:: 2 * substeps, 1] = command - noise  # read at the samples of the law alone
    before = np.array([course.force_N[0] if course.before_N is None else course.before_N, 0.0, 0.0])
    mass = course.payload_kg[0][1]
    rest = equilibrium(continuous, before, figures(mass))
    measured = float(np.asarray(continuous.function(0.0, rest, before, figures(mass))[1]).ravel()[-1])
    state = rest[[continuous.states.index(name) for name in states]]
    error, current = -measured, laws[first_stage].gain_A_per_V * -measured

    hop = round(schedule.estimator.update_s / period)
    estimator = PayloadEstimator(rig, schedule)
    stage, changed = first_stage, -np.inf
    rows: list[np.ndarray] = []
    changes: list[tuple[float, int]] = []
    pending = list(course.payload_kg[1:])
    bare = lumped.figures(plant)["outer_mass"]
    for begin in range(0, count - 1, hop):
        end = min(begin + hop, count - 1)
        now = begin * period
        while pending and pending[0][0] <= now + 1e-12:
            new = pending.pop(0)[1]
            if course.joining == "from_rest" and new > mass:
                state[velocity] *= (bare + mass) / (bare + new)
            mass = new
        law = sampled_law(laws[stage], period)
        z = law.after(np.array([error]), current)
        y, state = integrate(
            kinds,
            np.arange(begin, end + 1) * period,
            inputs[2 * substeps * begin : 2 * substeps * end + 1],
            state,
            figures(mass),
            substeps,
            limit_m,
            law.packed(substeps, 0, 0.0, z, current),
        )
        whole = len(y) == end - begin + 1
        y = y[: end - begin]  # the last sample is the first of what follows
        here = slice(begin, begin + len(y))
        volts = y[:, OUTPUTS.index("measured_V")] + noise[here]
        for value in command[here] - volts:
            z, current = law.step(z, np.array([value]))
            error = value
        estimate = estimator.advance(volts, y[:, OUTPUTS.index("current_A")]) if whole else estimator.estimate
        noted = (mass, stage + 1, estimate.outer_end_mass_kg, estimate.std_kg)
        times = np.arange(begin, begin + len(y)) * period
        given = (times, course.force_N[here], command[here])
        rows.append(np.column_stack([*given, y[:, :4], volts, np.tile(noted, (len(y), 1))]))
        if not whole:
            record = diverged(rig.name, np.vstack(rows), limit_m, period)
            return replace(record, columns=COLUMNS, changes=tuple(changes))
        chosen = next_stage(schedule, stage, estimate, end * period - changed) if adaptive else stage
        if chosen != stage:
            stage, changed = chosen, end * period
            changes.append((end * period, stage + 1))
    return SimulatedRecord(rig.name, np.vstack(rows), True, columns=COLUMNS, changes=tuple(changes))


def next_stage(schedule: Scheduled, stage: int, estimate: Estimate, since_s: float) -> int:
    """The stage to go on with.

    A stage keeps acting while the estimate lies within its range, less the estimator's band towards its neighbours:
    then the payload itself is in the range as long as the estimate errs by no more than the band. Ranges overlap by
    more than two bands; the rest is hysteresis.

    Args:
        schedule: stages and figures.
        stage: number of the one that acts, from 0.
        estimate: of the payload.
        since_s: time since the last change.
    """
    if since_s < schedule.dwell_s or estimate.std_kg > schedule.estimator.largest_std_kg:
        return stage
    mass = estimate.outer_end_mass_kg
    spare = [min(mass - least, most - mass) for least, most in schedule.kept_kg]
    if spare[stage] >= 0:
        return stage
    return max(range(len(spare)), key=lambda k: spare[k])


def course_of(row: ScenarioRecord, scenario: Scenario) -> Course:
    """What a record does to the rig: force, command, and payload with its change."""
    inputs, begun = inputs_of(row, scenario), (0.0, row.outer_end_mass_kg)
    force, command = inputs[:, 0] + row.preload_N, inputs[:, 1]
    before = row.preload_N if scenario.start == "loaded" else 0.0
    if (change := row.payload_change) is None:
        return Course(force, (begun,), command_V=command, before_N=before)
    return Course(force, (begun, (change.at_s, change.outer_end_mass_kg)), change.joining, command, before)


def unfit(scenario: Scenario, row: ScenarioRecord, schedule: Scheduled) -> list[Problem]:
    """What of a record in its scenario a scheduled controller cannot be put through."""
    found = []
    if abs(scenario.sample_s - schedule.period_s) > 1e-9:
        words = f"must be the period of the scheduled controller, {schedule.period_s:g}, is {scenario.sample_s:g}"
        found.append(Problem("sample_s", words))
    if scenario.sampled not in (None, Sampled(period_s=schedule.period_s)):
        words = f"must be as the scheduled controller is: every {schedule.period_s:g} s, without delay and quantisation"
        found.append(Problem("sampled", words))
    if row.wall is not None:
        found.append(Problem(f"record.{row.name}.wall", "is not for a scheduled controller"))
    return found


def simulate_stages(prototype: Prototype, scenario: Scenario, row: ScenarioRecord, position: int) -> SimulatedRecord:
    """Simulate a record of a scenario, at a position there, begun with the first stage.

    Law and estimator work at the schedule's period and hear the sensor with its noise where the prototype states it.
    Under noise nothing comes to rest, so that a record is called stable as long as the tip stays within the limit.

    Raises:
        InputError: where there is no equilibrium to start from.
    """
    noise, seed = prototype.sensor.noise_V or 0.0, scenario.measurement.seed + position
    course, limit, built = course_of(row, scenario), scenario.displacement_limit_m, prototype
    if row.inner_end_mass_kg is not None:
        built = prototype.but(payload=prototype.payload.but(inner_end_mass_kg=row.inner_end_mass_kg))
    try:
        found = simulate_scheduled(prototype, course, built, noise_V=noise, seed=seed, limit_m=limit)
    except ValueError as error:
        raise InputError(prototype.name, [(f"record.{row.name}", str(error))]) from error
    return replace(found, name=row.name, samples=as_measured(found.samples, scenario, position))
