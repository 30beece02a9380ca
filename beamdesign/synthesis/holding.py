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
- Strength of the inner tube, without a safety factor: up to the bandwidth, where it may resonate.
- Gain: below the critical one of all bending modes, of which the proofs have one per beam; where it is not, that is a
  caution.
- Bandwidth: at least the one up to which the study wants its load held still.

What holds still is asked before anything is tuned (`standing`), the rest of a tuned design (`working`). What needs a
figure that the prototype does not state is not asked, and named.
"""

from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from beamdesign import quantities as q
from beamdesign.loop import loop
from beamdesign.plant.actuators import MARGIN
from beamdesign.plant.linear_reach import single_mode_reach
from beamdesign.plant.members import STANDARD_GRAVITY, bearable_travel_m, own_sag_m, weight_N
from beamdesign.problem import DesignProblem
from beamdesign.prototype import Prototype
from beamdesign.quantities import at_least, at_most, rigs_in_words
from beamdesign.records import InputError
from beamdesign.result import finite, picked
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.shapes import gaps
from beamdesign.synthesis.changes import (
    COMPLIANCE,
    FROM_HZ,
    KEYS,
    LEFT,
    LOAD,
    LOOP_GAIN,
    PAYLOAD,
    SAFETY,
    TRIES,
    Change,
    Way,
    changed,
    in_words,
    strictest,
)
from beamdesign.synthesis.operating_limits import demand, grid_Hz, needs_to_carry
from beamdesign.synthesis.sizing import size

_PER_LOAD = 4 / 3
"""Power of the load with which a tube's stiffness grows at most, where all its sizes grow alike at one stress."""
_POINTS = 60
_GAP, _BEND = "gap between the tubes", "travel that the inner tube bears"
_MODES = "critical gain with all bending modes"
_OSCILLATES = "with one mode per beam, as proofs have it, the loop is stable, and with all of them it oscillates"
_BELOW = 0.8  # of the frequency at which all modes oscillate: from there on a limit of the loop gain helps


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
        """What is not met, without which it is no design."""
        return tuple(limit for limit in self.limits if not (limit.met or limit.name == _MODES))

    @property
    def caution(self) -> str:
        """What is to be heeded of a design, with what to change; empty where there is nothing."""
        if self.all_modes is None or self.all_modes.met:
            return ""
        return f"{self.all_modes.words}: {_OSCILLATES}; {', or '.join(in_words(self.all_modes.ways))}"

    @property
    def all_modes(self) -> Demanded | None:
        """The gain of a tuned design, of the critical one of all bending modes."""
        return next((limit for limit in self.limits if limit.name == _MODES), None)

    @property
    def ways(self) -> tuple[Way, ...]:
        """What to change, each way enough by itself, of figures that a study may state; empty where all is met."""
        every = all(limit.ways for limit in self.missed) and self.missed
        joined = (strictest(sum(way, ())) for way in product(*(limit.ways for limit in self.limits if limit.ways)))
        ways = dict.fromkeys((*self.instead, *(joined if every else ())))
        stated = [way for way in ways if all(one.value in q.range_of(KEYS[one.key][2]) for one in way)]
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
        return finite(picked(self, "load_N weight_N missing caution") | {"limits": limits})


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
    designed = Change(LOAD, load) if weight <= load else Change.rounded(LOAD, payload + link * weight / load)
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
    carried = (min(load, stall - swelled, apart) - link) / STANDARD_GRAVITY
    payloads = Change.rounded(PAYLOAD, carried, False, masses_kg[0])
    less = Change.rounded(LOAD, (stall - weight) * load / swelled, False)
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
        if not isfinite(needed):
            what, pressure, supply, of, _ = actuator.holding(prototype, need["force_N"])
            limit = Demanded(f"{what} while the load moves", pressure, inf if supply is None else supply, of)
            ways = _stronger(prototype, MARGIN * need["force_N"])
        if limit not in limits:
            limits.append(limit if limit.met else limit._replace(ways=ways))
    moved = [one._replace(needed=need["stroke_m"]) for one in still.limits if one.name == _GAP]
    limits += [one if one.met else one._replace(ways=one.ways or ((_wider(problem, one),),)) for one in moved]
    limits += [*_strength(prototype, load, need["stroke_m"]), *_modes(prototype, masses_kg)]
    bandwidth = Demanded("guaranteed bandwidth", least, up_to_Hz, "Hz")
    if not bandwidth.met:
        bandwidth = bandwidth._replace(ways=_slower(prototype, masses_kg, up_to_Hz, least))
    limits.append(bandwidth)

    def enough(change: Change) -> bool:
        """Whether less of the payload or of the load, which is no matter of the loop, is enough for all limits."""
        if change.key == PAYLOAD:
            return not working(problem, prototype, (masses_kg[0], change.value), up_to_Hz).missed
        return not working(changed(problem, (change,)), prototype, masses_kg, up_to_Hz).missed

    instead = tuple((change,) for (change,) in still.instead if enough(change))
    return Holding(load, still.weight_N, tuple(limits), missing, instead)


