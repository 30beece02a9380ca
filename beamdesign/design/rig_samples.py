"""Samples of all loops of a rig: over frequency, at the ends and in the middle of the range of outer end mass."""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from beamdesign.design.loop_search import grid_plant
from beamdesign.design.loop_set import LOOSER_PEAK, ends
from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.sampled_loops import Samples, samples
from beamdesign.design.worst_samples import worst_samples
from beamdesign.linear import BilinearPlant
from beamdesign.members import Member
from beamdesign.prototype import Goal
from beamdesign.records import InputError

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


def plants_of(members: Sequence[Member]) -> list[tuple[BilinearPlant, float, bool]]:
    """Plants, factors on their gain and whether they are to perform, of the members of a rig.

    Raises:
        InputError: where the sensor rides on the mount, for which there are no samples.
    """
    if any(member.rig.sensor_rides for member in members):
        why = "a sensor that turns with the mount is tuned for with a controller of few parameters only, as a lag"
        raise InputError("prototype", [("effects.mount_compliance.sensor_share", why)])
    return [(one.polynomials(), factor, performs) for one, factor, performs in ends(members)]


def rig_samples(
    members: Sequence[Member],
    goal: Goal,
    masses_kg: tuple[float, float],
    spread: RigSpread | None = None,
) -> Samples:
    """Samples of all members of a rig, and of the rigs it may turn out to be.

    Args:
        members: linear members of the rig.
        goal: whose frequency the limit of loop gain begins at is among the samples.
        masses_kg: range of outer end mass.
        spread: how far the rig may be off; none: not at all.
    """
    masses = sampled_masses(masses_kg).tolist()
    frequencies = np.union1d(FREQUENCIES_HZ, [goal.loop_gain_from_Hz])
    if any(member.rig.effects for member in members):
        frequencies = np.union1d(frequencies, MODES_HZ)

    def sampled(members: Sequence[Member]) -> Samples:
        parts = [
            samples(grid_plant(plant, frequencies, factor), masses, 1.0 if performs else LOOSER_PEAK)
            for plant, factor, performs in plants_of(members)
        ]
        return reduce(Samples.joined, parts)

    nominal = sampled(members)
    return nominal if spread is None else worst_samples(nominal, spread, sampled)
