"""Stock sizes of square tube, as data with what they are taken from in `stock_sizes.toml`."""

from functools import cache
from pathlib import Path

from beamdesign.records import Positive, Record, parse, read_table
from beamdesign.structure.section import SquareTube

_DATA = Path(__file__).with_name("stock_sizes.toml")


class _Size(Record):
    width_m: Positive
    walls_m: tuple[Positive, ...]


class _StockList(Record):
    square_tube: tuple[_Size, ...]


@cache
def stock_tubes() -> tuple[SquareTube, ...]:
    """Every stock tube, by ascending width and then wall, in m."""
    sizes = parse(_StockList, read_table(_DATA), _DATA).square_tube
    return tuple(sorted(SquareTube(size.width_m, wall) for size in sizes for wall in size.walls_m))
