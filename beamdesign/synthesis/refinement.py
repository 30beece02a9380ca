"""Refinement of a law by interior points on samples: the largest bandwidth, or the least moving mass that has it.

With exact second derivatives the bandwidth is a variable, and compliance is enforced at shares of it. The other limits
are enforced at sampled points: a coarse set that covers everything, and the worst points of a fine one, chosen anew in
every round. Where the sections of the beams are variables too, the plant at these points is symbolic in them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import exp, inf, log, pi

import casadi as ca
import numpy as np

from beamdesign.controllers.protocol import Form
from beamdesign.plant.linear import BilinearPlant
from beamdesign.progress import interruption_waits
from beamdesign.proofs.certificate import Kind
from beamdesign.proofs.performance import servo_off_peak
from beamdesign.prototype import Goal
from beamdesign.synthesis.free_search import QUIET_IPOPT
from beamdesign.synthesis.loop_program import Block, highest, point, sampled_program, stiffness_of
from beamdesign.synthesis.loop_samples import LIMITED, Samples, Slacks, counting, goal_limits, sampled_bandwidth, slacks
from beamdesign.synthesis.sections import MASS_PER_MISSING_BANDWIDTH, Sections
from beamdesign.time_limit import leave_out, over

_EVERY = 6
"""Of how many neighbouring points one is enforced wherever it stands."""

_WORST: dict[Kind, int] = {
    "peak_sensitivity": 100, "loop_gain": 25, "controller_effort": 50, "gain_margin": 50, "peak_compliance": 50,
}  # fmt: skip
"""How many of the worst points of each limit but the compliance are enforced beside these."""


_SHARES = np.concatenate([[5e-4], np.linspace(0.02, 0.37, 8), np.linspace(0.4, 1.0, 21)])

_FEWER_SHARES = _SHARES[::-3][::-1]
"""Of the bandwidth at which compliance is enforced, and at which it is of rigs at one mass, of which there are many."""

_MOVES = 0.3
"""How far a resonance may move in a round: logarithm of its frequency."""

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

_LOST = 3
"""How often a step of a law may fail, each shorter than the one before, before none is expected to lead on."""

_STILL = 1e-5
"""Move of all variables below which a refinement of sections ends."""

_SETTLED = 1e-4
"""Relative growth of the bandwidth in a round below which the refinement ends."""


Program = tuple[ca.Function, ca.Function | None, "_InTime"]


class _InTime(ca.Callback):
    """Ends a program between two iterations once the time is up; of many members one takes seconds."""

    def __init__(self, program: Mapping[str, ca.MX]) -> None:
        ca.Callback.__init__(self)
        self._rows = {"f": 1} | {name: program[name[-1]].numel() for name in ("x", "g", "lam_x", "lam_g", "lam_p")}
        self.construct("in_time")

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._rows[ca.nlpsol_out(i)], 1)

    def eval(self, given: Sequence[ca.DM]) -> list[bool]:
        return [over()]


@dataclass(frozen=True)
class LawRefinement:
    """Interior points for one form of law on one set of samples; called from any start.

    Attributes:
        points: fine samples of the loops, with sections those of the rig to begin with.
        goal: the limits.
        form: of the law.
        inner_kg: least and most mass inside.
        plants: the plants and factors on their gain that are to perform, with outer end masses (kg), whether they
            are of the nominal rig, and (15,) factors on the mass inside and on the lumped figures.
        sections: that may be chosen as well; the rigs are then that with them and, as `factors` says, what is off it.
        nominal_rows: how many rows of samples are of the nominal rig; of the others only the worst points are enforced.
        factors: (rows of samples, 15) on the mass inside and on the lumped figures.
        resampled: section variables to the samples with them, None where there is no such rig.
        pace: how quick the rig is, see `beamdesign.plant.assembly.pace`.
    """

    points: Samples
    goal: Goal
    form: Form
    inner_kg: tuple[float, float]
    plants: Sequence[tuple[BilinearPlant, float, Sequence[float], bool, np.ndarray]]
    nominal_rows: int
    factors: np.ndarray
    sections: Sections | None = None
    resampled: Callable[[np.ndarray], Samples | None] | None = None
    pace: float = 1.0
    _programs: dict[tuple[int, ...], Program] = field(default_factory=dict, repr=False, compare=False)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, those of the form, the mass inside and the sections, (v,) each."""
        own, inner = self.form, self.inner_kg
        least, most = ((), ()) if self.sections is None else self.sections.bounds
        return np.array([*own.lower, inner[0], *least]), np.array([*own.upper, inner[1], *most])

    def measured(self, variables: np.ndarray) -> Slacks | None:
        """What a law leaves of the limits, without derivatives; None where there is no such rig."""
        points = self.points if self.resampled is None else self.resampled(variables[self.form.size + 1 :])
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
            missed = max(found.violation(inside), self._overdrawn(variables))
            return width, self.value(variables, width), missed

        reached, value, violation = judged(best, now)
        least, widest, met = _MENDED if worth < inf else _MENDED_A_LITTLE, reach, now.values
        tries, lost, small = 0, 0, _VIOLATION / (100 if self.sections is None or inside else 10)
        while rounds > 0 and reach > 0.005:
            if over():
                leave_out("rounds of refinement")
                break
            rounds -= 1
            tried, foreseen = self._solved(best, now, met, reached, (inside, stiffer), reach)
            solved = self._program[0].stats()["success"]
            if solved and foreseen < value * (1 + _SETTLED) and violation < small:
                break
            if self.sections is not None and np.abs((tried - best) / self._sizes).max() < _STILL:
                break
            then = self.measured(tried)
            if then is not None:
                wider, higher, missed = judged(tried, then)
                mended = missed < min(violation - 1e-7, least * violation) and higher >= value * (1 - worth * violation)
                better = mended or higher > value * (1 + _SETTLED)
                if then.settled and missed < max(violation, _VIOLATION) * 1.01 and better:
                    best, now, reached, value, violation, met = tried, then, wider, higher, missed, then.values
                    lost = 0
                    if self.sections is not None:  # a long way to go, whose parts are curved more or less
                        reach, tries = min(2 * reach, widest), 0
                    continue
                met = np.minimum(met, then.values)
            tries, lost = tries + 1, 0 if solved else lost + 1
            if self.sections is None and lost == _LOST:
                break
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
        self, start: np.ndarray, now: Slacks, met: np.ndarray, reached: float, spare: tuple[float, float], reach: float
    ) -> tuple[np.ndarray, float]:
        """Variables of the program's optimum, and the value that it foresees there; a bandwidth (Hz) is reached."""
        lower, upper = self.bounds
        sizes = self._sizes
        moves = reach * np.append(self.form.moves, sizes[self.form.size :])
        lower, upper = np.maximum(lower, start - moves), np.minimum(upper, start + moves)
        # A compliance that just misses its limit at rest has no bandwidth, but is a good start.
        near = sampled_bandwidth(self.points, now.compliance + NEARLY)
        most = self._aimed
        beta = min(log(max(reached, near, 0.5 * self.pace)), most)
        highest_beta = min(beta + (0.25 if self.sections is None else 1.0), most)
        limited = dict(zip(LIMITED, met if self.sections else now.values, strict=True))
        (solver, servo_off, _), resonance, apart = self._program, [], 0.0
        if servo_off is not None:
            at, largest = highest(servo_off, start / sizes, self.pace)
            resonance, apart = [at], log(now.servo_off_m_per_N) - largest
        data = [self._data(self._chosen(limited[kind], worst)).ravel(order="F") for kind, worst in _WORST.items()]
        with interruption_waits():
            found = solver(
                x0=np.concatenate([start / sizes, [beta], resonance]),
                p=np.concatenate([*data, spare, [apart]]),
                lbx=np.concatenate([lower / sizes, [beta - 1.0], np.subtract(resonance, _MOVES)]),
                ubx=np.concatenate([upper / sizes, [highest_beta], np.add(resonance, _MOVES)]),
                lbg=0.0,
                ubg=ca.inf,
            )
        solution = np.asarray(found["x"]).ravel()
        if not np.isfinite(solution).all():
            return start, 0.0
        values, foreseen = np.clip(solution[: len(start)] * sizes, lower, upper), float(solution[len(start)])
        return values, self.value(values, exp(foreseen))

    @property
    def _sizes(self) -> np.ndarray:
        """What the program's variables, which are all of the order of one, are in: the mass inside in its unit."""
        own, count = self.form.size, len(self.bounds[0])
        return np.concatenate([np.ones(own), [self.form.mass_unit_kg], np.ones(count - own - 1)])

    @property
    def _aimed(self) -> float:
        """Logarithm of the bandwidth (Hz) beyond which nothing is sought."""
        sections = self.sections
        return inf if sections is None or sections.needed_Hz is None else log(sections.needed_Hz * (1 + 1e-5))

    @cached_property
    def _program(self) -> Program:
        """The program. Its points are parameters: refinements that differ in nothing else share it."""
        counts = dict(zip(LIMITED, np.where(counting(self.points, self.goal), 0.0, np.inf), strict=True))
        # How many points are enforced must not change: as many as ever count.
        sizes = tuple(len(self._chosen(counts[kind], worst)) for kind, worst in _WORST.items())
        if sizes not in self._programs:
            self._programs[sizes] = self._built(sizes)
        return self._programs[sizes]

    def _built(self, sizes: Sequence[int]) -> Program:
        """The program; and log(|x / F_d|) without a law of the rig that has the largest, where that sets a limit.

        That is over the variables and a logarithm of frequency (Hz), which is one more variable of the program: it
        finds the resonance as this moves with the mass inside and the sections.
        """
        own, sized = self.form.size, self.sections
        count = own + 1 + (0 if sized is None else len(sized.start))
        limits = goal_limits(self.goal)
        variables = ca.MX.sym("variables", count + 1 + ("peak_compliance" in limits))
        law, inner, chosen, beta, resonance = ca.vertsplit(
            variables, [0, own, own + 1, count, count + 1, variables.shape[0]]
        )
        inner = self.form.mass_unit_kg * inner
        table, _ = self.form.coefficients(law)
        figures = ca.MX(0, 1) if sized is None else sized.figures(chosen)
        inside, stiffer, apart = (ca.MX.sym(name) for name in ("inside", "stiffer", "apart"))
        data, blocks, objective, servo_off = [], list[Block](), -beta, None

        def stiffness(plant: BilinearPlant, factor: float) -> ca.Function:
            if sized is None:
                return stiffness_of(table.shape, plant, factor)
            return sized.slack(table.shape, "compliance")

        def off(k: int, count: int) -> np.ndarray:  # a plant that stands is off already
            factors = np.ones(1) if sized is None else self.plants[k][4]
            return np.repeat(factors[:, None], count, 1)

        limit_of = {kind: ca.MX(log(limit)) for kind, limit in limits.items()}
        if "peak_compliance" in limits:
            k, mass = self._softest()
            idle = ca.DM.zeros(*table.shape)
            idle[-1, 0] = 1
            factors = off(k, 1)
            lumped = figures * ca.DM(factors[1:])
            idling = ca.vec(idle), factors[0, 0] * inner, lumped, mass, ca.exp(resonance)
            without = -stiffness(*self.plants[k][:2])(*idling)
            limit_of["peak_compliance"] += without + apart  # what the samples have more or less of it
            servo_off = ca.Function("servo_off", [variables], [without])
        for kind, size in zip(_WORST, sizes, strict=True):
            given = ca.MX.sym(f"data_{kind}", len(self._data(np.arange(1))), size)
            data.append(given)
            if not size:
                continue
            limit = limit_of[kind] - inside
            if sized is None:
                blocks.append(Block(point(table.shape, kind), given, limit))
            else:
                slack = sized.slack(table.shape, kind)
                frequency, relaxed, rest = ca.vertsplit(given, [0, 1, 2, given.shape[0]])
                blocks.append(Block(slack, ca.vertcat(frequency, rest), limit, ca.log(relaxed).T))
        asked = log(self.goal.compliance_m_per_N) - stiffer
        for k, (plant, factor, masses, nominal, _) in enumerate(self.plants):
            shares = _SHARES if nominal else _FEWER_SHARES
            every = [np.repeat(shares, len(masses)), np.tile(masses, len(shares))]
            each = ca.DM(np.vstack([*every, off(k, len(every[0]))]))
            blocks.append(Block(stiffness(plant, factor), each, asked, of_bandwidth=True))
        rest = ca.MX(0, 1)
        if sized is not None:
            rest = ca.MX(sized.structure(inner, chosen))
            if sized.needed_Hz is not None:
                missing = self._aimed - beta
                objective = sized.moving_mass(inner, chosen) / sized.mass_unit_kg
                objective += MASS_PER_MISSING_BANDWIDTH * missing
        program, derivatives = sampled_program(
            variables, ca.vertcat(*map(ca.vec, data), inside, stiffer, apart), objective,
            ca.vertcat(ca.vec(table), inner, figures, beta), table.numel(), blocks, rest,
        )  # fmt: skip
        options = QUIET_IPOPT | {"ipopt.max_iter": 70, "ipopt.tol": 1e-6, "ipopt.mu_init": 1e-3}
        options |= {"ipopt.mumps_pivot_order": 0}  # by least degree: few variables, many slacks
        options |= {"iteration_callback": (in_time := _InTime(program))}
        return ca.nlpsol("refinement", "ipopt", program, options | derivatives), servo_off, in_time

    def _softest(self) -> tuple[int, float]:
        """Which of the plants, at which outer end mass (kg), has the largest compliance without a law."""
        inner = self.inner_kg[0]
        every = [
            (servo_off_peak([plant.at(inner)], (mass, mass)), k, mass)
            for k, (plant, _, masses, *_) in enumerate(self.plants)
            for mass in masses
        ]
        _, k, mass = max(every)
        return k, mass

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
            at_row = self.factors[at.row[index]].T
            return np.vstack([at.frequency_Hz[index], relaxed, at.outer_end_mass[index], at_row])
        pairs = (*at.control, at.disturbance, *at.crossed)
        values = np.concatenate([at.denominator[index][None], *(pair[:, index] for pair in pairs)])
        return np.concatenate([[2 * pi * at.frequency_Hz[index], relaxed], values.real, values.imag])
