"""Structural checks of a pair of tubes, on floats, numpy arrays and CasADi symbols alike.

Two load cases, each with the whole tip force on one beam:

- servo on: the actuator passes the force to the inner beam, which bends from its clamp over its free length, while the
  outer beam is held straight;
- servo off: the outer beam alone carries it, and bends towards the unloaded inner one.

The force is static and acts at the tips; the weight of the beams (about 1 % of its moment in the published prototype),
torsion, shear, fatigue and the introduction of the force into the walls are not checked.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from operator import attrgetter
from typing import Any, NamedTuple

from beamdesign.problem import DesignProblem
from beamdesign.quantities import at_least, at_most, quantity, read_in
from beamdesign.result import picked
from beamdesign.structure import lumped
from beamdesign.structure.section import Quantity, Tube, clearances

ROUNDING = 1e-9
"""Share of its limit (plus a thousandth of its unit) by which a check may be missed and still count.

Sums of decimal sizes are not exact in binary.
"""


Requirements = Mapping[str, Quantity]
"""The figures that are asked for by their names in `REQUIREMENTS`, each of which may be a symbol too."""

Factors = tuple[tuple[Quantity, Quantity], tuple[Quantity, Quantity]]


class Requirement(NamedTuple):
    """Of one of them where it stands in a study file, how far it may be eased, and how its shadow price is told.

    Attributes:
        key: in the study file.
        easiest: no load at all, factors of 1, no gap, walls of 0.1 mm, tubes of 2 m.
        name: what the names of its shadow price begin with.
        words: what it is called.
        share: of the requirement that makes the price's unit; None for 1 mm.
    """

    key: str
    easiest: float
    name: str
    words: str
    share: float | None = None

    @property
    def price(self) -> str:
        """Name of the shadow price."""
        return f"{self.name}_kg_per_{'mm' if self.share is None else 'percent'}"

    def unit(self, figure: float) -> float:
        """What that is per, where so much is asked, in the requirement's own unit."""
        return 0.001 if self.share is None else self.share * figure


_STATED = (
    Requirement("load.tip_force_N", 1e-3, "tip_force", "tip force", 0.01),
    Requirement("safety.strength", 1.0, "safety_strength", "safety factor on strength", 0.01),
    Requirement("safety.local_buckling", 1.0, "safety_local_buckling", "safety factor on local buckling", 0.01),
    Requirement("clearance.assembly_m", 0.0, "clearance_assembly", "clearance at assembly"),
    Requirement("clearance.under_load_m", 0.0, "clearance_under_load", "clearance under load"),
    Requirement("sections.least_wall_m", 1e-4, "least_wall", "least wall"),
    Requirement("sections.largest_width_m", 2.0, "largest_width", "largest width"),
    Requirement("sections.width_to_wall_at_most", 1000.0, "width_to_wall_at_most", "largest width to wall", 0.01),
)
REQUIREMENTS = {one.key.partition(".")[2]: one for one in _STATED}
"""What can be asked for, by name."""


class Check(NamedTuple):
    """One requirement met or missed: what it is about, the figure found, and its limit, in the same unit."""

    name: str
    value: Quantity
    limit: Quantity
    unit: str
    at_least: bool = False

    @property
    def shown(self) -> tuple[float, float, str]:
        """Value, limit and unit for people: millimetres and megapascals; numbers only."""
        unit, factor = read_in(float(self.value), self.unit)
        return factor * float(self.value), factor * float(self.limit), unit

    @property
    def missed(self) -> str:
        """In words, what it is and what it needs to be; numbers only."""
        side, bound = ("least", at_least) if self.at_least else ("most", at_most)
        found, limit = bound(float(self.value), self.unit), quantity(float(self.limit), self.unit)
        return f"{self.name} is {found}, needs at {side} {limit}"

    @property
    def slack(self) -> Quantity:
        """How far the value is on the right side of its limit; negative where the check fails."""
        return self.value - self.limit if self.at_least else self.limit - self.value

    @property
    def satisfied(self) -> Any:
        """Whether the check holds, up to `ROUNDING`; numbers and arrays only."""
        return self.slack >= -ROUNDING * (abs(self.limit) + 1e-3)

    @property
    def utilisation(self) -> float:
        """Share of the limit that is used, 1 at the limit and more beyond; numbers only.

        value / limit of what may be at most its limit, limit / value of what must be at least that; infinite where such
        a value is not positive though its limit is.
        """
        value, limit = float(self.value), float(self.limit)
        over, under = (limit, value) if self.at_least else (value, limit)
        if under > 0:
            return max(over, 0.0) / under
        return float("inf") if over > under else 1.0


