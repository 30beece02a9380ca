"""Samples of all loops of a rig: over frequency, at the ends and in the middle of the range of outer end mass."""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from beamdesign.design.loop_search import member_grid
from beamdesign.design.loop_set import LOOSER_PEAK, ends
from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.sampled_loops import Samples, samples
from beamdesign.design.worst_samples import worst_samples
from beamdesign.linear import LinearRig
from beamdesign.members import BilinearPlant, Member, bilinear_plant
from beamdesign.prototype import Goal

FREQUENCIES_HZ = np.concatenate(
    [
        np.geomspace(0.01, 4.9, 60),
        np.geomspace(5.0, 150.0, 380),
        np.geomspace(153.0, 1200.0, 70),
        np.geomspace(1300, 1e5, 12),
    ]
)
"""Of the samples: fine where peaks may be sharp; far above everything, the controller's effort still grows."""

MODES_HZ = np.geomspace(155.0, 700.0, 100)
"""Further samples of rigs with effects, among which may be a second mode."""


def sampled_masses(masses_kg: tuple[float, float]) -> np.ndarray:
    """Outer end masses of the samples, kg."""
    return np.unique(np.linspace(*masses_kg, 3))


def plants_of(rig: LinearRig, members: Sequence[Member]) -> list[tuple[BilinearPlant, float, bool]]:
    """Plants, factors on their gain and whether they are to perform, of a rig or of its members where it has any."""
    if not members:
        return [(bilinear_plant(rig), 1.0, True)]
    return [(bilinear_plant(one), factor, performs) for one, factor, performs in ends(members)]


def rig_samples(
    rig: LinearRig,
    members: Sequence[Member],
    goal: Goal,
    masses_kg: tuple[float, float],
    spread: RigSpread | None = None,
) -> Samples:
    """Samples of a rig, of its members where it has effects, and of the rigs it may turn out to be.

    Args:
        rig: without effects.
        members: linear members of the rig with its effects; none where it has none.
        goal: whose frequency the limit of loop gain begins at is among the samples.
        masses_kg: range of outer end mass.
        spread: how far the rig may be off; none: not at all.
    """
    masses = sampled_masses(masses_kg).tolist()
    frequencies = np.union1d(FREQUENCIES_HZ, [goal.loop_gain_from_Hz])
    if members:
        frequencies = np.union1d(frequencies, MODES_HZ)

    def sampled(rig: LinearRig, members: Sequence[Member]) -> Samples:
        parts = [
            samples(member_grid(plant, factor, frequencies), masses, 1.0 if performs else LOOSER_PEAK)
            for plant, factor, performs in plants_of(rig, members)
        ]
        return reduce(Samples.joined, parts)

    nominal = sampled(rig, members)
    return nominal if spread is None else worst_samples(nominal, spread, sampled)
