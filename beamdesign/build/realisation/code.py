"""The controller as code: realised for a rate and a word length, proved as it is realised, and what that costs.

Margins come from polynomials: nothing is swept. At sample times the loop is that of L(z) = z^-late C(z) P(z), with P
the plant under a held current; this is exact. With p = (2 / T) (z - 1) / (z + 1) the unit circle becomes the imaginary
axis, p = j (2 / T) tan(w T / 2), and L a ratio of polynomials in p. What the continuous loop's polynomials are asked is
then asked of these.
"""

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from math import atan, inf, pi
from pathlib import Path
from typing import Any

import numpy as np
from flint import ctx, fmpq, fmpq_mat, fmpq_poly

from beamdesign.arguments import checked, takes
from beamdesign.build.realisation.c_code import c_files
from beamdesign.build.realisation.loop import (
    RealisedLoop,
    SampledVerdict,
    prove_any_computing_time,
    prove_sampled,
    realised_loop,
)
from beamdesign.build.realisation.realise import (
    LawErrors,
    Realisation,
    RoundingEffect,
    full_scales_of,
    half_steps,
    law_errors,
    realise,
    rounding_effect,
)
from beamdesign.files import write_set
from beamdesign.loop import LoopAtMass, loop
from beamdesign.polynomial import exact, transfer
from beamdesign.progress import Progress, silent
from beamdesign.proofs.any_loop import in_p
from beamdesign.proofs.certifying import stability_over
from beamdesign.proofs.scope import holds_for
from beamdesign.prototype import Prototype
from beamdesign.quantities import FullScale, LargestCurrent, SamplingRate, masses_text
from beamdesign.records import InputError
from beamdesign.result import Result, finite, picked
from beamdesign.structure.arm import left_aside

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


def sampled_figures(loop: RealisedLoop, mass_kg: float) -> LoopFigures:
    """Of the sampled-data loop at one outer end mass, at its sample times."""
    rate = loop.rate_Hz
    return loop_figures(image(loop, mass_kg), lambda frequency_Hz: rate / pi * atan(pi * frequency_Hz / rate))


def loop_figures(at: LoopAtMass, true_Hz: Callable[[float], float] = float) -> LoopFigures:
    """Of a loop at one mass, whose frequencies (Hz) may stand for others."""
    crossover = true_Hz(max(at.crossovers_Hz(), default=0.0))
    if not at.stable:
        return LoopFigures(inf, 0.0, 0.0, crossover)
    margins = at.margins()
    return LoopFigures(at.peak_sensitivity(), margins.gain_up, margins.phase_deg, crossover)


def image(loop: RealisedLoop, mass_kg: float) -> LoopAtMass:
    """The loop in p; of its three polynomials that of the disturbance stands empty.

    The plant's polynomials are those of matrices within 2^-200 of the true ones; coefficients keep 80 bits.
    """
    own = loop.law
    laws, below = transfer(own.a, own.b, own.c, own.d)
    with ctx.workprec(_BITS):
        mass = exact(mass_kg)
        moved = loop.plant.moved(mass, mass, loop.period_s)
        n, seen = loop.plant.a.nrows(), loop.plant.readings(own.sensed)
        phi = fmpq_mat(n, n, [moved[i, j].mid().fmpq() for i in range(n) for j in range(n)])
        gamma = fmpq_mat(n, 1, [moved[i, n].mid().fmpq() for i in range(n)])
        dual = phi.transpose(), seen.transpose(), gamma.transpose()  # from one input to all that is sensed
        plants, free = transfer(*dual, fmpq_mat(1, len(laws)))
        numerator = -sum((law * plant for law, plant in zip(laws, plants, strict=True)), fmpq_poly([0]))
        denominator = below * free * fmpq_poly([0, 1] if loop.delayed else [1])
        degree, p = max(denominator.degree(), numerator.degree()), fmpq_poly([0, 1 / (2 * exact(loop.rate_Hz))])
        both = (in_p(part.coeffs(), degree, p).coeffs() for part in (denominator, numerator))
        under, above = (fmpq_poly([_kept(c) for c in part]) for part in both)
        return LoopAtMass(under, above, fmpq_poly([0]))


