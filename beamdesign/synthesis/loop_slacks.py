"""What a law leaves of every limit at the points of sampled loops: numbers, the rigs that leave least, and programs.

The variables are those of a law's form, then the inner end mass in kg. Everything here is sampled and only proposes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, pi
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq_poly

from beamdesign.controllers.form import Form
from beamdesign.plant.linear import BilinearPlant, PairOver
from beamdesign.proofs.certificate import Kind
from beamdesign.prototype import Goal
from beamdesign.rational import nearest
from beamdesign.synthesis.loop_limits import (
    LIMITED,
    RELAXED_PEAK,
    Pair,
    added_up,
    goal_limits,
    law_on_axis,
    on_axis,
    slack_of,
)
from beamdesign.synthesis.loop_samples import Samples


@dataclass(frozen=True)
class Slacks:
    """Logarithms by which a law keeps each limit at each point, and their derivatives by the variables.

    Attributes:
        values: (6, n) log of limit over |S|, |x / F_d|, |L|, |C S|, C from the displacement sensor's volts, the largest
            |S| of all lower gains, and |x / F_d| again, whose limit at every frequency is a multiple of the largest
            without a law of all points, as `LIMITED` lists them; infinite where a limit does not count.
        slopes: (6, n, v); none where none were asked for.
        settled: whether 1 + L winds about the origin on no row: the loop is stable as far as the samples tell, at lower
            gains where the goal wants it.
        servo_off_m_per_N: the largest |x / F_d| without a law of all points.
    """

    values: np.ndarray
    slopes: np.ndarray
    settled: bool
    servo_off_m_per_N: float

    @property
    def sensitivity(self) -> np.ndarray:
        """(n,) log of limit over |S|."""
        return np.asarray(self.values[0])

    @property
    def compliance(self) -> np.ndarray:
        """(n,) log of limit over |x / F_d|."""
        return np.asarray(self.values[1])

    def violation(self, inside: float = 0.0) -> float:
        """By how much the limits other than the compliance, to be kept with so much to spare, are missed at worst."""
        return max(0.0, inside - float(self.values[OTHERS].min()))


COMPLIANCE, OTHERS = 1, [0, 2, 3, 4, 5]
"""Places in `LIMITED`."""


def slacks(points: Samples, goal: Goal, form: Form, variables: np.ndarray, slopes: bool = True) -> Slacks:
    """What a law leaves of every limit at every point.

    Args:
        points: of the loops.
        goal: its limits; those that are None are kept by an infinite slack.
        form: of the law.
        variables: (v,) those of the form, then the mass inside, kg; more behind them does not count.
        slopes: whether to work out derivatives.
    """
    s, own_variables = 2j * pi * points.frequency_Hz, variables[: form.size]
    inner = float(variables[form.size])
    own = form.responses(own_variables, s)
    return slacks_of(points, goal, own, inner, form.slopes(own_variables, s) if slopes else None)


NONE = np.empty(0)


def counting(points: Samples, goal: Goal) -> np.ndarray:
    """(6, n) at which points each limit counts."""
    performs = points.relaxed == 1.0
    far, everywhere = performs & (points.frequency_Hz >= goal.loop_gain_from_Hz), np.full(len(performs), True)
    peaked = points.relaxed < RELAXED_PEAK
    where = np.array([everywhere, performs, far, performs, everywhere, peaked])
    return where & np.isin(LIMITED, list(goal_limits(goal)))[:, None]


def slacks_of(points: Samples, goal: Goal, own: np.ndarray, inner: float, of_own: np.ndarray | None = None) -> Slacks:
    """The same of a law whose responses are known.

    Args:
        points: of the loops.
        goal: its limits.
        own: (p, n) the law at the points.
        inner: mass inside, kg.
        of_own: (p, n, v) its derivatives by all variables but the mass; none for no slopes.
    """
    plant, control, disturbance, crossed = points.at(inner)
    moved = disturbance + (own * crossed).sum(axis=0)
    loop = (own * control).sum(axis=0)
    closed = np.log(np.abs(1 + loop))
    share = np.clip(-loop.real / np.maximum(np.abs(loop) ** 2, 1e-300), 0.0, 1.0)  # of the gain, with |1 + k L| least
    lower, limits = 1 + share * loop, goal_limits(goal)
    with np.errstate(divide="ignore"):
        compliance, effort = closed - np.log(np.abs(moved)), closed - np.log(np.abs(own[0]))
        softest = compliance + np.log(without := points.servo_off(inner))
        left = np.array([closed, compliance, -np.log(np.abs(loop)), effort, np.log(np.abs(lower)), softest])
    stated = np.log([limits.get(kind, 1.0) for kind in LIMITED])
    left = np.where(counting(points, goal), left + stated[:, None], np.inf)
    left[0] += np.log(points.relaxed)
    steps = np.diff(np.angle(1 + loop))
    steps = (steps + pi) % (2 * pi) - pi
    same = np.diff(points.row) == 0
    settled = bool((np.abs(np.bincount(points.row[1:][same], weights=steps[same])) < pi).all())
    if settled and goal.lower_gains:
        settled = not _passes_behind(loop[:-1][same], loop[1:][same]).any()
    if of_own is None:
        return Slacks(left, NONE, settled, without)
    shrinks = points.denominator / plant
    of_loop, of_moved = ((by[:, :, None] * of_own).sum(axis=0) for by in (control, crossed))
    by_mass = (own * points.control[:, 1]).sum(axis=0) / plant - loop * shrinks
    of_loop = np.column_stack([of_loop, by_mass])
    by_mass = (points.disturbance[1] + (own * points.crossed[:, 1]).sum(axis=0)) / plant - moved * shrinks
    of_moved = np.column_stack([of_moved, by_mass])
    of_closed = (of_loop / (1 + loop)[:, None]).real
    of_effort = of_closed.copy()
    of_effort[:, :-1] -= (of_own[0] / own[0][:, None]).real
    of_compliance, of_loop_gain = of_closed - (of_moved / moved[:, None]).real, -(of_loop / loop[:, None]).real
    of_lower = (share[:, None] * of_loop / lower[:, None]).real
    of_softest = of_compliance.copy()
    of_softest[:, -1] += log(points.servo_off(inner + _STEP_KG) / points.servo_off(inner - _STEP_KG)) / (2 * _STEP_KG)
    slopes = np.array([of_closed, of_compliance, of_loop_gain, of_effort, of_lower, of_softest])
    return Slacks(left, slopes, settled, without)


_STEP_KG = 1e-4
"""Of the mass inside, for the slope of what its largest compliance is without a law."""


def _passes_behind(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Whether the chords between points of a loop cross the real axis to the left of -1."""
    crosses = (start.imag < 0) != (end.imag < 0)
    at = start.real * end.imag - end.real * start.imag
    return np.asarray(crosses & (at / np.where(crosses, end.imag - start.imag, 1.0) < -1))


