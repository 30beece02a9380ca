"""Stability of a loop whose law is changed while it runs: any change at any time, or changes that are far enough apart.

All laws act on the same states, none of which jumps at a change (`beamdesign.proof.stage_family`). In this order:

- *Common function.* One V = x' P(m) x that falls along every stage at every payload of the whole range. Then the loop
  is stable whichever stage acts when: an estimate of the payload may be wrong, late or restless. The same function
  is made to bear a payload that changes: at a bounded rate, or in jumps that are far enough apart on average.
- *One function each.* V_i = x' P_i(m) x falls as exp(-2 decay t) along stage i, and P_j(m) < factor P_i(m): stable
  if the stage changes no more often, on average, than every log(factor) / (2 decay) (Hespanha and Morse, 1999), the
  payload staying.
- *Refutation.* Two stages in turn, at one payload, under which the motion grows; proved by ball arithmetic.

Candidates come from semidefinite programs and are verified in rationals; what only a solver claims is `unverified`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log
from typing import Literal

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proof.any_change import Status
from beamdesign.proof.bounded_rate import LEAST_RATE, Update, quiet
from beamdesign.proof.common_function import Families, SolveTogether, solve_one_each, solve_together
from beamdesign.proof.common_function import solve_together_across_jumps as solve_jumps
from beamdesign.proof.decrease import (
    Joining,
    dwell_suffices,
    holds_across_jumps,
    holds_at_rate,
    jump,
    jump_shares,
)
from beamdesign.proof.definite import Definite, positive_on
from beamdesign.proof.growth import frozen, growing_times, proved_growth
from beamdesign.proof.lmi import SOLVERS, Answer, Sought, at, modal_coordinates, slowest_decay
from beamdesign.proof.mass_family import floats, rationals
from beamdesign.proof.rational import nearest, shortened

Coefficients = tuple[fmpq_mat, ...]
"""Of P(m), ascending in m."""

FIRST_RATE, LARGEST_RATE, RESOLUTION = 2.0, 600.0, 1.2
"""kg/s where the search for the largest rate of the payload begins and gives up, and the factor in which it ends."""
JOININGS: tuple[Joining, ...] = ("matched", "from_rest")
TURNS = 4
"""How often a program is solved anew in the coordinates of its last answer."""
DECAY_SHARES = (0.3, 0.6, 0.9)
"""Decay rates to try, as shares of the slowest one."""


@dataclass(frozen=True)
class PayloadRate:
    """The payload may change at up to this rate, any stage acting at any time.

    Attributes:
        joining: how payload joins, see `beamdesign.proof.decrease`.
        rate_kg_per_s: proved bound on |dm/dt|.
        coefficients: of P(m), (n, n) each, exact, SI.
    """

    joining: Joining
    rate_kg_per_s: float
    coefficients: Coefficients


@dataclass(frozen=True)
class PayloadJumps:
    """The payload may jump, if jumps are this far apart on average, any stage acting at any time.

    Attributes:
        joining: how payload joins.
        dwell_s: average time between jumps that is proved to be enough.
        factor: growth of V at a jump.
        decay_per_s: V falls as exp(-2 decay t) between jumps.
        coefficients: of P(m), affine in m.
    """

    joining: Joining
    dwell_s: fmpq
    factor: fmpq
    decay_per_s: fmpq
    coefficients: Coefficients


@dataclass(frozen=True)
class StageCycle:
    """Two stages in turn at one payload, under which the motion grows.

    Attributes:
        stages: their numbers, from 0.
        outer_end_mass_kg: the payload.
        time_s: with each.
        factor: growth per cycle, in floats.
        cycles: after which growth is proved; 0 where it was only computed in floats.
    """

    stages: tuple[int, int]
    outer_end_mass_kg: float
    time_s: tuple[float, float]
    factor: float
    cycles: int


@dataclass(frozen=True)
class StageSwitching:
    """What is proved of changes between stages.

    Attributes:
        status: of changes at least `dwell_s` apart on average, at any payload of the range that stays.
        reason: why not proved, in words; empty where it is.
        outer_end_mass_kg: the range.
        kind: `any_time` with one common function, `dwell` with one each, `none`.
        dwell_s: 0 with a common function.
        factor: growth of V at a change of stage; 1 with a common function.
        decay_per_s: of the functions of each stage; 0 where only that V falls was asked.
        functions: one common P(m), or one for each stage.
        rates: of the payload, with any change of stage.
        jumps: of the payload, likewise.
        counterexample: of changes at any time, where there is no common function.
        states: names of the states.
    """

    status: Status
    reason: str
    outer_end_mass_kg: tuple[float, float]
    kind: Literal["any_time", "dwell", "none"]
    dwell_s: fmpq
    factor: fmpq
    decay_per_s: fmpq
    functions: tuple[Coefficients, ...]
    rates: tuple[PayloadRate, ...]
    jumps: tuple[PayloadJumps, ...]
    counterexample: StageCycle | None
    states: tuple[str, ...]

    def suffices(self, dwell_s: float) -> bool:
        """Whether changes of stage at least so far apart are proved to be stable."""
        return self.status == "proved" and self.dwell_s <= exact(dwell_s)


def stage_switching(
    families: Families, low: fmpq, high: fmpq, update: Update = quiet, solve: SolveTogether = solve_together
) -> StageSwitching:
    """Prove what can be proved of changes between stages.

    Args:
        families: the loop with each stage, in the same states; see `stage_families`.
        low: least payload, kg.
        high: largest payload, kg, above `low`.
        update: told of progress.
        solve: what finds candidates for the common function.
    """
    range_kg, states = (nearest(low), nearest(high)), families[0].states
    zero, none = fmpq(0), ()
    for k, family in enumerate(families, start=1):
        stays = frozen(family, low, high)
        if not stays.stable:
            words = f"stage {k} is not stable over the whole range even by itself: {stays.reason}"
            return StageSwitching("refuted", words, range_kg, "none", zero, zero, zero, none, none, none, None, states)
    update(0.05, "a function common to all stages")
    common = _common(families, low, high, solve)
    if common.coefficients:
        rates = tuple(
            _largest_rate(families, low, high, joining, common, solve, update, share)
            for joining, share in zip(JOININGS, (0.2, 0.45), strict=True)
        )
        update(0.7, "payload that jumps")
        jumps = tuple(_jumps(families, low, high, joining, common.coordinates) for joining in JOININGS)
        return StageSwitching(
            "proved",
            "",
            range_kg,
            "any_time",
            zero,
            fmpq(1),
            zero,
            (common.coefficients,),
            tuple(rate for rate in rates if rate is not None),
            tuple(found for found in jumps if found is not None),
            None,
            states,
        )
    update(0.4, "a function for each stage")
    cycle = _growing_cycle(families, low, high)
    each = _one_each(families, low, high, common.coordinates)
    words = common.reason
    if cycle is not None:
        sure = "proved" if cycle.cycles else "shown numerically only"
        words = f"stages {cycle.stages[0] + 1} and {cycle.stages[1] + 1} in turn make the motion grow ({sure})"
    if each is None:
        status: Status = "unverified" if common.claimed else "undecided"
        return StageSwitching(status, words, range_kg, "none", zero, zero, zero, none, none, none, cycle, states)
    dwell, factor, decay, functions = each
    return StageSwitching(
        "proved", words, range_kg, "dwell", dwell, factor, decay, functions, none, none, cycle, states
    )


@dataclass(frozen=True)
class _Found:
    coefficients: Coefficients
    coordinates: np.ndarray
    reason: str = "no function was found that serves all stages"
    claimed: bool = False


def _common(families: Families, low: fmpq, high: fmpq, solve: SolveTogether) -> _Found:
    middle = (low + high) / 2
    start = modal_coordinates(at(families[len(families) // 2], middle))
    best = _Found((), start)
    for degree in (1, 2):
        coordinates = start
        for _ in range(TURNS):
            tried = _tried(families, Sought(low, high, degree), coordinates, solve)
            if tried.coefficients:
                return tried
            best = tried if tried.claimed else best
            if np.array_equal(tried.coordinates, coordinates):
                break
            coordinates = tried.coordinates
    return best


def _tried(families: Families, sought: Sought, coordinates: np.ndarray, solve: SolveTogether) -> _Found:
    """One program, its answer checked."""
    answer = solve(families, sought, coordinates, SOLVERS[0])
    onward = coordinates if answer.coordinates is None else answer.coordinates
    if not _finite(answer):
        return _Found((), onward)
    coefficients = tuple(rationals(p) for p in answer.coefficients)
    judged = all_fall(families, coefficients, sought.low, sought.high, sought.rate, sought.joining)
    if judged.holds:
        return _Found(coefficients, onward)
    words = f"{answer.solver} says {answer.status}, the exact check refuses it ({judged.reason})"
    return _Found((), onward, words, True) if answer.claims else _Found((), onward)


def all_fall(
    families: Families,
    coefficients: Sequence[fmpq_mat],
    low: fmpq,
    high: fmpq,
    rate: fmpq,
    joining: Joining,
    decay: fmpq | None = None,
) -> Definite:
    """Whether V = x' P(m) x falls along every family; exact, see `beamdesign.proof.decrease.holds_at_rate`."""
    for k, family in enumerate(families, start=1):
        answer = holds_at_rate(family, coefficients, low, high, rate, joining, decay)
        if not answer.holds:
            return Definite(False, f"stage {k}: {answer.reason}")
    return Definite(True)


