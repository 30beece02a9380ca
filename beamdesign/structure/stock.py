"""Stock sizes of tube, as data with what they are taken from in `stock_sizes.toml`."""

from functools import cache
from pathlib import Path

from beamdesign.records import Positive, Record, parse, read_table
from beamdesign.structure.section import SHAPES, RectangularTube, RoundTube, Tube

_DATA = Path(__file__).with_name("stock_sizes.toml")

SAME_SHARE = 1e-3
"""Within which a ratio of sides is that of a stock tube."""


class _Size(Record):
    width_m: Positive
    depth_m: Positive | None = None
    walls_m: tuple[Positive, ...]


class _StockList(Record):
    square_tube: tuple[_Size, ...]
    round_tube: tuple[_Size, ...]
    rectangular_tube: tuple[_Size, ...]


@cache
def _stock() -> dict[str, tuple[Tube, ...]]:
    data = parse(_StockList, read_table(_DATA), _DATA)
    lying = [(size, size.depth_m or size.width_m) for size in data.rectangular_tube]
    sides = [(b, h, size.walls_m) for size, side in lying for b, h in ((size.width_m, side), (side, size.width_m))]
    found: dict[str, list[Tube]] = {
        "square": [Tube(size.width_m, wall) for size in data.square_tube for wall in size.walls_m],
        "round": [RoundTube(size.width_m, wall) for size in data.round_tube for wall in size.walls_m],
        "rectangle": [RectangularTube(b, wall, depth_over_width=h / b) for b, h, walls in sides for wall in walls],
    }
    assert found.keys() == SHAPES.keys()
    return {shape: tuple(sorted(tubes, key=lambda one: (one.width_m, one.wall_m))) for shape, tubes in found.items()}


def stock_tubes(shape: str = "square", depth_over_width: float | None = None) -> tuple[Tube, ...]:
    """Every stock tube of a shape, or of a ratio of sides too, by ascending width and then wall, in m."""
    ratio, tubes = depth_over_width, _stock()[shape]
    return tubes if ratio is None else tuple(t for t in tubes if abs(t.depth_over_width / ratio - 1) <= SAME_SHARE)
