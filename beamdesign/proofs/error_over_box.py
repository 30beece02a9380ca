"""What is linear plus a bounded error, over a box of tolerances: how far the tip strays, proved of every member.

An error of a size E whose impulse response to the tip is g moves it by no more than E times the integral of |g|, see
`beamdesign.proofs.bounded_error`. With Re s > -a free of poles, Cauchy and Schwarz, and Parseval, bound that by

    integral of |g| <= sqrt(integral of exp(-2 a t)) sqrt(integral of |g exp(a t)|^2) = sqrt(I / (2 a)),
    I = 1 / pi times the integral of |G(j w - a)|^2 over w from zero,

which of one exponential is exact at half its decay rate, and of an oscillation that decays slowly 11 % too much. So all
that is needed of every member is that (j w + c) G(j w - a) stays below a limit in each of several bands of frequency,
the last without end: magnitudes over a box, as other claims are. That none of them is infinite and one member has its
poles left of -a says that every member has. Pieces of the outer end mass have each a decay rate of their own.

Where the limits are, and how fast a decay rate, is found from samples; what is stated is proved.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product, zip_longest
from math import pi
from operator import itemgetter
from typing import Any

import numpy as np
from flint import arb, ctx, fmpq, fmpq_poly

from beamdesign.plant.members import family as linear_family
from beamdesign.polynomial import bounds, exact, is_hurwitz, nearest, roots, shortened, text
from beamdesign.proofs.bounded_error import SLIDING, Error, errors_in_loop, numerators, rows_of, slides
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_claims import BoxClaim
from beamdesign.proofs.box_member import below, parameters_at, with_number
from beamdesign.proofs.branch import Search
from beamdesign.proofs.certificate import Asked, Row, Weighed
from beamdesign.proofs.read_once import NotCovered
from beamdesign.proofs.rig_family import FACTOR, rig_family
from beamdesign.proofs.scope import unraised
from beamdesign.proofs.statement import UNKNOWN, Circle, Interval, PolynomialFamily, Statement, wrapped
from beamdesign.proofs.value_set import with_unknown
from beamdesign.proofs.zero_exclusion import PRECISION_BITS, held, pieces
from beamdesign.prototype import Prototype
from beamdesign.structure.lumped import figures
from beamdesign.time_limit import leave_out, over

METHOD = "bounded error: Parseval's theorem left of the axis, by zero exclusion"
MASS = "outer_end_mass"
_MEMBERS, _HALVINGS = 120, 2
"""Samples of each piece of the outer end mass, and how often the worst of these pieces is halved."""
_ROUNDS = 2
"""How often each figure of the slowest sample is put to either end, to find a slower one."""
_W = np.concatenate([[0.0], np.geomspace(0.5, 1e5, 700)])
_OF_SLOWEST = 0.15, 0.25, 0.35, 0.5, 0.65, 0.8
"""Decay rates that are tried, over that of the slowest pole of the samples."""
_EXCESS, _LAST = 0.01, 0.99
"""What a band may add to I over what the samples' largest values come to, and what is to be below the last band."""
_RELAXATIONS = {1.15: 60, 1.3: 100, 1.6: 600, 2.5: 2_000}
"""Limits over what the samples reach, tried in turn, and how many pieces are looked at; in the last band the last."""
_SLOWER = (1.0, 0.6, 0.35)
"""Shares of the decay rate of the slowest pole of the samples that are tried in turn: a member may be slower."""
_DIGITS = 4
_NO_FLOW = (
    "No bound is proved over the box: a force between piston and cylinder is not worth a flow of the rig's own oil and"
    " piston, as effects change these; `certify --nonlinear` says what is proved of the nominal figures."
)
Lead = tuple[fmpq, fmpq]
"""See `Weighed`."""
_NO_LEAD, _NONE = (fmpq(1), fmpq(0)), (fmpq(0), fmpq(0))


@dataclass(frozen=True)
class Plan:
    """How a piece is to be proved: its own ranges, the decay rate, bands and limits as samples say, and their bound."""

    own: Mapping[str, Interval]
    decay: float
    edges: tuple[float, ...]
    limits: tuple[float, ...]
    per_unit: float
    lead: Lead


