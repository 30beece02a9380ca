"""Slacks of a loop at one point as functions of its law and masses, of which programs of refinement are made."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, pi
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq_poly

from beamdesign.plant.linear import BilinearPlant, PairOver
from beamdesign.proofs.certificate import Kind
from beamdesign.rational import nearest
from beamdesign.synthesis.loop_limits import Pair, added_up, law_on_axis, on_axis, slack_of

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

    def functions(self, shared: int, coefficients: int) -> tuple[ca.Function, ca.Function, ca.Function]:
        """Slack, slope and, by weights, sums of slopes and curvatures, over what all points share, see below."""
        y, own, weight = ca.SX.sym("y", shared), ca.SX.sym("own", self.given.shape[0]), ca.SX.sym("weight")
        law, inner, figures, beta = ca.vertsplit(y, [0, coefficients, coefficients + 1, shared - 1, shared])
        if self.slack.n_in() == 4:
            slack = self.slack(law, inner, figures, own)
        else:
            frequency = own[0] * ca.exp(beta) if self.of_bandwidth else own[0]
            slack = self.slack(law, inner, figures * own[2:], own[1], frequency)
        curvature, slope = ca.hessian(slack, y)
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
    found, slopes, pull, bent = [], [], ca.MX(y.shape[0], 1), ca.MX(y.shape[0], y.shape[0])
    plain = lam_f * objective
    for block in blocks:
        value, slope, curved = block.functions(y.shape[0], coefficients)
        n = block.given.shape[1]
        weights.append(ca.MX.sym("weights", n))
        found.append(value(y, block.given).T + block.more + block.limit)
        slopes.append(slope(y, block.given).T @ to_x + ca.repmat(ca.jacobian(block.limit, x), n, 1))
        pulled, bending = curved(y, block.given, weights[-1].T)
        pull, bent, plain = pull + pulled, bent + bending, plain + ca.sum1(weights[-1]) * block.limit
    weights.append(ca.MX.sym("weights", rest.shape[0]))
    along, lam_g = ca.MX.sym("along", y.shape[0]), ca.vertcat(*weights)
    plain, _ = ca.hessian(plain + ca.dot(weights[-1], rest) + ca.dot(along, y), x)
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