def sampled_bandwidth(points: Samples, compliance: np.ndarray) -> float:
    """Least frequency (Hz), interpolated, from which some row misses the compliance; 0 where one misses it at once."""
    rows = (points.row == row for row in np.unique(points.row))
    reached = (first_miss(points.frequency_Hz[on], compliance[on]) for on in rows)
    return min(*reached, float(points.frequency_Hz.max()), np.inf)


def first_miss(frequency_Hz: np.ndarray, slack: np.ndarray) -> float:
    """From where a slack is negative, interpolated, Hz; 0 where it is at once, infinite where it never is."""
    k = int(np.argmax(slack < 0))
    if slack[k] >= 0 or k == 0:
        return np.inf if slack[k] >= 0 else 0.0
    share = slack[k - 1] / (slack[k - 1] - slack[k])
    return float(frequency_Hz[k - 1] * (frequency_Hz[k] / frequency_Hz[k - 1]) ** share)


# The same at one point as functions of a law and masses, of which programs of refinement are made.

ONCE = {"cse": True}
"""Common parts of a function and of its derivatives are worked out once."""

_RESONANCES = np.linspace(log(0.3), log(300.0), 700)
"""Logarithms of frequencies (Hz) among which one is sought."""


def highest(servo_off: ca.Function, variables: np.ndarray) -> tuple[float, float]:
    """Logarithm of the frequency (Hz), last of the variables, at which a function of all of them is largest, and that.

    Args:
        servo_off: of the variables of a program: those given, then one that does not count, then this.
        variables: (v,) those given.
    """
    at, step = _RESONANCES, float(_RESONANCES[1] - _RESONANCES[0])
    for _ in range(4):
        values = np.asarray(servo_off(np.vstack([np.repeat(variables[:, None], len(at), 1), 0 * at, at]))).ravel()
        best = float(at[values.argmax()])
        at, step = best + step * np.linspace(-1, 1, 41), step / 20
    return best, float(values.max())


