"""Payload that changes at a bounded rate: a Lyapunov function that depends on the mass, and the largest rate proved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from flint import fmpq

from beamdesign.proof.decrease import ZERO, Joining
from beamdesign.proof.lmi import SOLVERS, Solve, Sought, solve
from beamdesign.proof.mass_family import Families
from beamdesign.proof.rational import nearest, shortened
from beamdesign.proof.verified import Coefficients, Status, Verified, sought_with

FIRST_RATE, LEAST_RATE, LARGEST_RATE = 16.0, 1e-3, 1e6
"""kg/s at which the search starts, below which it gives up, and above which it does not ask."""
RESOLUTION = 1.05
"""The largest rate proved is known to lie within this factor of one that was not proved."""
DEGREES = (1, 2)
"""Of P in m, tried in this order."""

Update = Callable[[float, str], object]
"""Takes the share of the work done and a word on what is being done."""


def quiet(fraction: float, text: str = "") -> None:
    """Report no progress."""


@dataclass(frozen=True)
class BoundedRate:
    """Stability for every m(t) within a range that changes at no more than a given rate, whichever stage acts when.

    Attributes:
        status: see `beamdesign.proof.verified.Status`; for the rate asked for, or for the largest one found.
        reason: in words, why it is not proved; empty where it is.
        joining: how payload joins.
        rate_kg_per_s: bound on |dm/dt|; None where nothing is proved.
        coefficients: of P(m).
        refused_kg_per_s: least rate that was tried and not proved; None where the search ended at `LARGEST_RATE`, or
            was for one rate alone.
    """

    status: Status
    reason: str
    joining: Joining
    rate_kg_per_s: float | None
    coefficients: Coefficients
    refused_kg_per_s: float | None = None


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
) -> BoundedRate:
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
    best: BoundedRate | None = None
    for degree in degrees:

        def sought(rate: fmpq, degree: int = degree) -> Sought:
            return Sought(low, high, degree, rate, joining)

        if wanted is None:
            found = _largest(families, sought, coordinates, solve, update)
        else:
            found = _at(families, sought, coordinates, wanted, solve)
        if found.status == "proved":
            return found
        best = found if best is None or found.status == "unverified" else best
    assert best is not None
    return best


def _at(
    families: Families, sought: Callable[[fmpq], Sought], coordinates: np.ndarray, wanted: fmpq, solve: Solve
) -> BoundedRate:
    """One rate, approached from lower ones for the sake of the coordinates."""
    for share in (fmpq(1, 64), fmpq(1, 8)):
        coordinates = sought_with(families, sought(wanted * share), coordinates, solve).coordinates
    found = sought_with(families, sought(wanted), coordinates, solve, SOLVERS)
    rate, joining = nearest(wanted), sought(wanted).joining
    if found.coefficients:
        return BoundedRate("proved", "", joining, rate, found.coefficients)
    return BoundedRate(found.status, found.reason, joining, None, (), rate)


def _largest(
    families: Families, sought: Callable[[fmpq], Sought], coordinates: np.ndarray, solve: Solve, update: Update
) -> BoundedRate:
    good: tuple[float, Verified] | None = None
    bad: float | None = None
    failed = Verified((), "", coordinates)
    rate, done, joining = FIRST_RATE, 0, sought(ZERO).joining
    while LEAST_RATE <= rate <= LARGEST_RATE:
        update(done / (done + 6), f"mass {joining.replace('_', ' ')}, {rate:.4g} kg/s")
        exact_rate = shortened(fmpq(round(rate * 10**9), 10**9), 3)
        found = sought_with(families, sought(exact_rate), coordinates, solve)
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
        return BoundedRate(failed.status, failed.reason, joining, None, (), bad)
    return BoundedRate("proved", "", joining, good[0], good[1].coefficients, bad)
