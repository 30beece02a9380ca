"""A solver's candidates for Lyapunov functions, verified in rationals, whatever a solver says of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from flint import fmpq_mat

from beamdesign.proof.decrease import holds_at_rate
from beamdesign.proof.lmi import SOLVERS, Answer, Solve, Sought, solve
from beamdesign.proof.mass_family import Families, rationals

Status = Literal["proved", "unverified", "refuted", "undecided"]
"""proved: verified in rationals. unverified: a solver claims it and the exact check does not confirm it, which is
worth nothing. refuted: a counterexample was verified. undecided: neither."""

Coefficients = tuple[fmpq_mat, ...]
"""Of P(m) in V = x' P(m) x, ascending in m, (n, n) each, exact, SI."""


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
        return "" if self.coefficients else self.refused or "no function was found"


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
