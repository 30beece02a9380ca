"""The guarantee at chosen frequencies and masses as smooth CasADi constraints."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import pi
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.controllers.form import UNIT, Form
from beamdesign.linear import UNUSED
from beamdesign.proof.certificate import Kind
from beamdesign.prototype import Goal
from beamdesign.rig.beams_rig import FIGURES
from beamdesign.rig.linearised import linear_assembly, transfer_polynomials


@dataclass(frozen=True)
class CheckPoints:
    """Where an optimiser enforces the guarantee: finitely many points, enlarged by whatever a proof refutes.

    Attributes:
        sensitivity: (n, 2) frequency in Hz and outer end mass in kg.
        compliance: (k, 2) frequency as a share of the bandwidth, and outer end mass in kg.
        loop_gain: (l, 2) as for the sensitivity; none where the goal sets no limit.
        controller_effort: (e, 2) likewise.
    """

    sensitivity: np.ndarray
    compliance: np.ndarray
    loop_gain: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    controller_effort: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def with_sensitivity(self, frequency_Hz: float, mass: float) -> "CheckPoints":
        """Also enforce the peak sensitivity at a peak and beside it, where a sharp peak may move to."""
        new = [[frequency_Hz * factor, mass] for factor in _BESIDE]
        return replace(self, sensitivity=np.vstack([self.sensitivity, new]))

    def with_magnitude(self, kind: Kind, frequency_Hz: float, mass: float, from_Hz: float) -> "CheckPoints":
        """Also enforce peak sensitivity, loop gain (from a frequency up) or effort at a peak and beside it."""
        if kind == "peak_sensitivity":
            return self.with_sensitivity(frequency_Hz, mass)
        least = from_Hz if kind == "loop_gain" else 0.0
        new = [[max(frequency_Hz * factor, least), mass] for factor in _BESIDE]
        if kind == "loop_gain":
            return replace(self, loop_gain=np.vstack([self.loop_gain, new]))
        return replace(self, controller_effort=np.vstack([self.controller_effort, new]))

    def with_compliance(self, share: float, masses: np.ndarray) -> "CheckPoints":
        """Also enforce the compliance at a share of the bandwidth, for all of the masses."""
        new = [[min(share, 1.0), mass] for mass in masses]
        return replace(self, compliance=np.vstack([self.compliance, new]))


def check_points(low: float, high: float, frequencies: int = 48, goal: Goal | None = None) -> CheckPoints:
    """Points to begin with: both ends of the mass range, frequencies from 2 to 300 Hz; proofs add the others.

    A goal that limits loop gain or effort adds points of these.
    """
    masses = np.unique([low, high])
    frequency = np.geomspace(2.0, 300.0, frequencies)
    share = np.array([0.02, 0.5, 0.8, 1.0])

    def pairs(values: np.ndarray) -> np.ndarray:
        return np.array([(value, mass) for mass in masses for value in values])

    points = CheckPoints(pairs(frequency), pairs(share))
    if goal is None:
        return points
    if goal.loop_gain is not None:
        points = replace(points, loop_gain=pairs(goal.loop_gain_from_Hz * np.geomspace(1.0, _FAR, 12)))
    if goal.controller_effort_A_per_V is not None:
        points = replace(points, controller_effort=pairs(np.append(np.geomspace(2.0, 1000.0, 40), 1e5)))
    return points


_BESIDE = (0.99, 0.997, 1.0, 1.003, 1.01)
_FAR = 10.0
"""Up to how many times the frequency at which its limit begins the loop gain is enforced to begin with."""


Pair = tuple[ca.SX, ca.SX]
"""Real and imaginary part."""


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


def log_size(value: Pair) -> ca.SX:
    """Logarithm of the size of a complex number."""
    return ca.log(value[0] ** 2 + value[1] ** 2) / 2


@cache
def loop_slack(form: Form, filtered: bool) -> ca.Function:
    """Slacks of the two limits at one frequency and one pair of end masses.

    Inputs: figures (16, as `FIGURES`, end masses included), variables of the form, frequency in Hz.
    Outputs: log(|p| / |opened|), which peak sensitivity Ms bounds below by -log(Ms), and log(|p| / |disturbance|),
    which a compliance limit c bounds below by -log(c).
    """
    return _slack(form, *_without_effects(filtered))


@cache
def limit_slack(form: Form, filtered: bool) -> ca.Function:
    """Slacks of the limits on the controller's reach, with the inputs of `loop_slack`.

    Outputs: log(1 / |L|) and log(1 / |C S|), V/A.
    """
    return _slack(form, *_without_effects(filtered), limits=True)


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


def _slack(form: Form, figures: ca.SX, polynomials: list[list[ca.SX]], limits: bool = False) -> ca.Function:
    """The slacks from a plant's denominator, control and disturbance polynomials in terms of the figures."""
    variables, frequency = ca.SX.sym("controller", form.size), ca.SX.sym("frequency")
    w = 2 * pi * frequency
    plant, control, disturbance = (on_axis(p, w) for p in polynomials)
    (above,), below = form.polynomials(ca.vertsplit(variables))
    numerator, denominator = (on_axis(part, w / UNIT) for part in (above, below))
    opened, returned = product(plant, denominator), product(control, numerator)
    closed = log_size((opened[0] + returned[0], opened[1] + returned[1]))
    given = [figures, variables, frequency]
    if limits:
        demanded = log_size(numerator) + log_size(plant)
        return ca.Function("limit_slack", given, [log_size(opened) - log_size(returned), closed - demanded])
    force_path = product(disturbance, denominator)
    return ca.Function("loop_slack", given, [closed - log_size(opened), closed - log_size(force_path)])


