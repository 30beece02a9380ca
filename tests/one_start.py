"""Searches that go on with their best start alone: what is found is proved as ever, in half of the time."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import pytest

from beamdesign.synthesis import codesign, tuning
from beamdesign.synthesis.law_task import Effort, Search


@contextmanager
def best_start_alone() -> Iterator[None]:
    """`tune` and `codesign` refine and prove one start of several; kinds of synthesis state how much they try."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "Search", partial(Search, effort=Effort(wide=0, starts=1, refined=1, candidates=1)))
        patch.setattr(codesign, "SIZED_EFFORT", replace(codesign.SIZED_EFFORT, starts=1, candidates=1))
        yield
