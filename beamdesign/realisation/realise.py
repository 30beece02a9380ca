"""A controller as a machine carries it out: sections, coefficients and words, chosen by scaling."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import floor, frexp, log2
from typing import Literal

import numpy as np
from flint import fmpq_mat

from beamdesign.controllers import Controller, TransferFunction
from beamdesign.realisation.coefficient import Coefficient, fixed_point, float32
from beamdesign.realisation.law import coefficients_of, states_of
from beamdesign.realisation.linear_forms import LinearLaw, linear_law
from beamdesign.realisation.peaks import l1_norms, l2_norms
from beamdesign.realisation.sections import Cascade, Section, cascade

LEAST_WORD, LARGEST_WORD = 8, 32
FULL_SCALE_V = 10.0
FLOAT_STEP = 2.0**-23
"""Largest distance of neighbouring floats of 32 bits, relative."""
Scaling = Literal["l1", "l2"]


@dataclass(frozen=True)
class Realisation:
    """A controller at a rate in given words. Signals are in V, the current in A.

    Attributes:
        asked: the sections before rounding.
        word_length: bits of a word with its sign; None for floats of 32 bits.
        coefficients: as realised; `gain` is in A/V.
        signal_places: binary places of words in V: a word n stands for n / 2^places; 0 in floats.
        current_places: of words in A; 0 in floats.
        full_scale_V: largest error that it is scaled for; larger ones are limited.
        largest_current_A: limit of the current.
        scaling: by which the words were chosen, see `realise`.
    """

    asked: Cascade
    word_length: int | None
    coefficients: Mapping[str, Coefficient]
    signal_places: int
    current_places: int
    full_scale_V: float
    largest_current_A: float
    scaling: Scaling = "l1"

    @property
    def rate_Hz(self) -> float:
        """Sampling rate."""
        return self.asked.rate_Hz

    @property
    def sections(self) -> tuple[Section, ...]:
        """In the order that the error passes them."""
        return self.asked.sections

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return states_of(self.sections)

    @cached_property
    def linear(self) -> LinearLaw:
        """The law as realised, exact, with its roundings."""
        return linear_law(self.sections, self.coefficients, self.word_length is None)

    @property
    def state_places(self) -> int:
        """Binary places of a state: words with word_length - 2 places more, so that no small step is lost."""
        return self.signal_places + (self.word_length or 2) - 2

    @property
    def current_limit(self) -> int:
        """The limit of the current as a word; fixed point only."""
        return int(self.largest_current_A * 2.0**self.current_places)

    @property
    def current_shift(self) -> int:
        """Places dropped from gain times word, which makes a word of current; fixed point only."""
        return self.coefficients["gain"].places + self.signal_places - self.current_places


def realise(
    controller: Controller | TransferFunction,
    rate_Hz: float,
    word_length: int | None = 32,
    full_scale_V: float = FULL_SCALE_V,
    largest_current_A: float | None = None,
    scaling: Scaling = "l1",
    prewarped: bool = True,
) -> Realisation:
    """Discretise and round a controller.

    Args:
        controller: any law of the project, or a transfer function.
        rate_Hz: sampling rate.
        word_length: of fixed-point words; None for floats of 32 bits.
        full_scale_V: largest error.
        largest_current_A: limit; none: what the gain makes of the full scale at rest.
        scaling: `l1`: no signal can overflow, whatever the error does within full scale; `l2`: none does for errors of
            the energy of one sample at full scale, others are limited, for some bits more of resolution.
        prewarped: see `sections.cascade`.

    Raises:
        ValueError: where the law cannot be realised; in words.
    """
    if word_length is not None and not LEAST_WORD <= word_length <= LARGEST_WORD:
        raise ValueError(f"a word of {word_length} bits; {LEAST_WORD} to {LARGEST_WORD} can be used")
    asked = cascade(controller, rate_Hz, prewarped)
    largest = asked.gain_A_per_V * full_scale_V if largest_current_A is None else largest_current_A

    def rounded(value: float) -> Coefficient:
        return float32(value) if word_length is None else fixed_point(value, word_length)

    named = coefficients_of(asked.sections) | {"gain": asked.gain_A_per_V}
    coefficients = {name: rounded(value) for name, value in named.items()}
    lost = [name for name, one in coefficients.items() if one.asked and one.value == 0]
    if lost:
        raise ValueError(f"words of {word_length} bits are too short: nothing is left of {', '.join(lost)}")
    linear = linear_law(asked.sections, coefficients, word_length is None)
    if len(linear.states) and np.abs(np.linalg.eigvals(floats(linear.a))).max() >= 1:
        raise ValueError(f"words of {word_length} bits are too short: the rounded controller itself is not stable")
    if word_length is None:
        return Realisation(asked, None, coefficients, 0, 0, full_scale_V, largest, scaling)
    signal_places = _places(linear, word_length, full_scale_V, scaling)
    # Never more places than a product has: the last operation drops places, it cannot make any.
    current_places = min(word_length - 1 - frexp(largest)[1], coefficients["gain"].places + signal_places)
    made = Realisation(asked, word_length, coefficients, signal_places, current_places, full_scale_V, largest, scaling)
    if made.current_limit < 1 or made.current_shift > 2 * word_length - 2:
        raise ValueError(
            f"a largest current of {largest:g} A and what the gain makes of {full_scale_V:g} V, "
            f"{asked.gain_A_per_V * full_scale_V:g} A, lie too far apart for words of {word_length} bits"
        )
    return made


def _places(linear: LinearLaw, word_length: int, full_scale_V: float, scaling: Scaling) -> int:
    """The most binary places with which every signal of an error within full scale, roundings included, fits a word."""
    n = len(linear.states)
    a, rows = floats(linear.a), floats(linear.signals)
    norms = l1_norms if scaling == "l1" else l2_norms
    peaks = norms(a, floats(linear.b), rows[:, :n], rows[:, n : n + 1])[:, 0]
    halves = [0.5 if kind == "signal" else 0.5 * 2.0 ** (2 - word_length) for _, kind in linear.roundings]
    rounded = l1_norms(a, floats(linear.f), rows[:, :n], rows[:, n + 1 :]) @ np.array(halves)
    room = 2 ** (word_length - 1) - 1 - rounded
    if room.min() <= 0:
        raise ValueError(f"words of {word_length} bits are too short: rounding alone fills them")
    return floor(log2(float((room / (full_scale_V * peaks)).min())))


def floats(matrix: fmpq_mat) -> np.ndarray:
    """The nearest floats of a rational matrix."""
    rows, columns = matrix.nrows(), matrix.ncols()
    return np.array(
        [[float(matrix[i, j].p) / float(matrix[i, j].q) for j in range(columns)] for i in range(rows)]
    ).reshape(rows, columns)
