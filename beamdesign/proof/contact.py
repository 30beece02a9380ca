"""Contact with a wall: a spring and a dashpot at the tip, over ranges of stiffness, damping and end mass at once.

The characteristic polynomial p0 + (m s^2 + b s + k) n is affine in m, b and k together and of constant degree, so that
it is stable on the whole box if it is on its edges (edge theorem of Bartlett, Hollot and Huang, 1988). This is the
linear loop in lasting contact; touching and letting go is not covered, other than by passivity.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from flint import fmpq, fmpq_poly

from beamdesign.loop import Tip
from beamdesign.polynomial import Affine, exact
from beamdesign.proof.passivity import Environment
from beamdesign.proof.rational import nearest, shortened
from beamdesign.proof.stability import StabilityMap, stable_ranges, unstable_at

Ends = tuple[fmpq, fmpq]
_NO_DAMPING = (fmpq(0), fmpq(0))


@dataclass(frozen=True)
class Wall:
    """Walls that the tip may lean on.

    Attributes:
        stiffness: least and largest, N/m; zero is no wall.
        damping: least and largest, N s/m.
    """

    stiffness: Ends
    damping: Ends = _NO_DAMPING


@dataclass(frozen=True)
class Contact:
    """Whether the loop is stable against every wall of a range with every end mass of a range.

    Attributes:
        holds: whether it is proved; if not, it is refuted.
        reason: in words, why not; empty where it is.
        witness: end mass and wall at which it is not stable; None where it holds.
        exact: whether these figures refute it themselves, or only stand next to a root on the axis at irrational ones.
        frequency_Hz: of the oscillation there.
    """

    holds: bool
    reason: str = ""
    witness: Environment | None = None
    exact: bool = True
    frequency_Hz: float | None = None


@dataclass(frozen=True)
class _Edge:
    """One edge of the box: figures of one corner, and which of them varies (0 stiffness, 1 damping, 2 mass)."""

    corner: tuple[fmpq, ...]
    varies: int
    family: Affine
    low: fmpq
    high: fmpq

    def environment(self, value: fmpq) -> Environment:
        stiffness, damping, mass = (value if k == self.varies else given for k, given in enumerate(self.corner))
        return Environment(mass, stiffness, damping)


def _edges(tip: Tip, masses: Ends, wall: Wall) -> Iterator[_Edge]:
    sides = (wall.stiffness, wall.damping, masses)
    wide = [k for k in range(3) if sides[k][0] < sides[k][1]] or [2]
    for varies in wide:
        for rest in product(*(sorted(set(side)) for k, side in enumerate(sides) if k != varies)):
            corner = (*rest[:varies], fmpq(0), *rest[varies:])
            slope = fmpq_poly([fmpq(0)] * varies + [fmpq(1)]) * tip.moved
            family = Affine(tip.against(corner[2], corner[0], corner[1]), slope)
            yield _Edge(corner, varies, family, *sides[varies])


def prove_contact(tip: Tip, masses: Ends, wall: Wall) -> Contact:
    """Decide whether the loop is stable for every end mass, wall stiffness and wall damping of a box.

    Raises:
        ValueError: for an empty range, or a negative figure.
    """
    for name, (low, high) in (("mass", masses), ("stiffness", wall.stiffness), ("damping", wall.damping)):
        if not 0 <= low <= high:
            raise ValueError(f"{name} must range from zero or more upwards, is {nearest(low)} to {nearest(high)}")
    for edge in _edges(tip, masses, wall):
        if (there := unstable_at(edge.family, edge.low, edge.high)) is not None:
            found = edge.environment(there.value)
            return Contact(False, _words(found), found, there.exact, there.frequency_Hz)
    return Contact(True)


def _words(found: Environment) -> str:
    wall = f"against a wall of {nearest(found.stiffness):.6g} N/m" if found.stiffness else "without a wall"
    if found.damping:
        wall += f" with {nearest(found.damping):.6g} N s/m"
    return f"not stable {wall} and with an outer end mass of {nearest(found.mass):.6g} kg"


def stable_walls(tip: Tip, outer_end_mass: fmpq, wall: Wall) -> StabilityMap:
    """All ranges of wall stiffness (N/m) that are stable or not with one end mass (kg) and the least wall damping."""
    return stable_ranges(Affine(tip.against(outer_end_mass, damping=wall.damping[0]), tip.moved), *wall.stiffness)


def stiffest_wall(tip: Tip, masses: Ends, wall: Wall) -> float:
    """Largest wall stiffness (N/m) up to which every wall is proved to be stable with every mass, to four digits down.

    0 where even the softest is not; the range's own upper end where all of them are.
    """

    def proves(high: fmpq) -> bool:
        return prove_contact(tip, masses, Wall((wall.stiffness[0], high), wall.damping)).holds

    low, high = wall.stiffness
    if proves(high):
        return nearest(high)
    if not proves(low):
        return 0.0
    # What is stable up to some wall is so up to every softer one.
    lower, upper = max(low, fmpq(1)), high
    if not proves(lower):
        return nearest(low)
    while upper > lower * fmpq(10002, 10000):
        middle = shortened(_geometric(lower, upper), 6)
        lower, upper = (middle, upper) if proves(middle) else (lower, middle)
    return nearest(shortened(lower, 4)) if shortened(lower, 4) >= low else nearest(lower)


def _geometric(low: fmpq, high: fmpq) -> fmpq:
    return min(max(exact((nearest(low) * nearest(high)) ** 0.5), low), high)
