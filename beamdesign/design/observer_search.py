"""Laws to polish for several sensors: synthesised by Riccati equations or matrix inequalities, or given.

Weights are searched for a synthesis that serves the whole range of payloads; its law is reduced to an order that can be
realised. What is then polished are its entries themselves: the structure stays that of the observer, the figures are no
longer optimal by any weights.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beamdesign.controllers import Controller, Sensed
from beamdesign.controllers.block_form import block_form
from beamdesign.design.law_search import Effort, Found, Search, Told, sampled_masses, search
from beamdesign.design.loop_samples import COARSE_HZ, Samples, rig_samples
from beamdesign.design.lqg import lqg
from beamdesign.design.state_space import StateSpace
from beamdesign.design.weight_search import Proposal, WeightSearch, least_norm

SYNTHESES = ("lqg", "hinf")
"""Kinds of synthesis."""

EFFORT = Effort(polished=2, candidates=1)
ADDED_SENSORS_EFFORT = Effort(polished=1, candidates=1)

_LMI_SEARCH, _LMI_STARTS = 6, 3
"""Evaluations of the search for weights with matrix inequalities, and from how many weights."""

Given = tuple[Controller, float]
"""A law to begin with, and the mass inside, kg."""


def search_observer(
    task: Search, kind: str | None, starts: Sequence[Given] = (), told: Told = lambda share, text: None
) -> Found:
    """Find the largest guaranteed bandwidth of a law given by matrices.

    Args:
        task: what is asked; its sensors are those of the law.
        kind: one of `SYNTHESES`: how laws to polish are synthesised; None for the starts alone.
        starts: further laws to polish, with these sensors or fewer; others than linear ones are passed over.
        told: the share done and what is being done.
    """
    if len(task.sensors) > 1 and any(member.gain.low != member.gain.high for member in task.members):
        why = "with added sensors no tuner serves the range of gains that an effect of this prototype asks for"
        return Found(None, (), 0, why)
    given = [one for one in starts if one[0].observer or one[0].sections]
    if len(task.sensors) > 1 and kind and not given:
        # What the displacement alone reaches is where an added sensor begins.
        first = replace(task, sensors=task.sensors[:1], effort=replace(task.effort, polished=EFFORT.polished))
        alone = search_observer(first, kind, (), lambda share, text: told(0.4 * share, f"displacement alone, {text}"))
        if alone.proved is not None:
            given = [(alone.proved.controller, alone.proved.inner_end_mass_kg)]
    laws = [(StateSpace(*_matrices(law, task.sensors)), inner) for law, inner in given]
    if kind:
        laws += [(one.law, one.inner_end_mass) for one in _proposals(task, kind, told)[: task.effort.synthesised]]
    worth = _worth(task.points)
    opened = [
        (form[0], np.append(form[1], inner))
        for law, inner in laws
        if len(law.a) <= 2 * task.effort.blocks
        and (form := block_form(task.sensors, law.a, law.b, law.c, law.d, task.effort.blocks, worth)) is not None
    ]
    if not opened:
        return Found(None, (), 0, "no weights led to a stable controller with a stable loop")
    return search(task, opened, told=lambda share, text: told(0.4 + 0.6 * share, text))


def _proposals(task: Search, kind: str, told: Told) -> list[Proposal]:
    """Laws that were synthesised, the best first."""
    told(0.0, "searching weights")
    frequencies = np.union1d(COARSE_HZ, [task.goal.loop_gain_from_Hz])
    points = rig_samples(task.members, frequencies, sampled_masses(task.masses_kg), task.sensors)
    rig = next(member.rig for member in task.members if member.performance is not None)
    weights = WeightSearch(
        rig, task.sensors, points, task.goal, task.masses_kg, task.inner_kg[1], 2 * task.effort.blocks
    )
    found = weights.sampled(task.effort.weights)
    if found:
        told(0.1, "improving weights")
        found = [weights.improved(found[0], lqg, task.effort.evaluations), *found]
    if kind == "lqg" or not found:
        return found
    solved = []
    for k, start in enumerate(found[:_LMI_STARTS]):
        told(0.2 + 0.1 * k / _LMI_STARTS, f"matrix inequalities {k + 1} of {_LMI_STARTS}")
        one = weights.proposal(start.variables, least_norm)
        if one is not None:
            solved.append(one)
    if solved:
        solved.sort(key=lambda one: one.cost)
        told(0.3, "improving weights")
        solved.insert(0, weights.improved(solved[0], least_norm, _LMI_SEARCH))
    return solved


def _worth(points: Samples) -> np.ndarray:
    """Gains through each sensor, over that through the first, that make the same loop gain about 10 Hz, (p,)."""
    near = (points.frequency_Hz > 5) & (points.frequency_Hz < 20)
    size = np.median(np.abs(points.control[:, 0, near]), axis=1)
    return np.asarray(size[0] / size)


def _matrices(law: Controller, sensors: tuple[Sensed, ...]) -> tuple[np.ndarray, ...]:
    """The matrices of a law with fewer sensors, which does nothing yet with the others."""
    model = law.control_model()
    a, b_own, c, d_own = (np.asarray(part) for part in (model.A, model.B, model.C, model.D))
    b, d = np.zeros((len(a), len(sensors))), np.zeros((1, len(sensors)))
    places = [sensors.index(name) for name in law.senses]
    b[:, places], d[:, places] = b_own, d_own
    return a, b, c, d
