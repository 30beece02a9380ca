"""The outer tip of a closed loop as a port for forces: F / x = p / n, whatever is fixed to it or touches it.

An end mass m, a spring k and a dashpot b between the tip and the ground add (m s^2 + b s + k) x to the force, so that
the characteristic polynomial is p0 + (m s^2 + b s + k) n: affine in all three together, and n is free of them.
"""

from dataclasses import dataclass
from functools import cached_property
from math import inf, pi

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.polynomial import Affine, exact

_S = fmpq_poly([0, 1])
_NONE = fmpq(0)


@dataclass(frozen=True)
class Tip:
    """The tip of a closed loop, exact.

    Attributes:
        bare: p0, the characteristic polynomial in s with nothing fixed to the tip.
        moved: n, numerator of the compliance x / F = n / p0.
    """

    bare: fmpq_poly
    moved: fmpq_poly

    @cached_property
    def over_mass(self) -> Affine:
        """The characteristic polynomial over the end mass, free of any wall."""
        return Affine(self.bare, _S * _S * self.moved)

    def against(self, mass: fmpq = _NONE, stiffness: fmpq = _NONE, damping: fmpq = _NONE) -> fmpq_poly:
        """The characteristic polynomial with an end mass (kg) against a spring (N/m) and a dashpot (N s/m)."""
        return self.bare + fmpq_poly([stiffness, damping, mass]) * self.moved

    def static_stiffness(self) -> float:
        """F / x at zero frequency, N/m; infinite for a servo that integrates."""
        return inf if self.moved[0] == 0 else float(self.bare[0] / self.moved[0])

    def stiffness_response(self, frequency_Hz: np.ndarray, outer_end_mass: float = 0.0) -> np.ndarray:
        """F / x in N/m at the given frequencies (N,), complex, the end mass (kg) included."""
        s = 2j * pi * np.asarray(frequency_Hz, dtype=float)
        above, below = (
            np.polyval([float(c) for c in reversed(polynomial.coeffs())], s)
            for polynomial in (self.against(exact(outer_end_mass)), self.moved)
        )
        return np.asarray(above / below)


def tip(loop: Loop) -> Tip:
    """The tip of a closed loop.

    Raises:
        ValueError: where an end mass does not act on the tip that the force acts on.
    """
    family = loop.characteristic
    if family.slope != _S * _S * loop.disturbance:
        raise ValueError("the end mass of this loop does not move with the tip that the force acts on")
    return Tip(family.constant, loop.disturbance)
