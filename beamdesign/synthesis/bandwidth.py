"""The largest bandwidth near a law on samples: a coarse search by linear programs, and a refinement by interior points.

At each step the least slack of compliance up to a little beyond the bandwidth reached is maximised, linearised, with
the other limits as constraints (sequential linear programming; R. Fletcher and E. Sainz de la Maza, Nonlinear
programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43, 1989). At such an
optimum nearly as many limits are active as there are variables, so that steps of first order are enough.

In the refinement, with exact second derivatives, the bandwidth is a variable, and compliance is enforced at shares of
it. The other limits are enforced at sampled points: a coarse set that covers everything, and the worst points of a
fine one, chosen anew in every round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf, log, pi

import casadi as ca
import numpy as np
from flint import fmpq_poly

from beamdesign.controllers.form import UNIT, Form
from beamdesign.plant.linear import BilinearPlant, PairOver
from beamdesign.proofs.certificate import Kind
from beamdesign.prototype import Goal
from beamdesign.rational import nearest
from beamdesign.synthesis.interruption import interruption_waits
from beamdesign.synthesis.loop_limits import LIMITED, Pair, added_up, goal_limits, on_axis, product, slack_of
from beamdesign.synthesis.loop_samples import COMPLIANCE, OTHERS, Samples, Slacks, counting, sampled_bandwidth, slacks

_BEYOND = 1.06
"""Up to how many times the bandwidth reached the compliance is bettered."""

_PENALTY = 20.0
"""What a violation of the other limits costs, over the slack of compliance."""

_SMALLEST_REACH, _LARGEST_REACH = 1e-4, 0.5


def coarse_search(
    points: Samples,
    goal: Goal,
    form: Form,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    most: int = 600,
    reach: float = 0.3,
) -> np.ndarray:
    """Variables (v,) that a coarse search leads to; its start, within its bounds, where no loop is stable.

    Args:
        points: where the limits are kept.
        goal: the limits.
        form: of the law.
        start: (v,) variables.
        lower: (v,) their bounds.
        upper: (v,)
        most: linear programs at most.
        reach: how far a variable may move in the first step.
    """
    here = np.clip(start, lower, upper)
    now = slacks(points, goal, form, here)
    if not now.settled:
        return here
    aim = _aim(points, now)
    steps, still = 0, 0
    while steps < most and reach > _SMALLEST_REACH and still < 12:
        steps += 1
        least, greatest = np.maximum(lower - here, -reach), np.minimum(upper - here, reach)
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
            tried_again = here + again
            then_again = slacks(points, goal, form, tried_again)
            if then_again.settled and (not then.settled or _merit(points, then_again, aim) - merit > gained):
                tried, then, gained = tried_again, then_again, _merit(points, then_again, aim) - merit
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


def _aim(points: Samples, now: Slacks) -> float:
    """Up to which frequency the compliance is to be bettered."""
    return max(sampled_bandwidth(points, now.compliance), float(points.frequency_Hz.min())) * _BEYOND


def _merit(points: Samples, found: Slacks, aim: float) -> float:
    return float(found.compliance[points.frequency_Hz <= aim].min()) - _PENALTY * found.violation


def _step(points: Samples, now: Slacks, aim: float, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, float]:
    """The best move within bounds by the linearised slacks, and the merit that is foreseen of it."""
    from scipy.optimize import linprog

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
    bounds = [*zip(least, most, strict=True), (None, None), (0.0, None)]
    found = linprog(cost, np.vstack(rows), np.concatenate(right), bounds=bounds, method="highs")
    if found.x is None:
        return np.zeros(count), -np.inf
    return np.asarray(found.x[:count]), -float(found.fun)


_EVERY = 6
"""Of how many neighbouring points one is enforced wherever it stands."""

_WORST: dict[Kind, int] = {"peak_sensitivity": 100, "loop_gain": 25, "controller_effort": 50}
"""How many of the worst points of each limit but the compliance are enforced beside these."""

_SHARES = np.concatenate([[5e-4], np.linspace(0.02, 0.37, 8), np.linspace(0.4, 1.0, 21)])

_VIOLATION = 2e-3
"""Violation between the enforced points that is put up with in a round; the worst of them are enforced in the next."""

WORTH = 10.0
"""Share of the bandwidth that may be given up to mend a violation, over that violation."""

_MENDED, _MENDED_A_LITTLE = 0.5, 0.9
"""Share of a violation that a mended one has at most; and where nothing else leads on: as worst rigs change about, the
violation may have to be mended in several steps."""

TOUCH = 5e-4
"""By how much (logarithm) compliance is kept to spare where it is enforced, so that it is kept between as well."""

NEARLY = 0.02
"""By how much (logarithm) the compliance may miss its limit where a round begins."""

_SETTLED = 1e-4
"""Relative growth of the bandwidth in a round below which the refinement ends."""


@dataclass(frozen=True)
class LawRefinement:
    """Interior points for one form of law on one set of samples; called from any start.

    Attributes:
        points: fine samples of the loops.
        goal: the limits.
        form: of the law.
        inner_kg: least and most mass inside.
        plants: the plants and factors on their gain that are to perform, with the number of their first row of samples,
            that of the least mass.
        masses: outer end masses (kg) of the rows of a plant.
    """

    points: Samples
    goal: Goal
    form: Form
    inner_kg: tuple[float, float]
    plants: Sequence[tuple[BilinearPlant, float, int]]
    masses: Sequence[float]
    _solver: ca.Function = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build the program: its points are parameters."""
        object.__setattr__(self, "_solver", self._program())

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, those of the form and the mass inside, (v,) each."""
        return np.append(self.form.lower, self.inner_kg[0]), np.append(self.form.upper, self.inner_kg[1])

    def measured(self, variables: np.ndarray) -> Slacks:
        """What a law leaves of the limits, without derivatives."""
        return slacks(self.points, self.goal, self.form, variables, slopes=False)

    def __call__(
        self,
        start: np.ndarray,
        inside: float = 0.0,
        stiffer: float = TOUCH,
        rounds: int = 20,
        reach: float = 0.5,
        worth: float = WORTH,
    ) -> tuple[np.ndarray, float]:
        """Variables and sampled bandwidth of the best loop found, the start's own where none is better.

        Args:
            start: (v,) variables of a loop that is stable.
            inside: by how much (logarithm) every limit but the compliance is to be kept with something to spare.
            stiffer: likewise of the compliance.
            rounds: at most.
            reach: how far a variable may move in the first of them.
            worth: share of the bandwidth that may be given up to mend a violation, over that violation.
        """
        best = np.clip(start, *self.bounds)
        now = self.measured(best)
        if not now.settled:
            return best, 0.0

        def bandwidth(found: Slacks) -> float:
            return sampled_bandwidth(self.points, found.compliance - stiffer + TOUCH)

        reached, violation = bandwidth(now), now.violation_inside(inside)
        least = _MENDED if worth < inf else _MENDED_A_LITTLE
        while rounds > 0 and reach > 0.005:
            rounds -= 1
            tried, foreseen = self._solved(best, now, reached, (inside, stiffer), reach)
            if self._solver.stats()["success"] and foreseen < reached * (1 + _SETTLED) and violation < _VIOLATION / 100:
                break
            then = self.measured(tried)
            wider, missed = bandwidth(then), then.violation_inside(inside)
            mended = missed < min(violation - 1e-7, least * violation) and wider >= reached * (1 - worth * violation)
            better = mended or wider > reached * (1 + _SETTLED)
            if not (then.settled and missed < max(violation, _VIOLATION) * 1.01 and better):
                reach /= 3
                continue
            best, now, reached, violation = tried, then, wider, missed
        return best, reached

    def _solved(
        self, start: np.ndarray, now: Slacks, bandwidth_Hz: float, spare: tuple[float, float], reach: float
    ) -> tuple[np.ndarray, float]:
        """Variables of the program's optimum, and the bandwidth (Hz) that it foresees there."""
        lower, upper = self.bounds
        moves = reach * np.append(self.form.moves, 1.0)
        lower, upper = np.maximum(lower, start - moves), np.minimum(upper, start + moves)
        # A compliance that just misses its limit at rest has no bandwidth, but is a good start.
        near = sampled_bandwidth(self.points, now.compliance + NEARLY)
        beta = log(max(bandwidth_Hz, near, 0.5))
        limited = dict(zip(LIMITED, zip(now.values, now.held_on, strict=True), strict=True))
        data = [
            _data(on, _chosen(slack, worst)).ravel(order="F")
            for (slack, on), worst in ((limited[kind], worst) for kind, worst in _WORST.items())
        ]
        off = limited["compliance"][1]
        data += [self._moved(off, row, np.exp(beta)).ravel(order="F") for _, _, row in self.plants]
        with interruption_waits():
            found = self._solver(
                x0=np.append(start, beta),
                p=np.concatenate([*data, spare]),
                lbx=np.append(lower, beta - 1.0),
                ubx=np.append(upper, beta + 0.25),
                lbg=0.0,
                ubg=ca.inf,
            )
        *values, foreseen = np.asarray(found["x"]).ravel()
        if not np.isfinite(values).all():
            return start, 0.0
        return np.clip(values, lower, upper), float(np.exp(foreseen))

    def _moved(self, off: Samples, first_row: int, bandwidth_Hz: float) -> np.ndarray:
        """(2 r, n) logarithms, real and imaginary, of the worst rigs' responses over the nominal ones.

        At shares of a bandwidth. The responses are those from current to each sensor, from force to displacement, and
        what feedback adds to it.
        """
        asked, found = np.log(_SHARES * bandwidth_Hz), []
        for k in range(len(self.masses)):
            on = np.nonzero(self.points.row == first_row + k)[0]
            nearest = on[np.abs(np.log(self.points.frequency_Hz[on])[:, None] - asked).argmin(axis=0)]
            found.append(np.log(_ratios(off, self.points, nearest)))
        both = np.stack(found, axis=2).reshape(-1, len(asked) * len(self.masses))
        return np.concatenate([both.real, both.imag])

    def _program(self) -> ca.Function:
        variables = ca.MX.sym("variables", self.form.size + 2)
        own, inner, beta = ca.vertsplit(variables, [0, self.form.size, self.form.size + 1, self.form.size + 2])
        table, _ = self.form.coefficients(own)
        inside, stiffer = ca.MX.sym("inside"), ca.MX.sym("stiffer")
        data, found = [], []
        rows = 2 + 2 * (1 + 2 * len(self.form.sensors))
        # How many points are enforced must not change: as many as ever count.
        counts = dict(zip(LIMITED, np.where(counting(self.points, self.goal), 0.0, np.inf), strict=True))
        for kind, worst in _WORST.items():
            size = len(_chosen(counts[kind], worst))
            given = ca.MX.sym(f"data_{kind}", rows, size)
            data.append(given)
            if not size:
                continue
            point = _point(table.shape, kind, log(goal_limits(self.goal)[kind])).map(size)
            found.append(point(ca.repmat(ca.vec(table), 1, size), ca.repmat(inner, 1, size), given).T - inside)
        n = len(_SHARES) * len(self.masses)
        masses = ca.DM(np.tile(self.masses, len(_SHARES))).T
        frequencies = ca.exp(beta) * ca.DM(np.repeat(_SHARES, len(self.masses))).T
        for k, (plant, factor, _) in enumerate(self.plants):
            data.append(ca.MX.sym(f"moved_{k}", 2 * (1 + 2 * len(self.form.sensors)), n))
            stiffness = _stiffness(table.shape, plant, factor).map(n)
            asked = (ca.repmat(ca.vec(table), 1, n), ca.repmat(inner, 1, n), masses, frequencies, data[-1])
            found.append(stiffness(*asked).T + log(self.goal.compliance_m_per_N) - stiffer)
        return ca.nlpsol(
            "refinement",
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


def _data(at: Samples, index: np.ndarray) -> np.ndarray:
    """What `_point` reads of some points, (rows, count)."""
    values = np.concatenate([at.denominator[index][None], *(control[:, index] for control in at.control)])
    plain = np.array([2 * pi * at.frequency_Hz[index], at.relaxed[index]])
    return np.concatenate([plain, values.real, values.imag])


def _ratios(off: Samples, nominal: Samples, index: np.ndarray) -> np.ndarray:
    """(r, n) responses of rigs that are off over the nominal ones; one where nothing responds."""

    def listed(at: Samples) -> np.ndarray:
        return np.concatenate([at.control[:, 0, index], at.disturbance[:1, index], at.crossed[:, 0, index]])

    here = listed(nominal)
    return np.divide(listed(off), here, out=np.ones_like(here), where=here != 0)


def _chosen(slack: np.ndarray, worst: int) -> np.ndarray:
    """Indices of every so manieth finite slack and of the worst of the others."""
    finite = np.nonzero(np.isfinite(slack))[0]
    even = finite[::_EVERY]
    rest = np.setdiff1d(finite, even)
    return np.concatenate([even, rest[np.argsort(slack[rest], kind="stable")[:worst]]])


def _law(coefficients: ca.SX, w: ca.SX) -> tuple[list[Pair], Pair]:
    """Numerators of a law and their denominator at j w."""
    *above, below = (on_axis(ca.horzsplit(row), w / UNIT) for row in ca.vertsplit(coefficients))
    return above, below


def _point(shape: tuple[int, int], kind: Kind, limit: float) -> ca.Function:
    """Slack of a limit (its logarithm) at one point, from the law's coefficients, mass and data."""
    coefficients = ca.SX.sym("coefficients", *shape)
    half = 2 * shape[0] - 1
    inner, data = ca.SX.sym("inner"), ca.SX.sym("data", 2 + 2 * half)
    values: list[Pair] = [(data[2 + k], data[2 + half + k]) for k in range(half)]
    plant: Pair = (1 + inner * values[0][0], inner * values[0][1])
    control = [
        (bare[0] + inner * added[0], bare[1] + inner * added[1])
        for bare, added in zip(values[1::2], values[2::2], strict=True)
    ]
    slack = slack_of(kind, _law(coefficients, data[0]), plant, control) + limit + ca.log(data[1])
    return ca.Function("point", [ca.vec(coefficients), inner, data], [slack])


def _stiffness(shape: tuple[int, int], plant: BilinearPlant, factor: float) -> ca.Function:
    """log(|F_d / x|) from the law's coefficients, masses inside and outside (kg), frequency (Hz) and moves."""
    coefficients = ca.SX.sym("coefficients", *shape)
    p = shape[0] - 1
    inner, outer, frequency = (ca.SX.sym(name) for name in ("inner", "outer", "frequency"))
    moves, w = ca.SX.sym("moves", 2 * (1 + 2 * p)), 2 * pi * frequency

    def at(*weighted: tuple[ca.SX | float, fmpq_poly]) -> Pair:
        return on_axis(added_up((by, [nearest(c) for c in polynomial.coeffs()]) for by, polynomial in weighted), w)

    def moved(k: int, value: Pair) -> Pair:
        size, turn = ca.exp(moves[k]), moves[1 + 2 * p + k]
        return product(value, (size * ca.cos(turn), size * ca.sin(turn)))

    def over_both(rows: tuple[PairOver, PairOver], by: float = 1.0) -> Pair:
        (own, within), (slope, both) = rows
        return at((by, own), (by * inner, within), (by * outer, slope), (by * outer * inner, both))

    slack = slack_of(
        "compliance",
        _law(coefficients, w),
        over_both(plant.denominator),
        [moved(k, over_both(rows, factor)) for k, rows in enumerate(plant.control)],
        moved(p, at((1.0, plant.disturbance[0]), (inner, plant.disturbance[1]))),
        [moved(p + 1 + k, at((factor, own), (factor * inner, added))) for k, (own, added) in enumerate(plant.crossed)],
    )
    return ca.Function("stiffness", [ca.vec(coefficients), inner, outer, frequency, moves], [slack])
