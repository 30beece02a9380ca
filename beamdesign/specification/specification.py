"""The specification of a prototype: what to build, what of it is proved, and how to accept what was built."""

from collections.abc import Callable
from dataclasses import dataclass, field

from beamdesign.loop import loop
from beamdesign.proof.box import box_of, certify_box
from beamdesign.proof.certificate import Certificate
from beamdesign.proof.certifying import certify
from beamdesign.prototype import Prototype
from beamdesign.realisation.loop import realised_loop
from beamdesign.specification.acceptance_bands import AcceptanceAtMass, acceptance_bands
from beamdesign.specification.analogue import AnalogueController, analogue_controllers
from beamdesign.specification.data_folder import DURATION_S, AcceptancePlan, acceptance_plan
from beamdesign.specification.difference_equation import (
    DifferenceEquation,
    difference_equation,
    sensible_rate_Hz,
    upper_break_Hz,
)
from beamdesign.specification.ratings import Ratings, ratings
from beamdesign.specification.sampled_loop import SampledVerdict, prove_sampled
from beamdesign.specification.sensor_need import SensorNeed, sensor_need
from beamdesign.specification.stock_choice import StockChoice, stock_choices
from beamdesign.specification.tolerances import Tolerances, tolerances, why_no_box

STANDARD_GRAVITY = 9.80665
_REFERENCE_N = 100.0
_DELAY_BUDGET = 2000
_TRIES = 3

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class DigitalController:
    """The difference equation and what is proved of the loop with it.

    Attributes:
        equation: its coefficients.
        crossover_Hz: highest frequency with |L| = 1 over the masses looked at.
        at_once: sampled-data loop whose current is put out at the sample; None for a prototype with effects.
        one_period_late: the same put out one whole period later.
        delay_s: one and a half periods: half of the hold, one of computation.
        delay_stable: the continuous law with every pure delay from 0 to `delay_s`, over all masses: proved stable
            (True), refuted (False), undecided (None).
        delay_certificate: text that `beamdesign certify --replay` proves again; empty unless proved.
        reason: why there is no sampled-data verdict; empty where there is.
    """

    equation: DifferenceEquation
    crossover_Hz: float
    at_once: SampledVerdict | None
    one_period_late: SampledVerdict | None
    delay_s: float
    delay_stable: bool | None
    delay_certificate: str = field(repr=False)
    reason: str = ""


@dataclass(frozen=True)
class Specification:
    """Everything; the parts after `certificate` are None where the loop is not stable over the range.

    Attributes:
        prototype: what is specified.
        masses_kg: range of outer end mass.
        certificate: stability, bandwidth and peak sensitivity over the range.
        load_N: reference load of the ratings.
        load_words: where it comes from.
        stock: nearest stock sizes; None where a beam has no geometry.
        tolerances_reason: why no tolerances are proved, in words; empty where they are.
        reason: why there is no specification, in words; empty where there is one.
    """

    prototype: Prototype
    masses_kg: tuple[float, float]
    certificate: Certificate
    load_N: float
    load_words: str
    stock: tuple[StockChoice, ...] | None = None
    ratings: Ratings | None = None
    sensor: SensorNeed | None = None
    analogue: tuple[AnalogueController, ...] = ()
    analogue_reason: str = ""
    digital: DigitalController | None = None
    tolerances: Tolerances | None = None
    tolerances_reason: str = ""
    acceptance: tuple[AcceptanceAtMass, ...] = ()
    plan: AcceptancePlan | None = None
    reason: str = ""


