"""Courses of the payload: however fast, or at a bounded rate. What is proved of each, and how candidates are verified.

Candidates for Lyapunov functions V = x' P(m) x come from `beamdesign.proofs.lmi`; what counts is
`beamdesign.proofs.decrease`, which checks them in rationals, whatever a solver says of them. Payload that changes
however fast, matched in velocity, is settled by a P that is free of m, or refuted by two masses in turn; a bounded rate
by a P(m), for the largest rate that can be proved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proofs.decrease import ZERO, Joining, holds_at_rate
from beamdesign.proofs.growth import Cycle, growing_cycle, masses_in_turn
from beamdesign.proofs.lmi import SOLVERS, Answer, Solve, Sought, at, lyapunov_candidates, modal_coordinates, solve
from beamdesign.proofs.mass_family import Families, rationals
from beamdesign.rational import nearest, shortened

FIRST_STEP, LEAST_STEP = 1 / 8, 1 / 256
"""Steps by which a range of masses grows, as shares of it."""
FIRST_RATE, LEAST_RATE, LARGEST_RATE = 16.0, 1e-3, 1e6
"""kg/s at which the search starts, below which it gives up, and above which it does not ask."""
RESOLUTION = 1.05
"""The largest rate proved is known to lie within this factor of one that was not proved."""
DEGREES = (1, 2)
"""Of P in m, tried in this order."""
NONE_FOUND = "no function was found"

Update = Callable[[float, str], object]
"""Takes the share of the work done and a word on what is being done."""

Status = Literal["proved", "unverified", "refuted", "undecided"]
"""proved: verified in rationals. unverified: a solver claims it and the exact check does not confirm it, which is
worth nothing. refuted: a counterexample was verified. undecided: neither."""

Coefficients = tuple[fmpq_mat, ...]
"""Of P(m) in V = x' P(m) x, ascending in m, (n, n) each, exact, SI."""


def quiet(fraction: float, text: str = "") -> None:
    """Report no progress."""


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
    def kind(self) -> Literal["any_time", "dwell", "none"]:
        """Of sudden changes: whether they may come at any time, or after a dwell."""
        if self.status != "proved" or self.dwell_s is None:
            return "none"
        return "dwell" if self.dwell_s else "any_time"

    def suffices(self, dwell_s: float) -> bool:
        """Whether changes at least so far apart are proved to be stable."""
        return self.status == "proved" and self.dwell_s is not None and self.dwell_s <= exact(dwell_s)


@dataclass(frozen=True)
class Verified:
    """What the exact check left of the answers to one question.

    Attributes:
        coefficients: of P(m); empty where no answer passed.
        refused: the claim of a solver that the exact check refused, in words; empty where there is none.
        coordinates: (n, n), to solve the next, harder problem in.
    """

    coefficients: Coefficients
    refused: str
    coordinates: np.ndarray

    @property
    def status(self) -> Status:
        """Proved; or not, and whether a solver claimed it."""
        return "proved" if self.coefficients else "unverified" if self.refused else "undecided"

    @property
    def reason(self) -> str:
        """Why it is not proved, in words; empty where it is."""
        return "" if self.coefficients else self.refused or NONE_FOUND


def sought_with(
    families: Families,
    sought: Sought,
    coordinates: np.ndarray,
    solve: Solve = solve,
    solvers: Sequence[str] = SOLVERS[:1],
) -> Verified:
    """Ask solvers, one after another, until an answer passes the exact check.

    Args:
        families: the closed loop with each stage.
        sought: what is asked of V.
        coordinates: (n, n), to solve in.
        solve: what finds candidates.
        solvers: their names.
    """
    refused, onward = "", coordinates
    for solver in solvers:
        answer = solve(families, sought, coordinates, solver)
        if not answer.coefficients:
            continue
        onward = coordinates if answer.coordinates is None else answer.coordinates
        coefficients, wrong = checked(families, sought, answer.coefficients)
        if not wrong:
            return Verified(coefficients, "", onward)
        if answer.claims:
            refused = refusal(answer, wrong)
    return Verified((), refused, onward)


def checked(families: Families, sought: Sought, candidate: Sequence[np.ndarray]) -> tuple[Coefficients, str]:
    """Coefficients of P(m), (n, n) each, rounded to decimals, and what the exact check finds wrong with them."""
    if not all(np.all(np.isfinite(p)) for p in candidate):
        return (), "the candidate is not finite"
    coefficients = tuple(rationals(p) for p in candidate)
    answer = holds_at_rate(families, coefficients, sought.low, sought.high, sought.rate, sought.joining, sought.decay)
    return (coefficients, "") if answer.holds else ((), answer.reason)