def errors_over_box(prototype: Prototype, box: Box, budget: int = 20_000) -> tuple[list[BoxClaim], list[Row]]:
    """Prove how far the tip of every member strays from its linear response, for each error that is bounded.

    Args:
        prototype: with a controller of one law.
        box: ranges of its parameters; the others keep their values.
        budget: most pieces to look at in one band.

    Returns:
        Claims, one for each error and piece of the outer end mass, and rows for each effect and for all together.
    """
    found, rows = errors_in_loop(prototype)
    if any(one.place == "stroke" for one in found) and not worth_a_flow(prototype):
        rows += [Row((one.effect,), METHOD, False, _NO_FLOW) for one in found if one.place == "stroke"]
        found = [one for one in found if one.place != "stroke"]
        found = found if any(not one.per_m for one in found) else []
    found = [replace(one, size=one.size * _more(prototype, box, one)) for one in found]
    claims, most, known = list[BoxClaim](), list[fmpq](), dict[str, list[BoxClaim]]()
    try:
        for one in found:
            if one.size == 0:  # it moves nothing
                most.append(one.size)
                continue
            if one.place not in known:
                if over():
                    leave_out("errors that are bounded")
                    raise NotCovered("no time was left for it")
                known[one.place] = _claims(prototype, box, one, budget)
            own = [_resized(claim, one.size) for claim in known[one.place]]
            claims, most = [*claims, *own], [*most, max(exact(claim.asked.limit) for claim in own)]
    except ValueError as error:
        reason = f"No bound is proved over the box: {error}."
        return [], [*rows, *(Row((one.effect,), METHOD, False, reason) for one in found if not one.per_m)]
    spanned = linear_family(prototype, nearest(box.ranges.get(MASS, _NONE)[1]), box.ranges)
    of = f"for every member of the box and every payload that stays{unraised(spanned, [one.effect for one in found])}"
    return claims, [*rows, *rows_of(found, most, of, METHOD)]


def _resized(claim: BoxClaim, size: fmpq) -> BoxClaim:
    """The same of an error of another size at the same place."""
    weighed = claim.asked.error
    assert weighed is not None  # it is of a deviation
    limit = shortened(exact(claim.asked.limit) * size / weighed.size, _DIGITS, up=True)
    asked = Asked("deviation", nearest(limit), error=weighed._replace(size=size))
    return replace(claim, asked=asked, more={**claim.more, "size": text(size)})


def _more(prototype: Prototype, box: Box, error: Error) -> fmpq:
    """How much larger an error may be of a member than of the nominal rig: what is behind it has a gain of its own."""
    most = box.ranges.get(error.gain)
    return fmpq(1) if most is None else most[1] / exact(figures(prototype)[error.gain])


def _claims(prototype: Prototype, box: Box, error: Error, budget: int) -> list[BoxClaim]:
    """The claims of one error, one for each piece of the outer end mass.

    Raises:
        NotCovered: where one is not proved, with the reason.
    """
    if "delay" in box.ranges:
        raise NotCovered("a delay is not covered")
    if any(member.rig.sensor_rides for member in linear_family(prototype).members):
        raise NotCovered("the sensor rides on the mount, so that it does not see the tip alone")

    figure = {**{name: (exact(value),) * 2 for name, value in figures(prototype).items()}, **box.ranges}

    def lead(decay: fmpq) -> Lead:
        return leading(figure, decay) if error.place == "stroke" else _NO_LEAD

    def family(decay: fmpq, corner: fmpq) -> PolynomialFamily:
        weighed = Weighed(error.place, error.size, decay, corner, lead(decay))
        return rig_family(prototype, claim=Asked("deviation", 1.0, error=weighed), delayed=False, varying=box.ranges)

    def proved(one: Plan) -> BoxClaim:
        for slower in _SLOWER:
            with suppress(NotCovered):
                return _proved(family, box, one if slower == 1.0 else plan(one.own, slower), error, budget)
        return _proved(family, box, plan(one.own, _SLOWER[-1] / 2), error, budget)

    plan, own = partial(_plan, family(fmpq(0), fmpq(0)), box, lead), _sliding(box, prototype)
    plans = [plan(own)]
    low, high = box.ranges.get(MASS, (fmpq(0), fmpq(0)))
    for _ in range(_HALVINGS if low < high else 0):
        worst = max(plans, key=lambda one: one.per_unit)
        low, high = worst.own.get(MASS, (low, high))
        plans.remove(worst)
        middle = (low + high) / 2
        plans += [plan({**own, MASS: ends}) for ends in ((low, middle), (middle, high))]
    return [*map(proved, plans)]


