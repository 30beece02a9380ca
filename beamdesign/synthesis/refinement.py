"""Refine a proposed loop by interior points on finitely many check points, and let exact proofs add what was missed.

The variables of a program, in this order: logarithms of the controller's parameters, inner end mass (kg), logarithm
of the guaranteed bandwidth (Hz), and whatever describes the sections. Where a loop comes nearest to its limits is found
by sampling: these points are for the optimiser, and prove nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, log

import casadi as ca
import numpy as np

from beamdesign.controllers import Controller
from beamdesign.controllers.form import Form
from beamdesign.loop import Loop, LoopAtMass
from beamdesign.plant.members import VertexModel
from beamdesign.proofs.certificate import Claim, Kind
from beamdesign.prototype import Goal
from beamdesign.synthesis.interruption import interruption_waits
from beamdesign.synthesis.loop_limits import LoopSet, goal_limits, loop_set, loop_slack

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


SHARES = np.linspace(0.0, 1.0, 5)
"""Masses, as shares of the range, that are looked at."""


def magnitude(loop: LoopAtMass, kind: Kind, frequency_Hz: np.ndarray) -> np.ndarray:
    """|S|, |L| or |C S| at the given frequencies."""
    match kind:
        case "peak_sensitivity":
            return np.abs(loop.sensitivity_response(frequency_Hz))
        case "loop_gain":
            return np.abs(loop.loop_response(frequency_Hz))
        case "controller_effort":
            return np.abs(loop.effort_response(frequency_Hz))
    raise ValueError(f"no limit of {kind} is enforced at check points")


def peak_near(
    loop: Loop, kind: Kind, frequency_Hz: float, mass: float, low: float, high: float, from_Hz: float = 0.0
) -> tuple[float, float]:
    """Frequency and mass of the peak that a point lies on, by small grids that move and zoom in."""
    for spread in (0.03, 0.03, 0.03, 0.01, 0.003):
        frequencies = np.maximum(frequency_Hz * np.geomspace(1 / (1 + spread), 1 + spread, 21), from_Hz)
        masses = np.unique(np.clip(mass + spread * (high - low) * np.linspace(-3, 3, 7), low, high))
        peaks = np.array([magnitude(loop.at(float(value)), kind, frequencies) for value in masses])
        i, j = np.unravel_index(int(peaks.argmax()), peaks.shape)
        frequency_Hz, mass = float(frequencies[j]), float(masses[i])
    return frequency_Hz, mass


def largest_sampled(
    loop: Loop, kind: Kind, low: float, high: float, from_Hz: float = 0.0
) -> tuple[float, float, float]:
    """Largest magnitude on a coarse grid, its frequency and mass; a proof's witness need not be near the worst peak."""
    start, end = (1.0, 400.0) if kind == "peak_sensitivity" else (max(from_Hz, 1.0), max(4 * from_Hz, 2000.0))
    frequencies, masses = np.geomspace(start, end, 400), low + SHARES * (high - low)
    peaks = np.array([magnitude(loop.at(float(mass)), kind, frequencies) for mass in masses])
    i, j = np.unravel_index(int(peaks.argmax()), peaks.shape)
    return float(peaks[i, j]), float(frequencies[j]), float(masses[i])


def high_peaks(loop: Loop, low: float, high: float, least: float) -> list[tuple[float, float]]:
    """Frequencies and masses of all sampled peaks of the sensitivity above a value."""
    found = []
    frequencies = np.geomspace(1.0, 400.0, 1200)
    for mass in np.unique(low + SHARES * (high - low)):
        size = magnitude(loop.at(float(mass)), "peak_sensitivity", frequencies)
        inner = size[1:-1]
        peaks = (inner > size[:-2]) & (inner >= size[2:]) & (inner > least)
        found += [(float(frequency), float(mass)) for frequency in frequencies[1:-1][peaks]]
    return found


ROUNDS = 24
"""Most rounds of refinement and proof from one start."""

_SMALLEST_REACH = 0.02

_INSIDE = 6e-6
"""How far inside both limits to stay (in logarithms), so that rounding the figures keeps the proof."""

_STUCK = 1e-4
"""A move so small that the last check point changed nothing: then too the limit is tightened."""

_HIGH_PEAK = 0.7
"""Share of the limit from which a peak of the sensitivity counts as high."""

_SPARE: dict[Kind, int] = {"peak_sensitivity": 60, "compliance": 20, "loop_gain": 20, "controller_effort": 40}
"""Slots for further check points of each limit, before a solver is built anew with more."""

_SMALLEST_SHARE = 1e-3
"""Least share of the bandwidth at which compliance is enforced: at rest it may vanish, and has no logarithm then."""

LARGEST_BANDWIDTH_HZ = 500.0
"""Most that is guaranteed, also of a rig that keeps the compliance at every frequency."""


