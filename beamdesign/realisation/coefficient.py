"""Coefficients as a machine holds them: an integer with a number of places, or a float of 32 bits."""

from dataclasses import dataclass
from fractions import Fraction
from math import frexp

import numpy as np
from flint import fmpq


@dataclass(frozen=True)
class Coefficient:
    """A coefficient as realised.

    Attributes:
        asked: before rounding.
        integer: of a fixed-point coefficient integer / 2^places; None in floats.
        places: binary places of it.
    """

    asked: float
    integer: int | None
    places: int

    @property
    def value(self) -> fmpq:
        """As realised, exact."""
        if self.integer is not None:
            return fmpq(self.integer, 2**self.places)
        exactly = Fraction(float(np.float32(self.asked)))
        return fmpq(exactly.numerator, exactly.denominator)

    @property
    def error(self) -> float:
        """Relative, of what is realised; 0 where nothing was asked."""
        return int(self.value.p) / int(self.value.q) / self.asked - 1 if self.asked else 0.0


def fixed_point(value: float, word_length: int, more_places: int = 0) -> Coefficient:
    """Round to a word of its own scaling: the integer has word_length - 1 significant bits, and a sign.

    No more than 2 word_length - 2 places are used, so that a word times it, rounded, fits two words; `more_places`
    where the word that it multiplies has so many less than none, as of a pressure in Pa.

    Raises:
        ValueError: where it is too large for a word without places.
    """
    most = 2 ** (word_length - 1) - 1
    places = min(word_length - 1 - frexp(value)[1], 2 * word_length - 2 + more_places) if value else 0
    while abs(integer := round(Fraction(value) * Fraction(2) ** places)) > most:
        places -= 1
    if places < 0:
        raise ValueError(f"a coefficient of {value:.6g} is too large for words of {word_length} bits")
    return Coefficient(value, integer, places)


def float32(value: float) -> Coefficient:
    """Round to the nearest float of 32 bits."""
    return Coefficient(value, None, 0)


def float64(value: float) -> Coefficient:
    """A float of 64 bits as it is: an integer over a power of two."""
    integer, below = value.as_integer_ratio()
    return Coefficient(value, integer, below.bit_length() - 1)
