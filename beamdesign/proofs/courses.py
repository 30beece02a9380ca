"""Courses of the payload: however fast, or at a bounded rate. What is proved of each, and how candidates are verified.

Candidates for Lyapunov functions V = x' P(m) x come from `beamdesign.proofs.lmi`; what counts is
`beamdesign.proofs.decrease`, which checks them in rationals, whatever a solver says of them. Payload that changes
however fast, matched in velocity, is settled by a P that is free of m, or refuted by two masses in turn, by ball
arithmetic; a bounded rate by a P(m), for the largest rate that can be proved.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from flint import arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.polynomial import exact, nearest, shortened
from beamdesign.progress import Progress, silent
from beamdesign.proofs.decrease import ZERO, Joining, holds_at_rate
from beamdesign.proofs.lmi import SOLVERS, Answer, Sought, at, lyapunov_candidates, modal_coordinates, solve
from beamdesign.proofs.mass_family import Families, rationals

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 256
"""Steps by which a range of masses grows, as shares of it."""
FIRST_RATE, LEAST_RATE, LARGEST_RATE = 16.0, 1e-3, 1e6
"""kg/s at which the search starts, below which it gives up, and above which it does not ask."""
RESOLUTION = 1.05
"""The largest rate proved is known to lie within this factor of one that was not proved."""
DEGREES = (1, 2)
"""Of P in m, tried in this order."""
NONE_FOUND = "no function was found"

Status = Literal["proved", "unverified", "refuted", "undecided"]
"""proved: verified in rationals. unverified: a solver claims it and the exact check does not confirm it, which is
worth nothing. refuted: a counterexample was verified. undecided: neither."""

Coefficients = tuple[fmpq_mat, ...]
"""Of P(m) in V = x' P(m) x, ascending in m, (n, n) each, exact, SI."""


# Two masses or stages in turn under which the motion grows.


PRECISION_BITS = 384
DOUBLINGS = 13
"""Of the number of cycles, until a proof of growth is given up; a factor of 1.001 per cycle needs about 11."""

Corner = tuple[int, fmpq]
"""A stage, numbered from 0, and an outer end mass, kg."""


@dataclass(frozen=True)
class Cycle:
    """Sudden changes between two stages, or between two masses, matched, under which the loop's motion grows.

    Attributes:
        stages: the stage at each, numbered from 0.
        outer_end_mass_kg: the mass at each.
        time_s: time spent at each.
        factor: growth per cycle, the spectral radius over one cycle, in floats.
        cycles: repetitions after which growth is proved; 0 where it was only computed in floats.
    """

    stages: tuple[int, int]
    outer_end_mass_kg: tuple[float, float]
    time_s: tuple[float, float]
    factor: float
    cycles: int

    @property
    def proved(self) -> bool:
        """Whether ball arithmetic confirms the growth."""
        return self.cycles > 0