def point(shape: tuple[int, int], kind: Kind) -> ca.Function:
    """Slack of a limit at one point, see `slack_of`, from the law's coefficients, mass inside, nothing, and data."""
    coefficients = ca.SX.sym("coefficients", *shape)
    sensors = shape[0] - 1
    half = 4 * sensors + 3
    inner, data = ca.SX.sym("inner"), ca.SX.sym("data", 2 + 2 * half)
    values: list[Pair] = [(data[2 + k], data[2 + half + k]) for k in range(half)]
    plant: Pair = (1 + inner * values[0][0], inner * values[0][1])
    pairs = [
        (bare[0] + inner * added[0], bare[1] + inner * added[1])
        for bare, added in zip(values[1::2], values[2::2], strict=True)
    ]
    control, (disturbance, *crossed) = pairs[:sensors], pairs[sensors:]
    slack = slack_of(kind, law_on_axis(coefficients, data[0]), plant, control, disturbance, crossed) + ca.log(data[1])
    return ca.Function("point", [ca.vec(coefficients), inner, ca.SX(0, 1), data], [slack], ONCE)


def stiffness_of(shape: tuple[int, int], plant: BilinearPlant, factor: float) -> ca.Function:
    """log(|F_d / x|) from the law's coefficients, masses inside and outside (kg) and frequency (Hz)."""
    coefficients = ca.SX.sym("coefficients", *shape)
    inner, outer, frequency = (ca.SX.sym(name) for name in ("inner", "outer", "frequency"))
    w = 2 * pi * frequency

    def at(*weighted: tuple[ca.SX | float, fmpq_poly]) -> Pair:
        return on_axis(added_up((by, [nearest(c) for c in polynomial.coeffs()]) for by, polynomial in weighted), w)

    def over_both(rows: tuple[PairOver, PairOver], by: float = 1.0) -> Pair:
        (own, within), (slope, both) = rows
        return at((by, own), (by * inner, within), (by * outer, slope), (by * outer * inner, both))

    slack = slack_of(
        "compliance",
        law_on_axis(coefficients, w),
        over_both(plant.denominator),
        [over_both(rows, factor) for rows in plant.control],
        at((1.0, plant.disturbance[0]), (inner, plant.disturbance[1])),
        [at((factor, own), (factor * inner, added)) for own, added in plant.crossed],
    )
    return ca.Function("stiffness", [ca.vec(coefficients), inner, ca.SX(0, 1), outer, frequency], [slack], ONCE)


