"""Upper bounds of integrals of absolute impulse responses over a range of masses, in balls.

A response is a sum of exponentials. Over a step from t to t + h it is its value and slope at t to within h^2 / 2 times
what bounds its second derivative, so that its integral is at most that of the straight line and h^3 / 6 times that
bound; the step follows the response as it dies down. What is left at the end counts without regard to signs. From a
mass M to m, p = p0 + m p1 multiplies the response by 1 / (1 + (m - M) p1 / p(M)), whose terms are bounded alike.
"""

from collections.abc import Sequence
from typing import Any

from flint import acb, acb_mat, acb_poly, arb, ctx, fmpq, fmpq_poly

from beamdesign.checker.roots import Pair, Polynomials, ends
from beamdesign.checker.work import Unreadable, of_roots, spend

MOST_PIECES = 2000
MOST_STEPS = 4_000_000
"""Of all pieces together."""
LEFT = fmpq(1, 500)
"""At the end, over what has been summed up."""
FINE = fmpq(1, 200)
"""Of a step, what the second derivative may add over the absolute exponentials; made less while it adds up to more than
a share of the whole."""
MOST_BENT = fmpq(1, 100)
SHORTEST = fmpq(1, 2**40)
PRECISION_BITS = 96
AT_ONCE = 16
"""Steps of one length."""


def integrals(numerators: Sequence[fmpq_poly], closed: Polynomials, masses: Pair, pieces: int) -> list[fmpq]:
    """For each numerator a bound of the absolute integral of numerator / (p0 + m p1) at every mass of a range.

    Raises:
        Unreadable: where a piece of the range is too long, or the responses too slow.
    """
    reach = (masses[1] - masses[0]) / (2 * pieces)
    found, steps = [fmpq(0) for _ in numerators], MOST_STEPS
    for k in range(pieces):
        at = closed[0] + (masses[0] + (2 * k + 1) * reach) * closed[1]
        with ctx.workprec(PRECISION_BITS):
            response = _Response([*numerators, closed[1]], at)
            *own, share = response.integrals(steps)
        steps -= response.steps
        left = 1 - reach * share
        if left <= 0:
            raise Unreadable("a piece of the masses is too long to say anything of all of it")
        found = [max(one, other / left) for one, other in zip(found, own, strict=True)]
    return found


class _Response:
    """Impulse responses of several numerators over one denominator.

    Attributes:
        steps: that were needed.
    """

    def __init__(self, numerators: Sequence[fmpq_poly], denominator: fmpq_poly) -> None:
        self.steps, degree = 0, denominator.degree()
        if max(one.degree() for one in numerators) > degree:
            raise Unreadable("an error that is differentiated")
        self._straight = [abs(arb(one[degree] / denominator[degree])) for one in numerators]
        slope = acb_poly(denominator.derivative())
        self._poles, places = list[acb](), list[acb]()
        spend(of_roots(denominator))
        roots: list[Any] = denominator.complex_roots()
        for root, count in roots:
            if count > 1 or not root.real < 0:
                raise Unreadable("poles that coincide, or are not stable")
            if not root.imag < 0:
                self._poles.append(root)
                places.append(acb(slope(root)) * (1 if root.imag == 0 else fmpq(1, 2)))
        # at a root the part that passes straight through adds nothing
        self._weights = [[acb_poly(one)(p) / below for p, below in zip(self._poles, places, strict=True)]
                         for one in numerators]  # fmt: skip

    def integrals(self, most: int) -> list[fmpq]:
        """Bounds of the absolute integrals, what passes straight through included."""
        fine = FINE
        while True:
            sums, bent = self._summed(fine, most)
            if all(bool(off <= total * arb(MOST_BENT)) for off, total in zip(bent, sums, strict=True)):
                whole = (a + b + c for a, b, c in zip(sums, bent, self._straight, strict=True))
                return [ends(one)[1] for one in whole]
            fine /= 4

    def _summed(self, fine: fmpq, most: int) -> tuple[list[arb], list[arb]]:
        """Sums over straight lines, with what is left at the end, and what the bends may add."""
        count, poles = len(self._poles), self._poles
        shown = acb_mat([w for row in self._weights for w in (row, [a * p for a, p in zip(row, poles, strict=True)])])
        sizes = [[abs(a) for a in row] for row in self._weights]
        bends = [[size * abs(p) ** 2 for size, p in zip(row, poles, strict=True)] for row in sizes]
        sums, bent, time = [arb(0) for _ in sizes], [arb(0) for _ in sizes], fmpq(0)
        while True:
            now = [(p * arb(time)).exp() for p in poles]
            fallen = [abs(one) for one in now]
            size = [_along(row, fallen) for row in sizes]
            left = [_along(row, [f / abs(p.real) for f, p in zip(fallen, poles, strict=True)]) for row in sizes]
            if time > 0 and all(bool(a <= s * arb(LEFT)) for a, s in zip(left, sums, strict=True)):
                return [a + b for a, b in zip(sums, left, strict=True)], bent
            bend, step = [_along(row, fallen) for row in bends], fmpq(1)
            while not all(bool(b * arb(step * step / 6) <= a * arb(fine)) for a, b in zip(size, bend, strict=True)):
                step /= 2
                if step < SHORTEST:
                    raise Unreadable("the responses are too fast to be summed up")
            spend(100 + 30 * count + AT_ONCE * (len(sums) * (5 + count / 2) + count))
            turned = [(p * arb(step)).exp() for p in poles]
            for _ in range(AT_ONCE):
                values = shown * acb_mat(count, 1, now)
                for k in range(len(sums)):
                    sums[k] += _straight_line(values[2 * k, 0].real, values[2 * k + 1, 0].real, step)
                now = [a * b for a, b in zip(now, turned, strict=True)]
            bent = [total + one * arb(AT_ONCE * step**3 / 6) for total, one in zip(bent, bend, strict=True)]
            time += AT_ONCE * step
            self.steps += AT_ONCE
            if self.steps > most:
                raise Unreadable("the responses are too slow to be summed up")


def _along(one: Sequence[arb], other: Sequence[arb]) -> arb:
    return sum((a * b for a, b in zip(one, other, strict=True)), arb(0))


def _straight_line(start: arb, slope: arb, step: fmpq) -> arb:
    """A bound of the integral of |start + slope u| over u from none to a step."""
    end = start + slope * arb(step)
    a, b = abs(start), abs(end)
    return ((a * a + b * b) / (a + b) if start * end < 0 else a + b) * arb(step / 2)
