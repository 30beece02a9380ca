"""What there is to say of one design in a search for a law: its worth, its worst rigs, and what is proved of it.

What is proved is of all loops that one controller has to serve, which are those of all linear members of a rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, log
from typing import Any

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.controllers import Controller
from beamdesign.controllers.protocol import UNIT
from beamdesign.loop import member_loop, rig_loop
from beamdesign.plant.members import VertexModel, family
from beamdesign.polynomial import exact, nearest
from beamdesign.proofs.absolute_stability import FOR_ODD, IN_THE_CURRENT, absolute_stability
from beamdesign.proofs.certificate import Asked, Claim, goal_claims, over_passive, peak_claim
from beamdesign.proofs.performance import bandwidth, least_limit, prove, servo_off_of
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.scope import is_linear, members
from beamdesign.prototype import Goal, Prototype
from beamdesign.quantities import masses_text
from beamdesign.result import picked
from beamdesign.synthesis import PROVED
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_samples import Design, calmer
from beamdesign.synthesis.rig_spread import BoxTask, Cut, OverBox
from beamdesign.time_limit import left_out, over

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

    def columns(self) -> dict[str, Any]:
        """Its columns in a table, with those of the breaks and sections that its law has."""
        law = self.controller
        breaks = {} if law.lag is None else picked(law.lag, "pole_Hz zero_Hz")
        for k, section in enumerate(law.sections, start=1):
            breaks |= {f"section_{k}_{name}": value for name, value in section.model_dump().items()}
        return picked(self, PROVED) | breaks

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
        rests = any(one.kind == "slope" for one in box.claims) if box else _rests(prototype, masses_kg)
        frozen = [name for name in sorted(prototype.effects) if not is_linear(name) and name not in IN_THE_CURRENT]
        shown = "bandwidth_Hz peak_sensitivity peak_compliance_m_per_N servo_off_m_per_N peak_over_passive"
        return {
            **picked(self, shown),
            "outer_end_mass_kg": list(masses_kg),
            "rigs": "nominal" if box is None else {"sigmas": box.sigmas, "shape": "box"},
            "lower_gains": lower,
            "comes_to_rest": rests,
            **({"at_rest_with_frozen": frozen} if rests and frozen else {}),
            "nominal": dict(zip(("bandwidth_Hz", "peak_sensitivity"), nominal, strict=True)),
            "tightest": [] if box is None else list(box.tightest),
        }


def _rests(prototype: Prototype, masses_kg: tuple[float, float]) -> bool:
    """Whether the nominal loop is proved to come to rest from every state while its law's current saturates."""
    if not prototype.goal.lower_gains:
        return False
    given = members(prototype, *masses_kg)
    found, _ = absolute_stability(given.loops, given.low, given.high)
    return found is not None and not found[0].for_odd_only


_SHARES_OF_GAIN = np.geomspace(1e-3, 1.0, 300)


def forbidden_shares(prototype: Prototype, masses_kg: tuple[float, float]) -> list[tuple[float, float]]:
    """Shares of its gain with which the loop is not stable at some outer end mass, least and most of each stretch.

    On a grid of shares and masses: neighbours of what is found may be as bad.
    """
    own = member_loop(prototype, family(prototype).rest)
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
        return not all((one.widened(fmpq(0)) if goal.lower_gains else one).stable for one in self.stable)

    def refuted(self, goal: Goal) -> list[Claim]:
        """The goal's limits but that of the bandwidth that are refuted, of one member each."""
        each = ((prove(rectangle, asked) for rectangle in self.performing) for asked in self._asked(goal))
        return [claim for claims in each for claim in [next((one for one in claims if not one.holds), None)] if claim]

    def excess(self, goal: Goal) -> float:
        """Logarithm of the largest share by which one of these limits is proved to be kept or may be exceeded."""
        most = max(least_limit(self.performing, one.kind, one.from_Hz) / one.limit for one in self._asked(goal))
        return log(most) if most < inf else inf

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


ENOUGH = 0.985
"""Share of the sampled bandwidth which, if proved, ends the search for more."""

ROOM = 2e-3
"""By how much (logarithm) limits are kept to spare of a design that is proved over a box, where proofs need room."""

_KNOWN = 0.98
"""Share of the largest compliance with the servo off of a box that is enough on samples."""


