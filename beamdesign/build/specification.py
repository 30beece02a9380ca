"""The specification of a prototype: what to build, what of it is proved, and how to accept what was built."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, ROUND_FLOOR
from math import floor, log10
from typing import Any

from beamdesign.arguments import checked, takes
from beamdesign.build.acceptance import AcceptanceAtMass, AcceptancePlan, acceptance, acceptance_plan
from beamdesign.build.analogue import AnalogueController, analogue_controllers
from beamdesign.build.ratings import KEPT, Ratings, SensorNeed, StockChoice, ratings, sensor_need, stock_choices
from beamdesign.build.realisation.law import DifferenceEquation, difference_equation
from beamdesign.build.realisation.loop import SampledVerdict, prove_sampled, realised_loop
from beamdesign.build.realisation.sections import sensible_rate_Hz, upper_break_Hz
from beamdesign.build.tolerances import LARGEST, Tolerances, tolerances, why_no_box
from beamdesign.loop import loop
from beamdesign.plant.members import STANDARD_GRAVITY
from beamdesign.progress import Progress, part_of, silent
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.certificate import Certificate, Guaranteed
from beamdesign.proofs.certifying import certify, worst_of
from beamdesign.proofs.lyapunov import Switching, switching
from beamdesign.proofs.mass_family import stage_families
from beamdesign.proofs.scope import holds_for
from beamdesign.proofs.tolerance_box import box_with_effects
from beamdesign.prototype import InStage, Prototype
from beamdesign.quantities import Force, SamplingRate, Share, decimal, masses_text, stated_bandwidth, stated_peak
from beamdesign.records import InputError
from beamdesign.result import Result
from beamdesign.synthesis.design_run import DesignRun

_REFERENCE_N = 100.0
_DELAY_BUDGET = 2000
_TRIES = 3


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
    delay_certificate: str = field(repr=False, compare=False)
    reason: str = ""


@dataclass(frozen=True)
class LawSpecification:
    """How a law is realised, and what is to be measured while it acts; a fixed law is the only one.

    The parts after `certificate` are None or empty where not every loop is stable over its range, and but for
    `acceptance` where a design run is specified.

    Attributes:
        stage: the prototype with this law, and the payloads that it is for.
        certificate: stability, bandwidth and peak sensitivity over these.
        analogue_reason: why there is no circuit, in words; empty where there is one.
    """

    stage: InStage
    certificate: Certificate
    analogue: tuple[AnalogueController, ...] = ()
    analogue_reason: str = ""
    digital: DigitalController | None = None
    acceptance: tuple[AcceptanceAtMass, ...] = ()
    plan: AcceptancePlan | None = None


@dataclass(frozen=True, repr=False)
class Specification(Result):
    """Everything; the parts after `laws` are None where the loop is not stable over the range.

    Of a design run it is what follows from the design without a further search: no sensor, tolerances, circuit or code.

    Attributes:
        prototype: what is specified.
        masses_kg: range of outer end mass.
        load_N: reference load of the ratings.
        load_words: where it comes from.
        laws: of the controller, each over its own payloads.
        switching: what is proved of changes between them; None for one law, and with effects, of which nothing is.
        guaranteed: the worst that is proved with any of the laws over its own payloads.
        stock: nearest stock sizes; None where a beam has no geometry.
        tolerances_reason: why no tolerances are proved, in words; empty where they are.
        governing: the structural check that governs the sections of a design run; empty for another prototype.
        reason: why there is no specification, in words; empty where there is one.
    """

    prototype: Prototype
    masses_kg: tuple[float, float]
    load_N: float
    load_words: str
    laws: tuple[LawSpecification, ...]
    switching: Switching | None = None
    guaranteed: Guaranteed | None = None
    stock: tuple[StockChoice, ...] | None = None
    ratings: Ratings | None = None
    sensor: SensorNeed | None = None
    tolerances: Tolerances | None = None
    tolerances_reason: str = ""
    governing: str = ""
    reason: str = ""

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign spec` writes of it."""
        from beamdesign.build.folder import json_fields

        return json_fields(self)

    def rows(self) -> list[tuple[str, str, str]]:
        """Figure, value, and what it rests on."""
        from beamdesign.build.folder import optional

        guaranteed, tolerances, sensor = self.guaranteed, self.tolerances, self.sensor
        if guaranteed is None or sensor is None:
            return []
        rows = [
            ("for every outer end mass of", masses_text(self.masses_kg), ""),
            ("guaranteed bandwidth", stated_bandwidth(guaranteed.bandwidth_Hz), "proved"),
            ("guaranteed peak sensitivity", stated_peak(guaranteed.peak_sensitivity), "proved"),
            ("proved", holds_for(self.prototype), ""),
            *(("not proved", law.certificate.open_between, "") for law in self.laws if law.certificate.open_between),
        ]
        for law in self.laws:
            name = f"stage {law.stage.number}: " if law.stage.number else ""
            for one in law.analogue:
                verdicts = [f"{100 * t.resistors:g}/{100 * t.capacitor:g} % {t.verdict}" for t in one.tolerances]
                words = f"{name}circuit of {one.circuit.resistors}, {one.circuit.capacitors}"
                rows.append((words, "; ".join(verdicts), ""))
            assert law.digital is not None
            late, answers = law.digital.one_period_late, {True: "proved", False: "refuted", None: "undecided"}
            basis = "not worked out" if late is None else answers[late.stable]
            rows.append((f"{name}code at, current one period late", f"{law.digital.equation.rate_Hz:g} Hz", basis))
        if self.prototype.schedule is not None and self.switching is None:
            rows.append(("changes between the laws", "not covered by any proof", "the prototype has effects"))
        for words, from_Hz in (
            ("sensor bandwidth from which on the loop is stable", sensor.stable_from_Hz),
            (f"that costs at most {100 * KEPT:g} % of the guarantee", sensor.performs_from_Hz),
        ):
            founded = "none proved" if from_Hz is None else "proved"
            rows.append((words, optional(from_Hz, "Hz", ROUND_CEILING), founded))
        finest = f"{decimal(1e6 * sensor.resolution_m, 4, ROUND_FLOOR)} µm"
        rows.append(("sensor resolution, at most", finest, "computed"))
        if tolerances is None:
            rows.append(("tolerances", "none proved", self.tolerances_reason))
        else:
            tightest, share = tolerances.figures[0], decimal(100 * tolerances.equal, 3, ROUND_FLOOR)
            alone = f"± {decimal(100 * tightest.alone, 3, ROUND_FLOOR)} %"
            name = f"tightest figure alone: {tightest.name}" if tightest.alone < LARGEST else "each figure alone"
            rows += [(name, alone, "proved"), ("all figures at once, equal shares", f"± {share} %", "proved")]
        return rows


