"""Robust tuning: the controller and inner end mass with the largest guaranteed bandwidth over a payload range.

A coarse search proposes, an interior-point method refines on finitely many points, and exact proofs decide: what they
refute becomes a further point, and nothing is returned that is not proved over the continuous range.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import log

import casadi as ca
import numpy as np
from beamdesign.certify.performance import (
    Claim,
    guaranteed_bandwidth,
    guaranteed_peak_sensitivity,
    prove_peak_sensitivity,
)
from beamdesign.certify.stability import is_stable_over
from scipy.stats import qmc

from beamdesign.design.controller_forms import FORMS, ControllerForm
from beamdesign.design.loop_constraints import CheckPoints, check_points, guarantee
from beamdesign.design.loop_search import SEARCH_FREQUENCIES_HZ, Candidate, best_gain, grid_plant
from beamdesign.linear import LinearRig, linear_rig
from beamdesign.loop import Loop, close_loop
from beamdesign.polynomial import exact
from beamdesign.prototype import Goal, Lag, Payload, Proportional, Prototype

Progress = Callable[[float, str], None]

SAMPLES = 256  # of the coarse search; a power of two, as Sobol's sequence wants
STARTS = 4
ROUNDS = 8  # of proof and refinement per start


@dataclass(frozen=True)
class Proved:
    """A loop that was proved stable and within the peak sensitivity for every outer end mass of the range."""

    controller: Proportional | Lag
    inner_end_mass_kg: float
    bandwidth_Hz: float
    peak_sensitivity: float


@dataclass(frozen=True)
class Tuning:
    """Outcome of `tune`.

    Attributes:
        prototype: with the tuned controller and end mass; as given where nothing was found.
        outer_end_mass_kg: the range of the guarantee.
        best: the proved loop, None where there is none.
        starts: bandwidth that each start of the refinement was proved to reach, 0 for a failed one.
        certificates: how many exact stability proofs were run.
        reason: why there is no answer, empty where there is one.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    best: Proved | None
    starts: tuple[float, ...]
    certificates: int
    reason: str = ""


@dataclass
class _Oracle:
    """The exact proofs for one rig, range and limits, counting what it was asked."""

    rig: LinearRig
    low: float
    high: float
    goal: Goal
    certificates: int = 0

    def loop(self, controller: Proportional | Lag, inner_end_mass: float) -> Loop | None:
        """The loop, if it is proved stable over the range."""
        closed = close_loop(self.rig.plant(inner_end_mass), controller)
        self.certificates += 1
        stable = is_stable_over(closed.characteristic, exact(self.low), exact(self.high))
        return closed if stable else None

    def prove(self, loop: Loop, controller: Proportional | Lag, inner_end_mass: float) -> Proved | Claim:
        """The proved figures, or the refuted claim of peak sensitivity."""
        claim = prove_peak_sensitivity(loop, self.goal.peak_sensitivity, self.low, self.high)
        if not claim.holds:
            return claim
        return Proved(
            controller,
            inner_end_mass,
            guaranteed_bandwidth(loop, self.goal.compliance_m_per_N, self.low, self.high),
            guaranteed_peak_sensitivity(loop, self.low, self.high),
        )


def _sampled_starts(oracle: _Oracle, form: ControllerForm, largest_inner: float) -> list[Candidate]:
    """The best sampled loops that are proved stable, mutually distant in the space of shapes."""
    bounds = np.array([*form.log_bounds[1:], (0.0, largest_inner)])
    unit = qmc.Sobol(len(bounds), scramble=True, seed=0).random(SAMPLES)
    points = bounds[:, 0] + unit * (bounds[:, 1] - bounds[:, 0])
    grid = grid_plant(oracle.rig, SEARCH_FREQUENCIES_HZ)
    masses = np.linspace(oracle.low, oracle.high, 1 if oracle.low == oracle.high else 7)
    goal = oracle.goal
    found = [
        best_gain(grid, form, np.exp(point[:-1]), point[-1], masses, goal.peak_sensitivity, goal.compliance_m_per_N)
        for point in points
    ]
    chosen: list[int] = []
    for i in sorted(range(SAMPLES), key=lambda i: -found[i].bandwidth_Hz):
        if len(chosen) == STARTS or found[i].bandwidth_Hz == 0.0:
            break
        if any(np.linalg.norm(unit[i] - unit[j]) < 0.1 for j in chosen):
            continue
        if oracle.loop(form.record([found[i].gain, *found[i].shape]), found[i].inner_end_mass) is not None:
            chosen.append(i)
    return [found[i] for i in chosen]


