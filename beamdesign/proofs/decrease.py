"""What a Lyapunov function V = x' P(m) x must satisfy while the mass changes, as exact inequalities.

**Mass that comes and goes.** Let W = M_m + m be the mass at the outer tip, v its velocity against the base, F the force
on it. Mass that joins with the velocity u relative to the tip adds the momentum u dm, so W v' = F + m' u (Meshchersky);
it is neither W v' = F nor (W v)' = F by itself. Displacements never jump. Two cases bound what a gripper does:

- *matched*: payload joins and leaves with the tip's own velocity, u = 0, so W v' = F and v is continuous. Mass that is
  let go always leaves like this.
- *from rest*: payload is at rest when it joins, u = -v, so (W v)' = F. A sudden pick-up keeps the momentum, and v jumps
  to v (M_m + m1) / (M_m + m2).

Payload that moves with a part of the tip's velocity, u = -theta v with theta in [0, 1], is an average of the two.

**The inequality.** With A(m) = fixed + inertial / W and D = e e' picking out v, and m' = rate,

    dV/dt = x' [A' P + P A + rate dP/dm - theta (rate / W) (D P + P D)] x,

so that -W (dV/dt + 2 decay V) is a polynomial in m whose matrix coefficients are linear in those of P. The rate enters
linearly on each side of zero and theta linearly, so their extremes suffice; m is settled by Bernstein coefficients.

**Sudden pick-ups from rest.** J' P J <= P for all small jumps J would need P to leave v uncoupled from all other
states, which feedback does not allow in general. Their growth of V is bounded by a factor instead, to be made up for by
the decrease in the time between them.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations
from operator import mul
from typing import Any, Literal

from flint import arb, ctx, fmpq, fmpq_mat

from beamdesign.proofs.frames import control_value
from beamdesign.proofs.mass_family import Families, MassFamily

# Definiteness of symmetric rational matrices, and of matrix polynomials on an interval, decided exactly.


DEEPEST = 10
"""Halvings of an interval after which `not_positive_on` gives up."""


def not_positive(matrix: fmpq_mat) -> str:
    """Why a matrix is not positive definite, in words; empty where it is proved to be, in rationals.

    Sylvester's criterion: all leading principal minors are positive. A semidefinite matrix is not positive definite:
    its first vanishing minor is named.

    Args:
        matrix: square, rational.
    """
    if matrix != matrix.transpose():
        return "the matrix is not symmetric"
    # The pivots without fractions are these minors, over one positive denominator, until rows change places at a zero.
    rows, _, _, upper = matrix.numer_denom()[0].fflu()
    for k in range(matrix.nrows()):
        minor = upper[k, k] if rows[k, k] == 1 else 0
        if minor <= 0:
            return f"leading minor {k + 1} of {matrix.nrows()} is {'zero' if minor == 0 else 'negative'}"
    return ""


def bernstein(coefficients: Sequence[Any], low: Any, high: Any) -> list[Any]:
    """Bernstein coefficients on [low, high] of sum over k of coefficients[k] m^k.

    On the interval the polynomial is a convex combination of them; the first and the last are its values at the ends.
    Works alike on numbers, arrays and rational matrices; `low` and `high` are rationals or floats to match.
    """
    degree, none = len(coefficients) - 1, coefficients[0] * 0
    shares = ([control_value(low, high, k, degree, i) for k in range(degree + 1)] for i in range(degree + 1))
    return [sum((p * share for p, share in zip(coefficients, own, strict=True)), none) for own in shares]


def not_positive_on(coefficients: Sequence[fmpq_mat], low: fmpq, high: fmpq, deepest: int = DEEPEST) -> str:
    """Why sum over k of coefficients[k] m^k is not positive definite for every m in [low, high]; empty where it is.

    Positive definite Bernstein coefficients prove it; where they are not, the interval is halved. An end of a piece
    at which the matrix itself is not positive definite refutes it.

    Args:
        coefficients: symmetric matrices, ascending in m.
        low: least m.
        high: most m, above `low`.
        deepest: number of halvings after which the answer is no, for lack of a proof.
    """
    values = bernstein(coefficients, low, high)
    for value, place in ((values[0], low), (values[-1], high)):
        if wrong := not_positive(value):
            return f"at {float(place):.6g}: {wrong}"
    if not any(map(not_positive, values[1:-1])):
        return ""
    if deepest == 0:
        return f"no proof between {float(low):.6g} and {float(high):.6g} after all halvings"
    middle = (low + high) / 2
    below = not_positive_on(coefficients, low, middle, deepest - 1)
    return below or not_positive_on(coefficients, middle, high, deepest - 1)


# The inequality.


Joining = Literal["matched", "from_rest"]
"""How payload joins: with the tip's velocity, or with any velocity from rest to the tip's."""

ZERO = fmpq(0)


@dataclass(frozen=True)
class Sought:
    """What is asked of V = x' P(m) x between two masses.

    Attributes:
        families: the closed loop with each stage, along each of which V is to fall.
        low: kg.
        high: kg.
        degree: of P in m; 0 for a common P, which settles all matched changes.
        rate: bound on |dm/dt|, kg/s; zero for a mass that stays.
        joining: how payload joins.
        decay: 1/s, V falls as exp(-2 decay t).
    """

    families: Families
    low: fmpq
    high: fmpq
    degree: int = 0
    rate: fmpq = ZERO
    joining: Joining = "matched"
    decay: fmpq = ZERO

    @property
    def extremes(self) -> tuple[tuple[int, int], ...]:
        """Signs of the rate and shares theta that bound all changes of this kind; mass leaves matched."""
        if not self.rate:
            return ((0, 0),)
        return ((1, 0), (-1, 0)) if self.joining == "matched" else ((1, 0), (-1, 0), (1, 1))


def decrease(
    loop: Any, coefficients: Iterable[Any], decay: Any, rate: Any, resting: int, times: Callable[[Any, Any], Any] = mul
) -> list[Any]:
    """Coefficients in m, ascending, of -W (dV/dt + 2 decay V); see the head of this file.

    Args:
        loop: a `MassFamily`, or what has its `fixed`, `inertial`, `pick` and `bare_mass` in floats.
        coefficients: P_k of P(m), ascending; rational matrices or (batches of) arrays.
        decay: 1/s.
        rate: dm/dt, kg/s, signed.
        resting: theta, 1 where the payload joins from rest.
        times: what multiplies matrices.
    """

    def both(left: Any, p: Any) -> Any:
        return times(left.transpose(), p) + times(p, left)

    coefficients = [*coefficients]
    total = [coefficients[0] * (decay * 0)] * (len(coefficients) + 1)
    for k, p in enumerate(coefficients):
        constant = both(loop.fixed, p) + p * (2 * decay)
        total[k + 1] = total[k + 1] - constant
        total[k] = total[k] - constant * loop.bare_mass - both(loop.inertial, p) - p * (rate * k)
        if resting:
            total[k] = total[k] + both(loop.pick, p) * rate
        if k:
            total[k - 1] = total[k - 1] - p * (rate * k * loop.bare_mass)
    return total


def not_falling(sought: Sought, coefficients: Sequence[fmpq_mat]) -> str:
    """Why V = x' P(m) x does not fall as is asked of it, with P(m) as it is here, ascending in m.

    In words, empty where it does; of a P that is free of m that is for any matched change however fast: dP/dm is zero.
    """
    if wrong := not_positive_on(coefficients, sought.low, sought.high):
        return f"P(m) is not positive definite: {wrong}"
    for k, family in enumerate(sought.families, start=1):
        for sign, resting in sought.extremes:
            falling = decrease(family, coefficients, sought.decay, sign * sought.rate, resting)
            if wrong := not_positive_on(falling, sought.low, sought.high):
                return f"V does not decrease{f' with stage {k}' if len(sought.families) > 1 else ''} {wrong}"
    return ""


def jump(family: MassFamily, share: fmpq) -> fmpq_mat:
    """The map of the state at a sudden change of mass: the velocity keeps `share` of itself."""
    n = family.order
    return fmpq_mat(n, n, [int(i == j) for i in range(n) for j in range(n)]) - family.pick * (1 - share)


Change = tuple[fmpq_mat, fmpq_mat]
"""P before a sudden change, and J' P J of P after it, by which V goes on from the state before it."""


