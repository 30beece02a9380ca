"""The alternative to the tuner: differential evolution on a grid, and what its optimum is worth once it is proved.

The same variables within the same bounds as in `tune` (logarithms of gain and breaks, inner end mass), and the same
goal, sampled on 300 frequencies and 7 outer end masses: largest bandwidth, a penalty for peak sensitivity above its
limit, and a larger one for loops with an eigenvalue to the right of the axis at a sampled mass.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, log, pi, tanh

import numpy as np
from comparison import Comparison, Cost, Effort, Method, timed
from grids import closed_loops, growth, matrices
from scipy.optimize import OptimizeResult, differential_evolution

from beamdesign import Prototype, tune
from beamdesign.controllers import Lag, Proportional
from beamdesign.controllers.protocol import form_of
from beamdesign.loop import close_loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.performance import bandwidth, least_limit, prove
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.synthesis.loop_samples import first_miss, samples

LARGEST_INNER_KG = 6.0
SEARCH_FREQUENCIES_HZ = np.geomspace(0.05, 600.0, 300)
"""3 % steps, finer than the half-width of a mode with 5 % damping."""
_MASSES = 7
_PER_EXCESS = 20.0
"""Penalty per unit of log(peak sensitivity) above its limit: many times what that buys in log(bandwidth)."""
_UNSTABLE = 10.0
_LEAST_SHARE = 1e-3
_LOUDEST_A_PER_V = 5e3
"""Beyond which no gain is plausible, half as large again included."""


class Sampled:
    """The tuner's goal on a grid, as a function to minimise."""

    def __init__(self, prototype: Prototype, masses_kg: tuple[float, float], kind: str):
        rig = paper_model(prototype)
        self.form, self.goal, self.rig = form_of(kind), prototype.goal, rig
        self.masses = np.linspace(*masses_kg, _MASSES)
        self.bounds = [*zip(self.form.lower, self.form.upper, strict=True), (0.0, LARGEST_INNER_KG)]
        self._points = samples(rig.polynomials(), SEARCH_FREQUENCIES_HZ, self.masses)
        self._matrices = matrices(rig)

    def record(self, variables: np.ndarray) -> tuple[Proportional | Lag, float]:
        """Controller and inner end mass with rounded figures, as the tuner rounds its own."""
        return self.form.record(variables[:-1]), round(float(variables[-1]), 6)

    def figures(self, variables: np.ndarray) -> tuple[float, float]:
        """Bandwidth (Hz) and peak sensitivity on the grid."""
        own = self.form.responses(variables[:-1], 2j * pi * SEARCH_FREQUENCIES_HZ)[0]
        _, (control,), disturbance, _ = self._points.at(float(variables[-1]))
        shape = (len(self.masses), -1)
        returned = 1 + own * control.reshape(shape)
        compliance = np.abs(disturbance.reshape(shape) / returned).max(axis=0)
        slack = np.log(self.goal.compliance_m_per_N / compliance)
        # A design that misses the compliance at once is told how far it is off, so that the search has a way to go.
        reached = first_miss(SEARCH_FREQUENCIES_HZ, slack) or float(SEARCH_FREQUENCIES_HZ[0] * np.exp(slack[0]))
        bandwidth = min(reached, float(SEARCH_FREQUENCIES_HZ[-1]))
        return bandwidth, float(1 / np.abs(returned).min())

    def __call__(self, variables: np.ndarray) -> float:
        """What is minimised."""
        controller = self.form.record(variables[:-1])
        fastest = float(growth(closed_loops(self._matrices, controller, float(variables[-1]), self.masses)).max())
        if fastest >= 0:
            return _UNSTABLE + tanh(fastest / 100)
        bandwidth, peak = self.figures(variables)
        return -log(bandwidth) + _PER_EXCESS * max(0.0, log(peak / self.goal.peak_sensitivity))


@dataclass(frozen=True)
class Worth:
    """What a sampled optimum is worth.

    Attributes:
        stable: whether it is stable over the whole range, exactly.
        bandwidth_Hz: guaranteed at the gain that was found; 0 where not stable.
        peak_sensitivity: guaranteed there, rounded up to 1e-4.
        keeps_limit: whether it is proved to keep the limit of peak sensitivity as it stands.
        gain_share: nearest share of the gain, lower or higher, at which it is proved to keep the limit; 0 for none.
        proved_bandwidth_Hz: guaranteed at that share; of a lower and a higher one the better.
    """

    stable: bool
    bandwidth_Hz: float
    peak_sensitivity: float
    keeps_limit: bool
    gain_share: float
    proved_bandwidth_Hz: float