def requirements(problem: DesignProblem) -> Requirements:
    """What a design problem asks of the sections; a width to wall only where it has a limit of that."""
    every = {name: attrgetter(one.key)(problem) for name, one in REQUIREMENTS.items()}
    return {name: figure for name, figure in every.items() if figure is not None}


def beam_mass(problem: DesignProblem, outer: Tube, inner: Tube) -> Quantity:
    """Mass of both tubes over their full lengths, clamped parts included, kg."""
    pairs = zip(problem.beams, (outer, inner), strict=True)
    return sum(asked.length_m * tube.mass_per_length(asked.material.density_kg_per_m3) for asked, tube in pairs)


def checks(
    problem: DesignProblem,
    outer: Tube,
    inner: Tube,
    asked: Requirements | None = None,
    factors: Factors | None = None,
    measured: tuple[float, float] | None = None,
) -> list[Check]:
    """Every structural check of a pair of tubes.

    Args:
        problem: lengths, materials and what is asked.
        outer: the outer tube, whose sizes and those of the inner one broadcast against each other, m.
        inner: the inner tube.
        asked: other figures than the problem's, perhaps symbols.
        factors: local buckling factors (flange, web) of outer and inner tube, where they are variables on their own.
        measured: tip stiffness of outer and inner tube, N/m, where it is not to follow from their sections.

    Returns:
        Checks, always the same ones in the same order for the same problem.
    """
    asked = asked or requirements(problem)
    cases = (("outer", "servo off", problem.outer_beam, outer), ("inner", "servo on", problem.inner_beam, inner))
    found: list[Check] = []
    for (name, case, of, tube), given in zip(cases, factors or (None, None), strict=True):
        alloy, moment = of.material, asked["tip_force_N"] * of.free_length_m
        stress = moment / tube.elastic_modulus
        resistance = tube.bending_resistance(alloy.proof_strength_Pa, alloy.buckling_constants, given)
        found += [
            Check(f"{name} strength, {case}", stress, alloy.proof_strength_Pa / asked["strength"], "Pa"),
            Check(f"{name} local buckling, {case}", moment, resistance / asked["local_buckling"], "N m"),
        ]
        if tube.shape == "round":
            limit = alloy.largest_diameter_to_wall
            if alloy.buckling_class is None:  # EN 1993-1-1, 5.5.2(9): of the stress under load in place of the strength
                limit = limit * (resistance / (asked["local_buckling"] * moment))
            found.append(Check(f"{name} diameter to wall, class 3", tube.width_m / tube.wall_m, limit, "1"))
    stiffness = measured or [
        lumped.tip_stiffness(of.material.youngs_modulus_Pa * tube.second_moment, of.free_length_m)
        for _, _, of, tube in cases
    ]
    gaps, force, thinnest = clearances(outer, inner), asked["tip_force_N"], asked["least_wall_m"]
    gap_off, gap_on = (lumped.clearance_under_load(gaps[0], force, one) for one in stiffness)
    found += [
        Check("clearance at assembly", gaps[0], asked["assembly_m"], "m", at_least=True),
        *(Check("clearance at assembly, across", gap, asked["assembly_m"], "m", at_least=True) for gap in gaps[1:]),
        Check("clearance under load, servo on", gap_on, asked["under_load_m"], "m", at_least=True),
        Check("clearance under load, servo off", gap_off, asked["under_load_m"], "m", at_least=True),
        *(Check(f"{name} least wall", tube.wall_m, thinnest, "m", at_least=True) for name, _, _, tube in cases),
        *(
            Check(f"{name} wall within strength data", tube.wall_m, of.material.largest_wall_m, "m")
            for name, _, of, tube in cases
        ),
        *(Check(f"outer largest {side}", size, asked["largest_width_m"], "m") for side, size in outer.sides.items()),
    ]
    if (most := asked.get("width_to_wall_at_most")) is not None:
        found += [
            Check(f"{name} {side} to wall", size / tube.wall_m, most, "1")
            for name, _, _, tube in cases
            for side, size in tube.sides.items()
        ]
    return found


