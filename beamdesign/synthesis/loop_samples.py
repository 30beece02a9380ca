"""Loops sampled over frequency and end mass: what a search works on. Everything here is sampled and only proposes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import pi

import numpy as np
from flint import fmpq_poly

from beamdesign.controllers import SENSED, Sensed
from beamdesign.plant.linear import BilinearPlant, PairOver
from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import at_points
from beamdesign.synthesis.loop_limits import RELAXED_PEAK, ends

COARSE_HZ = np.concatenate(
    [np.geomspace(0.05, 5, 25), np.geomspace(5.3, 150, 130), np.geomspace(155, 1e3, 25), [3e3, 1e4, 1e5]]
)
FINE_HZ = np.concatenate(
    [
        np.geomspace(0.01, 0.98, 20),
        np.geomspace(1, 4.9, 80),
        np.geomspace(5, 60, 250),
        np.geomspace(61, 150, 60),
        np.geomspace(153, 1200, 60),
        np.geomspace(1300, 1e5, 10),
    ]
)
"""Fine where peaks may be sharp; far above everything, the law's effort still grows."""

MODES_HZ = np.geomspace(155.0, 700.0, 100)
"""Further samples of rigs with effects, among which may be a second mode."""


@dataclass(frozen=True)
class Samples:
    """Responses at n points, each divided by the plant's denominator without inner end mass there.

    [0] is without inner end mass, [1] what a kilogram of it adds. With K_k the law from each of p sensors,
    L = sum K_k control_k / plant, and x / F_d = (disturbance + sum K_k crossed_k) / plant / (1 + L), where
    plant = 1 + inner end mass times denominator.

    Attributes:
        frequency_Hz: (n,).
        row: (n,) number of the row of neighbouring frequencies, of one plant at one outer end mass, a point is on.
        denominator: (n,) what a kilogram inside adds to the denominator.
        control: (p, 2, n) current to what is sensed.
        disturbance: (2, n) force to displacement.
        crossed: (p, 2, n) what feedback of a sensor adds to that, see `beamdesign.plant.linear.Plant`.
        outer_end_mass: (n,) kg.
        relaxed: (n,) factor on the limit of sensitivity; where it is above one, nothing else is limited.
    """

    frequency_Hz: np.ndarray
    row: np.ndarray
    denominator: np.ndarray
    control: np.ndarray
    disturbance: np.ndarray
    crossed: np.ndarray
    outer_end_mass: np.ndarray
    relaxed: np.ndarray

    def joined(self, other: "Samples") -> "Samples":
        """With the points of another, in rows of their own."""
        whole = {name: np.concatenate([value, getattr(other, name)], axis=-1) for name, value in vars(self).items()}
        whole["row"] = np.append(self.row, other.row + self.row.max() + 1)
        return Samples(**whole)

    def at(self, inner: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Plant (n,), then control (p, n), disturbance (n,) and crossed (p, n) over it, with a mass inside (kg)."""
        plant = 1 + inner * self.denominator
        control = (self.control[:, 0] + inner * self.control[:, 1]) / plant
        crossed = (self.crossed[:, 0] + inner * self.crossed[:, 1]) / plant
        return plant, control, (self.disturbance[0] + inner * self.disturbance[1]) / plant, crossed

    def servo_off(self, inner: float) -> float:
        """Largest |x / F_d| (m/N) without a law, of all points that are to perform, with a mass inside (kg).

        Between neighbouring frequencies F_d / x is interpolated: of one mass on a spring it is quadratic in frequency.
        """
        without = self.at(inner)[2]
        size = np.where(self.relaxed == 1.0, np.abs(without), 0.0)
        k = int(size.argmax())
        near = np.arange(max(k - 2, 0), min(k + 3, len(size)))
        near = near[(self.row[near] == self.row[k]) & (size[near] > 0)]
        if k in (near[0], near[-1]):
            return float(size[k])
        at = self.frequency_Hz[near] / self.frequency_Hz[k] - 1
        scale = float(np.abs(at).max())
        terms = np.linalg.solve(np.vander(at / scale), size[k] / without[near])
        low, high = (float(self.frequency_Hz[i] / self.frequency_Hz[k]) - 1 for i in (k - 1, k + 1))
        between = np.linspace(low, high, _BETWEEN)
        return float(size[k] / min(1.0, np.abs(np.polyval(terms, between / scale)).min()))


_BETWEEN = 1001
"""How many frequencies are looked at about the highest point."""


def samples(
    plant: BilinearPlant,
    frequency_Hz: np.ndarray,
    outer_end_masses: Sequence[float],
    factor: float = 1.0,
    relaxed: float = 1.0,
) -> Samples:
    """A grid of frequencies at each of some outer end masses (kg), with the plant's gain times a factor."""
    masses, s = np.asarray(outer_end_masses, dtype=float)[:, None], 2j * pi * frequency_Hz

    def on_axis(polynomial: fmpq_poly) -> np.ndarray:
        return at_points(polynomial, s)

    def rows(pair: tuple[PairOver, PairOver]) -> list[np.ndarray]:
        """(masses, f) without and per kilogram of inner end mass."""
        (own, inner), (outer, both) = (map(on_axis, row) for row in pair)
        return [own + masses * outer, inner + masses * both]

    bare, added = rows(plant.denominator)

    def over(parts: Sequence[np.ndarray]) -> np.ndarray:
        return np.array([(part / bare).ravel() for part in parts])

    free = [[np.tile(on_axis(p), (len(masses), 1)) for p in pair] for pair in (plant.disturbance, *plant.crossed)]
    count = len(frequency_Hz)
    return Samples(
        np.tile(frequency_Hz, len(masses)),
        np.repeat(np.arange(len(masses)), count),
        (added / bare).ravel(),
        factor * np.array([over(rows(one)) for one in plant.control]),
        over(free[0]),
        factor * np.array([over(one) for one in free[1:]]),
        np.repeat(masses.ravel(), count),
        np.full(count * len(masses), relaxed),
    )


def rig_samples(
    members: Sequence[VertexModel],
    frequency_Hz: np.ndarray,
    outer_end_masses: Sequence[float],
    sensors: tuple[Sensed, ...] = SENSED[:1],
    relaxed: float = 1.0,
) -> Samples:
    """Samples of all members of a rig at the ends of their gains.

    Args:
        members: linear members of the rig.
        frequency_Hz: (f,) ascending.
        outer_end_masses: kg.
        sensors: of `beamdesign.controllers.SENSORS`.
        relaxed: factor on the limit of sensitivity of members that are to perform.
    """
    parts = [
        samples(rig.polynomials(sensors), frequency_Hz, outer_end_masses, factor, relaxed if performs else RELAXED_PEAK)
        for rig, factor, performs in ends(members)
    ]
    return reduce(Samples.joined, parts)