def _largest_rate(
    families: Families,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    common: _Found,
    solve: SolveTogether,
    update: Update,
    share: float,
) -> PayloadRate | None:
    good: tuple[float, _Found] | None = None
    bad: float | None = None
    rate, coordinates, degree = FIRST_RATE, common.coordinates, len(common.coefficients) - 1
    while LEAST_RATE <= rate <= LARGEST_RATE:
        update(share, f"payload {joining.replace('_', ' ')}, {rate:.3g} kg/s")
        exact_rate = shortened(exact(rate), 3)
        tried = _tried(families, Sought(low, high, degree, exact_rate, joining), coordinates, solve)
        rate = nearest(exact_rate)
        if tried.coefficients:
            good, coordinates = (rate, tried), tried.coordinates
        else:
            bad = rate
        if good and bad:
            if bad / good[0] < RESOLUTION:
                break
            rate = (good[0] * bad) ** 0.5
        else:
            rate = rate * 4 if good else rate / 4
    return None if good is None else PayloadRate(joining, good[0], good[1].coefficients)


def _jumps(families: Families, low: fmpq, high: fmpq, joining: Joining, coordinates: np.ndarray) -> PayloadJumps | None:
    """The shortest average time between jumps of the payload that can be proved, over a few decay rates."""
    best: PayloadJumps | None = None
    slowest = min(slowest_decay(family, low, high) for family in families)
    for share in DECAY_SHARES:
        decay = shortened(exact(slowest * share), 3)
        sought, inner = Sought(low, high, 1, fmpq(0), joining, decay), coordinates
        for _ in range(2):  # the second time in the coordinates of the first answer
            answer = solve_jumps(families, sought, inner)
            if not _finite(answer):
                break
            found = _verified_jumps(families, sought, tuple(rationals(p) for p in answer.coefficients))
            if found is not None and (best is None or found.dwell_s < best.dwell_s):
                best = found
            if answer.coordinates is None:
                break
            inner = answer.coordinates
    return best


