"""What to change of a study that has no design: keys and figures, tried until they lead to one."""

from collections.abc import Callable, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import NamedTuple

from beamdesign import quantities as q
from beamdesign.plant.actuators import KINDS as ACTUATORS
from beamdesign.problem import DesignProblem

PAYLOAD, COMPLIANCE = "payload.outer_end_mass_kg", "goal.compliance_m_per_N"
LOAD, LEFT = "load.tip_force_N", "clearance.under_load_m"
SAFETY = {"safety.strength": "strength", "safety.local_buckling": "local buckling"}
LOOP_GAIN, FROM_HZ = "goal.loop_gain", "goal.loop_gain_from_Hz"
TRIES = 4
"""How often a change is made larger until it leads to a design."""


class Change(NamedTuple):
    """A key of the study file, and the figure that it must have at least, or at most; of payloads the largest.

    Attributes:
        key: of the study file.
        value: SI.
        at_least: or at most.
        smallest: of a range of payloads, which stays.
    """

    key: str
    value: float
    at_least: bool = True
    smallest: float = 0.0

    @classmethod
    def rounded(cls, key: str, value: float, at_least: bool = True, smallest: float = 0.0) -> "Change":
        """With a figure to three significant digits that is enough, so that what is printed of it is all of it."""
        towards = Context(3, ROUND_CEILING if at_least else ROUND_FLOOR)
        return cls(key, float(towards.create_decimal(repr(float(value)))), at_least, smallest)

    def __str__(self) -> str:
        """In words, in the unit that it is read in and as it is to be written."""
        name, unit, _ = KEYS[self.key]
        side = "least" if self.at_least else "most"
        written = f"[{self.smallest:g}, {self.value:g}]" if self.key == PAYLOAD else f"{self.value:g}"
        return f"{name} of at {side} {q.quantity(self.value, unit)} ({self.key} = {written})"


Way = tuple[Change, ...]
"""Changes that are made together."""

KEYS = {
    PAYLOAD: ("a payload", "kg", q.MassOrNone),
    LOAD: ("a load", "N", q.Force),
    LEFT: ("a gap left under load", "m", q.Gap),
    "actuator.piston_area_m2": ("a piston area", "m2", q.PistonArea),
    "actuator.torque_constant_N_m_per_A": ("a torque constant", "N m/A", q.TorqueConstant),
    "actuator.stroke_m": ("a stroke", "m", q.Stroke),
    "supply.pressure_Pa": ("a supply pressure", "Pa", q.SupplyPressure),
    **{one.place: (f"a {one.name}", one.unit, one.quantity) for kind in ACTUATORS.values() for one in kind.ratings},
    COMPLIANCE: ("a goal of compliance", "m/N", q.ComplianceLimit),
    **{key: (f"a factor of safety on {words}", "1", q.SafetyFactor) for key, words in SAFETY.items()},
    LOOP_GAIN: ("a loop gain", "1", q.LoopGain),
    FROM_HZ: ("a frequency from where on that counts", "Hz", q.Frequency),
    "load.least_bandwidth_Hz": ("a goal of bandwidth", "Hz", q.Bandwidth),
}
"""By key: its name, its unit, and what of it a study may state."""


def in_words(ways: Sequence[Way]) -> tuple[str, ...]:
    """Ways as people read them."""
    return tuple(" and ".join(map(str, way)) for way in ways)


def easier(problem: DesignProblem) -> tuple[Way, ...]:
    """What makes any design easier, to begin with: half of the largest payload, ten times the compliance."""
    smallest, largest = problem.asked_kg()
    given = (Change(PAYLOAD, largest, False, smallest), Change(COMPLIANCE, problem.goal.compliance_m_per_N))
    return tuple((change,) for one in given for change in _milder(one, problem))


def _milder(change: Change, problem: DesignProblem) -> tuple[Change, ...]:
    """A payload halved, or a compliance times ten, as far as a study may state it; nothing of other changes."""
    factor = {PAYLOAD: 0.5, COMPLIANCE: 10.0}.get(change.key)
    if factor is None:
        return ()
    milder = Change.rounded(change.key, factor * change.value, change.at_least, change.smallest)
    least = problem.asked_kg()[0] if change.key == PAYLOAD else 0.0
    return (milder,) if 0 < milder.value >= least and milder.value in q.range_of(KEYS[change.key][2]) else ()


def changed(problem: DesignProblem, way: Way) -> DesignProblem:
    """A study with a way taken."""
    table = problem.model_dump()
    for change in way:
        name, key = change.key.split(".")
        table[name][key] = change.value if change.key != PAYLOAD else (table[name][key][0], change.value)
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
        for _ in range(TRIES):
            needed = lacking(changed(problem, tried))
            whole = (*tried, *(needed or ()))
            if needed == () or (needed and lacking(changed(problem, whole)) == ()):
                found.append(whole)
                break
            if len(way) > 1 or not (tried := _milder(tried[0], problem)):
                break
    return tuple(found)


def strictest(changes: Way) -> Way:
    """Of several changes of one key the one that asks for most."""
    rising = sorted(changes, key=lambda one: one.value if one.at_least else -one.value)
    strictest = {one.key: one for one in rising}
    return tuple(strictest[key] for key in dict.fromkeys(one.key for one in changes))
