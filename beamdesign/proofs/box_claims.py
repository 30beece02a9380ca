"""Claims over a whole box: of magnitudes of every member at every frequency, and of stability at lower gains.

A magnitude |a / p| reaches its limit where p with one more unknown vanishes (see `rig_family.claimed`), whose argument
is one more variable of the box. Where zero exclusion keeps that polynomial from zero everywhere, the magnitude has its
limit nowhere, and since box and frequencies are connected it stays below where it is below at one member without
motion, or at high frequencies. So nothing is needed for performance that stability does not need.

That every member is stable with its gain times every number from a share to one is stability of a box with one more
range, that of the gain.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING
from functools import partial
from math import inf, pi, prod
from typing import Any

import numpy as np
from flint import ctx, fmpq

from beamdesign.loop import loop
from beamdesign.plant.members import family as linear_family
from beamdesign.polynomial import exact, nearest, shortened, text
from beamdesign.proofs.box import Box, cubes_of, parts_beside
from beamdesign.proofs.box_member import (
    Ratios,
    Worst,
    below,
    member_at,
    ratios,
    stable_at,
    unstable_member,
    with_number,
    worst_in_bands,
    worst_near,
    worst_of,
)
from beamdesign.proofs.branch import Search
from beamdesign.proofs.certificate import LOWER_GAINS, Asked, peak_claim
from beamdesign.proofs.multiplier import angle_ratios, presupposed
from beamdesign.proofs.read_once import NotCovered
from beamdesign.proofs.rig_family import FACTOR, performing_spans, rig_family
from beamdesign.proofs.statement import UNKNOWN, Interval, PolynomialFamily, Statement
from beamdesign.proofs.tolerance_box import servo_off_over_box
from beamdesign.proofs.value_set import with_unknown
from beamdesign.proofs.writer import Tables, texts
from beamdesign.proofs.zero_exclusion import PRECISION_BITS, Piece, held, pieces
from beamdesign.prototype import Prototype
from beamdesign.quantities import decimal
from beamdesign.time_limit import leave_out, over, while_time

_TURNS, _SETTLED, _SAMPLES = 8, 1e-4, 4001
_LOOKS, _OPEN = (0.03, 0.08, 0.2), 300
"""Shares of the budget after which open pieces are looked into for members that exceed a limit, and how many."""
_VISITS = 500
"""Most sub-boxes that are sorted out to tell how much of the box is undecided."""
_ABOVE_ONE, _NONE = 1.0001, (fmpq(0), fmpq(0))
_RELAXATIONS = (1.002, 1.02, 1.1, 1.5)
"""How much looser than the worst member's figure a claim is made, tried in turn."""


@dataclass(frozen=True)
class BoxClaim:
    """A claim about every member of a box.

    Attributes:
        asked: the claim.
        family: the polynomial with the unknown.
        holds: True if proved of every member, False if one refutes it, None where neither was found.
        reason: in words, why it is not True; empty where it is.
        witness: value of every parameter of a member that refutes it.
        frequency_Hz: where that one does.
        pieces: number of pieces of frequency, parameters and unknown that were proved to be clear of zero; none where
            the search has left others.
        looked_at: number of pieces the search looked at.
        tree: marks of the pieces; None of a deviation, which has them in its bands.
        own: ranges that are other than those of the box, see `own_ranges`.
        more: what a certificate states of a deviation beside, see `beamdesign.proofs.error_over_box`.
    """

    asked: Asked
    family: PolynomialFamily = field(repr=False, compare=False)
    holds: bool | None
    reason: str
    witness: Mapping[str, fmpq] | None = None
    frequency_Hz: float | None = None
    pieces: int = 0
    looked_at: int = 0
    tree: Sequence[str] | None = field(default=(), repr=False, compare=False)
    own: Mapping[str, Interval] = field(default_factory=dict)
    more: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def table(self) -> Tables:
        """As a certificate states it."""
        asked = self.asked
        found: Tables = {"kind": asked.kind, "limit": text(exact(asked.limit))}
        found |= {} if asked.bandwidth_Hz == inf else {"bandwidth_Hz": text(exact(asked.bandwidth_Hz))}
        found |= {} if asked.kind != "loop_gain" else {"from_Hz": text(exact(asked.from_Hz))}
        found |= self.family.table(self.tree) | ({} if asked.multiplier is None else asked.multiplier.table())
        found |= self.more
        return found | ({"range": {name: texts(ends) for name, ends in self.own.items()}} if self.own else {})


