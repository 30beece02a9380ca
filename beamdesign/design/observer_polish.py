"""The largest bandwidth near a controller with several sensors: interior points with exact second derivatives.

Every limit is enforced at sampled points: a coarse set that covers everything, and the worst points of a fine one,
chosen anew in every round. The bandwidth is a variable: beyond it the limit of compliance is raised, smoothly and fast.
"""

from dataclasses import dataclass, field
from math import log, pi

import casadi as ca
import numpy as np

from beamdesign.design.interruption import interruption_waits
from beamdesign.design.observer_slacks import BlockLaw, observer_slacks
from beamdesign.design.sampled_loops import Slacks, sampled_bandwidth
from beamdesign.design.sensed_samples import SensedSamples
from beamdesign.prototype import Goal

_EVERY = 6
"""Of how many neighbouring points one is enforced wherever it stands."""

_WORST = (100, 60, 25, 50)
"""How many of the worst points of sensitivity, compliance, loop gain and effort are enforced beside these."""

_RAISED = 600.0
"""By how much (logarithm) the limit of compliance is raised beyond the bandwidth, over the square of the log of the
frequencies' ratio."""

_BEYOND = 1.3
"""Up to how many times the bandwidth compliance is enforced, raised or not."""

_SPOILT = 2e-3
"""Violation between the enforced points that is put up with in a round; the worst of them are enforced in the next."""

_WORTH = 10.0
"""Share of the bandwidth that may be given up to mend a violation, over that violation."""

TOUCH = 5e-4
"""By how much (logarithm) compliance is kept to spare where it is enforced, so that it is kept between as well."""

_NEARLY = 0.02
"""By how much (logarithm) the compliance may miss its limit where a round begins."""

_SETTLED = 1e-4
"""Relative growth of the bandwidth in a round below which the polish ends."""

_FREE = 3.0
"""Of a numerator's figure, of order one: how far it may move over what a logarithm may."""


