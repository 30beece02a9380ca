"""The largest bandwidth near a start, within limits at sampled points: interior points with exact second derivatives.

The bandwidth is a variable, and compliance is enforced at shares of it. The other limits are enforced at fixed
frequencies and masses, of which the plant's responses are worked out beforehand: a coarse set that covers everything,
and the worst points of a fine one, chosen anew in every round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, log, pi

import casadi as ca
import numpy as np

from beamdesign.design.interruption import interruption_waits
from beamdesign.design.loop_constraints import member_slack
from beamdesign.design.sampled_loops import Samples, Slacks, sampled_bandwidth, slacks
from beamdesign.design.worst_samples import WorstSamples
from beamdesign.linear import BilinearPlant
from beamdesign.prototype import Goal

_WORST = (120, 20, 60)
"""How many of the worst points of sensitivity, loop gain and effort are enforced beside the coarse ones."""

_EVERY = (4, 4, 6)
"""Of how many neighbouring points one is enforced wherever it stands."""

_SHARES = np.concatenate([[5e-4], np.linspace(0.02, 0.37, 8), np.linspace(0.4, 1.0, 21)])

_SPOILT = 2e-3
"""Violation between the enforced points that is put up with in a round; the worst of them are enforced in the next."""

WORTH = 10.0
"""Share of the bandwidth that may be given up to mend a violation, over that violation."""

_MENDED, _MENDED_A_LITTLE = 0.5, 0.9
"""Share of a violation that a mended one has at most; and where nothing else leads on: as worst rigs change about, the
violation may have to be mended in several steps."""

STIFFER = 3e-3
"""By how much (logarithm) the compliance is kept with something to spare at shares of the bandwidth."""

_SETTLED = 2e-5
"""Relative growth of the bandwidth in a round below which the polish ends."""


@dataclass(frozen=True)
class Polish:
    """Interior points for one form of controller on one set of loops; called from any start.

    Attributes:
        points: fine samples of the loops.
        goal: the limits.
        kind: of the form, see `beamdesign.design.controller_forms.form_named`.
        plants: the plants and factors on their gain that are to perform, with the number of their first row of samples,
            that of the least mass.
        masses: outer end masses (kg) at which compliance is enforced.
        lower: (v,) bounds of the variables of `sampled_loops`.
        upper: (v,)
    """

    points: Samples
    goal: Goal
    kind: str
    plants: Sequence[tuple[BilinearPlant, float, int]]
    masses: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    _solver: ca.Function = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build the program: its points are parameters."""
        object.__setattr__(self, "_solver", self._program())

    def __call__(
        self,
        start: np.ndarray,
        inside: float = 0.0,
        stiffer: float = STIFFER,
        rounds: int = 12,
        reach: float = 0.7,
        worth: float = WORTH,
    ) -> tuple[np.ndarray, float]:
        """Variables and sampled bandwidth of the best loop found, the start's own where none is better.

        Args:
            start: (v,) variables of a loop that is stable.
            inside: by how much (logarithm) every limit but the compliance is to be kept with something to spare.
            stiffer: likewise of the compliance, which may touch its limit far below the bandwidth.
            rounds: at most.
            reach: how far a variable may move in the first of them.
            worth: share of the bandwidth that may be given up to mend a violation, over that violation.
        """
        best = np.clip(start, self.lower, self.upper)
        now = slacks(self.points, self.goal, best, slopes=False)
        reached = sampled_bandwidth(self.points, now.compliance)
        spoilt = now.violation_inside(inside)
        least = _MENDED if worth < inf else _MENDED_A_LITTLE
        while rounds > 0 and reach > 0.01:
            rounds -= 1
            tried = self._solved(best, now, max(reached, 0.5), (inside, stiffer), reach)
            then = slacks(self.points, self.goal, tried, slopes=False)
            wider = sampled_bandwidth(self.points, then.compliance)
            spoils = then.violation_inside(inside)
            mended = spoils < min(spoilt - 1e-7, least * spoilt) and wider >= reached * (1 - worth * spoilt)
            better = mended or wider > reached * (1 + _SETTLED)
            if not (then.settled and spoils < max(spoilt, _SPOILT) * 1.01 and better):
                reach /= 3
                continue
            best, now, reached, spoilt = tried, then, wider, spoils
        return best, reached

    def _solved(
        self, start: np.ndarray, now: Slacks, bandwidth_Hz: float, spare: tuple[float, float], reach: float
    ) -> np.ndarray:
        limited = (now.held_on[0], now.held_on[2], now.held_on[3])
        data = [_data(one, index).ravel(order="F") for one, index in zip(limited, _enforced(now), strict=True)]
        if isinstance(self.points, WorstSamples):
            data += [self._moved(now, row, bandwidth_Hz).ravel(order="F") for _, _, row in self.plants]
        lower, upper = np.maximum(self.lower, start - reach), np.minimum(self.upper, start + reach)
        beta = log(bandwidth_Hz)
        with interruption_waits():
            found = self._solver(
                x0=np.append(start, beta),
                p=np.concatenate([*data, spare]),
                lbx=np.append(lower, beta - 1.0),
                ubx=np.append(upper, beta + 1.0),
                lbg=0.0,
                ubg=ca.inf,
            )
        values = np.asarray(found["x"]).ravel()[:-1]
        return np.clip(values, lower, upper) if np.isfinite(values).all() else start

    def _moved(self, now: Slacks, first_row: int, bandwidth_Hz: float) -> np.ndarray:
        """(3, n) shifts, as of `member_slack`, of the rigs that are worst for compliance at shares of a bandwidth."""
        off, found = now.held_on[1], []
        asked = np.log(_SHARES * bandwidth_Hz)
        for k in range(len(self.masses)):
            on = np.nonzero(self.points.row == first_row + k)[0]
            nearest = on[np.abs(np.log(self.points.frequency_Hz[on])[:, None] - asked).argmin(axis=0)]
            control, pushed = (
                np.log(one[0, nearest] / own[0, nearest])
                for one, own in ((off.control, self.points.control), (off.disturbance, self.points.disturbance))
            )
            found.append(np.array([control.real, control.imag, pushed.real]))
        return np.stack(found, axis=2).reshape(3, -1)

    def _program(self) -> ca.Function:
        count = len(self.lower)
        variables = ca.MX.sym("variables", count + 1)
        logarithms, inner, beta = ca.vertsplit(variables, [0, count - 1, count, count + 1])
        nothing = slacks(self.points, self.goal, self.lower, slopes=False)
        sizes = [len(index) for index in _enforced(nothing)]
        data = [ca.MX.sym(name, _ROWS, size) for name, size in zip("sle", sizes, strict=True)]
        inside, stiffer, found = ca.MX.sym("inside"), ca.MX.sym("stiffer"), []
        for k, (given, size) in enumerate(zip(data, sizes, strict=True)):
            if size:
                point, every = _point(count, self.goal, k), ca.vertcat(logarithms, inner)
                found.append(point.map(size)(ca.repmat(every, 1, size), given).T - inside)
        shares = np.repeat(_SHARES, len(self.masses))
        masses = np.tile(self.masses, len(_SHARES))
        off = isinstance(self.points, WorstSamples)
        for plant, factor, _ in self.plants:
            slack = member_slack(self.kind, plant, factor, shifts=off)
            n = len(shares)
            both = ca.vertcat(ca.DM(masses).T, ca.repmat(inner, 1, n))
            asked = [both, ca.repmat(logarithms, 1, n), ca.exp(beta) * ca.DM(shares).T]
            if off:
                data.append(ca.MX.sym("moved", 3, n))
                stiffness = slack.map(n)(*asked, data[-1])
            else:
                _, stiffness = slack.map(n)(*asked)
            found.append(stiffness.T + log(self.goal.compliance_m_per_N) - stiffer)
        return ca.nlpsol(
            "polish",
            "ipopt",
            {"x": variables, "p": ca.vertcat(*map(ca.vec, data), inside, stiffer), "f": -beta, "g": ca.vertcat(*found)},
            {
                "print_time": False,
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
                "ipopt.max_iter": 80,
                "ipopt.tol": 1e-7,
                "ipopt.mu_init": 1e-3,
                "ipopt.bound_relax_factor": 0.0,
            },
        )


