"""Square, rectangular and round tubes: their sections, on floats, numpy arrays and CasADi symbols; stock sizes.

A rounded rectangle is the sharp one less four corner pieces; a tube is the outside rectangle less the opening. The
inside corner radius is what the wall leaves of the outside one, `max(r - wall, 0)`. All results but the torsion
constant of tubes with corners are exact; nothing else is a thin-wall approximation.

Local buckling of thin flat walls is that of EN 1999-1-1:2007 (Eurocode 9), in bending, without welds. A wall too
slender for its class limit counts with a reduced thickness where it is compressed (clauses 6.1.4 and 6.1.5), and the
bending resistance is that of the effective section (6.2.5). Elastic throughout: the reserve that 6.2.5 allows to stocky
(class 1 and 2) sections by plastic bending is left out, on the safe side. A round tube has no effective section here:
its wall is to be of class 3 at most, `Material.largest_diameter_to_wall`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import permutations
from math import pi
from pathlib import Path
from typing import Any, ClassVar, Self, TypeAlias

from beamdesign.records import read_table

Quantity: TypeAlias = Any
"""A float, a numpy array or a CasADi expression; the functions give back what they are given (broadcast)."""


def positive_part(value: Quantity) -> Quantity:
    """`max(value, 0)`, in operations that floats, arrays and symbols share; exact in floating point."""
    return (value + abs(value)) / 2


GAMMA_M1 = 1.1
"""Partial factor for the resistance of members, clause 6.1.3, Table 6.1."""

WEB_SLENDERNESS = 0.40
"""beta over b / t of an internal part whose neutral axis is at its centre, clause 6.1.4.3(1)."""


LOCAL_BUCKLING_CONSTANTS = {"A": (32.0, 220.0), "B": (29.0, 198.0)}
"""C1 and C2 of the local buckling factor of an internal part: Table 6.3, without welds."""


def elastic_buckling_constants(modulus: float, poissons_ratio: float) -> tuple[float, float]:
    """C1 and C2 of a plate of a modulus (Pa), by Winter's curve rho = 1 / lambda - 0.22 / lambda^2.

    The slenderness lambda is sqrt(f / sigma_cr) with sigma_cr = 4 pi^2 E / (12 (1 - nu^2)) (t / b)^2, as in
    EN 1993-1-5:2006, clause 4.4. For aluminium that is row A of Table 6.3 of EN 1999-1-1; for webs it is on the safe
    side, since there EN 1993 has 0.11 in the place of 0.22.
    """
    first = (4 * pi**2 * modulus / (12 * (1 - poissons_ratio**2)) / 250e6) ** 0.5
    return first, 0.22 * first**2


def buckling_curve(slenderness: Quantity, constants: tuple[float, float]) -> Quantity:
    """C1 / x - C2 / x^2 at x = beta / epsilon, held constant below its maximum at x = 2 C2 / C1.

    There it exceeds 1, so that `min(1, buckling_curve)` is the local buckling factor, while the curve itself has a
    continuous slope: an optimiser gets rho_c <= 1 and rho_c <= buckling_curve and never meets the kink between them.
    """
    first, second = constants
    peak = 2 * second / first
    held = peak + positive_part(slenderness - peak)
    return first / held - second / held**2


def local_buckling_factor(slenderness: Quantity, constants: tuple[float, float]) -> Quantity:
    """rho_c = t_eff / t of a compressed internal part of relative slenderness beta / epsilon, clause 6.1.5(2).

    1 up to the class 3 limit, C1 / x - C2 / x^2 beyond it.
    """
    return 1 - positive_part(1 - buckling_curve(slenderness, constants))


@dataclass(frozen=True)
class Tube:
    """A square tube, and what all shapes have in common; bent by a load along its depth.

    Attributes:
        width_m: outside width across the load; of a round tube its diameter, m.
        wall_m: wall thickness t, m, less than half of every side.
        corner_radius_m: outside corner radius r, m; 0 is sharp, inside and out. At most half of every side.
        depth_over_width: outside size along the load over that across it.
    """

    width_m: Quantity
    wall_m: Quantity
    corner_radius_m: Quantity = 0.0
    depth_over_width: Quantity = field(default=1.0, kw_only=True)
    shape: ClassVar[str] = "square"

    @property
    def depth_m(self) -> Quantity:
        """Outside size along the load, m."""
        return self.depth_over_width * self.width_m

    @property
    def sides(self) -> dict[str, Quantity]:
        """Outside sizes that differ, m, by name."""
        return {"width": self.width_m}

    @property
    def turned(self) -> "Tube":
        """The same tube with the load on its other side."""
        return replace(self, width_m=self.depth_m, depth_over_width=1 / self.depth_over_width)

    @property
    def sizes(self) -> dict[str, Quantity]:
        """What tells it from other tubes, by the keys of a beam."""
        found = {"width_m": self.width_m, "wall_m": self.wall_m}
        return found if self.shape == "square" else {"shape": self.shape, **found}

    def at(self, width: Quantity, wall: Quantity) -> Self:
        """A tube of the same shape and corners, of another width and wall in m."""
        return replace(self, width_m=width, wall_m=wall)

    @property
    def millimetres(self) -> str:
        """The sizes, in words: outside ones and wall."""
        return f"{1e3 * self.width_m:.4g} x {1e3 * self.wall_m:.3g}"

    @property
    def area(self) -> Quantity:
        """Cross-section area, m2: 2 t (b + h - 2 t) - (4 - pi) (r^2 - max(r - t, 0)^2)."""
        inner_radius = positive_part(self.corner_radius_m - self.wall_m)
        sharp = 2 * self.wall_m * (self.width_m + self.depth_m - 2 * self.wall_m)
        return sharp - (4 - pi) * (self.corner_radius_m**2 - inner_radius**2)

    @property
    def second_moment(self) -> Quantity:
        """Second moment of area about the centroidal axis across the load, symbol I, m4."""
        wall, depth = self.wall_m, self.depth_m
        opening = depth - 2 * wall
        # b h^3 - (b - 2 t) (h - 2 t)^3 factored, so that thin walls do not cancel.
        sharp = 2 * wall * (self.width_m * (depth**2 + depth * opening + opening**2) + opening**3) / 12
        inner_radius = positive_part(self.corner_radius_m - wall)
        lost, kept = _corners_second_moment(depth, self.corner_radius_m), _corners_second_moment(opening, inner_radius)
        return sharp - lost + kept

    @property
    def polar_moment(self) -> Quantity:
        """Polar second moment of area, m4."""
        return self.second_moment + self.turned.second_moment

    @property
    def elastic_modulus(self) -> Quantity:
        """Elastic section modulus W = I / (h / 2), m3."""
        return self.second_moment / (self.depth_m / 2)

    @property
    def torsion_constant(self) -> Quantity:
        """Torsion constant of a thin wall, symbol J, m4.

        Bredt's 4 A^2 t / p of the wall's middle line, and what the wall has by itself, p t^3 / 3; EN 10219-2:2006,
        Annex B, has the same. A square tube whose wall is a tenth of its width is within a few per cent of the exact
        solution; sharp inside corners add a little that is left out. A square section does not warp, so that a clamped
        end hinders nothing (thin-walled theory); that of a rectangle does a little, and the clamp stiffens it.
        """
        wall = self.wall_m
        middle_radius = positive_part(self.corner_radius_m - wall / 2)
        enclosed = (self.width_m - wall) * (self.depth_m - wall) - (4 - pi) * middle_radius**2
        perimeter = 2 * (self.width_m + self.depth_m - 2 * wall) - (8 - 2 * pi) * middle_radius
        return 4 * enclosed**2 * wall / perimeter + perimeter * wall**3 / 3

    @property
    def shear_area(self) -> Quantity:
        """Area that stands for the section where a load along the depth shears it, m2: 5/12 of a thin square tube's.

        By the energy of the shear flow V S / I along the middle line of a thin wall, corners sharp.
        """
        width, depth = self.width_m - self.wall_m, self.depth_m - self.wall_m
        most = width * depth / 4 + depth**2 / 8  # S over the wall at the neutral axis
        energy = depth**2 * width**3 / 48 + most**2 * depth - most * depth**3 / 12 + depth**5 / 320
        return self.wall_m * (width * depth**2 / 2 + depth**3 / 6) ** 2 / (2 * energy)

    def mass_per_length(self, density: Quantity) -> Quantity:
        """Mass per unit length, symbol m in equation (1), kg/m, from kg/m3."""
        return density * self.area

    @property
    def _flat(self) -> tuple[Quantity, Quantity]:
        """Widths of the flat parts of flange and web, between rounded corners or the inside faces of neighbours, m."""
        corners = 2 * (self.wall_m + positive_part(self.corner_radius_m - self.wall_m))
        return self.width_m - corners, self.depth_m - corners

    def relative_slenderness(self, proof_strength: float) -> tuple[Quantity, ...]:
        """Relative slenderness beta / epsilon of the compressed flange and of the webs in bending.

        epsilon = sqrt(250 MPa / f_o) (Table 6.2); the stress gradient in the webs is that of the gross section.

        Args:
            proof_strength: f_o, Pa.

        Returns:
            Flange, beta = b / t, and web, beta = 0.40 b / t, each over epsilon; of a round tube nothing.
        """
        epsilon = (250e6 / proof_strength) ** 0.5
        flange, web = self._flat
        return flange / self.wall_m / epsilon, WEB_SLENDERNESS * (web / self.wall_m / epsilon)

    def effective_modulus(self, flange_factor: Quantity, web_factor: Quantity) -> Quantity:
        """Effective elastic section modulus W_eff in bending, for its compressed edge, clause 6.2.5.2.

        The compressed flange counts with thickness rho t about its mid-plane; this lowers the neutral axis; the webs
        count with their own reduced thickness from there to the compressed flange. Corners and everything in tension
        stay whole. One pass: the web is not reclassified for the lowered axis.

        Args:
            flange_factor: rho_c of the compressed flange.
            web_factor: rho_c of the webs.

        Returns:
            W_eff, m3; with both factors 1 the gross elastic modulus. It grows with each factor.
        """
        wall, (flange, web) = self.wall_m, self._flat
        flange_lost = (1 - flange_factor) * wall * flange
        flange_height = (self.depth_m - wall) / 2
        area_left = self.area - flange_lost
        axis = -flange_lost * flange_height / area_left

        depth = web / 2 - axis
        web_lost = 2 * (1 - web_factor) * wall * depth
        web_height = (web / 2 + axis) / 2
        area_left = area_left - web_lost
        axis = -(flange_lost * flange_height + web_lost * web_height) / area_left

        about_middle = (
            self.second_moment
            - flange_lost * flange_height**2
            - flange * wall**3 * (1 - flange_factor**3) / 12
            - web_lost * (web_height**2 + depth**2 / 12)
        )
        return (about_middle - area_left * axis**2) / (self.depth_m / 2 - axis)

    def bending_resistance(
        self, proof_strength: float, constants: tuple[float, float], factors: tuple[Quantity, Quantity] | None = None
    ) -> Quantity:
        """Design bending resistance M_c,Rd = W_eff f_o / gamma_M1, clause 6.2.5.1(2).

        Args:
            proof_strength: f_o, Pa.
            constants: C1 and C2 of the local buckling factor.
            factors: local buckling factors of flange and webs, instead of those that follow from the slenderness.

        Returns:
            Moment, N m.
        """
        own = (local_buckling_factor(value, constants) for value in self.relative_slenderness(proof_strength))
        return self.effective_modulus(*(factors or own)) * proof_strength / GAMMA_M1


@dataclass(frozen=True)
class RectangularTube(Tube):
    """A rectangular tube: the width is the side across the load, the depth that along it."""

    shape: ClassVar[str] = "rectangle"

    @property
    def sides(self) -> dict[str, Quantity]:  # noqa: D102
        return {"width": self.width_m, "depth": self.depth_m}

    @property
    def sizes(self) -> dict[str, Quantity]:  # noqa: D102
        return super().sizes | {"depth_m": float(f"{self.depth_m:.12g}")}

    @property
    def millimetres(self) -> str:  # noqa: D102
        return f"{1e3 * self.width_m:.4g} x {1e3 * self.depth_m:.4g} x {1e3 * self.wall_m:.3g}"


@dataclass(frozen=True)
class RoundTube(Tube):
    """A round tube: a square one whose corners have half its width, twisted exactly."""

    corner_radius_m: Quantity = field(init=False)
    shape: ClassVar[str] = "round"

    def __post_init__(self) -> None:
        """Set what the diameter says."""
        object.__setattr__(self, "corner_radius_m", self.width_m / 2)

    @property
    def millimetres(self) -> str:  # noqa: D102
        return f"round {super().millimetres}"

    @property
    def torsion_constant(self) -> Quantity:
        """Of the ring, exact: its polar moment pi / 32 (D^4 - d^4), m4."""
        return 2 * self.second_moment

    @property
    def shear_area(self) -> Quantity:
        """Half the area of a thin ring, m2."""
        return self.area / 2

    def relative_slenderness(self, proof_strength: float) -> tuple[Quantity, ...]:  # noqa: D102
        return ()

    def effective_modulus(self, *factors: Quantity) -> Quantity:
        """The elastic one, m3; it has no flat walls."""
        return self.elastic_modulus


def _corners_second_moment(side: Quantity, radius: Quantity) -> Quantity:
    """What rounding the four corners of a rectangle takes from its second moment.

    Each corner piece is a square of side r less a quarter disc of radius r about the inner vertex of that square; with
    h = side / 2 along the load, integrating y^2 over the difference gives the polynomial below.
    """
    half = side / 2
    return 4 * radius**2 * (
        (1 - pi / 4) * half**2 - (5 / 3 - pi / 2) * half * radius + (1 - 5 * pi / 16) * radius**2
    )  # fmt: skip


def at_corners(outer: Tube, inner: Tube) -> bool:
    """Whether the gap is at the corners of the inner tube: they come nearest to a round one around it."""
    return outer.shape == "round" and inner.shape != "round"


def clearances(outer: Tube, inner: Tube) -> tuple[Quantity, ...]:
    """Gaps between the inner tube, centred, and the inside of the outer one, m; negative where it does not fit.

    Returns:
        That along the load, per side, and then, where it may be another, that across. Between a tube with corners and
        the round one around it, it is the one at its corners in any direction, which a motion by d lessens by d at
        most. Corners of the outer tube's inside count as sharp.
    """
    across = (outer.width_m - 2 * outer.wall_m - inner.width_m) / 2
    if at_corners(outer, inner):
        radius = inner.corner_radius_m
        corner = ((inner.width_m / 2 - radius) ** 2 + (inner.depth_m / 2 - radius) ** 2) ** 0.5 + radius
        return (outer.width_m / 2 - outer.wall_m - corner,)
    if "rectangle" not in (outer.shape, inner.shape):
        return (across,)
    return (outer.depth_m - 2 * outer.wall_m - inner.depth_m) / 2, across


SHAPES = {shape.shape: shape for shape in (Tube, RectangularTube, RoundTube)}
"""Tubes by the name of their shape."""


def as_arrays(tubes: Sequence[Tube], shape: tuple[int, ...]) -> Tube:
    """Tubes of one shape as one whose sizes are arrays, of an array's shape."""
    import numpy as np

    given = [one.name for one in fields(tubes[0]) if one.init]
    sizes = {name: np.array([getattr(tube, name) for tube in tubes]).reshape(shape) for name in given}
    return type(tubes[0])(**sizes)


