"""Any loop with one input and one output, proved: stability, margins and peaks of |S| and |T|, nothing swept.

L = N / D is fed back with unity gain, 1 + L = 0 being the closed loop. A discrete loop is looked at in p with z = (1 +
p) / (1 - p), which takes the inside of the unit circle to the left half plane: there p = j tan(w T / 2). So both kinds
come to polynomials on the imaginary axis, z = -1 being at infinity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from math import inf, isfinite
from typing import Any, TypeVar

from flint import acb, arb, ctx, fmpq, fmpq_mat, fmpq_mpoly, fmpq_poly

from beamdesign.polynomial import (
    Affine,
    bounds,
    even_odd,
    exact,
    is_hurwitz,
    peak,
    real_roots,
    roots,
    rounded_down,
    rounded_up,
    shares_axis_root,
    squared_magnitude,
    tight,
    transfer,
    value_at,
)
from beamdesign.proofs.stability import StabilityMap, stable_ranges
from beamdesign.records import InputError
from beamdesign.result import Result

# The open loop of a system of python-control as exact polynomials, that of a discrete one as well.


P = TypeVar("P", fmpq_poly, fmpq_mpoly)


@dataclass(frozen=True)
class OpenLoop:
    """L = numerator / denominator, exact, in s or in the p of the module's text.

    Attributes:
        numerator: N.
        denominator: D.
        order: number of closed-loop poles, the degree of D in s or z.
        period_s: T of a discrete loop; None for a continuous one.
    """

    numerator: fmpq_poly
    denominator: fmpq_poly
    order: int
    period_s: float | None

    @cached_property
    def characteristic(self) -> fmpq_poly:
        """D + N; its roots are the closed loop's poles."""
        return self.denominator + self.numerator

    @property
    def stable(self) -> bool:
        """Whether all closed-loop poles are stable, and none is at infinity (in z at -1)."""
        return self.characteristic.degree() == self.order and is_hurwitz(self.characteristic)

    @property
    def hidden_at_infinity(self) -> bool:
        """Whether a pole at z = -1 is there at every gain."""
        return max(self.numerator.degree(), self.denominator.degree()) < self.order

    def frequency(self, square: arb) -> arb:
        """The frequency that belongs to x, rad/s."""
        if not square.is_finite():
            return arb.pos_inf() if self.period_s is None else arb.pi() / arb(exact(self.period_s))
        return square.sqrt() if self.period_s is None else 2 * square.sqrt().atan() / arb(exact(self.period_s))

    def unstable_pole(self) -> complex:
        """The pole that is farthest to the wrong side, in rad/s or in z."""
        found = roots(self.characteristic)
        if self.period_s is None:
            return complex(max(found, key=lambda pole: pole.real))
        return complex(max([(1 + p) / (1 - p) if p != 1 else complex(inf) for p in found], key=abs))


def open_loop(system: Any) -> OpenLoop:
    """The exact polynomials of a system of python-control.

    Raises:
        InputError: as `prove`.
    """
    import control

    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise refused(f"expected a TransferFunction or a StateSpace of python-control, not {type(system).__name__}")
    if (system.ninputs, system.noutputs) != (1, 1):
        raise refused(f"has {system.ninputs} inputs and {system.noutputs} outputs; it must have one of each")
    if isinstance(system, control.TransferFunction):
        above, below = (fmpq_poly([number(c) for c in reversed(part[0][0])]) for part in (system.num, system.den))
    else:
        parts = (system.A, system.B, system.C, system.D)
        exactly = (fmpq_mat(len(part), part.shape[1], [*map(number, part.ravel())]) for part in parts)
        (above,), below = transfer(*exactly)
    period_s = period(system.dt)
    n = order(above.degree(), below.degree())
    if period_s is not None:
        above, below = (in_p(part.coeffs(), n, fmpq_poly([0, 1])) for part in (above, below))
    return OpenLoop(above, below, n, period_s)


def order(zeros: int, poles: int) -> int:
    """That of a loop from the degrees of its polynomials.

    Raises:
        InputError: for a denominator of zero, or more zeros than poles.
    """
    if poles < 0:
        raise refused("the denominator is zero")
    if zeros > poles:
        raise refused(f"has more zeros ({zeros}) than poles ({poles}): no real loop has a gain that grows")
    return poles


def in_p(coefficients: Sequence[Any], n: int, p: P) -> P:
    """A polynomial in z, its coefficients from that of 1 up, for z = (1 + p) / (1 - p), times (1 - p)^n."""
    parts = (c * (1 + p) ** k * (1 - p) ** (n - k) for k, c in enumerate(coefficients))
    return sum(parts, 0 * p)


def period(dt: Any) -> float | None:
    """The period of a `dt` of python-control, s; None for a continuous system.

    Raises:
        InputError: for one that is no positive number.
    """
    if dt is None or dt == 0:
        return None
    try:
        seconds = float(dt)
    except (TypeError, ValueError):
        seconds = inf
    if not (isfinite(seconds) and seconds > 0):
        raise refused(f"its period must be a positive number of seconds, is {dt!r}")
    return seconds


