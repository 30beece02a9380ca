"""The limits of a goal: what the loops that one controller has to serve keep of them, proved, and as expressions.

The loops are those of all linear members of a rig.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from math import inf, log
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq, fmpq_poly
from pydantic import Field

from beamdesign.controllers import Controller
from beamdesign.controllers.form import UNIT
from beamdesign.json_text import picked
from beamdesign.loop import rig_loop
from beamdesign.plant.linear import UNUSED, LinearModel
from beamdesign.plant.linearised import linear_assembly, transfer_polynomials
from beamdesign.plant.members import VertexModel, family
from beamdesign.plant.rigs import figures_of
from beamdesign.polynomial import exact
from beamdesign.proofs.absolute_stability import absolute_stability, members
from beamdesign.proofs.certificate import Asked, Claim, Kind, goal_claims, over_passive, peak_claim
from beamdesign.proofs.performance import least_limit, prove
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.servo_off import servo_off_of
from beamdesign.prototype import Goal, Prototype
from beamdesign.rational import nearest
from beamdesign.synthesis.rig_spread import OverBox

LIMITED: tuple[Kind, ...] = (
    "peak_sensitivity", "compliance", "loop_gain", "controller_effort", "gain_margin", "peak_compliance",
)  # fmt: skip
"""What a goal limits, in the order of everything that is listed by limit."""


def goal_limits(goal: Goal) -> dict[Kind, float]:
    """The limits that a goal sets, in this order; of the peak compliance in multiples of that with the servo off."""
    lower = getattr(goal, "peak_at_lower_gains", LARGEST_AT_LOWER_GAINS) if goal.lower_gains else inf
    given = (goal.peak_sensitivity, goal.compliance_m_per_N, goal.loop_gain, goal.controller_effort_A_per_V)
    limits = zip(LIMITED, (*given, lower, goal.peak_over_passive), strict=True)
    return {kind: limit for kind, limit in limits if limit is not None and limit < inf}


LARGEST_AT_LOWER_GAINS = 10.0
"""Peak sensitivity that an optimiser allows at any lower gain, so that the loop is stable there."""


class _Calmer(Goal):
    """A goal of an optimiser alone."""

    peak_at_lower_gains: float = Field(description="instead of LARGEST_AT_LOWER_GAINS")


def calmer(goal: Goal, peak: float = LARGEST_AT_LOWER_GAINS) -> Goal:
    """A goal with a limit of an optimiser's own at lower gains; with the largest, as it is stated."""
    own = {name: getattr(goal, name) for name in Goal.model_fields}
    return Goal(**own) if peak == LARGEST_AT_LOWER_GAINS else _Calmer(**own, peak_at_lower_gains=peak)


RELAXED_PEAK = 3.0
"""An optimiser keeps members that only have to be stable within the limit of sensitivity times this."""


def ends(members: Sequence[VertexModel]) -> list[tuple[LinearModel, float, bool]]:
    """Rig, factor on the gain and whether it is to perform, of every member at the ends of what it is asked."""
    found = []
    for member in members:
        inside = member.performance
        asked = member.gain if inside is None else inside
        found += [(member.rig, factor, inside is not None) for factor in sorted({asked.low, asked.high}) if factor > 0]
    return found


LARGEST_BANDWIDTH_HZ = 500.0
"""Most that is guaranteed, also of a rig that keeps the compliance at every frequency."""


