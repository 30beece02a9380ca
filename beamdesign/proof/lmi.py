"""Candidates for Lyapunov functions from semidefinite programs, in coordinates in which the stiff plant is tame.

Nothing here is a result. What a solver returns, and whatever it says about it, goes to `beamdesign.proof.decrease`,
which decides in rationals.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import fmpq

from beamdesign.proof.decrease import Joining, Terms, decrease, extremes
from beamdesign.proof.definite import bernstein
from beamdesign.proof.mass_family import MassFamily, floats

SOLVERS = ("CLARABEL", "SCS")
ZERO = fmpq(0)


@dataclass(frozen=True)
class Answer:
    """What a solver says.

    Attributes:
        solver: its name.
        status: its own word, such as "optimal"; or the error it ended in.
        claims: whether it claims to have found a function: a status of success and a positive margin.
        coefficients: of P(m), ascending in m, (n, n) each in SI; empty where it returned nothing.
        coordinates: (n, n) map from the state to coordinates in which P at mid-range is the identity: those to solve
            the next, harder problem in. None where P at mid-range is not positive definite even in floats.
    """

    solver: str
    status: str
    claims: bool
    coefficients: tuple[np.ndarray, ...]
    coordinates: np.ndarray | None


@dataclass(frozen=True)
class Sought:
    """What is asked of V = x' P(m) x between two masses.

    Attributes:
        low: kg.
        high: kg.
        degree: of P in m; 0 for a common P, which settles all matched changes.
        rate: bound on |dm/dt|, kg/s; of no meaning for degree 0.
        joining: how payload joins.
        decay: 1/s, V falls as exp(-2 decay t).
    """

    low: fmpq
    high: fmpq
    degree: int = 0
    rate: fmpq = ZERO
    joining: Joining = "matched"
    decay: fmpq = ZERO


Solve = Callable[[MassFamily, Sought, np.ndarray, str], Answer]
"""How a candidate is obtained: family, what is sought, coordinates, name of the solver."""


def at(family: MassFamily, mass: fmpq) -> np.ndarray:
    """A(m) in floats."""
    return floats(family.at(mass))


def slowest_decay(family: MassFamily, low: fmpq, high: fmpq) -> float:
    """The lesser decay rate of the two ends, 1/s, sampled; negative for an unstable one."""
    return min(-max(np.linalg.eigvals(at(family, mass)).real) for mass in (low, high))


def modal_coordinates(a: np.ndarray) -> np.ndarray:
    """(n, n) map T from the state to modal coordinates, in which a stable A has the identity as a Lyapunov function.

    T A T^-1 has a block of 1 or 2 for each pole: entries are of the order of the poles, whatever the units of the
    state. Where the modes are too nearly parallel, a Lyapunov function in balanced units takes their place, or for an
    unstable A those units alone.
    """
    from scipy.linalg import matrix_balance, solve_continuous_lyapunov

    balanced, scales = matrix_balance(a, permute=False, separate=True)
    scale = np.diag(1 / scales[0])
    poles, vectors = np.linalg.eig(balanced)
    columns: list[np.ndarray] = []
    for pole, vector in zip(poles, vectors.T, strict=True):
        if pole.imag > 0:
            columns += [vector.real, vector.imag]
        elif pole.imag == 0:
            columns.append(vector.real)
    modes = np.array(columns).T
    if np.linalg.cond(modes) < 1e8:
        return np.linalg.inv(modes) @ scale
    if poles.real.max() >= 0:
        return scale
    function = solve_continuous_lyapunov(balanced.T, -np.eye(len(a)) * np.abs(poles).max())
    return factor((function + function.T) / 2) @ scale


def factor(positive: np.ndarray) -> np.ndarray:
    """R with R' R equal to a positive definite matrix.

    Raises:
        numpy.linalg.LinAlgError: where it is not positive definite in floats.
    """
    return np.linalg.cholesky(positive).T


def lyapunov_candidates(family: MassFamily, low: fmpq, high: fmpq) -> list[np.ndarray]:
    """Common P without a program: Lyapunov functions of the middle, and the sum of those of both ends, (n, n), SI."""
    from scipy.linalg import solve_continuous_lyapunov

    total_low, total_high = family.bare_mass + low, family.bare_mass + high
    middle = 2 * total_low * total_high / (total_low + total_high) - family.bare_mass
    t = modal_coordinates(at(family, middle))
    inverse = np.linalg.inv(t)
    found = []
    for mass in (middle, low, high):
        a = t @ at(family, mass) @ inverse
        function = solve_continuous_lyapunov(a.T, -np.eye(len(a)))
        found.append(t.T @ function @ t)
    return [t.T @ t, found[0], found[1] + found[2]]


def solve(family: MassFamily, sought: Sought, coordinates: np.ndarray, solver: str = "CLARABEL") -> Answer:
    """Maximise the margin t of t I <= P(m) <= I and -W dV/dt >= t c W I in the given coordinates z = T x.

    The identity is feasible with t of about 1 where it is a Lyapunov function already, so the margin says how far the
    coordinates are from ideal; c is the slowest decay rate.

    Args:
        family: the closed loop.
        sought: what is asked of V.
        coordinates: T, (n, n); the identity matrix leaves the problem in SI.
        solver: of `SOLVERS`.
    """
    scaled = Scaled(family, sought, coordinates)
    identity = np.eye(family.order)
    basis = scaled.basis(sought.degree)
    values = bernstein(list(np.moveaxis(basis, 1, 0)), scaled.low, scaled.high)
    falls = [f for case in _cases(sought) for f in scaled.decrease(basis, sought, *case)]
    slowest = abs(slowest_decay(family, sought.low, sought.high)) / scaled.pace
    constraints = [(v, 0.0, identity) for v in values]
    constraints += [(-v, 1.0, np.zeros_like(identity)) for v in values]
    constraints += [(f, 0.0, slowest * identity) for f in falls]
    status, margin, weights = maximise_margin(constraints, solver)
    if weights is None:
        return Answer(solver, status, False, (), None)
    inner = np.tensordot(weights, basis, axes=1)
    return scaled.answer(solver, status, status.startswith("optimal") and margin > 0, inner)


def solve_across_jumps(family: MassFamily, sought: Sought, coordinates: np.ndarray, solver: str = "CLARABEL") -> Answer:
    """Minimise g of I <= P(m) and J' P(m) J <= g I at a fixed decay rate: little growth of V at sudden changes.

    Args:
        family: the closed loop.
        sought: of degree 0 or 1; its rate is not used, the mass stays between the changes.
        coordinates: T, (n, n).
        solver: of `SOLVERS`.
    """
    scaled = Scaled(family, sought, coordinates)
    identity = np.eye(family.order)
    basis = scaled.basis(sought.degree)
    values = bernstein(list(np.moveaxis(basis, 1, 0)), scaled.low, scaled.high)
    falls = scaled.decrease(basis, sought, 0, 0)
    share = 1.0 if sought.joining == "matched" else float((scaled.bare + scaled.low) / (scaled.bare + scaled.high))
    jump = identity - (1 - share) * scaled.pick
    # The margin is maximised, so the sign of g is turned: P >= I, J' P J <= -t I with t = -g.
    constraints = [(v, -1.0, 0 * identity) for v in values]
    constraints += [(-v, 0.0, identity) for v in values]
    constraints += [(-(jump.T @ v @ jump), 0.0, identity) for v in values]
    room = 0.02 * abs(slowest_decay(family, sought.low, sought.high)) / scaled.pace  # for the exact check
    constraints += [(f, -room, 0 * identity) for f in falls]
    status, _, weights = maximise_margin(constraints, solver, most=-1.0)
    if weights is None:
        return Answer(solver, status, False, (), None)
    inner = np.tensordot(weights, basis, axes=1)
    return scaled.answer(solver, status, status.startswith("optimal"), inner)


def _cases(sought: Sought) -> tuple[tuple[int, int], ...]:
    return extremes(sought.joining) if sought.rate and sought.degree else ((0, 0),)


class Scaled:
    """The family in coordinates z = T x, in units of its total mass at mid-range and of the time of its mean pole.

    A pace (1/s) takes the place of the mean pole where it is given.
    """

    def __init__(self, family: MassFamily, sought: Sought, coordinates: np.ndarray, pace: float | None = None):
        inverse = np.linalg.inv(coordinates)
        self.coordinates = coordinates
        middle = (sought.low + sought.high) / 2
        self.unit = float(family.bare_mass + middle)
        own = float(np.exp(np.mean(np.log(np.abs(np.linalg.eigvals(at(family, middle))) + 1e-3))))
        self.pace = own if pace is None else pace
        self.bare = float(family.bare_mass) / self.unit
        self.low, self.high = float(sought.low) / self.unit, float(sought.high) / self.unit
        self.fixed = coordinates @ floats(family.fixed) @ inverse / self.pace
        self.inertial = coordinates @ floats(family.inertial) @ inverse / self.pace / self.unit
        self.pick = np.outer(coordinates[:, family.velocity], inverse[family.velocity])

    def basis(self, degree: int) -> np.ndarray:
        """One symmetric matrix after another as coefficient of one power of m: (count, degree + 1, n, n)."""
        n = len(self.fixed)
        pairs = [(i, j) for i in range(n) for j in range(i, n)]
        basis = np.zeros((len(pairs) * (degree + 1), degree + 1, n, n))
        for k in range(degree + 1):
            for p, (i, j) in enumerate(pairs):
                basis[k * len(pairs) + p, k, i, j] = basis[k * len(pairs) + p, k, j, i] = 1.0
        return basis

    def decrease(self, basis: np.ndarray, sought: Sought, sign: int, resting: int) -> list[np.ndarray]:
        """Bernstein coefficients of -W (dV/dt + 2 decay V) for each member of the basis, (count, n, n) each."""

        def both(left: np.ndarray, p: np.ndarray) -> np.ndarray:
            return left.T @ p + p @ left

        terms = [
            Terms(p, both(self.fixed, p), both(self.inertial, p), both(self.pick, p)) for p in np.moveaxis(basis, 1, 0)
        ]
        rate, decay = sign * float(sought.rate) / self.unit / self.pace, float(sought.decay) / self.pace
        return bernstein(decrease(terms, self.bare, decay, rate, resting), self.low, self.high)

    def answer(self, solver: str, status: str, claims: bool, inner: np.ndarray) -> Answer:
        """An answer in SI from coefficients in scaled mass and coordinates."""
        middle = (self.low + self.high) / 2
        coefficients = tuple(self.coordinates.T @ p @ self.coordinates / self.unit**k for k, p in enumerate(inner))
        try:
            coordinates = factor(sum(p * middle**k for k, p in enumerate(inner))) @ self.coordinates
        except np.linalg.LinAlgError:
            coordinates = None
        return Answer(solver, status, claims, coefficients, coordinates)


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
