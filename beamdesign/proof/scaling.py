"""The largest scaling of a box of tolerances that is proved stable, and the least that is refuted."""

from collections.abc import Mapping
from dataclasses import dataclass

from flint import fmpq

from beamdesign.polynomial import exact
from beamdesign.proof.box import Box, BoxVerdict, certify_box
from beamdesign.proof.rational import nearest, shortened
from beamdesign.proof.refute import unstable_member
from beamdesign.proof.rig_family import Family, rig_family
from beamdesign.prototype import Prototype

_TRIES = 10
"""Most factors to try to prove."""


@dataclass(frozen=True)
class Scaling:
    """How far the ranges of a box can be drawn out around its nominal values.

    Attributes:
        proved: largest factor at which the whole box was proved stable; 0 if none was.
        refuted: least factor at which a member of the box was proved not to be stable; None where none was found.
        limit: factor beyond which a figure would reach zero; nothing above it was asked.
        verdict: that of the box scaled by `proved`, with its certificate; None if `proved` is 0.
        unstable_point: the member that refutes at `refuted`.
        reason: in words, what is known between the two factors.
    """

    proved: float
    refuted: float | None
    limit: float
    verdict: BoxVerdict | None
    unstable_point: Mapping[str, fmpq] | None
    reason: str


def largest_scaling(
    subject: Prototype | Family, box: Box, within: float = 0.02, budget: int = 4000, most: float = 10.0
) -> Scaling:
    """Draw the ranges of a box out until a member refutes it, and prove as much of that as can be.

    First the least factor is bracketed at which a member is found that is not stable. Then boxes a little smaller are
    tried, ever farther from it, until one is proved. Rigid ranges keep their size.

    Args:
        subject: a prototype with a controller, or any family.
        box: the tolerances at factor 1.
        within: how near to each other, relatively, the two factors should come.
        budget: most pieces to look at for each factor.
        most: largest factor to try.

    Raises:
        ValueError: as `certify_box`.
    """
    family = rig_family(subject) if isinstance(subject, Prototype) else subject
    limit = _limit(family, box, most)
    refuted, point = _least_refuted(family, box, limit, within / 4)
    proved, verdict, above = fmpq(0), None, limit if refuted is None else refuted
    factor = limit if refuted is None else _short(refuted * (1 - exact(within)))
    for _ in range(_TRIES):
        if not above * (1 - exact(1.001 * within)) > proved or factor <= 0:
            break
        found = certify_box(family, box.scaled(factor), budget, volumes=False)
        if found.stable:
            proved, verdict = factor, found
        else:
            above = factor
            if found.stable is False:
                refuted, point = factor, found.unstable_point
        if proved == limit:
            break
        factor = _short((proved + above) / 2)
    known = None if refuted is None else nearest(refuted)
    reason = _bracket(proved, above, refuted, limit)
    return Scaling(nearest(proved), known, nearest(limit), verdict, point, reason)


def _limit(family: Family, box: Box, most: float) -> fmpq:
    """The largest factor to try: beyond it a figure that is positive would reach zero."""
    limit = exact(most)
    for name, low, middle in zip(box.names, box.low, box.nominal, strict=True):
        if name in family.positive and name not in box.rigid and low < middle and middle > 0:
            limit = min(limit, middle / (middle - low) * fmpq(999, 1000))
    return _short(limit)


def _least_refuted(
    family: Family, box: Box, limit: fmpq, within: float
) -> tuple[fmpq | None, Mapping[str, fmpq] | None]:
    """The least factor, about, at which a member is found that is not stable, and that member."""

    def found(factor: fmpq) -> Mapping[str, fmpq] | None:
        return unstable_member(family.over(box.scaled(factor).ranges))

    low, high, point = fmpq(0), limit, found(limit)
    if point is None:
        return None, None
    while high - low > exact(within) * high and high > limit / 1000:
        middle = _short((low + high) / 2)
        if (nearer := found(middle)) is not None:
            high, point = middle, nearer
        else:
            low = middle
    return high, point


def _short(factor: fmpq) -> fmpq:
    """A factor rounded down to six digits."""
    return shortened(factor, 6) if factor > 0 else factor


def _bracket(proved: fmpq, above: fmpq, refuted: fmpq | None, limit: fmpq) -> str:
    low, high = f"{nearest(proved):.4g}", f"{nearest(above):.4g}"
    if proved == limit:
        return f"proved up to {low}, the largest factor that was tried"
    start = f"proved up to {low}" if proved > 0 else "no factor was proved"
    if refuted is None:
        return f"{start}, undecided at {high}; no member was found that is not stable"
    if above < refuted:
        return f"{start}, undecided at {high}, refuted at {nearest(refuted):.4g}"
    return f"{start}, refuted at {high}"