@dataclass(frozen=True)
class Proved:
    """A loop proved stable and within the peak sensitivity for every outer end mass of the range.

    Attributes:
        controller: with rounded figures, as it was proved.
        inner_end_mass_kg: mass added inside.
        bandwidth_Hz: proved, for every mass of the range.
        peak_sensitivity: proved bound.
        variables: of the search, where it was found.
        over_box: what is proved of every rig within the tolerances, which the figures above are of; None where they are
            those of exactly the figures stated.
        nominal: bandwidth (Hz) and peak sensitivity of these, where the figures above are of a box.
        peak_compliance_m_per_N: proved at every frequency; infinite where the goal sets it no limit.
        servo_off_m_per_N: the largest compliance with the servo off that this is compared with.
    """

    controller: Controller
    inner_end_mass_kg: float
    bandwidth_Hz: float
    peak_sensitivity: float
    variables: np.ndarray
    over_box: OverBox | None = None
    nominal: tuple[float, float] | None = None
    peak_compliance_m_per_N: float = inf
    servo_off_m_per_N: float = inf

    def over(self, box: OverBox) -> "Proved":
        """What is proved of every rig of a box, beside what is proved of the nominal one."""
        claims = {claim.kind: claim for claim in box.claims}
        width, peak, softest = claims["compliance"], claims["peak_sensitivity"], claims.get("peak_compliance")
        return replace(
            self,
            bandwidth_Hz=min(width.bandwidth_Hz, self.bandwidth_Hz),
            peak_sensitivity=peak.limit,
            over_box=box,
            nominal=(self.bandwidth_Hz, self.peak_sensitivity),
            peak_compliance_m_per_N=inf if softest is None else softest.limit,
            servo_off_m_per_N=box.servo_off_m_per_N,
        )

    @property
    def peak_over_passive(self) -> float:
        """How many times the largest compliance with the servo off the largest with it on is; infinite for no limit."""
        return over_passive(self.peak_compliance_m_per_N, self.servo_off_m_per_N)

    @property
    def sigmas(self) -> float:
        """Standard deviations of every figure that it is proved for; zero: exactly these figures."""
        return 0.0 if self.over_box is None else self.over_box.sigmas

    def guaranteed(self, prototype: Prototype, masses_kg: tuple[float, float]) -> dict[str, Any]:
        """What JSON files say of it: the figures, for which rigs, and at which lower gains.

        Args:
            prototype: with this controller and mass inside.
            masses_kg: the range of outer end mass.
        """
        box, nominal = self.over_box, self.nominal or (self.bandwidth_Hz, self.peak_sensitivity)
        lower = prototype.goal.lower_gains or forbidden_shares(prototype, masses_kg)
        return {
            "bandwidth_Hz": self.bandwidth_Hz,
            "peak_sensitivity": self.peak_sensitivity,
            **picked(self, "peak_compliance_m_per_N servo_off_m_per_N peak_over_passive"),
            "outer_end_mass_kg": list(masses_kg),
            "rigs": "nominal" if box is None else {"sigmas": box.sigmas, "shape": "box"},
            "lower_gains": lower,
            "comes_to_rest": any(one.kind == "slope" for one in box.claims) if box else _rests(prototype, masses_kg),
            "nominal": dict(zip(("bandwidth_Hz", "peak_sensitivity"), nominal, strict=True)),
            "tightest": [] if box is None else list(box.tightest),
        }


def _rests(prototype: Prototype, masses_kg: tuple[float, float]) -> bool:
    """Whether the nominal loop is proved to come to rest from every state while its current saturates."""
    if not prototype.goal.lower_gains:
        return False
    given = members(prototype, *masses_kg)
    found = absolute_stability(given.loops, given.low, given.high).multiplier
    return found is not None and not found.for_odd_only


_SHARES_OF_GAIN = np.geomspace(1e-3, 1.0, 300)


def forbidden_shares(prototype: Prototype, masses_kg: tuple[float, float]) -> list[tuple[float, float]]:
    """Shares of its gain with which the loop is not stable at some outer end mass, least and most of each stretch.

    On a grid of shares and masses: neighbours of what is found may be as bad.
    """
    assert prototype.controller is not None  # it was tuned
    own = rig_loop(family(prototype).rest.rig, prototype.payload.inner_end_mass_kg, prototype.controller)
    scale = fmpq_poly([0, exact(UNIT)])  # roots of moderate size
    unstable = np.zeros(len(_SHARES_OF_GAIN), dtype=bool)
    for mass in np.linspace(*masses_kg, 15):
        parts = (part.at(exact(float(mass)))(scale) for part in (own.loop_denominator, own.loop_numerator))
        open_loop, fed_back = (np.array([nearest(c) for c in part.coeffs()[::-1]]) for part in parts)
        for k, share in enumerate(_SHARES_OF_GAIN):
            unstable[k] |= bool(np.roots(np.polyadd(open_loop, share * fed_back)).real.max() >= 0)
    starts = np.flatnonzero(np.diff(np.concatenate([[False], unstable, [False]]).astype(int)))
    ends = zip(_SHARES_OF_GAIN[starts[::2]], _SHARES_OF_GAIN[starts[1::2] - 1], strict=True)
    return [(float(low), float(high)) for low, high in ends]