def claim_over_box(
    prototype: Prototype, box: Box, asked: Asked, budget: int = 20_000, seconds: float = inf
) -> BoxClaim:
    """Prove or refute a claim about every member of a box.

    Args:
        prototype: with a controller of one law.
        box: ranges of its parameters; the others keep their values.
        asked: of the kind compliance, peak_compliance, peak_sensitivity, loop_gain, controller_effort, gain_margin or
            slope.
        budget: most pieces to look at.
        seconds: most time to spend on the search; what was found until then is proved all the same.

    Raises:
        ValueError: as `claimed` and `read_once`, or for a box that `PolynomialFamily.over` refuses.
    """
    family = _family(prototype, box, asked)
    return claim_of_family(family, box, asked, own_ranges(prototype, family, box, asked), budget, seconds)


def claim_of_family(
    family: PolynomialFamily,
    box: Box,
    asked: Asked,
    own: Mapping[str, Interval] | None = None,
    budget: int = 20_000,
    seconds: float = inf,
) -> BoxClaim:
    """The same of any polynomial with the unknown of a claim, over ranges of its own in the place of some of the box.

    Raises:
        ValueError: as `PolynomialFamily.over`.
    """
    own, of_gains = own or {}, asked.kind == "gain_margin"
    statement = family.over({**box.ranges, **own})
    inside = {name: min(max(value, own[name][0]), own[name][1]) for name, value in box.nominal.items() if name in own}
    nominal = {**family.values, **box.nominal, **inside}
    with ctx.workprec(PRECISION_BITS):
        if of_gains and (point := unstable_member(statement)) is not None:
            share = nearest(point["controller_gain"] / nominal["controller_gain"])
            reason = f"a member is not stable at {share:.6g} times the gain"
            return BoxClaim(asked, family, False, reason, point, own=own)
        by, searched = _by(asked), not of_gains and statement.inner.get("delay", _NONE) == _NONE

        def exceeding(shares: np.ndarray, at: np.ndarray) -> BoxClaim | None:
            point, w = member_at(statement, shares), shortened(exact(at.item()), 9)
            if below(statement, point, w * w):
                return None
            hertz = nearest(w) / (2 * pi)
            return BoxClaim(asked, family, False, f"exceeded by a member at {hertz:.6g} Hz", point, hertz, own=own)

        if searched and (refuted := exceeding(*worst_in_bands(statement, by)[0][1:])):
            return refuted
        try:
            search = Search(statement)
        except ValueError as error:
            return BoxClaim(asked, family, None, f"not covered: {error}", own=own)
        for spent in _LOOKS if searched else ():
            search.run(int(budget * spent), seconds * spent)
            # What stays open after a while may hold a member that the search for the worst did not come to.
            middles = search.open_middles(_OPEN)
            if len(middles[1]) and (refuted := exceeding(*worst_near(statement, by, *middles)[1:])):
                return refuted
        search.run(budget, seconds * (1 - sum(_LOOKS)))
        every = list(pieces(statement, search.tree))
        settled = [piece.direction != "?" for piece in every]
        proved = held(every) if all(settled) else []
    found = BoxClaim(asked, family, True, "", None, None, sum(proved), search.looked_at, search.tree, own)
    settled = proved or settled
    if not all(settled):
        left = [piece for piece, sure in zip(every, settled, strict=True) if not sure]
        return replace(found, holds=None, reason=f"undecided on {len(left)} of {len(settled)} pieces, {_share(left)}")
    if of_gains and stable_at(statement, nominal) is not True:
        return replace(found, holds=None, reason="no member could be told to be stable")
    if (used := asked.multiplier) is not None:
        at_none, at_one = (with_number(statement, nominal, fmpq(unknown)) for unknown in (0, 1))
        if not presupposed(at_none, at_one, used):
            return replace(found, holds=None, reason="the nominal loop does not have what the theorem presupposes")
    if not of_gains and statement.since == 0 and not below(statement, nominal, fmpq(0)):
        return replace(found, holds=False, reason="exceeded without motion", witness=nominal, frequency_Hz=0.0)
    return found


def _share(left: Sequence[Piece]) -> str:
    """How much of the box some pieces come to at most, and at what frequencies, in words."""
    names = [name for name in left[0].cell.statement.varying if name != UNKNOWN]
    cubes = cubes_of(left, names)
    alone = sum((prod((end - start for start, end in cube), start=fmpq(1)) for cube in cubes), fmpq(0))
    together = sum((volume for _, volume, clear in parts_beside(cubes, len(names), _VISITS) if not clear), fmpq(0))
    low, ends = min(piece.w1 for piece in left), [piece.w2 for piece in left]
    high = "up" if None in ends else f"to {nearest(max(end for end in ends if end is not None)) / (2 * pi):.4g} Hz"
    most = decimal(nearest(min(alone, together)), 3, ROUND_CEILING)
    return f"at most {most} of the box, from {nearest(low) / (2 * pi):.4g} Hz {high}"


