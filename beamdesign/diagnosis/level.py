"""How often a rig without a gap looks as much as if it had one: a test whose level holds in finite samples.

The probability that a diagnosis gives to no gap is ranked among those of rigs without one, drawn and diagnosed by the
same program (`studies/benchmarks/null_scores.py`, their scores in `nulls.toml`). If a rig without a gap is drawn like
these, every rank is as probable as any other, so that `chance` is at most a level with at most that probability: split
conformal prediction (V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random World, Springer 2005,
section 2.2). As the score is the last that a diagnosis says, nothing has to be corrected for how many causes and places
were looked at. Nothing is promised of rigs that are unlike those.
"""

import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

LEVEL = 0.02
"""Share of rigs without a gap that may be said to have one."""


@cache
def null_scores() -> tuple[float, ...]:
    """Probability of no gap that each of the rigs without one was given, least first."""
    path = Path(__file__).with_name("nulls.toml")
    return tuple(sorted(tomllib.loads(path.read_text(encoding="utf-8"))["no_gap"]))


def chance(no_gap: float, among: Sequence[float] | None = None) -> float:
    """Probability that a rig without a gap is given so little probability of having none (a conformal p-value).

    Args:
        no_gap: probability that a diagnosis gives to it.
        among: the same of rigs without a gap; those of `null_scores` if None.
    """
    scores = null_scores() if among is None else among
    return (1 + sum(score <= no_gap for score in scores)) / (1 + len(scores))
