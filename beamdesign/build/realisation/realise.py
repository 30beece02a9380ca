"""A controller as a machine carries it out: sections, coefficients and words, chosen by scaling; and its roundings.

Words are scaled to the largest values of a discrete linear system: sums of absolute impulse responses, with what is
left out bounded.

A rounding is an input of the linear loop that never exceeds half a step. However the roundings fall, an output then
departs from that of the same law without rounding by at most the sum of absolute impulse responses times half a step
each. No limit cycle of the rounded loop about a point of rest can be larger. It holds as long as no limit is reached.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from math import degrees, floor, frexp, log2, log10, pi

import numpy as np
from flint import ctx

from beamdesign.build.realisation.law import Coefficient, LinearLaw, coefficients_of, fixed_point, linear_law, states_of
from beamdesign.build.realisation.loop import LOOP_BITS, RealisedLoop, middle
from beamdesign.build.realisation.sections import DiscreteLaw, discretised, laws_of
from beamdesign.controllers import SENSORS, Controller, TransferFunction
from beamdesign.polynomial import at_points, exact, nearest
from beamdesign.proofs.mass_family import floats
from beamdesign.prototype import Prototype

LEAST_WORD, LARGEST_WORD = 8, 32
FULL_SCALE_V = 10.0
_OF_UNIT = {"m": 0.01, "Pa": 2.1e7, "N": 1e4}
FULL_SCALES: Mapping[str, float] = {name: _OF_UNIT.get(name.rpartition("_")[2], 1.0) for name in SENSORS[1:]}
"""Of the other readings where nothing says better: a beam's tip, an industrial supply, a load cell."""
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
    scales = tuple(full_scale_V if one.unit == "V" else full_scales[one.reading] for one in asked.channels)
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
    finest = [coefficients[one.gain_name].places + own - spare for one, own in zip(asked.channels, places, strict=True)]
    current_places = min(word_length - 1 - frexp(largest)[1], *finest)
    made = Realisation(rate_Hz, asked.channels, word_length, coefficients, places, current_places, scales, largest)
    if made.current_limit < 1 or max(made.current_shifts.values()) > 2 * word_length - 2:
        raise ValueError(
            f"a largest current of {largest:g} A and what the gain makes of full scale, {at_rest:g} A, lie too far"
            f" apart for words of {word_length} bits"
        )
    return made


def full_scales_of(prototype: Prototype, full_scale_V: float) -> dict[str, float]:
    """Largest values of the readings beside the error: what the displacement's volts reach, and the supply pressure."""
    felt = prototype.actuator.feels[0]
    own = {"inner_displacement_m": full_scale_V / prototype.sensor.gain_V_per_m}
    if felt.endswith("_Pa") and prototype.supply.pressure_Pa:
        own[felt] = prototype.supply.pressure_Pa
    if felt.endswith("_N"):
        own[felt] = max(2 * prototype.actuator.strength_N(prototype), FULL_SCALES[felt])
    return {**FULL_SCALES, **own}


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
    raise ValueError(f"it takes more than {_MOST_STEPS} samples to come to rest; at a lower rate it takes fewer")


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


