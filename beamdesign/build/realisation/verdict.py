"""A realised controller judged: the law itself, the loop proved as realised, the margin that it costs, its roundings.

A rounding is an input of the linear loop that never exceeds half a step. However the roundings fall, an output then
departs from that of the same law without rounding by at most the sum of absolute impulse responses times half a step
each. No limit cycle of the rounded loop about a point of rest can be larger. It holds as long as no limit is reached.

Margins come from polynomials: nothing is swept. At sample times the loop is that of L(z) = z^-late C(z) P(z), with P
the plant under a held current; this is exact. With p = (2 / T) (z - 1) / (z + 1) the unit circle becomes the imaginary
axis, p = j (2 / T) tan(w T / 2), and L a ratio of polynomials in p. What the continuous loop's polynomials are asked is
then asked of these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import atan, degrees, inf, log10, pi

import numpy as np
from flint import ctx, fmpq, fmpq_mat, fmpq_poly

from beamdesign.build.realisation.law import LinearLaw
from beamdesign.build.realisation.loop import (
    LOOP_BITS,
    RealisedLoop,
    SampledVerdict,
    middle,
    prove_sampled,
    realised_loop,
)
from beamdesign.build.realisation.realise import FLOAT_STEP, Realisation, l1_norms, l2_norms
from beamdesign.build.realisation.sections import laws_of
from beamdesign.controllers import Controller
from beamdesign.loop import LoopAtMass, loop
from beamdesign.polynomial import at_points, exact, nearest
from beamdesign.proofs.mass_family import floats
from beamdesign.prototype import Prototype

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


def sampled_figures(loop: RealisedLoop, mass_kg: float) -> LoopFigures:
    """Of the sampled-data loop at one outer end mass, at its sample times."""
    rate = loop.rate_Hz
    return _figures(image(loop, mass_kg), lambda frequency_Hz: rate / pi * atan(pi * frequency_Hz / rate))


def _figures(at: LoopAtMass, true_Hz: Callable[[float], float]) -> LoopFigures:
    crossover = true_Hz(max(at.crossovers_Hz(), default=0.0))
    if not at.stable:
        return LoopFigures(inf, 0.0, 0.0, crossover)
    margins = at.margins()
    return LoopFigures(at.peak_sensitivity(), margins.gain_up, margins.phase_deg, crossover)


def image(loop: RealisedLoop, mass_kg: float) -> LoopAtMass:
    """The loop in p; of its three polynomials that of the disturbance stands empty.

    The plant's polynomials are those of matrices within 2^-200 of the true ones; coefficients keep 80 bits.
    """
    laws, law = law_polynomials(loop.law), loop.law
    with ctx.workprec(_BITS):
        mass = exact(mass_kg)
        moved = loop.plant.moved(mass, mass, loop.period_s)
        n = loop.plant.a.nrows()
        phi = fmpq_mat(n, n, [moved[i, j].mid().fmpq() for i in range(n) for j in range(n)])
        gamma = fmpq_mat(n, 1, [moved[i, n].mid().fmpq() for i in range(n)])
        free, seen = phi.charpoly(), loop.plant.readings(law.sensed)
        denominator, numerator = law.a.charpoly() * free, fmpq_poly([0])
        for k, (above, _) in enumerate(laws):
            row = fmpq_mat(1, n, [seen[k, j] for j in range(n)])
            numerator += above * ((phi + gamma * row).charpoly() - free)
        if loop.delayed:
            denominator *= fmpq_poly([0, 1])
        below, above = _in_p([denominator, numerator], loop.rate_Hz)
        return LoopAtMass(below, above, fmpq_poly([0]))


def law_polynomials(law: LinearLaw) -> list[tuple[fmpq_poly, fmpq_poly]]:
    """Numerator and denominator in z of what is made of each reading, coefficients as realised, exact.

    With the numerator of c (z - a)^-1 b + d as det(z - a + b c) + (d - 1) det(z - a).
    """
    n, below = law.a.nrows(), law.a.charpoly()
    columns = [fmpq_mat(n, 1, [law.b[i, k] for i in range(n)]) for k in range(len(law.sensed))]
    return [((law.a - b * law.c).charpoly() + (law.d[0, k] - 1) * below, below) for k, b in enumerate(columns)]


def _in_p(polynomials: list[fmpq_poly], rate_Hz: float) -> list[fmpq_poly]:
    """Put z = (1 + p T / 2) / (1 - p T / 2) and clear the denominators, of all with the same power."""
    degree = max(polynomial.degree() for polynomial in polynomials)
    half, found = 1 / (2 * exact(rate_Hz)), []
    above, below = fmpq_poly([1, half]), fmpq_poly([1, -half])
    for polynomial in polynomials:
        terms = (c * above**k * below ** (degree - k) for k, c in enumerate(polynomial.coeffs()))
        found.append(fmpq_poly([_kept(c) for c in sum(terms, fmpq_poly([0])).coeffs()]))
    return found


def _kept(value: fmpq) -> fmpq:
    """Rounded to `_KEPT_BITS` significant bits: roots of huge rationals would cost seconds and tell no more."""
    if value == 0:
        return value
    places = _KEPT_BITS - (int(value.p).bit_length() - int(value.q).bit_length())
    scaled = value * fmpq(2) ** places
    return fmpq(int(scaled.p) // int(scaled.q)) * fmpq(2) ** -places


def rounded_loop(loop: RealisedLoop, mass_kg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The loop at one outer end mass with its roundings as inputs, in floats.

    Returns:
        A, B, C and D of x+ = A x + B u, y = C x + D u; inputs u are the roundings of the law, outputs y the
        displacement of the tip (m), the current (A) computed at the sample, and the error (V).
    """
    mass, law, plant = exact(mass_kg), loop.law, loop.plant
    with ctx.workprec(LOOP_BITS):
        a, moved = loop.matrix(mass), middle(plant.moved(mass, mass, loop.period_s))
    n, late, given, seen = plant.a.nrows(), int(loop.delayed), floats(law.g), floats(plant.readings(law.sensed))
    b, c, d = np.zeros((len(a), given.shape[1])), np.zeros((3, len(a))), np.zeros((3, given.shape[1]))
    if late:
        b[n] = given
    else:
        b[:n] = moved[:n, n : n + 1] @ given
    b[n + late :] = floats(law.f)
    c[0, :n], c[2, :n] = floats(plant.tip)[0], seen[0]
    c[1, :n], c[1, n + late :] = (floats(law.d) @ seen)[0], floats(law.c)[0]
    d[1] = given
    return a, b, c, d


