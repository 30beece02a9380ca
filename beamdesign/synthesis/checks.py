"""Structural checks of a pair of square tubes, on floats, numpy arrays and CasADi symbols alike.

Two load cases, each with the whole tip force on one beam:

- servo on: the actuator passes the force to the inner beam, which bends from its clamp over its free length, while the
  outer beam is held straight;
- servo off: the outer beam alone carries it, and bends towards the unloaded inner one.

The force is static and acts at the tips; the weight of the beams (about 1 % of its moment in the published prototype),
torsion, shear, fatigue and the introduction of the force into the walls are not checked.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR
from operator import attrgetter
from typing import Any, NamedTuple

from beamdesign.json_text import picked
from beamdesign.problem import DesignProblem
from beamdesign.quantity_text import decimal
from beamdesign.structure import beam, section
from beamdesign.structure.materials import Material
from beamdesign.structure.section import Quantity, SquareTube, bending_resistance

ROUNDING = 1e-9
"""Share of its limit (plus a thousandth of its unit) by which a check may be missed and still count.

Sums of decimal sizes are not exact in binary.
"""


class Requirements(NamedTuple):
    """The figures that are asked for, each of which may be a symbol too."""

    tip_force_N: Quantity
    strength: Quantity
    local_buckling: Quantity
    assembly_m: Quantity
    under_load_m: Quantity
    least_wall_m: Quantity
    largest_width_m: Quantity
    width_to_wall_at_most: Quantity | None


Factors = tuple[tuple[Quantity, Quantity], tuple[Quantity, Quantity]]


class Requirement(NamedTuple):
    """Of one of them where it stands in a study file, how far it may be eased, and what its shadow price is called.

    Attributes:
        key: in the study file.
        easiest: no load at all, factors of 1, no gap, walls of 0.1 mm, tubes of 2 m.
        price: name of the shadow price.
        share: of the requirement that makes the price's unit; None for 1 mm.
    """

    key: str
    easiest: float
    price: str
    share: float | None


REQUIREMENTS = {
    "tip_force_N": Requirement("load.tip_force_N", 1e-3, "tip_force_kg_per_percent", 0.01),
    "strength": Requirement("safety.strength", 1.0, "safety_strength_kg_per_percent", 0.01),
    "local_buckling": Requirement("safety.local_buckling", 1.0, "safety_local_buckling_kg_per_percent", 0.01),
    "assembly_m": Requirement("clearance.assembly_m", 0.0, "clearance_assembly_kg_per_mm", None),
    "under_load_m": Requirement("clearance.under_load_m", 0.0, "clearance_under_load_kg_per_mm", None),
    "least_wall_m": Requirement("sections.least_wall_m", 1e-4, "least_wall_kg_per_mm", None),
    "largest_width_m": Requirement("sections.largest_width_m", 2.0, "largest_width_kg_per_mm", None),
    "width_to_wall_at_most": Requirement(
        "sections.width_to_wall_at_most", 1000.0, "width_to_wall_at_most_kg_per_percent", 0.01
    ),
}
"""Every one of `Requirements`, in its order."""


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
        factor, unit = {"m": (1e3, "mm"), "Pa": (1e-6, "MPa"), "1": (1.0, "")}.get(self.unit, (1.0, self.unit))
        return factor * float(self.value), factor * float(self.limit), unit

    @property
    def missed(self) -> str:
        """In words, what it is and what it needs to be; numbers only."""
        value, limit, unit = self.shown
        side = "least" if self.at_least else "most"
        found = decimal(value, rounding=ROUND_FLOOR if self.at_least else ROUND_CEILING)
        return f"{self.name} is {found} {unit}".rstrip() + f", needs at {side} {decimal(limit)} {unit}".rstrip()

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
    """What a design problem asks of the sections."""
    return Requirements(*(attrgetter(one.key)(problem) for one in REQUIREMENTS.values()))


def materials(problem: DesignProblem) -> tuple[Material, Material]:
    """Those of the outer and the inner beam."""
    return problem.outer_beam.material, problem.inner_beam.material


def beam_mass(
    problem: DesignProblem,
    outer_width: Quantity,
    outer_wall: Quantity,
    inner_width: Quantity,
    inner_wall: Quantity,
    corner_radii: tuple[float, float] = (0.0, 0.0),
) -> Quantity:
    """Mass of both tubes over their full lengths, clamped parts included, kg; sizes in m."""
    outer, inner = materials(problem)
    return problem.outer_beam.length_m * section.mass_per_length(
        outer_width, outer_wall, outer.density_kg_per_m3, corner_radii[0]
    ) + problem.inner_beam.length_m * section.mass_per_length(
        inner_width, inner_wall, inner.density_kg_per_m3, corner_radii[1]
    )


def checks(
    problem: DesignProblem,
    outer_width: Quantity,
    outer_wall: Quantity,
    inner_width: Quantity,
    inner_wall: Quantity,
    asked: Requirements | None = None,
    corner_radii: tuple[float, float] = (0.0, 0.0),
    factors: Factors | None = None,
) -> list[Check]:
    """Every structural check of a pair of tubes.

    Args:
        problem: lengths, materials and what is asked.
        outer_width: outside width of the outer tube, m; this and the next three broadcast against each other.
        outer_wall: its wall, m.
        inner_width: outside width of the inner tube, m.
        inner_wall: its wall, m.
        asked: other figures than the problem's, perhaps symbols.
        corner_radii: outside corner radii of outer and inner tube, m.
        factors: local buckling factors (flange, web) of outer and inner tube, where they are variables on their own.

    Returns:
        Checks, always the same ones in the same order for the same problem.
    """
    asked = asked or requirements(problem)
    outer_alloy, inner_alloy = materials(problem)
    cases = (
        ("outer", "servo off", problem.outer_beam, outer_alloy, outer_width, outer_wall, corner_radii[0]),
        ("inner", "servo on", problem.inner_beam, inner_alloy, inner_width, inner_wall, corner_radii[1]),
    )
    found: list[Check] = []
    for (name, case, asked_of_beam, alloy, width, wall, radius), given in zip(
        cases, factors or (None, None), strict=True
    ):
        moment = asked.tip_force_N * asked_of_beam.free_length_m
        stress = moment / section.elastic_modulus(width, wall, radius)
        resistance = bending_resistance(width, wall, alloy.proof_strength_Pa, alloy.buckling_constants, radius, given)
        found += [
            Check(f"{name} strength, {case}", stress, alloy.proof_strength_Pa / asked.strength, "Pa"),
            Check(f"{name} local buckling, {case}", moment, resistance / asked.local_buckling, "N m"),
        ]
    return found + _fit(problem, asked, cases)


def _fit(problem: DesignProblem, asked: Requirements, cases: Iterable[tuple[Any, ...]]) -> list[Check]:
    """Clearances, walls and widths."""
    (_, _, outer, outer_alloy, outer_width, outer_wall, outer_radius), inner_case = cases
    _, _, inner, inner_alloy, inner_width, inner_wall, inner_radius = inner_case
    gap = section.clearance(outer_width, outer_wall, inner_width)
    outer_rigidity = section.flexural_rigidity(
        outer_alloy.youngs_modulus_Pa, section.second_moment(outer_width, outer_wall, outer_radius)
    )
    inner_rigidity = section.flexural_rigidity(
        inner_alloy.youngs_modulus_Pa, section.second_moment(inner_width, inner_wall, inner_radius)
    )
    gap_on = beam.clearance_under_load(gap, asked.tip_force_N, beam.tip_stiffness(inner_rigidity, inner.free_length_m))
    gap_off = beam.clearance_under_load(gap, asked.tip_force_N, beam.tip_stiffness(outer_rigidity, outer.free_length_m))
    found = [
        Check("clearance at assembly", gap, asked.assembly_m, "m", at_least=True),
        Check("clearance under load, servo on", gap_on, asked.under_load_m, "m", at_least=True),
        Check("clearance under load, servo off", gap_off, asked.under_load_m, "m", at_least=True),
        Check("outer least wall", outer_wall, asked.least_wall_m, "m", at_least=True),
        Check("inner least wall", inner_wall, asked.least_wall_m, "m", at_least=True),
        Check("outer wall within strength data", outer_wall, outer_alloy.largest_wall_m, "m"),
        Check("inner wall within strength data", inner_wall, inner_alloy.largest_wall_m, "m"),
        Check("outer largest width", outer_width, asked.largest_width_m, "m"),
    ]
    if asked.width_to_wall_at_most is not None:
        found += [
            Check("outer width to wall", outer_width / outer_wall, asked.width_to_wall_at_most, "1"),
            Check("inner width to wall", inner_width / inner_wall, asked.width_to_wall_at_most, "1"),
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

    outer: SquareTube
    inner: SquareTube
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
        return {
            "outer": self.outer._asdict(),
            "inner": self.inner._asdict(),
            "beam_mass_kg": self.beam_mass_kg,
            "checks": [picked(check, "name value limit utilisation unit at_least satisfied") for check in self.checks],
        }

    def __str__(self) -> str:
        """The sizes in words."""
        return " and ".join(f"{1e3 * width:.4g} x {1e3 * wall:.3g} mm" for width, wall in (self.outer, self.inner))

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
    outer: SquareTube,
    inner: SquareTube,
    corner_radii: tuple[float, float] = (0.0, 0.0),
    asked: Requirements | None = None,
) -> CheckedPair:
    """Check a given pair of tubes.

    Args:
        problem: what is asked.
        outer: width and wall of the outer tube, m.
        inner: width and wall of the inner tube, m.
        corner_radii: outside corner radii of both, m.
        asked: other figures than the problem's.
    """
    found = checks(problem, *outer, *inner, asked=asked, corner_radii=corner_radii)
    return CheckedPair(
        outer=outer,
        inner=inner,
        beam_mass_kg=float(beam_mass(problem, *outer, *inner, corner_radii)),
        checks=tuple(check._replace(value=float(check.value), limit=float(check.limit)) for check in found),
    )
