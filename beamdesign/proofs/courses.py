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

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product
from math import log

import numpy as np
from flint import fmpq

from beamdesign.polynomial import exact, nearest, shortened
from beamdesign.progress import Progress, silent
from beamdesign.proofs.decrease import (
    ZERO,
    Change,
    Sought,
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
    Status,
    checked,
    lyapunov_candidates,
    refused,
    slowest_decay,
    solve_one_each,
    sought_with,
)
from beamdesign.proofs.mass_family import at, floats, growing_cycle, modal_coordinates

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 256
"""Steps by which a range of masses grows, as shares of it."""
FIRST_RATE, LEAST_RATE, LARGEST_RATE = 16.0, 1e-3, 1e6
"""kg/s at which the search starts, below which it gives up, and above which it does not ask."""
RESOLUTION = 1.05
"""The largest rate proved is known to lie within this factor of one that was not proved."""
DEGREES = (1, 2)
"""Of P in m, tried in this order."""


def any_change(sought: Sought) -> Found:
    """Decide stability under arbitrary matched changes of mass between two masses, whichever stage acts when.

    Functions from Lyapunov's equation are tried first, then semidefinite programs on a growing range, each in the
    coordinates that the one before made ideal. All go through the exact check. Loops are to be stable at the least
    mass.
    """
    families, low, high = sought.families, sought.low, sought.high
    coordinates = modal_coordinates(at(families[len(families) // 2], low))
    candidates = (checked(sought, [candidate])[0] for candidate in lyapunov_candidates(sought))
    function: Coefficients = next(filter(None, candidates), ())
    best, claimed = high if function else low, ""
    step = (high - low) * fmpq(1, round(1 / FIRST_STEP))
    while best < high and step >= (high - low) * fmpq(1, round(1 / LEAST_STEP)):
        target = min(shortened(best + step, 9), high)  # a decimal, so that as a float it is the same number
        if target <= best:
            break
        found, onward = sought_with(replace(sought, high=target), coordinates)
        claimed = found.claimed if target == high else claimed
        if found.coefficients:
            best, function, coordinates = target, found.coefficients, onward
            step *= 2
        else:
            step /= 2
    if best < high:  # the whole range once more, from the best coordinates there are
        found, _ = sought_with(sought, coordinates, SOLVERS)
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
    sought: Sought,
    coordinates: np.ndarray,
    wanted: fmpq | None = None,
    update: Progress = silent,
    degrees: Sequence[int] = DEGREES,
) -> Course:
    """Prove stability up to a rate of change, or find the largest rate that can be proved.

    Args:
        sought: loops that are stable at every mass that stays, and how payload joins.
        coordinates: (n, n), to begin in.
        wanted: rate, kg/s; the largest is searched for where it is left out.
        update: told of progress.
        degrees: of P in m, tried in this order.
    """
    tried = list[Course]()
    for degree in degrees:
        own = replace(sought, degree=degree)
        found = _largest(own, coordinates, update) if wanted is None else _at(own, coordinates, wanted)
        if found.status == "proved":
            return found
        tried.append(found)
    return next((one for one in tried[::-1] if one.status == "unverified"), tried[0])


def _at(sought: Sought, coordinates: np.ndarray, wanted: fmpq) -> Course:
    """One rate, approached from lower ones for the sake of the coordinates."""
    for share in (fmpq(1, 64), fmpq(1, 8)):
        _, coordinates = sought_with(replace(sought, rate=wanted * share), coordinates)
    found, _ = sought_with(replace(sought, rate=wanted), coordinates, SOLVERS)
    rate = nearest(wanted)
    return replace(found, rate_kg_per_s=rate) if found.coefficients else replace(found, refused_kg_per_s=rate)


def _largest(sought: Sought, coordinates: np.ndarray, update: Progress) -> Course:
    best, bad = Course("undecided", NONE_FOUND, sought.joining), None
    rate, done = FIRST_RATE, 0
    while LEAST_RATE <= rate <= LARGEST_RATE:
        update(done / (done + 6), f"mass {sought.joining.replace('_', ' ')}, {rate:.4g} kg/s")
        exact_rate = shortened(fmpq(round(rate * 10**9), 10**9), 3)
        found, onward = sought_with(replace(sought, rate=exact_rate), coordinates)
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


def stage_change(sought: Sought) -> Found:
    """Prove what can be proved of changes between stages, each of which is stable by itself."""
    families, low, high = sought.families, sought.low, sought.high
    at_any_time = Course("proved", dwell_s=ZERO, factor=fmpq(1))
    if len(families) == 1:
        return at_any_time, modal_coordinates(at(families[0], low))
    common, coordinates = _common(sought)
    if common.functions:
        return replace(at_any_time, functions=common.functions), coordinates
    pairs = product((low, (low + high) / 2, high), combinations(range(len(families)), 2))
    cycle = growing_cycle(families, (((i, mass), (j, mass)) for mass, (i, j) in pairs))
    words = common.claimed or "no function was found that serves all stages"
    if cycle is not None:
        sure = "proved" if cycle.proved else "shown numerically only"
        words = f"stages {cycle.stages[0] + 1} and {cycle.stages[1] + 1} in turn make the motion grow ({sure})"
    each = _shortest_dwell(replace(sought, degree=1), len(families), coordinates, TURNS)
    found = common if each.dwell_s is None else each
    return replace(found, reason=words, counterexample=cycle), coordinates


def _common(sought: Sought) -> Found:
    start = modal_coordinates(at(sought.families[len(sought.families) // 2], (sought.low + sought.high) / 2))
    best = Course("undecided", NONE_FOUND), start
    for degree in DEGREES:
        coordinates = start
        for _ in range(TURNS):
            found, onward = sought_with(replace(sought, degree=degree), coordinates)
            if found.functions:
                return found, onward
            best = (found, onward) if found.claimed else best
            if np.array_equal(onward, coordinates):
                break
            coordinates = onward
    return best


def sudden_change(sought: Sought, coordinates: np.ndarray) -> Course:
    """The shortest average time between sudden changes that can be proved, over a few decay rates.

    Args:
        sought: loops that are stable at every mass that stays, and how payload joins.
        coordinates: (n, n), to begin in.
    """
    # The second time in the coordinates of the first answer.
    found = _shortest_dwell(replace(sought, degree=1), 1, coordinates, 2)
    return replace(found, joining=sought.joining)


def _shortest_dwell(sought: Sought, count: int, coordinates: np.ndarray, turns: int) -> Course:
    """The shortest dwell over a few decay rates and, for each, turns in the coordinates of the last answer.

    It is with so many functions: one, of changes of the payload, or one for each stage, of changes between these.
    Answers are verified exactly.
    """
    best = Course("undecided", NONE_FOUND)
    slowest = min(slowest_decay(sought, family) for family in sought.families)
    for share in DECAY_SHARES:
        asked, inner = replace(sought, decay=shortened(exact(slowest * share), 3)), coordinates
        for _ in range(turns):
            answer = solve_one_each(asked, inner, count)
            if not answer.functions:
                break
            found = _verified(asked, answer)
            if found.dwell_s is None:
                better = best.dwell_s is None and found.status == "unverified"
            else:
                better = best.dwell_s is None or found.dwell_s < best.dwell_s
            best = found if better else best
            if answer.coordinates is None:
                break
            inner = answer.coordinates
    return best


def _verified(asked: Sought, answer: Answer) -> Course:
    """What functions, one for all families or one for each, prove of the time between changes; the check is exact."""
    alone = len(answer.functions) == 1
    own = [asked] if alone else [replace(asked, families=[family]) for family in asked.families]
    found = [checked(one, function) for one, function in zip(own, answer.functions, strict=True)]
    wrong = next((words for _, words in found if words), "")
    if not wrong:
        functions = [function for function, _ in found]
        changes = changes_of_payload(asked, functions[0]) if alone else changes_of_stage(asked, functions)
        course = _enough(changes, functions, asked.decay)
        if course.status == "proved":
            return course
        wrong = course.reason
    return refused(answer, wrong, asked.joining) if answer.claims else Course("undecided", NONE_FOUND)


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