def _verified_jumps(families: Families, sought: Sought, coefficients: Coefficients) -> PayloadJumps | None:
    if not all_fall(families, coefficients, sought.low, sought.high, fmpq(0), sought.joining, sought.decay).holds:
        return None
    factor = _above(_largest_growth(families, sought, coefficients))
    if not holds_across_jumps(families[0], coefficients, sought.low, sought.high, factor, sought.joining).holds:
        return None
    dwell = _dwell(factor, sought.decay)
    return None if dwell is None else PayloadJumps(sought.joining, dwell, factor, sought.decay, coefficients)


def _largest_growth(families: Families, sought: Sought, coefficients: Coefficients) -> float:
    ends = [_at(coefficients, mass) for mass in (sought.low, sought.high)]
    leaps = [floats(jump(families[0], s)) for s in jump_shares(families[0], sought.low, sought.high, sought.joining)]
    return max(_ratio(leap @ after @ leap, before) for leap in leaps for before in ends for after in ends)


def _one_each(
    families: Families, low: fmpq, high: fmpq, coordinates: np.ndarray
) -> tuple[fmpq, fmpq, fmpq, tuple[Coefficients, ...]] | None:
    """Dwell, factor, decay and functions of the shortest dwell that can be proved; None where there is none."""
    best: tuple[fmpq, fmpq, fmpq, tuple[Coefficients, ...]] | None = None
    slowest = min(slowest_decay(family, low, high) for family in families)
    for share in DECAY_SHARES:
        decay = shortened(exact(slowest * share), 3)
        inner = coordinates
        for _ in range(TURNS):
            answers = solve_one_each(families, Sought(low, high, 1, fmpq(0), "matched", decay), inner)
            if not all(_finite(answer) for answer in answers):
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
        if not holds_at_rate(family, function, low, high, fmpq(0), "matched", decay).holds:
            return None
    pairs = [(i, j) for i in range(len(families)) for j in range(len(families)) if i != j]
    growth = max(_ratio(_at(functions[j], mass), _at(functions[i], mass)) for i, j in pairs for mass in (low, high))
    factor = _above(growth)
    for i, j in pairs:  # affine in m: both ends prove what lies between
        gaps = [factor * one - two for one, two in zip(functions[i], functions[j], strict=True)]
        if not positive_on(gaps, low, high).holds:
            return None
    dwell = _dwell(factor, decay)
    return None if dwell is None else (dwell, factor)


