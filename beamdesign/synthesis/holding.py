"""Whether the actuator and the structure of a design hold what is asked of them, and what to change where they do not.

Asked are the load of the study, held still, and put on and taken off at any frequency up to the guaranteed bandwidth;
and beside it a weight: that of the largest payload and of the links. The orientation is the worst one: the link lies
level and the servo acts upwards, so that all of gravity acts across both beams, with the load; the piston is in the
middle of its stroke without it. A beam weighs at its tip by its end mass and 3/8 of its free tube
(`beamdesign.structure.lumped.weighing_mass`).

- Structure: its sections are chosen for the load of the study, which must not be less than the weight. Their checks,
  that of the gap left between the tubes among them, are of that load alone (`beamdesign.synthesis.checks`).
- Gap: load and weight together must not make the tubes touch, held still and up to the bandwidth.
- Actuator: load and weight, held still (`Actuator.holding`): pressure of the supply, or current of the motor.
- Its stroke and what else it has to be rated for (`Actuator.ratings`): up to the bandwidth.
- Bandwidth: at least the one up to which the study wants its load held still.

What holds still is asked before anything is tuned (`standing`), the rest of a tuned design (`working`). What needs a
figure that the prototype does not state is not asked, and named.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from itertools import product
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from beamdesign import quantities as q
from beamdesign.plant.actuators import KINDS, MARGIN
from beamdesign.plant.members import STANDARD_GRAVITY, own_sag_m, weight_N
from beamdesign.problem import DesignProblem
from beamdesign.prototype import Prototype
from beamdesign.quantities import at_least, at_most, rigs_in_words
from beamdesign.result import finite, picked
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.shapes import gaps
from beamdesign.synthesis.operating_limits import demand, grid_Hz, needs_to_carry
from beamdesign.synthesis.sizing import size

_PER_LOAD = 4 / 3
"""Power of the load with which a tube's stiffness grows at most, where all its sizes grow alike at one stress."""
_POINTS = 60
_TRIES = 4
_PAYLOAD, _COMPLIANCE = "payload.outer_end_mass_kg", "goal.compliance_m_per_N"
_LOAD, _LEFT = "load.tip_force_N", "clearance.under_load_m"
_GAP = "gap between the tubes"


class Change(NamedTuple):
    """A key of the study file, and the figure that it must have at least, or at most."""

    key: str
    value: float
    at_least: bool = True

    @classmethod
    def rounded(cls, key: str, value: float, at_least: bool = True) -> "Change":
        """With a figure to three significant digits that is enough, so that what is printed of it is all of it."""
        towards = Context(3, ROUND_CEILING if at_least else ROUND_FLOOR)
        return cls(key, float(towards.create_decimal(repr(value))), at_least)

    def __str__(self) -> str:
        """In words, in the unit that it is read in and as it is to be written."""
        name, unit, _ = _KEYS[self.key]
        side = "least" if self.at_least else "most"
        return f"{name} of at {side} {q.quantity(self.value, unit)} ({self.key} = {self.value:g})"


Way = tuple[Change, ...]
"""Changes that are made together."""

_KEYS = {
    _PAYLOAD: ("a payload", "kg", q.MassOrNone),
    _LOAD: ("a load", "N", q.Force),
    _LEFT: ("a gap left under load", "m", q.Gap),
    "actuator.piston_area_m2": ("a piston area", "m2", q.PistonArea),
    "actuator.torque_constant_N_m_per_A": ("a torque constant", "N m/A", q.TorqueConstant),
    "actuator.stroke_m": ("a stroke", "m", q.Stroke),
    "supply.pressure_Pa": ("a supply pressure", "Pa", q.SupplyPressure),
    **{one.place: (f"a {one.name}", one.unit, one.quantity) for kind in KINDS.values() for one in kind.ratings},
    _COMPLIANCE: ("a goal of compliance", "m/N", q.ComplianceLimit),
    "load.least_bandwidth_Hz": ("a goal of bandwidth", "Hz", q.Bandwidth),
}
"""By key: its name, its unit, and what of it a study may state."""