def rounded_loop(loop: RealisedLoop, mass_kg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The loop at one outer end mass with its roundings as inputs, in floats.

    Returns:
        A, B, C and D of x+ = A x + B u, y = C x + D u; inputs u are the roundings of the law, outputs y the
        displacement of the tip (m), the current (A) computed at the sample, and the error (V).
    """
    mass, law, plant = exact(mass_kg), loop.law, loop.plant
    with ctx.workprec(LOOP_BITS):
        a, moved = loop.matrix(mass), middle(plant.moved(mass, mass, loop.period_s))
    n, late, given, seen = plant.a.nrows(), int(loop.delayed), floats(law.g), floats(plant.readings(law.sensed))
    b, c, d = np.zeros((len(a), given.shape[1])), np.zeros((3, len(a))), np.zeros((3, given.shape[1]))
    if late:
        b[n] = given
    else:
        b[:n] = moved[:n, n : n + 1] @ given
    b[n + late :] = floats(law.f)
    c[0, :n], c[2, :n] = floats(plant.tip)[0], seen[0]
    c[1, :n], c[1, n + late :] = (floats(law.d) @ seen)[0], floats(law.c)[0]
    d[1] = given
    return a, b, c, d


@dataclass(frozen=True)
class RoundingEffect:
    """Of all roundings together, at one outer end mass, at sample times.

    Attributes:
        displacement_m: largest departure of the tip.
        current_A: of the current.
        error_V: of the error.
        expected_displacement_m: root mean square, were the roundings independent and evenly spread.
        expected_current_A: likewise.
    """

    displacement_m: float
    current_A: float
    error_V: float
    expected_displacement_m: float
    expected_current_A: float


def half_steps(realisation: Realisation) -> np.ndarray:
    """(m,) bound of every rounding of a realised law, V, m, Pa or A, for readings within full scale."""
    law = realisation.linear
    if realisation.word_length is not None:
        finer = {"signal": 0, "state": realisation.state_extra}
        places = [
            realisation.current_places if kind == "current" else realisation.places[k] + finer[kind]
            for _, kind, k in law.roundings
        ]
        return 2.0 ** -np.array(places, dtype=float) / 2
    # Floats round by a share of what they hold, which the roundings add to: v = u (|R_e| full scale + |R_v| v).
    n, m, k = len(law.states), len(law.roundings), len(law.sensed)
    rounded = floats(law.rounded)
    inputs = np.hstack([floats(law.b), floats(law.f)])
    norms = l1_norms(floats(law.a), inputs, rounded[:, :n], rounded[:, n:])
    share = FLOAT_STEP / 2
    found = np.linalg.solve(np.eye(m) - share * norms[:, k:], share * norms[:, :k] @ np.array(realisation.full_scales))
    return np.asarray(found)


def rounding_effect(loop: RealisedLoop, mass_kg: float, halves: np.ndarray) -> RoundingEffect:
    """The effect of rounding on the loop at one outer end mass.

    Args:
        loop: of a realised controller.
        mass_kg: on the outer tip.
        halves: bounds of its roundings, as of `half_steps`.

    Raises:
        ValueError: where the loop is not stable.
    """
    a, b, c, d = rounded_loop(loop, mass_kg)
    most = l1_norms(a, b, c, d) @ halves
    spread = l2_norms(a, b * halves, c, d * halves)
    expected = np.sqrt((spread**2).sum(axis=1) / 3)  # an even spread over +-h has the variance h^2 / 3
    return RoundingEffect(*most.tolist(), *expected[:2].tolist())


@dataclass(frozen=True)
class LawErrors:
    """What discretising and rounding do to the law alone.

    Attributes:
        coefficient: largest relative error of a rounded coefficient.
        pole: largest relative error of a pole by rounding, as a share of its distance from z = 1.
        static_gain: relative.
        at_Hz: frequency of the next two.
        gain_dB: law as realised over the continuous one there.
        lag_deg: what the law itself lags behind there, without hold and computing.
        hold_lag_deg: what the hold adds, half a period.
        computing_lag_deg: what one period of computing adds.
    """

    coefficient: float
    pole: float
    static_gain: float
    at_Hz: float
    gain_dB: float
    lag_deg: float
    hold_lag_deg: float
    computing_lag_deg: float


def law_errors(controller: Controller, realisation: Realisation, at_Hz: float) -> LawErrors:
    """Errors of the law as realised against the continuous one, of the reading where gain and phase err most."""
    z, s = np.exp(2j * pi * at_Hz / realisation.rate_Hz), 2j * pi * at_Hz
    a, b, c, d = (floats(getattr(realisation.linear, name)) for name in "abcd")
    made = (c @ np.linalg.solve(z * np.eye(len(a)) - a, b) + d)[0]
    ratios = [
        one * at_points(law.denominator, s) / at_points(law.numerator, s)
        for one, (_, law) in zip(made, laws_of(controller), strict=True)
    ]
    ratio = max(ratios, key=lambda ratio: abs(np.log(ratio)))
    turn = 360 * at_Hz / realisation.rate_Hz
    return LawErrors(
        max(abs(one.error) for one in realisation.coefficients.values()),
        max(_pole_errors(realisation), default=0.0),
        max((realisation.coefficients[one.gain_name].error for one in realisation.channels), key=abs),
        at_Hz,
        20 * log10(abs(ratio)),
        -degrees(float(np.angle(ratio))),
        turn / 2,
        turn,
    )


def _pole_errors(realisation: Realisation) -> list[float]:
    """Of every pole, how far rounding moves it as a share of its distance from z = 1."""
    found: list[float] = []
    given = {name: nearest(one.value) for name, one in realisation.coefficients.items()}
    for number, section in enumerate(realisation.sections, 1):
        follow = given[f"follow{number}"]
        if section.order == 1:
            found.append(abs(follow / section.follow - 1))
            continue
        damping = given[f"damping{number}"]
        asked, made = (np.roots([1, r * f, f * f]) for f, r in ((section.follow, section.damping), (follow, damping)))
        found += [float(np.abs(made - pole).min() / abs(pole)) for pole in asked]
    return found
