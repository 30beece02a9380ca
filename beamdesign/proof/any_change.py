"""Payload that changes however fast, matched in velocity: a common Lyapunov function, or why there is no proof."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.proof.decrease import holds_for_any_change
from beamdesign.proof.growth import Cycle, growing_cycle
from beamdesign.proof.lmi import SOLVERS, Answer, Solve, Sought, at, lyapunov_candidates, modal_coordinates, solve
from beamdesign.proof.mass_family import MassFamily, rationals
from beamdesign.proof.rational import nearest, shortened

Status = Literal["proved", "unverified", "refuted", "undecided"]
"""proved: verified in rationals. unverified: a solver claims it and the exact check does not confirm it, which is
worth nothing. refuted: a counterexample was verified. undecided: neither."""

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 256
"""Steps by which the range grows, as shares of it."""


@dataclass(frozen=True)
class AnyChange:
    """Stability for every course of m(t) within a range, jumps included, v being continuous.

    Attributes:
        status: see `Status`; for the whole range.
        reason: in words, why it is not proved; empty where it is.
        outer_end_mass_kg: the range asked about.
        proved_up_to_kg: from the least mass up to here it is proved; the whole range, part of it, or None.
        function: P of the common V = x' P x on that range, (n, n), exact, SI; None where nothing is proved.
        counterexample: a cycle of masses under which the motion grows, if one was found.
    """

    status: Status
    reason: str
    outer_end_mass_kg: tuple[float, float]
    proved_up_to_kg: float | None
    function: fmpq_mat | None
    counterexample: Cycle | None


@dataclass(frozen=True)
class Reached:
    """How far a common function was found while the range grew from its least mass.

    Attributes:
        high: largest mass reached, with a verified function.
        function: that function, or None where not even the least mass has one.
        coordinates: those to go on from.
        refused: the last claim of a solver about the whole range that the exact check refused, in words.
    """

    high: fmpq
    function: fmpq_mat | None
    coordinates: np.ndarray
    refused: str


def any_change(family: MassFamily, low: fmpq, high: fmpq, solve: Solve = solve) -> tuple[AnyChange, Reached]:
    """Decide stability under arbitrary matched changes of mass between `low` and `high`.

    Functions from Lyapunov's equation are tried first, then semidefinite programs on a growing range, each in the
    coordinates that the one before made ideal. All go through the exact check.

    Args:
        family: the closed loop, stable at `low`.
        low: least mass, kg.
        high: largest mass, kg.
        solve: what finds candidates.
    """
    reached = _common(family, low, high, solve)
    range_kg = (nearest(low), nearest(high))
    if reached.function is not None and reached.high == high:
        return AnyChange("proved", "", range_kg, range_kg[1], reached.function, None), reached
    partly = nearest(reached.high) if reached.function is not None and reached.high > low else None
    function = reached.function if partly is not None else None
    cycle = growing_cycle(family, low, high)
    if cycle is not None and cycle.proved:
        words = (
            f"the motion grows {cycle.factor:.4g}-fold per cycle of {cycle.time_s[0]:.4g} s at {range_kg[0]:g} kg and"
            f" {cycle.time_s[1]:.4g} s at {range_kg[1]:g} kg (proved by ball arithmetic over {cycle.cycles} cycles)"
        )
        return AnyChange("refuted", words, range_kg, partly, function, cycle), reached
    words = "no function was found that serves all masses"
    if cycle is not None:
        words = f"a cycle of masses seems to make the motion grow {cycle.factor:.6g}-fold, shown numerically only"
    if reached.refused:
        return AnyChange("unverified", f"{reached.refused}; {words}", range_kg, partly, function, cycle), reached
    return AnyChange("undecided", words, range_kg, partly, function, cycle), reached


def _common(family: MassFamily, low: fmpq, high: fmpq, solve: Solve) -> Reached:
    coordinates = modal_coordinates(at(family, low))
    for candidate in lyapunov_candidates(family, low, high):
        if (function := verified(family, candidate, low, high).function) is not None:
            return Reached(high, function, coordinates, "")
    best, function, refused = low, verified(family, coordinates.T @ coordinates, low, low).function, ""
    step = (high - low) * fmpq(1, round(1 / FIRST_STEP))
    while step >= (high - low) * fmpq(1, round(1 / LEAST_STEP)):
        target = min(shortened(best + step, 9), high)  # a decimal, so that as a float it is the same number
        if target <= best:
            break
        answer = solve(family, Sought(low, target), coordinates, SOLVERS[0])
        found = _judge(family, answer, low, target)
        refused = found.refused if target == high else refused
        if found.function is not None and answer.coordinates is not None:
            best, function, coordinates = target, found.function, answer.coordinates
            if best == high:
                return Reached(high, function, coordinates, "")
            step *= 2
        else:
            step /= 2
    for solver in SOLVERS:  # the whole range once more, from the best coordinates there are
        found = _judge(family, solve(family, Sought(low, high), coordinates, solver), low, high)
        if found.function is not None:
            return Reached(high, found.function, coordinates, "")
        refused = found.refused or refused
    return Reached(best, function, coordinates, refused)


@dataclass(frozen=True)
class Judged:
    """A candidate after the exact check: the function, or what is wrong with it."""

    function: fmpq_mat | None
    refused: str


def verified(family: MassFamily, candidate: np.ndarray, low: fmpq, high: fmpq) -> Judged:
    """Round a candidate P (n, n) to decimals and check it in rationals."""
    if not np.all(np.isfinite(candidate)):
        return Judged(None, "the candidate is not finite")
    function = rationals(candidate)
    answer = holds_for_any_change(family, function, low, high)
    return Judged(function, "") if answer.holds else Judged(None, answer.reason)


def _judge(family: MassFamily, answer: Answer, low: fmpq, high: fmpq) -> Judged:
    if not answer.coefficients:
        return Judged(None, "")
    found = verified(family, answer.coefficients[0], low, high)
    if found.function is not None or not answer.claims:
        return Judged(found.function, "")
    return Judged(None, f"{answer.solver} says {answer.status}, the exact check refuses it ({found.refused})")