@dataclass(frozen=True)
class ObserverPolish:
    """Interior points for one form of controller on one set of samples; called from any start.

    Attributes:
        points: fine samples of the loops.
        goal: the limits.
        law: form of the controller.
        largest_inner: most mass inside, kg.
    """

    points: SensedSamples
    goal: Goal
    law: BlockLaw
    largest_inner: float
    _solver: ca.Function = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build the program: its points are parameters."""
        object.__setattr__(self, "_solver", self._program())

    def measured(self, variables: np.ndarray) -> Slacks:
        """What a controller leaves of the limits, without derivatives."""
        return observer_slacks(self.points, self.goal, self.law, variables, slopes=False)

    def __call__(
        self, start: np.ndarray, inside: float = 0.0, stiffer: float = TOUCH, rounds: int = 12, reach: float = 0.5
    ) -> tuple[np.ndarray, float]:
        """Variables and sampled bandwidth of the best loop found, the start's own where none is better.

        Args:
            start: (v,) variables of a loop that is stable.
            inside: by how much (logarithm) every limit but the compliance is to be kept with something to spare.
            stiffer: likewise of the compliance.
            rounds: at most.
            reach: how far a variable may move in the first of them.
        """
        lower, upper = self.law.bounds(self.largest_inner)
        best = np.clip(start, lower, upper)
        now = self.measured(best)
        if not now.settled:
            return best, 0.0
        reached, spoilt = sampled_bandwidth(self.points, now.compliance - stiffer + TOUCH), now.violation_inside(inside)
        while rounds > 0 and reach > 0.005:
            rounds -= 1
            tried = self._solved(best, now, reached, (inside, stiffer), reach)
            then = self.measured(tried)
            wider, spoils = (
                sampled_bandwidth(self.points, then.compliance - stiffer + TOUCH),
                then.violation_inside(inside),
            )
            mended = spoils < min(spoilt - 1e-7, spoilt / 2) and wider >= reached * (1 - _WORTH * spoilt)
            better = mended or wider > reached * (1 + _SETTLED)
            if not (then.settled and spoils < max(spoilt, _SPOILT) * 1.01 and better):
                reach /= 3
                continue
            best, now, reached, spoilt = tried, then, wider, spoils
        return best, reached

    def _solved(
        self, start: np.ndarray, now: Slacks, bandwidth_Hz: float, spare: tuple[float, float], reach: float
    ) -> np.ndarray:
        lower, upper = self.law.bounds(self.largest_inner)
        moves = np.full(len(start), reach)
        moves[upper > 500] *= _FREE
        lower, upper = np.maximum(lower, start - moves), np.minimum(upper, start + moves)
        # A compliance that just misses its limit at rest has no bandwidth, but is a good start.
        near = sampled_bandwidth(self.points, now.compliance + _NEARLY)
        beta = log(max(bandwidth_Hz, near, 0.5))
        data = [self._data(index).ravel(order="F") for index in self._enforced(now, np.exp(beta))]
        with interruption_waits():
            found = self._solver(
                x0=np.append(start, beta),
                p=np.concatenate([*data, spare]),
                lbx=np.append(lower, beta - 1.0),
                ubx=np.append(upper, beta + 0.25),
                lbg=0.0,
                ubg=ca.inf,
            )
        values = np.asarray(found["x"]).ravel()[:-1]
        return np.clip(values, lower, upper) if np.isfinite(values).all() else start

    def _enforced(self, now: Slacks, bandwidth_Hz: float) -> list[np.ndarray]:
        """Indices of the points at which each limit is enforced; as many of each whatever the bandwidth."""
        near = self.points.frequency_Hz <= bandwidth_Hz * _BEYOND
        far = np.where(np.isinf(now.compliance), np.inf, 50.0 + self.points.frequency_Hz)
        compliance = np.where(near, now.compliance, far)
        parts = (now.sensitivity, compliance, now.loop_gain, now.effort)
        return [_chosen(part, worst) for part, worst in zip(parts, _WORST, strict=True)]

    def _data(self, index: np.ndarray) -> np.ndarray:
        """What `_point` reads of some points, (rows, count)."""
        at = self.points
        parts = [at.denominator[index][None], at.disturbance[:, index]]
        for k in range(self.law.sensors):
            parts += [at.control[k][:, index], at.minor[k][:, index]]
        values = np.concatenate(parts)
        plain = np.array([2 * pi * at.frequency_Hz[index], at.looser[index]])
        return np.concatenate([plain, values.real, values.imag])

    def _program(self) -> ca.Function:
        count = self.law.size
        variables = ca.MX.sym("variables", count + 1)
        own, beta = variables[:count], variables[count]
        inside, stiffer = ca.MX.sym("inside"), ca.MX.sym("stiffer")
        limited = (True, True, self.goal.loop_gain is not None, self.goal.controller_effort_A_per_V is not None)
        data, found = [], []
        for which, worst in enumerate(_WORST):
            rows = 2 + 2 * (3 + 4 * self.law.sensors)
            size = len(_chosen(self._limited(which), worst))
            given = ca.MX.sym(f"data_{which}", rows, size)
            data.append(given)
            if not (limited[which] and size):
                continue
            slack = _point(self.law, self.goal, which).map(size)(ca.repmat(own, 1, size), given).T
            if which == 1:
                over = ca.fmax(ca.log(given[0, :].T / (2 * pi)) - beta, 0.0)
                slack = slack + _RAISED * over**2 - stiffer
            else:
                slack = slack - inside
            found.append(slack)
        return ca.nlpsol(
            "polish",
            "ipopt",
            {"x": variables, "p": ca.vertcat(*map(ca.vec, data), inside, stiffer), "f": -beta, "g": ca.vertcat(*found)},
            {
                "print_time": False,
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
                "ipopt.max_iter": 70,
                "ipopt.tol": 1e-6,
                "ipopt.mu_init": 1e-3,
                "ipopt.bound_relax_factor": 0.0,
            },
        )

    def _limited(self, which: int) -> np.ndarray:
        """Zero where a limit ever counts, else infinite: how many points are enforced must not change."""
        counts = np.full(len(self.points.frequency_Hz), True) if which == 0 else self.points.looser == 1.0
        if which == 2:
            counts &= self.points.frequency_Hz >= self.goal.loop_gain_from_Hz
        return np.where(counts, 0.0, np.inf)


def _chosen(slack: np.ndarray, worst: int) -> np.ndarray:
    """Indices of every so manieth finite slack and of the worst of the others."""
    finite = np.nonzero(np.isfinite(slack))[0]
    even = finite[::_EVERY]
    rest = np.setdiff1d(finite, even)
    return np.concatenate([even, rest[np.argsort(slack[rest], kind="stable")[:worst]]])


Pair = tuple[ca.SX, ca.SX]


def _times(one: Pair, two: Pair) -> Pair:
    return one[0] * two[0] - one[1] * two[1], one[0] * two[1] + one[1] * two[0]


def _plus(one: Pair, two: Pair) -> Pair:
    return one[0] + two[0], one[1] + two[1]


def _log(value: Pair) -> ca.SX:
    return ca.log(value[0] ** 2 + value[1] ** 2) / 2


def _point(law: BlockLaw, goal: Goal, which: int) -> ca.Function:
    """Slack of sensitivity, compliance, loop gain or effort at one point, from variables and data of the point."""
    p, count = law.sensors, law.size
    half = 3 + 4 * p
    variables, data = ca.SX.sym("variables", count), ca.SX.sym("data", 2 + 2 * half)
    w, looser, inner = data[0], data[1], variables[count - 1]
    values: list[Pair] = [(data[2 + k], data[2 + half + k]) for k in range(half)]

    def affine(k: int) -> Pair:
        return values[k][0] + inner * values[k + 1][0], values[k][1] + inner * values[k + 1][1]

    one: Pair = (ca.SX(1), ca.SX(0))
    plant = _plus(one, (inner * values[0][0], inner * values[0][1]))
    own: list[Pair] = [(variables[law.blocks * (2 + 2 * p) + k] * law.units[k], ca.SX(0)) for k in range(p)]
    for i in range(law.blocks):
        first = i * (2 + 2 * p)
        u, damping = w / ca.exp(variables[first]), ca.exp(variables[first + 1])
        below: Pair = (1 - u * u, 2 * damping * u)
        square = below[0] ** 2 + below[1] ** 2
        for k in range(p):
            low, high = variables[first + 2 + k] * law.units[k], variables[first + 2 + p + k] * law.units[k]
            above: Pair = (low, high * u)
            numerator = _times(above, (below[0], -below[1]))
            own[k] = _plus(own[k], (numerator[0] / square, numerator[1] / square))
    returned, moved = (ca.SX(0), ca.SX(0)), affine(1)
    for k in range(p):
        returned = _plus(returned, _times(own[k], affine(3 + 4 * k)))
        if k:
            moved = _plus(moved, _times(own[k], affine(5 + 4 * k)))
    closed = _log(_plus(plant, returned))  # of plant times 1 + L
    if which == 0:
        slack = closed - _log(plant) + log(goal.peak_sensitivity) + ca.log(looser)
    elif which == 1:
        slack = closed - _log(moved) + log(goal.compliance_m_per_N)
    elif which == 2:
        slack = _log(plant) - _log(returned) + log(goal.loop_gain or 1.0)
    else:
        slack = closed - _log(plant) - _log(own[0]) + log(goal.controller_effort_A_per_V or 1.0)
    return ca.Function("point", [variables, data], [slack])
