"""Candidates for Lyapunov functions from semidefinite programs, in coordinates in which the stiff plant is tame.

They are sought for several closed loops in the same states, the stages, or for one, which is the case of one stage.
What a solver returns, and whatever it says about it, is no result: it goes to `beamdesign.proofs.decrease`, which
decides in rationals, and what that leaves of it is what is proved of a `Course`.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from operator import matmul
from typing import Any, Literal

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proofs.decrease import ZERO, Joining, Sought, bernstein, decrease, not_falling
from beamdesign.proofs.mass_family import Cycle, MassFamily, at, floats, modal_coordinates, rationals

SOLVERS = ("CLARABEL", "SCS")


@dataclass(frozen=True)
class Answer:
    """What a solver says.

    Attributes:
        solver: its name.
        status: its own word, such as "optimal"; or the error it ended in.
        claims: whether it claims to have found functions: a status of success and a positive margin.
        functions: of each P(m) the coefficients, ascending in m, (n, n) each in SI; none where it returned nothing.
        coordinates: (n, n) map from the state to coordinates in which P at mid-range, or the mean of several, is the
            identity: those to solve the next, harder problem in. None where that is not positive definite even in
            floats.
    """

    solver: str
    status: str
    claims: bool = False
    functions: tuple[tuple[np.ndarray, ...], ...] = ()
    coordinates: np.ndarray | None = None


def slowest_decay(sought: Sought, family: MassFamily) -> float:
    """The least decay rate of a family at the two ends, 1/s, sampled; negative for an unstable one."""
    return min(-max(np.linalg.eigvals(at(family, mass)).real) for mass in (sought.low, sought.high))


def lyapunov_candidates(sought: Sought) -> list[np.ndarray]:
    """Common P without a program: Lyapunov functions of the middle, and the sum of those of both ends, (n, n), SI."""
    from scipy.linalg import solve_continuous_lyapunov

    families, low, high = sought.families, sought.low, sought.high
    total_low, total_high = families[0].bare_mass + low, families[0].bare_mass + high
    middle = 2 * total_low * total_high / (total_low + total_high) - families[0].bare_mass
    t = modal_coordinates(at(families[len(families) // 2], middle))
    inverse = np.linalg.inv(t)
    found = []
    for mass in (middle, low, high):
        loops = [t @ at(family, mass) @ inverse for family in families]
        function = sum(solve_continuous_lyapunov(a.T, -np.eye(len(a))) for a in loops)
        found.append(t.T @ function @ t)
    return [t.T @ t, found[0], found[1] + found[2]]


def solve(sought: Sought, coordinates: np.ndarray, solver: str) -> Answer:
    """Maximise the margin t of t I <= P(m) <= I and -W dV/dt >= t c W I along every family, in coordinates z = T x.

    The identity is feasible with t of about 1 where it is a Lyapunov function already, so the margin says how far the
    coordinates are from ideal; c is the slowest decay rate of a family.

    Args:
        sought: what is asked of V.
        coordinates: T, (n, n); the identity matrix leaves the problem in SI.
        solver: of `SOLVERS`.
    """
    scaled = _scaled(sought, coordinates)
    first, identity = scaled[0], np.eye(len(coordinates))
    basis = first.basis(sought.degree)
    values = bernstein(list(np.moveaxis(basis, 1, 0)), first.low, first.high)
    constraints = [(v, 0.0, identity) for v in values] + [(-v, 1.0, 0 * identity) for v in values]
    for one in scaled:
        slowest = abs(one.slowest) / one.pace
        for case in sought.extremes:
            constraints += [(f, 0.0, slowest * identity) for f in one.decrease(basis, sought, *case)]
    status, margin, weights = maximise_margin(constraints, solver)
    if weights is None:
        return Answer(solver, status)
    inner = np.tensordot(weights, basis, axes=1)
    claims = status.startswith("optimal") and margin > 0
    return Answer(solver, status, claims, (first.in_si(inner),), first.onward(inner))


def solve_one_each(sought: Sought, coordinates: np.ndarray, count: int) -> Answer:
    """Minimise g of I <= P_i(m) <= g I while each P_i(m) falls along its own family at the decay that is sought.

    Of one function for all families it is P(m) and J' P(m) J with the jumps J of the payload that are to stay in these
    bounds: little growth of V at sudden changes.

    Args:
        sought: of degree 0 or 1; its rate is not used, the mass stays between the changes.
        coordinates: T, (n, n).
        count: of functions: as many as there are families, or 1 for one that falls along all of them.
    """
    solver, scaled = SOLVERS[0], _scaled(sought, coordinates)
    first, identity = scaled[0], np.eye(len(coordinates))
    own = first.basis(sought.degree)
    size, constraints, bases = len(own), [], []
    share = (
        1.0 if sought.joining == "matched" else float((first.bare_mass + first.low) / (first.bare_mass + first.high))
    )
    # Of a common function both, though of matched payload they agree: a solver then keeps further from the bound.
    jumps = [identity] if count > 1 else [identity, identity - (1 - share) * first.pick]
    for k in range(count):
        basis = np.zeros((size * count, *own.shape[1:]))
        basis[k * size : (k + 1) * size] = own
        bases.append(basis)
        values = bernstein(list(np.moveaxis(basis, 1, 0)), first.low, first.high)
        # The margin is maximised, so the sign of g is turned: P >= I, J' P J <= -t I with t = -g.
        constraints += [(v, -1.0, 0 * identity) for v in values]
        constraints += [(-(jump.T @ v @ jump), 0.0, identity) for jump in jumps for v in values]
    for k, one in enumerate(scaled):
        room = 0.02 * abs(one.slowest) / one.pace  # for the exact check
        constraints += [(f, -room, 0 * identity) for f in one.decrease(bases[k if count > 1 else 0], sought, 0, 0)]
    status, _, weights = maximise_margin(constraints, solver, most=-1.0)
    if weights is None:
        return Answer(solver, status)
    inner = [np.tensordot(weights[k * size : (k + 1) * size], own, axes=1) for k in range(count)]
    onward = first.onward(np.mean(inner, axis=0))
    return Answer(solver, status, status.startswith("optimal"), tuple(map(first.in_si, inner)), onward)


class Scaled:
    """The family in coordinates z = T x, in units of its total mass at mid-range and of a time, 1 / pace (s)."""

    def __init__(self, family: MassFamily, sought: Sought, coordinates: np.ndarray, pace: float):
        inverse = np.linalg.inv(coordinates)
        self.coordinates = coordinates
        middle = (sought.low + sought.high) / 2
        self.unit = float(family.bare_mass + middle)
        self.pace, self.slowest = pace, slowest_decay(sought, family)
        self.bare_mass = float(family.bare_mass) / self.unit
        self.low, self.high = float(sought.low) / self.unit, float(sought.high) / self.unit
        self.fixed = coordinates @ floats(family.fixed) @ inverse / self.pace
        self.inertial = coordinates @ floats(family.inertial) @ inverse / self.pace / self.unit
        self.pick = np.outer(coordinates[:, family.velocity], inverse[family.velocity])

    def basis(self, degree: int) -> np.ndarray:
        """One symmetric matrix after another as coefficient of one power of m: (count, degree + 1, n, n)."""
        rows, columns = np.triu_indices(n := len(self.fixed))
        pairs, basis = range(len(rows)), np.zeros((degree + 1, len(rows), degree + 1, n, n))
        for k in range(degree + 1):
            basis[k, pairs, k, rows, columns] = basis[k, pairs, k, columns, rows] = 1.0
        return basis.reshape(-1, degree + 1, n, n)

    def decrease(self, basis: np.ndarray, sought: Sought, sign: int, resting: int) -> list[np.ndarray]:
        """Bernstein coefficients of -W (dV/dt + 2 decay V) for each member of the basis, (count, n, n) each."""
        rate, decay = sign * float(sought.rate) / self.unit / self.pace, float(sought.decay) / self.pace
        found = decrease(self, np.moveaxis(basis, 1, 0), decay, rate, resting, matmul)
        return bernstein(found, self.low, self.high)

    def in_si(self, inner: np.ndarray) -> tuple[np.ndarray, ...]:
        """Coefficients of P(m) in SI from those in scaled mass and coordinates."""
        return tuple(self.coordinates.T @ p @ self.coordinates / self.unit**k for k, p in enumerate(inner))

    def onward(self, inner: np.ndarray) -> np.ndarray | None:
        """Coordinates in which such a P at mid-range is the identity; None where it is not positive definite."""
        middle = (self.low + self.high) / 2
        try:
            return np.linalg.cholesky(sum(p * middle**k for k, p in enumerate(inner))).T @ self.coordinates
        except np.linalg.LinAlgError:
            return None


def _scaled(sought: Sought, coordinates: np.ndarray) -> list[Scaled]:
    """All families in one unit of time, that of their mean."""
    middle = (sought.low + sought.high) / 2
    poles = np.concatenate([np.linalg.eigvals(at(family, middle)) for family in sought.families])
    pace = float(np.exp(np.mean(np.log(np.abs(poles) + 1e-3))))
    return [Scaled(family, sought, coordinates, pace) for family in sought.families]


def maximise_margin(
    constraints: Sequence[tuple[np.ndarray, float, np.ndarray]], solver: str, most: float = 1.0
) -> tuple[str, float, np.ndarray | None]:
    """Maximise t <= most subject to sum_i w_i B_i + constant I - t M >= 0 for each (B, constant, M).

    Returns:
        the solver's status, t, and the weights w, or None where it returned none.
    """
    import cvxpy as cp

    count, n, _ = constraints[0][0].shape
    unknown: Any = cp.Variable(count + 1)
    conditions = [unknown[count] <= most]
    for basis, constant, margin in constraints:
        symmetric = (basis + np.swapaxes(basis, 1, 2)) / 2
        matrix = np.column_stack([symmetric.reshape(count, n * n).T, -margin.reshape(n * n)])
        conditions.append(cp.reshape(matrix @ unknown, (n, n), order="C") + constant * np.eye(n) >> 0)
    problem: Any = cp.Problem(cp.Maximize(unknown[count]), conditions)
    with warnings.catch_warnings():
        # The solver's doubts are no news: its answer is checked in rationals whatever it says.
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            problem.solve(solver=solver)
        except cp.error.SolverError as error:
            return f"failed: {error}", 0.0, None
    if unknown.value is None or not np.all(np.isfinite(unknown.value)):
        return str(problem.status), 0.0, None
    return str(problem.status), float(unknown.value[count]), unknown.value[:count]


# What the exact check leaves of them.


NONE_FOUND = "no function was found"
Status = Literal["proved", "unverified", "refuted", "undecided"]
"""proved: verified in rationals. unverified: a solver claims it and the exact check does not confirm it, which is
worth nothing. refuted: a counterexample was verified. undecided: neither."""
Coefficients = tuple[fmpq_mat, ...]
"""Of P(m) in V = x' P(m) x, ascending in m, (n, n) each, exact, SI."""


