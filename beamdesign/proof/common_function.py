"""Candidates for Lyapunov functions that several loops share, or one for each, from semidefinite programs.

As in `beamdesign.proof.lmi`, nothing here is a result: what a solver returns is decided in rationals elsewhere. All
loops are in the same states; see `beamdesign.proof.stage_family`.
"""

from collections.abc import Callable, Sequence

import numpy as np

from beamdesign.proof.decrease import extremes
from beamdesign.proof.definite import bernstein
from beamdesign.proof.lmi import Answer, Scaled, Sought, at, factor, maximise_margin, slowest_decay
from beamdesign.proof.mass_family import MassFamily

Families = Sequence[MassFamily]

SolveTogether = Callable[[Families, Sought, np.ndarray, str], Answer]
"""How a common candidate is obtained: families, what is sought, coordinates, name of the solver."""


def solve_together(families: Families, sought: Sought, coordinates: np.ndarray, solver: str = "CLARABEL") -> Answer:
    """Maximise the margin of one P(m) that falls along every family; as `beamdesign.proof.lmi.solve` does for one."""
    scaled = _scaled(families, sought, coordinates)
    identity = np.eye(families[0].order)
    basis = scaled[0].basis(sought.degree)
    values = bernstein(list(np.moveaxis(basis, 1, 0)), scaled[0].low, scaled[0].high)
    constraints = [(v, 0.0, identity) for v in values] + [(-v, 1.0, 0 * identity) for v in values]
    cases = extremes(sought.joining) if sought.rate and sought.degree else ((0, 0),)
    for one, family in zip(scaled, families, strict=True):
        slowest = abs(slowest_decay(family, sought.low, sought.high)) / one.pace
        for case in cases:
            constraints += [(f, 0.0, slowest * identity) for f in one.decrease(basis, sought, *case)]
    status, margin, weights = maximise_margin(constraints, solver)
    if weights is None:
        return Answer(solver, status, False, (), None)
    inner = np.tensordot(weights, basis, axes=1)
    return scaled[0].answer(solver, status, status.startswith("optimal") and margin > 0, inner)


def solve_together_across_jumps(
    families: Families, sought: Sought, coordinates: np.ndarray, solver: str = "CLARABEL"
) -> Answer:
    """Minimise g of I <= P(m) and J' P(m) J <= g I while P(m) falls along every family at the decay that is sought."""
    scaled = _scaled(families, sought, coordinates)
    first, identity = scaled[0], np.eye(families[0].order)
    basis = first.basis(sought.degree)
    values = bernstein(list(np.moveaxis(basis, 1, 0)), first.low, first.high)
    share = 1.0 if sought.joining == "matched" else float((first.bare + first.low) / (first.bare + first.high))
    jump = identity - (1 - share) * first.pick
    constraints = [(v, -1.0, 0 * identity) for v in values] + [(-v, 0.0, identity) for v in values]
    constraints += [(-(jump.T @ v @ jump), 0.0, identity) for v in values]
    for one, family in zip(scaled, families, strict=True):
        constraints += _falling(one, family, sought, basis)
    status, _, weights = maximise_margin(constraints, solver, most=-1.0)
    if weights is None:
        return Answer(solver, status, False, (), None)
    return first.answer(solver, status, status.startswith("optimal"), np.tensordot(weights, basis, axes=1))


def solve_one_each(
    families: Families, sought: Sought, coordinates: np.ndarray, solver: str = "CLARABEL"
) -> tuple[Answer, ...]:
    """Minimise g of I <= P_i(m) <= g I while each P_i(m) falls along its own family at the decay that is sought.

    Returns:
        one answer for each family, all with the same coordinates to go on in: those of the mean of all functions.
    """
    scaled = _scaled(families, sought, coordinates)
    first, identity, count = scaled[0], np.eye(families[0].order), len(families)
    own = first.basis(sought.degree)
    size = len(own)
    constraints = []
    for k, (one, family) in enumerate(zip(scaled, families, strict=True)):
        basis = np.zeros((size * count, *own.shape[1:]))
        basis[k * size : (k + 1) * size] = own
        values = bernstein(list(np.moveaxis(basis, 1, 0)), one.low, one.high)
        constraints += [(v, -1.0, 0 * identity) for v in values] + [(-v, 0.0, identity) for v in values]
        constraints += _falling(one, family, sought, basis)
    status, _, weights = maximise_margin(constraints, solver, most=-1.0)
    if weights is None:
        return tuple(Answer(solver, status, False, (), None) for _ in families)
    inner = [np.tensordot(weights[k * size : (k + 1) * size], own, axes=1) for k in range(count)]
    claims, middle = status.startswith("optimal"), (first.low + first.high) / 2
    mean = sum(p * middle**k for each in inner for k, p in enumerate(each)) / count
    try:
        onward = factor(mean) @ coordinates
    except np.linalg.LinAlgError:
        onward = None
    answers = [one.answer(solver, status, claims, each) for one, each in zip(scaled, inner, strict=True)]
    return tuple(Answer(solver, status, claims, answer.coefficients, onward) for answer in answers)


def _falling(
    one: Scaled, family: MassFamily, sought: Sought, basis: np.ndarray
) -> list[tuple[np.ndarray, float, np.ndarray]]:
    room = 0.02 * abs(slowest_decay(family, sought.low, sought.high)) / one.pace  # for the exact check
    return [(f, -room, np.zeros(f.shape[1:])) for f in one.decrease(basis, sought, 0, 0)]


def _scaled(families: Families, sought: Sought, coordinates: np.ndarray) -> list[Scaled]:
    """All families in one unit of time, that of their mean."""
    middle = (sought.low + sought.high) / 2
    poles = np.concatenate([np.linalg.eigvals(at(family, middle)) for family in families])
    pace = float(np.exp(np.mean(np.log(np.abs(poles) + 1e-3))))
    return [Scaled(family, sought, coordinates, pace) for family in families]
