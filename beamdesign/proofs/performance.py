"""Performance that holds for every outer end mass of a range and every factor on the gain, in rational arithmetic.

Six claims: compliance up to a bandwidth, peak sensitivity, loop gain above a frequency, controller effort, decay rate,
gain margin. The first four are magnitudes |above / below| that stay within a limit: inequalities quadratic in the mass
(see `first_negative`); the other two are stability of related families. Each presupposes that the loop is stable
over the range, which is proved first. For magnitudes there is the inverse question as well: the best figure that can be
proved, rounded to the safe side.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import inf, isinf, pi, sqrt
from typing import NamedTuple

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.plant.linear import Plant
from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import Affine, at_points, exact, nearest, ratio, roots, shortened
from beamdesign.proofs.arm import PlaneLoop
from beamdesign.proofs.certificate import Asked, Claim, Kind, Witness
from beamdesign.proofs.quadratic import Coefficients, first_negative, kept_up_to_Hz, magnitude_slack, squared_frequency
from beamdesign.proofs.rectangle import Rectangle, Side, shifted
from beamdesign.proofs.stability import Unstable, unstable_at

_RELATIVE_STEP = 5e-5
_LEAST_LIMIT = 1e-12
"""Of what is zero, such as the loop gain of a controller that feeds nothing back."""
_LARGEST_LIMIT = 1e12


Closed = Loop | PlaneLoop
"""What magnitudes are of: a loop, or one plane of an arm, which has them under these names."""


MAGNITUDES: dict[Kind, tuple[str, str, str]] = {
    "compliance": ("|x/F_d|", "disturbance", "characteristic"),
    "peak_compliance": ("|x/F_d|", "disturbance", "characteristic"),
    "tip_compliance": ("|x/F_d|", "tip", "characteristic"),
    "load_compliance": ("|x/F_d|", "load", "characteristic"),
    "peak_sensitivity": ("|1/(1+L)|", "loop_denominator", "characteristic"),
    "loop_gain": ("|L|", "loop_numerator", "loop_denominator"),
    "controller_effort": ("|C S|", "effort_numerator", "characteristic"),
}
"""The symbol of each, and the names of numerator and denominator."""


def slack(kind: Kind, loop: Closed, limit: fmpq) -> Coefficients:
    """limit^2 |below|^2 - |above|^2 of a loop's magnitude: not negative where it keeps the limit."""
    above, below = _quotient(kind, loop)
    return magnitude_slack(limit, below, above)


def _quotient(kind: Kind, loop: Closed) -> tuple[Affine, Affine]:
    """Numerator and denominator of a loop's magnitude."""
    above, below = (getattr(loop, name) for name in MAGNITUDES[kind][1:])
    return (Affine(above) if isinstance(above, fmpq_poly) else above), below


# Claims proved or refuted.


def prove(rectangle: Rectangle, asked: Asked) -> Claim:
    """Prove or refute a claim on a rectangle: on its sides, and inside where these do not decide.

    Raises:
        ValueError: for a limit that is not positive, a frequency that is negative, or as `Rectangle.deciding_sides`.
    """
    limit, kind = exact(asked.limit), asked.kind
    if limit < 0 or (limit == 0 and kind != "gain_margin"):
        raise ValueError(f"a limit must be positive, is {asked.limit}")
    if asked.from_Hz < 0:
        raise ValueError(f"a frequency must not be negative, is {asked.from_Hz}")
    if asked.bandwidth_Hz <= 0:
        raise ValueError(f"a bandwidth must be positive, is {asked.bandwidth_Hz}")
    held = asked.decided((nearest(rectangle.low), nearest(rectangle.high)), True)
    if kind == "gain_margin":
        return _gain_margin(rectangle, limit, held)
    for side in rectangle.sides() if kind == "decay_rate" else rectangle.deciding_sides():
        if kind == "loop_gain" and side.factor is None:
            continue  # it grows with the factor
        found = _decays_slowly(side, limit) if kind == "decay_rate" else _exceeded(side, asked, limit)
        if found is not None:
            return _refuted(held, side, found)
    if kind == "decay_rate" and (inside := rectangle.inside(limit)) is not None:
        words = "a pole decays no faster" if inside.decided else _OPEN
        return replace(held, holds=False, reason=f"{words} between the ends of masses and gains")
    return held