@dataclass(frozen=True)
class RoundingEffect:
    """Of all roundings together, at one outer end mass, at sample times.

    Attributes:
        displacement_m: largest departure of the tip.
        current_A: of the current.
        error_V: of the error.
        expected_displacement_m: root mean square, were the roundings independent and evenly spread.
        expected_current_A: likewise.
    """

    displacement_m: float
    current_A: float
    error_V: float
    expected_displacement_m: float
    expected_current_A: float


def half_steps(realisation: Realisation) -> np.ndarray:
    """(m,) bound of every rounding of a realised law, V, m, Pa or A, for readings within full scale."""
    law = realisation.linear
    if realisation.word_length is not None:
        finer = {"signal": 0, "state": realisation.state_extra}
        places = [
            realisation.current_places if kind == "current" else realisation.places[k] + finer[kind]
            for _, kind, k in law.roundings
        ]
        return 2.0 ** -np.array(places, dtype=float) / 2
    # Floats round by a share of what they hold, which the roundings add to: v = u (|R_e| full scale + |R_v| v).
    n, m, k = len(law.states), len(law.roundings), len(law.sensed)
    rounded = floats(law.rounded)
    inputs = np.hstack([floats(law.b), floats(law.f)])
    norms = l1_norms(floats(law.a), inputs, rounded[:, :n], rounded[:, n:])
    share = FLOAT_STEP / 2
    found = np.linalg.solve(np.eye(m) - share * norms[:, k:], share * norms[:, :k] @ np.array(realisation.full_scales))
    return np.asarray(found)


def rounding_effect(loop: RealisedLoop, mass_kg: float, halves: np.ndarray) -> RoundingEffect:
    """The effect of rounding on the loop at one outer end mass.

    Args:
        loop: of a realised controller.
        mass_kg: on the outer tip.
        halves: bounds of its roundings, as of `half_steps`.

    Raises:
        ValueError: where the loop is not stable.
    """
    a, b, c, d = rounded_loop(loop, mass_kg)
    most = l1_norms(a, b, c, d) @ halves
    spread = l2_norms(a, b * halves, c, d * halves)
    expected = np.sqrt((spread**2).sum(axis=1) / 3)  # an even spread over +-h has the variance h^2 / 3
    return RoundingEffect(*most.tolist(), *expected[:2].tolist())


MASSES_LOOKED_AT = 5


@dataclass(frozen=True)
class LawErrors:
    """What discretising and rounding do to the law alone.

    Attributes:
        coefficient: largest relative error of a rounded coefficient.
        pole: largest relative error of a pole by rounding, as a share of its distance from z = 1.
        static_gain: relative.
        at_Hz: frequency of the next two.
        gain_dB: law as realised over the continuous one there.
        lag_deg: what the law itself lags behind there, without hold and computing.
        hold_lag_deg: what the hold adds, half a period.
        computing_lag_deg: what one period of computing adds.
    """

    coefficient: float
    pole: float
    static_gain: float
    at_Hz: float
    gain_dB: float
    lag_deg: float
    hold_lag_deg: float
    computing_lag_deg: float


@dataclass(frozen=True)
class AtMass:
    """The loop at one outer end mass, computed.

    Attributes:
        outer_end_mass_kg: kg.
        continuous: figures of the design.
        at_once: of the loop as realised, its current put out at the sample.
        late: likewise one period later.
        rounding: effect of rounding where it is late; None where that loop is not stable.
    """

    outer_end_mass_kg: float
    continuous: LoopFigures
    at_once: LoopFigures
    late: LoopFigures
    rounding: RoundingEffect | None