def proved_growth(first: fmpq_mat, second: fmpq_mat, time_first: fmpq, time_second: fmpq) -> int:
    """The number of cycles after which growth is proved, or 0.

    With M = exp(A2 t2) exp(A1 t1), enclosed by balls, |trace M^k| > n for one k proves that the spectral radius of M
    exceeds one, since |trace M^k| is at most n times its k-th power.
    """
    order = first.nrows()
    with ctx.workprec(PRECISION_BITS):
        power = arb_mat(second * time_second).exp() * arb_mat(first * time_first).exp()
        before = power
        for doubling in range(DOUBLINGS + 1):
            # Between powers of two lies a second chance for a complex pair, whose trace may be small at one of them.
            for k, candidate in ((2**doubling, power), (3 * 2**doubling // 2, power * before if doubling else power)):
                if abs(candidate.trace()) > order:
                    return k
            before, power = power, power * power
    return 0


def growing_cycle(families: Families, turns: Iterable[tuple[Corner, Corner]]) -> Cycle | None:
    """The cycle under which the motion grows fastest; finding none proves nothing.

    Args:
        families: the closed loop with each stage.
        turns: pairs of corners to go between.
    """
    best: Cycle | None = None
    for (i, first), (j, second) in turns:
        found = growing_times(at(families[i], first), at(families[j], second))
        if found is None or (best is not None and found[2] <= best.factor):
            continue
        *times, factor = found
        cycles = proved_growth(families[i].at(first), families[j].at(second), *map(exact, times))
        best = Cycle((i, j), (nearest(first), nearest(second)), (times[0], times[1]), factor, cycles)
    return best


def growing_times(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float] | None:
    """Times (s) at two matrices in turn under which the motion grows, and the growth per cycle, in floats.

    Times are tried on a logarithmic grid from a fraction of the fastest pole's period to the slowest's, and the best
    pair is refined; so finding none proves nothing.
    """
    from scipy.linalg import expm
    from scipy.optimize import minimize

    t = modal_coordinates(first)
    inverse = np.linalg.inv(t)
    ends = [t @ a @ inverse for a in (first, second)]
    speeds = np.abs(np.concatenate([np.linalg.eigvals(a) for a in ends]))
    times = np.geomspace(0.2 / speeds.max(), 2 * np.pi / max(speeds.min(), speeds.max() * 1e-4), 48)
    steps = [expm(np.multiply.outer(times, a)) for a in ends]
    products = steps[1][:, None] @ steps[0][None, :]  # [time at high, time at low]
    radii = np.abs(np.linalg.eigvals(products)).max(axis=-1)
    # Growth per second, not per cycle, would favour the shortest times, whose factor is too near one to prove.
    j, i = np.unravel_index(int(radii.argmax()), radii.shape)

    def decline(logs: np.ndarray) -> float:
        at_low, at_high = np.clip(np.exp(logs), times[0], times[-1])
        return -float(np.abs(np.linalg.eigvals(expm(ends[1] * at_high) @ expm(ends[0] * at_low))).max())

    best = minimize(decline, np.log([times[i], times[j]]), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
    if best.fun >= -1.0:
        return None
    at_low, at_high = (float(f"{value:.6g}") for value in np.clip(np.exp(best.x), times[0], times[-1]))
    return at_low, at_high, -float(best.fun)


# Courses.


@dataclass(frozen=True)
class Course:
    """What is proved of one kind of course of payload and stage.

    Attributes:
        status: see `Status`; for the whole range, and for the rate asked for or the largest one found.
        reason: in words, why it is not proved, or of stages not at any time; empty where it is.
        joining: how payload joins.
        functions: coefficients of P(m), of one common function or of one for each stage; none where nothing is proved.
        proved_up_to_kg: of any change, from the least mass up to here it is proved; the whole range, part of it, or
            None.
        rate_kg_per_s: bound on |dm/dt|; None where nothing is proved.
        refused_kg_per_s: least rate that was tried and not proved; None where the search ended at `LARGEST_RATE`, or
            was for one rate alone.
        dwell_s: average time between sudden changes that is proved to be enough, 0 where they may come at any time;
            None where nothing is proved.
        factor: growth of V at a change.
        decay_per_s: decay rate of |x| between changes.
        counterexample: a cycle of masses, or of stages, under which the motion grows, if one was found.
    """

    status: Status
    reason: str = ""
    joining: Joining = "matched"
    functions: tuple[Coefficients, ...] = ()
    proved_up_to_kg: float | None = None
    rate_kg_per_s: float | None = None
    refused_kg_per_s: float | None = None
    dwell_s: fmpq | None = None
    factor: fmpq = ZERO
    decay_per_s: fmpq = ZERO
    counterexample: Cycle | None = None

    @property
    def coefficients(self) -> Coefficients:
        """Those of the first function; empty where nothing is proved."""
        return self.functions[0] if self.functions else ()

    @property
    def claimed(self) -> str:
        """The claim of a solver that the exact check refused, in words; empty where there is none."""
        return self.reason if self.status == "unverified" else ""

    @property
    def kind(self) -> Literal["any_time", "dwell", "none"]:
        """Of sudden changes: whether they may come at any time, or after a dwell."""
        if self.status != "proved" or self.dwell_s is None:
            return "none"
        return "dwell" if self.dwell_s else "any_time"

    def suffices(self, dwell_s: float) -> bool:
        """Whether changes at least so far apart are proved to be stable."""
        return self.status == "proved" and self.dwell_s is not None and self.dwell_s <= exact(dwell_s)


_Found = tuple[Course, np.ndarray]


def sought_with(
    families: Families,
    sought: Sought,
    coordinates: np.ndarray,
    solvers: Sequence[str] = SOLVERS[:1],
) -> _Found:
    """Ask solvers, one after another, until an answer passes the exact check.

    Args:
        families: the closed loop with each stage.
        sought: what is asked of V.
        coordinates: (n, n), to solve in.
        solvers: their names.

    Returns:
        what the exact check left of the answers, and coordinates (n, n) to solve the next, harder problem in.
    """
    found, onward = Course("undecided", NONE_FOUND, sought.joining), coordinates
    for solver in solvers:
        answer = solve(families, sought, coordinates, solver)
        if not answer.coefficients:
            continue
        onward = coordinates if answer.coordinates is None else answer.coordinates
        coefficients, wrong = checked(families, sought, answer.coefficients)
        if not wrong:
            return Course("proved", "", sought.joining, (coefficients,)), onward
        if answer.claims:
            found = refused(answer, wrong, sought.joining)
    return found, onward


def checked(families: Families, sought: Sought, candidate: Sequence[np.ndarray]) -> tuple[Coefficients, str]:
    """Coefficients of P(m), (n, n) each, rounded to decimals, and what the exact check finds wrong with them."""
    if not all(np.all(np.isfinite(p)) for p in candidate):
        return (), "the candidate is not finite"
    coefficients = tuple(rationals(p) for p in candidate)
    answer = holds_at_rate(families, coefficients, sought.low, sought.high, sought.rate, sought.joining, sought.decay)
    return (coefficients, "") if answer.holds else ((), answer.reason)


def refused(answer: Answer, wrong: str, joining: Joining) -> Course:
    """A solver's claim that the exact check refuses."""
    words = f"{answer.solver} says {answer.status}, the exact check refuses it ({wrong})"
    return Course("unverified", words, joining)


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
    best: Course | None = None
    for degree in degrees:

        def ask(rate: fmpq, inner: np.ndarray, solvers: Sequence[str] = SOLVERS[:1], degree: int = degree) -> _Found:
            return sought_with(families, Sought(low, high, degree, rate, joining), inner, solvers)

        found = _largest(ask, joining, coordinates, update) if wanted is None else _at(ask, coordinates, wanted)
        if found.status == "proved":
            return found
        best = found if best is None or found.status == "unverified" else best
    assert best is not None
    return best


def _at(ask: Callable[..., _Found], coordinates: np.ndarray, wanted: fmpq) -> Course:
    """One rate, approached from lower ones for the sake of the coordinates."""
    for share in (fmpq(1, 64), fmpq(1, 8)):
        _, coordinates = ask(wanted * share, coordinates)
    found, _ = ask(wanted, coordinates, SOLVERS)
    rate = nearest(wanted)
    return replace(found, rate_kg_per_s=rate) if found.coefficients else replace(found, refused_kg_per_s=rate)


def _largest(ask: Callable[..., _Found], joining: Joining, coordinates: np.ndarray, update: Progress) -> Course:
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
