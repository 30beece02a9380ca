"""All that is proved of every rig within tolerances at once: stability, performance, and what is not linear."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any

from flint import fmpq

from beamdesign.arguments import checked, takes
from beamdesign.polynomial import nearest
from beamdesign.progress import Progress, silent
from beamdesign.proofs.absolute_stability import box_rows, slope_over_box
from beamdesign.proofs.box import Box, BoxVerdict
from beamdesign.proofs.box import certify_box as decide
from beamdesign.proofs.box_claims import BoxClaim, best_over_box, guaranteed_fields
from beamdesign.proofs.certificate import Row, over_passive
from beamdesign.proofs.changing_gain import changing_over_box
from beamdesign.proofs.error_over_box import errors_over_box
from beamdesign.proofs.rig_family import FACTOR
from beamdesign.proofs.scope import holds_for, members, near_rest, uncovered
from beamdesign.proofs.statement import Interval
from beamdesign.proofs.tolerance_box import (
    Scaling,
    figure_key,
    largest_scaling,
    scaling_of_each,
    servo_off_over_box,
    tolerance_box,
)
from beamdesign.prototype import Prototype
from beamdesign.quantities import Delay, Sigmas, stated_range
from beamdesign.result import Result, finite, picked
from beamdesign.time_limit import leave_out, over, share, within


@dataclass(frozen=True, repr=False)
class BoxGuarantee(Result):
    """What is proved of every rig of a box.

    Attributes:
        prototype: with one law.
        outer_end_mass_kg: payloads.
        sigmas: standard deviations to either side of every figure.
        box: the ranges.
        verdict: on stability.
        claims: what is proved beside it; none where that is not proved.
        nonlinear: what is proved of effects while they move; None where it was not asked for.
        scaling: of all tolerances, the largest that is stable; None where it was not asked for, or nothing `scales`.
        each: of each figure alone, the others as they are.
        left_out: what was not looked for to the end for want of time, in words.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    sigmas: float
    box: Box
    verdict: BoxVerdict
    claims: tuple[BoxClaim, ...]
    nonlinear: tuple[Row, ...] | None
    scaling: Scaling | None
    each: Mapping[str, Scaling]
    left_out: tuple[str, ...] = ()

    @property
    def scales(self) -> bool:
        """Whether any range comes from a tolerance: those of payload and delay are kept as they are asked for."""
        return not self.box.rigid.issuperset(self.box.names)

    @property
    def stable(self) -> bool | None:
        """Whether every rig is proved to be stable, or one not to be; None where neither is."""
        return self.verdict.stable

    @property
    def proved(self) -> bool:
        """Whether linear members are proved stable, and all that was asked of what is not linear."""
        return self.stable is True and all(row.proved for row in self.nonlinear or ())

    @cached_property
    def small_motion(self) -> str:
        """What is proved of linear members and not of small motion about rest, in words; empty where all is."""
        return uncovered(self.prototype, self.nonlinear or (), ())

    @property
    def yes(self) -> bool:
        """Whether all of it is proved, of small motion about rest too."""
        return self.proved and not self.small_motion

    @property
    def reason(self) -> str:
        """Why stability is not proved; empty where it is."""
        return self.verdict.reason or (self.small_motion if self.stable else "")

    @cached_property
    def text(self) -> str:
        """The certificate, which `beamdesign.check` proves again; empty where nothing is decided."""
        return self.verdict.write(self.claims)

    @cached_property
    def guaranteed(self) -> dict[str, Any]:
        """The figures that every rig keeps, by their keys in JSON; None, or false, where none is proved."""
        found = guaranteed_fields(self.claims) | {"outer_end_mass_kg": self.outer_end_mass_kg}
        if softest := found["peak_compliance_m_per_N"]:
            off, _ = servo_off_over_box(self.prototype, self.box)
            found |= {"servo_off_m_per_N": off, "peak_over_passive": over_passive(softest, off)}
        if performing := {name: ends for claim in self.claims for name, ends in part_of_box(claim).items()}:
            found |= {"performing": in_units(performing)}
        return found

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""

        def point(of: Mapping[str, fmpq] | None) -> dict[str, float] | None:
            units = ((*figure_key(name), value) for name, value in (of or {}).items())
            return None if of is None else {key: nearest(value) / factor for key, factor, value in units}

        verdict, scaling = self.verdict, self.scaling
        shares = (None,) * 3 if verdict.volumes is None else [*map(nearest, verdict.volumes)]
        return finite({
            **picked(self, "stable reason pieces=verdict.pieces looked_at=verdict.looked_at"),
            "box": in_units(self.box.ranges),
            **dict(zip(("stable_fraction", "unstable_fraction", "undecided_fraction"), shares, strict=True)),
            "unstable_point": point(verdict.unstable_point),
            "largest_scaling": scaling
            and picked(scaling, "proved refuted limit reason") | {"unstable_point": point(scaling.unstable_point)},
            "scaling_of_each": [
                {"figure": figure_key(name)[0]} | picked(one, "proved refuted limit") for name, one in self.each.items()
            ],
            "guaranteed": self.guaranteed,
            **({} if self.nonlinear is None else {"nonlinear": [row.to_dict() for row in self.nonlinear]}),
            "holds_for": holds_for(self.prototype, self.sigmas),
            "near_rest": near_rest(self.prototype, self.nonlinear or ()),
            "complete": not self.left_out,
            "left_out": self.left_out,
        })  # fmt: skip


