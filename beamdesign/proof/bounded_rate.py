"""Payload that changes at a bounded rate: a Lyapunov function that depends on the mass, and the largest rate proved."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.proof.any_change import Status
from beamdesign.proof.decrease import Joining, holds_at_rate
from beamdesign.proof.lmi import SOLVERS, Answer, Solve, Sought, solve
from beamdesign.proof.mass_family import MassFamily, rationals
from beamdesign.proof.rational import nearest, shortened

FIRST_RATE, LEAST_RATE, LARGEST_RATE = 16.0, 1e-3, 1e6
"""kg/s at which the search starts, below which it gives up, and above which it does not ask."""
RESOLUTION = 1.05
"""The largest rate proved is known to lie within this factor of one that was not proved."""
DEGREES = (1, 2)
"""Of P in m, tried in this order."""

Update = Callable[[float, str], object]
"""Takes the share of the work done and a word on what is being done."""


def quiet(fraction: float, text: str = "") -> None:
    """Report no progress."""


@dataclass(frozen=True)
class BoundedRate:
    """Stability for every m(t) within a range that changes at no more than a given rate.

    Attributes:
        status: see `beamdesign.proof.any_change.Status`; for the rate asked for, or for the largest one found.
        reason: in words, why it is not proved; empty where it is.
        joining: how payload joins.
        rate_kg_per_s: bound on |dm/dt|; None where nothing is proved.
        coefficients: of P(m) in V = x' P(m) x, ascending in m, (n, n) each, exact, SI.
        refused_kg_per_s: least rate that was tried and not proved; None where the search ended at `LARGEST_RATE`, or
            was for one rate alone.
    """

    status: Status
    reason: str
    joining: Joining
    rate_kg_per_s: float | None
    coefficients: tuple[fmpq_mat, ...]
    refused_kg_per_s: float | None = None


@dataclass(frozen=True)
class _Try:
    """One rate: the verified function, or what was wrong; and coordinates to go on from."""

    coefficients: tuple[fmpq_mat, ...]
    reason: str
    claimed: bool
    coordinates: np.ndarray


def bounded_rate(
    family: MassFamily,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    coordinates: np.ndarray,
    wanted: fmpq | None = None,
    solve: Solve = solve,
    update: Update = quiet,
) -> BoundedRate:
    """Prove stability up to a rate of change, or find the largest rate that can be proved.

    Args:
        family: the closed loop, stable at every mass that stays.
        low: least mass, kg.
        high: largest mass, kg, above `low`.
        joining: how payload joins.
        coordinates: (n, n), to begin in.
        wanted: rate, kg/s; the largest is searched for where it is left out.
        solve: what finds candidates.
        update: told of progress.
    """
    best: BoundedRate | None = None
    for degree in DEGREES:
        if wanted is None:
            found = _largest(family, low, high, joining, degree, coordinates, solve, update)
        else:
            found = _at(family, low, high, joining, degree, coordinates, wanted, solve)
        if found.status == "proved":
            return found
        best = found if best is None or found.status == "unverified" else best
    assert best is not None
    return best


def _at(
    family: MassFamily,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    degree: int,
    coordinates: np.ndarray,
    wanted: fmpq,
    solve: Solve,
) -> BoundedRate:
    """One rate, approached from lower ones for the sake of the coordinates."""
    tried = _Try((), "", False, coordinates)
    for share in (fmpq(1, 64), fmpq(1, 8)):
        tried = _try(family, Sought(low, high, degree, wanted * share, joining), tried.coordinates, solve)
    tried = _try(family, Sought(low, high, degree, wanted, joining), tried.coordinates, solve, SOLVERS)
    if tried.coefficients:
        return BoundedRate("proved", "", joining, nearest(wanted), tried.coefficients)
    return BoundedRate("unverified" if tried.claimed else "undecided", tried.reason, joining, None, (), nearest(wanted))


def _largest(
    family: MassFamily,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    degree: int,
    coordinates: np.ndarray,
    solve: Solve,
    update: Update,
) -> BoundedRate:
    good: tuple[float, _Try] | None = None
    bad: float | None = None
    failed: _Try | None = None
    rate, done = FIRST_RATE, 0
    while LEAST_RATE <= rate <= LARGEST_RATE:
        update(done / (done + 6), f"mass {joining.replace('_', ' ')}, {rate:.4g} kg/s")
        exact_rate = shortened(fmpq(round(rate * 10**9), 10**9), 3)
        sought = Sought(low, high, degree, exact_rate, joining)
        tried = _try(family, sought, coordinates, solve)
        done, rate = done + 1, nearest(exact_rate)
        if tried.coefficients:
            good, coordinates = (rate, tried), tried.coordinates
        else:
            bad, failed = rate, tried
        if good and bad:
            if bad / good[0] < RESOLUTION:
                break
            rate = (good[0] * bad) ** 0.5
        else:
            rate = rate * 4 if good else rate / 4
    if good is None:
        assert failed is not None
        return BoundedRate("unverified" if failed.claimed else "undecided", failed.reason, joining, None, (), bad)
    return BoundedRate("proved", "", joining, good[0], good[1].coefficients, bad)


def _try(
    family: MassFamily,
    sought: Sought,
    coordinates: np.ndarray,
    solve: Solve,
    solvers: tuple[str, ...] = SOLVERS[:1],
) -> _Try:
    reason, claimed = "no function was found", False
    for solver in solvers:
        answer = solve(family, sought, coordinates, solver)
        if not answer.coefficients:
            continue
        judged = _judge(family, sought, answer)
        if judged == "":
            exact_coefficients = tuple(rationals(p) for p in answer.coefficients)
            onward = coordinates if answer.coordinates is None else answer.coordinates
            return _Try(exact_coefficients, "", False, onward)
        if answer.claims:
            reason, claimed = f"{answer.solver} says {answer.status}, the exact check refuses it ({judged})", True
    return _Try((), reason, claimed, coordinates)


def _judge(family: MassFamily, sought: Sought, answer: Answer) -> str:
    """Why the exact check refuses an answer; empty where it confirms it."""
    if not all(np.all(np.isfinite(p)) for p in answer.coefficients):
        return "the candidate is not finite"
    coefficients = [rationals(p) for p in answer.coefficients]
    return holds_at_rate(
        family, coefficients, sought.low, sought.high, sought.rate, sought.joining, sought.decay
    ).reason
