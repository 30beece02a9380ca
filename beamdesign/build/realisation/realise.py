"""A controller as a machine carries it out: sections, coefficients and words, chosen by scaling.

Words are scaled to the largest values of a discrete linear system: sums of absolute impulse responses, with what is
left out bounded. As difference equations in floats of 64 bits it is what is specified and simulated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from math import floor, frexp, log2

import numpy as np

from beamdesign.build.realisation.law import (
    Arithmetic,
    Coefficient,
    LinearLaw,
    coefficients_of,
    fixed_point,
    float64,
    linear_law,
    one_period,
    states_of,
)
from beamdesign.build.realisation.sections import DiscreteLaw, discretised, factored, highest_Hz, laws_of
from beamdesign.controllers import Controller, TransferFunction
from beamdesign.proofs.mass_family import floats
from beamdesign.prototype import Prototype

LEAST_WORD, LARGEST_WORD = 8, 32
FULL_SCALE_V = 10.0
FULL_SCALES = {"inner_displacement_m": 0.01, "load_pressure_Pa": 2.1e7, "screw_force_N": 1e4}
"""Of the other readings where nothing says better: a beam's tip and an industrial supply."""
FLOAT_STEP = 2.0**-23
"""Largest distance of neighbouring floats of 32 bits, relative."""


@dataclass(frozen=True)
class Realisation(DiscreteLaw):
    """A controller at a rate, as it is before rounding, in given words. Readings are in V, m or Pa, the current in A.

    Attributes:
        word_length: bits of a word with its sign; None for floats of 32 bits.
        coefficients: as realised; gains are in A per unit of their reading.
        places: binary places of words of each channel: a word n stands for n / 2^places; 0 in floats.
        current_places: of words in A; 0 in floats.
        full_scales: largest value of each reading that it is scaled for; larger ones are limited.
        largest_current_A: limit of the current.
    """

    word_length: int | None
    coefficients: Mapping[str, Coefficient]
    places: tuple[int, ...]
    current_places: int
    full_scales: tuple[float, ...]
    largest_current_A: float

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return states_of(self.sections)

    @property
    def state_channels(self) -> dict[str, int]:
        """Place of the channel of each state."""
        orders = [sum(section.order for section in channel.sections) for channel in self.channels]
        places = chain.from_iterable([place] * order for place, order in enumerate(orders))
        return dict(zip(self.states, places, strict=True))

    @cached_property
    def linear(self) -> LinearLaw:
        """The law as realised, exact, with its roundings."""
        return linear_law(self, self.coefficients, self.word_length is None)

    @property
    def signal_places(self) -> int:
        """Binary places of the error's words."""
        return self.places[0]

    @property
    def full_scale_V(self) -> float:
        """Of the error."""
        return self.full_scales[0]

    @property
    def state_extra(self) -> int:
        """Places that a state has beyond those of its channel's words, so that no small step is lost."""
        return (self.word_length or 2) - 2

    @property
    def current_limit(self) -> int:
        """The limit of the current as a word; fixed point only."""
        return int(self.largest_current_A * 2.0**self.current_places)

    @property
    def current_shifts(self) -> dict[str, int]:
        """By gain, places dropped from it times a word, which makes a word of current; fixed point only."""
        return {
            channel.gain_name: self.coefficients[channel.gain_name].places + places - self.current_places
            for channel, places in zip(self.channels, self.places, strict=True)
        }