class Demanded(NamedTuple):
    """What is needed beside what there is, both in one unit, SI.

    Attributes:
        name: of what.
        needed: at least this.
        available: as prototype or study state it.
        unit: of both.
        ways: to meet it, each enough by itself; empty where it is met.
    """

    name: str
    needed: float
    available: float
    unit: str
    ways: tuple[Way, ...] = ()

    @property
    def met(self) -> bool:
        """Whether there is enough: decided by the figures themselves, never by what is printed of them."""
        return self.needed <= self.available

    @property
    def figures(self) -> tuple[str, str]:
        """Both, rounded away from each other, so that print does not make equal what is not."""
        return at_most(self.needed, self.unit), at_least(self.available, self.unit)

    @property
    def words(self) -> str:
        """Both in words."""
        needed, available = self.figures
        return f"{needed} of {self.name} instead of {available}"


@dataclass(frozen=True)
class Holding:
    """Whether a design holds its load and its weight.

    Attributes:
        load_N: force on the tip.
        weight_N: beside it, of the largest payload and of the outer beam, at the tip.
        limits: all that could be asked.
        missing: keys that are not stated, by the limit that was not asked for want of them.
        instead: ways that meet all that is missed at once, beside those of each limit.
    """

    load_N: float
    weight_N: float
    limits: tuple[Demanded, ...]
    missing: dict[str, str]
    instead: tuple[Way, ...] = ()

    @property
    def missed(self) -> tuple[Demanded, ...]:
        """What is not met."""
        return tuple(limit for limit in self.limits if not limit.met)

    @property
    def ways(self) -> tuple[Way, ...]:
        """What to change, each way enough by itself, of figures that a study may state; empty where all is met."""
        every = all(limit.ways for limit in self.missed) and self.missed
        joined = (_strictest(sum(way, ())) for way in product(*(limit.ways for limit in self.limits if limit.ways)))
        ways = dict.fromkeys((*self.instead, *(joined if every else ())))
        stated = [way for way in ways if all(one.value in q.range_of(_KEYS[one.key][2]) for one in way)]
        return tuple(way for way in stated if not any(set(other) < set(way) for other in stated))

    @property
    def reason(self) -> str:
        """Why the design is none, in a sentence; empty where it is one."""
        if not self.missed:
            return ""
        return f"for {self.held} the design needs {' and '.join(limit.words for limit in self.missed)}"

    @property
    def held(self) -> str:
        """Load and weight in words."""
        return f"{at_least(self.load_N, 'N')} on the tip and {at_most(self.weight_N, 'N')} of weight"

    def rows(self) -> list[tuple[str, str]]:
        """For people: what is held, what of each limit it takes, and what was not asked."""
        limits = [(f"takes of {limit.name}", " of ".join(limit.figures)) for limit in self.limits[1:-1]]
        unasked = [(f"{name} not asked for want of", key) for name, key in self.missing.items()]
        return [("holds, link level", f"{self.held}, of {rigs_in_words(0.0)}"), *limits, *unasked]

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        limits = [picked(limit, "name needed available unit met") for limit in self.limits]
        return finite(picked(self, "load_N weight_N missing") | {"limits": limits})


def standing(problem: DesignProblem, prototype: Prototype, masses_kg: tuple[float, float]) -> Holding:
    """Whether structure and actuator hold load and weight still, whatever the controller.

    Args:
        problem: with the load that the sections are designed for.
        prototype: of it, with its sections; a controller is not needed.
        masses_kg: payloads (least, most).
    """
    load, payload = problem.load.tip_force_N, STANDARD_GRAVITY * masses_kg[1]
    weight = weight_N(prototype, masses_kg[1])
    link = weight - payload
    name, needed, available, unit, key = prototype.actuator.holding(prototype, load + weight)
    held = Demanded(name, needed, inf if available is None else available, unit)  # enough where nothing is stated
    stall = held.available * (load + weight) / held.needed
    # Sections for a larger load weigh more, but not by more than it is larger.
    designed = Change(_LOAD, load) if weight <= load else Change.rounded(_LOAD, payload + link * weight / load)
    force = _swelled(prototype, problem, designed.value) + payload + link * designed.value / load
    structure = Demanded("load in the choice of its sections", weight, load, "N")
    gap = _closing(prototype, load + weight)
    if not structure.met:
        structure = structure._replace(ways=_heavier(problem, designed, masses_kg[1]))
    if not gap.met:
        gap = gap._replace(ways=structure.ways or ((_wider(problem, gap),),))
    if not held.met or (force > stall and not structure.met):
        held = held._replace(ways=_stronger(prototype, force))
    swelled, instead = _swelled(prototype, problem, load), []
    apart = (gap.available / MARGIN - gap.needed) * lumped_beam(prototype.inner_beam).stiffness + weight
    payloads = Change.rounded(_PAYLOAD, (min(load, stall - swelled, apart) - link) / STANDARD_GRAVITY, False)
    less = Change.rounded(_LOAD, (stall - weight) * load / swelled, False)
    every = (structure, held, gap)
    if payloads.value >= masses_kg[0] and not all(limit.met for limit in every):
        instead.append((payloads,))
    if less.value >= weight and not held.met:
        instead.append((less,))
    places = (held, key), (gap, "width_m and wall_m of both beams")
    missing = {one.name: place for one, place in places if one.available == inf}
    return Holding(load, weight, tuple(one for one in every if one.name not in missing), missing, tuple(instead))


