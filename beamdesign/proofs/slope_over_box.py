"""Multipliers over a box of tolerances: sought on its worst members, and proved of every member at once.

A linear program finds one multiplier for all members on a list (`beamdesign.proofs.multiplier_search`); a search over
the box in bands of frequency then finds members that it does not fit, or hardly, and these join the list, until none is
found. What is found is a guess, which `claim_over_box` proves or not.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from math import inf

import numpy as np
from flint import fmpq

from beamdesign.proofs.absolute_stability import NOT_ODD, Row, rows_of
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_claims import BoxClaim, claim_over_box, over_own_ranges
from beamdesign.proofs.box_member import worst_in_bands
from beamdesign.proofs.certificate import LOWER_GAINS, Asked
from beamdesign.proofs.multiplier import Multiplier, angle_ratios, closed_over_denominator
from beamdesign.proofs.multiplier_search import ENDS_rad_per_s, Grid, kernels
from beamdesign.proofs.nonlinear import NONE_KNOWN, is_linear
from beamdesign.proofs.read_once import NotCovered
from beamdesign.proofs.statement import Statement
from beamdesign.prototype import Prototype

_PLAIN = Multiplier((), fmpq(0))
_ORDERS = ((1, 2), (1, 2, 4))
"""Orders of kernels that are tried: the lower they are the less there is to prove."""
_ROUNDS, _SHARES = 10, 9
_KEPT, _GOOD = 0.3, 0.75
"""What part of the least Re z / |z| of its samples every member is to keep, and what part of the best one is enough."""
_LEAST = 2e-3
"""Of what is less no proof is tried."""
_FREQUENCIES, _NEAR_rad_per_s = 500, np.geomspace(20.0, 2000.0, 400)
_NOT_FOUND = "No multiplier was found for the whole box; that does not say that a loop of it oscillates."


def slope_over_box(
    prototype: Prototype,
    box: Box,
    budget: int = 20_000,
    seconds: float = inf,
    lower: BoxClaim | None = None,
    may_be_odd: bool = True,
) -> tuple[BoxClaim | None, str]:
    """Prove that every member comes to rest with every static characteristic of slope 0 to 1 in its current.

    Args:
        prototype: with a controller of one law.
        box: ranges of its parameters; the others keep their values.
        budget: most pieces to look at in one proof.
        seconds: most time for one proof.
        lower: what is known of stability at every lower gain, where that was asked before.
        may_be_odd: whether a multiplier for odd characteristics alone, without command and load, will do.

    Returns:
        The claim, proved; or None, and why there is none.
    """
    lower = claim_over_box(prototype, box, LOWER_GAINS, budget, seconds) if lower is None else lower
    if lower.holds is False:
        return None, (
            f"Of the box {lower.reason}, and a lower gain is what a saturation comes to at large amplitudes, so that no"
            " such multiplier exists."
        )
    if lower.holds is None:
        return None, f"Whether every member is stable at every lower gain: {lower.reason}."
    try:
        statement = over_own_ranges(prototype, box, _asked(_PLAIN))
    except NotCovered as error:
        return None, f"Not covered: {error}."
    for multiplier in _multipliers(statement, may_be_odd and not {*NOT_ODD} & {*prototype.effects}):
        claim = claim_over_box(prototype, box, _asked(multiplier), budget, seconds)
        return (claim, "") if claim.holds else (None, f"The multiplier that was found was not proved: {claim.reason}.")
    return None, _NOT_FOUND


def box_rows(prototype: Prototype, claim: BoxClaim | None, reason: str, moved: Sequence[Row] = ()) -> tuple[Row, ...]:
    """What is proved of the effects of every member while they move, in words, from what `slope_over_box` found.

    Args:
        prototype: with its effects.
        claim: as found.
        reason: why there is none.
        moved: what is proved of bounded errors.
    """
    of = "for every member of the box and every payload that stays"
    multiplier = None if claim is None else claim.asked.multiplier
    rows = [*rows_of(prototype, multiplier, reason, of), *moved]
    known = {name for row in rows for name in row.effects}
    if left := tuple(n for n in sorted(prototype.effects) if n not in known and not is_linear(n)):
        why = "Not covered over a box while it moves; `certify --nonlinear` says what is proved of the nominal figures."
        rows.append(Row(left, NONE_KNOWN, False, why))
    return tuple(rows)


def _asked(multiplier: Multiplier) -> Asked:
    return Asked("slope", 1.0, multiplier=multiplier)


def _multipliers(statement: Statement, may_be_odd: bool) -> Iterator[Multiplier]:
    """Multipliers that fit every member that a search found, those that need no odd characteristic first."""
    w = np.unique(np.concatenate([np.geomspace(*ENDS_rad_per_s, _FREQUENCIES), _NEAR_rad_per_s]))
    shares = np.full((_SHARES, len(statement.varying)), 0.5)
    for k in (k for k, name in enumerate(statement.varying) if "outer_end_mass" in name):
        shares[:, k] = np.linspace(0, 1, _SHARES)
    for odd, orders in product((False, True) if may_be_odd else (False,), _ORDERS):
        for _ in range(_ROUNDS):
            z = closed_over_denominator(_PLAIN, statement, shares, w[None])
            found = _best(Grid(w, z, popov=False), orders, odd)
            if found is None:
                break
            multiplier, least = found
            worst = worst_in_bands(statement, partial(angle_ratios, multiplier, _PLAIN))
            near = [one for one in worst if one[0] > 1 - _KEPT * least]
            if not near:
                yield multiplier
                break
            shares = np.concatenate([shares, *(some for _, some, _ in near)])
            w = np.unique(np.concatenate([w, *(at[0] for _, _, at in near)]))


def _best(grid: Grid, orders: Sequence[int], odd: bool) -> tuple[Multiplier, float] | None:
    """A multiplier of low degree that fits the samples almost as well as any, and the least Re z / |z| of these."""
    found = []
    for multiplier, _ in grid.candidates(kernels(orders), odd):
        if multiplier.admissible and multiplier.popov_s == 0:
            found.append((multiplier, float((multiplier.response(grid.w) * grid.turned).real.min())))
    enough = _GOOD * max((least for _, least in found), default=0.0)
    good = [one for one in found if one[1] >= max(enough, _LEAST)]
    return min(good, key=lambda one: one[0].parts[2].degree(), default=None)
