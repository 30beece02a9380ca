"""What a loop leaves of each limit at chosen frequencies and masses, as smooth CasADi expressions."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache, reduce
from math import pi
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.controllers.form import UNIT, Form
from beamdesign.design.loop_set import goal_limits
from beamdesign.linear import UNUSED
from beamdesign.proof.certificate import Kind
from beamdesign.prototype import Goal
from beamdesign.rig.beams_rig import FIGURES
from beamdesign.rig.linearised import linear_assembly, transfer_polynomials

CheckPoints = Mapping[Kind, np.ndarray]
"""Where an optimiser enforces each limit of a goal, enlarged by what a proof refutes: (n, 2) frequency in Hz, of the
compliance as a share of the bandwidth, and outer end mass in kg."""


def check_points(low: float, high: float, goal: Goal, frequencies: int = 48) -> CheckPoints:
    """Points to begin with: both ends of the mass range (kg), frequencies from 2 to 300 Hz; proofs add the others."""
    begun: dict[Kind, np.ndarray] = {
        "peak_sensitivity": np.geomspace(2.0, 300.0, frequencies),
        "compliance": np.array([0.02, 0.5, 0.8, 1.0]),
        "loop_gain": goal.loop_gain_from_Hz * np.geomspace(1.0, _FAR, 12),
        "controller_effort": np.append(np.geomspace(2.0, 1000.0, 40), 1e5),
    }
    masses = np.unique([low, high])
    return {kind: np.array([(value, mass) for mass in masses for value in begun[kind]]) for kind in goal_limits(goal)}


_BESIDE = np.array([0.99, 0.997, 1.0, 1.003, 1.01])
_FAR = 10.0
"""Up to how many times the frequency at which its limit begins the loop gain is enforced to begin with."""


def with_peak(points: CheckPoints, kind: Kind, frequency_Hz: float, mass: float, from_Hz: float = 0.0) -> CheckPoints:
    """Also enforce a limit (from a frequency up) at a peak and beside it, where a sharp peak may move to."""
    return _enlarged(points, kind, np.maximum(frequency_Hz * _BESIDE, from_Hz), np.array([mass]))


def with_share(points: CheckPoints, share: float, masses: np.ndarray) -> CheckPoints:
    """Also enforce the compliance at a share of the bandwidth, for all of the masses."""
    return _enlarged(points, "compliance", np.array([min(share, 1.0)]), masses)


def _enlarged(points: CheckPoints, kind: Kind, values: np.ndarray, masses: np.ndarray) -> CheckPoints:
    return {**points, kind: np.vstack([points[kind], np.column_stack(np.broadcast_arrays(values, masses))])}


Pair = tuple[ca.SX, ca.SX]
"""Real and imaginary part."""

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


def slack_of(
    kind: Kind,
    law: tuple[Sequence[Pair], Pair],
    plant: Pair,
    control: Sequence[Pair],
    disturbance: Pair = _NOTHING,
    crossed: Sequence[Pair] = (),
) -> ca.SX:
    """Logarithm of 1 / |S|, |F_d / x|, 1 / |L| or 1 / |C S| at one frequency, to which that of the limit is added.

    Args:
        kind: of the limit.
        law: numerators of the law, one per sensor, and their denominator.
        plant: the plant's denominator.
        control: its numerators, as of `beamdesign.linear.Plant`, one per sensor.
        disturbance: likewise; of the compliance alone.
        crossed: likewise.
    """
    above, below = law
    opened = product(plant, below)
    returned = _sum(*map(product, above, control))
    match kind:
        case "loop_gain":
            return _log_size(opened) - _log_size(returned)
        case "peak_sensitivity":
            over = _log_size(opened)
        case "compliance":
            over = _log_size(_sum(product(disturbance, below), *map(product, above, crossed)))
        case _:
            over = _log_size(plant) + _log_size(above[0])
    return _log_size(_sum(opened, returned)) - over


@cache
def loop_slack(form: Form, filtered: bool, kind: Kind) -> ca.Function:
    """The slack of a limit at one frequency and one pair of end masses, see `slack_of`, of a rig without effects.

    Inputs: figures (16, as `FIGURES`, end masses included), variables of the form, frequency in Hz.
    """
    figures, polynomials = _without_effects(filtered)
    variables, frequency = ca.SX.sym("controller", form.size), ca.SX.sym("frequency")
    above, below = form.polynomials(ca.vertsplit(variables))
    w = 2 * pi * frequency
    plant, control, disturbance = (on_axis(p, w) for p in polynomials)
    law = [on_axis(p, w / UNIT) for p in above], on_axis(below, w / UNIT)
    slack = slack_of(kind, law, plant, [control], disturbance)
    return ca.Function("loop_slack", [figures, variables, frequency], [slack])


def _without_effects(filtered: bool) -> tuple[ca.SX, list[list[ca.SX]]]:
    """Symbols of `FIGURES`, and the plant's denominator, control and disturbance polynomials in terms of them."""
    figures = ca.SX.sym("figures", len(FIGURES))
    given = UNUSED | dict(zip(FIGURES, ca.vertsplit(figures), strict=True))
    values = ca.vertcat(*(given[name] for name in linear_assembly(filtered, ()).parameters))
    found = [ca.vertsplit(part) for part in transfer_polynomials(filtered, (), ((), ((1, 1),), ((0, 0),)))(values)]
    outer, inner = given["outer_end_mass"], given["inner_end_mass"]
    weights = (1, inner, outer, outer * inner)
    return figures, [added_up(zip(weights, found[k : k + 4], strict=True)) for k in (0, 4, 8)]


def added_up(terms: Iterable[tuple[Any, Sequence[Any]]]) -> list[ca.SX]:
    """Coefficients of a sum of weighted polynomials, each given by its own."""
    listed = list(terms)
    length = max(len(polynomial) for _, polynomial in listed)
    return [sum((weight * p[k] for weight, p in listed if k < len(p)), ca.SX(0)) for k in range(length)]


def guarantee(
    slack: ca.Function, figures: ca.MX, inner_end_mass: ca.MX, logarithms: ca.MX, frequency: ca.MX, masses: ca.MX
) -> ca.MX:
    """Slacks at all check points of a limit, as expressions of the design variables, (n, 1).

    Args:
        slack: `loop_slack`.
        figures: its figures less the end masses.
        inner_end_mass: kg.
        logarithms: variables of the controller's form.
        frequency: (n, 1) Hz.
        masses: (n, 1) outer end masses, kg.
    """
    n = masses.shape[0]
    everything = ca.vertcat(ca.repmat(figures, 1, n), masses.T, ca.repmat(inner_end_mass, 1, n))
    return slack.map(n)(everything, ca.repmat(logarithms, 1, n), frequency.T).T
