"""How much work a run of the comparisons takes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """Sizes of the grids and numbers of repeats.

    Attributes:
        repeats: of everything that takes milliseconds.
        sweeps: repeats of the margin sweep; what takes seconds is done once.
        sweep: outer end masses of the margin sweep.
        grid: outer end masses of the eigenvalue grid.
        kind: controller kind that is tuned.
        seeds: of the evolutionary search, one run each.
        generations: at most so many of that search.
        candidates: random ones from the tuner's box.
    """

    repeats: int = 15
    sweeps: int = 3
    sweep: int = 200
    grid: int = 2000
    kind: str = "lag"
    seeds: tuple[int, ...] = (0, 1, 2)
    generations: int = 1000
    candidates: int = 1000


QUICK = Effort(repeats=3, sweeps=1, sweep=50, kind="proportional", seeds=(0,), generations=40, candidates=60)
"""Enough to see every row, and what each method misses."""