@takes("Prototype")
def specify(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float] | None = None,
    rate_Hz: float | None = None,
    load_N: float | None = None,
    noise_share: float = 0.1,
    progress: Progress = silent,
) -> Specification:
    """Specify what to build and how to accept it; `write_specification` of `beamdesign.build.folder` writes it.

    Args:
        prototype: with a controller.
        outer_end_mass_kg: range of payload to be built for; else the prototype's.
        rate_Hz: sampling rate of the difference equations; chosen where it is None, as the schedule's of several laws.
        load_N: reference load; else the prototype's largest force, else the weight of the largest payload.
        noise_share: share of the motion that the goal allows, which sensor noise may cause.
        progress: told the share done and what is being done.

    Raises:
        InputError: for a sampling rate that is too low for its laws, or one that cannot be sampled; for effects for
            which no linear loop stands; for several laws and one payload; without a range; for figures that are not
            plausible; where the inner beam's own sag leaves nothing to test.
        ValueError: for an empty range.
    """
    for key, quantity, given in (("rate_Hz", SamplingRate, rate_Hz), ("load_N", Force, load_N)):
        checked(prototype.name, key, quantity, *([] if given is None else [given]))
    checked(prototype.name, "noise_share", Share, noise_share)
    masses_kg = prototype.asked_kg(outer_end_mass_kg)
    prototype = _for_payloads(prototype, masses_kg)
    stages, schedule = prototype.stages(masses_kg), prototype.schedule
    rate_Hz = rate_Hz or (1 / schedule.period_s if schedule else None)
    _refuse_slow(prototype, rate_Hz)
    progress(0.0, "certificate")
    laws = tuple(LawSpecification(stage, certify(stage.prototype, *stage.outer_end_mass_kg)) for stage in stages)
    load, words = reference_load(prototype, masses_kg, load_N)
    found = Specification(prototype, masses_kg, load, words, laws)
    for one in laws:
        inside = one.certificate.between
        if one.certificate.guaranteed is None or (inside is not None and inside.stable is False):
            low, high = one.stage.outer_end_mass_kg
            reason = f"not certifiable from {low:g} to {high:g} kg: {one.certificate.reason}"
            return replace(found, reason=reason)
    if schedule is not None and not masses_kg[0] < masses_kg[1]:
        reason = f"{masses_kg[0]:g} kg is one payload, which is not for a scheduled controller; give one law"
        raise InputError(prototype.name, [("payload.outer_end_mass_kg", reason)])
    progress(0.01, "difference equations")
    laws = tuple(_begun(one, rate_Hz) for one in laws)
    # One law may be built as a circuit instead; several are handed over by code alone.
    if schedule is not None and (refuted := "; ".join(filter(None, map(_why_no_code, laws)))):
        return replace(found, reason=refuted)
    if schedule is not None and not prototype.effects:  # with which no proof covers changes, as the document says
        progress(0.015, "changes of stage")
        switched = switching(stage_families(prototype), *masses_kg, dwell_s=schedule.dwell_s)
        found = replace(found, switching=switched)
        if not switched.stable:
            return replace(found, reason=f"changes between its laws are not proved: {switched.reason}")
    progress(0.02, "sections and ratings")
    found = _with_ratings(found)
    progress(0.05, "bandwidth of the sensor")
    sensor = sensor_need(prototype, masses_kg, load, noise_share)
    unboxed = why_no_box(stages[0].prototype)
    kept = None if unboxed else tolerances(prototype, masses_kg, part_of(progress, 0.1, 0.5))
    specified, share = {} if kept is None else kept.specified, 0.5 / len(laws)
    laws = tuple(
        _realised(one, specified, part_of(progress, 0.5 + k * share, 0.5 + (k + 1) * share))
        for k, one in enumerate(laws)
    )
    return replace(found, laws=laws, sensor=sensor, tolerances=kept, tolerances_reason=unboxed)


