"""The open loop of a system of python-control as exact polynomials, that of a discrete one as well.

A discrete loop is looked at in p with z = (1 + p) / (1 - p), which takes the inside of the unit circle to the left half
plane: there p = j tan(w T / 2). So both kinds come to polynomials on the imaginary axis, z = -1 being at infinity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from typing import Any, TypeVar

from flint import arb, fmpq, fmpq_mat, fmpq_mpoly, fmpq_poly

from beamdesign.polynomial import exact, is_hurwitz, roots
from beamdesign.records import InputError

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
        a, b, c, d = (_matrix(part) for part in (system.A, system.B, system.C, system.D))
        below = a.charpoly()
        # c (s - a)^-1 b + d = (det(s - a + b c) + (d - 1) det(s - a)) / det(s - a)
        above = ((a - b * c).charpoly() if a.nrows() else below) + (d[0, 0] - 1) * below
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


def _matrix(values: Any) -> fmpq_mat:
    rows, columns = values.shape
    return fmpq_mat(rows, columns, [number(value) for value in values.ravel()])
