"""Controllers written as observers: state matrices with entries to nine digits."""

from math import pi

import numpy as np

from beamdesign.observer import SENSED, Observer
from beamdesign.prototype import Prototype, Structured

DIGITS = 9
"""To which the entries of a record are rounded."""


def rounded(values: np.ndarray, digits: int = DIGITS) -> np.ndarray:
    """Values to so many significant digits."""
    return np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])(values)


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