def _for_payloads(prototype: Prototype, masses_kg: tuple[float, float]) -> Prototype:
    """With these payloads in the place of its own, whose weight some effects heed, and a guarantee that covers them.

    Raises:
        InputError: where some of them are for no law.
    """
    if masses_kg == (prototype.outer_end_mass_kg or (0.0, 0.0)):
        return prototype
    prototype.stages(masses_kg)
    payload, stated = prototype.payload.but(outer_end_mass_kg=masses_kg), prototype.guarantee
    if stated is not None:
        low, high = stated.outer_end_mass_kg
        stated = stated if low <= masses_kg[0] and masses_kg[1] <= high else None
    return prototype.but(payload=payload, guarantee=stated)


@takes("Prototype")
def spec(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float] | None = None,
    rate_Hz: float | None = None,
    load_N: float | None = None,
    noise_share: float = 0.1,
    progress: Progress = silent,
) -> Specification:
    """The same by the name of the command; arguments as of `specify`."""
    return specify(prototype, outer_end_mass_kg, rate_Hz, load_N, noise_share, progress)


def specification_of(run: DesignRun) -> Specification:
    """The specification of a design run with one law that gave a certified prototype; its load is the study's.

    Raises:
        ValueError: where the run has no result; its `reason` says why.
    """
    prototype, certificate = run.prototype, run.certificate
    if prototype is None or certificate is None or prototype.guarantee is None or prototype.controller is None:
        raise ValueError(f"nothing to specify: {run.reason or 'the run is not complete'}")
    masses_kg = prototype.guarantee.outer_end_mass_kg
    stage = InStage(prototype, masses_kg, int(run.suffix.rpartition("_")[2] or 0))
    law = LawSpecification(stage, certificate, acceptance=acceptance(prototype, stage.looked_at_kg))
    load_N = run.problem.load.tip_force_N
    found = Specification(prototype, masses_kg, load_N, "the study's load on the tip", (law,))
    return replace(_with_ratings(found), governing=run.sizing.governing)


