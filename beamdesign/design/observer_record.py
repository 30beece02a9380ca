"""Controllers written as observers: state matrices with entries to nine digits."""

import numpy as np

from beamdesign.controllers import SENSED, Observer
from beamdesign.prototype import Prototype

DIGITS = 9
"""To which the entries of a record are rounded."""


def rounded(values: np.ndarray, digits: int = DIGITS) -> np.ndarray:
    """Values to so many significant digits."""
    return np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])(values)


def as_observer(prototype: Prototype) -> list[tuple[Observer, float]]:
    """The prototype's controller with its mass inside as a start, where it can be written as an observer."""
    law, inner = prototype.controller, prototype.payload.inner_end_mass_kg
    if law is None:
        return []
    if law.observer is not None:
        return [(law.observer, inner)]
    if law.cascade is None or not law.sections:
        return []
    a, b, c, d = (rounded(np.asarray(part)) for part in law.cascade.matrices())
    return [(Observer.of(law.gain_A_per_V, SENSED[:1], a, b[:, None], c, [d]), inner)]
