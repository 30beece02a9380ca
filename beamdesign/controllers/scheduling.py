"""A scheduled controller at work: how it estimates the payload, and which stage it goes on with.

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

from dataclasses import dataclass
from math import exp, inf, sqrt

import numpy as np

from beamdesign.controllers import Scheduled
from beamdesign.controllers.scheduled import FREE
from beamdesign.plant.equilibrium import scales
from beamdesign.plant.linear import LinearModel
from beamdesign.plant.members import paper_model
from beamdesign.prototype import Prototype

CANDIDATES = 17
MARGIN = 0.1
"""Share of the payload's range by which candidates go beyond either end, so that the end can be told from beyond."""
CONTRADICTION = 4.0
"""Standard deviations by which a window's estimate may be off what was added up, before that is dropped."""
_NOISE_ROOM = 1.3
"""Factor on the noise that a window without movement of the force may leave."""


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
    scale = np.append(scales(rig.states), [10.0, 1.0])  # then force (N) and current (A)
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
        rig, inner = paper_model(prototype.but(effects={})), prototype.payload.inner_end_mass_kg
        least = max(low - beyond, -rig.figures["outer_mass"] / 2)  # half the beam's own mass is always left
        self._masses = np.linspace(least, high + beyond, CANDIDATES)
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