@dataclass(frozen=True)
class LoopSet:
    """All loops of one controller and inner end mass over a range of outer end masses.

    Attributes:
        stable: rectangles of masses and gains that are to be stable, one of each member.
        performing: likewise, those that are to perform.
        servo_off_m_per_N: the largest compliance of these with the servo off.
    """

    stable: Sequence[Rectangle]
    performing: Sequence[Rectangle]
    servo_off_m_per_N: float

    def unstable(self, goal: Goal) -> bool:
        """Whether some member is not stable throughout, at lower gains where the goal wants it: exact."""
        if goal.lower_gains:  # masses and gains both vary then, and the sides alone do not decide
            return not all(one.widened(fmpq(0)).stable for one in self.stable)
        return any(one.unstable_side() is not None for one in self.stable)

    def refuted(self, goal: Goal) -> list[Claim]:
        """The goal's limits but that of the bandwidth that are refuted, of one member each."""
        each = ((prove(rectangle, asked) for rectangle in self.performing) for asked in self._asked(goal))
        return [claim for claims in each for claim in [next((one for one in claims if not one.holds), None)] if claim]

    def excess(self, goal: Goal) -> float:
        """Logarithm of the largest share by which one of these limits is proved to be kept or may be exceeded."""
        most = max(least_limit(self.performing, one.kind, one.from_Hz) / one.limit for one in self._asked(goal))
        return log(most) if most < inf else inf

    def peak_sensitivity(self) -> float:
        """Proved for every loop that is to perform."""
        return least_limit(self.performing, "peak_sensitivity")

    def peak_compliance(self, goal: Goal) -> float:
        """Proved at every frequency for every loop that is to perform; infinite where the goal sets it no limit."""
        (limit,) = [one.limit for one in peak_claim(goal, self.servo_off_m_per_N)] or [inf]
        return least_limit(self.performing, "peak_compliance", goal=limit) if limit < inf else inf

    def _asked(self, goal: Goal) -> tuple[Asked, ...]:
        """The limits of sensitivity, loop gain, effort and peak compliance, as they are proved."""
        peak = Asked("peak_sensitivity", goal.peak_sensitivity)
        return (peak, *goal_claims(goal), *peak_claim(goal, self.servo_off_m_per_N))


def loop_set(
    members: Sequence[VertexModel], controller: Controller, inner_end_mass: float, masses_kg: tuple[float, float]
) -> LoopSet:
    """Close the loops of all members of a rig."""
    low, high = (exact(mass) for mass in masses_kg)
    stable, performing = list[Rectangle](), list[Rectangle]()
    for member in members:
        loop = rig_loop(member.rig, inner_end_mass, controller)
        for found, gains in ((stable, member.gain), (performing, member.performance)):
            if gains is not None:
                found.append(Rectangle(loop, low, high, exact(gains.low), exact(gains.high)))
    return LoopSet(stable, performing, servo_off_of(members, inner_end_mass, masses_kg).compliance_m_per_N)


Pair = tuple[ca.SX, ca.SX]
"""Real and imaginary part."""

_TINY = 1e-300
_NOTHING: Pair = (ca.SX(0), ca.SX(0))


def on_axis(coefficients: Sequence[Any], w: ca.SX) -> Pair:
    """A polynomial, its coefficients ascending, at j w."""
    parts, power = [ca.SX(0), ca.SX(0)], ca.SX(1)
    for k, coefficient in enumerate(coefficients):
        term = coefficient * power
        parts[k % 2] += -term if k % 4 >= 2 else term
        power = power * w
    return parts[0], parts[1]


