"""Refinement of a law by interior points on samples: the largest bandwidth, or the least moving mass that has it.

With exact second derivatives the bandwidth is a variable, and compliance is enforced at shares of it. The other limits
are enforced at sampled points: a coarse set that covers everything, and the worst points of a fine one, chosen anew in
every round. Where the sections of the beams are variables too, the plant at these points is symbolic in them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import exp, inf, log, pi
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq_poly

from beamdesign.controllers.form import Form
from beamdesign.plant.linear import BilinearPlant, PairOver
from beamdesign.proofs.certificate import Kind
from beamdesign.prototype import Goal
from beamdesign.rational import nearest
from beamdesign.synthesis.interruption import interruption_waits
from beamdesign.synthesis.loop_limits import (
    LIMITED,
    Pair,
    added_up,
    goal_limits,
    law_on_axis,
    on_axis,
    slack_of,
)
from beamdesign.synthesis.loop_samples import Samples
from beamdesign.synthesis.loop_slacks import Slacks, counting, sampled_bandwidth, slacks
from beamdesign.synthesis.sections import MASS_PER_MISSING_BANDWIDTH, Sections, sized_slack

_EVERY = 6
"""Of how many neighbouring points one is enforced wherever it stands."""

_WORST: dict[Kind, int] = {"peak_sensitivity": 100, "loop_gain": 25, "controller_effort": 50, "gain_margin": 50}
"""How many of the worst points of each limit but the compliance are enforced beside these."""


_SHARES = np.concatenate([[5e-4], np.linspace(0.02, 0.37, 8), np.linspace(0.4, 1.0, 21)])

_FEWER_SHARES = _SHARES[::-3][::-1]
"""Of the bandwidth at which compliance is enforced, and at which it is of rigs at one mass, of which there are many."""

_VIOLATION = 2e-3
"""Violation between the enforced points that is put up with in a round; the worst of them are enforced in the next."""

WORTH = 10.0
"""Share of the bandwidth that may be given up to mend a violation, over that violation."""

_MENDED, _MENDED_A_LITTLE = 0.5, 0.9
"""Share of a violation that a mended one has at most; and where nothing else leads on: as worst rigs change about, the
violation may have to be mended in several steps."""

TOUCH = 5e-4
"""By how much (logarithm) compliance is kept to spare where it is enforced, so that it is kept between as well."""

NEARLY = 0.02
"""By how much (logarithm) the compliance may miss its limit where a round begins."""

_TRIES = 3
"""How often a step with sections is tried, with the peaks enforced that the last one met, before a shorter one is."""

_STILL = 1e-5
"""Move of all variables below which a refinement of sections ends."""

_SETTLED = 1e-4
"""Relative growth of the bandwidth in a round below which the refinement ends."""


@dataclass(frozen=True)
class LawRefinement:
    """Interior points for one form of law on one set of samples; called from any start.

    Attributes:
        points: fine samples of the loops, with sections those of the rig to begin with.
        goal: the limits.
        form: of the law.
        inner_kg: least and most mass inside.
        plants: the plants and factors on their gain that are to perform, with outer end masses (kg), and whether they
            are of the nominal rig.
        sections: that may be chosen as well; the rigs are then that with them and, as `factors` says, what is off it.
        nominal_rows: how many rows of samples are of the nominal rig; of the others only the worst points are enforced.
        resampled: section variables to the samples with them, None where there is no such rig.
        factors: (rows of samples, 14) on the lumped figures, and for each of the plants likewise, where there are
            sections.
    """

    points: Samples
    goal: Goal
    form: Form
    inner_kg: tuple[float, float]
    plants: Sequence[tuple[BilinearPlant, float, Sequence[float], bool]]
    nominal_rows: int
    sections: Sections | None = None
    resampled: Callable[[np.ndarray], Samples | None] | None = None
    factors: tuple[np.ndarray, np.ndarray] | None = None
    _solver: ca.Function = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Build the program: its points are parameters."""
        object.__setattr__(self, "_solver", self._program())

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, those of the form, the mass inside and the sections, (v,) each."""
        own, inner, sections = self.form, self.inner_kg, self.sections
        lower, upper = np.append(own.lower, inner[0]), np.append(own.upper, inner[1])
        if sections is None:
            return lower, upper
        return np.append(lower, sections.lower), np.append(upper, sections.upper)

    def points_at(self, variables: np.ndarray) -> Samples | None:
        """Samples of the loops with the sections among these variables."""
        return self.points if self.resampled is None else self.resampled(variables[self.form.size + 1 :])

    def measured(self, variables: np.ndarray) -> Slacks | None:
        """What a law leaves of the limits, without derivatives; None where there is no such rig."""
        points = self.points_at(variables)
        return None if points is None else slacks(points, self.goal, self.form, variables, slopes=False)

    def __call__(
        self,
        start: np.ndarray,
        inside: float = 0.0,
        stiffer: float = TOUCH,
        rounds: int = 20,
        reach: float = 0.5,
        worth: float = WORTH,
    ) -> tuple[np.ndarray, float]:
        """Variables and sampled value of the best loop found, the start's own where none is better.

        The value is the bandwidth (Hz), or with sections what they say it is.

        Args:
            start: (v,) variables of a loop that is stable.
            inside: by how much (logarithm) every limit but the compliance is to be kept with something to spare.
            stiffer: likewise of the compliance.
            rounds: at most.
            reach: how far a variable may move in the first of them.
            worth: share of the value that may be given up to mend a violation, over that violation.
        """
        best = np.clip(start, *self.bounds)
        now = self.measured(best)
        if now is None or not now.settled:
            return best, 0.0

        def judged(variables: np.ndarray, found: Slacks) -> tuple[float, float, float]:
            """Bandwidth (Hz), value, and what is missed of the other limits."""
            width = sampled_bandwidth(self.points, found.compliance - stiffer + TOUCH)
            missed = max(found.violation_inside(inside), self._overdrawn(variables))
            return width, self.value(variables, width), missed

        reached, value, violation = judged(best, now)
        least, widest, met = _MENDED if worth < inf else _MENDED_A_LITTLE, reach, now.values
        tries, small = 0, _VIOLATION / (100 if self.sections is None or inside else 10)
        while rounds > 0 and reach > 0.005:
            rounds -= 1
            tried, foreseen = self._solved(best, now, met, reached, (inside, stiffer), reach)
            if self._solver.stats()["success"] and foreseen < value * (1 + _SETTLED) and violation < small:
                break
            if self.sections is not None and np.abs(tried - best).max() < _STILL:
                break
            then = self.measured(tried)
            if then is not None:
                wider, higher, missed = judged(tried, then)
                mended = missed < min(violation - 1e-7, least * violation) and higher >= value * (1 - worth * violation)
                better = mended or higher > value * (1 + _SETTLED)
                if then.settled and missed < max(violation, _VIOLATION) * 1.01 and better:
                    best, now, reached, value, violation, met = tried, then, wider, higher, missed, then.values
                    if self.sections is not None:  # a long way to go, whose parts are curved more or less
                        reach, tries = min(2 * reach, widest), 0
                    continue
                met = np.minimum(met, then.values)
            tries += 1
            if self.sections is None or tries % _TRIES == 0:
                reach /= 3
        return best, value

    def value(self, variables: np.ndarray, bandwidth_Hz: float) -> float:
        """What a loop of a bandwidth is worth."""
        if self.sections is None:
            return bandwidth_Hz
        own = self.form.size
        return self.sections.value(float(variables[own]), variables[own + 1 :], bandwidth_Hz)

    def _overdrawn(self, variables: np.ndarray) -> float:
        """By how much the sections miss what they are to keep."""
        if self.sections is None:
            return 0.0
        own = self.form.size
        kept = np.asarray(self.sections.structure(variables[own], variables[own + 1 :]))
        return max(0.0, -float(kept.min(initial=0.0)))

    def _solved(
        self,
        start: np.ndarray,
        now: Slacks,
        met: np.ndarray,
        bandwidth_Hz: float,
        spare: tuple[float, float],
        reach: float,
    ) -> tuple[np.ndarray, float]:
        """Variables of the program's optimum, and the value that it foresees there."""
        lower, upper = self.bounds
        moves = reach * np.append(self.form.moves, np.ones(len(start) - self.form.size))
        lower, upper = np.maximum(lower, start - moves), np.minimum(upper, start + moves)
        # A compliance that just misses its limit at rest has no bandwidth, but is a good start.
        near = sampled_bandwidth(self.points, now.compliance + NEARLY)
        beta = log(max(bandwidth_Hz, near, 0.5))
        if (most := self._aimed) < inf:
            beta = min(beta, most)
        limited = dict(zip(LIMITED, met if self.sections else now.values, strict=True))
        data = [self._data(self._chosen(limited[kind], worst)).ravel(order="F") for kind, worst in _WORST.items()]
        with interruption_waits():
            found = self._solver(
                x0=np.append(start, beta),
                p=np.concatenate([*data, spare]),
                lbx=np.append(lower, beta - 1.0),
                ubx=np.append(upper, min(beta + (0.25 if self.sections is None else 1.0), most)),
                lbg=0.0,
                ubg=ca.inf,
            )
        *values, foreseen = np.asarray(found["x"]).ravel()
        if not np.isfinite(values).all():
            return start, 0.0
        values = np.clip(values, lower, upper)
        return values, self.value(values, exp(foreseen))

    @property
    def _aimed(self) -> float:
        """Logarithm of the bandwidth (Hz) beyond which nothing is sought."""
        sections = self.sections
        return inf if sections is None or sections.needed_Hz is None else log(sections.needed_Hz * (1 + 1e-5))

    def _program(self) -> ca.Function:
        own, sized = self.form.size, self.sections
        count = own + 1 + (0 if sized is None else len(sized.start))
        variables = ca.MX.sym("variables", count + 1)
        law, inner, chosen, beta = ca.vertsplit(variables, [0, own, own + 1, count, count + 1])
        table, _ = self.form.coefficients(law)
        figures = ca.MX(0, 1) if sized is None else sized.figures(chosen)
        none = ca.MX(0, 1)
        inside, stiffer = ca.MX.sym("inside"), ca.MX.sym("stiffer")
        data, found, objective = [], [], -beta

        def held(slack: ca.Function, factors: Any, given: Sequence[ca.MX]) -> ca.MX:
            """A slack at points side by side, from what is the same for all and what each has of its own."""
            n = given[0].shape[1]
            law, mass, lumped = (ca.repmat(one, 1, n) for one in (ca.vec(table), inner, figures))
            return slack.map(n)(law, mass, lumped if sized is None else lumped * factors, *given).T

        # How many points are enforced must not change: as many as ever count.
        counts = dict(zip(LIMITED, np.where(counting(self.points, self.goal), 0.0, np.inf), strict=True))
        for kind, worst in _WORST.items():
            size = len(self._chosen(counts[kind], worst))
            given = ca.MX.sym(f"data_{kind}", len(self._data(np.arange(1))), size)
            data.append(given)
            if not size:
                continue
            limit = log(goal_limits(self.goal)[kind])
            if sized is None:
                found.append(held(_point(table.shape, kind), none, [given]) + limit - inside)
            else:
                frequency, relaxed, outer, factors = ca.vertsplit(given, [0, 1, 2, 3, given.shape[0]])
                slack = sized_slack(table.shape, kind, sized.filtered)
                found.append(held(slack, factors, [outer, frequency]) + ca.log(relaxed).T + limit - inside)
        asked = log(self.goal.compliance_m_per_N) - stiffer
        for k, (plant, factor, masses, nominal) in enumerate(self.plants):
            shares = _SHARES if nominal else _FEWER_SHARES
            every = ca.MX(np.tile(masses, len(shares))).T
            frequencies = ca.exp(beta) * ca.DM(np.repeat(shares, len(masses))).T
            stiffness = (
                _stiffness(table.shape, plant, factor)
                if sized is None
                else sized_slack(table.shape, "compliance", sized.filtered)
            )
            off = (
                none if self.factors is None else ca.DM(np.repeat(self.factors[1][k][:, None], every.shape[1], axis=1))
            )
            found.append(held(stiffness, off, [every, frequencies]) + asked)
        if sized is not None:
            found.append(ca.MX(sized.structure(inner, chosen)))
            if sized.needed_Hz is not None:
                missing = self._aimed - beta
                objective = sized.moving_mass(inner, chosen) + MASS_PER_MISSING_BANDWIDTH * missing
        return ca.nlpsol(
            "refinement",
            "ipopt",
            {
                "x": variables,
                "p": ca.vertcat(*map(ca.vec, data), inside, stiffer),
                "f": objective,
                "g": ca.vertcat(*found),
            },
            {
                "print_time": False,
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
                "ipopt.max_iter": 70,
                "ipopt.tol": 1e-6,
                "ipopt.mu_init": 1e-3,
                "ipopt.bound_relax_factor": 0.0,
            },
        )

    def _chosen(self, slack: np.ndarray, worst: int) -> np.ndarray:
        """Indices of every so manieth finite slack and of the worst of the others; fewer where each costs more."""
        finite = np.nonzero(np.isfinite(slack))[0]
        nominal = finite[self.points.row[finite] < self.nominal_rows]
        even = nominal[:: _EVERY if self.sections is None else 6 * _EVERY]
        rest = np.setdiff1d(finite, even)
        return np.concatenate([even, rest[np.argsort(slack[rest], kind="stable")[:worst]]])

    def _data(self, index: np.ndarray) -> np.ndarray:
        """What the program reads of some points, (rows, count)."""
        at, relaxed = self.points, self.points.relaxed[index]
        if self.sections is not None:
            assert self.factors is not None
            return np.vstack(
                [at.frequency_Hz[index], relaxed, at.outer_end_mass[index], self.factors[0][at.row[index]].T]
            )
        values = np.concatenate([at.denominator[index][None], *(control[:, index] for control in at.control)])
        return np.concatenate([[2 * pi * at.frequency_Hz[index], relaxed], values.real, values.imag])


def _point(shape: tuple[int, int], kind: Kind) -> ca.Function:
    """Slack of a limit at one point, see `slack_of`, from the law's coefficients, mass inside, nothing, and data."""
    coefficients = ca.SX.sym("coefficients", *shape)
    half = 2 * shape[0] - 1
    inner, data = ca.SX.sym("inner"), ca.SX.sym("data", 2 + 2 * half)
    values: list[Pair] = [(data[2 + k], data[2 + half + k]) for k in range(half)]
    plant: Pair = (1 + inner * values[0][0], inner * values[0][1])
    control = [
        (bare[0] + inner * added[0], bare[1] + inner * added[1])
        for bare, added in zip(values[1::2], values[2::2], strict=True)
    ]
    slack = slack_of(kind, law_on_axis(coefficients, data[0]), plant, control) + ca.log(data[1])
    return ca.Function("point", [ca.vec(coefficients), inner, ca.SX(0, 1), data], [slack])


def _stiffness(shape: tuple[int, int], plant: BilinearPlant, factor: float) -> ca.Function:
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
    return ca.Function("stiffness", [ca.vec(coefficients), inner, ca.SX(0, 1), outer, frequency], [slack])