@dataclass(frozen=True)
class LoopProgram:
    """What is optimised, over the variables named at the head of this file.

    Attributes:
        form: kind of controller.
        goal: limits of compliance and peak sensitivity.
        outer_end_mass_kg: range of the guarantee.
        figures: the section variables to the (14,) lumped figures; to none where they stand.
        filtered: whether the sensor has a filter.
        structure: all variables to slacks that must not be negative.
        objective: all variables to what is minimised.
        lower: (n,) bounds of all variables.
        upper: (n,)
        reach: how far the variables may move in the first round. Beyond a stability boundary the sensitivity is
            finite again, so that a long step can end in an unstable loop that meets every constraint.
        tighten_below: excess of |S| (in logarithms) below which a refuted limit is tightened by it; above it, only
            check points are added, which costs rounds but nothing of the optimum.
        members: section variables to all linear members of the rig they stand for, rounded as it will be written down,
            which are all guaranteed; None where they are the sizes of no tubes, or of an inner one that does not go
            into the outer one.
        flaw: all variables to the reason why their rounded sections may not be built, empty where they may.
        cost: of a proved loop, to choose the best one by.
    """

    form: Form
    goal: Goal
    outer_end_mass_kg: tuple[float, float]
    figures: Callable[[ca.MX], ca.MX]
    filtered: bool
    structure: Callable[[ca.MX], ca.MX]
    objective: Callable[[ca.MX], ca.MX]
    lower: np.ndarray
    upper: np.ndarray
    reach: float
    tighten_below: float
    members: Callable[[np.ndarray], tuple[VertexModel, ...] | None]
    flaw: Callable[[np.ndarray], str]
    cost: Callable[["Proved"], float]


@dataclass(frozen=True)
class Proved:
    """A loop proved stable and within the peak sensitivity for every outer end mass of the range.

    Attributes:
        controller: with rounded figures, as it was proved.
        inner_end_mass_kg: mass added inside.
        bandwidth_Hz: proved, for every mass of the range.
        peak_sensitivity: proved bound.
        variables: of the program, where it was found.
    """

    controller: Controller
    inner_end_mass_kg: float
    bandwidth_Hz: float
    peak_sensitivity: float
    variables: np.ndarray


@dataclass(frozen=True)
class Refinement:
    """Outcome of one start: what was proved, or why nothing was; and how many stability proofs it took."""

    proved: Proved | None
    certificates: int
    reason: str = ""


class _Solver:
    """IPOPT for one program: the check points are parameters, in slots that repeat a point where unused."""

    def __init__(self, program: LoopProgram, points: CheckPoints):
        self._slots = {kind: len(given) + _SPARE[kind] for kind, given in points.items()}
        self._program = program
        count, n = program.form.size, len(program.lower)
        variables, inside = ca.MX.sym("variables", n), ca.MX.sym("inside")
        logarithms, inner, log_bandwidth, sections = ca.vertsplit(variables, [0, count, count + 1, count + 2, n])
        limits, figures, slacks, places = goal_limits(program.goal), program.figures(sections), [], []
        for kind, slots in self._slots.items():
            place = ca.MX.sym(kind, slots, 2)
            frequency = ca.exp(log_bandwidth) * place[:, 0] if kind == "compliance" else place[:, 0]
            slack = loop_slack(program.form, program.filtered, kind)
            found = guarantee(slack, figures, inner, logarithms, frequency, place[:, 1]) + log(limits[kind])
            slacks.append(found - (_INSIDE if kind == "compliance" else inside))
            places.append(place)
        self._solver = ca.nlpsol(
            "loop",
            "ipopt",
            {
                "x": variables,
                "p": ca.vertcat(*map(ca.vec, places), inside),
                "f": program.objective(variables),
                "g": ca.vertcat(*slacks, program.structure(variables)),
            },
            {
                "print_time": False,
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
                "ipopt.max_iter": 150,
                "ipopt.tol": 1e-8,
                "ipopt.mu_init": 1e-3,
                "ipopt.bound_relax_factor": 0.0,
            },
        )

    def holds(self, points: CheckPoints) -> bool:
        """Whether there are slots for all of the points."""
        return all(len(points[kind]) <= slots for kind, slots in self._slots.items())

    def __call__(self, start: np.ndarray, points: CheckPoints, inside: float, reach: float) -> np.ndarray:
        """Minimise the objective with the guarantee enforced at the points.

        Args:
            start: variables to begin from.
            points: where both limits are enforced.
            inside: how far inside the limit of sensitivity, in logarithms.
            reach: how far each variable may move.

        Returns:
            The variables where IPOPT stopped, whatever its status: only a proof of the result counts.
        """
        slots = [
            np.vstack([given, np.repeat(given[:1], self._slots[kind] - len(given), axis=0)]).ravel(order="F")
            for kind, given in points.items()
        ]
        lower, upper = np.maximum(self._program.lower, start - reach), np.minimum(self._program.upper, start + reach)
        given = np.concatenate([*slots, [inside]])
        with interruption_waits():
            found = self._solver(x0=start, p=given, lbx=lower, ubx=upper, lbg=0.0, ubg=ca.inf)
        return np.clip(np.asarray(found["x"]).ravel(), lower, upper)