def realise(
    controller: Controller | TransferFunction,
    rate_Hz: float,
    word_length: int | None = 32,
    full_scale_V: float = FULL_SCALE_V,
    largest_current_A: float | None = None,
    full_scales: Mapping[str, float] = FULL_SCALES,
) -> Realisation:
    """Discretise and round a controller; no signal can overflow, whatever its readings do within full scale.

    Args:
        controller: any law of the project, or a transfer function.
        rate_Hz: sampling rate.
        word_length: of fixed-point words; None for floats of 32 bits.
        full_scale_V: largest error, and largest command where that is read by itself.
        largest_current_A: limit; none: what the gains make of the full scales at rest.
        full_scales: largest value (m, Pa) of each further reading.

    Raises:
        ValueError: where the law cannot be realised; in words.
    """
    if word_length is not None and not LEAST_WORD <= word_length <= LARGEST_WORD:
        raise ValueError(f"a word of {word_length} bits; {LEAST_WORD} to {LARGEST_WORD} can be used")
    asked = discretised(controller, rate_Hz)
    scales = tuple(full_scale_V if one.unit == "V" else full_scales[one.heard] for one in asked.channels)
    at_rest = sum(abs(one.gain) * scale for one, scale in zip(asked.channels, scales, strict=True))
    largest = at_rest if largest_current_A is None else largest_current_A

    units = {one.gain_name: max(0, frexp(scale)[1]) for one, scale in zip(asked.channels, scales, strict=True)}
    units["gain"] = 0

    def rounded(name: str, value: float) -> Coefficient:
        if word_length is None:
            return Coefficient(value, None, 0)
        return fixed_point(value, word_length, units.get(name, 0))

    coefficients = {name: rounded(name, value) for name, value in coefficients_of(asked).items()}
    lost = [name for name, one in coefficients.items() if one.asked and one.value == 0]
    if lost:
        raise ValueError(f"words of {word_length} bits are too short: nothing is left of {', '.join(lost)}")
    linear = linear_law(asked, coefficients, word_length is None)
    if len(linear.states) and np.abs(np.linalg.eigvals(floats(linear.a))).max() >= 1:
        raise ValueError(f"words of {word_length} bits are too short: the rounded controller itself is not stable")
    if word_length is None:
        return Realisation(rate_Hz, asked.channels, None, coefficients, (0,) * len(scales), 0, scales, largest)
    places = tuple(_places(linear, word_length, place, scale) for place, scale in enumerate(scales))
    # Never more places than a product has: the last operation drops places, it cannot make any. The sum of up to four
    # products has to fit two words, so that each drops two of them at least.
    spare = 2 if len(places) > 1 else 0
    products = [
        coefficients[one.gain_name].places + own - spare for one, own in zip(asked.channels, places, strict=True)
    ]
    current_places = min(word_length - 1 - frexp(largest)[1], *products)
    made = Realisation(rate_Hz, asked.channels, word_length, coefficients, places, current_places, scales, largest)
    if made.current_limit < 1 or max(made.current_shifts.values()) > 2 * word_length - 2:
        raise ValueError(
            f"a largest current of {largest:g} A and what the gain makes of full scale, {at_rest:g} A, lie too far"
            f" apart for words of {word_length} bits"
        )
    return made


def full_scales_of(prototype: Prototype, full_scale_V: float) -> dict[str, float]:
    """Largest values of the readings beside the error: what the displacement's volts reach, and the supply pressure."""
    return FULL_SCALES | {
        "inner_displacement_m": full_scale_V / prototype.sensor.gain_V_per_m,
        "load_pressure_Pa": prototype.supply.pressure_Pa or FULL_SCALES["load_pressure_Pa"],
        "screw_force_N": max(2 * prototype.actuator.strength_N(prototype), FULL_SCALES["screw_force_N"]),
    }


def _places(linear: LinearLaw, word_length: int, place: int, full_scale: float) -> int:
    """The most binary places with which every signal of a channel, roundings included, fits a word."""
    n, k = len(linear.states), len(linear.sensed)
    a, rows = floats(linear.a), floats(linear.signals)[np.array(linear.signal_channels) == place]
    given = slice(place, place + 1)
    peaks = l1_norms(a, floats(linear.b)[:, given], rows[:, :n], rows[:, n : n + k][:, given])[:, 0]
    halves = [0.5 if kind == "signal" else 0.5 * 2.0 ** (2 - word_length) for _, kind, _ in linear.roundings]
    rounded = l1_norms(a, floats(linear.f), rows[:, :n], rows[:, n + k :]) @ np.array(halves)
    room = 2 ** (word_length - 1) - 1 - rounded
    if room.min() <= 0:
        raise ValueError(f"words of {word_length} bits are too short: rounding alone fills them")
    return floor(log2(float((room / (full_scale * peaks)).min())))


_BLOCK = 128
_RELATIVE = 1e-6
_MOST_STEPS = 4_000_000