@dataclass(frozen=True)
class Course:
    """What is proved of one kind of course of payload and stage.

    Attributes:
        status: see `Status`; for the whole range, and for the rate asked for or the largest one found.
        reason: in words, why it is not proved, or of stages not at any time; empty where it is.
        joining: how payload joins.
        functions: coefficients of P(m), of one common function or of one for each stage; none where nothing is proved.
        proved_up_to_kg: of any change, from the least mass up to here it is proved; the whole range, part of it, or
            None.
        rate_kg_per_s: bound on |dm/dt|; None where nothing is proved.
        refused_kg_per_s: least rate that was tried and not proved; None where the search ended at `LARGEST_RATE`, or
            was for one rate alone.
        dwell_s: average time between sudden changes that is proved to be enough, 0 where they may come at any time;
            None where nothing is proved.
        factor: growth of V at a change.
        decay_per_s: decay rate of |x| between changes.
        counterexample: a cycle of masses, or of stages, under which the motion grows, if one was found.
    """

    status: Status
    reason: str = ""
    joining: Joining = "matched"
    functions: tuple[Coefficients, ...] = ()
    proved_up_to_kg: float | None = None
    rate_kg_per_s: float | None = None
    refused_kg_per_s: float | None = None
    dwell_s: fmpq | None = None
    factor: fmpq = ZERO
    decay_per_s: fmpq = ZERO
    counterexample: Cycle | None = None

    @property
    def coefficients(self) -> Coefficients:
        """Those of the first function; empty where nothing is proved."""
        return self.functions[0] if self.functions else ()

    @property
    def claimed(self) -> str:
        """The claim of a solver that the exact check refused, in words; empty where there is none."""
        return self.reason if self.status == "unverified" else ""

    @property
    def kind(self) -> Literal["any_time", "dwell", "none"]:
        """Of sudden changes: whether they may come at any time, or after a dwell."""
        if self.status != "proved" or self.dwell_s is None:
            return "none"
        return "dwell" if self.dwell_s else "any_time"

    def suffices(self, dwell_s: float) -> bool:
        """Whether changes at least so far apart are proved to be stable."""
        return self.status == "proved" and self.dwell_s is not None and self.dwell_s <= exact(dwell_s)


