"""What a beam's table says of its tube: shape and sizes, what cannot be, and whether one tube goes into another.

And what the tubes of a link are asked to keep beside its load: sizes, gaps, and factors against each failure.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import Field, model_serializer

from beamdesign import quantities as q
from beamdesign.records import Problem, Record, numbers, stated
from beamdesign.structure.section import SHAPES, RectangularTube, RoundTube, Tube, clearances

FIT_M = 1e-9
"""Least play of a tube inside another; what differs by less is the same size, rounded differently."""

LENGTHS_APART = 10.0
"""Largest ratio of the free lengths of beams that move side by side; beyond, one is in another unit."""

_RATIOS = q.range_of(q.DepthOverWidth)

DEPTHS = ("depth_m", "depth_over_width")
"""Keys of what only a rectangle has: of a tube that stands, and of one still to be sized."""


class Shaped(Record):
    """A beam whose tube is of some shape."""

    shape: Literal["square", "rectangle", "round"] = Field(
        "square", description="of the tube; a rectangle has its depth along the load, its width across it"
    )

    @property
    def tube(self) -> Tube | None:
        """Its tube, m; None where a size is missing."""
        return tube_of(self)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Walls fit in widths, free lengths in lengths; a rectangle has a depth, and a round tube no corners."""
        if (pair := numbers(table, "wall_m", "width_m")) and pair[0] >= pair[1] / 2 > 0:
            yield Problem("wall_m", f"{pair[0]} is not less than half the width, {pair[1] / 2}")
        if (pair := numbers(table, "free_length_m", "length_m")) and pair[0] > pair[1] > 0:
            yield Problem("free_length_m", f"{pair[0]} exceeds length_m, {pair[1]}")
        shape, (depth,) = table.get("shape", "square"), (key for key in DEPTHS if key in cls.model_fields)
        if shape == "rectangle" and table.get(depth) is None and (depth != "depth_m" or table.get("width_m")):
            yield Problem(depth, "missing: a rectangle has a depth along the load beside its width")
        if shape in ("square", "round") and table.get(depth) is not None:
            yield Problem(depth, f"only a rectangle has one; the shape is {shape!r}")
        tube = tube_of(table)
        if shape == "rectangle" and tube is not None and tube.wall_m >= tube.depth_m / 2 > 0:
            yield Problem("wall_m", f"{tube.wall_m} is not less than half the depth, {tube.depth_m / 2:.6g}")
        elif depth == "depth_m" and shape == "rectangle" and tube is not None and tube.depth_over_width not in _RATIOS:
            words = f"is {tube.depth_over_width:.4g} times the width, outside the plausible range {_RATIOS}"
            yield Problem(depth, words)
        if (pair := numbers(table, "corner_radius_m", "wall_m")) and 0 < pair[0] < pair[1]:
            yield Problem("corner_radius_m", f"outside radius {pair[0]} is less than the wall, {pair[1]}")
        for key in ("width_m", "depth_m"):
            if (pair := numbers(table, "corner_radius_m", key)) and pair[0] > pair[1] / 2 > 0:
                words = f"outside radius {pair[0]} exceeds half the {key.removesuffix('_m')}, {pair[1] / 2}"
                yield Problem("corner_radius_m", words)
        if shape == "round" and (pair := numbers(table, "corner_radius_m")) and pair[0] != 0:
            yield Problem("corner_radius_m", "a round tube has no corners; leave it out")

    @model_serializer(mode="wrap")
    def _square_where_nothing_is_said(self, handler: Any) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if (key, value) != ("shape", "square")}


def tube_of(beam: Any, wall_m: float | None = None) -> Tube | None:
    """The tube of a beam (record, table or a tube); None where a size is missing or no number, or the shape unknown.

    Args:
        beam: whose sizes are read.
        wall_m: what counts where it states no wall.
    """

    def figure(key: str, other: float | None = None) -> float | None:
        found = numbers({"beam": beam}, f"beam.{key}")
        return other if found is None else found[0]

    width, wall, radius = figure("width_m"), figure("wall_m", wall_m), figure("corner_radius_m", 0.0)
    shape = stated(beam, "shape", "square")
    kind = SHAPES.get(shape) if isinstance(shape, str) else None
    if width is None or wall is None or kind is None:
        return None
    if kind is RoundTube:
        return RoundTube(width, wall)
    if kind is Tube:
        return Tube(width, wall, radius)
    depth, ratio = figure("depth_m"), figure("depth_over_width")
    ratio = ratio if depth is None or width <= 0 else depth / width
    return None if ratio is None else RectangularTube(width, wall, radius, depth_over_width=ratio)


def gaps(outer: Any, inner: Any) -> tuple[float, ...] | None:
    """The `clearances` of two beams or tubes, m; None where a size is missing. Nobody needs to know the inner wall."""
    around, inside = tube_of(outer), tube_of(inner, wall_m=0.0)
    return None if around is None or inside is None else tuple(map(float, clearances(around, inside)))


def beams_that_do_not_fit(table: Mapping[str, Any]) -> Iterator[Problem]:
    """What is wrong between the beams of a table: the inner one goes inside the outer, and is about as long."""
    outer, inner = (table.get(name, {}) for name in ("outer_beam", "inner_beam"))
    play, around, inside = gaps(outer, inner), tube_of(outer), tube_of(inner, wall_m=0.0)
    if play and around and inside and min(play) < FIT_M / 2:
        opening = around.width_m - 2 * around.wall_m
        words = f"{inside.width_m} does not fit inside the outer beam, whose opening is {opening:.6g}"
        if not around.shape == inside.shape == "square":
            words = f"does not fit inside the outer beam: the gap per side would be {min(play):.4g} m"
        if opening > 0:
            yield Problem("inner_beam.width_m", words)
    pair = numbers(table, "inner_beam.free_length_m", "outer_beam.free_length_m")
    if pair and min(pair) > 0 and max(pair) > LENGTHS_APART * min(pair):
        words = f"is {pair[0]:g} m, more than a factor of {LENGTHS_APART:g} from the outer beam's {pair[1]:g} m"
        yield Problem("inner_beam.free_length_m", words)


class Sizes(Record):
    """What limits the sizes of the tubes."""

    least_wall_m: q.Wall = Field(0.002, description="thinnest wall that may be used")
    largest_width_m: q.Width = Field(0.2, description="widest tube that may be used")
    width_to_wall_at_most: q.Slenderness | None = Field(
        None, description="limit of b / t, beside the check of local buckling"
    )

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The thinnest wall fits into the widest tube."""
        pair = numbers(cls.whole(table), "least_wall_m", "largest_width_m")
        if pair and pair[0] >= pair[1] / 2 > 0:
            yield Problem("least_wall_m", f"{pair[0]} is not less than half of largest_width_m, {pair[1] / 2}")


class Clearance(Record):
    """Gap between the inner beam and the outer one's inside, per side."""

    assembly_m: q.Gap = Field(0.005, description="least gap before any load")
    under_load_m: q.Gap = Field(0.003, description="least gap left when the inner beam carries the load")


class Safety(Record):
    """Factors on the load against each failure."""

    strength: q.SafetyFactor = Field(2.0, description="factor against yield in bending")
    local_buckling: q.SafetyFactor = Field(1.5, description="factor against bending resistance of thin walls")


class SizedFor(Sizes, Clearance, Safety):
    """What the sections were chosen to keep, beside their load: sizes, gaps and factors of the study."""