def l1_norms(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Largest |y_i| per largest |u_j| of x+ = A x + B u, y = C x + D u from rest.

    Args:
        a: (n, n) with all eigenvalues within the unit circle.
        b: (n, m).
        c: (p, n).
        d: (p, m).

    Returns:
        (p, m); what the sums leave out is bounded by the modes' geometric series and added, so that they are upper
        bounds up to rounding in double precision.

    Raises:
        ValueError: for a system that does not decay within `_MOST_STEPS` steps.
    """
    total = np.abs(d)
    if not len(a):
        return total
    rows = [c]
    for _ in range(_BLOCK - 1):
        rows.append(rows[-1] @ a)
    stacked, jump = np.vstack(rows), np.linalg.matrix_power(a, _BLOCK)
    values, vectors = np.linalg.eig(a)
    radii = np.abs(values)
    if radii.max() >= 1:
        raise ValueError(f"a characteristic value of modulus {radii.max():.6g}")
    ahead = np.abs(c @ vectors) / (1 - radii)
    state, inverse = b.astype(float), np.linalg.inv(vectors)
    for _ in range(_MOST_STEPS // _BLOCK):
        total = total + np.abs(stacked @ state).reshape(_BLOCK, *d.shape).sum(axis=0)
        state = jump @ state
        rest = ahead @ np.abs(inverse @ state)
        if np.all(rest <= _RELATIVE * total + 1e-300):
            return np.asarray(total + rest)
    raise ValueError(f"no decay within {_MOST_STEPS} steps")


def l2_norms(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(p, m) root of the sum of squares of every impulse response; arguments as of `l1_norms`.

    It is the spread of y under white u of unit spread, and the largest |y| under u of unit energy.
    """
    found = np.zeros(d.shape)
    for j in range(b.shape[1]):
        gramian, jump = np.outer(b[:, j], b[:, j]), a
        while np.abs(jump).max() > 1e-12:  # twice as many steps each time (R. A. Smith 1968), whatever the units
            gramian, jump = gramian + jump @ gramian @ jump.T, jump @ jump
        found[:, j] = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", c, gramian, c), 0) + d[:, j] ** 2)
    return found


DIGITS = 12
_PER_CROSSOVER = 40.0


@dataclass(frozen=True)
class DifferenceEquation:
    """The sections of `beamdesign.build.realisation.sections`, their coefficients as they are printed.

    Attributes:
        asked: what was discretised, before it was rounded.
        coefficients: by name, to `DIGITS` significant digits: what is printed is what is proved. Gains are in A per
            unit of their reading.
    """

    asked: DiscreteLaw
    coefficients: dict[str, float]

    @property
    def rate_Hz(self) -> float:
        """Sampling rate."""
        return self.asked.rate_Hz

    @property
    def period_s(self) -> float:
        """Between two samples."""
        return 1 / self.rate_Hz

    @cached_property
    def linear(self) -> LinearLaw:
        """As matrices, exact."""
        return linear_law(self.asked, {name: float64(value) for name, value in self.coefficients.items()}, False)

    def lines(self) -> list[str]:
        """The statements of one period, in the order in which they are carried out."""
        written = _Lines()
        one_period(self.asked.channels, [_LETTERS.get(c.name, c.name) for c in self.asked.channels], written)
        return written.statements


_LETTERS = {"error": "e"}


class _Lines(Arithmetic[str]):
    """Arithmetic on names and expressions."""

    def __init__(self) -> None:
        self.statements: list[str] = []

    def read(self, state: str) -> str:
        return state

    def multiply(self, coefficient: str, value: str) -> str:
        return f"{coefficient}*{value}"

    def add(self, one: str, other: str) -> str:
        return f"{one} + {other}"

    def subtract(self, one: str, other: str) -> str:
        return f"{one} - {other}"

    def signal(self, name: str, value: str) -> str:
        self.statements.append(f"{name} = {value}")
        return name

    def current(self, terms: Sequence[tuple[str, str]]) -> str:
        self.statements.append(f"i = {' + '.join(f'{gain}*{value}' for gain, value in terms)}")
        return "i"

    def advance(self, state: str, coefficient: str, value: str, held: bool) -> None:
        self.statements.append(f"{state} = {state} + {coefficient}*{value}")


def difference_equation(controller: Controller, rate_Hz: float) -> DifferenceEquation:
    """Tustin's rule with each break prewarped: poles and zeros lie at their own frequencies, the static gain is kept.

    Args:
        controller: continuous law.
        rate_Hz: more than twice the upper break.

    Raises:
        ValueError: as of `beamdesign.build.realisation.sections.discretised`.
    """
    asked = discretised(controller, rate_Hz)
    named = coefficients_of(asked)
    return DifferenceEquation(asked, {name: float(f"{value:.{DIGITS - 1}e}") for name, value in named.items()})


def upper_break_Hz(controller: Controller) -> float:
    """The highest natural frequency of its poles and zeros, from any of its readings.

    Raises:
        ValueError: as of `beamdesign.build.realisation.sections.factored`.
    """
    return max(highest_Hz(factored(law)[1]) for _, law in laws_of(controller))


def sensible_rate_Hz(crossover_Hz: float, upper_break_Hz: float = 0.0) -> float:
    """The least rate of 1, 2 or 5 times a power of ten that is 40 times the crossover and ten times the upper break."""
    least = max(_PER_CROSSOVER * crossover_Hz, 10 * upper_break_Hz, 1000.0)
    return next(rate for k in count() for step in (1, 2, 5) if (rate := step * 10.0**k) >= least)