@dataclass(frozen=True)
class Block:
    """Constraints of a program: one slack at points side by side, not negative.

    Attributes:
        slack: as of `point`, or as of `stiffness_of`.
        given: (rows, n) what each point has of its own: the data, or frequency (Hz), outer end mass (kg) and factors on
            the figures.
        limit: what is added to all of them.
        more: what is added to each, (n,).
        of_bandwidth: whether instead of frequencies there are shares of the bandwidth.
    """

    slack: ca.Function
    given: Any
    limit: ca.MX
    more: Any = 0.0
    of_bandwidth: bool = False

    def functions(
        self, shared: int, coefficients: int, moving: list[int]
    ) -> tuple[ca.Function, ca.Function, ca.Function]:
        """Slack, slope and, by weights, sums of slopes and curvatures, over what moves of all that points share."""
        y, own, weight = ca.SX.sym("y", shared), ca.SX.sym("own", self.given.shape[0]), ca.SX.sym("weight")
        law, inner, figures, beta = ca.vertsplit(y, [0, coefficients, coefficients + 1, shared - 1, shared])
        if self.slack.n_in() == 4:
            slack = self.slack(law, inner, figures, own)
        else:
            frequency = own[0] * ca.exp(beta) if self.of_bandwidth else own[0]
            slack = self.slack(law, inner, figures * own[2:], own[1], frequency)
        curvature, slope = ca.hessian(slack, y[moving])
        n, outputs = self.given.shape[1], [weight * slope, weight * ca.triu(curvature)]
        curved = ca.Function("curved", [y, own, weight], outputs, ONCE).map("curves", "serial", n, [0], [0, 1])
        value, sloping = (ca.Function("one", [y, own], [found], ONCE) for found in (slack, slope))
        return value.map("values", "serial", n, [0], []), sloping.map("slopes", "serial", n, [0], []), curved


def sampled_program(
    x: ca.MX, parameters: ca.MX, objective: ca.MX, y: ca.MX, coefficients: int, blocks: Sequence[Block], rest: ca.MX
) -> tuple[dict[str, ca.MX], dict[str, ca.Function]]:
    """A program, and first and second derivatives of its constraints, put together from those at single points.

    CasADi by itself goes once through all points for every direction, which takes several times as long.

    Args:
        x: variables.
        parameters: other symbols.
        objective: to be least.
        y: what all points share: the law's coefficients, mass inside (kg), figures, logarithm of the bandwidth (Hz).
        coefficients: how many of these there are.
        blocks: constraints at points.
        rest: other constraints, not to be negative.
    """
    to_x, lam_f, weights = ca.jacobian(y, x), ca.MX.sym("lam_f"), list[ca.MX]()
    moving = sorted(set(to_x.sparsity().row()))  # the others are the same whatever the variables are
    to_x, size = to_x[moving, :], len(moving)
    found, slopes, pull, bent = [], [], ca.MX(size, 1), ca.MX(size, size)
    plain = lam_f * objective
    for block in blocks:
        value, slope, curved = block.functions(y.shape[0], coefficients, moving)
        n = block.given.shape[1]
        weights.append(ca.MX.sym("weights", n))
        found.append(value(y, block.given).T + block.more + block.limit)
        slopes.append(slope(y, block.given).T @ to_x + ca.repmat(ca.jacobian(block.limit, x), n, 1))
        pulled, bending = curved(y, block.given, weights[-1].T)
        pull, bent, plain = pull + pulled, bent + bending, plain + ca.sum1(weights[-1]) * block.limit
    weights.append(ca.MX.sym("weights", rest.shape[0]))
    along, lam_g = ca.MX.sym("along", size), ca.vertcat(*weights)
    plain, _ = ca.hessian(plain + ca.dot(weights[-1], rest) + ca.dot(along, y[moving]), x)
    own = ca.Function("own", [x, parameters, along, lam_f, lam_g], [plain])
    bent = ca.triu(to_x.T @ ca.triu2symm(bent) @ to_x + own(x, parameters, pull, lam_f, lam_g))
    constraints = ca.vertcat(*found, rest)
    derivatives = {
        "jac_g": ca.Function(
            "jac_g",
            [x, parameters],
            [constraints, ca.vertcat(*slopes, ca.jacobian(rest, x))],
            ["x", "p"],
            ["g", "jac_g_x"],
        ),
        "hess_lag": ca.Function(
            "hess_lag", [x, parameters, lam_f, lam_g], [bent], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
    }
    return {"x": x, "p": parameters, "f": objective, "g": constraints}, derivatives