def working(problem: DesignProblem, prototype: Prototype, masses_kg: tuple[float, float], up_to_Hz: float) -> Holding:
    """Whether a tuned design holds load and weight up to its bandwidth, and whether that is worth having.

    Args:
        problem: with the load, and how fast it is to be held still.
        prototype: of it, with a controller whose loop is stable at these masses.
        masses_kg: payloads (least, most).
        up_to_Hz: guaranteed bandwidth.
    """
    still, least = standing(problem, prototype, masses_kg), problem.load.least_bandwidth_Hz
    load = still.load_N
    need, actuator = needs_to_carry(prototype, masses_kg, load, up_to_Hz), prototype.actuator
    limits, missing = [one for one in still.limits if one.name != _GAP], dict(still.missing)
    every = [
        (one.name, one.place, need[one.need], actuator.stated(prototype, one), one.unit) for one in actuator.ratings
    ]
    every.insert(1, ("stroke", "actuator.stroke_m", 2 * need["stroke_m"], actuator.stroke_m, "m"))
    for name, key, needed, available, unit in every:
        if available is None:
            missing[name] = key
            continue
        limit = Demanded(name, needed, available, unit)
        ways: tuple[Way, ...] = ((Change.rounded(key, MARGIN * needed),),)
        if not isfinite(needed):  # the actuator stalls while the load moves
            ways = _stronger(prototype, MARGIN * need["force_N"])
        limits.append(limit if limit.met else limit._replace(ways=ways))
    moved = [one._replace(needed=need["stroke_m"]) for one in still.limits if one.name == _GAP]
    limits += [one if one.met else one._replace(ways=one.ways or ((_wider(problem, one),),)) for one in moved]
    bandwidth = Demanded("guaranteed bandwidth", least, up_to_Hz, "Hz")
    if not bandwidth.met:
        bandwidth = bandwidth._replace(ways=_slower(prototype, masses_kg, up_to_Hz, least))
    limits.append(bandwidth)

    def enough(change: Change) -> bool:
        """Whether less of the payload or of the load, which is no matter of the loop, is enough for all limits."""
        if change.key == _PAYLOAD:
            return not working(problem, prototype, (masses_kg[0], change.value), up_to_Hz).missed
        return not working(changed(problem, (change,)), prototype, masses_kg, up_to_Hz).missed

    instead = tuple((change,) for (change,) in still.instead if enough(change))
    return Holding(load, still.weight_N, tuple(limits), missing, instead)


def in_words(ways: Sequence[Way]) -> tuple[str, ...]:
    """Ways as people read them."""
    return tuple(" and ".join(map(str, way)) for way in ways)


def easier(problem: DesignProblem) -> tuple[Way, ...]:
    """What makes any design easier, to begin with: half of the largest payload, ten times the compliance."""
    largest = problem.asked_kg()[1]
    given = (Change(_PAYLOAD, largest, False), Change(_COMPLIANCE, problem.goal.compliance_m_per_N))
    return tuple((change,) for one in given for change in _milder(one, problem))


def _milder(change: Change, problem: DesignProblem) -> tuple[Change, ...]:
    """A payload halved, or a compliance times ten, as far as a study may state it; nothing of other changes."""
    factor = {_PAYLOAD: 0.5, _COMPLIANCE: 10.0}.get(change.key)
    if factor is None:
        return ()
    milder = Change.rounded(change.key, factor * change.value, change.at_least)
    least = problem.asked_kg()[0] if change.key == _PAYLOAD else 0.0
    return (milder,) if 0 < milder.value >= least and milder.value in q.range_of(_KEYS[change.key][2]) else ()