def worth_a_flow(prototype: Prototype) -> bool:
    """Whether a force between piston and cylinder that slides moves the tip as the flow Q / A + A s / K times it does.

    It does not where effects change the oil, or make the sides of the piston unequal.
    """
    area, oil, leakage = (exact(figures(prototype)[name]) for name in ("piston_area", "oil_stiffness", "leakage"))
    flow = fmpq_poly([leakage * oil, area**2])
    members = linear_family(prototype).members
    with suppress(ArithmeticError):  # where no numerator is known at all
        known = (numerators(prototype, one.rig, {"stroke"}) for one in members if slides(one, members))
        return all(one["stroke"] * area * oil == one["flow"] * flow for one in known)
    return False


def leading(figure: Mapping[str, Interval], decay: fmpq) -> Lead:
    """Numbers r and t with |Q / A + A s / K| at most |r + t j w| at s = j w - decay for all figures within ranges.

    That is the flow behind the spool which moves the tip as a force between piston and cylinder does, over that force.
    """
    (least, most), area, oil = (figure.get(name, _NONE) for name in ("leakage", "piston_area", "oil_stiffness"))
    over_oil = area[1] / oil[0]
    return max(most / area[0], over_oil * decay - least / area[1]), over_oil


def _sliding(box: Box, prototype: Prototype) -> dict[str, Interval]:
    """Ranges of its own: what slides, at the ends at which it is the linear part, and the gain without effects.

    Raises:
        NotCovered: where effects never leave the gain as it is.
    """
    own = {}
    for effect in SLIDING.keys() & prototype.effects.keys():
        for figure, end in SLIDING[effect].items():
            if (name := f"{effect}_{figure}") in box.ranges:
                own[name] = (box.ranges[name][end == "high"],) * 2
    low, high = box.ranges.get(FACTOR, (fmpq(1), fmpq(1)))
    if not low <= 1 <= high:
        raise NotCovered("the effects never leave the gain as it is")
    return own | ({FACTOR: (fmpq(1), fmpq(1))} if FACTOR in box.ranges else {})


def _plan(
    plain: PolynomialFamily, box: Box, lead: Callable[[fmpq], Lead], own: Mapping[str, Interval], slower: float = 1.0
) -> Plan:
    """The decay rate and bands of the least bound that samples of a piece allow.

    Raises:
        NotCovered: where a sample is not stable.
    """
    statement = plain.over({**box.ranges, **own})
    generator = np.random.default_rng(0)
    shares = generator.choice([0.0, 0.5, 1.0], size=(_MEMBERS, len(statement.varying)), p=(0.45, 0.1, 0.45))
    slowest, row = min(((_slowest(statement, row), row) for row in shares[::2]), key=itemgetter(0))
    for _, k, end in product(range(_ROUNDS), range(len(row)), (0.0, 1.0)):
        other = np.concatenate([row[:k], [end], row[k + 1 :]])
        if (found := _slowest(statement, other)) < slowest:
            slowest, row = found, other
            shares = np.vstack([shares, row])
    if slowest <= 0:
        raise NotCovered("a member is not stable")
    rates = (float(f"{share * slower * slowest:.2g}") for share in _OF_SLOWEST)
    plans = (_bands(statement, shares, rate, own, lead) for rate in rates)
    return min(plans, key=lambda one: one.per_unit)


def _slowest(statement: Statement, shares: np.ndarray) -> float:
    """Decay rate of the slowest pole of a member."""
    member = parameters_at(statement, [exact(float(share)) for share in shares])
    return -max(root.real for root in roots(with_number(statement, member, fmpq(0))))


