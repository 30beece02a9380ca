"""Margins of the sampled-data loop at one payload, from its polynomials: nothing is swept.

At sample times the loop is that of L(z) = z^-late C(z) P(z), with P the plant under a held current; this is exact. With
p = (2 / T) (z - 1) / (z + 1) the unit circle becomes the imaginary axis, p = j (2 / T) tan(w T / 2), and L a ratio of
polynomials in p. What the continuous loop's polynomials are asked is then asked of these.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import atan, inf, pi

from flint import arb_mat, ctx, fmpq, fmpq_mat, fmpq_poly

from beamdesign.loop import LoopAtMass
from beamdesign.polynomial import exact
from beamdesign.realisation.loop import RealisedLoop
from beamdesign.realisation.realise import Realisation

_BITS = 256
_KEPT_BITS = 80


@dataclass(frozen=True)
class LoopFigures:
    """How far a loop is from instability; one that is not stable has an infinite peak and margins of zero.

    Attributes:
        peak_sensitivity: largest |1 / (1 + L)|.
        gain_up: factor on the gain at which it becomes unstable.
        phase_deg: least phase margin.
        crossover_Hz: highest frequency with |L| = 1.
    """

    peak_sensitivity: float
    gain_up: float
    phase_deg: float
    crossover_Hz: float


def continuous_figures(loop: LoopAtMass) -> LoopFigures:
    """Of a continuous loop at one mass."""
    return _figures(loop, lambda frequency_Hz: frequency_Hz)


def sampled_figures(loop: RealisedLoop[Realisation], mass_kg: float) -> LoopFigures:
    """Of the sampled-data loop at one outer end mass, at its sample times."""
    rate = loop.realisation.rate_Hz
    return _figures(image(loop, mass_kg), lambda frequency_Hz: rate / pi * atan(pi * frequency_Hz / rate))


def _figures(at: LoopAtMass, true_Hz: Callable[[float], float]) -> LoopFigures:
    crossover = true_Hz(max(at.crossovers_Hz(), default=0.0))
    if not at.stable:
        return LoopFigures(inf, 0.0, 0.0, crossover)
    margins = at.margins()
    return LoopFigures(at.peak_sensitivity(), margins.gain_up, margins.phase_deg, crossover)


def image(loop: RealisedLoop[Realisation], mass_kg: float) -> LoopAtMass:
    """The loop in p; of its three polynomials that of the disturbance stands empty.

    The plant's polynomials are those of matrices within 2^-200 of the true ones; coefficients keep 80 bits.
    """
    laws = law_polynomials(loop.realisation)
    with ctx.workprec(_BITS):
        mass = exact(mass_kg)
        moved = loop.plant.moved(mass, mass, loop.realisation.rate_Hz)
        n = loop.plant.a.nrows()
        phi = fmpq_mat(n, n, [_middle(moved, i, j) for i in range(n) for j in range(n)])
        gamma = fmpq_mat(n, 1, [_middle(moved, i, n) for i in range(n)])
        free, seen = phi.charpoly(), loop.plant.readings(loop.realisation.linear.heard)
        bottom, returned = fmpq_poly([1]), fmpq_poly([0])
        for k, (above, below) in enumerate(laws):
            row = fmpq_mat(1, n, [seen[k, j] for j in range(n)])
            fed = (phi + gamma * row).charpoly() - free
            bottom, returned = bottom * below, returned * below + above * fed * bottom
        opened = bottom * free * (fmpq_poly([0, 1]) if loop.delayed else fmpq_poly([1]))
        below, above = _in_p([opened, returned], loop.realisation.rate_Hz)
        return LoopAtMass(below, above, fmpq_poly([0]))


def law_polynomials(realisation: Realisation) -> list[tuple[fmpq_poly, fmpq_poly]]:
    """Numerator and denominator in z of what is made of each reading, coefficients as realised, exact."""
    given = {name: one.value for name, one in realisation.coefficients.items()}
    delta, number, laws = fmpq_poly([-1, 1]), 0, []
    for channel in realisation.channels:
        top, bottom = fmpq_poly([given[channel.gain_name]]), fmpq_poly([1])
        for section in channel.sections:
            number += 1
            f, h = given[f"follow{number}"], given[f"direct{number}"]
            if section.order == 1:
                top, bottom = top * (h * delta + f), bottom * (delta + f)
            else:
                r, k = given[f"damping{number}"], given[f"slope{number}"]
                top = top * (h * delta**2 + k * f * delta + f**2)
                bottom = bottom * (delta**2 + r * f * delta + f**2)
        laws.append((top, bottom))
    return laws


def _middle(balls: arb_mat, i: int, j: int) -> fmpq:
    mantissa, exponent = balls[i, j].mid().man_exp()
    return fmpq(mantissa) * fmpq(2) ** int(exponent)


def _in_p(polynomials: list[fmpq_poly], rate_Hz: float) -> list[fmpq_poly]:
    """Put z = (1 + p T / 2) / (1 - p T / 2) and clear the denominators, of all with the same power."""
    degree = max(polynomial.degree() for polynomial in polynomials)
    half = 1 / (2 * exact(rate_Hz))
    above, below = [fmpq_poly([1])], [fmpq_poly([1])]
    for _ in range(degree):
        above.append(above[-1] * fmpq_poly([1, half]))
        below.append(below[-1] * fmpq_poly([1, -half]))
    found = []
    for polynomial in polynomials:
        total = fmpq_poly([0])
        for k, coefficient in enumerate(polynomial.coeffs()):
            total += coefficient * above[k] * below[degree - k]
        found.append(fmpq_poly([_kept(c) for c in total.coeffs()]))
    return found


def _kept(value: fmpq) -> fmpq:
    """Rounded to `_KEPT_BITS` significant bits: roots of huge rationals would cost seconds and tell no more."""
    if value == 0:
        return value
    places = _KEPT_BITS - (int(value.p).bit_length() - int(value.q).bit_length())
    scaled = value * fmpq(2) ** places
    return fmpq(int(scaled.p) // int(scaled.q)) * fmpq(2) ** -places
