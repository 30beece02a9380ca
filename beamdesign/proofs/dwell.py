"""Sudden changes far enough apart: of the payload, or of the stage of a law while the payload stays.

V falls as exp(-2 decay t) between changes and grows at most by `factor` at one. With no more than n0 + t / dwell
changes in any time t, for some n0, the loop is exponentially stable if dwell > log(factor) / (2 decay) (average dwell
time; Hespanha and Morse, 1999). All stages act on the same states, none of which jumps at a change of stage
(`beamdesign.proofs.mass_family`). Of changes of stage, in this order:

- *Common function.* One V = x' P(m) x that falls along every stage at every payload of the whole range. Then the loop
  is stable whichever stage acts when: an estimate of the payload may be wrong, late or restless.
- *One function each.* V_i = x' P_i(m) x falls along stage i, and P_j(m) < factor P_i(m).
- *Refutation.* Two stages in turn, at one payload, under which the motion grows; proved by ball arithmetic.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import combinations, product
from math import log

import numpy as np
from flint import fmpq

from beamdesign.polynomial import exact, nearest, shortened
from beamdesign.proofs.courses import NONE_FOUND, Coefficients, Course, checked, growing_cycle, refused, sought_with
from beamdesign.proofs.decrease import (
    ZERO,
    Change,
    Joining,
    changes_of_payload,
    changes_of_stage,
    dwell_suffices,
    grows_at_most,
    holds_at_rate,
)
from beamdesign.proofs.lmi import Answer, Sought, at, modal_coordinates, slowest_decay, solve_one_each
from beamdesign.proofs.mass_family import Families, floats, rationals

TURNS = 4
"""How often a program over stages is solved anew in the coordinates of its last answer."""
DECAY_SHARES = (0.3, 0.6, 0.9)
"""Decay rates to try, as shares of the slowest one of a mass that stays."""


def stage_change(families: Families, low: fmpq, high: fmpq) -> tuple[Course, np.ndarray]:
    """Prove what can be proved of changes between stages, each of which is stable by itself.

    Args:
        families: the loop with each stage, in the same states; see `stage_families`.
        low: least payload, kg.
        high: largest payload, kg, above `low`.

    Returns:
        what is proved, and coordinates (n, n) to go on from.
    """
    at_any_time = Course("proved", dwell_s=ZERO, factor=fmpq(1))
    if len(families) == 1:
        return at_any_time, modal_coordinates(at(families[0], low))
    common, coordinates = _common(families, low, high)
    if common.functions:
        return replace(at_any_time, functions=common.functions), coordinates
    pairs = product((low, (low + high) / 2, high), combinations(range(len(families)), 2))
    cycle = growing_cycle(families, (((i, mass), (j, mass)) for mass, (i, j) in pairs))
    words = common.claimed or "no function was found that serves all stages"
    if cycle is not None:
        sure = "proved" if cycle.proved else "shown numerically only"
        words = f"stages {cycle.stages[0] + 1} and {cycle.stages[1] + 1} in turn make the motion grow ({sure})"

    def ask(decay: fmpq, inner: np.ndarray) -> Sequence[Answer]:
        return solve_one_each(families, Sought(low, high, 1, decay=decay), inner)

    def verify(decay: fmpq, answers: Sequence[Answer]) -> Course:
        if not all(np.all(np.isfinite(answer.coefficients)) for answer in answers):
            return Course("undecided", NONE_FOUND)
        functions = tuple(tuple(rationals(p) for p in answer.coefficients) for answer in answers)
        return verified_dwell(families, functions, low, high, decay)

    each = _shortest_dwell(families, low, high, coordinates, ask, verify, TURNS)
    found = common if each.dwell_s is None else each
    return replace(found, reason=words, counterexample=cycle), coordinates


def _common(families: Families, low: fmpq, high: fmpq) -> tuple[Course, np.ndarray]:
    start = modal_coordinates(at(families[len(families) // 2], (low + high) / 2))
    best = Course("undecided", NONE_FOUND), start
    for degree in (1, 2):
        coordinates = start
        for _ in range(TURNS):
            found, onward = sought_with(families, Sought(low, high, degree), coordinates)
            if found.functions:
                return found, onward
            best = (found, onward) if found.claimed else best
            if np.array_equal(onward, coordinates):
                break
            coordinates = onward
    return best


def sudden_change(families: Families, low: fmpq, high: fmpq, joining: Joining, coordinates: np.ndarray) -> Course:
    """The shortest average time between sudden changes that can be proved, over a few decay rates.

    Args:
        families: the closed loop with each stage, stable at every mass that stays.
        low: least mass, kg.
        high: largest mass, kg, above `low`.
        joining: how payload joins.
        coordinates: (n, n), to begin in.
    """

    def sought(decay: fmpq) -> Sought:
        return Sought(low, high, 1, ZERO, joining, decay)

    def ask(decay: fmpq, inner: np.ndarray) -> Sequence[Answer]:
        return solve_one_each(families, sought(decay), inner, 1)

    def verify(decay: fmpq, answers: Sequence[Answer]) -> Course:
        coefficients, wrong = checked(families, sought(decay), answers[0].coefficients)
        if not wrong:
            changes = changes_of_payload(families[0], coefficients, low, high, joining)
            found = _enough(changes, (coefficients,), decay)
            if found.status == "proved":
                return found
            wrong = found.reason
        return refused(answers[0], wrong, joining) if answers[0].claims else Course("undecided", NONE_FOUND)

    # The second time in the coordinates of the first answer.
    return replace(_shortest_dwell(families, low, high, coordinates, ask, verify, 2), joining=joining)


def _shortest_dwell(
    families: Families,
    low: fmpq,
    high: fmpq,
    coordinates: np.ndarray,
    ask: Callable[[fmpq, np.ndarray], Sequence[Answer]],
    verify: Callable[[fmpq, Sequence[Answer]], Course],
    turns: int,
) -> Course:
    """The shortest dwell over a few decay rates and, for each, turns in the coordinates of the last answer."""
    best, slowest = Course("undecided", NONE_FOUND), slowest_decay(families, low, high)
    for decay in (shortened(exact(slowest * share), 3) for share in DECAY_SHARES):
        inner = coordinates
        for _ in range(turns):
            answers = ask(decay, inner)
            if not all(answer.coefficients for answer in answers):
                break
            found = verify(decay, answers)
            if found.dwell_s is None:
                better = best.dwell_s is None and found.status == "unverified"
            else:
                better = best.dwell_s is None or found.dwell_s < best.dwell_s
            best = found if better else best
            if answers[0].coordinates is None:
                break
            inner = answers[0].coordinates
    return best


def verified_dwell(families: Families, functions: Sequence[Coefficients], low: fmpq, high: fmpq, decay: fmpq) -> Course:
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
            return Course("undecided", NONE_FOUND)
    return _enough(changes_of_stage(functions, low, high), functions, decay)


def _enough(changes: Sequence[Change], functions: Sequence[Coefficients], decay: fmpq) -> Course:
    """The time between changes that is enough for functions that fall at a rate between them; the check is exact."""
    factor = least_factor((floats(after), floats(before)) for before, after in changes)
    across = grows_at_most(changes, factor)
    dwell = shortened(exact(log(nearest(factor)) / (2 * nearest(decay)) * (1 + 1e-6)), 4, up=True)
    if not across.holds or not dwell_suffices(dwell, factor, decay):
        return Course("undecided", across.reason or NONE_FOUND)
    return Course("proved", functions=tuple(functions), dwell_s=dwell, factor=factor, decay_per_s=decay)


def least_factor(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> fmpq:
    """A little more than the largest ratio of V after and before a change, from pairs of P after and P before."""
    largest = 1.0
    for after, before in pairs:
        scale = 1 / np.sqrt(np.diag(before))
        inverse = np.linalg.inv(np.linalg.cholesky(before * np.outer(scale, scale)))
        ratio = inverse @ (after * np.outer(scale, scale)) @ inverse.T
        largest = max(largest, float(np.linalg.eigvalsh((ratio + ratio.T) / 2)[-1]))
    return shortened(exact(largest * (1 + 1e-5)), 6, up=True)
