"""Cost of a piece of work: wall and processor time, medians over repeats in this process."""

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time
from typing import TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Cost:
    """Medians over repeats of one piece of work.

    Attributes:
        wall_s: elapsed.
        cpu_s: of this process, over all its threads; the fairer one where other work shares the machine.
    """

    wall_s: float
    cpu_s: float

    def __truediv__(self, parts: float) -> "Cost":
        return Cost(self.wall_s / parts, self.cpu_s / parts)

    def __add__(self, other: "Cost") -> "Cost":
        return Cost(self.wall_s + other.wall_s, self.cpu_s + other.cpu_s)


def timed(work: Callable[[], Result], repeats: int, warm: bool = True) -> tuple[Cost, Result]:
    """Do the work `repeats` times, after once in vain where caches are to be warm; median cost and last result."""
    if warm:
        work()
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = perf_counter(), process_time()
        result = work()
        walls.append(perf_counter() - wall)
        cpus.append(process_time() - cpu)
    return Cost(median(walls), median(cpus)), result