def _with_ratings(found: Specification) -> Specification:
    """With what follows from the proofs of its laws at once: guarantee, stock sizes and ratings."""
    each = [one for law in found.laws if (one := law.certificate.guaranteed) is not None]
    assert len(each) == len(found.laws)  # a law that is not certifiable has been refused
    reached, stated = worst_of(each), found.prototype.guarantee
    # Of a prototype that is promised for every rig within its tolerances the promise is rated, as `run` does.
    up_to_Hz = reached.bandwidth_Hz if stated is None else min(stated.bandwidth_Hz, reached.bandwidth_Hz)
    stock = stock_choices(found.prototype, found.masses_kg)
    needed = ratings(found.prototype, found.masses_kg, found.load_N, up_to_Hz)
    return replace(found, guaranteed=reached, stock=stock, ratings=needed)


def _refuse_slow(prototype: Prototype, rate_Hz: float | None) -> None:
    """Refuse a sampling rate that is too low for a law."""
    try:
        upper = max(upper_break_Hz(law) for law, _ in prototype.own_controller.laws)
    except ValueError as error:
        raise InputError(prototype.name, [("controller", str(error))]) from error
    if rate_Hz is not None and rate_Hz <= 2 * upper:
        reason = f"{rate_Hz:g} Hz is not more than twice the controller's upper break, {upper:g} Hz; give more"
        raise InputError("--sampling-rate-Hz", [("rate", reason)])


def _begun(law: LawSpecification, rate_Hz: float | None) -> LawSpecification:
    """A law that is proved stable over its payloads with its difference equation and excitations to accept it by."""
    prototype, masses_kg, _ = law.stage
    digital = digital_controller(prototype, masses_kg, law.stage.looked_at_kg, rate_Hz)
    return replace(law, digital=digital, plan=acceptance_plan(prototype, masses_kg))


def _why_no_code(law: LawSpecification) -> str:
    """Why the code of a law is refuted, and what to change, in words; empty where it is not."""
    assert law.digital is not None
    found, late = law.digital, law.digital.one_period_late
    if late is None or late.stable is not False:
        return ""
    rate = found.equation.rate_Hz
    faster = max(2 * rate, sensible_rate_Hz(found.crossover_Hz, upper_break_Hz(law.stage.prototype.own_controller)))
    return (
        f"the code of stage {law.stage.number}, sampled at {rate:g} Hz with its current one period late, is not stable:"
        f" {late.reason}; sample more often, as every {1 / faster:.2g} s (controller.period_s)"
    )


def _realised(law: LawSpecification, specified: Mapping[str, float], progress: Progress) -> LawSpecification:
    """A law that is begun, with its circuit and what is expected of its acceptance test."""
    prototype, masses_kg, _ = law.stage
    analogue: tuple[AnalogueController, ...] = ()
    why = ""
    try:
        analogue = analogue_controllers(prototype, masses_kg, part_of(progress, 0.0, 0.2))
    except ValueError as error:
        why = str(error)
    assert law.plan is not None
    looked_at = tuple(sorted({*law.stage.looked_at_kg, *law.plan.masses_kg}))
    expected = acceptance(prototype, looked_at, specified, part_of(progress, 0.2, 1.0))
    return replace(law, analogue=analogue, analogue_reason=why, acceptance=expected)


def digital_controller(
    prototype: Prototype, masses_kg: tuple[float, float], looked_at: tuple[float, ...], rate_Hz: float | None
) -> DigitalController:
    """The difference equation; where no rate is asked for, it is raised until the sampled-data loop is proved."""
    controller, closed = prototype.own_controller, loop(prototype)
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
        box = box_with_effects(prototype, {"outer_end_mass": masses_kg, "delay": (0.0, delay)})
        verdict = certify_box(prototype, box, _DELAY_BUDGET, volumes=False)
        stable, proof = verdict.stable, verdict.certificate if verdict.stable else ""
    return DigitalController(equation, crossover, at_once, late, delay, stable, proof, reason)


def reference_load(prototype: Prototype, masses_kg: tuple[float, float], asked: float | None) -> tuple[float, str]:
    """The load that ratings are for, N, and where it comes from; a weight to three significant digits at least."""
    if asked is not None:
        return asked, "as asked for"
    if prototype.payload.largest_force_N:
        return prototype.payload.largest_force_N, "payload.largest_force_N of the prototype"
    if masses_kg[1] > 0:
        weight_N = STANDARD_GRAVITY * masses_kg[1]
        return round(weight_N, max(1, 2 - floor(log10(weight_N)))), "weight of the largest payload"
    return _REFERENCE_N, "chosen, since the prototype states no load; give one with --load-N"