@dataclass(frozen=True)
class CheckedPair:
    """A pair of tubes, checked.

    Attributes:
        outer: the outer tube, m.
        inner: the inner tube, m.
        beam_mass_kg: both tubes over their full lengths.
        checks: every structural check, in numbers.
    """

    outer: Tube
    inner: Tube
    beam_mass_kg: float
    checks: tuple[Check, ...]

    @property
    def failing(self) -> tuple[Check, ...]:
        """The checks that are not satisfied, the worst first."""
        missed = [check for check in self.checks if not check.satisfied]
        return tuple(sorted(missed, key=lambda check: -check.utilisation))

    @property
    def misses(self) -> str:
        """What these are and need to be, in words."""
        return "; ".join(check.missed for check in self.failing)

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        checks = [picked(check, "name value limit utilisation unit at_least satisfied") for check in self.checks]
        return picked(self, "outer=outer.sizes inner=inner.sizes beam_mass_kg") | {"checks": checks}

    def __str__(self) -> str:
        """The sizes in words."""
        return " and ".join(f"{tube.millimetres} mm" for tube in (self.outer, self.inner))

    @property
    def feasible(self) -> bool:
        """Whether every check is satisfied."""
        return not self.failing

    @property
    def governing(self) -> str:
        """Name of the check that uses most of its limit, or misses it most."""
        return max(self.checks, key=lambda check: check.utilisation).name


def check_sections(
    problem: DesignProblem,
    outer: Tube,
    inner: Tube,
    asked: Requirements | None = None,
    measured: tuple[float, float] | None = None,
) -> CheckedPair:
    """Check a given pair of tubes.

    Args:
        problem: what is asked.
        outer: the outer tube, m.
        inner: the inner tube, m.
        asked: other figures than the problem's.
        measured: as of `checks`.
    """
    found = checks(problem, outer, inner, asked, measured=measured)
    in_numbers = tuple(check._replace(value=float(check.value), limit=float(check.limit)) for check in found)
    return CheckedPair(outer, inner, float(beam_mass(problem, outer, inner)), in_numbers)


Pair = tuple[Tube, Tube]
"""The outer and the inner tube."""

_DIGITS, _MEANT = 4, 12


@dataclass(frozen=True)
class Relaxation:
    """A change of one requirement that is enough, all others staying as they are.

    Attributes:
        key: where the requirement stands in a study file.
        asked: its figure there.
        enough: a figure with which tubes were found, rounded to the easier side.
        outer: outer tube that does then.
        inner: inner tube that does then.
    """

    key: str
    asked: float
    enough: float
    outer: Tube
    inner: Tube

    def __str__(self) -> str:
        """In words, as in "load.tip_force_N from 2000 to 1500"."""
        return f"{self.key} from {self.asked:g} to {self.enough:g}"

    @property
    def share(self) -> float:
        """Size of the change relative to what was asked."""
        return abs(self.enough - self.asked) / self.asked


def eased(asked: Requirements, name: str, share: Any) -> Any:
    """The figure of a requirement at a share, 0 to 1, of the way to its easiest; of a symbol in symbols.

    The way is by equal factors where it does not end at zero: a load may be orders of magnitude too large.
    """
    figure, easiest = float(asked[name]), REQUIREMENTS[name].easiest
    return figure * (easiest / figure) ** share if easiest else figure * (1 - share)


def enough_of(asked: Requirements, name: str, share: float) -> float:
    """That figure, rounded to a few digits in the direction of the easiest one, and not beyond it."""
    figure, easiest = eased(asked, name, share), REQUIREMENTS[name].easiest
    exact = Context(_MEANT).create_decimal(repr(figure))  # so that 1500.0000000000002 is 1500 and stays that
    value = float(Context(_DIGITS, ROUND_CEILING if easiest > figure else ROUND_FLOOR).create_decimal(exact))
    return min(value, easiest) if easiest > figure else max(value, easiest)


def relaxable(asked: Requirements) -> list[str]:
    """Names of those that can be eased."""
    return [name for name, figure in asked.items() if float(figure) != REQUIREMENTS[name].easiest]


def confirmed(problem: DesignProblem, found: Iterable[tuple[str, float, Pair]]) -> tuple[Relaxation, ...]:
    """The relaxations, the relatively smallest first, whose pairs really pass with the rounded figure."""
    asked = requirements(problem)
    every = [
        Relaxation(REQUIREMENTS[name].key, float(asked[name]), enough, *pair)
        for name, enough, pair in found
        if check_sections(problem, *pair, asked={**asked, name: enough}).feasible
    ]
    return tuple(sorted(every, key=lambda one: one.share))
