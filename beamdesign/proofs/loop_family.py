"""Any loop whose coefficients depend on parameters, proved for every value of them: exactly of one, by pieces of many.

A coefficient is any polynomial in the parameters. See `any_loop` for what a discrete loop is looked at in.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf
from typing import TYPE_CHECKING, Any

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly

from beamdesign.arguments import takes
from beamdesign.loop import Loop
from beamdesign.polynomial import Affine, nearest
from beamdesign.proofs.any_loop import (
    SAFE,
    OpenLoop,
    Pair,
    ProvedLoop,
    in_p,
    number,
    open_loop,
    order,
    period,
    proved,
    refused,
)
from beamdesign.proofs.box import Box, BoxVerdict, box_of, certify_box
from beamdesign.proofs.box_claims import claim_of_family
from beamdesign.proofs.certificate import Asked, Kind
from beamdesign.proofs.performance import keeps, least_of
from beamdesign.proofs.read_once import Expression, S, read_once
from beamdesign.proofs.rig_family import TRANSPORT, claimed
from beamdesign.proofs.stability import StabilityMap, stable_ranges
from beamdesign.proofs.statement import UNKNOWN, Interval, PolynomialFamily, in_context, written
from beamdesign.quantities import stated_range
from beamdesign.records import InputError
from beamdesign.result import Result

if TYPE_CHECKING:
    import control

_CORNERS = 6
"""Most parameters of which every corner is looked at."""
_BEYOND = fmpq(10) ** 400
"""Larger than any float."""
PEAK: Kind = "peak_sensitivity"


@dataclass(frozen=True)
class LoopFamily:
    """L = numerator / denominator over parameters, in s or in p, exact.

    Attributes:
        numerator: N.
        denominator: D.
        order: degree of D in s or z.
        period_s: of a discrete loop.
        ranges: of each parameter.
    """

    numerator: fmpq_mpoly
    denominator: fmpq_mpoly
    order: int
    period_s: float | None
    ranges: Mapping[str, Interval]

    @property
    def box(self) -> Box:
        """The ranges, their middles being what scaling starts from."""
        return box_of(self.ranges)

    def at(self, point: Mapping[str, fmpq]) -> OpenLoop:
        """One member."""
        above, below = (_in_s(part.subs(dict(point.items()))) for part in (self.numerator, self.denominator))
        return OpenLoop(above, below, self.order, self.period_s)

    def over_one(self) -> Loop | None:
        """The loop over its only parameter, in the place of the mass; None for several, or where it is not affine."""
        if len(self.ranges) != 1:
            return None
        (name,) = self.ranges
        parts = []
        for part in (self.denominator, self.numerator):
            slope = part.derivative(name)
            if slope.derivative(name) != 0:
                return None
            parts.append(Affine(_in_s(part.subs({name: 0})), _in_s(slope.subs({name: 0}))))
        return Loop(parts[0], parts[1], fmpq_poly([0]))

    def expression(self, claim: Asked | None = None) -> PolynomialFamily:
        """The closed loop's polynomial, or that of a claim of it, as boxes are proved of.

        Its parameters are put in as few places as are found where all of them are positive, since factors that this
        leaves out might vanish.
        """
        p, circles, since, until = self.numerator + self.denominator, {}, fmpq(0), None
        if claim is not None:
            p, circles[UNKNOWN], since, until = claimed(claim, p, self.numerator, 0 * p)
        values = self.box.nominal
        positive = [name for name, (low, _) in self.ranges.items() if low > 0]

        def shaped(form: Expression) -> PolynomialFamily:
            shape = form.p, values, form.leaves, form.bound
            return PolynomialFamily("loop", *shape, {}, form.groups, positive, circles, since, until)

        plain, turned = p.subs({UNKNOWN: 0}), p.derivative(UNKNOWN)
        if len(positive) == len(values):
            found = shaped(read_once(p, [*values], (UNKNOWN,)))
            # Where leading terms of its products cancel each other, the form is of a higher degree than p.
            if found.over({}).degree == tuple(_degree(part) for part in (plain, turned)):
                return found
        if claim is None:
            return shaped(Expression("plain", {"plain": written(plain)}, (), ()))
        leaves = {"plain": written(plain), "turned": written(turned)}
        return shaped(Expression(f"plain + {UNKNOWN} * turned", leaves, (("plain", "turned"),), ()))

    def turns_at_infinity(self, limit: fmpq, points: Iterable[Mapping[str, fmpq]]) -> bool:
        """Whether at one of these members no frequency is high enough for a peak sensitivity to be proved from it up.

        The unknown of the claim, see `claimed`, has a size of up to limit / (limit - 1).
        """
        loops, n = map(self.at, points), self.order
        return any(abs(one.numerator[n]) * limit >= abs(one.denominator[n]) * (limit - 1) for one in loops)


@dataclass(frozen=True, repr=False)
class ProvedFamily(Result):
    """What is proved of a loop for every value of its parameters.

    Attributes:
        stable: True if proved of every member, False if one is proved not to be, None where neither was found.
        reason: why it is not True, or which claim is not proved; empty where all is.
        parameters: range of each.
        middle: what is proved of the member in the middle of all ranges.
        stable_ranges: of a single parameter that enters affinely all stable ranges, ends rounded inwards, and open
            where the loop stops being stable; else None.
        peak_sensitivity: of such a one, what max |S| is proved to be at most, to 1e-4 from one up; else None.
        unstable_member: one that is proved not to be stable, rounded to floats.
        claims: by figure, whether it is proved (True), refuted (False) or neither (None) of all members.
        certificate: text that `check` proves again; it states stability alone. Empty where that is undecided.
        family: the loop over its parameters.
    """

    stable: bool | None
    reason: str
    parameters: Mapping[str, Pair]
    middle: ProvedLoop
    stable_ranges: tuple[Pair, ...] | None = None
    peak_sensitivity: float | None = None
    unstable_member: Mapping[str, float] | None = None
    claims: Mapping[str, bool | None] = field(default_factory=dict)
    certificate: str = field(default="", repr=False)
    family: LoopFamily | None = field(default=None, repr=False, compare=False)

    @property
    def status(self) -> str:
        """Whether every member is stable and keeps what was claimed."""
        answers = (self.stable, *self.claims.values())
        return "yes" if self.yes else "no" if False in answers else "undecided"

    def to_dict(self) -> dict[str, Any]:
        """Its fields but the loop and the certificate."""
        return {name: value for name, value in super().to_dict().items() if name != "certificate"}

    def rows(self) -> Sequence[tuple[Any, ...]]:
        """Ranges of the parameters, what is stable of a single one, and the largest peak."""
        found: list[tuple[Any, ...]] = [(name, stated_range(ends)) for name, ends in self.parameters.items()]
        found += [("stable", stated_range(ends)) for ends in self.stable_ranges or ()]
        return found if self.peak_sensitivity is None else [*found, (PEAK, self.peak_sensitivity, "at most")]


@takes()
def prove(
    loop: "control.TransferFunction | control.StateSpace | Sequence[Any]",
    parameters: Mapping[str, Pair] | None = None,
    *,
    claims: Mapping[str, float] | None = None,
) -> ProvedLoop | ProvedFamily:
    """Prove stability, margins and peaks of a loop of one's own under negative unity feedback.

    Every number counts as the decimal that it prints as; what python-control worked out before is taken as it stands.
    A state space is converted in rationals, and modes that it hides are looked at too.

    Args:
        loop: L as a transfer function or state space of python-control, continuous or discrete (a `dt` of True counts
            as 1 s); or, with parameters, as (numerator, denominator) or (numerator, denominator, period in s). Each is
            a text in s (or z) and the parameters with + - * / and **, or a list of coefficients, that of the highest
            power first: numbers, such texts, or {"": 1.0, "m": 2.0} for 1 + 2 m.
        parameters: range of each by name; the result is about every member.
        claims: limits by figure: of a loop its figures, peaks at most and margins at least; over parameters
            `peak_sensitivity` alone.

    Raises:
        InputError: for a loop with several inputs or outputs, more zeros than poles, or a figure that is no number; or
            for an unknown name.
    """
    claims = claims or {}
    if not parameters and hasattr(loop, "ninputs"):
        return with_claims(proved(open_loop(loop)), claims)
    family = loop_family(loop, parameters or {})
    if not parameters:
        return with_claims(proved(family.at({})), claims)
    if unknown := sorted(set(claims) - {PEAK}):
        raise InputError("claims", [(name, f"over parameters there is {PEAK} alone") for name in unknown])
    return _over(family, claims.get(PEAK))


def with_claims(found: ProvedLoop, claims: Mapping[str, float]) -> ProvedLoop:
    """The same with limits decided, each by the figure's bounds.

    Raises:
        InputError: for a figure that a loop does not have.
    """
    if unknown := sorted(set(claims) - set(SAFE)):
        raise InputError("claims", [(name, f"no such figure; there are {', '.join(SAFE)}") for name in unknown])
    decided = {name: _kept(name, getattr(found, name), limit) for name, limit in claims.items()}
    words = {False: "does not keep", None: "is too near to tell from"}
    wrong = [f"{n} {words[kept]} {claims[n]:g}" for n, kept in decided.items() if kept is not True]
    return replace(found, claims=decided, reason=found.reason or "; ".join(wrong))


def _kept(name: str, pair: Pair | None, limit: float) -> bool | None:
    if pair is None:
        return False
    given, (low, high) = number(limit), (_BEYOND if end == inf else fmpq(*end.as_integer_ratio()) for end in pair)
    kept, lost = (low >= given, high < given) if SAFE[name] == "at least" else (high <= given, low > given)
    return True if kept else False if lost else None


def loop_family(loop: Any, parameters: Mapping[str, Pair]) -> LoopFamily:
    """The exact polynomials of what `prove` takes with parameters.

    Raises:
        InputError: as there.
    """
    if hasattr(loop, "ninputs"):
        raise refused("with parameters it is (numerator, denominator), whose coefficients they stand in")
    if isinstance(loop, str) or not isinstance(loop, Sequence) or len(loop) not in (2, 3):
        raise refused("expected a system of python-control, or (numerator, denominator) or that with a period")
    of, dt = ("s", None) if len(loop) == 2 or loop[2] in (0, None) else ("z", period(loop[2]))
    for name in parameters:
        if not (name.isidentifier() and name.isascii()) or name in ("s", "z", TRANSPORT, UNKNOWN):
            raise InputError("parameters", [(name, "is no name that a parameter can have")])
    context = fmpq_mpoly_ctx.get([S, UNKNOWN, *parameters], "lex")
    try:
        above, below = (_polynomial(part, context, of, parameters) for part in loop[:2])
    except ValueError as error:
        raise refused(str(error)) from error
    ranges = {name: _range(name, ends) for name, ends in parameters.items()}
    n = order(_degree(above), _degree(below))
    if dt is not None:
        above, below = (in_p(_coefficients(part), n, context.gen(0)) for part in (above, below))
    return LoopFamily(above, below, n, dt, ranges)


def _range(name: str, ends: Any) -> Interval:
    try:
        low, high = (number(end) for end in ends)
    except (TypeError, ValueError) as error:
        raise InputError("parameters", [(name, f"expected a pair of numbers, not {ends!r}")]) from error
    if low > high:
        raise InputError("parameters", [(name, f"is an empty range: {nearest(low):g} is above {nearest(high):g}")])
    return low, high


def _polynomial(part: Any, context: fmpq_mpoly_ctx, of: str, parameters: Iterable[str]) -> fmpq_mpoly:
    """A text in s or z, or coefficients of which that of the highest power is first."""
    named = {name: name for name in parameters}
    if isinstance(part, str):
        return in_context(part, context, {**named, of: S})

    def one(value: Any) -> fmpq_mpoly:
        if isinstance(value, str):
            return in_context(value, context, named)
        if isinstance(value, Mapping):
            terms = (number(c) * in_context(name or "1", context, named) for name, c in value.items())
            return sum(terms, context.constant(0))
        return context.constant(number(value))

    if not isinstance(part, Iterable):
        raise InputError("loop", [(of, f"expected a text in {of} or a list of coefficients, is {part!r}")])
    s = context.gen(0)
    return sum((one(value) * s**k for k, value in enumerate(reversed([*part]))), context.constant(0))


def _coefficients(part: fmpq_mpoly) -> list[fmpq_mpoly]:
    """Those of the first variable, from that of its power zero up, in the others."""
    found: list[dict[tuple[int, ...], fmpq]] = [{} for _ in range(_degree(part) + 1)]
    for (power, *rest), c in part.to_dict().items():
        found[int(power)][(0, *rest)] = c
    return [part.context().from_dict(terms) for terms in found]


def _in_s(part: fmpq_mpoly) -> fmpq_poly:
    """A polynomial in s alone."""
    powers = {int(power): c for (power, *_), c in part.to_dict().items()}
    return fmpq_poly([powers.get(k, 0) for k in range(max(powers, default=-1) + 1)])


def _degree(part: fmpq_mpoly) -> int:
    """In s; -1 for zero."""
    return -1 if part == 0 else int(part.degrees()[0])


def _over(family: LoopFamily, limit: float | None) -> ProvedFamily:
    given = {name: (nearest(low), nearest(high)) for name, (low, high) in family.ranges.items()}
    middle = proved(family.at(family.box.nominal))
    if _degree(family.numerator + family.denominator) < family.order:
        where = "infinity" if family.period_s is None else "z = -1"
        return ProvedFamily(False, f"every member has a closed-loop pole at {where}", given, middle, family=family)
    over, verdict = family.over_one(), certify_box(family.expression(), family.box, volumes=False)
    found: dict[str, Any] = {"certificate": verdict.certificate, "family": family}
    stable, reason = verdict.stable, verdict.reason
    if over is not None:
        (ends,) = family.ranges.values()
        exactly = stable_ranges(over.characteristic, *ends)
        stable, found["stable_ranges"] = exactly.stable, tuple(exactly.stable_ranges)
        reason = _in_words(exactly, *family.ranges) if not stable else ""
        if stable:
            found[PEAK] = least_of(PEAK, over, ends)
    if verdict.unstable_point is not None:
        found["unstable_member"] = {name: nearest(verdict.unstable_point[name]) for name in family.ranges}
    if limit is not None:
        held, why = _keeps(family, over, limit, verdict) if stable else (stable, "")
        found["claims"], reason = {PEAK: held}, reason or why
    return ProvedFamily(stable, reason, given, middle, **found)


def _in_words(found: StabilityMap, name: str) -> str:
    ranges = ", ".join(map(stated_range, found.stable_ranges))
    return f"stable only for {name} from {ranges}" if ranges else f"stable for no {name} of the range"


def _keeps(family: LoopFamily, over: Loop | None, limit: float, verdict: BoxVerdict) -> tuple[bool | None, str]:
    """Whether every member keeps a peak sensitivity, all of them being stable; and why not."""
    if limit <= 0:
        return False, f"no loop has a peak sensitivity of {limit:g}"
    if over is not None:
        (ends,) = family.ranges.values()
        held = keeps(PEAK, over, number(limit), ends)
        return held, "" if held else f"a member exceeds the peak sensitivity {limit:g}"
    corners = product(*family.ranges.values()) if len(family.ranges) <= _CORNERS else ()
    points = [verdict.box.nominal, *(dict(zip(family.ranges, values, strict=True)) for values in corners)]
    for point in points:
        if (peak := proved(family.at(point)).peak_sensitivity) is not None and peak[0] > limit:
            where = ", ".join(f"{name} {nearest(value):.6g}" for name, value in point.items())
            return False, f"the member at {where} has a peak sensitivity of {peak[0]:.6g}"
    if family.turns_at_infinity(number(limit), points):
        where = "infinite frequency" if family.period_s is None else "z = -1"
        return None, f"not decided: the peak sensitivity where |L| is as large as here at {where}"
    try:
        asked = Asked(PEAK, limit)
        claim = claim_of_family(family.expression(asked), family.box, asked)
    except ValueError as error:
        return None, f"not covered: {error}"
    return claim.holds, claim.reason
