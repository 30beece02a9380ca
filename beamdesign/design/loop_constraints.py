"""The guarantee at chosen frequencies and masses as smooth CasADi constraints."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import pi
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq_poly

from beamdesign.design.controller_forms import form_named
from beamdesign.linear import UNUSED, BilinearPlant
from beamdesign.proof.performance import Kind
from beamdesign.proof.rational import nearest
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


def _on_axis(coefficients: list[ca.SX], frequency: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Real and imaginary part of a polynomial at j w."""
    parts = [ca.SX(0), ca.SX(0)]
    for power, coefficient in enumerate(coefficients):
        term = coefficient * frequency**power
        parts[power % 2] += -term if power % 4 >= 2 else term
    return parts[0], parts[1]


def _product(left: tuple[ca.SX, ca.SX], right: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
    return left[0] * right[0] - left[1] * right[1], left[0] * right[1] + left[1] * right[0]


@cache
def loop_slack(kind: str, filtered: bool) -> ca.Function:
    """Slacks of the two limits at one frequency and one pair of end masses.

    Inputs: figures (16, as `FIGURES`, end masses included), logarithms of the controller's parameters, frequency in Hz.
    Outputs: log(|p| / |opened|), which peak sensitivity Ms bounds below by -log(Ms), and log(|p| / |disturbance|),
    which a compliance limit c bounds below by -log(c).
    """
    return _slack(kind, *_without_effects(filtered))


@cache
def limit_slack(kind: str, filtered: bool) -> ca.Function:
    """Slacks of the limits on the controller's reach, with the inputs of `loop_slack`.

    Outputs: log(1 / |L|) and log(1 / |C S|), V/A.
    """
    return _slack(kind, *_without_effects(filtered), limits=True)


def _without_effects(filtered: bool) -> tuple[ca.SX, list[list[ca.SX]]]:
    """Symbols of `FIGURES`, and the plant's denominator, control and disturbance polynomials in terms of them."""
    figures = ca.SX.sym("figures", len(FIGURES))
    given = UNUSED | dict(zip(FIGURES, ca.vertsplit(figures), strict=True))
    values = ca.vertcat(*(given[name] for name in linear_assembly(filtered, ()).parameters))
    found = [ca.vertsplit(part) for part in transfer_polynomials(filtered, (), ((), ((1, 1),), ((0, 0),)))(values)]
    outer, inner = given["outer_end_mass"], given["inner_end_mass"]
    weights = (1, inner, outer, outer * inner)
    return figures, [_added_up(zip(weights, found[k : k + 4], strict=True)) for k in (0, 4, 8)]


def _added_up(terms: Iterable[tuple[Any, Sequence[Any]]]) -> list[ca.SX]:
    """Coefficients of a sum of weighted polynomials, each given by its own."""
    listed = list(terms)
    length = max(len(polynomial) for _, polynomial in listed)
    return [sum((weight * p[k] for weight, p in listed if k < len(p)), ca.SX(0)) for k in range(length)]


def _slack(
    kind: str, figures: ca.SX, polynomials: list[list[ca.SX]], limits: bool = False, shifts: bool = False
) -> ca.Function:
    """The slacks from a plant's denominator, control and disturbance polynomials in terms of the figures.

    A fourth polynomial is what the force shows by way of the controller, see `crossed` of `beamdesign.linear.Plant`.
    """
    form = form_named(kind)
    logarithms = ca.SX.sym("controller", len(form.names))
    frequency = ca.SX.sym("frequency")
    w = 2 * pi * frequency
    plant, control, disturbance, *crossed = (_on_axis(p, w) for p in polynomials)
    gain, *shape = ca.vertsplit(ca.exp(logarithms))
    law = form.polynomials(shape)
    numerator, denominator = (_on_axis([ca.SX(c) for c in p], w) for p in law)
    opened = _product(plant, denominator)
    returned = _product(control, (gain * numerator[0], gain * numerator[1]))
    force_path = _product(disturbance, denominator)
    for each in crossed:
        by_controller = _product(each, (gain * numerator[0], gain * numerator[1]))
        force_path = (force_path[0] + by_controller[0], force_path[1] + by_controller[1])
    shift = ca.SX.sym("shift", 3)
    if shifts:
        size, turn = ca.exp(shift[0]), shift[1]
        returned = _product(returned, (size * ca.cos(turn), size * ca.sin(turn)))

    def log_square(value: tuple[ca.SX, ca.SX]) -> ca.SX:
        return ca.log(value[0] ** 2 + value[1] ** 2)

    closed = log_square((opened[0] + returned[0], opened[1] + returned[1]))
    if limits:
        demanded = 2 * ca.log(gain) + log_square(numerator) + log_square(plant)
        reached = [(log_square(opened) - log_square(returned)) / 2, (closed - demanded) / 2]
        return ca.Function("limit_slack", [figures, logarithms, frequency], reached)
    slacks = [(closed - log_square(opened)) / 2, (closed - log_square(force_path)) / 2]
    if shifts:
        return ca.Function("shifted_slack", [figures, logarithms, frequency, shift], [slacks[1] - shift[2]])
    return ca.Function("loop_slack", [figures, logarithms, frequency], slacks)


def member_slack(
    kind: str, plant: BilinearPlant, factor: float, limits: bool = False, shifts: bool = False
) -> ca.Function:
    """`loop_slack`, or with `limits` `limit_slack`, for a plant whose figures stand, with its gain times a factor.

    Its figures are the two end masses. With `shifts` there is a further input and one output, the slack of compliance:
    by how much (logarithm) the loop's response is larger, what its phase is more (rad), and by how much the response
    to the force is larger.
    """
    masses = ca.SX.sym("masses", 2)
    outer, inner = ca.vertsplit(masses)

    def coefficients(*terms: tuple[Any, fmpq_poly]) -> list[ca.SX]:
        return _added_up((weight, [nearest(c) for c in polynomial.coeffs()]) for weight, polynomial in terms)

    (d00, d01), (d10, d11) = plant.denominator
    denominator = coefficients((1.0, d00), (inner, d01), (outer, d10), (outer * inner, d11))
    (c00, c01), (slope, with_inner) = plant.control[0]
    control = [(factor, c00), (factor * inner, c01)]
    disturbance = coefficients((1.0, plant.disturbance[0]), (inner, plant.disturbance[1]))
    if not plant.mass_shows:
        return _slack(kind, masses, [denominator, coefficients(*control), disturbance], limits, shifts)
    assert not shifts  # these come from samples, of which there are none where the sensor rides
    own, added = plant.crossed[0]
    control += [(factor * outer, slope), (factor * outer * inner, with_inner)]
    crossed = coefficients((factor, own), (factor * inner, added))
    return _slack(kind, masses, [denominator, coefficients(*control), disturbance, crossed], limits, shifts)


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
        slack: `loop_slack` or `member_slack`.
        figures: its figures less the end masses.
        inner_end_mass: kg.
        logarithms: of the controller's parameters.
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
