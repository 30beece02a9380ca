"""Rigs that a prototype may turn out to be: its figures off by so many standard deviations of its tolerances."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beamdesign.parameters import PARAMETERS, SIGMAS, TOLERANCES, rows_of
from beamdesign.plant.members import VertexModel, served
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure.lumped import CHANGEABLE, with_figures

_CUT = 4.0
_DIGITS = 3
"""To which a deviation is rounded: a thousandth of a standard deviation."""


class Cut(NamedTuple):
    """A rig that is off, at one outer end mass, as something that limits are held on.

    Attributes:
        z: by how many standard deviations each figure is off.
        outer_end_mass_kg: the mass.
        frequency_Hz: about which it is sampled more closely.
    """

    z: tuple[float, ...]
    outer_end_mass_kg: float
    frequency_Hz: float


@dataclass(frozen=True)
class RigSpread:
    """What a prototype may turn out to be: a box of figures, each off by so many standard deviations at once.

    Attributes:
        prototype: nominal.
        largest_outer_kg: largest outer end mass, whose weight is the load of effects that depend on it.
        deviations: relative standard deviation by figure, as in `beamdesign.structure.lumped`; d of them.
        sigmas: how far the figures are off, in standard deviations.
        stage: payloads of the law that serves them and all payloads, as of `beamdesign.plant.members.served`.
    """

    prototype: Prototype
    largest_outer_kg: float
    deviations: Mapping[str, float]
    sigmas: float
    stage: tuple[tuple[float, float], tuple[float, float]] | None = None

    def rig(self, z: np.ndarray) -> Prototype:
        """The prototype with its figures off by (d,) standard deviations."""
        return with_figures(self.prototype, self.factors(z))

    def factors(self, z: np.ndarray) -> dict[str, float]:
        """What the figures are multiplied by, those that change."""
        pairs = zip(z, self.deviations.items(), strict=True)
        return {name: 1 + float(value) * size for value, (name, size) in pairs if value}

    def off(self, factors: Mapping[str, float]) -> np.ndarray:
        """(d,) standard deviations of figures that are multiplied by these, those left out by one."""
        return np.round([(factors.get(name, 1.0) - 1) / size for name, size in self.deviations.items()], _DIGITS)

    def members(self, z: np.ndarray) -> tuple[VertexModel, ...]:
        """Linear members that a law has to serve of the prototype with its figures off by (d,)."""
        return served(self.rig(z), self.largest_outer_kg, self.stage)

    def drawn(self, count: int, seed: int) -> list[np.ndarray]:
        """Deviations (d,) of rigs drawn at random: normal, cut off at four."""
        normal = np.random.default_rng(seed).standard_normal((count, len(self.deviations)))
        return list(np.round(np.clip(normal, -_CUT, _CUT), _DIGITS))


def rig_spread(prototype: Prototype, largest_outer_kg: float, sigmas: float = SIGMAS) -> RigSpread:
    """The rigs within so many standard deviations of the prototype's `[tolerance]`.

    Tolerances of end masses are left out: the outer one is a range of its own, the inner one is weighed.

    Raises:
        InputError: where no figure has a tolerance, or one could reach zero.
        ValueError: for sigmas that are not positive.
    """
    if not sigmas > 0:
        raise ValueError("robust against nothing: sigmas must be positive")
    lacks = PARAMETERS.keys() - rows_of(type(prototype.actuator)).keys()
    lacks |= {"filter_frequency"} if prototype.sensor.filter_Hz is None else set()
    every = {name: getattr(prototype.tolerance, TOLERANCES[name]) for name in CHANGEABLE if name in TOLERANCES}
    for beam in ("outer", "inner"):  # a dashpot 2 zeta sqrt(K M) is off where K and M are
        own, stiffness, mass = (every[f"{beam}_{figure}"] for figure in ("damping", "stiffness", "mass"))
        every[f"{beam}_damping"] = own or (stiffness + mass) / 2
    deviations = {
        name: size for name, size in every.items() if size and name not in lacks and not name.endswith("end_mass")
    }
    if not deviations:
        raise InputError("tolerance", [Problem("tolerance", "no figure has a tolerance: nothing to be robust against")])
    if wide := [name for name, size in deviations.items() if sigmas * size >= 1]:
        reason = "{:g} standard deviations of {:g} reach zero"
        problems = [Problem(TOLERANCES[name], reason.format(sigmas, deviations[name])) for name in wide]
        raise InputError("tolerance", problems)
    return RigSpread(prototype, largest_outer_kg, deviations, sigmas)