def changed(problem: DesignProblem, way: Way) -> DesignProblem:
    """A study with a way taken."""
    table = problem.model_dump()
    for change in way:
        name, key = change.key.split(".")
        table[name][key] = change.value if change.key != _PAYLOAD else (table[name][key][0], change.value)
    return DesignProblem.model_validate(table)


def carried(
    problem: DesignProblem, ways: Sequence[Way], lacking: Callable[[DesignProblem], Way | None]
) -> tuple[Way, ...]:
    """Those ways that lead to a design, with what else their studies need.

    A payload is halved, a compliance made ten times as large until one does.

    Args:
        problem: without a design.
        ways: to try.
        lacking: what a study needs besides to have a design: nothing where it has one; None where that is not known.
    """
    found: list[Way] = []
    for way in ways:
        tried = way
        for _ in range(_TRIES):
            needed = lacking(changed(problem, tried))
            whole = (*tried, *(needed or ()))
            if needed == () or (needed and lacking(changed(problem, whole)) == ()):
                found.append(whole)
                break
            if len(way) > 1 or not (tried := _milder(tried[0], problem)):
                break
    return tuple(found)


def _strictest(changes: Way) -> Way:
    """Of several changes of one key the one that asks for most."""
    rising = sorted(changes, key=lambda one: one.value if one.at_least else -one.value)
    strictest = {one.key: one for one in rising}
    return tuple(strictest[key] for key in dict.fromkeys(one.key for one in changes))


def _closing(prototype: Prototype, force_N: float) -> Demanded:
    """What a force held still and its own weight move the inner beam, of the gap in their direction, m."""
    play = gaps(prototype.outer_beam, prototype.inner_beam)
    needed = force_N / lumped_beam(prototype.inner_beam).stiffness + own_sag_m(prototype)
    return Demanded(_GAP, needed, inf if play is None else play[0], "m")


def _wider(problem: DesignProblem, gap: Demanded) -> Change:
    """What a study has to ask of the gap that is left under its load, so that load and weight leave one too."""
    return Change.rounded(_LEFT, problem.clearance.under_load_m + MARGIN * gap.needed - gap.available)


def _heavier(problem: DesignProblem, load: Change, payload_kg: float) -> tuple[Way, ...]:
    """A larger load, and what of the gap its sections need besides not to touch; none where there are no sections."""
    way: Way = (load,)
    for _ in range(_TRIES):
        study = changed(problem, way)
        sized = size(study)
        if not sized.feasible:
            break
        rig = study.prototype(sized.outer, sized.inner)
        gap = _closing(rig, load.value + weight_N(rig, payload_kg))
        if MARGIN * gap.needed <= gap.available:
            return (way,)
        way = (load, _wider(study, gap))
    return ()


def _swelled(prototype: Prototype, problem: DesignProblem, load_N: float) -> float:
    """Largest force, N, that a load takes of the cylinder while the tip gives way by no more than the goal allows.

    The actuator gives what the load and the spring of the outer beam ask, F (1 + c K); of sections for a larger load
    than the study's the spring is stiffer.
    """
    stiffness = lumped_beam(prototype.outer_beam).stiffness * (load_N / problem.load.tip_force_N) ** _PER_LOAD
    return load_N * (1 + problem.goal.compliance_m_per_N * stiffness)


def _stronger(prototype: Prototype, force_N: float) -> tuple[Way, ...]:
    """What the actuator needs more of, for a force."""
    return tuple((Change.rounded(*change),) for change in prototype.actuator.stronger(prototype, force_N))


def _slower(prototype: Prototype, masses_kg: tuple[float, float], up_to_Hz: float, least_Hz: float) -> tuple[Way, ...]:
    """The compliance that the same loop keeps up to the least bandwidth, or a bandwidth that it has."""
    places = [(stage.prototype, mass) for stage in prototype.stages(masses_kg) for mass in stage.looked_at_kg]
    asked = [demand(law, mass, grid_Hz(law, mass, least_Hz / 1e3, least_Hz, _POINTS)) for law, mass in places]
    most = max(float(np.abs(one["displacement"]).max()) for one in asked)
    had = Change.rounded("load.least_bandwidth_Hz", up_to_Hz, False)
    return (Change.rounded(_COMPLIANCE, MARGIN * most),), (had,)