def unknown(task: Search, design: Design) -> list[Cut]:
    """The rig of the box with the largest compliance with the servo off, where the samples know none like it.

    Over a box compliance is compared worst with worst, and on its samples likewise.
    """
    if task.goal.peak_over_passive == inf:
        return []
    points, box = task.points_with(design.chosen) or task.points, over_box(task, design)
    most, softest = box.servo_off
    known = points.servo_off(design.inner_end_mass) > _KNOWN * most
    return [] if known else [box.cut(softest)]


def whole(task: Search, design: Design, loops: LoopSet) -> tuple[Proved | None, str, list[Cut]]:
    """What is proved of a design whose nominal loops keep all limits: of these, or of the whole box.

    Or why not, and the rigs that refute it.
    """
    performing, goal, servo_off = loops.performing, task.goal, loops.servo_off_m_per_N
    width = min(bandwidth(performing, goal.compliance_m_per_N), LARGEST_BANDWIDTH_HZ)
    peak = min(least_limit(performing, "peak_sensitivity"), goal.peak_sensitivity)
    found = Proved(design.law, design.inner_end_mass, width, peak, design.variables, servo_off_m_per_N=servo_off)
    if task.spread is None:
        for asked in peak_claim(goal, servo_off):  # at every frequency, where the goal limits that
            most = least_limit(performing, asked.kind, goal=asked.limit)
            found = replace(found, peak_compliance_m_per_N=most)
        return found, "", []
    over, reason, cuts = over_box(task, design).proof(task.reached(design, ROOM))
    return (None, reason, cuts) if over is None else (found.over(over), "", [])


def rests(task: Search, design: Design, found: Proved) -> tuple[Proved | None, str]:
    """What was proved of a design with that proof as well, or why there is none."""
    if not task.goal.lower_gains:
        return None, "it need not be stable at every lower gain"
    if found.over_box is not None:
        over, reason = over_box(task, design).at_rest(found.over_box)
        return (None, reason) if over is None else (replace(found, over_box=over), "")
    if not task.goal.comes_to_rest:
        return found, ""
    members = task.members_with(design.chosen, rounded=True)
    each = loop_set(members, found.controller, found.inner_end_mass_kg, task.masses_kg).stable
    proof, reason = absolute_stability([one.loop.scaled(one.most) for one in each], *map(exact, task.masses_kg))
    if proof is not None and proof[0].for_odd_only:
        return None, f"the multiplier that was found is {FOR_ODD} alone"
    return (None, reason) if proof is None else (found, "")


def value_of(task: Search, design: Design) -> float:
    """What a design is worth on samples; of a box anew, as it was found before the worst rigs were known."""
    return design.value if task.spread is None else task.value(design, task.reached(design))


def over_box(task: Search, design: Design) -> BoxTask:
    """A design as what is to hold over the whole box."""
    assert task.spread is not None
    rig = task.prototype_with(design.chosen, rounded=True)
    whole = task.masses_kg if task.spread.stage is None else task.spread.stage[1]
    built = rig.with_law(design.law, task.masses_kg, design.inner_end_mass).but(goal=calmer(task.goal))
    return BoxTask(built, task.spread, task.masses_kg, whole)


def in_box(task: Search, design: Design, missed: float = -ROOM / 2) -> list[tuple[str, float, Cut]]:
    """Rigs of the box that miss a limit by more than so much, or keep it by less than a proof needs."""
    return over_box(task, design).worst(task.reached(design, ROOM), missed)


def no_answer(kind: str, goal: Goal, masses_kg: tuple[float, float], failure: str, sigmas: float = 0.0) -> str:
    """Why there is no design, and what may allow one: of what was asked only that which can be asked less of."""
    if over() or left_out():
        return f"no {kind} controller was proved in the time given ({failure}); more time may find one"
    ratio = goal.peak_over_passive
    softer = f" and {ratio:g} times its largest with the servo off at any" if ratio < inf else ""
    easier = [
        *(["a narrower range"] if masses_kg[0] < masses_kg[1] else []),
        *(["tighter tolerances or fewer standard deviations of them"] if sigmas else []),
        "a larger peak sensitivity",
        f"a larger compliance{' or peak_over_passive' if ratio < inf else ''}",
    ]
    return (
        f"no {kind} controller was found that is proved stable with peak sensitivity at most"
        f" {goal.peak_sensitivity:g} for outer end masses of {masses_text(masses_kg)}, and keeps"
        f" {goal.compliance_m_per_N:g} m/N up to any useful frequency{softer} ({failure});"
        f" {', '.join(easier)}, or more inner end mass may allow one"
    )