_DATA = Path(__file__).with_name("stock_sizes.toml")

SAME_SHARE = 1e-3
"""Within which a ratio of sides is that of a stock tube."""


@cache
def _stock() -> dict[str, tuple[Tube, ...]]:
    data = read_table(_DATA)
    sides = [
        (b, h, size["walls_m"])
        for size in data["rectangular_tube"]
        for b, h in permutations((size["width_m"], size["depth_m"]))
    ]
    found: dict[str, list[Tube]] = {
        "square": [Tube(size["width_m"], wall) for size in data["square_tube"] for wall in size["walls_m"]],
        "round": [RoundTube(size["width_m"], wall) for size in data["round_tube"] for wall in size["walls_m"]],
        "rectangle": [RectangularTube(b, wall, depth_over_width=h / b) for b, h, walls in sides for wall in walls],
    }
    assert found.keys() == SHAPES.keys()
    return {shape: tuple(sorted(tubes, key=lambda one: (one.width_m, one.wall_m))) for shape, tubes in found.items()}


def stock_tubes(shape: str = "square", depth_over_width: float | None = None) -> tuple[Tube, ...]:
    """Every stock tube of a shape, or of a ratio of sides too, by ascending width and then wall, in m."""
    ratio, tubes = depth_over_width, _stock()[shape]
    return tubes if ratio is None else tuple(t for t in tubes if abs(t.depth_over_width / ratio - 1) <= SAME_SHARE)
