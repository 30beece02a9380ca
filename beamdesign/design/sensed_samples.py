"""What an added sensor sees: state space and sampled responses of a rig whose controller reads several sensors.

The inner tip's displacement and the load pressure are states of the rig, or sums of them. Everything here is in floats
and only proposes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from beamdesign.controllers import SENSED, Sensed
from beamdesign.linear import LinearModel
from beamdesign.rig.linearised import SEEN


@dataclass(frozen=True)
class SensedModel:
    """x' = a x + b u, y = c x at one pair of end masses, SI.

    Attributes:
        a: (n, n).
        b: (n, 2) of tip force (N) and current (A).
        c: (1 + p, n): the tip's displacement (m), then what the p sensors give (V, m, Pa).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def responses(self, frequency_Hz: np.ndarray) -> np.ndarray:
        """(f, 1 + p, 2) from inputs to outputs, complex."""
        s = 2j * pi * np.asarray(frequency_Hz, dtype=float)
        inside = np.linalg.solve(s[:, None, None] * np.eye(len(self.a)) - self.a, self.b[None].astype(complex))
        return np.asarray(self.c @ inside)


def sensed_model(
    rig: LinearModel, outer_end_mass: float, inner_end_mass: float, sensors: Sequence[Sensed] = SENSED[:1]
) -> SensedModel:
    """State space of a rig with its sensors.

    Args:
        rig: of a prototype, or of one of its linear members.
        outer_end_mass: kg.
        inner_end_mass: kg.
        sensors: of `beamdesign.controllers.SENSED`, the displacement first.

    Raises:
        ValueError: without the displacement in the first place.
    """
    a, b, c = rig.matrices(outer_end_mass, inner_end_mass)
    if not sensors or sensors[0] != SENSED[0]:
        raise ValueError("the first sensor is that of the outer tip's displacement")
    return SensedModel(a, b, c[[0, 1, *(SEEN.index(name) for name in sensors[1:])]])


@dataclass(frozen=True)
class SensedSamples:
    """Responses at n points, each divided by the plant's denominator without inner end mass there.

    [0] is without inner end mass, [1] what a kilogram of it adds. With K_k the controller's transfer functions,
    L = sum K_k control_k / plant, and x / F_d = (disturbance + sum K_k minor_k) / plant / (1 + L), where
    plant = 1 + inner end mass times denominator.

    Attributes:
        frequency_Hz: (n,).
        row: (n,) number of the row of neighbouring frequencies, of one plant at one outer end mass, a point is on.
        denominator: (n,) what a kilogram inside adds to the denominator.
        control: (p, 2, n) current to what a sensor gives.
        disturbance: (2, n) force to displacement.
        minor: (p, 2, n) what feedback of a sensor adds to that; zero for the displacement itself.
        looser: (n,) factor on the limit of sensitivity; where it is above one, nothing else is limited.
    """

    frequency_Hz: np.ndarray
    row: np.ndarray
    denominator: np.ndarray
    control: np.ndarray
    disturbance: np.ndarray
    minor: np.ndarray
    looser: np.ndarray

    def joined(self, other: "SensedSamples") -> "SensedSamples":
        """With the points of another, in rows of their own."""
        return SensedSamples(
            np.append(self.frequency_Hz, other.frequency_Hz),
            np.append(self.row, other.row + self.row.max() + 1),
            np.append(self.denominator, other.denominator),
            np.concatenate([self.control, other.control], axis=2),
            np.concatenate([self.disturbance, other.disturbance], axis=1),
            np.concatenate([self.minor, other.minor], axis=2),
            np.append(self.looser, other.looser),
        )


def sensed_samples(
    rig: LinearModel,
    sensors: Sequence[Sensed],
    frequency_Hz: np.ndarray,
    outer_end_masses: Sequence[float],
    factor: float = 1.0,
    looser: float = 1.0,
) -> SensedSamples:
    """A grid of frequencies at each of some outer end masses (kg), for any inner end mass.

    Args:
        rig: of a prototype, or of one of its linear members.
        sensors: of `beamdesign.controllers.SENSED`.
        frequency_Hz: (f,) ascending.
        outer_end_masses: kg.
        factor: on the gain from current.
        looser: see `SensedSamples`.
    """
    parts = [_at_mass(rig, sensors, frequency_Hz, mass, factor) for mass in outer_end_masses]
    denominator, control, disturbance, minor = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(4))
    count = len(frequency_Hz)
    return SensedSamples(
        np.tile(frequency_Hz, len(parts)),
        np.repeat(np.arange(len(parts)), count),
        denominator,
        control,
        disturbance,
        minor,
        np.full(count * len(parts), looser),
    )


def _at_mass(
    rig: LinearModel, sensors: Sequence[Sensed], frequency_Hz: np.ndarray, mass: float, factor: float
) -> tuple[np.ndarray, ...]:
    """Denominator, control, disturbance and minors at one outer end mass, from two inner ones: each is affine."""
    s = 2j * pi * frequency_Hz
    found = []
    for inner in (0.0, 1.0):
        plant = sensed_model(rig, mass, inner, sensors)
        g = plant.responses(frequency_Hz)
        g[:, :, 1] *= factor
        # Scaled to one at zero frequency, where end masses have no part.
        denominator = np.prod(1 - s[:, None] / np.linalg.eigvals(plant.a), axis=1)
        minors = g[:, :1, 0] * g[:, 1:, 1] - g[:, :1, 1] * g[:, 1:, 0]
        minors[:, 0] = 0.0  # the tip's own displacement, filtered: both outputs see one thing
        found.append((denominator, *(denominator * part.T for part in (g[:, 1:, 1], g[:, 0, 0], minors))))
    bare, one = found
    by = bare[0]
    both = [np.stack([now, then - now], axis=-2) / by for now, then in zip(bare[1:], one[1:], strict=True)]
    return (one[0] - bare[0]) / by, *both