def _refine(
    oracle: _Oracle, form: ControllerForm, start: np.ndarray, points: CheckPoints, largest_inner: float
) -> np.ndarray:
    """Maximise the bandwidth subject to both limits at the check points.

    Args:
        oracle: rig and limits.
        form: kind of controller.
        start: logarithms of the controller's parameters, inner end mass (kg), logarithm of the bandwidth (Hz).
        points: where the limits are enforced.
        largest_inner: bound on the inner end mass, kg.

    Returns:
        the same variables, refined; whatever the solver's status, only a proof counts.
    """
    count = len(form.names)
    variables = ca.MX.sym("variables", count + 2)
    logarithms, inner, log_bandwidth = variables[:count], variables[count], variables[count + 1]
    figures = ca.MX(ca.DM(list(oracle.rig.figures.values())))
    sensitivity, stiffness = guarantee(
        form.kind, oracle.rig.filtered, figures, inner, logarithms, log_bandwidth, points
    )
    # A hair inside both limits, so that rounding the figures does not break the proof.
    floors = (1e-5 - log(oracle.goal.peak_sensitivity), 1e-7 - log(oracle.goal.compliance_m_per_N))
    constraints = ca.vertcat(sensitivity - floors[0], stiffness - floors[1])
    solver = ca.nlpsol(
        "tuning",
        "ipopt",
        {"x": variables, "f": -log_bandwidth, "g": constraints},
        {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": 120,
                "tol": 1e-9,
                "mu_init": 1e-3,
                "bound_relax_factor": 0,
            },
        },
    )
    lower = [low for low, _ in form.log_bounds] + [0.0, log(1e-3)]
    upper = [high for _, high in form.log_bounds] + [largest_inner, log(500.0)]
    result = solver(x0=start, lbx=lower, ubx=upper, lbg=0.0, ubg=ca.inf)
    return np.clip(np.asarray(result["x"]).ravel(), lower, upper)


def _from_start(oracle: _Oracle, form: ControllerForm, start: Candidate, largest_inner: float) -> Proved | None:
    """Refine one start in rounds, each enforcing what the last proof refuted."""
    points = check_points(oracle.low, oracle.high)
    variables = np.array([log(start.gain), *np.log(start.shape), start.inner_end_mass, log(start.bandwidth_Hz)])
    best: Proved | None = None
    for _ in range(ROUNDS):
        variables = _refine(oracle, form, variables, points, largest_inner)
        controller = form.rounded(variables[: len(form.names)])
        inner = round(float(variables[-2]), 6)
        closed = oracle.loop(controller, inner)
        if closed is None:
            return best
        proved = oracle.prove(closed, controller, inner)
        if isinstance(proved, Claim):
            points = points.with_sensitivity(proved.witness_frequency_Hz, proved.witness_outer_end_mass_kg)
            continue
        if best is None or proved.bandwidth_Hz > best.bandwidth_Hz:
            best = proved
        aimed = float(np.exp(variables[-1]))
        if proved.bandwidth_Hz >= aimed * (1 - 1e-5):
            return best
        # Somewhere below the aimed bandwidth the compliance is too large between the check points.
        share = proved.bandwidth_Hz / aimed
        for mass in np.linspace(oracle.low, oracle.high, 5):
            points = points.with_compliance(share, float(mass))
        variables[-1] = log(max(proved.bandwidth_Hz, 1e-3))
    return best


def tune(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str = "lag",
    largest_inner_end_mass_kg: float = 6.0,
    progress: Progress | None = None,
) -> Tuning:
    """Tune controller and inner end mass for the largest guaranteed bandwidth.

    Args:
        prototype: the rig; its goal sets the limits of compliance and peak sensitivity.
        outer_end_mass_kg: range of mass on the outer tip over which everything is guaranteed.
        kind: controller kind, a key of `beamdesign.design.controller_forms.FORMS`.
        largest_inner_end_mass_kg: most mass that may be added to the inner tip.
        progress: told the share done and what is being done.

    Returns:
        the tuned prototype with what was proved of it, or a reason why there is none.
    """
    told = progress or (lambda fraction, text: None)
    low, high = outer_end_mass_kg
    form = FORMS[kind]
    oracle = _Oracle(linear_rig(prototype), low, high, prototype.goal)
    told(0.0, "coarse search")
    starts = _sampled_starts(oracle, form, largest_inner_end_mass_kg)
    proved: list[Proved | None] = []
    for k, start in enumerate(starts):
        told((k + 1) / (len(starts) + 1), f"refining and proving start {k + 1} of {len(starts)}")
        proved.append(_from_start(oracle, form, start, largest_inner_end_mass_kg))
    reached = tuple(p.bandwidth_Hz if p else 0.0 for p in proved)
    successes = [p for p in proved if p is not None]
    if not successes:
        reason = (
            f"no {kind} controller was found that is proved stable with peak sensitivity at most"
            f" {prototype.goal.peak_sensitivity:g} for outer end masses of {low:g} to {high:g} kg;"
            " a narrower range, a larger peak sensitivity or more inner end mass may allow one"
        )
        return Tuning(prototype, outer_end_mass_kg, None, reached, oracle.certificates, reason)
    best = max(successes, key=lambda p: p.bandwidth_Hz)
    tuned = prototype.but(
        controller=best.controller,
        payload=Payload(outer_end_mass_kg=outer_end_mass_kg, inner_end_mass_kg=best.inner_end_mass_kg),
        guarantee=None,
    )
    return Tuning(tuned, outer_end_mass_kg, best, reached, oracle.certificates)
