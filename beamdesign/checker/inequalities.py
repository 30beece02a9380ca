"""Inequalities over mass and frequency: magnitudes of a loop, and where their slack is not negative."""

from flint import arb, fmpq, fmpq_poly

from beamdesign.checker.reading import Table, Unreadable, short
from beamdesign.checker.roots import ZERO, Pair, Polynomials, bound, ends, inner, pieces

NONE = fmpq(0)


INEQUALITIES = ("compliance", "peak_sensitivity", "loop_gain", "controller_effort")


def squared(frequency_Hz: fmpq) -> Pair:
    """Bounds of w^2 for a frequency."""
    return ends((2 * arb.pi() * arb(frequency_Hz)) ** 2)


class Bound:
    """What a claim says of a magnitude.

    Attributes:
        kind: of the claim.
        limit: of the magnitude.
        start: least w^2 for which it is claimed.
        until: largest, None where there is no end.
        words: the claim.
    """

    def __init__(self, claim: Table, kind: str):
        self.kind, self.limit = kind, claim.at_least("limit", 0, above=True)
        self.start, self.until, unit, band = NONE, None, "", ""
        if kind.endswith("compliance"):
            unit, band = " m/N", " at every frequency"
            if claim.take("bandwidth_Hz") != "infinite":
                hertz = claim.at_least("bandwidth_Hz", 0)
                self.until, band = squared(hertz)[1], f" up to {short(hertz)} Hz"
        elif kind == "loop_gain":
            hertz = claim.at_least("from_Hz", 0)
            self.start, band = max(squared(hertz)[0], NONE), f" from {short(hertz)} Hz up"
        elif kind == "controller_effort":
            unit = " A/V"
        self.words = f"{kind.replace('_', ' ')} at most {short(self.limit)}{unit}{band}"

    def covers(self, square: fmpq) -> bool:
        """Whether it says something of a w^2."""
        return self.start <= square and (self.until is None or square <= self.until)


def magnitudes(
    kind: str, opened: Polynomials, returned: Polynomials, disturbance: fmpq_poly, law: Polynomials
) -> tuple[Polynomials, Polynomials]:
    """Denominator and numerator of what a claim bounds, each over the mass; `law` is the controller.

    With p = opened + returned: x / F_d = disturbance / p, S = opened / p, L = returned / opened, and C S is
    (opened / law denominator) (law numerator) / p, the controller's denominator being a factor of `opened`; C is from
    the displacement sensor's volts to the current.
    """
    closed = opened[0] + returned[0], opened[1] + returned[1]
    match kind:
        case "compliance":
            return closed, (disturbance, ZERO)
        case "peak_sensitivity":
            return closed, opened
        case "loop_gain":
            return opened, returned
    if any(divmod(part, law[1])[1] != 0 for part in opened):
        raise Unreadable("the controller's poles are not those of the open loop")
    above, below = law
    return closed, (opened[0] / below * above, opened[1] / below * above)


class Slack:
    """limit^2 |denominator|^2 - |numerator|^2 at jw; both polynomials are affine in the mass."""

    def __init__(self, limit: fmpq, denominator: Polynomials, numerator: Polynomials):
        (d0, d1), (n0, n1) = denominator, numerator
        square = limit * limit
        self.coefficients = tuple(
            square * inner(*below) - inner(*above)
            for below, above in (((d1, d1), (n1, n1)), ((2 * d0, d1), (2 * n0, n1)), ((d0, d0), (n0, n0)))
        )

    def at(self, mass: fmpq, square: fmpq) -> fmpq:
        """Its value at one mass and one w^2."""
        a, b, c = (polynomial(square) for polynomial in self.coefficients)
        return (a * mass + b) * mass + c

    def nonnegative(self, low: fmpq, high: fmpq, until: fmpq | None, start: fmpq = NONE) -> bool:
        """Whether it is nowhere negative for masses in [low, high] and start <= w^2 <= until (None: no end).

        Its least value over the mass lies at an end, or at the vertex: the signs of the curvature, of the slope at
        both ends, of the values there and of the discriminant decide. One point settles each interval between the
        roots of all these.
        """
        a, b, c = self.coefficients
        deciding = [a, 2 * a * low + b, 2 * a * high + b]
        deciding += [a * m**2 + b * m + c for m in (low, high)]
        deciding.append(b * b - 4 * a * c)
        if until is None:
            until = max([2 * start + 1, *(bound(q) for q in deciding if q.degree() > 0)])
        points, _ = pieces(deciding, start, until)
        return all(self._nonnegative_at(x, low, high) for x in points)

    def _nonnegative_at(self, x: fmpq, low: fmpq, high: fmpq) -> bool:
        a, b, _ = (polynomial(x) for polynomial in self.coefficients)
        masses = [low, high]
        if a > 0 and low < -b / (2 * a) < high:
            masses.append(-b / (2 * a))
        return all(self.at(mass, x) >= 0 for mass in masses)