def refusal(answer: Answer, wrong: str) -> str:
    """A solver's claim and why it is refused, in words."""
    return f"{answer.solver} says {answer.status}, the exact check refuses it ({wrong})"


def any_change(families: Families, low: fmpq, high: fmpq, solve: Solve = solve) -> tuple[Course, np.ndarray]:
    """Decide stability under arbitrary matched changes of mass between `low` and `high`, whichever stage acts when.

    Functions from Lyapunov's equation are tried first, then semidefinite programs on a growing range, each in the
    coordinates that the one before made ideal. All go through the exact check.

    Args:
        families: the closed loop with each stage, stable at `low`.
        low: least mass, kg.
        high: largest mass, kg.
        solve: what finds candidates.

    Returns:
        what is proved, and coordinates (n, n) to go on from.
    """
    coordinates = modal_coordinates(at(families[len(families) // 2], low))
    best, refused = low, ""
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
        found = sought_with(families, Sought(low, target), coordinates, solve)
        refused = found.refused if target == high else refused
        if found.coefficients:
            best, function, coordinates = target, found.coefficients, found.coordinates
            step *= 2
        else:
            step /= 2
    if best < high:  # the whole range once more, from the best coordinates there are
        found = sought_with(families, Sought(low, high), coordinates, solve, SOLVERS)
        refused = found.refused or refused
        if found.coefficients:
            best, function = high, found.coefficients
    functions, partly = ((function,), nearest(best)) if function else ((), None)
    if function and best == high:
        return Course("proved", functions=functions, proved_up_to_kg=partly), coordinates
    cycle = growing_cycle(families, masses_in_turn(families, low, high))
    status: Status = "unverified" if refused else "undecided"
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
        words = f"{refused}; {words}"
    return Course(status, words, "matched", functions, partly, counterexample=cycle), coordinates


def bounded_rate(
    families: Families,
    low: fmpq,
    high: fmpq,
    joining: Joining,
    coordinates: np.ndarray,
    wanted: fmpq | None = None,
    solve: Solve = solve,
    update: Update = quiet,
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
        solve: what finds candidates.
        update: told of progress.
        degrees: of P in m, tried in this order.
    """
    best: Course | None = None
    for degree in degrees:

        def ask(rate: fmpq, inner: np.ndarray, solvers: Sequence[str] = SOLVERS[:1], degree: int = degree) -> Verified:
            return sought_with(families, Sought(low, high, degree, rate, joining), inner, solve, solvers)

        found = (
            _largest(ask, joining, coordinates, update) if wanted is None else _at(ask, joining, coordinates, wanted)
        )
        if found.status == "proved":
            return found
        best = found if best is None or found.status == "unverified" else best
    assert best is not None
    return best


def _at(ask: Callable[..., Verified], joining: Joining, coordinates: np.ndarray, wanted: fmpq) -> Course:
    """One rate, approached from lower ones for the sake of the coordinates."""
    for share in (fmpq(1, 64), fmpq(1, 8)):
        coordinates = ask(wanted * share, coordinates).coordinates
    found, rate = ask(wanted, coordinates, SOLVERS), nearest(wanted)
    if found.coefficients:
        return Course("proved", "", joining, (found.coefficients,), rate_kg_per_s=rate)
    return Course(found.status, found.reason, joining, refused_kg_per_s=rate)


def _largest(ask: Callable[..., Verified], joining: Joining, coordinates: np.ndarray, update: Update) -> Course:
    good: tuple[float, Verified] | None = None
    bad: float | None = None
    failed = Verified((), "", coordinates)
    rate, done = FIRST_RATE, 0
    while LEAST_RATE <= rate <= LARGEST_RATE:
        update(done / (done + 6), f"mass {joining.replace('_', ' ')}, {rate:.4g} kg/s")
        exact_rate = shortened(fmpq(round(rate * 10**9), 10**9), 3)
        found = ask(exact_rate, coordinates)
        done, rate = done + 1, nearest(exact_rate)
        if found.coefficients:
            good, coordinates = (rate, found), found.coordinates
        else:
            bad, failed = rate, found
        if good and bad:
            if bad / good[0] < RESOLUTION:
                break
            rate = (good[0] * bad) ** 0.5
        else:
            rate = rate * 4 if good else rate / 4
    if good is None:
        return Course(failed.status, failed.reason, joining, refused_kg_per_s=bad)
    return Course("proved", "", joining, (good[1].coefficients,), rate_kg_per_s=good[0], refused_kg_per_s=bad)