def _strength(prototype: Prototype, load_N: float, travel_m: float) -> list[Demanded]:
    """What the inner tip travels, of what its tube bears; sections chosen with as much more safety bear it."""
    if (bears := bearable_travel_m(prototype)) is None:
        return []
    found = Demanded(_BEND, travel_m, bears, "m")
    times = MARGIN * travel_m * lumped_beam(prototype.inner_beam).stiffness / load_N
    return [found if found.met else found._replace(ways=(tuple(Change.rounded(key, times) for key in SAFETY),))]


def _modes(prototype: Prototype, masses_kg: tuple[float, float]) -> list[Demanded]:
    """The gain, of the least critical one of all bending modes; a limit of the loop gain from there on lowers it."""
    found = []
    for stage in prototype.stages(masses_kg):
        for mass in stage.looked_at_kg:
            with suppress(InputError, ValueError):  # of no beam with sizes, or no gain makes it oscillate
                found.append((stage.prototype, mass, single_mode_reach(stage.prototype, mass)))
    gains = [(law.own_controller.gain_A_per_V / of.critical_gain_all_A_per_V, law, mass, of) for law, mass, of in found]
    if not gains:
        return []
    share, law, mass, modes = max(gains, key=lambda row: row[0])
    gain, least = law.own_controller.gain_A_per_V, modes.critical_gain_all_A_per_V
    wanted = Demanded(_MODES, gain, least, "A/V")
    if wanted.met:
        return [wanted]
    from_Hz = _BELOW * modes.critical_frequency_Hz
    own = abs(loop(law.but(effects={})).at(mass).loop_response(np.array([from_Hz]))[0])
    way = Change.rounded(LOOP_GAIN, own / (MARGIN * share), False), Change.rounded(FROM_HZ, from_Hz, False)
    return [wanted._replace(ways=(way,))]


def _closing(prototype: Prototype, force_N: float) -> Demanded:
    """What a force held still and its own weight move the inner beam, of the gap in their direction, m."""
    play = gaps(prototype.outer_beam, prototype.inner_beam)
    needed = force_N / lumped_beam(prototype.inner_beam).stiffness + own_sag_m(prototype)
    return Demanded(_GAP, needed, inf if play is None else play[0], "m")


def _wider(problem: DesignProblem, gap: Demanded) -> Change:
    """What a study has to ask of the gap that is left under its load, so that load and weight leave one too."""
    return Change.rounded(LEFT, problem.clearance.under_load_m + MARGIN * gap.needed - gap.available)


def _heavier(problem: DesignProblem, load: Change, payload_kg: float) -> tuple[Way, ...]:
    """A larger load, and what of the gap its sections need besides not to touch; none where there are no sections."""
    way: Way = (load,)
    for _ in range(TRIES):
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
    return (Change.rounded(COMPLIANCE, MARGIN * most),), (had,)