def guarantee(
    slack: ca.Function,
    figures: ca.MX,
    inner_end_mass: ca.MX,
    logarithms: ca.MX,
    log_bandwidth: ca.MX,
    sensitivity_points: ca.MX,
    compliance_points: ca.MX,
) -> tuple[ca.MX, ca.MX]:
    """Slacks at all check points, as expressions of the design variables.

    Args:
        slack: `loop_slack`.
        figures: its figures less the end masses.
        inner_end_mass: kg.
        logarithms: variables of the controller's form.
        log_bandwidth: of the bandwidth in Hz.
        sensitivity_points: (n, 2) as in `CheckPoints`.
        compliance_points: (k, 2) likewise.

    Returns:
        log(1 / |S|), one per sensitivity point, and log(|F_d / x|), one per compliance point.
    """
    at = _at(slack, figures, inner_end_mass, logarithms)
    sensitivity, _ = at(sensitivity_points[:, 0].T, sensitivity_points[:, 1].T)
    _, stiffness = at(ca.exp(log_bandwidth) * compliance_points[:, 0].T, compliance_points[:, 1].T)
    return sensitivity.T, stiffness.T


def reach(
    slack: ca.Function,
    figures: ca.MX,
    inner_end_mass: ca.MX,
    logarithms: ca.MX,
    loop_gain_points: ca.MX,
    effort_points: ca.MX,
) -> tuple[ca.MX, ca.MX]:
    """Slacks of `limit_slack` at its check points: log(1 / |L|) and log(1 / |C S|); arguments as of `guarantee`."""
    at = _at(slack, figures, inner_end_mass, logarithms)
    loop_gain, _ = at(loop_gain_points[:, 0].T, loop_gain_points[:, 1].T)
    _, effort = at(effort_points[:, 0].T, effort_points[:, 1].T)
    return loop_gain.T, effort.T


def _at(
    slack: ca.Function, figures: ca.MX, inner_end_mass: ca.MX, logarithms: ca.MX
) -> Callable[[ca.MX, ca.MX], list[ca.MX]]:
    """The slacks at frequencies (1, n) and outer end masses (1, n)."""

    def at(frequency: ca.MX, masses: ca.MX) -> list[ca.MX]:
        n = masses.shape[1]
        if n == 0:
            return [ca.MX(1, 0), ca.MX(1, 0)]
        everything = ca.vertcat(ca.repmat(figures, 1, n), masses, ca.repmat(inner_end_mass, 1, n))
        return list(slack.map(n)(everything, ca.repmat(logarithms, 1, n), frequency))

    return at