def specify(
    prototype: Prototype,
    masses_kg: tuple[float, float],
    rate_Hz: float | None = None,
    load_N: float | None = None,
    noise_share: float = 0.1,
    duration_s: float = DURATION_S,
    progress: Progress = lambda share, words: None,
) -> Specification:
    """Work out the specification of a prototype.

    Args:
        prototype: with a controller.
        masses_kg: range of outer end mass it is to be built for.
        rate_Hz: sampling rate of the difference equation; chosen where it is None.
        load_N: reference load; else the prototype's largest force, else the weight of the largest payload.
        noise_share: share of the motion that the goal allows, which sensor noise may cause.
        duration_s: of each record of the acceptance test.
        progress: told the share done and what is being done.

    Raises:
        ValueError: without a controller, or for a sampling rate that is too low for it.
        InputError: for effects for which no linear loop stands.
    """
    progress(0.0, "certificate")
    certificate = certify(prototype, *masses_kg)
    load, words = _reference_load(prototype, masses_kg, load_N)
    if not certificate.stable or certificate.guaranteed is None:
        reason = f"not certifiable from {masses_kg[0]:g} to {masses_kg[1]:g} kg: {certificate.reason}"
        return Specification(prototype, masses_kg, certificate, load, words, reason=reason)
    looked_at = tuple(dict.fromkeys((masses_kg[0], sum(masses_kg) / 2, masses_kg[1])))
    progress(0.02, "sections and ratings")
    stock = stock_choices(prototype, masses_kg)
    needed = ratings(prototype, looked_at, load, certificate.guaranteed.bandwidth_Hz)
    sensor = sensor_need(prototype, masses_kg, load, noise_share, lambda text: progress(0.05, text))
    analogue: tuple[AnalogueController, ...] = ()
    why = ""
    try:
        analogue = analogue_controllers(prototype, masses_kg, lambda text: progress(0.12, text))
    except ValueError as error:
        why = str(error)
    progress(0.18, "difference equation")
    digital = digital_controller(prototype, masses_kg, looked_at, rate_Hz)
    unboxed = why_no_box(prototype)
    kept = None
    if not unboxed:
        kept = tolerances(prototype, masses_kg, lambda share, text: progress(0.25 + 0.45 * share, text))
    plan = acceptance_plan(prototype, masses_kg, duration_s)
    expected = acceptance_bands(
        prototype,
        tuple(sorted({*looked_at, *plan.masses_kg})),
        {} if kept is None else kept.specified,
        lambda share, text: progress(0.7 + 0.3 * share, text),
    )
    return Specification(
        prototype, masses_kg, certificate, load, words, stock, needed, sensor, analogue, why, digital, kept, unboxed,
        expected, plan
    )  # fmt: skip


def digital_controller(
    prototype: Prototype, masses_kg: tuple[float, float], looked_at: tuple[float, ...], rate_Hz: float | None
) -> DigitalController:
    """The difference equation; where no rate is asked for, it is raised until the sampled-data loop is proved."""
    assert prototype.controller is not None
    controller = prototype.controller
    closed = loop(prototype)
    crossover = max(max(closed.at(mass).crossovers_Hz(), default=0.0) for mass in looked_at)
    rate = rate_Hz or sensible_rate_Hz(crossover, upper_break_Hz(controller))
    for _ in range(1 if rate_Hz else _TRIES):
        equation = difference_equation(controller, rate)
        verdicts: list[SampledVerdict] = []
        if not prototype.effects:
            verdicts = [prove_sampled(realised_loop(prototype, equation, late), *masses_kg) for late in (False, True)]
        if all(verdict.stable for verdict in verdicts):
            break
        rate = sensible_rate_Hz(1.01 * rate / 40)
    delay = 1.5 * equation.period_s
    at_once, late = verdicts or (None, None)
    reason = "" if verdicts else "not worked out for a prototype with effects"
    stable, proof = None, ""
    if not why_no_box(prototype):
        box = box_of({"outer_end_mass": masses_kg, "delay": (0.0, delay)})
        verdict = certify_box(prototype, box, _DELAY_BUDGET, volumes=False)
        stable, proof = verdict.stable, verdict.certificate if verdict.stable else ""
    return DigitalController(equation, crossover, at_once, late, delay, stable, proof, reason)


def _reference_load(prototype: Prototype, masses_kg: tuple[float, float], asked: float | None) -> tuple[float, str]:
    if asked is not None:
        return asked, "as asked for"
    if prototype.payload.largest_force_N:
        return prototype.payload.largest_force_N, "payload.largest_force_N of the prototype"
    if masses_kg[1] > 0:
        return round(STANDARD_GRAVITY * masses_kg[1], 1), "weight of the largest payload"
    return _REFERENCE_N, "chosen, since the prototype states no load; give one with --load-N"
