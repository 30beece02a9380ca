"""Searches that go on with their best start alone, or with less: what is found is proved as ever.

And reports without pictures.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import inf

import pytest

from beamdesign.proofs import box_member
from beamdesign.synthesis import codesign, refinement, tuning
from beamdesign.synthesis.law_task import Effort, Search


@contextmanager
def short_climbs() -> Iterator[None]:
    """The worst member of a box is sought among few, in few turns: what is proved of all is proved as ever."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(box_member, "_CLIMBING", 5)
        patch.setattr(box_member, "_TURNS", 2)
        yield


@contextmanager
def best_start_alone() -> Iterator[None]:
    """`tune` and `codesign` refine and prove one start of several; kinds of synthesis state how much they try."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "Search", partial(Search, effort=Effort(wide=0, starts=1, refined=1, candidates=1)))
        patch.setattr(codesign, "SIZED_EFFORT", replace(codesign.SIZED_EFFORT, starts=1, candidates=1))
        yield


@contextmanager
def least_effort() -> Iterator[None]:
    """Beside that, a refinement keeps the limits at fewer points at once, and the worst rigs are sought less far."""
    with pytest.MonkeyPatch.context() as patch, best_start_alone(), short_climbs():
        patch.setattr(refinement, "_EVERY", 2 * refinement._EVERY)
        patch.setattr(refinement, "_WORST", {kind: count // 2 for kind, count in refinement._WORST.items()})
        yield


@contextmanager
def captions_alone() -> Iterator[None]:
    """Reports without the pictures, which take as long to draw as what they show."""
    from beamdesign.build import result_folder
    from beamdesign.report import figures, gap_folder
    from beamdesign.report.page import Picture

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "STEP", inf)  # of a root locus, of which most of the time is spent on its shape
        for pages in (result_folder, gap_folder):
            patch.setattr(pages, "in_page", lambda figure, name, caption, **given: Picture("", "", caption, name))
        yield