_ROWS = 8
"""Of the data of one point: w, then real and imaginary parts of what `Samples` holds, and the factor on the limit."""


def _enforced(found: Slacks) -> list[np.ndarray]:
    """Indices of the points at which sensitivity, loop gain and effort are enforced."""
    limited = (found.sensitivity, found.loop_gain, found.effort)
    return [_chosen(slack, worst, every) for slack, worst, every in zip(limited, _WORST, _EVERY, strict=True)]


def _chosen(slack: np.ndarray, worst: int, every: int) -> np.ndarray:
    """Indices of the points that are enforced: some of all that are limited, and the worst ones."""
    limited = np.nonzero(np.isfinite(slack))[0]
    if not len(limited):
        return limited
    least = limited[np.argsort(slack[limited], kind="stable")[:worst]]
    return np.concatenate([limited[::every], least])


def _data(points: Samples, index: np.ndarray) -> np.ndarray:
    """(_ROWS, n) of the chosen points."""
    complex_rows = (points.denominator[index], points.control[0, index], points.control[1, index])
    parts = [part for row in complex_rows for part in (row.real, row.imag)]
    return np.array([2 * pi * points.frequency_Hz[index], *parts, points.looser[index]])


def _point(count: int, goal: Goal, which: int) -> ca.Function:
    """Slack of sensitivity, loop gain or effort (0, 1, 2) at one point, from variables and data."""
    variables, data = ca.SX.sym("v", count), ca.SX.sym("d", _ROWS)
    w, pr, pi_, cr, ci, er, ei, looser = ca.vertsplit(data)
    inner = variables[count - 1]
    figures = ca.vertsplit(ca.exp(variables[: count - 1]))
    real, imaginary = figures[0], ca.SX(0)

    def times(a: tuple[ca.SX, ca.SX], b: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
        return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]

    above, below = (real, imaginary), (ca.SX(1), ca.SX(0))
    below = times(below, (ca.SX(1), w / (2 * pi * figures[1])))
    above = times(above, (ca.SX(1), w / (2 * pi * figures[2])))
    for first in range(3, count - 1, 4):
        zero, zero_damping, pole, pole_damping = figures[first : first + 4]
        u, v = w / (2 * pi * zero), w / (2 * pi * pole)
        above = times(above, (1 - u * u, 2 * zero_damping * u))
        below = times(below, (1 - v * v, 2 * pole_damping * v))
    opened = times(below, (1 + inner * pr, inner * pi_))
    returned = times(above, (cr + inner * er, ci + inner * ei))

    def log_square(value: tuple[ca.SX, ca.SX]) -> ca.SX:
        return ca.log(value[0] ** 2 + value[1] ** 2) / 2

    closed = log_square((opened[0] + returned[0], opened[1] + returned[1]))
    if which == 0:
        slack = closed - log_square(opened) + log(goal.peak_sensitivity) + ca.log(looser)
    elif which == 1:
        slack = log_square(opened) - log_square(returned) + log(goal.loop_gain or 1.0)
    else:
        plant = log_square((1 + inner * pr, inner * pi_))
        slack = closed - plant - log_square(above) + log(goal.controller_effort_A_per_V or 1.0)
    return ca.Function("point", [variables, data], [slack])
