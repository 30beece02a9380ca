"""A search for a law that goes on with its best start alone: what is found is proved as ever, in half of the time."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import pytest

from beamdesign.synthesis import tuning
from beamdesign.synthesis.law_task import Effort, Search


@contextmanager
def best_start_alone() -> Iterator[None]:
    """`tune` refines and proves one start of several; not for kinds of synthesis, which state how much they try."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "Search", partial(Search, effort=Effort(starts=1, candidates=1)))
        yield
