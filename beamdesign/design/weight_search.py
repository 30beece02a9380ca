"""The weights of a synthesis, searched for the controller that does best at sampled points of the loops it serves.

A regulator that is optimal by its weights knows nothing of limits on peaks; the weights, the mass inside and the
payload that it is designed for are what a search can choose. Everything here is sampled and only proposes.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log, pi

import numpy as np

from beamdesign.controllers import Sensed
from beamdesign.design.loop_samples import Samples, sampled_bandwidth, slacks_of
from beamdesign.design.synthesis import GeneralisedPlant, StateSpace, lqg
from beamdesign.design.synthesis_weights import Weights, realised, scaled_plant, sensed_model, weighted
from beamdesign.linear import LinearModel
from beamdesign.prototype import Goal

AIM_HZ = 5.0
"""Up to where the search betters the compliance."""

_PENALTY = 4.0
"""What a violation of the other limits costs, over the slack of compliance."""

_UNSTABLE, _NONE = 50.0, 60.0
"""Cost of a loop that is not stable, and of weights that lead to no stable controller."""

_LOG_BOUNDS = (
    (0.2, 3.0),  # corner, in units of 100 rad/s
    (0.05, 1.0),  # its damping ratio
    (2.0, 12.0),  # roll-off
    (1e-2, 1e2),  # current
    (1e-3, 1e2),  # noise
    (1e-3, 1e2),  # recovery
    (1e-2, 1e2),  # white force
    (1e-2, 1e2),  # noise of added sensors
)


@dataclass(frozen=True)
class Proposal:
    """A controller that was synthesised.

    Attributes:
        law: in SI, reduced to the order that is realised.
        inner_end_mass: kg.
        cost: the smaller the better.
        bandwidth_Hz: sampled, as synthesised; 0 where it misses another limit than the compliance.
        variables: logarithms of the weights, mass inside, payload it is designed for.
    """

    law: StateSpace
    inner_end_mass: float
    cost: float
    bandwidth_Hz: float
    variables: np.ndarray


@dataclass(frozen=True)
class WeightSearch:
    """One rig with its sensors, and the samples of all loops that are to be served.

    Attributes:
        rig: that the controller is designed on.
        sensors: what it reads.
        points: samples, the same frequencies in every row.
        goal: the limits.
        masses_kg: range of the payload.
        largest_inner: kg.
        order: of the controller.
    """

    rig: LinearModel
    sensors: Sequence[Sensed]
    points: Samples
    goal: Goal
    masses_kg: tuple[float, float]
    largest_inner: float
    order: int

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, (10,) each."""
        rows = [(log(low), log(high)) for low, high in _LOG_BOUNDS]
        found = np.array([*rows, (0.0, self.largest_inner), self.masses_kg])
        return found[:, 0], found[:, 1]

    def proposal(self, variables: np.ndarray, solve: Callable[[GeneralisedPlant], StateSpace]) -> Proposal | None:
        """The controller of some weights; None where there is none, or none that is stable."""
        weights, inner = Weights(*np.exp(variables[: len(_LOG_BOUNDS)])), float(variables[-2])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)  # an equation that is all but singular is no design
                plant = scaled_plant(
                    sensed_model(self.rig, float(variables[-1]), inner, self.sensors), self.goal.compliance_m_per_N
                )
                law = realised(plant, weights, solve(weighted(plant, weights)), self.order)
        except (np.linalg.LinAlgError, ValueError, RuntimeWarning):
            return None
        rows = int(self.points.row.max()) + 1
        s = 2j * pi * self.points.frequency_Hz[: len(self.points.frequency_Hz) // rows]
        left = slacks_of(self.points, self.goal, np.tile(law.responses(s)[:, 0].T, (1, rows)), inner)
        if not left.settled or not self._stable(law, inner):
            return Proposal(law, inner, _UNSTABLE, 0.0, variables)
        aimed = left.compliance[self.points.frequency_Hz <= AIM_HZ]
        reached = sampled_bandwidth(self.points, left.compliance) if left.violation < 1e-3 else 0.0
        return Proposal(law, inner, _PENALTY * left.violation - float(aimed.min()), reached, variables)

    def _stable(self, law: StateSpace, inner: float) -> bool:
        """Whether the loops of the rig that is designed on are stable at the ends and in the middle of the range."""
        for mass in np.unique(np.linspace(*self.masses_kg, 3)):
            plant = sensed_model(self.rig, float(mass), inner, self.sensors)
            current, sensed = plant.b[:, 1:], plant.c[1:]
            whole = np.block([[plant.a - current @ law.d @ sensed, current @ law.c], [-law.b @ sensed, law.a]])
            # The mean pressure of the chambers and the like neither are driven nor show; they are stable by themselves.
            if np.linalg.eigvals(whole).real.max() >= 0:
                return False
        return True

    def sampled(self, count: int) -> list[Proposal]:
        """Regulators of weights that fill their bounds evenly, the best first; only those with stable loops."""
        from scipy.stats import qmc

        lower, upper = self.bounds()
        unit = qmc.Sobol(len(lower), scramble=True, rng=0).random(count)
        found = [self.proposal(lower + row * (upper - lower), lqg) for row in unit]
        return sorted((one for one in found if one is not None and one.cost < _UNSTABLE), key=lambda one: one.cost)

    def improved(self, start: Proposal, solve: Callable[[GeneralisedPlant], StateSpace], evaluations: int) -> Proposal:
        """The best that a simplex search (J. A. Nelder and R. Mead, Computer Journal 7, 1965) finds from a start."""
        from scipy.optimize import minimize

        lower, upper = self.bounds()
        best = start

        def cost(variables: np.ndarray) -> float:
            nonlocal best
            found = self.proposal(np.clip(variables, lower, upper), solve)
            if found is not None and found.cost < best.cost:
                best = found
            return _NONE if found is None else found.cost

        steps = np.minimum(0.6, (upper - lower) / 4)
        simplex = np.vstack(
            [start.variables, start.variables + np.diag(np.where(start.variables + steps < upper, steps, -steps))]
        )
        minimize(
            cost,
            start.variables,
            method="Nelder-Mead",
            options={"maxfev": evaluations, "initial_simplex": simplex, "adaptive": True},
        )
        return best