def _exceeded(side: Side, asked: Asked, limit: fmpq) -> Unstable | None:
    """Where a magnitude exceeds its limit, or the loop is not stable."""
    if (there := unstable_at(side.loop.characteristic, side.low, side.high)) is not None:
        reason = f"the loop is not stable for all of these masses: {there.reason}"
        return replace(there, reason=reason)
    start = squared_frequency(exact(asked.from_Hz))[0] if asked.kind == "loop_gain" else fmpq(0)
    bounded = asked.kind == "compliance" and asked.bandwidth_Hz != inf
    until = squared_frequency(exact(asked.bandwidth_Hz))[1] if bounded else None
    found = first_negative(slack(asked.kind, side.loop, limit), side.low, side.high, start, until)
    if found is None:
        return None
    frequency, symbol = sqrt(nearest(found.x)) / (2 * pi), MAGNITUDES[asked.kind][0]
    reason = f"{symbol} exceeds the limit at {frequency:.6g} Hz with an outer end mass of {nearest(found.mass):.6g} kg"
    return Unstable(found.mass, True, frequency, reason, found.x)


def _decays_slowly(side: Side, rate: fmpq) -> Unstable | None:
    """Where a pole is not to the left of -rate."""
    if (there := unstable_at(shifted(side.loop.characteristic, rate), side.low, side.high)) is None:
        return None
    reason = (
        f"a pole decays no faster than {nearest(rate):.6g} 1/s with an outer end mass of"
        f" {nearest(there.value):.6g} kg (at {there.frequency_Hz:.6g} Hz)"
    )
    return replace(there, reason=reason)


def _refuted(held: Claim, side: Side, found: Unstable) -> Claim:
    """A claim that fails on a side: its witness states mass and factor, whichever of them varies."""
    if side.mass is None:
        mass, factor, reason = found.value, side.factor if side.factor != 1 else None, found.reason + side.where
    else:
        mass, factor = side.mass, found.value
        reason = f"fails at {found.frequency_Hz:.6g} Hz with {nearest(factor):.6g} times the gain{side.where}"
    witness = Witness(mass, found.squared_frequency, factor, found.frequency_Hz, found.exact)
    return replace(held, holds=False, reason=reason, witness=witness)


_OPEN = "not decided"


def _gain_margin(rectangle: Rectangle, limit: fmpq, held: Claim) -> Claim:
    """Whether a rectangle stays stable with its gain times every number between one and a limit."""
    alone = rectangle.least == rectangle.most
    if alone:  # the witness's factor is one on the loop as it stands
        rectangle = Rectangle(rectangle.loop.scaled(rectangle.least), rectangle.low, rectangle.high)
    wide = rectangle.widened(limit)
    for side in sorted(wide.sides(), key=lambda side: side.factor != 1):  # the loop as it stands first
        if alone and (there := unstable_at(side.loop.characteristic, side.low, side.high)) is not None:
            mass = there.value if side.mass is None else side.mass
            factor = there.value if side.factor is None else side.factor
            return _upset(held, Witness(mass, None, factor, there.frequency_Hz, there.exact))
        if not alone and not side.stable:
            return replace(held, holds=False, reason=f"unstable with the gain times some number up to this{side.where}")
    if (found := wide.inside()) is None:
        return held
    if not found.decided:
        return replace(held, holds=False, reason=f"{_OPEN} between the ends")
    if not alone:
        reason = "unstable with the gain times some number up to this between the ends"
        return replace(held, holds=False, reason=reason)
    return _upset(held, Witness(exact(found.mass), None, exact(found.factor), found.frequency_Hz, exact=False))


