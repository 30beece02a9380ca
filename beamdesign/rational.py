"""Rationals at the border of a proof: bounds of balls, simple numbers in a gap, text without loss, safe rounding."""

from math import inf, nextafter

from flint import arb, fmpq


def bounds(ball: arb) -> tuple[fmpq, fmpq]:
    """The least and the largest number of a finite ball, exactly, whatever the working precision."""
    middle, radius = ball.mid().fmpq(), ball.rad().fmpq()
    return middle - radius, middle + radius


def simple_between(low: fmpq, high: fmpq) -> fmpq:
    """A decimal of few digits strictly between two rationals, near their middle.

    Raises:
        ValueError: where nothing lies between.
    """
    if not low < high:
        raise ValueError(f"nothing lies between {low} and {high}")
    middle = (low + high) / 2
    step = fmpq(1)
    while step * 10 < high - low:
        step *= 10
    while True:
        candidate = ((middle / step) + fmpq(1, 2)).floor() * step
        if low < candidate < high:
            return fmpq(candidate)
        step /= 10


def text(value: fmpq) -> str:
    """A decimal where the rational has a short one, otherwise the quotient p/q; both read back exactly."""
    denominator, twos, fives = int(value.q), 0, 0
    while denominator % 2 == 0:
        denominator, twos = denominator // 2, twos + 1
    while denominator % 5 == 0:
        denominator, fives = denominator // 5, fives + 1
    places = max(twos, fives)
    if denominator != 1 or places > 40:
        return f"{value.p}/{value.q}"
    digits = str(abs(int(value.p)) * 10**places // int(value.q)).rjust(places + 1, "0")
    sign = "-" if value < 0 else ""
    return sign + (f"{digits[:-places]}.{digits[-places:]}" if places else digits)


def shortened(value: fmpq, digits: int, up: bool = False) -> fmpq:
    """A positive rational rounded down, or up, to a decimal of so many significant digits."""
    step = fmpq(1)
    while step * 10**digits <= value:
        step *= 10
    while step * 10 ** (digits - 1) > value:
        step /= 10
    steps = value / step
    return (steps.ceil() if up else steps.floor()) * step


def rounded_down(value: fmpq) -> float:
    """The largest float that is not above a rational."""
    near = nearest(value)
    return near if fmpq(*near.as_integer_ratio()) <= value else nextafter(near, -inf)


def rounded_up(value: fmpq) -> float:
    """The least float that is not below a rational."""
    return 0.0 - rounded_down(-value)  # no minus before a zero


def nearest(value: fmpq) -> float:
    """The float nearest to a rational: the way back from `beamdesign.polynomial.exact`."""
    return int(value.p) / int(value.q)  # a quotient of whole numbers is rounded once, to the nearest float