def product(left: Pair, right: Pair) -> Pair:
    """Of two complex numbers."""
    return left[0] * right[0] - left[1] * right[1], left[0] * right[1] + left[1] * right[0]


def _sum(first: Pair, *others: Pair) -> Pair:
    return reduce(lambda one, two: (one[0] + two[0], one[1] + two[1]), others, first)


def _log_size(value: Pair) -> ca.SX:
    return ca.log(value[0] ** 2 + value[1] ** 2) / 2


def law_on_axis(coefficients: ca.SX, w: ca.SX) -> tuple[list[Pair], Pair]:
    """Numerators of a law and their denominator at j w."""
    *above, below = (on_axis(ca.horzsplit(row), w / UNIT) for row in ca.vertsplit(coefficients))
    return above, below


def slack_of(
    kind: Kind,
    law: tuple[Sequence[Pair], Pair],
    plant: Pair,
    control: Sequence[Pair],
    disturbance: Pair = _NOTHING,
    crossed: Sequence[Pair] = (),
) -> ca.SX:
    """Logarithm of 1 / |S|, |F_d / x|, 1 / |L|, 1 / |C S| or the least 1 / |S| of all lower gains at one frequency.

    To that the logarithm of the limit is added, which for the peak compliance is a multiple of |x / F_d| without law.

    Args:
        kind: of the limit.
        law: numerators of the law, one per sensor, and their denominator.
        plant: the plant's denominator.
        control: its numerators, as of `beamdesign.plant.linear.Plant`, one per sensor.
        disturbance: likewise; of the compliance alone.
        crossed: likewise.
    """
    above, below = law
    denominator = product(plant, below)
    numerator = _sum(*map(product, above, control))
    match kind:
        case "loop_gain":
            return _log_size(denominator) - _log_size(numerator)
        case "gain_margin":  # at the share of the gain that comes nearest to the critical point
            along = denominator[0] * numerator[0] + denominator[1] * numerator[1]
            share = ca.fmin(1, ca.fmax(0, -along / (numerator[0] ** 2 + numerator[1] ** 2 + _TINY)))
            return _log_size(_sum(denominator, (share * numerator[0], share * numerator[1]))) - _log_size(denominator)
        case "peak_sensitivity":
            over = _log_size(denominator)
        case "compliance" | "peak_compliance":
            over = _log_size(_sum(product(disturbance, below), *map(product, above, crossed)))
        case _:
            over = _log_size(plant) + _log_size(above[0])
    return _log_size(_sum(denominator, numerator)) - over


@cache
def plant_of_figures(filtered: bool, rig: str) -> tuple[ca.SX, list[list[ca.SX]]]:
    """Of a rig without effects, symbols of its figures, and polynomials of its plant in terms of them.

    These are the denominator, and the numerators from current to volts and from tip force to the tip's displacement.
    """
    names = figures_of(rig)
    figures = ca.SX.sym("figures", len(names))
    given = UNUSED | dict(zip(names, ca.vertsplit(figures), strict=True))
    values = ca.vertcat(*(given[name] for name in linear_assembly(filtered, (), rig).parameters))
    minors = transfer_polynomials(filtered, (), ((), ((1, 1),), ((0, 0),)), rig)
    found = [ca.vertsplit(part) for part in minors(values)]
    outer, inner = given["outer_end_mass"], given["inner_end_mass"]
    weights = (1, inner, outer, outer * inner)
    return figures, [added_up(zip(weights, found[k : k + 4], strict=True)) for k in (0, 4, 8)]


def added_up(terms: Iterable[tuple[Any, Sequence[Any]]]) -> list[ca.SX]:
    """Coefficients of a sum of weighted polynomials, each given by its own."""
    listed = list(terms)
    length = max(len(polynomial) for _, polynomial in listed)
    return [sum((weight * p[k] for weight, p in listed if k < len(p)), ca.SX(0)) for k in range(length)]
