"""Limit cycles over the gain, by harmonic balance, and the gains of the linearised loop at which they begin.

A limit cycle has its amplitude given and its gain sought: so the curve of gain over amplitude is a function, and both
its stable and its unstable parts are found. Where a loop at rest is stable for small motions, the curve begins at
amplitude zero with a gain at which the linearised loop is on the edge of stability. A loop that is not stable at every
lower gain has two such edges about its own gain, and a curve from each.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, log, tau

import numpy as np
from scipy.optimize import brentq

from beamdesign.loop import CriticalGain
from beamdesign.plant import harmonic_balance
from beamdesign.plant.harmonic_balance import HARMONICS, FreeRig, Motion, NoBalance, Unknown, motion_of
from beamdesign.prototype import Prototype

_NEARBY = 0.999
_FLAT = 1e-8  # more than rounding makes of a loop that is linear up to an amplitude
_NEXT, _LEAP = 2.0, 0.15  # of amplitudes, and the logarithm that no frequency changes by from one to the next
_FAR = 4.0  # times the gain at the edge, beyond which a curve is not followed
_SLOWEST = 1.0  # rad/s
_SOUGHT_A_PER_V, _AWAY = (1e-4, 10.0), 1e3


@dataclass(frozen=True)
class LimitCycle:
    """An oscillation that feeds itself.

    Attributes:
        gain_A_per_V: at which it exists.
        motion: what it looks like.
        steepness: d ln(gain) / d ln(amplitude) along the curve. Where it is positive, oscillations at that gain tend to
            this one in amplitude; where negative, smaller ones die out and larger ones grow (J. M. Loeb's rule). The
            other way round where the curve begins at a gain below which the loop oscillates.
        stable: whether all neighbours tend to it: the rule above, and no Floquet multiplier outside the unit circle.
    """

    gain_A_per_V: float
    motion: Motion
    steepness: float
    stable: bool


@dataclass(frozen=True)
class StabilityEdge:
    """A gain at which a rig, linearised at rest, begins to oscillate as it rises, or ceases to.

    Attributes:
        prototype: the rig; without effects where these close no loop at rest, as a dead band does.
        critical: gain, and the frequency at which it oscillates there.
        begins: whether it oscillates above that gain; else below.
    """

    prototype: Prototype
    critical: CriticalGain
    begins: bool


def edges_about_own(prototype: Prototype, outer_end_mass: float = 0.0) -> tuple[StabilityEdge, ...]:
    """The edges of stability next below and next above the prototype's own gain.

    A loop that is stable at every lower gain has none below. Where the effects close no loop at rest, as a dead band
    does, they are those of the rig without them.

    Raises:
        ValueError: where an effect shakes the rig in time.
    """
    own = prototype.own_controller.gain_A_per_V
    for rig in (prototype, prototype.but(effects={})):
        found = list(edges(rig, outer_end_mass))
        below, above = ([one for one in found if (one.critical.gain_A_per_V < own) is side] for side in (True, False))
        if found:
            return *below[-1:], *above[:1]
    return ()


def edges(prototype: Prototype, outer_end_mass: float, preload: float = 0.0) -> Iterator[StabilityEdge]:
    """All edges, by ascending gain: from 0.1 mA/V to 10 A/V, and within a factor of 1000 of the prototype's own.

    Args:
        prototype: rig with its effects; the controller's breaks are kept.
        outer_end_mass: payload, kg.
        preload: constant force on the outer tip, N, under which it rests.

    Raises:
        ValueError: where an effect shakes the rig in time.
    """
    rig = FreeRig(prototype, outer_end_mass)

    def growth(logarithm: float) -> tuple[float, float]:
        found = rig.linear(float(np.exp(logarithm)), preload).poles
        # Friction's memory and a rod free in its play are poles at the origin, which are no oscillation.
        fastest = max(found[np.abs(found.imag) > _SLOWEST], key=lambda pole: pole.real)
        return float(fastest.real), abs(float(fastest.imag))

    own = prototype.own_controller.gain_A_per_V  # that of a motor may be hundreds of A/V
    low, high = min(_SOUGHT_A_PER_V[0], own / _AWAY), max(_SOUGHT_A_PER_V[1], own * _AWAY)
    grid = np.linspace(np.log(low), np.log(high), round(12 * np.log10(high / low)))
    before = growth(grid[0])[0]
    for left, right in pairwise(grid):
        after = growth(right)[0]
        if (before < 0) is not (after < 0):
            found = float(brentq(lambda at: growth(at)[0], left, right, xtol=1e-10))
            critical = CriticalGain(float(np.exp(found)), growth(found)[1] / tau)
            yield StabilityEdge(prototype, critical, before < 0)
        before = after


def limit_cycles(
    prototype: Prototype,
    begin: StabilityEdge,
    amplitudes: Sequence[float],
    outer_end_mass: float,
    harmonics: int = HARMONICS,
) -> Iterator[LimitCycle]:
    """Gains at which the loop oscillates with given amplitudes, each found from the one before.

    Args:
        prototype: rig with its effects and a controller, whose gain does not matter.
        begin: where their curve begins.
        amplitudes: of the displacement's first harmonic, m, in the order in which they are gone through; begin where
            the effects matter least.
        outer_end_mass: payload, kg.
        harmonics: how many; 1 gives the describing-function method.

    Raises:
        NoBalance: where no balance is found at one of them.
        ValueError: where an effect shakes the rig in time.
    """
    rig = FreeRig(prototype, outer_end_mass)
    first, linear = begin.critical, FreeRig(begin.prototype, outer_end_mass)
    # Of a rig without effects its oscillation stands among the states of the one with them.
    own = dict(zip(linear.assembly.states, _eigenmotion(linear, first), strict=True))
    shape = np.array([own.get(name, 0.0) for name in rig.assembly.states])
    guess = np.zeros((len(rig.assembly.states), 2 * harmonics + 1))
    guess[:, 0] = rig.rest(first.gain_A_per_V)
    guess[:, 1], guess[:, 2] = amplitudes[0] * shape.real, -amplitudes[0] * shape.imag
    unknown = (guess, tau * first.frequency_Hz, first.gain_A_per_V)
    at = amplitudes[0]
    for amplitude in amplitudes:
        unknown = _continued(rig, unknown, at, amplitude)
        at = amplitude
        c, omega, gain = unknown
        beyond = _continued(rig, unknown, at, amplitude * _NEARBY)[2]
        steepness = float(np.log(beyond / gain) / np.log(_NEARBY))
        # Where less gain makes it oscillate, larger ones die out if it takes less gain to keep them up.
        attracts = steepness if begin.begins else -steepness
        stable = attracts > _FLAT and _settles(rig, c, omega, gain)
        yield LimitCycle(gain, motion_of(rig, c, omega, gain), steepness, stable)


def cycles_about_own(
    prototype: Prototype, amplitudes: Sequence[float], outer_end_mass: float = 0.0
) -> tuple[tuple[float, LimitCycle], ...]:
    """Limit cycles of amplitudes (m, ascending), each with its amplitude, on the curves next to a prototype's own gain.

    First those of the curve that begins below it, if there is one, then those of the one above. Amplitudes at which
    nothing is found are left out, and so is all where an effect shakes the rig in time.
    """
    edges: tuple[StabilityEdge, ...] = ()
    with suppress(ValueError):
        edges = edges_about_own(prototype, outer_end_mass)
    found: list[tuple[float, LimitCycle]] = []
    for edge in edges:
        if edge.prototype is prototype:
            for amplitude in amplitudes:
                with suppress(ValueError):
                    found += zip([amplitude], limit_cycles(prototype, edge, [amplitude], outer_end_mass), strict=True)
        else:
            found += reversed([*_downwards(prototype, edge, amplitudes, outer_end_mass)])
    return tuple(found)


def _downwards(
    prototype: Prototype, edge: StabilityEdge, amplitudes: Sequence[float], outer_end_mass: float
) -> Iterator[tuple[float, LimitCycle]]:
    """From the largest amplitude as far down as the curve is followed: what closes no loop at rest matters least there.

    Below a dead band gains go up without end, and Newton's method may come upon the curve of another edge.
    """
    path: list[float] = []
    for high, low in pairwise(reversed(amplitudes)):
        path += np.geomspace(high, low, ceil(log(high / low, _NEXT)), endpoint=False).tolist()
    path.append(amplitudes[0])
    before = edge.critical.frequency_Hz
    with suppress(ValueError):
        for amplitude, cycle in zip(path, limit_cycles(prototype, edge, path, outer_end_mass), strict=True):
            leapt = abs(log(cycle.motion.frequency_Hz / before)) > _LEAP and amplitude < amplitudes[-1]
            if leapt or cycle.gain_A_per_V > _FAR * edge.critical.gain_A_per_V:
                return
            before = cycle.motion.frequency_Hz
            if amplitude in amplitudes:
                yield amplitude, cycle


def _continued(rig: FreeRig, start: Unknown, at: float, amplitude: float) -> Unknown:
    """Balance at an amplitude from that at another, in as many steps as it takes."""
    step, unknown = 1.0, start
    while True:
        target = at * (amplitude / at) ** step
        ratio = target / at
        c = unknown[0].copy()
        c[:, 1:] *= ratio
        try:
            unknown, at = harmonic_balance.balance(rig, (c, unknown[1], unknown[2]), target), target
            if abs(at / amplitude - 1) < 1e-12:
                return unknown
            step = 1.0
        except NoBalance:
            if ratio == 1.0 or step < 0.1:
                raise
            step /= 3


def _eigenmotion(rig: FreeRig, at: CriticalGain) -> np.ndarray:
    """Complex states (n,) of the linear oscillation at the critical gain, for a displacement of one."""
    model = rig.linear(at.gain_A_per_V)
    values, vectors = np.linalg.eig(model.a)
    shape = vectors[:, np.argmin(np.abs(values - 1j * tau * at.frequency_Hz))]
    return np.asarray(shape / (model.c[harmonic_balance.DISPLACEMENT] @ shape))


def _settles(rig: FreeRig, c: np.ndarray, omega: float, gain: float) -> bool:
    """Whether the multipliers lie inside the unit circle, but for the two nearest 1.

    These are that of a shift in time, and that of the amplitude, which `steepness` tells more sharply.
    """
    found = harmonic_balance.multipliers(rig, c, omega, gain)
    others = np.delete(found, np.argsort(np.abs(found - 1))[:2])
    return bool(np.all(np.abs(others) < 1))
