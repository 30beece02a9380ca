"""Rigs that a prototype may turn out to be: its figures off by so many standard deviations of its tolerances.

And a law over the whole box of them: its worst rigs, which a search finds, and what is proved of every rig.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, log
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from beamdesign.parameters import PARAMETERS, TOLERANCES, refuse_none_left, rows_of
from beamdesign.plant.members import VertexModel, served
from beamdesign.polynomial import exact, nearest
from beamdesign.proofs.absolute_stability import slope_over_box
from beamdesign.proofs.box import Box, certify_box
from beamdesign.proofs.box_claims import BoxClaim, claim_over_box, margins_over_box, relaxed, worst_over_box
from beamdesign.proofs.box_member import Worst
from beamdesign.proofs.certificate import LOWER_GAINS, Asked, goal_claims, peak_claim
from beamdesign.proofs.tolerance_box import servo_off_over_box, tolerance_box
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure.lumped import CHANGEABLE, with_figures
from beamdesign.synthesis import SIGMAS
from beamdesign.time_limit import left

_CUT = 4.0
_LEFT = 0.1
"""Of a figure with a wide tolerance, what a rig that is drawn has at the least."""
_DIGITS = 3
"""To which a deviation is rounded: a thousandth of a standard deviation."""


class Cut(NamedTuple):
    """A rig that is off, at one outer end mass, as something that limits are held on.

    Attributes:
        z: by how many standard deviations each figure is off.
        outer_end_mass_kg: the mass.
        frequency_Hz: about which it is sampled more closely.
    """

    z: tuple[float, ...]
    outer_end_mass_kg: float
    frequency_Hz: float


@dataclass(frozen=True)
class RigSpread:
    """What a prototype may turn out to be: a box of figures, each off by so many standard deviations at once.

    Attributes:
        prototype: nominal.
        largest_outer_kg: largest outer end mass, whose weight is the load of effects that depend on it.
        deviations: relative standard deviation by figure, as in `beamdesign.structure.lumped`; d of them.
        sigmas: how far the figures are off, in standard deviations.
        stage: payloads of the law that serves them and all payloads, as of `beamdesign.plant.members.served`.
    """

    prototype: Prototype
    largest_outer_kg: float
    deviations: Mapping[str, float]
    sigmas: float
    stage: tuple[tuple[float, float], tuple[float, float]] | None = None

    def rig(self, z: np.ndarray) -> Prototype:
        """The prototype with its figures off by (d,) standard deviations."""
        return with_figures(self.prototype, self.factors(z))

    def factors(self, z: np.ndarray) -> dict[str, float]:
        """What the figures are multiplied by, those that change."""
        pairs = zip(z, self.deviations.items(), strict=True)
        return {name: 1 + float(value) * size for value, (name, size) in pairs if value}

    def off(self, factors: Mapping[str, float]) -> np.ndarray:
        """(d,) standard deviations of figures that are multiplied by these, those left out by one."""
        return np.round([(factors.get(name, 1.0) - 1) / size for name, size in self.deviations.items()], _DIGITS)

    def members(self, z: np.ndarray) -> tuple[VertexModel, ...]:
        """Linear members that a law has to serve of the prototype with its figures off by (d,).

        Their inner end mass is a variable of the search, to which the mass of the rig that is off is in proportion.
        """
        inside = self.factors(z).get("inner_end_mass", 1.0)
        off = served(self.rig(z), self.largest_outer_kg, self.stage)
        return tuple(replace(one, rig=replace(one.rig, weighing=inside)) for one in off)

    def drawn(self, count: int, seed: int, reach: float = 1.0) -> list[np.ndarray]:
        """Deviations (d,) of rigs drawn at random: normal, cut off at four, times a reach; of no figure all is gone."""
        normal = np.random.default_rng(seed).standard_normal((count, len(self.deviations)))
        least = (_LEFT - 1) / np.array([*self.deviations.values()])
        return list(np.round(np.maximum(reach * np.clip(normal, -_CUT, _CUT), least), _DIGITS))


def rig_spread(prototype: Prototype, largest_outer_kg: float, sigmas: float = SIGMAS) -> RigSpread:
    """The rigs within so many standard deviations of the prototype's `[tolerance]`.

    That of the outer end mass, which is a range of its own, counts in the load of effects alone.

    Raises:
        InputError: where no figure has a tolerance, or one could reach zero.
    """
    if not (deviations := deviations_of(prototype)):
        reason = (
            "no figure of the rig has one: state some of its own, leave them all out for typical ones, or ask for"
            " exactly the figures stated (--nominal)"
        )
        raise InputError("tolerance", [Problem("tolerance", reason)])
    refuse_none_left({TOLERANCES[name]: size for name, size in deviations.items()}, sigmas)
    heaviest_kg = largest_outer_kg * (1 + sigmas * prototype.tolerance.outer_end_mass)
    return RigSpread(prototype, heaviest_kg, deviations, sigmas)


def deviations_of(prototype: Prototype) -> dict[str, float]:
    """Relative standard deviation of every figure of a rig that varies, but of the outer end mass."""
    lacks = PARAMETERS.keys() - rows_of(type(prototype.actuator)).keys()
    lacks |= {"filter_frequency"} if prototype.sensor.filter_Hz is None else set()
    every = {name: getattr(prototype.tolerance, TOLERANCES[name]) for name in CHANGEABLE if name in TOLERANCES}
    for beam in ("outer", "inner"):  # a dashpot 2 zeta sqrt(K M) is off where K and M are
        own, stiffness, mass = (every[f"{beam}_{figure}"] for figure in ("damping", "stiffness", "mass"))
        every[f"{beam}_damping"] = own or (stiffness + mass) / 2
    return {name: size for name, size in every.items() if size and name not in lacks}


BUDGET, SECONDS = 20_000, 120.0
"""Most pieces and most time for the proof of one claim."""

REST_BUDGET, REST_SECONDS = 5_000, 30.0
"""Most pieces, where that is not asked for, and most time for the proof that a design comes to rest while saturated."""

_LEAST_HZ = 1e-2
"""Bandwidth about which compliance is looked at of a law that has none."""

_RELAXATIONS = (1.0, 1.002, 1.02)
"""By what factors less than the worst rig's a bandwidth is claimed, tried in turn."""