def _upset(held: Claim, witness: Witness) -> Claim:
    """A gain margin that does not hold."""
    assert witness.gain_factor is not None
    factor, mass = nearest(witness.gain_factor), nearest(witness.mass)
    reason = f"unstable at {factor:.6g} times the gain with an outer end mass of {mass:.6g} kg"
    return replace(held, holds=False, reason=reason, witness=witness)


# The best figures that can be proved, of what is proved to be stable already.


def bandwidth(rectangles: Sequence[Rectangle], limit_m_per_N: float) -> float:
    """The largest bandwidth (Hz) that is proved on rectangles that are stable; 0 if none, infinite if every one."""
    limit = exact(limit_m_per_N)
    return min(
        kept_up_to_Hz(slack("compliance", side.loop, limit), side.low, side.high)
        for rectangle in rectangles
        for side in rectangle.deciding_sides()
    )


def least_limit(rectangles: Sequence[Rectangle], kind: Kind, from_Hz: float = 0.0, goal: float = inf) -> float:
    """The least limit of a magnitude that is proved on rectangles that are stable; infinite where none is.

    Args:
        rectangles: of masses and factors.
        kind: of magnitude; not a compliance, whose bandwidth is what is asked.
        from_Hz: for a loop gain, the frequency from which on the limit is kept.
        goal: see `least_of`.
    """
    worst = 0.0
    for rectangle, side in ((one, side) for one in rectangles for side in one.deciding_sides()):
        if kind == "loop_gain" and side.factor != rectangle.most:
            continue  # it grows with the factor
        # Mostly one side governs, and one proof settles each of the others.
        if worst == 0.0 or not keeps(kind, side.loop, exact(worst), (side.low, side.high), from_Hz):
            worst = max(worst, least_of(kind, side.loop, (side.low, side.high), from_Hz, goal))
            if isinf(worst):
                return inf
    return worst


def keeps(kind: Kind, loop: Closed, limit: fmpq, ends: tuple[fmpq, fmpq], from_Hz: float = 0.0) -> bool:
    """Whether a magnitude of a loop that is stable keeps a limit, at every frequency or from one up."""
    start = squared_frequency(exact(from_Hz))[0]
    return first_negative(slack(kind, loop, limit), *ends, start) is None


def least_of(kind: Kind, loop: Closed, ends: tuple[fmpq, fmpq], from_Hz: float = 0.0, goal: float = inf) -> float:
    """The least limit of a magnitude that is proved of a loop that is stable, to 1e-4 and rounded up to 5 digits.

    Where that rounding would pass a goal which is itself proved, it is the goal, so that a design that was tuned up to
    its goal is not told to be beyond it.
    """
    if kind == "peak_sensitivity":
        start = sampled_peak(loop.loop_denominator, loop.loop_numerator, *ends)
    else:
        start = sampled_ratio(*_quotient(kind, loop), from_Hz, *ends)
    found = least_proved(start, lambda limit: keeps(kind, loop, limit, ends, from_Hz))
    rounded = goal < found <= goal * (1 + 10 * _RELATIVE_STEP)
    return goal if rounded and keeps(kind, loop, exact(goal), ends, from_Hz) else found


def least_proved(start: float, proves: Callable[[fmpq], bool]) -> float:
    """The least figure from `start` up that is proved, to 1e-4 and rounded up to 5 digits; infinite for a vast one."""
    lower, step = max(start, _LEAST_LIMIT), _RELATIVE_STEP
    while not proves(upper := shortened(exact(lower * (1 + step)), 5, up=True)):
        if (lower := nearest(upper)) > _LARGEST_LIMIT:
            return inf
        step *= 8
    while nearest(upper) > lower * (1 + 2 * _RELATIVE_STEP):
        middle = shortened(exact(sqrt(lower * nearest(upper))), 5, up=True)
        if middle >= upper:
            break
        if proves(middle):
            upper = middle
        else:
            lower = nearest(middle)
    return nearest(upper)