def number(value: Any) -> fmpq:
    """A coefficient, exact.

    Raises:
        InputError: for what is no finite real number.
    """
    try:
        return exact(value)
    except (TypeError, ValueError) as error:
        raise refused(f"{value} is not a finite real number") from error


def refused(reason: str) -> InputError:
    """A loop that cannot be looked at."""
    return InputError("loop", [("loop", reason)])


# What is proved of it.


Pair = tuple[float, float]

_BITS = 128
_NOWHERE: Pair = (inf, inf)
_NONE, _ONE, _FAR = fmpq(0), fmpq(1), arb.pos_inf()

SAFE = {
    "gain_increase": "at least", "gain_decrease": "at most", "phase_margin_deg": "at least",
    "delay_margin_s": "at least", "disk_margin": "at least", "peak_sensitivity": "at most",
    "peak_complementary": "at most",
}  # fmt: skip
"""Figures of a loop, and to which side each is safe."""


@dataclass(frozen=True)
class AxisPoint:
    """A frequency at which L is real and negative, or of size one; every figure a pair of bounds.

    Attributes:
        frequency_rad_per_s: where it is.
        gain_factor: factor on L that puts a closed-loop pole there; exactly one where |L| = 1.
        phase_deg: by how much L may lag there until it is -1, between 0 and 360; exactly zero where L is negative.
    """

    frequency_rad_per_s: Pair
    gain_factor: Pair = (1.0, 1.0)
    phase_deg: Pair = (0.0, 0.0)


@dataclass(frozen=True, repr=False)
class ProvedLoop(Result):
    """What is proved of one loop. Each figure is a pair of bounds a few roundings apart, between which it lies.

    Where the loop is not stable there are no margins, and each is None.

    Attributes:
        stable: whether every closed-loop pole is stable, hidden ones included.
        reason: why the answer is no; empty where it is yes.
        period_s: of a discrete loop; None for a continuous one.
        stable_gains: ranges of a positive factor on L in which the loop is stable, ends rounded inwards.
        gain_increase: the least factor above one at which it is not stable; infinite for none.
        gain_decrease: the largest factor below one at which it is not; zero where every one is harmless.
        phase_margin_deg: the least turn of L at a frequency with |L| = 1, either way, that makes it -1.
        delay_margin_s: the least delay that makes it -1; in a discrete loop whole numbers of periods below are safe,
            and nothing is claimed where |L| is one or more at z = -1.
        disk_margin: alpha, 2 / max |S - T|: stable for every factor (1 + d / 2) / (1 - d / 2) on L with |d| < alpha.
        peak_sensitivity: max |S|, S = 1 / (1 + L).
        peak_complementary: max |T|, T = L / (1 + L).
        phase_crossings: all positive factors on L at which a closed-loop pole is on the axis, ascending.
        gain_crossings: all frequencies with |L| = 1, ascending.
        claims: by figure, whether what was claimed of it is proved (True), refuted (False) or too near to tell (None).
    """

    stable: bool
    reason: str
    period_s: float | None
    stable_gains: tuple[Pair, ...]
    gain_increase: Pair | None = None
    gain_decrease: Pair | None = None
    phase_margin_deg: Pair | None = None
    delay_margin_s: Pair | None = None
    disk_margin: Pair | None = None
    peak_sensitivity: Pair | None = None
    peak_complementary: Pair | None = None
    phase_crossings: tuple[AxisPoint, ...] = ()
    gain_crossings: tuple[AxisPoint, ...] = ()
    claims: Mapping[str, bool | None] = field(default_factory=dict)

    @property
    def status(self) -> str:
        """Whether it is stable, and keeps what was claimed."""
        return "yes" if self.yes else "no" if not self.stable or False in self.claims.values() else "undecided"

    def rows(self) -> Sequence[tuple[Any, ...]]:
        """Each figure rounded to its safe side, which that is, and its other bound."""
        pairs = ((name, words, getattr(self, name)) for name, words in SAFE.items())
        return [(n, *((p[0], w, p[1]) if w == "at least" else (p[1], w, p[0]))) for n, w, p in pairs if p is not None]


# What is proved.


