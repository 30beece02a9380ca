"""Where a search for a law begins: seeds of a kind, what differential evolution finds about them, more mass inside."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.plant.assembly import most_inside_kg
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_samples import Design

_FAR = 7.0
"""By how much (logarithm) a gain is by far below one that is stable."""

_MUCH = 0.3
"""Share of the most mass inside that is much to begin with."""

_MORE = (0.6, 1.0)
"""Such shares that are tried where that led nowhere."""

_FEW = 3
"""Variables of a law that differential evolution finds its way among in few rounds."""

_ABOUT = np.array([[-2.0, 6.0], [-3.0, 3.0]])
"""How far (logarithm) it looks about a seed, whose gain is low, and about its breaks."""

_POPULATION = 8
"""Designs of each round for every variable."""


def from_seeds(task: Search, seeds: Sequence[Controller]) -> list[Design]:
    """Seeds of a kind with little and with much mass inside, their gains lowered until the loops are stable.

    Where they are so by far, as with a motor, whose current is of another order than a valve's, the gain is the best.
    Of a range that is not the usual one, what is much in that is tried as well.
    """
    (least, most), found = task.inner_kg, []
    usual = most_inside_kg(task.members[0].rig.figures, task.masses_kg[1])
    much = {min(max(least, _MUCH * usual), most), least + _MUCH * (most - least)}
    for seed in seeds:
        for inner in sorted({least, *much}):
            if (sought_from := task.sought_form(seed)) is None:
                continue
            design = Design(sought_from[0], np.concatenate([sought_from[1], [inner], task.start]))
            while not task.settled(design) and design.variables[0] > design.form.lower[0]:
                design = design.louder(-0.5)
            if design.form.gain_first and task.settled(design.louder(_FAR)):
                steps = np.arange(0.0, design.form.upper[0] - design.variables[0], 0.5)
                design = max(map(design.louder, steps), key=lambda one: task.worth(task.points, one))
            found.append(design)
    return found


def with_more_inside(task: Search, starts: Sequence[Design]) -> list[Design]:
    """Those of the starts that have most mass inside with more of it, as far as there may be more."""
    (least, most), found = task.inner_kg, []
    heaviest = max((one.inner_end_mass for one in starts), default=most)
    for one in (start for start in starts if start.inner_end_mass == heaviest):
        for inner in (least + much * (most - least) for much in _MORE):
            heavier = one.variables.copy()
            heavier[one.form.size] = inner
            found += [calmed(task, replace(one, variables=heavier))] if inner > heaviest else []
    return found


def calmed(task: Search, design: Design) -> Design:
    """A design whose gain, where it has one, is lowered until the loops of all rigs are stable."""
    while design.form.gain_first and not task.settled(design) and design.variables[0] > design.form.lower[0]:
        design = design.louder(-0.2)
    return design