def _dwell(factor: fmpq, decay: fmpq) -> fmpq | None:
    """A little more than log(factor) / (2 decay)."""
    dwell = shortened(exact(log(nearest(factor)) / (2 * nearest(decay)) * (1 + 1e-6)), 4, up=True)
    return dwell if dwell_suffices(dwell, factor, decay) else None


def _above(growth: float) -> fmpq:
    return shortened(exact(max(growth, 1.0) * (1 + 1e-6) + 1e-9), 6, up=True)


def _at(coefficients: Coefficients, mass: fmpq) -> np.ndarray:
    return np.sum([floats(p) * nearest(mass) ** k for k, p in enumerate(coefficients)], axis=0)


def _ratio(top: np.ndarray, bottom: np.ndarray) -> float:
    """The largest of x' top x / x' bottom x, in floats, in coordinates in which bottom is the identity."""
    scale = 1 / np.sqrt(np.diag(bottom))
    inverse = np.linalg.inv(np.linalg.cholesky(bottom * np.outer(scale, scale)))
    return float(np.linalg.eigvalsh(inverse @ (top * np.outer(scale, scale)) @ inverse.T)[-1])


def _finite(answer: Answer) -> bool:
    return bool(answer.coefficients) and all(np.all(np.isfinite(p)) for p in answer.coefficients)


def _growing_cycle(families: Families, low: fmpq, high: fmpq) -> StageCycle | None:
    """Two stages in turn under which the motion grows, looked for at a few payloads; the fastest growth of all."""
    best: StageCycle | None = None
    for mass in (low, (low + high) / 2, high):
        for i in range(len(families)):
            for j in range(i + 1, len(families)):
                found = growing_times(at(families[i], mass), at(families[j], mass))
                if found is None or (best is not None and found[2] <= best.factor):
                    continue
                times = (found[0], found[1])
                one, two = families[i].at(mass), families[j].at(mass)
                cycles = proved_growth(one, two, exact(times[0]), exact(times[1]))
                best = StageCycle((i, j), nearest(mass), times, found[2], cycles)
    return best