def changes_of_payload(sought: Sought, coefficients: Sequence[fmpq_mat]) -> list[Change]:
    """The extremes of sudden changes between any two masses of the range.

    J(r)' P(m2) J(r) <= factor P(m1) is convex in the share r of velocity that is left and, for P affine in m, affine in
    both masses: the extremes suffice. All r are allowed for all pairs of masses, which is more than can happen.

    Raises:
        ValueError: where P(m) is of higher degree than one.
    """
    family = sought.families[0]
    least = (family.bare_mass + sought.low) / (family.bare_mass + sought.high)
    jumps = [jump(family, share) for share in ((fmpq(1),) if sought.joining == "matched" else (fmpq(1), least))]
    ends = _at_ends(sought, coefficients)
    return [(before, j * after * j) for before in ends for after in ends for j in jumps]


def changes_of_stage(sought: Sought, functions: Sequence[Sequence[fmpq_mat]]) -> list[Change]:
    """The extremes of changes between any two stages, each with its own P(m) affine in m, at a mass that stays.

    Raises:
        ValueError: where some P(m) is of higher degree than one.
    """
    pairs = permutations((_at_ends(sought, function) for function in functions), 2)
    return [change for before, after in pairs for change in zip(before, after, strict=True)]


def _at_ends(sought: Sought, coefficients: Sequence[fmpq_mat]) -> list[fmpq_mat]:
    if len(coefficients) > 2:
        raise ValueError("jumps are settled for P affine in m alone")
    masses = sought.low, sought.high
    return [sum((p * m**k for k, p in enumerate(coefficients)), coefficients[0] * 0) for m in masses]


def grows_beyond(changes: Sequence[Change], factor: fmpq) -> str:
    """Why not every one of some sudden changes multiplies V by less than `factor`, in words; empty where each does."""
    wrong = next(filter(None, (not_positive(before * factor - after) for before, after in changes)), "")
    return wrong and f"V grows by more than {float(factor):.6g} at a jump: {wrong}"


def dwell_suffices(dwell: fmpq, factor: fmpq, decay: fmpq) -> bool:
    """Whether exp(-2 decay dwell) factor < 1, by ball arithmetic: V shrinks over a dwell and the jump at its end."""
    with ctx.workprec(128):
        return bool(arb(factor).log() < arb(2 * decay * dwell))
