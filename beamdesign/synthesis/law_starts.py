"""Where a search for a law begins: seeds of a kind, what differential evolution finds about them, more mass inside."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.plant.assembly import most_inside_kg
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_samples import Design
from beamdesign.time_limit import over

_FAR = 7.0
"""By how much (logarithm) a gain is by far below one that is stable."""

_FEW = 3
"""Variables of a law among which differential evolution finds its way in few rounds."""

_ABOUT_GAIN, _ABOUT = (-2.0, 6.0), (-3.0, 3.0)
"""How far (logarithm) it looks about a seed, whose gain is low, and about its breaks."""

_POPULATION = 8
"""Designs of a round for every variable."""

_PRICE = 40.0
"""Of a violation there: at the usual one a loop of twice the bandwidth outweighs what keeps the limits, with a peak
sensitivity that is a tenth too large and that no refinement mends."""

_MUCH = 0.3
"""Share of the most mass inside that is much to begin with."""

_MORE = (0.6, 1.0)
"""Such shares that are tried where that led nowhere."""


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


def widely(task: Search, starts: Sequence[Design]) -> list[Design]:
    """The best design that differential evolution finds about starts of a law of few variables; none is not stable.

    What goes uphill from a seed ends on whatever hill that stands on: next to a cylinder in which nothing leaks at a
    lag of 1.6/22 Hz that has 0.66 Hz, where one of 11/310 Hz has 1.56.

    R. Storn and K. Price, Journal of Global Optimization 11 (1997) 341.
    """
    from scipy.optimize import differential_evolution

    rounds, inner_kg = task.effort.wide, np.array(task.inner_kg)
    if not rounds or over() or (form := starts[0].form).size > _FEW or not form.gain_first:
        return []
    first = min(starts, key=lambda one: one.variables[0])
    about = first.variables[: form.size, None] + np.array([_ABOUT_GAIN, *[_ABOUT] * (form.size - 1)])
    bounds = [*np.clip(about, form.lower[:, None], form.upper[:, None]), inner_kg]

    def design(variables: np.ndarray) -> Design:
        return replace(first, variables=np.append(variables, first.variables[form.size + 1 :]))

    found = differential_evolution(
        lambda variables: -task.worth(task.points, design(variables), _PRICE), bounds, rng=0, init="sobol",
        polish=False, maxiter=rounds, popsize=_POPULATION, tol=0.0, callback=lambda *_, **__: over(),
    )  # fmt: skip
    return [design(found.x)] if found.fun < 0 else []


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