Found = tuple[Course, np.ndarray]
"""What is proved, and coordinates (n, n) to solve the next, harder problem in."""


def sought_with(sought: Sought, coordinates: np.ndarray, solvers: Sequence[str] = SOLVERS[:1]) -> Found:
    """Ask solvers, one after another, until an answer passes the exact check.

    Args:
        sought: what is asked of V.
        coordinates: (n, n), to solve in.
        solvers: their names.

    Returns:
        what the exact check left of the answers, and coordinates (n, n) to solve the next, harder problem in.
    """
    found, onward = Course("undecided", NONE_FOUND, sought.joining), coordinates
    for solver in solvers:
        answer = solve(sought, coordinates, solver)
        if not answer.functions:
            continue
        onward = coordinates if answer.coordinates is None else answer.coordinates
        coefficients, wrong = checked(sought, answer.functions[0])
        if not wrong:
            return Course("proved", "", sought.joining, (coefficients,)), onward
        if answer.claims:
            found = refused(answer, wrong, sought.joining)
    return found, onward


def checked(sought: Sought, candidate: Sequence[np.ndarray]) -> tuple[Coefficients, str]:
    """Coefficients of P(m), (n, n) each, rounded to decimals, and what the exact check finds wrong with them."""
    if not all(np.all(np.isfinite(p)) for p in candidate):
        return (), "the candidate is not finite"
    coefficients = tuple(rationals(p) for p in candidate)
    wrong = not_falling(sought, coefficients)
    return () if wrong else coefficients, wrong


def refused(answer: Answer, wrong: str, joining: Joining) -> Course:
    """A solver's claim that the exact check refuses."""
    words = f"{answer.solver} says {answer.status}, the exact check refuses it ({wrong})"
    return Course("unverified", words, joining)