def own_ranges(prototype: Prototype, family: PolynomialFamily, box: Box, asked: Asked) -> dict[str, Interval]:
    """Ranges over which a claim is looked at in the place of those of the box.

    All that the box has for more than stability; for a gain margin the gain also times the shares claimed; for a
    magnitude what effects span, as far as they ask for more than stability; for a slope the largest gains.

    Raises:
        ValueError: for a gain margin that is not a share of the gain.
    """
    own = dict(box.performing)
    if asked.kind == "slope":
        return own | {name: (box.ranges[name][1],) * 2 for name in (FACTOR, "controller_gain") if name in box.ranges}
    if asked.kind != "gain_margin":
        heaviest = nearest(box.ranges.get("outer_end_mass", _NONE)[1])
        spans = performing_spans(linear_family(prototype, heaviest, box.ranges))
        return own | {name: pair for name, pair in spans.items() if name in box.ranges and pair != box.ranges[name]}
    if not 0 <= asked.limit <= 1:
        raise ValueError(f"over a box gains are lower ones, not up to {asked.limit:g} times the gain")
    low, high = box.ranges.get("controller_gain", (family.values["controller_gain"],) * 2)
    return own | {"controller_gain": (low * exact(asked.limit), high)}


def over_own_ranges(prototype: Prototype, box: Box, asked: Asked) -> Statement:
    """What is looked at for a claim, over the box and ranges of its own.

    Raises:
        ValueError: as `claim_over_box`.
    """
    family = _family(prototype, box, asked)
    return family.over({**box.ranges, **own_ranges(prototype, family, box, asked)})


def best_over_box(prototype: Prototype, box: Box, budget: int = 4000) -> tuple[BoxClaim, ...]:
    """The best bandwidth, peak compliance and peak sensitivity proved of every member, and stability at lower gains.

    The worst member that a search finds shows what cannot be proved; what is a little looser is tried, ever more so,
    until it is proved. A claim for which that fails is left out, as is one for which there is no time.

    Args:
        prototype: with a controller of one law; its goal says what compliance the bandwidth is for.
        box: ranges of its parameters.
        budget: most pieces to look at in each try.
    """
    goal = prototype.goal
    lower = claim_over_box(prototype, box, LOWER_GAINS, budget)
    claims = [lower] if lower.holds else []
    if lower.holds is None and over():
        leave_out(_named(LOWER_GAINS))
    asked = Asked("peak_compliance", goal.compliance_m_per_N), Asked("peak_sensitivity", goal.peak_sensitivity)
    for one in while_time((Asked("compliance", goal.compliance_m_per_N), *asked), _named):
        with suppress(NotCovered):
            best = _least(prototype, box, one) if one.kind != "compliance" else _highest(prototype, box, one)
            limits: tuple[Asked, ...] = (one,)
            if one.kind == "peak_compliance":
                limits = peak_claim(goal, servo_off_over_box(prototype, box)[0]) if goal.peak_over_passive < inf else ()
            claims += [] if best is None else _proved(prototype, box, best, budget, limits)
    return tuple(claims)


def _named(asked: Asked) -> str:
    """What is asked, in words."""
    return asked.kind.replace("_", " ")


def _proved(prototype: Prototype, box: Box, best: Asked, budget: int, goal: Sequence[Asked]) -> list[BoxClaim]:
    """One claim, as near to the best as it is proved; none where it is not.

    A goal that the best keeps, and what is a little looser does not, is tried first.
    """
    tried = [relaxed(best, factor) for factor in _RELAXATIONS]
    for asked in (*(one for one in goal if best.limit <= one.limit < tried[0].limit), *tried):
        claim = claim_over_box(prototype, box, asked, budget)
        if claim.holds:
            return [claim]
        if over():
            leave_out(_named(best))
            break
    return []


def _family(prototype: Prototype, box: Box, asked: Asked) -> PolynomialFamily:
    return rig_family(prototype, claim=asked, delayed="delay" in box.ranges, varying=box.ranges)


def guaranteed_fields(claims: Sequence[BoxClaim]) -> dict[str, Any]:
    """The figures of claims that hold, by their keys in JSON; None, or false, where there is none."""
    found = {claim.asked.kind: claim.asked for claim in claims if claim.holds}
    return {
        "bandwidth_Hz": found["compliance"].bandwidth_Hz if "compliance" in found else None,
        "peak_sensitivity": found["peak_sensitivity"].limit if "peak_sensitivity" in found else None,
        "peak_compliance_m_per_N": found["peak_compliance"].limit if "peak_compliance" in found else None,
        "lower_gains": "gain_margin" in found,
    }


