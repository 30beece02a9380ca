"""Changes between the stages of a law while the payload stays: at any time, or far enough apart.

All stages act on the same states, none of which jumps at a change (`beamdesign.proof.stage_family`). In this order:

- *Common function.* One V = x' P(m) x that falls along every stage at every payload of the whole range. Then the loop
  is stable whichever stage acts when: an estimate of the payload may be wrong, late or restless.
- *One function each.* V_i = x' P_i(m) x falls as exp(-2 decay t) along stage i, and P_j(m) < factor P_i(m): stable
  if the stage changes no more often, on average, than every log(factor) / (2 decay) (Hespanha and Morse, 1999).
- *Refutation.* Two stages in turn, at one payload, under which the motion grows; proved by ball arithmetic.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
from flint import fmpq

from beamdesign.polynomial import exact
from beamdesign.proof.decrease import ZERO, holds_at_rate
from beamdesign.proof.definite import positive_on
from beamdesign.proof.growth import Cycle, growing_cycle, stages_in_turn
from beamdesign.proof.lmi import Solve, Sought, at, modal_coordinates, solve, solve_one_each
from beamdesign.proof.mass_family import Families, rationals
from beamdesign.proof.sudden_change import at_mass, decays, least_dwell, least_factor
from beamdesign.proof.verified import Coefficients, Status, Verified, sought_with

TURNS = 4
"""How often a program is solved anew in the coordinates of its last answer."""


@dataclass(frozen=True)
class StageChange:
    """What is proved of changes of stage while the payload stays.

    Attributes:
        status: of changes at least `dwell_s` apart on average, at any payload of the range.
        reason: why not proved, or not at any time, in words; empty where it is.
        kind: `any_time` with one common function, `dwell` with one each, `none`.
        dwell_s: 0 with a common function.
        factor: growth of V at a change of stage; 1 with a common function.
        decay_per_s: of the functions of each stage; 0 where only that V falls was asked.
        functions: one common P(m), or one for each stage; none for a law of one stage, which never changes.
        counterexample: of changes at any time, where there is no common function.
    """

    status: Status
    reason: str
    kind: Literal["any_time", "dwell", "none"]
    dwell_s: fmpq = ZERO
    factor: fmpq = ZERO
    decay_per_s: fmpq = ZERO
    functions: tuple[Coefficients, ...] = ()
    counterexample: Cycle | None = None

    def suffices(self, dwell_s: float) -> bool:
        """Whether changes of stage at least so far apart are proved to be stable."""
        return self.status == "proved" and self.dwell_s <= exact(dwell_s)


def stage_change(families: Families, low: fmpq, high: fmpq, solve: Solve = solve) -> tuple[StageChange, np.ndarray]:
    """Prove what can be proved of changes between stages, each of which is stable by itself.

    Args:
        families: the loop with each stage, in the same states; see `stage_families`.
        low: least payload, kg.
        high: largest payload, kg, above `low`.
        solve: what finds candidates for the common function.

    Returns:
        what is proved, and coordinates (n, n) to go on from.
    """
    if len(families) == 1:
        return StageChange("proved", "", "any_time", factor=fmpq(1)), modal_coordinates(at(families[0], low))
    common = _common(families, low, high, solve)
    if common.coefficients:
        found = StageChange("proved", "", "any_time", factor=fmpq(1), functions=(common.coefficients,))
        return found, common.coordinates
    cycle = growing_cycle(families, stages_in_turn(families, low, high))
    words = common.refused or "no function was found that serves all stages"
    if cycle is not None:
        sure = "proved" if cycle.proved else "shown numerically only"
        words = f"stages {cycle.stages[0] + 1} and {cycle.stages[1] + 1} in turn make the motion grow ({sure})"
    each = _one_each(families, low, high, common.coordinates)
    if each is None:
        return StageChange(common.status, words, "none", counterexample=cycle), common.coordinates
    return StageChange("proved", words, "dwell", *each, cycle), common.coordinates


def _common(families: Families, low: fmpq, high: fmpq, solve: Solve) -> Verified:
    start = modal_coordinates(at(families[len(families) // 2], (low + high) / 2))
    best = Verified((), "", start)
    for degree in (1, 2):
        coordinates = start
        for _ in range(TURNS):
            found = sought_with(families, Sought(low, high, degree), coordinates, solve)
            if found.coefficients:
                return found
            best = found if found.refused else best
            if np.array_equal(found.coordinates, coordinates):
                break
            coordinates = found.coordinates
    return best


def _one_each(
    families: Families, low: fmpq, high: fmpq, coordinates: np.ndarray
) -> tuple[fmpq, fmpq, fmpq, tuple[Coefficients, ...]] | None:
    """Dwell, factor, decay and functions of the shortest dwell that can be proved; None where there is none."""
    best: tuple[fmpq, fmpq, fmpq, tuple[Coefficients, ...]] | None = None
    for decay in decays(families, low, high):
        inner = coordinates
        for _ in range(TURNS):
            answers = solve_one_each(families, Sought(low, high, 1, decay=decay), inner)
            if not all(a.coefficients and np.all(np.isfinite(a.coefficients)) for a in answers):
                break
            functions = tuple(tuple(rationals(p) for p in answer.coefficients) for answer in answers)
            found = verified_dwell(families, functions, low, high, decay)
            if found is not None and (best is None or found[0] < best[0]):
                best = (*found, decay, functions)
            if answers[0].coordinates is None:
                break
            inner = answers[0].coordinates
    return best


def verified_dwell(
    families: Families, functions: Sequence[Coefficients], low: fmpq, high: fmpq, decay: fmpq
) -> tuple[fmpq, fmpq] | None:
    """Average time between changes of stage that functions of each stage prove to be enough, and the growth at one.

    Args:
        families: the loop with each stage.
        functions: coefficients of P_i(m), affine in m, for each.
        low: least payload, kg.
        high: largest payload, kg.
        decay: 1/s.
    """
    for family, function in zip(families, functions, strict=True):
        if not holds_at_rate([family], function, low, high, ZERO, "matched", decay).holds:
            return None
    pairs = list(permutations(functions, 2))
    factor = least_factor((at_mass(two, mass), at_mass(one, mass)) for one, two in pairs for mass in (low, high))
    for before, after in pairs:  # affine in m: both ends prove what lies between
        gaps = [factor * one - two for one, two in zip(before, after, strict=True)]
        if not positive_on(gaps, low, high).holds:
            return None
    dwell = least_dwell(factor, decay)
    return None if dwell is None else (dwell, factor)