def _kept(value: fmpq) -> fmpq:
    """Rounded to `_KEPT_BITS` significant bits: roots of huge rationals would cost seconds and tell no more."""
    if value == 0:
        return value
    places = _KEPT_BITS - (int(value.p).bit_length() - int(value.q).bit_length())
    scaled = value * fmpq(2) ** places
    return fmpq(int(scaled.p) // int(scaled.q)) * fmpq(2) ** -places


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
    return AtMass(mass_kg, loop_figures(loop(prototype).at(mass_kg)), at_once, late, rounding)


def worst(figures: Sequence[LoopFigures]) -> LoopFigures:
    """The worst of each figure; the crossover is the highest."""
    return LoopFigures(
        max(one.peak_sensitivity for one in figures),
        min(one.gain_up for one in figures),
        min(one.phase_deg for one in figures),
        max(one.crossover_Hz for one in figures),
    )


@dataclass(frozen=True, repr=False)
class ProvedCode(Result):
    """A realised controller in its loop: what rate and rounding cost, and what is proved.

    Attributes:
        prototype: whose controller it is.
        outer_end_mass_kg: range over which the loop was to be proved.
        realisation: sections, coefficients, words.
        law: errors of the law.
        at_once, late: stability over the range, proved or refuted; None where it was not asked.
        masses: figures at the masses looked at.
        not_judged: why nothing is said about the loop; empty where something is.
        unstable: why the loop of the continuous law is not stable, where that of the realised one is not judged.
        any_time: stability for every computing time up to one period, where that was asked.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    realisation: Realisation
    law: LawErrors
    at_once: SampledVerdict | None = None
    late: SampledVerdict | None = None
    masses: tuple[AtMass, ...] = ()
    not_judged: str = ""
    any_time: SampledVerdict | None = None
    unstable: str = ""

    @property
    def proved(self) -> bool | None:
        """Whether the loop is stable in every case that was asked; None where that is open."""
        asked = [self.at_once, self.late] + ([] if self.any_time is None else [self.any_time])
        verdicts = [None if one is None else one.stable for one in asked]
        return False if False in verdicts else None if None in verdicts else True

    @property
    def reason(self) -> str:
        """Why there is no code; empty where there is."""
        if self.unstable:
            return f"with the continuous law the loop is not stable: {self.unstable}; no code is written"
        if self.proved or self.not_judged:
            return ""
        verdicts = (
            ("at once", self.at_once),
            ("one period late", self.late),
            ("after any computing time up to one period", self.any_time),
        )
        for answer, how in ((False, "not stable"), (None, "not proved stable")):
            for words, one in verdicts:
                if one is not None and one.stable is answer:
                    return f"with its current put out {words} the loop is {how}: {one.reason}; no code is written"
        return "the loop is not proved stable; no code is written"

    def rows(self) -> list[tuple[str, float]]:
        """What the law itself loses."""
        law = self.law
        return [
            ("largest relative error of a coefficient", law.coefficient),
            ("largest relative shift of a pole by rounding", law.pole),
            (f"gain of the law at {law.at_Hz:.4g} Hz against the continuous one, dB", law.gain_dB),
            ("lag there of the law, degrees", law.lag_deg),
            ("  of the hold", law.hold_lag_deg),
            ("  of one period of computing", law.computing_lag_deg),
        ]

    def loop_rows(self) -> list[tuple[str, float, float, float]]:
        """The worst of the loop at all masses looked at: continuous, put out at once, and one period late."""
        found = [worst([getattr(at, how) for at in self.masses]) for how in ("continuous", "at_once", "late")]
        words = "peak sensitivity", "gain margin, factor", "phase margin, degrees", "highest crossover, Hz"
        return list(zip(words, *map(astuple, found), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign code` writes of it."""
        made = self.realisation
        readings = [
            picked(one, "reading unit") | {"full_scale": scale, "places": places, "sections": len(one.sections)}
            for one, scale, places in zip(made.channels, made.full_scales, made.places, strict=True)
        ]
        asked = "asked integer places error"
        fields = {
            **picked(made, "rate_Hz word_length signal_places current_places full_scale_V largest_current_A sections"),
            "readings": readings,
            "coefficients": {name: picked(one, asked) for name, one in made.coefficients.items()},
            "outer_end_mass_kg": list(self.outer_end_mass_kg),
            "reason": self.reason or self.not_judged,
            **picked(self, "proved law at_once one_period_late=late any_computing_time=any_time masses"),
        }
        return finite(fields)

    def notes(self) -> tuple[str, ...]:
        """Lines on the loop for the head of the header."""
        if self.not_judged:
            return (f"Its loop is not proved: {self.not_judged}.",)
        where = masses_text(self.outer_end_mass_kg)
        if not self.proved:
            return (f"Its loop is not proved for {where} on the outer tip.",)
        when = "at its sample or one whole period later" if self.any_time is None else "at any time within a period"
        return (
            f"Proved stable for {where} on the outer tip, with these coefficients, the current held, put out",
            f"{when}, at every sample alike, {holds_for(self.prototype)}. Roundings and limits are no part of",
            "that proof.",
            *([f"It is proved with {words}."] if (words := left_aside(self.prototype)) else ()),
        )

    def write(self, folder: Path) -> list[Path]:
        """Write the C files, all of them or none; their paths.

        Raises:
            OSError: where one cannot be written.
        """
        texts = c_files(self.realisation, self.prototype.name, self.notes())
        return list(write_set(folder, {file: (file, text) for file, text in texts.items()}).values())


@takes("Prototype")
def code(
    prototype: Prototype,
    rate_Hz: float,
    outer_end_mass_kg: tuple[float, float] | None = None,
    word_length: int | None = 32,
    full_scale_V: float = 10.0,
    largest_current_A: float | None = None,
    any_computing_time: bool = False,
    progress: Progress = silent,
) -> ProvedCode:
    """Realise the controller of a prototype as C code, and prove the loop with it.

    Args:
        prototype: with a controller.
        rate_Hz: sampling rate.
        outer_end_mass_kg: range over which to prove it; else the prototype's payload, or none.
        word_length: bits of a fixed-point word with its sign; None for floats of 32 bits.
        full_scale_V: largest error.
        largest_current_A: limit; else the valve's rated current, or the gain times the full scale.
        any_computing_time: prove it for every computing time up to one period as well, the same at every sample.
        progress: called with the share done and what is being done.

    Raises:
        InputError: without a controller, for one that cannot be realised so, or for figures that are not plausible; for
            any computing time of a prototype with effects, of whose sampled loop nothing is proved.
        ValueError: for an empty range.
    """
    if prototype.controller is None:
        raise InputError(prototype.name, [("controller", "missing")])
    checked(prototype.name, "rate_Hz", SamplingRate, rate_Hz)
    checked(prototype.name, "full_scale_V", FullScale, full_scale_V)
    if largest_current_A is None:
        limit = prototype.actuator.largest_current_A(prototype)
    else:
        (limit,) = checked(prototype.name, "largest_current_A", LargestCurrent, largest_current_A)
    if any_computing_time and prototype.effects:
        raise InputError(prototype.name, [("any_computing_time", f"is not proved here: {_without(prototype)}")])
    own = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    masses = prototype.asked_kg(own if outer_end_mass_kg is None else outer_end_mass_kg)
    try:
        scales = full_scales_of(prototype, full_scale_V)
        made = realise(prototype.controller, rate_Hz, word_length, full_scale_V, limit, full_scales=scales)
    except ValueError as error:
        raise InputError(prototype.name, [("controller", str(error))]) from error
    found = judge(prototype, made, masses)
    if any_computing_time and found.proved:
        found = replace(found, any_time=prove_any_computing_time(realised_loop(prototype, made), *masses, progress))
    return found


def _without(prototype: Prototype) -> str:
    """Why nothing is proved of the sampled loop of a prototype with effects, in words."""
    return f"the sampled loop is not worked out for a prototype with effects ({', '.join(prototype.effects)})"


def judge(
    prototype: Prototype, realisation: Realisation, masses_kg: tuple[float, float], looked_at: int = 5
) -> ProvedCode:
    """Judge a realised controller over a range of outer end masses.

    Args:
        prototype: whose controller was realised.
        realisation: the controller.
        masses_kg: range.
        looked_at: number of masses at which figures are computed, ends included.

    Raises:
        ValueError: for a prototype without a controller.
    """
    controller = prototype.own_controller
    if prototype.effects:
        reason = _without(prototype)
        errors = law_errors(controller, realisation, realisation.rate_Hz / 40)
        found = stability_over(prototype, *masses_kg, as_far=True)
        return ProvedCode(prototype, masses_kg, realisation, errors, not_judged=reason, unstable=found.reason)
    figures = tuple(figures_at(prototype, realisation, mass) for mass in masses_between(masses_kg, looked_at))
    crossover = max(at.continuous.crossover_Hz for at in figures) or realisation.rate_Hz / 40
    at_once, late = (prove_sampled(realised_loop(prototype, realisation, late), *masses_kg) for late in (False, True))
    errors = law_errors(controller, realisation, crossover)
    return ProvedCode(prototype, masses_kg, realisation, errors, at_once, late, figures)