def relaxed(best: Asked, factor: float) -> Asked:
    """A claim that says a little less, with four digits."""
    if best.kind == "compliance" and best.bandwidth_Hz == inf:
        return best
    if best.kind == "compliance":
        return replace(best, bandwidth_Hz=nearest(shortened(exact(best.bandwidth_Hz / factor), 4)))
    return replace(best, limit=nearest(shortened(exact(best.limit * factor), 4, up=True)))


def _least(prototype: Prototype, box: Box, asked: Asked) -> Asked:
    """The claim at the magnitude of the worst member that was found."""
    for _ in range(_TURNS):
        statement = over_own_ranges(prototype, box, asked)
        _, shares, w = worst_in_bands(statement)[0]
        plain, whole = with_unknown(statement, shares, w)
        sizes = np.abs(plain), np.abs(whole if asked.kind == "peak_sensitivity" else whole - plain)
        found = (sizes[0] / sizes[1] if asked.kind == "peak_sensitivity" else sizes[1] / sizes[0]).item()
        if not 0 < found < inf or abs(found / asked.limit - 1) < _SETTLED:
            break
        asked = replace(asked, limit=max(found, _ABOVE_ONE if asked.kind == "peak_sensitivity" else 0.0))
    return asked


def _highest(prototype: Prototype, box: Box, asked: Asked) -> Asked | None:
    """The claim up to the bandwidth of the worst member that was found; None where that has none."""
    limit = asked.limit
    lightest = nearest(box.ranges.get("outer_end_mass", _NONE)[0])
    highest = loop(prototype, performing=True).at(lightest).bandwidth_Hz(limit)
    for _ in range(_TURNS if 0 < highest < inf else 0):
        statement = over_own_ranges(prototype, box, Asked("compliance", limit, highest))
        shares = worst_in_bands(statement)[0][1]
        w = np.linspace(0.0, 2 * pi * highest, _SAMPLES)[None]
        over = np.flatnonzero(ratios(statement, shares, w)[0] > 1)
        if not len(over):
            break
        highest = float(w[0, max(over[0] - 1, 0)]) / (2 * pi)
        if highest == 0:  # the worst member gives way too far however slow the force
            break
    return replace(asked, bandwidth_Hz=highest) if highest > 0 else None


def worst_over_box(prototype: Prototype, box: Box, asked: Asked) -> list[Worst]:
    """Seek members of a box that leave least of a claim's limit, one in each band of frequency, the worst first.

    Of a gain margin one that is not stable, if one is found.

    Args:
        prototype: with a controller of one law.
        box: ranges of its parameters.
        asked: as for `claim_over_box`.
    """
    statement = over_own_ranges(prototype, box, asked)
    if asked.kind == "gain_margin":
        point = unstable_member(statement)
        return [] if point is None else [Worst(inf, point, 0.0)]
    return worst_of(statement, _by(asked))


def _width(ends: Interval, kind: str) -> float:
    """Width of a range, relative to its middle for a factor."""
    low, high = map(nearest, ends)
    return 2 * (high - low) / (high + low) if kind == "product" else high - low


_NEAR, _NUDGE = 0.02, 0.05
"""What a member may have left of a limit (relative) that margins are told of, and by what share a figure is moved."""


def margins_over_box(prototype: Prototype, box: Box, asked: Asked) -> dict[str, float]:
    """How much farther each figure may be off before the worst members that were found reach a limit.

    In halves of its own range, the other figures staying as they are: first order, and sampled.

    Args:
        prototype: with a controller of one law.
        box: ranges of its parameters.
        asked: of a magnitude.
    """
    statement, found = over_own_ranges(prototype, box, asked), dict[str, float]()
    members = {name: (kind, parts) for name, kind, parts in statement.groups}
    ranges = statement.ranges | statement.parameters
    for ratio, shares, w in worst_in_bands(statement):
        if ratio < 1 - _NEAR:
            continue
        for k, name in enumerate(statement.varying):
            inward = shares.copy()
            inward[0, k] += _NUDGE if shares[0, k] < 0.5 else -_NUDGE
            # A half of the range is half of all shares.
            slope = (ratio - ratios(statement, inward, w).item()) / (2 * _NUDGE)
            margin = max(1 - ratio, 0.0) / slope if slope > 0 else inf
            kind, parts = members.get(name, ("sum", (name,)))
            for one in parts:  # of a sum or a product the whole is wider than each part
                if own := _width(ranges[one], kind):
                    found[one] = min(found.get(one, inf), margin * _width(ranges[name], kind) / own)
    return {name: margin for name, margin in found.items() if margin < inf}


def _by(asked: Asked) -> Ratios:
    """What says how near a member comes to the limit of a claim."""
    return ratios if asked.multiplier is None else partial(angle_ratios, asked.multiplier, asked.multiplier)
