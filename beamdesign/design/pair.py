"""A pair of square tubes with its mass and its checks."""

from dataclasses import dataclass

from beamdesign.design.checks import Check, Requirements, beam_mass, checks
from beamdesign.problem import DesignProblem
from beamdesign.section import SquareTube


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

    Raises:
        InputError: where a material is unknown.
    """
    found = checks(problem, *outer, *inner, asked=asked, corner_radii=corner_radii)
    return CheckedPair(
        outer=outer,
        inner=inner,
        beam_mass_kg=float(beam_mass(problem, *outer, *inner, corner_radii)),
        checks=tuple(check._replace(value=float(check.value), limit=float(check.limit)) for check in found),
    )