@dataclass(frozen=True)
class Judgement:
    """A realised controller in its loop.

    Attributes:
        law: errors of the law.
        at_once, late: stability over the range, proved or refuted; None where it was not asked.
        masses: figures at the masses looked at.
        reason: why nothing is said about the loop; empty where something is.
        any_time: stability for every computing time up to one period, where that was asked.
    """

    law: LawErrors
    at_once: SampledVerdict | None = None
    late: SampledVerdict | None = None
    masses: tuple[AtMass, ...] = ()
    reason: str = ""
    any_time: SampledVerdict | None = None

    @property
    def proved(self) -> bool | None:
        """Whether the loop is stable in every case that was asked; None where that is open."""
        asked = [self.at_once, self.late] + ([] if self.any_time is None else [self.any_time])
        verdicts = [None if one is None else one.stable for one in asked]
        return False if False in verdicts else None if None in verdicts else True


def judge(
    prototype: Prototype, realisation: Realisation, masses_kg: tuple[float, float], looked_at: int = MASSES_LOOKED_AT
) -> Judgement:
    """Judge a realised controller over a range of outer end masses.

    Args:
        prototype: whose controller was realised.
        realisation: the controller.
        masses_kg: range.
        looked_at: number of masses at which figures are computed, ends included.

    Raises:
        ValueError: for a prototype without a controller.
    """
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    if prototype.effects:
        names = ", ".join(prototype.effects)
        errors = law_errors(prototype.controller, realisation, realisation.rate_Hz / 40)
        return Judgement(errors, reason=f"the sampled loop is not worked out for a prototype with effects ({names})")
    masses = masses_between(masses_kg, looked_at)
    figures = tuple(figures_at(prototype, realisation, mass) for mass in masses)
    crossover = max(at.continuous.crossover_Hz for at in figures) or realisation.rate_Hz / 40
    at_once, late = (prove_sampled(realised_loop(prototype, realisation, late), *masses_kg) for late in (False, True))
    return Judgement(law_errors(prototype.controller, realisation, crossover), at_once, late, figures)


def masses_between(masses_kg: tuple[float, float], count: int) -> tuple[float, ...]:
    """Equally spaced masses, ends included; one where the range is one."""
    return tuple(dict.fromkeys(float(mass) for mass in np.linspace(*masses_kg, count)))


def figures_at(prototype: Prototype, realisation: Realisation, mass_kg: float) -> AtMass:
    """Figures at one outer end mass."""
    loops = [realised_loop(prototype, realisation, late) for late in (False, True)]
    at_once, late = (sampled_figures(one, mass_kg) for one in loops)
    try:
        rounding: RoundingEffect | None = rounding_effect(loops[1], mass_kg, half_steps(realisation))
    except ValueError:
        rounding = None
    return AtMass(mass_kg, continuous_figures(loop(prototype).at(mass_kg)), at_once, late, rounding)


def law_errors(controller: Controller, realisation: Realisation, at_Hz: float) -> LawErrors:
    """Errors of the law as realised against the continuous one, of the reading where gain and phase err most."""
    z, s = np.exp(2j * pi * at_Hz / realisation.rate_Hz), 2j * pi * at_Hz
    a, b, c, d = (floats(getattr(realisation.linear, name)) for name in "abcd")
    made = (c @ np.linalg.solve(z * np.eye(len(a)) - a, b) + d)[0]
    ratios = [
        one * at_points(law.denominator, s) / at_points(law.numerator, s)
        for one, (_, law) in zip(made, laws_of(controller), strict=True)
    ]
    ratio = max(ratios, key=lambda ratio: abs(np.log(ratio)))
    turn = 360 * at_Hz / realisation.rate_Hz
    return LawErrors(
        max(abs(one.error) for one in realisation.coefficients.values()),
        max(_pole_errors(realisation), default=0.0),
        max((realisation.coefficients[one.gain_name].error for one in realisation.channels), key=abs),
        at_Hz,
        20 * log10(abs(ratio)),
        -degrees(float(np.angle(ratio))),
        turn / 2,
        turn,
    )


def _pole_errors(realisation: Realisation) -> list[float]:
    """Of every pole, how far rounding moves it as a share of its distance from z = 1."""
    found: list[float] = []
    given = {name: nearest(one.value) for name, one in realisation.coefficients.items()}
    for number, section in enumerate(realisation.sections, 1):
        follow = given[f"follow{number}"]
        if section.order == 1:
            found.append(abs(follow / section.follow - 1))
            continue
        damping = given[f"damping{number}"]
        asked, made = (np.roots([1, r * f, f * f]) for f, r in ((section.follow, section.damping), (follow, damping)))
        found += [float(np.abs(made - pole).min() / abs(pole)) for pole in asked]
    return found


def worst(figures: Sequence[LoopFigures]) -> LoopFigures:
    """The worst of each figure; the crossover is the highest."""
    return LoopFigures(
        max(one.peak_sensitivity for one in figures),
        min(one.gain_up for one in figures),
        min(one.phase_deg for one in figures),
        max(one.crossover_Hz for one in figures),
    )
