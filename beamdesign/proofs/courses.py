"""Courses of payload and stage: however fast, at a bounded rate, or in sudden changes; what is proved of each.

Candidates for Lyapunov functions V = x' P(m) x come from `beamdesign.proofs.lmi`; what counts is
`beamdesign.proofs.decrease`, which checks them in rationals, whatever a solver says of them. Payload that changes
however fast, matched in velocity, is settled by a P that is free of m, or refuted by two masses in turn, by ball
arithmetic; a bounded rate by a P(m), for the largest rate that can be proved.

Where sudden changes, of the payload or of the stage of a law while the payload stays, are far enough apart, V falls as
exp(-2 decay t) between them and grows at most by `factor` at one. With no more than n0 + t / dwell changes in any time
t, for some n0, the loop is exponentially stable if dwell > log(factor) / (2 decay) (average dwell time; Hespanha and
Morse, 1999). All stages act on the same states, none of which jumps at a change of stage
(`beamdesign.proofs.mass_family`). Of changes of stage, in this order:

- *Common function.* One V = x' P(m) x that falls along every stage at every payload of the whole range. Then the loop
  is stable whichever stage acts when: an estimate of the payload may be wrong, late or restless.
- *One function each.* V_i = x' P_i(m) x falls along stage i, and P_j(m) < factor P_i(m).
- *Refutation.* Two stages in turn, at one payload, under which the motion grows; proved by ball arithmetic.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from math import log

import numpy as np
from flint import fmpq

from beamdesign.polynomial import exact, nearest, shortened
from beamdesign.progress import Progress, silent
from beamdesign.proofs.decrease import (
    ZERO,
    Change,
    Joining,
    changes_of_payload,
    changes_of_stage,
    dwell_suffices,
    grows_beyond,
)
from beamdesign.proofs.lmi import (
    NONE_FOUND,
    SOLVERS,
    Answer,
    Coefficients,
    Course,
    Found,
    Sought,
    Status,
    checked,
    lyapunov_candidates,
    refused,
    slowest_decay,
    solve_one_each,
    sought_with,
)
from beamdesign.proofs.mass_family import Families, at, floats, growing_cycle, modal_coordinates

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 256
"""Steps by which a range of masses grows, as shares of it."""
FIRST_RATE, LEAST_RATE, LARGEST_RATE = 16.0, 1e-3, 1e6
"""kg/s at which the search starts, below which it gives up, and above which it does not ask."""
RESOLUTION = 1.05
"""The largest rate proved is known to lie within this factor of one that was not proved."""
DEGREES = (1, 2)
"""Of P in m, tried in this order."""


def any_change(families: Families, low: fmpq, high: fmpq) -> tuple[Course, np.ndarray]:
    """Decide stability under arbitrary matched changes of mass between `low` and `high`, whichever stage acts when.

    Functions from Lyapunov's equation are tried first, then semidefinite programs on a growing range, each in the
    coordinates that the one before made ideal. All go through the exact check.

    Args:
        families: the closed loop with each stage, stable at `low`.
        low: least mass, kg.
        high: largest mass, kg.

    Returns:
        what is proved, and coordinates (n, n) to go on from.
    """
    coordinates = modal_coordinates(at(families[len(families) // 2], low))
    best, claimed = low, ""
    function: Coefficients = ()
    for candidate in lyapunov_candidates(families, low, high):
        function, wrong = checked(families, Sought(low, high), [candidate])
        if not wrong:
            best = high
            break
    step = (high - low) * fmpq(1, round(1 / FIRST_STEP))
    while best < high and step >= (high - low) * fmpq(1, round(1 / LEAST_STEP)):
        target = min(shortened(best + step, 9), high)  # a decimal, so that as a float it is the same number
        if target <= best:
            break
        found, onward = sought_with(families, Sought(low, target), coordinates)
        claimed = found.claimed if target == high else claimed
        if found.coefficients:
            best, function, coordinates = target, found.coefficients, onward
            step *= 2
        else:
            step /= 2
    if best < high:  # the whole range once more, from the best coordinates there are
        found, _ = sought_with(families, Sought(low, high), coordinates, SOLVERS)
        claimed = found.claimed or claimed
        if found.coefficients:
            best, function = high, found.coefficients
    functions, partly = ((function,), nearest(best)) if function else ((), None)
    if function and best == high:
        return Course("proved", functions=functions, proved_up_to_kg=partly), coordinates
    cycle = growing_cycle(families, [((k, low), (k, high)) for k in range(len(families))])
    status: Status = "unverified" if claimed else "undecided"
    words = "no function was found that serves all masses"
    if cycle is not None and cycle.proved:
        status, stage = "refuted", f"stage {cycle.stages[0] + 1}, " if len(families) > 1 else ""
        words = (
            f"{stage}the motion grows {cycle.factor:.4g}-fold per cycle of {cycle.time_s[0]:.4g} s at"
            f" {nearest(low):g} kg and {cycle.time_s[1]:.4g} s at {nearest(high):g} kg (proved by ball arithmetic over"
            f" {cycle.cycles} cycles)"
        )
    elif cycle is not None:
        words = f"a cycle of masses seems to make the motion grow {cycle.factor:.6g}-fold, shown numerically only"
    if status == "unverified":
        words = f"{claimed}; {words}"
    return Course(status, words, "matched", functions, partly, counterexample=cycle), coordinates


def bounded_rate(
    families: Families,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    coordinates: np.ndarray,
    wanted: fmpq | None = None,
    update: Progress = silent,
    degrees: Sequence[int] = DEGREES,
) -> Course:
    """Prove stability up to a rate of change, or find the largest rate that can be proved.

    Args:
        families: the closed loop with each stage, stable at every mass that stays.
        low: least mass, kg.
        high: largest mass, kg, above `low`.
        joining: how payload joins.
        coordinates: (n, n), to begin in.
        wanted: rate, kg/s; the largest is searched for where it is left out.
        update: told of progress.
        degrees: of P in m, tried in this order.
    """
    tried = list[Course]()
    for degree in degrees:

        def ask(rate: fmpq, inner: np.ndarray, solvers: Sequence[str] = SOLVERS[:1], degree: int = degree) -> Found:
            return sought_with(families, Sought(low, high, degree, rate, joining), inner, solvers)

        found = _largest(ask, joining, coordinates, update) if wanted is None else _at(ask, coordinates, wanted)
        if found.status == "proved":
            return found
        tried.append(found)
    return next((one for one in tried[::-1] if one.status == "unverified"), tried[0])


def _at(ask: Callable[..., Found], coordinates: np.ndarray, wanted: fmpq) -> Course:
    """One rate, approached from lower ones for the sake of the coordinates."""
    for share in (fmpq(1, 64), fmpq(1, 8)):
        _, coordinates = ask(wanted * share, coordinates)
    found, _ = ask(wanted, coordinates, SOLVERS)
    rate = nearest(wanted)
    return replace(found, rate_kg_per_s=rate) if found.coefficients else replace(found, refused_kg_per_s=rate)


def _largest(ask: Callable[..., Found], joining: Joining, coordinates: np.ndarray, update: Progress) -> Course:
    best, bad = Course("undecided", NONE_FOUND, joining), None
    rate, done = FIRST_RATE, 0
    while LEAST_RATE <= rate <= LARGEST_RATE:
        update(done / (done + 6), f"mass {joining.replace('_', ' ')}, {rate:.4g} kg/s")
        exact_rate = shortened(fmpq(round(rate * 10**9), 10**9), 3)
        found, onward = ask(exact_rate, coordinates)
        done, rate = done + 1, nearest(exact_rate)
        if found.coefficients:
            best, coordinates = replace(found, rate_kg_per_s=rate), onward
        else:
            best, bad = best if best.coefficients else found, rate
        good = best.rate_kg_per_s
        if good and bad:
            if bad / good < RESOLUTION:
                break
            rate = (good * bad) ** 0.5
        else:
            rate = rate * 4 if good else rate / 4
    return replace(best, refused_kg_per_s=bad)


# Sudden changes far enough apart.


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
    changes = partial(changes_of_stage, low=low, high=high)
    each = _shortest_dwell(families, Sought(low, high, 1), len(families), coordinates, changes, TURNS)
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

    def changes(functions: Sequence[Coefficients]) -> list[Change]:
        return changes_of_payload(families[0], functions[0], low, high, joining)

    # The second time in the coordinates of the first answer.
    found = _shortest_dwell(families, Sought(low, high, 1, joining=joining), 1, coordinates, changes, 2)
    return replace(found, joining=joining)


def _shortest_dwell(
    families: Families,
    sought: Sought,
    count: int,
    coordinates: np.ndarray,
    changes: Callable[[Sequence[Coefficients]], Sequence[Change]],
    turns: int,
) -> Course:
    """The shortest dwell over a few decay rates and, for each, turns in the coordinates of the last answer.

    It is with so many functions, of which follow the changes that join them; answers are verified exactly.
    """
    best, slowest = Course("undecided", NONE_FOUND), slowest_decay(families, sought.low, sought.high)
    for share in DECAY_SHARES:
        asked, inner = replace(sought, decay=shortened(exact(slowest * share), 3)), coordinates
        for _ in range(turns):
            answers = solve_one_each(families, asked, inner, count)
            if not all(answer.coefficients for answer in answers):
                break
            found = _verified(families, asked, answers, changes)
            if found.dwell_s is None:
                better = best.dwell_s is None and found.status == "unverified"
            else:
                better = best.dwell_s is None or found.dwell_s < best.dwell_s
            best = found if better else best
            if answers[0].coordinates is None:
                break
            inner = answers[0].coordinates
    return best


def _verified(
    families: Families,
    asked: Sought,
    answers: Sequence[Answer],
    changes: Callable[[Sequence[Coefficients]], Sequence[Change]],
) -> Course:
    """What answers, one for all families or one for each, prove of the time between changes; the check is exact."""
    own = [families] if len(answers) == 1 else [[family] for family in families]
    found = [checked(some, asked, answer.coefficients) for some, answer in zip(own, answers, strict=True)]
    wrong = next((words for _, words in found if words), "")
    if not wrong:
        functions = [function for function, _ in found]
        course = _enough(changes(functions), functions, asked.decay)
        if course.status == "proved":
            return course
        wrong = course.reason
    return refused(answers[0], wrong, asked.joining) if answers[0].claims else Course("undecided", NONE_FOUND)


def _enough(changes: Sequence[Change], functions: Sequence[Coefficients], decay: fmpq) -> Course:
    """The time between changes that is enough for functions that fall at a rate between them; the check is exact."""
    from scipy.linalg import eigh

    growths = (float(eigh(floats(after), floats(before), eigvals_only=True)[-1]) for before, after in changes)
    factor = shortened(exact(max([1.0, *growths]) * (1 + 1e-5)), 6, up=True)  # a little more than the largest
    wrong = grows_beyond(changes, factor)
    dwell = shortened(exact(log(nearest(factor)) / (2 * nearest(decay)) * (1 + 1e-6)), 4, up=True)
    if wrong or not dwell_suffices(dwell, factor, decay):
        return Course("undecided", wrong or NONE_FOUND)
    return Course("proved", functions=tuple(functions), dwell_s=dwell, factor=factor, decay_per_s=decay)
