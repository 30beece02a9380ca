"""Slacks of a loop at one point as functions of its law and masses, of which programs of refinement are made."""

from math import log, pi

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
