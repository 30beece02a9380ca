"""What a sweep is about to compute."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beamdesign.study.case import Case
from beamdesign.study.sweep_file import Sweep


@dataclass(frozen=True)
class Plan:
    """A sweep read from its file, with its base document.

    Attributes:
        path: of the sweep file.
        sweep: what it says.
        base: tables of the base document.
        cases: the cases that are known beforehand; of an adaptive method none.
        budget: how many there are at most.
        limit: as asked, None for all.
    """

    path: Path
    sweep: Sweep
    base: dict[str, Any]
    cases: tuple[Case, ...]
    budget: int
    limit: int | None = None