def worth(sampled: Sampled, variables: np.ndarray, low_kg: float, high_kg: float) -> Worth:
    """Prove what can be proved of a sampled optimum, and move its gain until it keeps the limit."""
    controller, inner = sampled.record(variables)
    plant, goal = sampled.rig.plant(inner), sampled.goal

    def at(share: float) -> Rectangle:
        closed = close_loop(plant, controller.but(gain_A_per_V=controller.gain_A_per_V * share))
        return Rectangle(closed, exact(low_kg), exact(high_kg))

    def kept(share: float) -> bool:
        return prove(at(share), Asked("peak_sensitivity", goal.peak_sensitivity)).holds

    def reached(share: float) -> float:
        return bandwidth([at(share)], goal.compliance_m_per_N) if at(share).stable else 0.0

    keeps, loudest = kept(1.0), min(1 / _LEAST_SHARE, _LOUDEST_A_PER_V / controller.gain_A_per_V)
    shares = [1.0] if keeps else [_nearest_kept(kept, factor) for factor in (_LEAST_SHARE, loudest)]
    proved = {reached(share): share for share in shares if share is not None}
    best = max(proved, default=0.0)
    return Worth(
        at(1.0).stable,
        reached(1.0),
        least_limit([at(1.0)], "peak_sensitivity") if at(1.0).stable else inf,
        keeps,
        proved.get(best, 0.0),
        best,
    )


def _nearest_kept(kept: Callable[[float], bool], furthest: float) -> float | None:
    """The share of the gain nearest to 1, towards the furthest one, at which the limit is kept; None where nowhere."""
    share, failing, step = 1.0, 1.0, 1e-6
    while not kept(share):
        if not min(furthest, 1.0) <= share <= max(furthest, 1.0):
            return None
        failing, share, step = share, share * (1 + (step if furthest > 1 else -step)), min(2 * step, 0.5)
    while abs(failing - share) > 1e-7 * failing:
        middle = (share + failing) / 2
        share, failing = (middle, failing) if kept(middle) else (share, middle)
    return share


def compare_tuners(
    prototype: Prototype, masses_kg: tuple[float, float], effort: Effort, row: str, question: str
) -> Comparison:
    """The tuner against one run of the evolution per seed."""
    cost, tuned = timed(lambda: tune(prototype, masses_kg, effort.kind, LARGEST_INNER_KG, sigmas=0.0), 1, warm=False)
    assert tuned.best is not None
    best = tuned.best
    methods = [
        Method(
            f"proof: tune, {effort.kind}",
            cost,
            f"{best.bandwidth_Hz:.7g} Hz proved, peak sensitivity at most {best.peak_sensitivity:.6g},"
            f" {best.inner_end_mass_kg:.3g} kg inside ({tuned.certificates} stability proofs)",
            facts={"proved_bandwidth_Hz": best.bandwidth_Hz, "peak_sensitivity": best.peak_sensitivity},
        )
    ]
    sampled = Sampled(prototype, masses_kg, effort.kind)
    for seed in effort.seeds:
        cost, found = timed(
            lambda seed=seed: differential_evolution(sampled, sampled.bounds, seed=seed, maxiter=effort.generations),
            1,
            warm=False,
        )
        methods.append(_searched(sampled, found, seed, cost, masses_kg))
    return Comparison(row, question, tuple(methods))


def _searched(sampled: Sampled, found: OptimizeResult, seed: int, cost: Cost, masses_kg: tuple[float, float]) -> Method:
    bandwidth, peak = sampled.figures(found.x)
    value, limit = worth(sampled, found.x, *masses_kg), sampled.goal.peak_sensitivity
    exact = f"proved, it is worth {value.bandwidth_Hz:.7g} Hz at peak sensitivity {value.peak_sensitivity:.5g}"
    if not value.stable:
        exact = "it is not stable over the whole range"
    elif not value.keeps_limit:
        exact += f", above the limit {limit:g}"
    after = "as it stands"
    if value.gain_share == 0:
        after = "no gain keeps the limit"
    elif not value.keeps_limit:
        after = f"with its gain times {value.gain_share:.6g} the limit is kept, and"
        after += (
            f" {value.proved_bandwidth_Hz:.7g} Hz are proved" if value.proved_bandwidth_Hz else " no bandwidth is left"
        )
    return Method(
        f"scipy differential_evolution, seed {seed}",
        cost,
        f"{bandwidth:.7g} Hz at peak sensitivity {peak:.5g} on the grid, {found.x[-1]:.3g} kg inside"
        f" ({found.nfev} evaluations)",
        f"{exact}; {after}",
        {
            "sampled_bandwidth_Hz": bandwidth,
            "sampled_peak_sensitivity": peak,
            "peak_sensitivity": value.peak_sensitivity,
            "keeps_limit": float(value.keeps_limit),
            "gain_share": value.gain_share,
            "proved_bandwidth_Hz": value.proved_bandwidth_Hz,
        },
    )
