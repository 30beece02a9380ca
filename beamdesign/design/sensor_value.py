"""What each added sensor buys: the bandwidth proved with it, each set of sensors grown from those that it contains."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from beamdesign.design.observer_tuning import TunedObserver, rounded, tune_observer
from beamdesign.linear import linear_rig
from beamdesign.members import family
from beamdesign.observer import SENSED, Observer, Sensed
from beamdesign.prototype import Prototype, Structured

SETS: tuple[tuple[Sensed, ...], ...] = (SENSED[:1], SENSED[:2], (SENSED[0], SENSED[2]), SENSED)
"""The displacement alone, with the inner tip's displacement, with the load pressure, with both."""


@dataclass(frozen=True)
class SensorRow:
    """What one set of sensors reaches.

    Attributes:
        sensors: what the controller reads.
        outer_end_mass_kg: range of the payload.
        found: the tuning, with what was proved.
    """

    sensors: tuple[Sensed, ...]
    outer_end_mass_kg: tuple[float, float]
    found: TunedObserver

    @property
    def bandwidth_Hz(self) -> float:
        """Proved; 0 where nothing was."""
        return self.found.proved.bandwidth_Hz if self.found.proved else 0.0


def sensor_rows(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str | None = None,
    sets: Sequence[tuple[Sensed, ...]] = SETS,
    largest_inner_end_mass_kg: float = 6.0,
    told: Callable[[float, str], None] = lambda share, text: None,
) -> Iterator[SensorRow]:
    """Tune for each set of sensors in turn, from what the smaller sets reached.

    Args:
        prototype: its own controller, where it is structured or an observer, is one more start.
        outer_end_mass_kg: range of the guarantee.
        kind: of synthesis, to start from that as well; None for the starts alone.
        sets: of sensors, each after those that it contains.
        largest_inner_end_mass_kg: kg.
        told: the share done and what is being done, for each set anew.
    """
    rig = linear_rig(prototype.but(effects={}))
    members = family(prototype, outer_end_mass_kg[1]).members if prototype.effects else ()
    reached: list[SensorRow] = []
    own = [] if prototype.controller is None else as_observer(prototype)
    for sensors in sets:
        starts = [(one, inner) for one, inner in own if set(one.sensors) <= set(sensors)]
        for row in reached:
            if row.found.proved is not None and set(row.sensors) <= set(sensors):
                known = row.found.proved.controller
                assert isinstance(known, Observer)
                starts.append((known, row.found.proved.inner_end_mass_kg))
        best = starts[-2:]
        found = tune_observer(
            rig, members, prototype.goal, outer_end_mass_kg, largest_inner_end_mass_kg, kind, sensors, told, best
        )
        reached.append(SensorRow(sensors, outer_end_mass_kg, found))
        yield reached[-1]


def as_observer(prototype: Prototype) -> list[tuple[Observer, float]]:
    """The prototype's controller with its mass inside as a start, where it can be written as an observer."""
    law, inner = prototype.controller, prototype.payload.inner_end_mass_kg
    if isinstance(law, Observer):
        return [(law, inner)]
    if not isinstance(law, Structured):
        return []
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[1.0]])
    lag = _lag_matrices(2 * pi * law.zero_Hz, 2 * pi * law.pole_Hz)
    parts = [lag] + [
        _section_matrices(2 * pi * one.zero_Hz, one.zero_damping_ratio, 2 * pi * one.pole_Hz, one.pole_damping_ratio)
        for one in law.section
    ]
    for a2, b2, c2, d2 in parts:
        a = np.block([[a, np.zeros((len(a), len(a2)))], [b2 @ c, a2]])
        b, c, d = np.vstack([b, b2 @ d]), np.hstack([d2 @ c, c2]), d2 @ d
    return [(Observer.of(law.gain_A_per_V, SENSED[:1], rounded(a), rounded(b), rounded(c[0]), rounded(d[0])), inner)]


Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _lag_matrices(zero: float, pole: float) -> Matrices:
    """(1 + s / zero) / (1 + s / pole)."""
    return np.array([[-pole]]), np.array([[pole]]), np.array([[1 - pole / zero]]), np.array([[pole / zero]])


def _section_matrices(zero: float, zero_damping: float, pole: float, pole_damping: float) -> Matrices:
    """(1 + 2 d s/z + (s/z)^2) / (1 + 2 e s/p + (s/p)^2)."""
    through = (pole / zero) ** 2
    a = np.array([[0.0, pole], [-pole, -2 * pole_damping * pole]])
    # Numerator less the direct gain's share: (1 - through) + s (2 d / z - 2 e through / p).
    c = np.array([[1 - through, pole * (2 * zero_damping / zero - 2 * pole_damping * through / pole)]])
    return a, np.array([[0.0], [pole]]), c, np.array([[through]])