def part_of_box(claim: BoxClaim) -> dict[str, Interval]:
    """The ranges in which performance is claimed, where they are not those of the box: of effects while they perform.

    None of a bounded error, whose row says it, and of claims that are about lower gains too.
    """
    gains = ("controller_gain", FACTOR) if claim.asked.kind in ("gain_margin", "slope") else ()
    return {} if claim.asked.kind == "deviation" else {n: own for n, own in claim.own.items() if n not in gains}


def of_members(claims: Iterable[BoxClaim]) -> str:
    """Of which members these are, in words."""
    own = in_units({name: ends for claim in claims for name, ends in part_of_box(claim).items()})
    at = (f"{key} {stated_range((low, high)) if low < high else f'{low:.7g}'}" for key, (low, high) in own.items())
    return f"every member{' with ' if own else ''}{' and '.join(at)}"


def in_units(ranges: Mapping[str, Interval]) -> dict[str, list[float]]:
    """Ranges by their keys with units, frequencies in Hz."""
    keys = ((*figure_key(name), ends) for name, ends in ranges.items())
    return {key: [nearest(end) / factor for end in ends] for key, factor, ends in keys}


@takes("Prototype")
def certify_box(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float] | None = None,
    sigmas: float = 3.0,
    only: Collection[str] = (),
    delay_s: float = 0.0,
    nonlinear: bool = False,
    scaling: bool = False,
    each: bool = False,
    budget: int = 4000,
    seconds: float = inf,
    progress: Progress = silent,
) -> BoxGuarantee:
    """Prove stability and performance of every rig within tolerances, for every payload, all figures at once.

    Args:
        prototype: with a controller of one law and its tolerances.
        outer_end_mass_kg: range of payloads; else the prototype's.
        sigmas: standard deviations to either side of every figure.
        only: figures that vary; else all that have a tolerance.
        delay_s: a pure delay in the loop that may be anything up to this.
        nonlinear: prove as well that every rig comes to rest while its law's current saturates, and how far bounded
            errors move its tip.
        scaling: find the largest scaling of the tolerances that is stable.
        each: find it of each figure alone, the others staying as far off as they may be.
        budget: most pieces of frequency and figures to look at, for each claim.
        seconds: most time for all searches together; what they found until then is proved all the same, and a step
            that was begun is brought to its end.
        progress: told the share done and what is being done.

    Raises:
        ValueError: without a controller, or for an empty range.
        InputError: for figures that are not plausible, a figure that the rig does not have, or that has no tolerance.
    """
    checked(prototype.name, "sigmas", Sigmas, sigmas)
    checked(prototype.name, "delay_s", Delay, delay_s)
    delays = (0.0, delay_s) if delay_s else None
    asked = None if outer_end_mass_kg is None else prototype.asked_kg(outer_end_mass_kg)
    masses = asked or prototype.outer_end_mass_kg or (0.0, 0.0)
    box = tolerance_box(prototype, sigmas, only or None, asked, delay_s=delays)
    with within(seconds / 60) as limit, share(1.0, within_steps=True):
        progress(0.1, f"{len(box.names)} figures")
        verdict = decide(prototype, box, budget)
        if verdict.stable is None and over():
            leave_out("stability of the whole box")
        progress(0.3, "performance" if verdict.stable else "")
        claims = best_over_box(prototype, box, budget) if verdict.stable else ()
        rows: tuple[Row, ...] = ()
        if nonlinear and verdict.stable:
            progress(0.5, "with a saturated current")
            lower = next((claim for claim in claims if claim.asked.kind == "gain_margin"), None)
            slope, why = _slope(prototype, box, budget, lower)
            progress(0.55, "with errors that are bounded")
            errors, moved = errors_over_box(prototype, box, budget)
            moved += changing_over_box(members(prototype, *masses), box, claims)
            rows = box_rows(prototype, slope, why, moved)
            claims = (*claims, *([] if slope is None else [slope]), *errors)
        progress(0.6, "scaling the tolerances" if scaling else "")
        scaling = scaling and not box.rigid.issuperset(box.names)
        if scaling and over():
            leave_out("scaling the tolerances")
        found = largest_scaling(prototype, box, budget=budget) if scaling and not over() else None
        alone = scaling_of_each(prototype, box, budget=budget) if each and verdict.stable else {}
    moving = rows if nonlinear else None
    left_out = tuple(limit.left_out)
    return BoxGuarantee(prototype, masses, sigmas, box, verdict, claims, moving, found, alone, left_out)


def _slope(prototype: Prototype, box: Box, budget: int, lower: BoxClaim | None) -> tuple[BoxClaim | None, str]:
    """What `slope_over_box` finds, as far as there is time for it."""
    if not over():
        slope, why = slope_over_box(prototype, box, budget, lower=lower)
        if slope is not None or not over():
            return slope, why
    leave_out("rest with a saturated current")
    return None, "No time was left to prove it."
