"""Roots of plain(s) + late(s) exp(-s T) in the right half plane, by the direct method of Walton and Marshall (1987).

As the delay grows from none, roots cross the axis only at jw with |plain(jw)| = |late(jw)|, where
W(w^2) = |plain(jw)|^2 - |late(jw)|^2 vanishes, at the delays that give exp(-jwT) the angle of -plain / late; whichever
of these it is, a pair moves to the right where W grows with w^2 and to the left where it falls.
"""

from typing import Any

from flint import acb, arb, fmpq, fmpq_poly

from beamdesign.checker.roots import S, bound, halve, inner, isolate, parts, pieces, square_free

_HALVINGS = 300


def unstable_roots(plain: fmpq_poly, late: fmpq_poly, delay: fmpq) -> int | None:
    """How many roots have a positive real part, the degree of `late` being the lower one.

    None where a root is on the axis, or too near to it to be told from one.
    """
    count = 0
    roots: list[Any] = (plain + late).complex_roots()
    for root, multiplicity in roots:
        if root.real.contains(0):
            return None
        count += multiplicity if root.real > 0 else 0
    if delay == 0 or late == 0:
        return count
    difference = inner(plain, plain) - inner(late, late)
    common = square_free(difference)
    if common(0) == 0:
        common = common / S
    if common.degree() < 1:
        return count
    most = bound(common)
    samples, _ = pieces([difference], fmpq(0), most)
    for found, before, after in zip(isolate(common, fmpq(0), most), samples, samples[1:], strict=False):
        grows = int(difference(after) > 0) - int(difference(before) > 0)
        interval = found
        for _ in range(_HALVINGS):
            crossed = _crossings(plain, late, delay, *interval)
            if crossed is not None:
                break
            interval = halve(common, interval)
        else:
            return None
        count += 2 * grows * crossed
    return count


def _crossings(plain: fmpq_poly, late: fmpq_poly, delay: fmpq, low: fmpq, high: fmpq) -> int | None:
    """How often the root at a w^2 between two numbers crosses as the delay grows; None where they are too far apart.

    It does where w T is the angle a of -late / plain plus a multiple of 2 pi, for 0 < T <= delay.
    """
    middle = arb((low + high) / 2)
    square = middle + arb(0, (arb((high - low) / 2)).upper())
    if not square > 0:
        return None
    w = square.sqrt()

    def on_axis(polynomial: fmpq_poly) -> acb:
        even, odd = parts(polynomial)
        return acb(_value(even, square), w * _value(odd, square))

    below = on_axis(plain)
    if below.contains(0):
        return None
    ratio = -on_axis(late) / below
    angle = ratio.arg() if ratio.real > 0 else (-ratio).arg() + arb.pi()
    turn = 2 * arb.pi()
    start, end = (-angle / turn).floor().unique_fmpz(), ((w * delay - angle) / turn).floor().unique_fmpz()
    return None if start is None or end is None else int(end - start)


def _value(polynomial: fmpq_poly, at: arb) -> arb:
    total = arb(0)
    for c in reversed(polynomial.coeffs()):
        total = total * at + arb(c)
    return total
