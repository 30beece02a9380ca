"""Payload that changes however fast, matched in velocity: a common Lyapunov function, or why there is no proof."""

from dataclasses import dataclass

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.proof.growth import Cycle, growing_cycle, masses_in_turn
from beamdesign.proof.lmi import SOLVERS, Solve, Sought, at, lyapunov_candidates, modal_coordinates, solve
from beamdesign.proof.mass_family import Families
from beamdesign.proof.rational import nearest, shortened
from beamdesign.proof.verified import Status, checked, sought_with

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 256
"""Steps by which the range grows, as shares of it."""


@dataclass(frozen=True)
class AnyChange:
    """Stability for every course of m(t) within a range, jumps included, v being continuous, whichever stage acts when.

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
        function: that function; None where it did not grow at all.
        coordinates: those to go on from.
        refused: the last claim of a solver about the whole range that the exact check refused, in words.
    """

    high: fmpq
    function: fmpq_mat | None
    coordinates: np.ndarray
    refused: str


def any_change(families: Families, low: fmpq, high: fmpq, solve: Solve = solve) -> tuple[AnyChange, Reached]:
    """Decide stability under arbitrary matched changes of mass between `low` and `high`.

    Functions from Lyapunov's equation are tried first, then semidefinite programs on a growing range, each in the
    coordinates that the one before made ideal. All go through the exact check.

    Args:
        families: the closed loop with each stage, stable at `low`.
        low: least mass, kg.
        high: largest mass, kg.
        solve: what finds candidates.
    """
    reached = _common(families, low, high, solve)
    range_kg = (nearest(low), nearest(high))
    partly = None if reached.function is None else nearest(reached.high)
    if reached.function is not None and reached.high == high:
        return AnyChange("proved", "", range_kg, partly, reached.function, None), reached
    cycle = growing_cycle(families, masses_in_turn(families, low, high))
    status: Status = "unverified" if reached.refused else "undecided"
    words = "no function was found that serves all masses"
    if cycle is not None and cycle.proved:
        status, stage = "refuted", f"stage {cycle.stages[0] + 1}, " if len(families) > 1 else ""
        words = (
            f"{stage}the motion grows {cycle.factor:.4g}-fold per cycle of {cycle.time_s[0]:.4g} s at"
            f" {range_kg[0]:g} kg and {cycle.time_s[1]:.4g} s at {range_kg[1]:g} kg (proved by ball arithmetic over"
            f" {cycle.cycles} cycles)"
        )
    elif cycle is not None:
        words = f"a cycle of masses seems to make the motion grow {cycle.factor:.6g}-fold, shown numerically only"
    if status == "unverified":
        words = f"{reached.refused}; {words}"
    return AnyChange(status, words, range_kg, partly, reached.function, cycle), reached


def _common(families: Families, low: fmpq, high: fmpq, solve: Solve) -> Reached:
    coordinates = modal_coordinates(at(families[len(families) // 2], low))
    for candidate in lyapunov_candidates(families, low, high):
        functions, wrong = checked(families, Sought(low, high), [candidate])
        if not wrong:
            return Reached(high, functions[0], coordinates, "")
    best, function, refused = low, None, ""
    step = (high - low) * fmpq(1, round(1 / FIRST_STEP))
    while step >= (high - low) * fmpq(1, round(1 / LEAST_STEP)):
        target = min(shortened(best + step, 9), high)  # a decimal, so that as a float it is the same number
        if target <= best:
            break
        found = sought_with(families, Sought(low, target), coordinates, solve)
        refused = found.refused if target == high else refused
        if found.coefficients:
            best, function, coordinates = target, found.coefficients[0], found.coordinates
            if best == high:
                return Reached(high, function, coordinates, "")
            step *= 2
        else:
            step /= 2
    # The whole range once more, from the best coordinates there are.
    found = sought_with(families, Sought(low, high), coordinates, solve, SOLVERS)
    if found.coefficients:
        return Reached(high, found.coefficients[0], coordinates, "")
    return Reached(best, function, coordinates, found.refused or refused)