def _bands(
    statement: Statement, shares: np.ndarray, decay: float, own: Mapping[str, Interval], lead: Callable[[fmpq], Lead]
) -> Plan:
    """Bands at one decay rate, each as wide as it adds little to I."""
    s = 1j * _W - decay
    ahead = lead(exact(decay))
    (r, t), (none, slope) = (map(nearest, one) for one in (ahead, lead(fmpq(0))))
    plain, whole = with_unknown(statement, shares, -1j * s[None])  # a frequency with an imaginary part
    size = np.abs((whole - plain) / plain / s * (r + t * 1j * _W) / (none + slope * s)).max(axis=0)
    parts = (size[1:] ** 2 + size[:-1] ** 2) / 2 * np.diff(_W)
    total = parts.sum()
    last = int(np.searchsorted(parts.cumsum(), _LAST * total))
    cuts, start = [0], 0
    for k in range(1, last + 1):
        excess = size[start : k + 1].max() ** 2 * (_W[k] - _W[start]) - parts[start:k].sum()
        if excess > _EXCESS * total and k > start + 1:
            start = k - 1
            cuts.append(start)
    cuts.append(max(last, cuts[-1] + 1))
    corner = float(f"{_W[cuts[-1]]:.3g}")
    weighed = size * np.hypot(_W, corner)
    ends = [*cuts, len(_W) - 1]
    limits = tuple(float(weighed[a : b + 1].max()) for a, b in pairwise(ends))
    edges = (*(float(f"{_W[k]:.3g}") for k in cuts[:-1]), corner)
    least = _per_unit(exact(decay), [*map(exact, edges)], [*map(exact, limits)])
    return Plan(own, decay, edges, limits, nearest(least), ahead)


def _per_unit(decay: fmpq, edges: Sequence[fmpq], limits: Sequence[fmpq]) -> fmpq:
    """Upper bound of the integral of |g| from limits of (j w + c) G(j w - decay) in bands, c being the last edge."""
    corner = edges[-1]
    with ctx.workprec(PRECISION_BITS):
        angles = [*(arb(edge / corner).atan() for edge in edges), arb.pi() / 2]
        squares = (limit * limit * (b - a) for limit, (a, b) in zip(limits, pairwise(angles), strict=True))
        return bounds((sum(squares, arb(0)) / (arb.pi() * 2 * decay * corner)).sqrt())[1]


def _proved(
    family: Callable[[fmpq, fmpq], PolynomialFamily], box: Box, plan: Plan, error: Error, budget: int
) -> BoxClaim:
    """One piece, proved band by band.

    Raises:
        NotCovered: where a band is not.
    """
    decay, edges = exact(plan.decay), [*map(exact, plan.edges)]
    whole = family(decay, edges[-1])
    ranges, member = {**box.ranges, **plan.own}, {**whole.values, **box.nominal}
    member |= {name: min(max(member[name], low), high) for name, (low, high) in plan.own.items()}
    bands, limits = list[dict[str, Any]](), list[fmpq]()
    with ctx.workprec(PRECISION_BITS):
        if not is_hurwitz(with_number(whole.over(ranges), member, fmpq(0))):
            raise NotCovered("the nominal loop decays too slowly")
        for since, until, reached in zip_longest(edges, edges[1:], plan.limits):
            for relaxation, most in [*_RELAXATIONS.items()][0 if until is not None else -1 :]:
                limit = shortened(exact(relaxation * reached), _DIGITS, up=True)
                circles = {UNKNOWN: Circle(fmpq(0), 1 / limit)}
                statement = replace(whole, circles=circles, since=since, until=until).over(ranges)
                search = Search(statement)
                search.run(min(budget, most))
                settled = "?" not in search.tree and below(statement, member, since * since)
                if settled and all(held([*pieces(statement, search.tree)])):
                    break
            else:
                where = f"from {nearest(since) / (2 * pi):.4g} Hz up"
                raise NotCovered(f"the response {where} is not proved to be small enough")
            limits.append(limit)
            end = {} if until is None else {"until_rad_per_s": text(until)}
            bands.append(end | {"limit": text(limit), "tree": wrapped(search.tree)})
    bound = shortened(error.size * _per_unit(decay, edges, limits), _DIGITS, up=True)
    asked = Asked("deviation", nearest(bound), error=Weighed(error.place, error.size, decay, edges[-1]))
    more = {"place": error.place, "size": text(error.size), "band": bands}
    more |= {} if plan.lead == _NO_LEAD else {"lead": [*map(text, plan.lead)]}
    more |= {"decay_per_s": text(decay), "corner_rad_per_s": text(edges[-1])}
    return BoxClaim(asked, whole, True, "", own=plan.own, tree=None, more=more)