@dataclass(frozen=True)
class OverBox:
    """What is proved of a prototype over a box of tolerances and payloads.

    Attributes:
        sigmas: standard deviations of every figure to either side.
        found: claims about every member with their proofs.
        write: the certificate of stability and some of these.
        servo_off_m_per_N: the largest compliance of the rigs of the box with the servo off, sought, rounded down.
        tightest: figures whose tolerance to tighten first, the first of them first, each with by how many standard
            deviations more it may be off, all others as in the worst rig that was found; sampled.
    """

    sigmas: float
    found: tuple[BoxClaim, ...] = field(repr=False)
    write: Callable[[Sequence[BoxClaim]], str] = field(repr=False, compare=False)
    servo_off_m_per_N: float
    tightest: tuple[dict[str, Any], ...]

    @property
    def claims(self) -> tuple[Asked, ...]:
        """What is proved about every member."""
        return tuple(claim.asked for claim in self.found)

    @cached_property
    def certificate(self) -> str:
        """Text that `beamdesign.checker` proves again."""
        return self.write(self.found)


@dataclass(frozen=True)
class BoxTask:
    """A prototype with a law, and what is asked of every rig that it may turn out to be.

    Attributes:
        prototype: with its controller; its goal sets the limits.
        spread: how far its figures may be off.
        masses_kg: payloads over which it is to perform.
        stable_kg: those over which it is to be stable.
    """

    prototype: Prototype
    spread: RigSpread
    masses_kg: tuple[float, float]
    stable_kg: tuple[float, float]

    @cached_property
    def box(self) -> Box:
        """Of tolerances and of payloads over which it is to be stable, with those over which it is to perform."""
        whole, own = (
            tolerance_box(self.prototype, self.spread.sigmas, None, masses_kg)
            for masses_kg in (self.stable_kg, self.masses_kg)
        )
        if self.masses_kg == self.stable_kg:
            return whole
        low, high = map(exact, self.masses_kg)
        return replace(whole, performing={"outer_end_mass": own.ranges.get("outer_end_mass", (low, high))})

    def worst(self, bandwidth_Hz: float, missed: float = 0.0) -> list[tuple[str, float, Cut]]:
        """Rigs that miss a limit by more than so much (logarithm): of what, by how much, and which."""
        found = [
            (asked.kind, log(worst.ratio), self.cut(worst))
            for asked in self._asked(bandwidth_Hz)
            for worst in worst_over_box(self.prototype, self.box, asked)
            if worst.ratio > 0 and log(worst.ratio) > missed
        ]
        return sorted(found, key=lambda one: -one[1])

    def _asked(self, bandwidth_Hz: float) -> Sequence[Asked]:
        goal = self.prototype.goal
        return (
            *([LOWER_GAINS] if goal.lower_gains else []),
            Asked("peak_sensitivity", goal.peak_sensitivity),
            Asked("compliance", goal.compliance_m_per_N, max(bandwidth_Hz, _LEAST_HZ)),
            *goal_claims(goal),
            *(peak_claim(goal, self.servo_off[0]) if goal.peak_over_passive < inf else ()),
        )

    @cached_property
    def servo_off(self) -> tuple[float, Worst]:
        """The largest compliance (m/N) of all rigs with the servo off, sought, rounded down, and the rig that has it.

        With the servo on the largest may be a multiple of that.
        """
        return servo_off_over_box(self.prototype, self.box)

    def cut(self, worst: Worst) -> Cut:
        """A worst rig as something that limits are held on."""
        known, nominal = self.spread.deviations, self.box.nominal
        factors = {name: nearest(worst.parameters[name] / nominal[name]) for name in known if name in nominal}
        z = tuple(map(float, self.spread.off(factors)))
        return Cut(z, nearest(worst.parameters["outer_end_mass"]), worst.frequency_Hz)

    def proof(self, bandwidth_Hz: float) -> tuple[OverBox | None, str, list[Cut]]:
        """Prove all that is asked of every rig, and the largest bandwidth that is proved.

        Or why that is not proved, and the rig that refutes it where one was found.
        """
        verdict = certify_box(self.prototype, self.box, BUDGET, min(SECONDS, left()), volumes=False)
        if not verdict.stable:
            return None, verdict.reason, []
        claims = []
        for asked in self._asked(bandwidth_Hz):
            for one in [relaxed(asked, by) for by in _RELAXATIONS] if asked.kind == "compliance" else [asked]:
                claim = claim_over_box(self.prototype, self.box, one, BUDGET, min(SECONDS, left()))
                if claim.holds:
                    break
            if not claim.holds:
                reason = f"{claim.asked.kind.replace('_', ' ')}: {claim.reason}"
                refuted = claim.holds is False and claim.witness is not None and asked.kind != "gain_margin"
                worst = Worst(inf, dict(claim.witness or {}), claim.frequency_Hz or 0.0)
                return None, reason, [self.cut(worst)] if refuted else []
            claims.append(claim)
        found = self.spread.sigmas, tuple(claims), verdict.write, self.servo_off[0], self._tightest(bandwidth_Hz)
        return OverBox(*found), "", []

    def at_rest(self, proved: OverBox) -> tuple[OverBox | None, str]:
        """With the proof that every rig comes to rest while its law's current saturates, or why there is none."""
        lower = next((claim for claim in proved.found if claim.asked.kind == "gain_margin"), None)
        budget, seconds = BUDGET if self.prototype.goal.comes_to_rest else REST_BUDGET, min(REST_SECONDS, left())
        claim, reason = slope_over_box(self.prototype, self.box, budget, seconds, lower, may_be_odd=False)
        if claim is None:
            return None, reason
        return replace(proved, found=(*proved.found, claim)), ""

    def _tightest(self, bandwidth_Hz: float) -> tuple[dict[str, Any], ...]:
        margins: dict[str, float] = {}
        for asked in self._asked(bandwidth_Hz):
            if asked.kind != "gain_margin":
                for name, shares in margins_over_box(self.prototype, self.box, asked).items():
                    margins[name] = min(margins.get(name, inf), shares * self.spread.sigmas)
        known = [{"parameter": name, "margin": of} for name, of in margins.items() if name in self.spread.deviations]
        return tuple(sorted(known, key=itemgetter("margin")))