def proved(loop: OpenLoop) -> ProvedLoop:
    """All that stands in `ProvedLoop`, but for claims."""
    if loop.hidden_at_infinity:
        return ProvedLoop(False, _why(loop), loop.period_s, ())
    with ctx.workprec(_BITS):
        family = Affine(loop.denominator, loop.numerator)
        below, above = stable_ranges(family, _NONE, _ONE, _BITS), _above_one(family)
        gains = _stable_gains(below, above, loop.stable)
        if not loop.stable:
            return ProvedLoop(False, _why(loop), loop.period_s, gains)
        last, first = below.ranges[-1].opens_at, above.ranges[0].closes_at
        flat = tight(lambda bits: _turns(loop, bits))
        turns = list(zip(flat[::2], flat[1::2], strict=True))
        either_way = [turn.min(2 * arb.pi() - turn) for _, turn in turns]
        n, d, p = loop.numerator, loop.denominator, loop.characteristic
        return ProvedLoop(
            True,
            "",
            loop.period_s,
            gains,
            gain_increase=_NOWHERE if first is None else _floats(first.ends),
            gain_decrease=(0.0, 0.0) if last is None else _floats(last.ends),
            phase_margin_deg=_degrees(reduce(arb.min, either_way)) if turns else _NOWHERE,
            delay_margin_s=_delay(loop, turns),
            disk_margin=_NOWHERE if n == d else _floats(bounds(2 / peak(d - n, p))),
            peak_sensitivity=_floats(bounds(peak(d, p))),
            peak_complementary=_floats(bounds(peak(n, p))),
            phase_crossings=tuple(
                AxisPoint(_pair(loop.frequency(one.squared_frequency)), _floats(one.ends))
                for one in (*below.crossings, *above.crossings)
                if one.ends[0] > 0
            ),
            gain_crossings=tuple(AxisPoint(_pair(w), phase_deg=_degrees(turn)) for w, turn in turns),
        )


def _above_one(family: Affine) -> StabilityMap:
    """The map from the factor one to beyond all crossings."""
    high = fmpq(2)
    while True:
        found = stable_ranges(family, _ONE, high, _BITS)
        beyond = [one.ends[1] for one in (*found.crossings, found.above) if one is not None]
        if max(beyond, default=_NONE) < high:
            return found
        high = fmpq(2 * max(beyond).ceil())


def _stable_gains(below: StabilityMap, above: StabilityMap, joined: bool) -> tuple[Pair, ...]:
    low, high = below.stable_ranges, above.stable_ranges
    if above.ranges[-1].stable:
        high[-1] = high[-1][0], inf
    return (*low[:-1], (low[-1][0], high[0][1]), *high[1:]) if joined else (*low, *high)


def _why(loop: OpenLoop) -> str:
    if loop.hidden_at_infinity or shares_axis_root(Affine(loop.denominator, loop.numerator)):
        return "not stable: L hides a pole on the border of stability that no gain moves"
    if loop.characteristic.degree() < loop.order:
        return (
            "not stable: 1 + L vanishes at infinite frequency, so that a pole is at infinity"
            if loop.period_s is None
            else "not stable: a closed-loop pole is at z = -1"
        )
    pole = loop.unstable_pole()
    at = f"{pole.real:.6g}" + (f" +- {abs(pole.imag):.6g}j" if pole.imag else "")
    return f"not stable: a closed-loop pole at {at}" + (" rad/s" if loop.period_s is None else " in z")


def _turns(loop: OpenLoop, bits: int) -> list[arb] | None:
    """Every frequency with |L| = 1, rad/s and ascending, each followed by the lag in 0 to 2 pi that makes L -1 there.

    At zero and at infinite frequency L is real, so that it is one there and not -1.
    """
    difference = squared_magnitude(loop.numerator) - squared_magnitude(loop.denominator)
    found = [arb(0), arb.pi()] if difference[0] == 0 else []
    for square in [] if difference.is_zero() else [x for x, _ in real_roots(difference, bits) if x > 0]:
        value = _on_axis(loop.numerator, square) / _on_axis(loop.denominator, square)
        if value.real < 0:
            if value.imag.contains(0):
                return None  # not -1, the loop being stable, but too near to tell on which side
            lag = (-value).arg() + (2 * arb.pi() if value.imag > 0 else 0)
        elif value.is_finite():
            lag = arb.pi() + value.arg()
        else:
            return None
        found += [loop.frequency(square), lag]
    # One in the whole of the frequencies is what remains of a difference of zero: the least of its lags stands above.
    return found if difference.is_zero() or difference[loop.order] != 0 else [*found, loop.frequency(_FAR), arb.pi()]


def _on_axis(polynomial: fmpq_poly, square: arb) -> acb:
    even, odd = even_odd(polynomial)
    return acb(value_at(even, square), square.sqrt() * value_at(odd, square))


def _delay(loop: OpenLoop, turns: Sequence[tuple[arb, arb]]) -> Pair:
    """The least lag over frequency.

    Where |L| is one or more at infinite frequency any delay makes poles with positive real parts, ever faster ones. A
    discrete loop with |L| below one at z = -1 keeps its number of unstable poles over whole periods below the least
    lag over frequency: with an arc of that radius L z^-d is a closed curve for every d, which never meets -1.
    """
    if abs(loop.numerator[loop.order]) >= abs(loop.denominator[loop.order]):
        return 0.0, loop.period_s or 0.0
    delays = [lag / frequency for frequency, lag in turns if frequency > 0]
    return _pair(reduce(arb.min, delays)) if delays else _NOWHERE


def _degrees(turn: arb) -> Pair:
    return _pair(turn * 180 / arb.pi())


def _pair(ball: arb) -> Pair:
    return _floats(bounds(ball)) if ball.is_finite() else _NOWHERE


def _floats(ends: tuple[fmpq, fmpq]) -> Pair:
    """Floats at or around two rationals."""
    return rounded_down(ends[0]), rounded_up(ends[1])