# Sampled, floating-point guesses of the best figures: where the search for the best proved ones begins. Nothing here is
# proved, and no proof rests on it; a poor guess only costs further proofs.


_FREQUENCIES = np.geomspace(1e-1, 1e5, 400)  # rad/s
_ZOOMS, _POINTS = 4, 21
_CLIMBS, _SHRINK = 14, 0.4
_CLIMBED = 1e-5
"""Relative gain below which climbing along the masses ends."""


def sampled_peak(denominator: Affine, numerator: Affine, low: fmpq, high: fmpq) -> float:
    """Largest |S| seen over sampled masses, near the poles and on a grid of frequencies, then on finer ones of both."""
    parts = (denominator.constant, denominator.slope, numerator.constant, numerator.slope)
    degree = max(polynomial.degree() for polynomial in parts)
    constant, slope, fed_back, fed_back_slope = (_floats(part, degree) for part in parts)

    def seen(masses: np.ndarray, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest |S| of each mass over its row of frequencies, and where."""
        s = 1j * frequencies
        below = np.polyval(constant, s) + masses[:, None] * np.polyval(slope, s)
        above = np.polyval(fed_back, s) + masses[:, None] * np.polyval(fed_back_slope, s)
        values = np.abs(below / (below + above))
        rows, columns = np.arange(len(masses)), values.argmax(axis=1)
        return values[rows, columns], frequencies[rows, columns]

    def with_poles(masses: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
        """The frequencies, and for each mass those of its poles."""
        closed = constant + fed_back + masses[:, None] * (slope + fed_back_slope)
        companions = np.zeros((len(masses), degree, degree))
        companions[:, :1] = -closed[:, None, 1:] / closed[:, None, :1]
        companions[:, 1:, :-1] = np.eye(max(degree - 1, 0))
        poles = np.abs(np.linalg.eigvals(companions))
        return np.hstack([np.broadcast_to(frequencies, (len(masses), len(frequencies))), poles])

    masses = np.linspace(nearest(low), nearest(high), 5 if low < high else 1)
    ends = masses[0], masses[-1]
    peaks, at = seen(masses, with_poles(masses, _FREQUENCIES))
    spread = 1.05
    for _ in range(_ZOOMS - 1):
        finer, at = seen(masses, at[:, None] * np.geomspace(1 / spread, spread, _POINTS))
        peaks, spread = np.maximum(peaks, finer), spread ** (2 / _POINTS)
    # From the best mass on, climb along the masses: a sharp peak may lie between the sampled ones.
    best, mass, frequency = (float(values[peaks.argmax()]) for values in (peaks, masses, at))
    reach, spread = float(ends[1] - ends[0]) / 8, 1.02
    stalled = 0
    for _ in range(_CLIMBS if reach > 0 else 0):
        masses = np.unique(np.clip(mass + reach * np.linspace(-1, 1, 5), *ends))
        peaks, at = seen(masses, with_poles(masses, frequency * np.geomspace(1 / spread, spread, _POINTS)))
        stalled = 0 if peaks.max() > best * (1 + _CLIMBED) else stalled + 1
        if peaks.max() > best:
            best, mass, frequency = (float(values[peaks.argmax()]) for values in (peaks, masses, at))
        if stalled and (stalled > 1 or mass in ends):
            break
        reach, spread = reach * _SHRINK, spread**_SHRINK
    return max(best, 1.0)


def sampled_ratio(above: Affine, below: Affine, from_Hz: float, low: fmpq, high: fmpq) -> float:
    """Largest |above / below| seen from a frequency up, over sampled masses and frequencies."""
    start, count = (2 * np.pi * from_Hz, 2000) if from_Hz else (1e-2, 3000)
    masses = np.linspace(nearest(low), nearest(high), 5)
    return float(np.abs(ratio(above, below, masses, np.geomspace(start, 1e6, count))).max())


def _floats(polynomial: fmpq_poly, degree: int) -> np.ndarray:
    """Coefficients from that of the given degree down."""
    return np.array([nearest(polynomial[power]) for power in range(degree, -1, -1)])


# The largest compliance with the servo off: it asks for no current, and the actuator gives as it then does.
#
# The closed loop's compliance is this times the sensitivity. It is what the servo is to better, so that limits of the
# closed loop's compliance are multiples of it. All of it is found by numerics and rounded down: no figure is above what
# the rig has, so that a limit that is a multiple of it is no laxer than stated.


_GRID = 2 * pi * np.geomspace(1e-2, 1e4, 3000)  # rad/s
_TOPS, _TOP_ZOOMS, _TOP_POINTS, _FINE = 3, 6, 41, 1.003
_DIGITS, _ROUNDING = 6, 1e-9


class Peak(NamedTuple):
    """The largest compliance of a rig with its servo off, m/N, rounded down, and at which frequency, Hz."""

    compliance_m_per_N: float
    frequency_Hz: float


def servo_off_peak(plants: Iterable[Plant], masses_kg: tuple[float, float]) -> Peak:
    """The largest |x / F_d| of some plants with no current, over all frequencies and a range of outer end masses.

    At a frequency the denominator is affine in the mass, so that the mass at which it is least is known; over the
    frequency a dense grid, to which the poles are added, is refined about its highest points.
    """
    return max((_peak(plant, masses_kg) for plant in plants), default=Peak(0.0, 0.0))


def _peak(plant: Plant, masses_kg: tuple[float, float]) -> Peak:
    constant, slope = plant.denominator.constant, plant.denominator.slope

    def compliance(w: np.ndarray) -> np.ndarray:
        s = 1j * w
        bare, added = at_points(constant, s), at_points(slope, s)
        mass = np.clip(-(np.conj(added) * bare).real / np.maximum(np.abs(added) ** 2, 1e-300), *masses_kg)
        with np.errstate(divide="ignore"):
            return np.asarray(np.abs(at_points(plant.disturbance, s)) / np.abs(bare + mass * added))

    poles = np.concatenate([np.abs(roots(plant.denominator.at(exact(mass)))) for mass in np.linspace(*masses_kg, 9)])
    grid = np.union1d(_GRID, poles[(poles > _GRID[0]) & (poles < _GRID[-1])])
    values = compliance(grid)
    rises = np.diff(values, prepend=-inf) > 0
    tops = np.flatnonzero(rises & np.append(~rises[1:], True))
    best = (float(values.max()), float(grid[values.argmax()]))
    for top in sorted(tops, key=lambda k: -values[k])[:_TOPS]:
        at, spread = grid[top], _FINE
        for _ in range(_TOP_ZOOMS):
            near = at * np.geomspace(1 / spread, spread, _TOP_POINTS)
            found = compliance(near)
            at, spread = near[found.argmax()], spread ** (3 / _TOP_POINTS)
            best = max(best, (float(found.max()), float(at)))
    return Peak(rounded_below(best[0]), best[1] / (2 * pi))


def rounded_below(value: float) -> float:
    """A figure that numerics have found, so much less and of so few digits that it is not above what it stands for."""
    return nearest(shortened(exact(value * (1 - _ROUNDING)), _DIGITS)) if 0 < value < inf else value


def servo_off_of(members: Iterable[VertexModel], inner_end_mass_kg: float, masses_kg: tuple[float, float]) -> Peak:
    """The same of those linear members of a rig that are to perform: the worst of them all."""
    performing = (member for member in members if member.performance is not None)
    return servo_off_peak((member.rig.plant(inner_end_mass_kg) for member in performing), masses_kg)