def _with_peaks(points: CheckPoints, program: LoopProgram, anchor: np.ndarray) -> CheckPoints:
    """Also enforce the sensitivity at the higher peaks of the loop that a refinement departs from.

    A sharp peak between check points is a gap in the fence around the stable loops, through which a step can pass.
    """
    count, (low, high) = program.form.size, program.outer_end_mass_kg
    members = program.members(anchor[count + 2 :])
    if members is None:
        return points
    controller = program.form.record(anchor[:count])
    loops = loop_set(members, controller, float(anchor[count]), (low, high))
    for loop in loops.ends():
        for frequency, mass in high_peaks(loop, low, high, _HIGH_PEAK * program.goal.peak_sensitivity):
            points = with_peak(points, "peak_sensitivity", frequency, mass)
    return points


def _with_refuted(
    points: CheckPoints, loops: LoopSet, refuted: Sequence[tuple[Claim, int]], program: LoopProgram
) -> CheckPoints:
    """Also enforce each refuted limit where its proof failed, and at the worst peak that sampling shows."""
    low, high = program.outer_end_mass_kg
    for claim, _ in refuted:
        from_Hz = claim.from_Hz or 0.0
        assert claim.witness_frequency_Hz is not None
        assert claim.witness_outer_end_mass_kg is not None
        witness = (claim.witness_frequency_Hz, claim.witness_outer_end_mass_kg)
        sampled = [(*largest_sampled(loop, claim.kind, low, high, from_Hz), loop) for loop in loops.ends()]
        worst = max(sampled, key=lambda found: found[0])
        for place in (witness, worst[1:3]):
            peak = peak_near(worst[3], claim.kind, *place, low, high, from_Hz)
            points = with_peak(points, claim.kind, *peak, from_Hz)
    return points


def refine(program: LoopProgram, start: np.ndarray, needed_Hz: float = 0.0) -> Refinement:
    """Refine one start in rounds; each enforces what the last proof refuted.

    Args:
        program: what is optimised.
        start: variables to begin from.
        needed_Hz: bandwidth below which a proved loop is no answer.
    """
    count = program.form.size
    low, high = program.outer_end_mass_kg
    points, inside, within = check_points(low, high, program.goal), _INSIDE, program.reach
    solver = _Solver(program, points)
    anchor, best = np.clip(start, program.lower, program.upper), None
    fenced: np.ndarray | None = None  # the anchor whose peaks are check points already
    reason, certificates = "no round of refinement was proved", 0
    while certificates < ROUNDS and within > _SMALLEST_REACH:
        if not solver.holds(points):
            solver = _Solver(program, points)
        variables = solver(anchor, points, inside, within)
        if not np.isfinite(variables).all():
            return Refinement(best, certificates, "" if best else "the refinement lost its way: figures not finite")
        members = program.members(variables[count + 2 :])
        if members is None:
            reason = "the refined sizes are no pair of tubes"
            within *= 0.4
            continue
        controller = program.form.record(variables[:count])
        inner = round(float(variables[count]), 6)
        loops = loop_set(members, controller, inner, (low, high))
        certificates += 1
        if loops.unstable():
            reason = "the refined loop is not stable over the whole range"
            if fenced is anchor:
                within *= 0.4
            else:
                points, fenced = _with_peaks(points, program, anchor), anchor
            continue
        moved, anchor = float(np.abs(variables - anchor).max()), variables
        refuted = loops.refuted(program.goal)
        if refuted:
            reason = f"{refuted[0][0].kind.replace('_', ' ')} refuted: {refuted[0][0].reason}"
            points = _with_refuted(points, loops, refuted, program)
            excess = loops.excess(program.goal)
            if moved < _STUCK:
                inside += excess
            else:
                inside = _INSIDE + (excess if excess < program.tighten_below else 0.0)
            continue
        bandwidth = min(*loops.bandwidths(program.goal.compliance_m_per_N).values(), LARGEST_BANDWIDTH_HZ)
        flaw = program.flaw(variables)
        if bandwidth < needed_Hz:
            reason = f"guarantees {bandwidth:.4g} Hz, {needed_Hz:.4g} Hz are needed"
        elif flaw:
            reason = flaw
        else:
            peak = min(loops.peak_sensitivity(), program.goal.peak_sensitivity)
            found = Proved(controller, inner, bandwidth, peak, variables)
            best = found if best is None else min(best, found, key=program.cost)
        aimed = exp(variables[count + 1])
        if bandwidth < aimed * (1 - 1e-4) or bandwidth < needed_Hz <= aimed:  # refuted between the check points
            points = with_share(points, max(bandwidth / aimed, _SMALLEST_SHARE), low + SHARES * (high - low))
        elif moved < 0.99 * within:
            break
    return Refinement(best, certificates, "" if best else reason)
