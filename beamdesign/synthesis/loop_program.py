"""What a law leaves of a limit at one point, as functions of the law and of masses, and programs made of them.

The loops are those of all linear members of a rig. Everything here is sampled and only proposes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from math import log, pi
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq_poly

from beamdesign.controllers.protocol import UNIT
from beamdesign.plant.linear import UNUSED, BilinearPlant, PairOver
from beamdesign.plant.linearised import linear_assembly, transfer_polynomials
from beamdesign.plant.rigs import figures_of
from beamdesign.polynomial import nearest
from beamdesign.proofs.certificate import Kind

Pair = tuple[ca.SX, ca.SX]
"""Real and imaginary part."""

_TINY = 1e-300
_NOTHING: Pair = (ca.SX(0), ca.SX(0))


def on_axis(coefficients: Sequence[Any], w: ca.SX) -> Pair:
    """A polynomial, its coefficients ascending, at j w."""
    parts, power = [ca.SX(0), ca.SX(0)], ca.SX(1)
    for k, coefficient in enumerate(coefficients):
        term = coefficient * power
        parts[k % 2] += -term if k % 4 >= 2 else term
        power = power * w
    return parts[0], parts[1]


def product(left: Pair, right: Pair) -> Pair:
    """Of two complex numbers."""
    return left[0] * right[0] - left[1] * right[1], left[0] * right[1] + left[1] * right[0]


def _sum(first: Pair, *others: Pair) -> Pair:
    return reduce(lambda one, two: (one[0] + two[0], one[1] + two[1]), others, first)


def _log_size(value: Pair) -> ca.SX:
    return ca.log(value[0] ** 2 + value[1] ** 2) / 2


def law_on_axis(coefficients: ca.SX, w: ca.SX) -> tuple[list[Pair], Pair]:
    """Numerators of a law and their denominator at j w."""
    *above, below = (on_axis(ca.horzsplit(row), w / UNIT) for row in ca.vertsplit(coefficients))
    return above, below


def slack_of(
    kind: Kind,
    law: tuple[Sequence[Pair], Pair],
    plant: Pair,
    control: Sequence[Pair],
    disturbance: Pair = _NOTHING,
    crossed: Sequence[Pair] = (),
) -> ca.SX:
    """Logarithm of 1 / |S|, |F_d / x|, 1 / |L|, 1 / |C S| or the least 1 / |S| of all lower gains at one frequency.

    To that the logarithm of the limit is added, which for the peak compliance is a multiple of |x / F_d| without law.

    Args:
        kind: of the limit.
        law: numerators of the law, one per sensor, and their denominator.
        plant: the plant's denominator.
        control: its numerators, as of `beamdesign.plant.linear.Plant`, one per sensor.
        disturbance: likewise; of the compliance alone.
        crossed: likewise.
    """
    above, below = law
    denominator = product(plant, below)
    numerator = _sum(*map(product, above, control))
    match kind:
        case "loop_gain":
            return _log_size(denominator) - _log_size(numerator)
        case "gain_margin":  # at the share of the gain that comes nearest to the critical point
            along = denominator[0] * numerator[0] + denominator[1] * numerator[1]
            share = ca.fmin(1, ca.fmax(0, -along / (numerator[0] ** 2 + numerator[1] ** 2 + _TINY)))
            return _log_size(_sum(denominator, (share * numerator[0], share * numerator[1]))) - _log_size(denominator)
        case "peak_sensitivity":
            over = _log_size(denominator)
        case "compliance" | "peak_compliance":
            over = _log_size(_sum(product(disturbance, below), *map(product, above, crossed)))
        case _:
            over = _log_size(plant) + _log_size(above[0])
    return _log_size(_sum(denominator, numerator)) - over


ONCE = {"cse": True}
"""Common parts of a function and of its derivatives are worked out once."""


def added_up(terms: Iterable[tuple[Any, Sequence[Any]]]) -> list[ca.SX]:
    """Coefficients of a sum of weighted polynomials, each given by its own."""
    listed = list(terms)
    length = max(len(polynomial) for _, polynomial in listed)
    return [sum((weight * p[k] for weight, p in listed if k < len(p)), ca.SX(0)) for k in range(length)]


def _over_frequency(
    shape: tuple[int, int],
    kind: Kind,
    symbols: tuple[Any, Any, Any],
    polynomials: tuple[Sequence[Any], Sequence[Sequence[Any]], Sequence[Any], Sequence[Sequence[Any]]],
    options: dict[str, bool],
) -> ca.Function:
    """Slack of a limit at one point of a plant, see `slack_of`.

    Inputs: the law's coefficients, mass inside (kg), lumped figures (d,), outer end mass (kg), frequency (Hz). The
    symbols are the three in the middle; the polynomials, of which they are made, denominator, control, disturbance and
    crossed numerators.
    """
    coefficients, frequency = ca.SX.sym("coefficients", *shape), ca.SX.sym("frequency")
    w, (plant, control, disturbance, crossed) = 2 * pi * frequency, polynomials
    each = on_axis(plant, w), [on_axis(one, w) for one in control], on_axis(disturbance, w)
    slack = slack_of(kind, law_on_axis(coefficients, w), *each, [on_axis(one, w) for one in crossed])
    return ca.Function("slack", [ca.vec(coefficients), *symbols, frequency], [slack], options)


@cache
def sized_slack(shape: tuple[int, int], kind: Kind, filtered: bool, rig: str) -> ca.Function:
    """That of a rig without effects, from the figures of its plant."""
    names = figures_of(rig)
    figures = ca.SX.sym("figures", len(names))
    given = UNUSED | dict(zip(names, ca.vertsplit(figures), strict=True))
    of = linear_assembly(filtered, (), rig)
    values = ca.vertcat(*(given[name] for name in of.parameters))
    minors = transfer_polynomials(of, ((), ((1, 1),), ((0, 0),)))
    found = [ca.vertsplit(part) for part in minors(values)]
    outer, inner = given["outer_end_mass"], given["inner_end_mass"]
    weights = (1, inner, outer, outer * inner)
    plant, control, disturbance = (added_up(zip(weights, found[k : k + 4], strict=True)) for k in (0, 4, 8))
    return _over_frequency(shape, kind, (inner, figures[:-2], outer), (plant, [control], disturbance, []), {})


def stiffness_of(shape: tuple[int, int], plant: BilinearPlant, factor: float) -> ca.Function:
    """log(|F_d / x|) likewise, of a plant that stands and a factor on its gain: of no figures."""
    inner, outer = ca.SX.sym("inner"), ca.SX.sym("outer")

    def added(*weighted: tuple[ca.SX | float, fmpq_poly]) -> list[ca.SX]:
        return added_up((by, [nearest(c) for c in polynomial.coeffs()]) for by, polynomial in weighted)

    def over_both(rows: tuple[PairOver, PairOver], by: float = 1.0) -> list[ca.SX]:
        (own, within), (slope, both) = rows
        return added((by, own), (by * inner, within), (by * outer, slope), (by * outer * inner, both))

    polynomials = (
        over_both(plant.denominator),
        [over_both(rows, factor) for rows in plant.control],
        added((1.0, plant.disturbance[0]), (inner, plant.disturbance[1])),
        [added((factor, own), (factor * inner, within)) for own, within in plant.crossed],
    )
    return _over_frequency(shape, "compliance", (inner, ca.SX(0, 1), outer), polynomials, ONCE)


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


_RESONANCES = np.linspace(log(0.3), log(300.0), 700)
"""Logarithms of frequencies (Hz) among which one is sought, of a rig as quick as the published one."""


def highest(servo_off: ca.Function, variables: np.ndarray, pace: float) -> tuple[float, float]:
    """Logarithm of the frequency (Hz), last of the variables, at which a function of all of them is largest, and that.

    Args:
        servo_off: of the variables of a program: those given, then one that does not count, then this.
        variables: (v,) those given.
        pace: how quick the rig is.
    """
    at, step = _RESONANCES + log(pace), float(_RESONANCES[1] - _RESONANCES[0])
    for _ in range(4):
        values = np.asarray(servo_off(np.vstack([np.repeat(variables[:, None], len(at), 1), 0 * at, at]))).ravel()
        best = float(at[values.argmax()])
        at, step = best + step * np.linspace(-1, 1, 41), step / 20
    return best, float(values.max())


@dataclass(frozen=True)
class Block:
    """Constraints of a program: one slack at points side by side, not negative.

    Attributes:
        slack: as of `point`, or as of `stiffness_of`.
        given: (rows, n) what each point has of its own: the data, or frequency (Hz), outer end mass (kg) and factors on
            the mass inside and on the figures.
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
            slack = self.slack(law, inner * own[2], figures * own[3:], own[1], frequency)
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
    constraints, jacobian = ca.vertcat(*found, rest), ca.vertcat(*slopes, ca.jacobian(rest, x))
    given = {"x": x, "p": parameters}
    weighted = given | {"lam_f": lam_f, "lam_g": lam_g}
    derivatives = {
        "jac_g": ca.Function("jac_g", [*given.values()], [constraints, jacobian], [*given], ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", [*weighted.values()], [bent], [*weighted], ["triu_hess_gamma_x_x"]),
    }
    return given | {"f": objective, "g": constraints}, derivatives
